"""The layer of a service between its clients and the federation: one thread decides, and all clients follow the events.

All waiting commands are decided in one write, so that many clients share a sync. The feed gets the events from the
commit itself; those no longer in its memory are read from the ledger. No connection is held without a limit, and a
client that follows events and does not read is disconnected.
"""

import asyncio
import math
from collections import deque
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from traceback import print_exc
from typing import Any, NamedTuple, TypeVar

import msgspec
from starlette.responses import Response
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from fsar_ledger.base.errors import FsarLedgerError, WriteFailed
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.locations import chain_of, event_count
from fsar_ledger.ledger.store.read import View
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.federation import Federation, newest_of
from fsar_ledger.runtime.live import Decision

TICK_S = 0.05
"""Seconds between decisions on what is due, such as timeouts, while no command arrives."""
AT_ONCE = 256
"""The most commands in one write."""
WAITING = 1_024
"""The most commands that wait; the senders of further ones are told to try again."""
REOPEN_S = 2.0
"""Seconds after a failed write until the federation is opened again."""
KEPT = 1 << 15
"""How many of the newest events are in memory; older ones are read from the ledger."""

MAX_HEADERS = 1 << 14
HEADERS_S, WRITE_S, IDLE_S = 10.0, 20.0, 30.0
"""Seconds that a client may take to send its headers, to read some of what was sent, and to make its next request."""
ABORT = "fsar.abort"
"""The extension of the scope that ends a connection at once."""

Put = Callable[[bytes], Coroutine[Any, Any, None]]
Result = Decision | FsarLedgerError
_Asked = TypeVar("_Asked")


class Busy(Exception):
    """Too many commands wait, so this one was not taken."""


class Row(NamedTuple):
    """An event: its seq, which continues across cuts of the run, and its bytes as the ledger hashes them, in JSON."""

    seq: int
    data: bytes


class _Place(msgspec.Struct):
    run_id: str
    seq: int


_PLACE = msgspec.json.Decoder(_Place)


class Feed:
    """The events of a run from any position on. All methods but `recorded` are for the loop's thread.

    `end` is the seq after the newest event.
    """

    def __init__(self, ledger: Path, run: str) -> None:
        self._ledger, self._run = ledger, run
        self._kept: deque[Row] = deque(maxlen=KEPT)
        self._grown = asyncio.Event()
        self._runs: list[str] = []  # those that continue each other, as last found
        self.end = 0

    def publish(self, first: int, rows: bytes) -> None:
        """Add the rows of a commit, a line each, the first of which has this seq."""
        if first != self.end:
            self._kept.clear()  # the federation was opened again, and the events between are in the ledger
        lines = rows.splitlines()
        self._kept.extend(Row(first + number, line) for number, line in enumerate(lines))
        self.end = first + len(lines)
        self._grown.set()
        self._grown = asyncio.Event()

    async def rows_from(self, seq: int, timeout_s: float) -> Sequence[Row]:
        """Return rows from this seq on, none if none arrives in this time. Raises: LedgerCorrupted."""
        if seq >= self.end:
            with suppress(TimeoutError):
                async with asyncio.timeout(timeout_s):  # `wait_for` of Python 3.11 may ignore that it is cancelled
                    await self._grown.wait()
            if seq >= self.end:
                return ()
        if self._kept and self._kept[0].seq <= seq:
            first = self._kept[0].seq
            return [self._kept[index - first] for index in range(seq, min(self.end, seq + AT_ONCE))]
        return await asyncio.to_thread(self.recorded, seq)

    def recorded(self, seq: int) -> Sequence[Row]:
        """Return the rows from this seq to the end of a part of the ledger. Raises: LedgerCorrupted."""
        view = open_ledger(self._ledger)
        if not (rows := _rows_in(view, self._runs, seq)):  # finding the runs means searching all of them
            self._runs = chain_of(view, newest_of(view, self._run)[0])
            rows = _rows_in(view, self._runs, seq)
        return rows


def _rows_in(view: View, runs: Sequence[str], seq: int) -> Sequence[Row]:
    """Return the rows from this seq to the end of a part of these runs; none if they end before."""
    offset = 0
    for run in runs:
        parts = view.parts(run)
        for part in parts:
            if offset + part.block.end > seq:
                rows = ((_PLACE.decode(row), row) for row in view.rows(part.first, part.end))
                matching = (
                    (offset + place.seq, row)
                    for place, row in rows
                    if place.run_id == run and (place.seq or not offset)
                )
                return [Row(number, row) for number, row in matching if number >= seq]
        offset += event_count(parts) - 1
    return ()


