"""The client of a service, for a robot's own program: needs nothing but Python and msgspec.

Every command gets a key, so one whose answer was lost on the way is sent again and decided once. Events are followed
from a position, and after a disconnect from the last one received.
"""

import http.client
import secrets
import ssl
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar
from urllib.parse import quote, urlencode, urlsplit

import msgspec

from fsar_ledger.base.errors import FsarLedgerError, UsageError, checked

TRANSIENT = (429, 503)
"""Transient errors: too many commands at once, or a full disk."""
PAUSE_S = 0.2
"""The first wait before a retry, in seconds; each further one is twice as long, up to 5."""

_Kind = TypeVar("_Kind")


class Refused(FsarLedgerError):
    """The service refused a command; nothing of it is on record. `status` is that of HTTP."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class Answered(msgspec.Struct, frozen=True):
    """The outcome of a command: the seq of its record, why it was rejected, its events, and what followed at once.

    An event is a dictionary with its `type` and its columns.
    """

    seq: int
    rejected: str | None
    events: tuple[dict[str, Any], ...]
    followed: tuple[dict[str, Any], ...] = ()


class _Health(msgspec.Struct):
    events: int


class FollowedEvent(msgspec.Struct, frozen=True):
    """An event of the run: its seq, type (`ExecutionStarted`) and columns, and its row as the ledger hashes it.

    `seq` is what `Client.events` takes as `after`. It counts on where the run is cut; that in the row begins anew.
    """

    seq: int
    type: str
    columns: dict[str, Any]
    row: bytes


class Client:
    """A principal's connection to a service. Use it as a context manager, or call `close`; one for each thread.

    Args:
        url: Its address, as `fsar-ledger serve` prints it.
        token: The token that `fsar-ledger principal new` printed.
        patience_s: How long transient errors (a lost connection, a full disk) are retried.
        tls: For https: the certificates to trust, if not those of the system.
        pause: Waits this many seconds.
    """

    @checked
    def __init__(
        self,
        url: str,
        token: str,
        *,
        patience_s: float = 30.0,
        tls: ssl.SSLContext | None = None,
        pause: Callable[[float], None] = time.sleep,
    ) -> None:
        self._url, self._token, self._patience_s, self._tls, self._pause = urlsplit(url), token, patience_s, tls, pause
        if self._url.scheme not in ("http", "https") or not self._url.hostname:
            raise UsageError(f"url {url!r:.200}: expected http://HOST:PORT or https://HOST:PORT")
        if not (token.isascii() and token.isprintable()):
            raise UsageError(
                "token: found characters that no token has, expected one as `principal new` printed it, on one line"
            )
        self._line: http.client.HTTPConnection | None = None

    def give(self, command: str, *, key: str | None = None, **fields: object) -> Answered:
        """Give the command (`ReportStart`) with these fields, and return its outcome, which is on disk.

        `key` identifies it, so that the same one can be given again even by another process; None: a new key.

        Raises:
            UsageError: The key has characters that no header can hold, or a field has a value that JSON cannot.
            Refused: It is not a command, not this principal's to give, or the service cannot take it in `patience_s`.
        """
        if key is not None and not (key.isprintable() and key.encode("latin-1", "replace").decode("latin-1") == key):
            raise UsageError(f"key {key!r:.200}: expected characters of Latin-1 that can be printed, as a header has")
        if key is not None and (not key or key != key.strip()):
            raise UsageError(f"key {key!r:.200}: expected at least one character, and no blank at either end")
        try:
            body = msgspec.json.encode(fields)
        except (TypeError, UnicodeEncodeError) as error:
            raise UsageError(f"command {command!r:.80}: {error!s:.200}; expected fields that are JSON") from error
        headers = {"Idempotency-Key": key or secrets.token_hex(16), "Content-Type": "application/json"}
        answer = self._patiently("POST", f"/commands/{quote(command)}", body, headers)
        return self._decoded(answer, Answered)

    def known(self) -> int:
        """Return how many events the run has. Raises: Refused: The service is unavailable, or its disk refuses."""
        return self._decoded(self._patiently("GET", "/health", None, {}), _Health).events

    def events(
        self, after: int | None = None, *, robot: str | None = None, task: str | None = None, concern: str | None = None
    ) -> Iterator[FollowedEvent]:
        """Yield the events after this seq (None: new ones only), and wait for more.

        They can be limited to those that name a robot, of a task, or of a concern. Each is yielded at least once, in
        order, and after a disconnect from the last position.

        Raises:
            Refused: The service does not let this principal follow, or is unavailable for longer than `patience_s`.
        """
        filters = {"robot": robot, "task": task, "concern": concern}
        pauses = self._pauses()
        while True:
            connection = self._connection()
            try:
                query = {"after": after, **filters}
                path = f"/events?{urlencode({name: value for name, value in query.items() if value is not None})}"
                connection.request("GET", path, headers=self._headers())
                answer = connection.getresponse()
                if answer.status != 200 and answer.status not in TRANSIENT:
                    raise Refused(answer.status, _reason(answer.read()))
                row = b""
                for name, value in _fields(answer) if answer.status == 200 else ():
                    if name == b"from":
                        after = int(value) - 1
                    elif name == b"data":
                        row = value
                    elif name == b"id":
                        after, pauses = int(value), self._pauses()
                        if row:
                            columns = msgspec.json.decode(row, type=dict[str, Any])
                            yield FollowedEvent(after, columns["type"].partition(".")[0], columns, row)
                            row = b""
                reason = "the service ended"
            except (OSError, http.client.HTTPException) as error:
                reason = f"{error}"
            finally:
                connection.close()
            if (pause_s := next(pauses)) is None:
                raise Refused(503, f"the service does not answer ({reason})")
            self._pause(pause_s)

    def close(self) -> None:
        """Close the connection; the next command opens another."""
        if self._line is not None:
            self._line.close()
            self._line = None

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _patiently(self, method: str, path: str, body: bytes | None, headers: dict[str, str]) -> bytes:
        """Return the answer, retrying transient errors. Raises: Refused for any other error, or in the end."""
        for pause_s in self._pauses():
            try:
                status, answer = self._send_request(method, path, body, headers)
            except (OSError, http.client.HTTPException) as error:
                status, answer = 503, f"the service does not answer ({error})".encode()
                self.close()
            if status == 200:
                return answer
            if status not in TRANSIENT or pause_s is None:
                break
            self._pause(pause_s)
        raise Refused(status, _reason(answer))

    def _decoded(self, answer: bytes, kind: type[_Kind]) -> _Kind:
        """Return the answer of a service. Raises: Refused for that of another program, such as a proxy."""
        try:
            return msgspec.json.decode(answer, type=kind)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise Refused(
                200,
                f"{self._url.geturl()}: found {answer[:80]!r}, expected the answer of `fsar-ledger serve`; check the "
                "address, and any proxy before it",
            ) from error

    def _send_request(self, method: str, path: str, body: bytes | None, headers: dict[str, str]) -> tuple[int, bytes]:
        if self._line is None:
            self._line = self._connection()
        self._line.request(method, path, body, {**self._headers(), **headers})
        answer = self._line.getresponse()
        return answer.status, answer.read()

    def _headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self._token}"}

    def _connection(self) -> http.client.HTTPConnection:
        host, port = f"{self._url.hostname}", self._url.port
        if self._url.scheme == "https":
            return http.client.HTTPSConnection(host, port, timeout=60, context=self._tls)
        return http.client.HTTPConnection(host, port, timeout=60)

    def _pauses(self) -> Iterator[float | None]:
        """Yield how long to wait before each retry, then None."""
        left, pause_s = self._patience_s, PAUSE_S
        while left > 0:
            yield min(pause_s, left)
            left -= pause_s
            pause_s = min(2 * pause_s, 5.0)
        while True:
            yield None


def _fields(answer: http.client.HTTPResponse) -> Iterator[tuple[bytes, bytes]]:
    """Yield the fields of server-sent events, and the comment that tells where they begin."""
    while (line := answer.readline()).endswith(b"\n"):
        name, _, value = line.rstrip(b"\n").removeprefix(b": ").partition(b" ")
        if name:
            yield name.removesuffix(b":"), value


def _reason(answer: bytes) -> str:
    try:
        return str(msgspec.json.decode(answer, type=dict[str, Any]).get("error"))
    except (msgspec.DecodeError, UnicodeDecodeError):
        return answer[:200].decode(errors="replace")
