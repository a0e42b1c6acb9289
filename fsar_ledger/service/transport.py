"""How the service holds connections: none without a limit, and who follows events and does not read is let go."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from starlette.responses import Response
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

MAX_HEADERS = 1 << 14
HEADERS_S, WRITE_S = 10.0, 20.0
"""How long a client may take for its headers, and to read."""
ABORT = "fsar.abort"
"""The extension of the scope by which a connection is ended at once."""


Put = Callable[[bytes], Coroutine[Any, Any, None]]


class EventStream(Response):
    """Server-sent events. Who does not read is let go, and comes again with the position that it knows.

    `follow` puts what there is to be sent, until the service ends.
    """

    def __init__(self, first: int, follow: Callable[[Put], Coroutine[Any, Any, None]]) -> None:
        super().__init__(media_type="text/event-stream", headers={"Cache-Control": "no-store"})
        del self.headers["content-length"]
        self._first, self._follow = first, follow

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send what there is until the client goes, the service ends, or nothing can be sent."""

        async def put(body: bytes) -> None:
            await asyncio.wait_for(send({"type": "http.response.body", "body": body, "more_body": True}), WRITE_S)

        async def gone() -> None:
            while (await receive())["type"] != "http.disconnect":
                pass

        await send({"type": "http.response.start", "status": 200, "headers": self.raw_headers})
        await put(b": from %d\n\n" % self._first)
        following = asyncio.create_task(self._follow(put))
        leaving = asyncio.create_task(gone())
        await asyncio.wait((following, leaving), return_when=asyncio.FIRST_COMPLETED)
        for task in (following, leaving):
            task.cancel()
        results = await asyncio.gather(following, leaving, return_exceptions=True)
        if isinstance(results[0], TimeoutError):
            scope["extensions"][ABORT]["call"]()  # a transport that is closed waits until all has been read
        else:
            await send({"type": "http.response.body", "body": b""})


class LimitedProtocol(HttpToolsProtocol):
    """Lets go who does not end its headers, in time or at all."""

    def connection_made(self, transport: Any) -> None:
        """Begin to wait for headers."""
        super().connection_made(transport)
        self._header_bytes = 0
        self._deadline = self.loop.call_later(HEADERS_S, transport.abort)

    def on_message_begin(self) -> None:
        """Begin to wait for headers."""
        super().on_message_begin()
        self.scope["extensions"] = {ABORT: {"call": self.transport.abort}}
        self._header_bytes = 0
        self._deadline.cancel()
        self._deadline = self.loop.call_later(HEADERS_S, self.transport.abort)

    def data_received(self, data: bytes) -> None:
        """Take bytes; of headers, not too many."""
        super().data_received(data)
        if not self._deadline.cancelled():
            self._header_bytes += len(data)
            if self._header_bytes > MAX_HEADERS:
                self.transport.abort()

    def on_headers_complete(self) -> None:
        """Wait for headers no more."""
        self._deadline.cancel()
        super().on_headers_complete()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait for headers no more."""
        self._deadline.cancel()
        super().connection_lost(exc)
