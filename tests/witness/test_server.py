import errno
import random
import socket
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from http.client import HTTPConnection

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.witness import MAX_BODY_BYTES, checkpoint_path
from fsar_ledger.witness import server as module
from fsar_ledger.witness.server import WitnessServer
from tests.witness.conftest import ORIGIN, Log, Open, serving

GROWING = Log(30)
BODY = str(GROWING.request(0, 5)).encode()


@pytest.fixture
def server(witness: Open) -> Iterator[WitnessServer]:
    with serving(witness.service) as found:
        yield found


def connected(server: WitnessServer, client: int = 1) -> socket.socket:
    """Connect as this client, each of which has an address of its own."""
    return socket.create_connection(
        ("127.0.0.1", server.server_port), timeout=5, source_address=(f"127.0.0.{client}", 0)
    )


def raw(server: WitnessServer, data: bytes, client: int = 1) -> bytes:
    """Send the bytes over one connection and return everything that comes back."""
    with connected(server, client) as connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        return b"".join(iter(lambda: connection.recv(1 << 16), b""))


def post(body: bytes = BODY, path: str = "/add-checkpoint", length: object = None, *headers: str) -> bytes:
    lines = [
        f"POST {path} HTTP/1.1",
        "Host: w",
        f"Content-Length: {len(body) if length is None else length}",
        *headers,
        "",
        "",
    ]
    return "\r\n".join(lines).encode() + body


def test_a_connection_may_ask_many_things_one_after_the_other(server: WitnessServer, witness: Open) -> None:
    connection = HTTPConnection("127.0.0.1", server.server_port, timeout=5)
    for old, new in ((0, 5), (5, 9), (9, 9)):
        connection.request("POST", "/add-checkpoint", str(GROWING.request(old, new)).encode())
        response = connection.getresponse()
        line = response.read().decode()
        assert (response.status, response.headers["Content-Type"], response.version) == (
            200,
            "text/plain; charset=utf-8",
            11,
        )
        assert line.startswith("— example.org/w1 ")
    connection.request("GET", checkpoint_path(ORIGIN))
    response = connection.getresponse()
    assert (response.status, response.read().decode().split("\n")[1]) == (200, "9")
    connection.request("POST", "/add-checkpoint", BODY)
    response = connection.getresponse()
    assert (response.status, response.headers["Content-Type"], response.read()) == (409, "text/x.tlog.size", b"9\n")
    connection.close()
    assert "Server" not in response.headers


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (post(), 200),
        (post(path="/"), 404),
        (post(path="/add-checkpoint/"), 404),
        (post(path="/add-checkpoint?x"), 404),
        (post(b""), 400),
        (post(b"x" * MAX_BODY_BYTES), 400),
        (post(b"", length=MAX_BODY_BYTES + 1), 413),
        (post(length=10**6), 413),
        (post(length="9" * 5000), 400),
        (post(length="-1"), 400),
        (post(length="+5"), 400),
        (post(length="5_0"), 400),
        (post(length=""), 400),
        (post(length="\xb2"), 400),
        (post(BODY, "/add-checkpoint", None, "Content-Length: 5"), 400),
        (post(BODY, "/add-checkpoint", None, "Transfer-Encoding: chunked"), 411),
        (b"POST /add-checkpoint HTTP/1.1\r\nHost: w\r\n\r\n", 411),
        (b"GET / HTTP/1.1\r\n\r\n", 404),
        (b"GET /" + b"a" * 64 + b"/checkpoint HTTP/1.1\r\n\r\n", 404),
        (b"GET /../../etc/passwd HTTP/1.1\r\n\r\n", 404),
        (b"GET //checkpoint HTTP/1.1\r\n\r\n", 404),
        (b"GET " + checkpoint_path(ORIGIN).upper().encode() + b" HTTP/1.1\r\n\r\n", 404),
        (b"HEAD / HTTP/1.1\r\n\r\n", 501),
        (b"PUT /add-checkpoint HTTP/1.1\r\n\r\n", 501),
        (b"\x1b[31m / HTTP/1.1\r\n\r\n", 501),
        (b"POST\r\n\r\n", 400),
        (b"POST / HTTP/9.9\r\n\r\n", 505),
        (b"POST / HTTP/x\r\n\r\n", 400),
        (b"POST /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n", 414),
        (b"GET / HTTP/1.1\r\n" + b"a: b\r\n" * 200 + b"\r\n", 431),
        (b"GET / HTTP/1.1\r\na: " + b"b" * 70_000 + b"\r\n\r\n", 431),
    ],
)
def test_each_request_has_its_status_and_a_short_clean_answer(
    server: WitnessServer, request_: bytes, status: int
) -> None:
    answer = raw(server, request_)
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.split(b" ")[:2] == [b"HTTP/1.1", str(status).encode()]
    assert len(answer) < 700
    assert b"\x1b" not in answer
    assert b"Traceback" not in answer
    if status != 501 or not request_.startswith(b"HEAD"):
        assert body.decode().endswith("\n")
    assert raw(server, b"GET / HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 404")  # it goes on


