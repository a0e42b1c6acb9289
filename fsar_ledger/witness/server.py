"""The service of a witness, and its HTTP/1.1 server.

The service judges, stores and cosigns checkpoints, one request per log at a time. The server handles one POST and one
GET endpoint, with limits on size, number and time of requests.
"""

import io
import socket
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import IPv4Address, IPv6Network, ip_address
from socketserver import TCPServer
from threading import Lock
from typing import Any

from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.ledger.log.note import Note, VerifierKey
from fsar_ledger.witness.state import State

from . import ADD_CHECKPOINT, MAX_BODY_BYTES, SIZE, Answer, judge, origin_hash, parse_request

Clock = Callable[[], int]
"""A function that returns the time in seconds since 1970."""


class Service:
    """A witness's request handling, independent of the transport.

    Args:
        state: Its key and the checkpoints that it cosigned.
        logs: The keys of the logs that it watches; the name of a key is the origin of its log.
        clock: Returns the current time.
        tell: Called with a line for the operator about each checkpoint of a watched log that was cosigned or refused.

    Raises: LedgerCorrupted if the stored note of a log lacks its signature, or has a damaged one.
    """

    def __init__(self, state: State, logs: Sequence[VerifierKey], clock: Clock, tell: Callable[[str], None]) -> None:
        state.require_signed(logs)
        self.tell = tell
        self._state, self._logs, self._clock = state, tuple(logs), clock
        self._origins = {origin_hash(key.name): key.name for key in logs}
        self._locks = {origin: Lock() for origin in self._origins.values()}

    def add_checkpoint(self, body: bytes) -> Answer:
        """Store and cosign the checkpoint in this request, or respond with why not."""
        try:
            request = parse_request(body)
        except ValueError as error:
            return Answer(HTTPStatus.BAD_REQUEST, f"{error}\n")
        origin = request.note.checkpoint.origin
        lock = self._locks.get(origin)
        if lock is None:
            return Answer(HTTPStatus.NOT_FOUND, "unknown log\n")
        with lock:
            newest = self._state.newest(origin)
            judged = judge(request, self._logs, newest.checkpoint if newest is not None else None)
            answer = judged if isinstance(judged, Answer) else self._cosign(judged)
        size, reason = request.note.checkpoint.size, answer.text.strip()
        if answer.media == SIZE:  # the log learns what to begin with, and comes again unless it has gone back
            reason = f"{int(reason):,} were cosigned before" if size < int(reason) else ""
        if answer.status == HTTPStatus.OK:
            self.tell(f"{origin}: {size:,} events: cosigned")
        elif answer.status != HTTPStatus.FORBIDDEN and reason:  # anyone can send what the log did not sign
            self.tell(f"{origin}: {size:,} events: refused ({reason})")
        return answer

    def newest(self, name: str) -> Answer:
        """Return the newest checkpoint of the log of this name (see `origin_hash`), with a new cosignature."""
        origin = self._origins.get(name)
        if origin is None:
            return Answer(HTTPStatus.NOT_FOUND, "unknown log\n")
        with self._locks[origin]:
            note = self._state.newest(origin)
            if note is None:
                return Answer(HTTPStatus.NOT_FOUND, "no checkpoint of this log was cosigned yet\n")
            signed = tuple(each for each in note.signatures if each.key != self._state.cosigner.key.key)
            cosignature = self._state.cosigner.cosign(note.checkpoint, self._clock())
        return Answer(HTTPStatus.OK, str(Note(note.checkpoint, (*signed, cosignature))))

    def _cosign(self, note: Note) -> Answer:
        cosignature = self._state.cosigner.cosign(note.checkpoint, self._clock())
        try:
            self._state.remember(Note(note.checkpoint, (*note.signatures, cosignature)))
        except WriteFailed as error:
            self.tell(str(error))
            return Answer(HTTPStatus.SERVICE_UNAVAILABLE, "the checkpoint could not be stored; nothing was cosigned\n")
        return Answer(HTTPStatus.OK, cosignature.line())


REQUEST_S = 10.0
"""Seconds within which a request must arrive, from the start of its connection or from the previous response."""

MAX_CONNECTIONS, MAX_OF_CLIENT = 64, 8
"""Simultaneous connections: of all clients, and of one. So no single client can keep others out by idling."""

_NETWORK_BITS = 64
_NAME_CHARACTERS = 64
_LENGTH_DIGITS = 7
_BUSY_S = 0.1
_BUSY = b"HTTP/1.1 503 Service Unavailable\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def client_of(host: str) -> str:
    """Return the client at this address; for IPv6 its network, since one client has all addresses in it."""
    address = ip_address(host.partition("%")[0])
    if isinstance(address, IPv4Address):
        return f"{address}"
    return f"{address.ipv4_mapped or IPv6Network((address, _NETWORK_BITS), strict=False)}"


class _Room:
    """A limit on simultaneous connections, in total and per client."""

    def __init__(self) -> None:
        self._held: Counter[str] = Counter()
        self._lock = Lock()

    def take(self, client: str) -> bool:
        """Reserve a connection for this client; return whether one was free."""
        with self._lock:
            is_free = self._held.total() < MAX_CONNECTIONS and self._held[client] < MAX_OF_CLIENT
            self._held[client] += is_free
            return is_free

    def leave(self, client: str) -> None:
        """Release a connection of this client."""
        with self._lock:
            self._held[client] -= 1
            self._held += Counter()  # drops clients without connections


