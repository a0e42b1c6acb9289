"""The service under attack: each is answered as documented, and changes nothing on record."""

import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

pytest.importorskip("uvicorn", reason="make test-all installs it")

from fsar_ledger.service import feed, server
from tests.service.site import TASK, Site, until

pytestmark = pytest.mark.slow


SAYS = b'{"robot": "robot/A1", "action_id": "t/1.1"}'
START = "/commands/ReportStart"
ATTACKS: dict[str, tuple[int, tuple[Any, ...]]] = {
    "no token": (401, ("POST", START, SAYS, None)),
    "a token that is wrong": (401, ("POST", START, SAYS, "fsar.0.0")),
    "a token with bytes that are no text": (401, ("POST", START, SAYS, "fsar.\xff.\xff")),
    "an auditor that commands": (403, ("POST", START, SAYS, "auditor/anna")),
    "another method": (405, ("GET", START)),
    "another path": (404, ("POST", "/commands", SAYS)),
    "a path that climbs": (404, ("POST", "/commands/../../etc/passwd", SAYS)),
    "a path that climbs in code": (404, ("POST", "/commands/%2e%2e%2f%2e%2e%2fetc%2fpasswd", SAYS)),
    "a path with a zero byte": (404, ("POST", START + "%00", SAYS)),
    "a command that is none": (404, ("POST", "/commands/EndAttempt", SAYS)),
    "a base of commands": (404, ("POST", "/commands/Work", SAYS)),
    "half of JSON": (400, ("POST", START, SAYS[:-1])),
    "JSON that is no object": (400, ("POST", START, b"[]")),
    "nothing": (400, ("POST", START, b"")),
    "bytes that are no UTF-8": (400, ("POST", START, b'{"robot": "\xff"}')),
    "half a surrogate": (400, ("POST", START, b'{"robot": "\\ud800", "action_id": "t"}')),
    "characters that steer a terminal": (400, ("POST", START, b'{"robot": "robot/A1", "action_id": "\\u001b[2J"}')),
    "deep JSON": (400, ("POST", START, b"[" * 60_000)),
    "deep fields": (400, ("POST", START, b'{"robot":' * 6_000)),
    "a number that is none": (400, ("POST", START, b'{"lasts_us": NaN}')),
    "a number beyond all": (400, ("POST", START, b'{"robot": "robot/A1", "action_id": "t", "lasts_us": 1e400}')),
    "a field that the run stamps": (400, ("POST", START, b'{"robot": "robot/A1", "action_id": "t", "now_us": 1}')),
    "a body that is too long": (413, ("POST", START, b" " * (1 << 20))),
    "an empty key": (400, ("POST", START, SAYS, "robot/A1", "Idempotency-Key: ")),
    "a key that is too long": (400, ("POST", START, SAYS, "robot/A1", "Idempotency-Key: " + "k" * 201)),
    "a parameter with a typo": (400, ("GET", "/events?robt=robot/A1")),
    "a place that is none": (400, ("GET", "/events?after=-1e9")),
    "a place beyond numbers": (400, ("GET", "/events?after=" + "9" * 40)),
    "a concern that is none": (400, ("GET", "/events?concern=polcy")),
    "a robot that is none": (400, ("GET", "/events?robot=robot/A9")),
    "events without a token": (401, ("GET", "/events", b"", None)),
}


@pytest.fixture(scope="module")
def attacked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with Site(tmp_path_factory.mktemp("site")) as one:
        one.ways["robot/A1"].give("SubmitTask", task_id="t", **TASK)
        yield one


@pytest.mark.parametrize("attack", ATTACKS)
def test_an_attack_is_answered_as_documented_and_leaves_no_trace(attacked: Site, attack: str) -> None:
    status, request = ATTACKS[attack]
    before = attacked.commands()  # tasks become due by themselves
    answer = attacked.asked(*request)
    assert answer.startswith(b"HTTP/1.1 %d " % status), answer[:200]
    if not answer.startswith(b"HTTP/1.1 400 ") or b"application/json" in answer:  # 400 may be of what is no HTTP
        assert msgspec.json.decode(answer.partition(b"\r\n\r\n")[2])["error"]
    assert attacked.commands() == before
    assert attacked.ways["robot/A1"].give("ReportContext", robot="robot/A1").rejected is None


@pytest.mark.parametrize(
    "data",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET / HTTP/9.9\r\n\r\n",
        b"POST /commands/ReportStart HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\nContent-Length: 6\r\n\r\n",
        b"POST /commands/ReportStart HTTP/1.1\r\nHost: x\r\nContent-Length: -5\r\n\r\n",
        b"POST /commands/ReportStart HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"GET /health HTTP/1.1\r\nHost: x\r\nX: " + b"x" * 300_000 + b"\r\n\r\n",
    ],
    ids=["TLS", "a version", "two lengths", "a negative length", "two ways of length", "headers without end"],
)
def test_what_is_no_request_is_let_go(attacked: Site, data: bytes) -> None:
    before = len(attacked.commands())
    assert attacked.raw(data)[:12] in (b"", b"HTTP/1.1 400")
    assert attacked.ways["robot/A1"].give("ReportContext", robot="robot/A1").rejected is None
    assert len(attacked.commands()) == before + 1