def test_an_answer_that_could_be_taken_for_a_second_request_ends_the_connection(server: WitnessServer) -> None:
    smuggled = b"GET " + checkpoint_path(ORIGIN).encode() + b" HTTP/1.1\r\nContent-Length: 50\r\n\r\n" + post()
    assert raw(server, smuggled).count(b"HTTP/1.1 ") == 1
    assert (
        raw(server, post(b"", "/add-checkpoint", None, "Transfer-Encoding: chunked") + post()).count(b"HTTP/1.1 ") == 1
    )


def test_a_body_that_ends_early_is_no_request(server: WitnessServer, witness: Open) -> None:
    assert raw(server, post(length=len(BODY) + 1)) == b""
    assert witness.told == []


def test_a_client_that_waits_for_100_continue_is_answered(server: WitnessServer) -> None:
    answer = raw(server, post(BODY, "/add-checkpoint", None, "Expect: 100-continue"))
    assert answer.startswith(b"HTTP/1.1 100 Continue\r\n\r\nHTTP/1.1 200")
    assert raw(server, post(b"", "/add-checkpoint", 10**6, "Expect: 100-continue")).startswith(b"HTTP/1.1 413")


@pytest.mark.slow
def test_a_slow_client_is_dropped_however_steadily_it_sends(
    server: WitnessServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "REQUEST_S", 0.4)
    for beginning in (b"", post()[:20], post()[:-5]):
        began = time.monotonic()
        with connected(server) as connection:
            connection.sendall(beginning)
            connection.settimeout(0.05)
            for _ in range(60):
                try:
                    if connection.recv(100) == b"":
                        break
                except TimeoutError:
                    connection.send(b"x" if beginning else b"\r\n")
                except ConnectionError:
                    break
            else:
                raise AssertionError("the connection is still open")
        assert time.monotonic() - began < 3


