"""The HTTP interface of a live federation: commands in, decisions and events out.

A principal speaks by its token and for itself alone, which the handlers judge (`handlers/public.not_its_word`), so that
an attempt to speak for another is on record. An invalid command, or one without a known token, is an HTTP error and
leaves no trace. Nothing here waits without a limit: not for a client's headers, body or reading, nor for the disk.
"""

import asyncio
import secrets
import socket
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route

from fsar_ledger.base.errors import FsarLedgerError, UsageError
from fsar_ledger.base.printable import did_you_mean
from fsar_ledger.events import CONCERN_OF, CONCERNS, Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.runtime.federation import Federation
from fsar_ledger.runtime.handlers.public import commands
from fsar_ledger.runtime.live import Decision, command_given
from fsar_ledger.sources.columns import object_of

from . import Principal, Principals
from .feed import IDLE_S, Busy, Decider, EventStream, Feed, LimitedProtocol, Put, Row
from .pages import FILES, described, overview, page, page_file

MAX_BODY, MAX_KEY = 1 << 16, 200
BODY_S, ALIVE_S, END_S = 10.0, 15.0, 3
"""Seconds that a body may take, between signs of life of a quiet subscription, and that the end waits for answers."""
MAX_CONNECTIONS, MAX_SUBSCRIPTIONS, MAX_OWN_SUBSCRIPTIONS, MAX_DRAWN = 512, 128, 8, 4
_OWN = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
_FILTERS = ("after", "robot", "task", "concern")


class HttpError(Exception):
    """An error answer."""

    def __init__(self, status: int, text: str, **headers: str) -> None:
        super().__init__(text)
        self.status, self.text = status, text
        self.headers = {name.replace("_", "-"): value for name, value in headers.items()}