class _DeadlineReader(io.RawIOBase):
    """A reader of a socket with one deadline for the whole request, however slowly it arrives."""

    def __init__(self, connection: socket.socket, monotonic: Callable[[], float]) -> None:
        self._connection, self._monotonic = connection, monotonic
        self.begin()

    def begin(self) -> None:
        """Start the deadline of the next request."""
        self._deadline = self._monotonic() + REQUEST_S

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left = self._deadline - self._monotonic()
        if left <= 0:
            raise TimeoutError
        self._connection.settimeout(left)
        return self._connection.recv_into(buffer)


class _Handler(BaseHTTPRequestHandler):
    """The handler of one connection."""

    protocol_version = "HTTP/1.1"
    server: "WitnessServer"

    def setup(self) -> None:
        super().setup()
        self.rfile.close()
        self._reader = _DeadlineReader(self.connection, self.server.monotonic)
        self.rfile = io.BufferedReader(self._reader)

    def handle_one_request(self) -> None:
        self._reader.begin()
        self.close_connection = True  # if anything fails before the request is parsed
        try:
            super().handle_one_request()
        except (ConnectionError, TimeoutError):
            self.close_connection = True

    def do_GET(self) -> None:
        """Respond with the newest checkpoint of a log."""
        name = self.path.removeprefix("/").removesuffix("/checkpoint")
        is_name = len(name) == _NAME_CHARACTERS and self.path == f"/{name}/checkpoint"
        if self.headers.get("Content-Length", "0") != "0" or "Transfer-Encoding" in self.headers:
            self.close_connection = True  # what follows is not a request
        self._send(self.server.service.newest(name) if is_name else Answer(HTTPStatus.NOT_FOUND, "nothing is here\n"))

    def do_POST(self) -> None:
        """Respond with the cosignature of a checkpoint."""
        lengths = self.headers.get_all("Content-Length", [])
        is_length = (
            len(lengths) == 1 and lengths[0].isascii() and lengths[0].isdecimal() and len(lengths[0]) <= _LENGTH_DIGITS
        )
        if "Transfer-Encoding" in self.headers or not lengths:
            self._refuse(HTTPStatus.LENGTH_REQUIRED, "the request must state its length\n")
        elif not is_length:
            self._refuse(HTTPStatus.BAD_REQUEST, "the length of the request is not a number, or too large\n")
        elif int(lengths[0]) > MAX_BODY_BYTES:
            self._refuse(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, f"a request may have at most {MAX_BODY_BYTES} bytes\n")
        else:
            self._answer(int(lengths[0]))

    def _answer(self, length: int) -> None:
        if self.headers.get("Expect", "").lower() == "100-continue":
            self.wfile.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        body = self.rfile.read(length)
        if len(body) < length:
            self.close_connection = True
        elif self.path != ADD_CHECKPOINT:
            self._send(Answer(HTTPStatus.NOT_FOUND, "nothing is here\n"))
        else:
            self._send(self.server.service.add_checkpoint(body))

    def handle_expect_100(self) -> bool:
        """Delay `100 Continue` until the length of the body has been checked."""
        return True

    def _refuse(self, status: HTTPStatus, text: str) -> None:
        self.close_connection = True
        self._send(Answer(status, text))

    def _send(self, answer: Answer) -> None:
        data = answer.text.encode()
        self.connection.settimeout(REQUEST_S)
        self.send_response_only(answer.status)
        self.send_header("Content-Type", answer.media)
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:  # noqa: ARG002
        """Respond to requests that `http.server` refuses with one line that repeats nothing of the request."""
        self.close_connection = True
        if getattr(self, "request_version", "HTTP/0.9") == "HTTP/0.9":  # not an HTTP/1 request: respond as HTTP/1
            self.request_version = self.protocol_version
        self._send(Answer(code, f"{HTTPStatus(code).phrase.lower()}\n"))

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the service reports what matters, and strangers must not fill a log."""


class WitnessServer(ThreadingHTTPServer):
    """The listening server of a witness, with one thread per connection.

    Raises:
        UsageError: It cannot listen at this address.
    """

    daemon_threads = True  # safe to stop at any moment: a checkpoint is stored whole or not at all
    block_on_close = False
    request_queue_size = 64

    def __init__(self, host: str, port: int, service: Service, monotonic: Callable[[], float]) -> None:
        self.service, self.monotonic = service, monotonic
        self._room = _Room()
        try:
            self.address_family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0][0]
            super().__init__((host, port), _Handler)
        except (OSError, OverflowError, UnicodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "no such address"
            raise UsageError(
                f"--host {host} --port {port}: found no way to listen there ({reason}), "
                "expected an address of this machine and a free port"
            ) from error

    @property
    def url(self) -> str:
        """Return the URL at which it listens."""
        host, port = self.server_address[:2]
        return f"http://[{host!s}]:{port}" if ":" in str(host) else f"http://{host!s}:{port}"

    def server_bind(self) -> None:
        """Bind the socket without a DNS lookup of the host."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), int(self.server_address[1])

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start a thread for the connection, or respond 503 if the total or this client's limit is reached."""
        client = client_of(client_address[0])
        if not self._room.take(client):
            with suppress(OSError):
                request.settimeout(_BUSY_S)
                request.sendall(_BUSY)
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread was started, so none will release the connection
            self._room.leave(client)
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve the connection until it ends."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._room.leave(client_of(client_address[0]))

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002
        """Report the error to the operator, unless the connection merely broke."""
        error = sys.exc_info()[1]
        if not isinstance(error, OSError):
            self.service.tell(f"a request was not answered: {type(error).__name__}")