class Decider:
    """A federation and the thread that decides waiting commands. Begin with `start`, end with `stop`.

    `opened` opens the federation, and again after a failed write, so that freeing disk space is enough.
    """

    def __init__(
        self, opened: Callable[[Callable[[int, bytes], None]], Federation], loop: asyncio.AbstractEventLoop, feed: Feed
    ) -> None:
        self._opened, self._loop, self._feed = opened, loop, feed
        self._queue: SimpleQueue[tuple[CommandGiven, asyncio.Future[Result]] | None] = SimpleQueue()
        self._federation: Federation | None = opened(self._tell)
        self._thread = Thread(target=self._decide, name="decisions", daemon=True)
        self.waiting = self.decided = self.writes = 0
        self.failed: FsarLedgerError | None = None
        feed.end = self._federation.size

    def start(self) -> None:
        """Begin to decide."""
        self._thread.start()

    def stop(self) -> None:
        """Decide the waiting commands, and close the ledger."""
        self._queue.put(None)
        self._thread.join()

    async def decide(self, command: CommandGiven) -> Decision:
        """Return the decision on the command, once it is on disk.

        Raises:
            Busy: Too many commands wait.
            UsageError: Its key was given with another command.
            WriteFailed: The disk refuses.
        """
        if self.waiting >= WAITING:
            raise Busy
        self.waiting += 1
        answer: asyncio.Future[Result] = self._loop.create_future()
        self._queue.put((command, answer))
        result = await answer
        if isinstance(result, FsarLedgerError):
            raise result
        return result

    async def ask(self, question: Callable[[State, int], _Asked]) -> _Asked:
        """Return the answer of `Federation.ask`. Raises: WriteFailed while it is closed, since the disk refuses."""
        if (federation := self._federation) is None:
            raise WriteFailed(f"{self.failed}")
        return await asyncio.to_thread(federation.ask, question)

    def _tell(self, first: int, rows: bytes) -> None:
        self._loop.call_soon_threadsafe(self._feed.publish, first, rows)

    def _next(self, timeout_s: float) -> tuple[list[tuple[CommandGiven, asyncio.Future[Result]]], bool]:
        """Return the waiting commands, after at most this time, and whether these are the last."""
        batch = []
        with suppress(Empty):
            item = self._queue.get(timeout=timeout_s)
            while item is not None:
                batch.append(item)
                if len(batch) == AT_ONCE:
                    return batch, False
                item = self._queue.get_nowait()
            return batch, True
        return batch, False

    def _decide(self) -> None:
        is_last = False
        while not is_last:
            batch, is_last = self._next(TICK_S if self._federation is not None else REOPEN_S)
            results = self._results([command for command, _ in batch])
            with suppress(RuntimeError):  # the loop has ended, and no client waits
                self._loop.call_soon_threadsafe(self._answer, batch, results)
        if self._federation is not None:
            with suppress(WriteFailed):
                self._federation.close()

    def _results(self, commands: Sequence[CommandGiven]) -> Sequence[Result]:
        try:
            if self._federation is None:
                self._federation = self._opened(self._tell)
            decided = self._federation.decide_all(commands) if commands else ()
            if not commands:
                self._federation.advance()
        except Exception as error:
            self._give_up()
            if not isinstance(error, FsarLedgerError):  # a bug of ours must not leave a client waiting
                print_exc()
                error = WriteFailed(f"the federation stopped ({type(error).__name__}), and is opened again")
            self.failed = error
            return [error] * len(commands)
        self.failed = None
        self.decided += len(commands)
        self.writes += bool(commands)
        return decided

    def _give_up(self) -> None:
        """Close the federation, whose state has events that are not on disk."""
        if self._federation is not None:
            with suppress(Exception):  # for want of memory, too: it is opened again
                self._federation.close()
            self._federation = None

    def _answer(self, batch: Sequence[tuple[CommandGiven, asyncio.Future[Result]]], results: Sequence[Result]) -> None:
        self.waiting -= len(batch)
        for (_, answer), result in zip(batch, results, strict=True):
            if not answer.done():  # the client may have gone
                answer.set_result(result)