class Service:
    """The routes of one federation.

    Args:
        ledger: The ledger that records it.
        run: The name of its run.
        opened: Opens it; called with a function that it calls with each commit.
        principals: The principals that may give commands or read.
        rate: How many commands a second each may give, and as many at once.
        viewed: Returns the page of the run as it is on record.
    """

    def __init__(
        self,
        ledger: Path,
        run: str,
        opened: Callable[[Callable[[int, bytes], None]], Federation],
        principals: Principals,
        rate: float,
        viewed: Callable[[], str],
    ) -> None:
        self._ledger, self._run, self._opened = ledger, run, opened
        self._principals, self._rate = principals, rate
        self._budgets: dict[str, tuple[float, float]] = {}
        self._subscriptions: Counter[str] = Counter()
        self._answers: Counter[int] = Counter()
        self._feed: Feed
        self._decider: Decider
        self._viewed, self._viewing = viewed, asyncio.Lock()
        self._drawn: dict[str, str] = {}
        self._server: uvicorn.Server | None = None
        self._refusal: FsarLedgerError | None = None
        self.app = Starlette(
            routes=[
                Route("/commands/{name}", self._command, methods=["POST"]),
                Route("/events", self._events, methods=["GET"]),
                Route("/health", self._health, methods=["GET"]),
                Route("/metrics", self._metrics, methods=["GET"]),
                Route("/openapi.json", self._openapi, methods=["GET"]),
                Route("/overview", self._overview, methods=["GET"]),
                Route("/view", self._view, methods=["POST"]),
                Route("/view/{ticket}", self._serve_page, methods=["GET"]),
                *(Route(path, self._file, methods=["GET"]) for path in FILES),
                Route("/", self._page, methods=["GET"]),
            ],
            lifespan=self._living,
            exception_handlers={HttpError: self._refused, HTTPException: self._not_there},
        )

    @asynccontextmanager
    async def _living(self, _: Starlette) -> AsyncIterator[None]:
        self._feed = Feed(self._ledger, self._run)
        try:
            self._decider = Decider(self._opened, asyncio.get_running_loop(), self._feed)
        except FsarLedgerError as error:  # raised here, it would be a traceback
            self._refusal = error
            self.stop()
            yield
            return
        self._decider.start()
        yield
        await asyncio.to_thread(self._decider.stop)

    async def _refused(self, _: Request, error: Exception) -> Response:
        assert isinstance(error, HttpError)
        return self._answer({"error": error.text}, error.status, error.headers)

    async def _not_there(self, request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        call = f"{request.method} {request.url.path!r:.80}"
        text = f"{call}: {error.detail}; expected a path and a method that /openapi.json describes"
        return self._answer({"error": text}, error.status_code, error.headers)

    def _answer(self, document: object, status: int = 200, headers: Mapping[str, str] | None = None) -> Response:
        self._answers[status] += 1
        return Response(msgspec.json.encode(document) + b"\n", status, headers, "application/json")

    def _principal(self, request: Request) -> Principal:
        try:
            principal = self._principals.authenticate(request.headers.get("authorization", ""))
        except UsageError as error:
            raise HttpError(503, f"no token can be checked: {error}", retry_after="5") from error
        if principal is None:
            raise HttpError(
                401,
                "found no token of a principal, expected `Authorization: Bearer TOKEN`; "
                "`fsar-ledger principal new` makes one",
                www_authenticate="Bearer",
            )
        return principal

    async def _command(self, request: Request) -> Response:
        principal = self._principal(request)
        if principal.kind == "auditor":
            raise HttpError(403, f"{principal.principal} reads, expected a principal that gives commands")
        self._spend(principal.principal)
        key = request.headers.get("idempotency-key")
        if key is not None and not 0 < len(key) <= MAX_KEY:
            raise HttpError(400, f"Idempotency-Key: found {len(key)} characters, expected 1 to {MAX_KEY}")
        name, status = request.path_params["name"], 400
        try:
            fields = object_of(await _body(request), "command")
            principal = self._principal(request)  # its token may be void since the headers came
            status = 400 if name in commands() else 404
            command = command_given(name, principal.principal, fields, key)
        except UsageError as error:
            raise HttpError(status, f"{error}") from error
        try:
            decision = await self._decider.decide(command)
        except Busy:
            raise HttpError(503, "too many commands wait; try again", retry_after="1") from None
        except UsageError as error:
            raise HttpError(409, f"{error}") from error
        except FsarLedgerError as error:
            raise HttpError(503, f"nothing was decided: {error}", retry_after="5") from error
        return self._answer(_decided(decision))

    def _spend(self, principal: str) -> None:
        """Take a command from the principal's budget, which is refilled over time."""
        now = time.monotonic()
        left, since = self._budgets.get(principal, (self._rate, now))
        left = min(self._rate, left + (now - since) * self._rate)
        if left < 1:
            self._budgets[principal] = (left, now)
            wait = f"{(1 - left) / self._rate:.3f}"
            raise HttpError(
                429, f"found more than {self._rate:g} commands a second by {principal}; wait {wait} s", retry_after="1"
            )
        self._budgets[principal] = (left - 1, now)

    async def _events(self, request: Request) -> Response:
        principal = self._principal(request)
        if unknown := sorted(set(request.query_params) - set(_FILTERS)):
            raise HttpError(400, f"parameter {unknown[0]!r:.80}: expected some of {', '.join(_FILTERS)}")
        wanted = {name: request.query_params[name] for name in _FILTERS[1:] if name in request.query_params}
        if (concern := wanted.get("concern")) is not None and concern not in CONCERNS:
            raise HttpError(
                400,
                f"concern {concern!r:.80}: there is none{did_you_mean(concern, CONCERNS) or ';'} "
                f"expected one of {', '.join(CONCERNS)}",
            )
        if (robot := wanted.get("robot")) is not None:
            await self._require_robot(robot, principal)
        after = request.headers.get("last-event-id", request.query_params.get("after"))
        if after is not None and not (after.isascii() and after.removeprefix("-").isdigit() and len(after) < 16):
            raise HttpError(400, f"after: found {after!r:.80}, expected the seq of the last known event")
        if after is not None and int(after) >= self._feed.end:
            raise HttpError(
                400,
                f"after: found {after}, expected at most {self._feed.end - 1}, the newest event of run {self._run}; if "
                "there were more, they are lost: `fsar-ledger verify --anchor` a checkpoint that was kept",
            )
        if (
            self._subscriptions.total() >= MAX_SUBSCRIPTIONS
            or self._subscriptions[principal.principal] >= MAX_OWN_SUBSCRIPTIONS
        ):
            raise HttpError(503, "found too many subscriptions; try again when one has ended", retry_after="10")
        first = self._feed.end if after is None else max(0, int(after) + 1)
        self._answers[200] += 1
        return EventStream(first, partial(self._follow, request, principal, first, wanted))

    async def _require_robot(self, name: str, principal: Principal) -> None:
        """Require that a robot of this name has joined; to a robot, others are not named. Raises: HttpError."""
        try:
            robots = await self._decider.ask(lambda state, _: [*state.fleet.robots])
        except FsarLedgerError:  # a client that follows events can wait for the disk
            return
        if name not in robots:
            others = "" if principal.kind == "robot" else f"; expected one of {', '.join(robots)}"
            raise HttpError(400, f"robot {name!r:.80}: there is none{others}")

    async def _follow(self, request: Request, principal: Principal, seq: int, wanted: dict[str, str], put: Put) -> None:
        """Put the events that the principal wants and may see, until its token is taken back or the service ends."""
        self._subscriptions[principal.principal] += 1
        try:
            sent_s = time.monotonic()
            while self._server is None or not self._server.should_exit:
                rows = await self._feed.rows_from(seq, 1.0)
                if self._principal(request) != principal:
                    return
                seq = rows[-1].seq + 1 if rows else seq
                if body := b"".join(_event_message(row, principal, wanted) for row in rows):
                    await put(body)
                    sent_s = time.monotonic()
                elif time.monotonic() - sent_s > ALIVE_S:
                    await put(b": alive\nid: %d\n\n" % (seq - 1))
                    sent_s = time.monotonic()
        finally:
            self._subscriptions[principal.principal] -= 1

    async def _health(self, _: Request) -> Response:
        failed = self._decider.failed or self._principals.failure()
        if failed is not None:
            return self._answer({"status": "failed", "run": self._run, "error": f"{failed}"}, 503)
        return self._answer({"status": "ok", "run": self._run, "events": self._feed.end})

    async def _metrics(self, _: Request) -> Response:
        lines = {
            "fsar_events_total": ("counter", self._feed.end),
            "fsar_commands_total": ("counter", self._decider.decided),
            "fsar_writes_total": ("counter", self._decider.writes),
            "fsar_commands_waiting": ("gauge", self._decider.waiting),
            "fsar_subscriptions": ("gauge", self._subscriptions.total()),
            "fsar_healthy": ("gauge", int((self._decider.failed or self._principals.failure()) is None)),
        }
        text = "".join(f"# TYPE {name} {kind}\n{name} {count}\n" for name, (kind, count) in lines.items())
        text += "# TYPE fsar_answers_total counter\n"
        text += "".join(
            f'fsar_answers_total{{status="{status}"}} {count}\n' for status, count in sorted(self._answers.items())
        )
        return PlainTextResponse(text, media_type="text/plain; version=0.0.4")

    async def _openapi(self, _: Request) -> Response:
        return self._answer(described())

    def _reader(self, request: Request) -> Principal:
        """Return the principal of a request that robots may not make. Raises: HttpError."""
        principal = self._principal(request)
        if principal.kind == "robot":
            raise HttpError(403, f"{principal.principal} is a robot, expected a person or a program")
        return principal

    async def _overview(self, request: Request) -> Response:
        reader = self._reader(request)
        try:
            document = await self._decider.ask(partial(overview, principal=reader.principal, run=self._run))
        except FsarLedgerError as error:
            raise HttpError(503, f"{error}", retry_after="5") from error
        return self._answer(document)

    async def _view(self, request: Request) -> Response:
        """Draw the run until now as the page of `fsar-ledger view`, and return where it can be fetched once."""
        self._reader(request)
        async with self._viewing:
            try:
                content = await asyncio.to_thread(self._viewed)
            except FsarLedgerError as error:
                raise HttpError(503, f"{error}", retry_after="5") from error
        ticket = secrets.token_urlsafe(16)
        self._drawn[ticket] = content
        while len(self._drawn) > MAX_DRAWN:
            del self._drawn[next(iter(self._drawn))]
        return self._answer({"page": f"view/{ticket}"})

    async def _serve_page(self, request: Request) -> Response:
        content = self._drawn.pop(request.path_params["ticket"], None)
        if content is None:
            raise HttpError(404, "the page was fetched already, or there was none")
        return HTMLResponse(content, headers={"Content-Security-Policy": "sandbox allow-scripts allow-downloads"})

    async def _file(self, request: Request) -> Response:
        name, kind = FILES[request.url.path]
        return Response(page_file(name), media_type=kind, headers=_OWN)

    async def _page(self, _: Request) -> Response:
        return HTMLResponse(
            page(self._run), headers={"Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'"}
        )

    def serve(self, listening: socket.socket, certificate: Path | None = None, key: Path | None = None) -> None:
        """Serve here until SIGTERM, Ctrl-C or `stop`; pending answers are sent, and the ledger is closed.

        Raises: As `opened`.
        """
        config = uvicorn.Config(
            self.app,
            http=LimitedProtocol,
            ws="none",
            lifespan="on",
            log_level="error",
            access_log=False,
            server_header=False,
            limit_concurrency=MAX_CONNECTIONS,
            timeout_keep_alive=int(IDLE_S),
            timeout_graceful_shutdown=END_S,
            ssl_certfile=certificate,
            ssl_keyfile=key,
        )
        self._server = uvicorn.Server(config)
        self._server.run(sockets=[listening])
        if self._refusal is not None:
            raise self._refusal

    def stop(self) -> None:
        """End `serve`."""
        if self._server is not None:
            self._server.should_exit = True


def _event_message(row: Row, principal: Principal, wanted: dict[str, str]) -> bytes:
    """Return the event as a message to a client; empty if it does not want it or may not see it."""
    message = b"data: %s\nid: %d\n\n" % (row.data, row.seq)
    if principal.kind != "robot" and not wanted:
        return message
    columns = msgspec.json.decode(row.data, type=dict[str, Any])
    kind = str(columns["type"])
    names = {text for value in columns.values() for text in (value if isinstance(value, list) else (value,))}
    if principal.kind == "robot" and principal.principal not in names:
        return b""
    if "robot" in wanted and wanted["robot"] not in names:
        return b""
    if "task" in wanted and columns.get("task_id") != wanted["task"]:
        return b""
    if "concern" in wanted and CONCERN_OF.get(kind.partition(".")[0]) != wanted["concern"]:
        return b""
    return message


def _decided(decision: Decision) -> dict[str, object]:
    document: dict[str, object] = {"seq": decision.seq, "rejected": decision.rejected, "events": _rows(decision.events)}
    return document | ({"followed": _rows(decision.followed)} if decision.followed else {})


def _rows(events: tuple[Event, ...]) -> list[dict[str, object]]:
    rows = [(type(event).__name__, flat(event)) for event in events]
    return [{"type": kind, **{name: value for name, value in row.items() if value is not None}} for kind, row in rows]


async def _body(request: Request) -> bytes:
    """Return the body. Raises: HttpError if it is too long or takes too long."""

    async def read() -> bytes:
        body = bytearray()
        async for part in request.stream():
            body += part
            if len(body) > MAX_BODY:
                raise HttpError(413, f"found more than {MAX_BODY:,} bytes, expected one command", connection="close")
        return bytes(body)

    try:
        return await asyncio.wait_for(read(), BODY_S)
    except TimeoutError:
        raise HttpError(
            408, f"found half a command after {BODY_S:g} s, expected a whole one", connection="close"
        ) from None
    except ClientDisconnect:
        raise HttpError(400, "the client disconnected") from None