@pytest.mark.parametrize(
    ("limit", "sent"),
    [
        ("HEADERS_S", b"POST /commands/ReportStart HTTP/1.1\r\nHost"),
        ("HEADERS_S", b""),
        (
            "BODY_S",
            b"POST /commands/ReportStart HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer %s\r\nContent-Length: 9\r\n\r\n{",
        ),
    ],
    ids=["headers", "nothing", "body"],
)
def test_a_client_that_is_slow_is_let_go(site: Site, monkeypatch: pytest.MonkeyPatch, limit: str, sent: bytes) -> None:
    monkeypatch.setattr(server if limit == "BODY_S" else feed, limit, 0.3)
    began = time.monotonic()
    answer = site.raw(sent % site.tokens["robot/A1"].encode() if b"%s" in sent else sent, wait_s=10)
    assert answer[:12] in (b"", b"HTTP/1.1 408")
    assert time.monotonic() - began < 5
    assert not site.commands()


HEALTH = b"GET /health HTTP/1.1\r\nHost: x\r\n"


@pytest.mark.parametrize("request_", [HEALTH + b"\r\n", HEALTH + b"Content-Length: 99\r\n\r\n"], ids=["lines", "body"])
def test_what_is_no_request_keeps_no_connection_open(
    site: Site, monkeypatch: pytest.MonkeyPatch, request_: bytes
) -> None:
    monkeypatch.setattr(feed, "IDLE_S", 0.5)
    with socket.create_connection(("127.0.0.1", site.port)) as line:
        line.settimeout(5)
        line.sendall(request_)
        assert line.recv(1 << 16).startswith(b"HTTP/1.1 200")
        line.sendall(b"\r\n")
        while line.recv(1 << 16):
            pass


def test_who_does_not_read_answers_is_let_go(
    site: Site, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(feed, "WRITE_S", 0.5)
    with socket.socket() as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        line.connect(("127.0.0.1", site.port))
        line.settimeout(0.05)
        end = time.monotonic() + 30
        with suppress(ConnectionError):
            while time.monotonic() < end:
                with suppress(TimeoutError):
                    line.sendall(b"GET /openapi.json HTTP/1.1\r\nHost: x\r\n\r\n")
                time.sleep(0.002)
        assert time.monotonic() < end
    assert "Traceback" not in capfd.readouterr().err


def test_who_subscribes_and_does_not_read_is_let_go_and_holds_nobody_up(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed, "WRITE_S", 0.5)
    line = socket.socket()
    line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    line.connect(("127.0.0.1", site.port))
    token = site.tokens["auditor/anna"].encode()
    line.sendall(b"GET /events?after=0 HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer " + token + b"\r\n\r\n")
    until(lambda: b"fsar_subscriptions 1" in site.asked("GET", "/metrics"))
    a, number = site.ways["robot/A1"], 0
    while b"fsar_subscriptions 0" not in site.asked("GET", "/metrics"):
        for _ in range(200):
            number += 1
            assert a.give("SubmitTask", task_id=f"{'long' * 40}{number}", **TASK).rejected is None
        assert number < 20_000
    line.close()


def test_a_flood_of_subscriptions_is_refused_and_others_go_on(site: Site) -> None:
    with ExitStack() as lines:
        for _ in range(server.MAX_OWN_SUBSCRIPTIONS):
            line = lines.enter_context(socket.create_connection(("127.0.0.1", site.port)))
            token = site.tokens["robot/A1"].encode()
            line.sendall(b"GET /events HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer " + token + b"\r\n\r\n")
            assert line.recv(1 << 16)
        until(lambda: b"fsar_subscriptions 8" in site.asked("GET", "/metrics"))
        assert site.asked("GET", "/events").startswith(b"HTTP/1.1 503 ")
        events = site.ways["robot/B1"].events(after=0, robot="robot/B1")
        assert next(events).columns["robot"] == "robot/B1"
    until(lambda: b"fsar_subscriptions 1" in site.asked("GET", "/metrics"))


def test_who_gives_too_many_commands_waits_and_others_do_not(tmp_path: Path) -> None:
    with Site(tmp_path, rate=5) as site:
        statuses = [site.asked("POST", "/commands/ReportContext", b'{"robot": "robot/A1"}')[9:12] for _ in range(20)]
        assert statuses.count(b"429") > 5
        assert statuses[0] == b"200"
        assert site.ways["robot/B1"].give("ReportContext", robot="robot/B1").rejected is None
        assert site.ways["robot/A1"].give("ReportContext", robot="robot/A1").rejected is None  # which waits