class EventStream(Response):
    """Server-sent events. A client that does not read is disconnected, and can resume from its last position.

    `follow` puts what is to be sent, until the service ends.
    """

    def __init__(self, first: int, follow: Callable[[Put], Coroutine[Any, Any, None]]) -> None:
        super().__init__(media_type="text/event-stream", headers={"Cache-Control": "no-store"})
        del self.headers["content-length"]
        self._first, self._follow = first, follow

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send events until the client disconnects, the service ends, or nothing can be sent."""

        async def put(body: bytes) -> None:
            async with asyncio.timeout(WRITE_S):
                await send({"type": "http.response.body", "body": body, "more_body": True})

        async def wait_for_disconnect() -> None:
            while (await receive())["type"] != "http.disconnect":
                pass

        await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
        if scope["method"] == "HEAD":
            await send({"type": "http.response.body", "body": b""})
            return
        await put(b": from %d\n\n" % self._first)
        following = asyncio.create_task(self._follow(put))
        leaving = asyncio.create_task(wait_for_disconnect())
        await asyncio.wait((following, leaving), return_when=asyncio.FIRST_COMPLETED)
        for task in (following, leaving):
            task.cancel()
        results = await asyncio.gather(following, leaving, return_exceptions=True)
        if isinstance(results[0], TimeoutError):
            scope["extensions"][ABORT]["call"]()  # a closed transport waits until all has been read
        else:
            await send({"type": "http.response.body", "body": b""})


class LimitedProtocol(HttpToolsProtocol):
    """An HTTP protocol that disconnects clients that are slow or idle, or whose headers are too long.

    After an answer only the next request ends the wait: not empty lines, nor the rest of a body that was not read.
    """

    def connection_made(self, transport: Any) -> None:
        """Begin to wait for headers."""
        super().connection_made(transport)
        self._header_bytes = 0
        self._deadline = self.loop.call_later(HEADERS_S, transport.abort)
        self._idle: asyncio.TimerHandle | None = None
        self._unread: asyncio.TimerHandle | None = None
        self._answered: Any = None  # the request that is being answered, or was last

    def on_message_begin(self) -> None:
        """Begin to wait for headers."""
        super().on_message_begin()
        self.scope["extensions"] = {ABORT: {"call": self.transport.abort}}
        self._header_bytes = 0
        _cancel(self._idle, self._deadline)
        self._deadline = self.loop.call_later(HEADERS_S, self.transport.abort)

    def data_received(self, data: bytes) -> None:
        """Take bytes, at most `MAX_HEADERS` of headers."""
        super().data_received(data)
        if not self._deadline.cancelled():
            self._header_bytes += len(data)
            if self._header_bytes > MAX_HEADERS:
                self.transport.abort()

    def on_headers_complete(self) -> None:
        """Stop waiting for headers."""
        self._deadline.cancel()
        super().on_headers_complete()
        if not self.pipeline:
            self._answered = self.cycle

    def on_response_complete(self) -> None:
        """Begin to wait for the next request, unless it has come or begun already."""
        if self.pipeline:
            self._answered = self.pipeline[-1][0]
        elif self._deadline.cancelled():
            self._idle = self.loop.call_later(IDLE_S, self._end)
        super().on_response_complete()

    def pause_writing(self) -> None:
        """Stop sending, and begin to wait until the client reads."""
        super().pause_writing()
        self._require_reading()

    def resume_writing(self) -> None:
        """Stop waiting until the client reads."""
        super().resume_writing()
        _cancel(self._unread)

    def _end(self) -> None:
        self.transport.close()  # once all has been read
        self._require_reading()

    def _require_reading(self, before: float = math.inf) -> None:
        """Disconnect a client that has read nothing since this many bytes were waiting for it; else look again."""
        _cancel(self._unread)
        waiting = self.transport.get_write_buffer_size()
        if waiting >= before:
            self.transport.abort()
        elif waiting:
            self._unread = self.loop.call_later(WRITE_S, self._require_reading, waiting)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting and answering. Where a client sent several requests at once, uvicorn ends only the newest."""
        if self._answered is not None:
            self._answered.disconnected = True
            self._answered.message_event.set()
        super().connection_lost(exc)
        _cancel(self._deadline, self._idle, self._unread)


def _cancel(*timers: asyncio.TimerHandle | None) -> None:
    for timer in timers:
        if timer is not None:
            timer.cancel()