def test_connections_beyond_the_limit_are_refused_and_earlier_ones_served(
    server: WitnessServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "REQUEST_S", 2.0)
    held = [connected(server, 2 + at // module.MAX_OF_CLIENT) for at in range(module.MAX_CONNECTIONS)]
    try:
        assert raw_or_reset(server, b"").startswith((b"HTTP/1.1 503", b"reset"))
        held[0].sendall(b"GET / HTTP/1.1\r\nConnection: close\r\n\r\n")
        assert held[0].recv(1000).startswith(b"HTTP/1.1 404")
    finally:
        for connection in held:
            connection.close()
    deadline = time.monotonic() + 5
    while not raw_or_reset(server, b"GET / HTTP/1.1\r\n\r\n").startswith(b"HTTP/1.1 404"):
        assert time.monotonic() < deadline, "no room was made"


@pytest.mark.parametrize("client", [1, 200])
def test_a_client_that_says_nothing_keeps_nobody_out(server: WitnessServer, client: int) -> None:
    held = [connected(server, 2) for _ in range(module.MAX_CONNECTIONS)]
    try:
        assert raw_or_reset(server, b"", 2).startswith((b"HTTP/1.1 503", b"reset"))
        assert raw_or_reset(server, post(), client).startswith(b"HTTP/1.1 200")
    finally:
        for connection in held:
            connection.close()
    deadline = time.monotonic() + 5
    while not raw_or_reset(server, b"GET / HTTP/1.1\r\n\r\n", 2).startswith(b"HTTP/1.1 404"):
        assert time.monotonic() < deadline, "no room was made"


@pytest.mark.parametrize(
    ("one", "other", "is_same"),
    [
        ("192.0.2.1", "192.0.2.1", True),
        ("192.0.2.1", "192.0.2.2", False),
        ("::ffff:192.0.2.1", "192.0.2.1", True),
        ("::ffff:192.0.2.1", "::ffff:192.0.2.2", False),
        ("2001:db8::1", "2001:db8::2:3", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("fe80::1%eth0", "fe80::2%eth0", True),
    ],
)
def test_a_client_is_an_address_or_a_network_of_the_newer_protocol(one: str, other: str, is_same: bool) -> None:
    assert (module.client_of(one) == module.client_of(other)) == is_same


def raw_or_reset(server: WitnessServer, data: bytes, client: int = 1) -> bytes:
    try:
        return raw(server, data, client)
    except OSError as error:
        if isinstance(error, ConnectionError) or error.errno == errno.ENOTCONN:  # by then it was reset
            return b"reset"
        raise


def test_500_malformed_requests_leave_the_witness_as_it_was(server: WitnessServer, witness: Open) -> None:
    draw = random.Random(4)
    assert raw(server, post()).startswith(b"HTTP/1.1 200")
    told = list(witness.told)
    good = post(str(GROWING.request(5, 9)).encode())

    def one(seed: int) -> bytes:
        change = random.Random(seed)
        data = bytearray(good)
        for _ in range(change.randrange(1, 5)):
            at = change.randrange(len(data))
            if change.random() < 0.5:
                data[at] = change.randrange(256)
            else:
                del data[at : at + change.randrange(1, 30)]
        return raw_or_reset(server, bytes(data)) if bytes(data) != good else b""

    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(one, (draw.randrange(1 << 40) for _ in range(500))))
    statuses = {answer[9:12] for answer in answers}
    assert statuses <= {b"", b"400", b"403", b"404", b"409", b"411", b"413", b"422", b"431", b"501", b"505", b"200"}
    assert len(statuses) >= 5
    assert all(answer.startswith((b"HTTP/1.1 ", b"reset")) or not answer for answer in answers)
    now = witness.state.newest(ORIGIN)
    assert now is not None
    # A changed header may leave a good request behind.
    assert now.checkpoint in (GROWING.checkpoint(5), GROWING.checkpoint(9))
    assert not [line for line in witness.told[len(told) :] if "not answered" in line]


def test_a_fault_of_the_witness_itself_is_told_to_its_operator_alone(
    server: WitnessServer, witness: Open, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(body: bytes) -> None:
        raise RuntimeError("secret")

    monkeypatch.setattr(witness.service, "add_checkpoint", fail)
    assert raw_or_reset(server, post()) in (b"", b"reset")
    assert witness.told == ["a request was not answered: RuntimeError"]


@pytest.mark.parametrize(("host", "port"), [("192.0.2.1", 0), ("no such host", 0), ("127.0.0.1", 1 << 20), ("", -1)])
def test_an_address_where_it_cannot_listen_is_a_usage_error(witness: Open, host: str, port: int) -> None:
    with pytest.raises(UsageError, match="found no way to listen there"):
        WitnessServer(host, port, witness.service, time.monotonic)


def test_a_port_that_is_taken_is_a_usage_error(server: WitnessServer, witness: Open) -> None:
    with pytest.raises(UsageError, match="already in use"):
        WitnessServer("127.0.0.1", server.server_port, witness.service, time.monotonic)


def test_it_listens_by_the_newer_protocol_too(witness: Open) -> None:
    if not socket.has_ipv6:
        pytest.skip("no IPv6 here")
    try:
        with WitnessServer("::1", 0, witness.service, time.monotonic) as found:
            assert found.url.startswith("http://[::1]:")
    except UsageError:
        pytest.skip("no IPv6 address here")
