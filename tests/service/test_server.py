"""The service under its clients: what it acknowledged is on disk, and every event can be followed."""

import errno
import os
import socket
import subprocess
import threading
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import msgspec
import pytest

pytest.importorskip("uvicorn", reason="make test-all installs it")

import fsar_ledger
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.runtime.federation import Federation
from fsar_ledger.service import feed
from fsar_ledger.service.client import Client, FollowedEvent, Refused
from tests.service.site import TASK, Site, is_good, read, take_back, until

pytestmark = pytest.mark.slow


def test_robots_open_a_door_and_a_supervisor_sees_it(tmp_path: Path) -> None:
    with Site(tmp_path) as site:
        a, b = site.ways["robot/A1"], site.ways["robot/B1"]
        site.ways["service/hub"].give("SubmitTask", task_id="t", **TASK)
        assert b.give("ReportStart", robot="robot/B1", action_id="t/1.1").rejected is not None
        judged = b.give("JudgeRequest", robot="robot/B1", action_id="t/1.1", accepts=True)
        assert [event["type"] for event in judged.events] == ["RequestAdmitted"]
        for name, fields in (
            ("ReportStart", {"robot": "robot/B1"}),
            ("ReportResult", {"executor": "robot/B1", "result": "success"}),
        ):
            assert b.give(name, action_id="t/1.1", **fields).rejected is None
        assert a.give("SubmitTask", task_id="u", **TASK).rejected is None
        seen = read(site.ways["supervisor/A1"].events(after=-1), len(site.record.events))
        assert [event.seq for event in seen] == list(range(len(seen)))
    [record] = open_ledger(site.ledger).runs()
    assert [event.type for event in seen] == [type(event).__name__ for event in record.events]
    assert b"\n".join(event.row for event in seen) == b"\n".join(open_ledger(site.ledger).rows(0, len(seen)))
    assert is_good(site.ledger)
    assert not [row for row in fsar_ledger.Ledger(site.ledger).audit().rows if row.holds is False]


@pytest.mark.parametrize(
    ("by", "command", "fields"),
    [
        ("robot/A1", "JudgeRequest", {"robot": "robot/B1", "action_id": "t/1.1", "accepts": True}),
        ("service/hub", "JudgeRequest", {"robot": "robot/B1", "action_id": "t/1.1", "accepts": True}),
        ("supervisor/A1", "ReportStart", {"robot": "robot/A1", "action_id": "t/1.1"}),
        (
            "robot/A1",
            "SetTrust",
            {
                "issued_by": "supervisor/A1",
                "robot": "robot/A1",
                "peer": "robot/B1",
                "scope": "persistent",
                "capability": None,
                "context": None,
                "reason": "x",
            },
        ),
        ("robot/B1", "SubmitTask", {"task_id": "u", **TASK}),
        ("supervisor/A1", "RespondToCall", {"supervisor": "supervisor/fleet", "action_id": "t/1.1", "approves": True}),
    ],
)
def test_who_speaks_for_another_is_rejected_on_record_and_changes_nothing(
    site: Site, by: str, command: str, fields: dict[str, Any]
) -> None:
    site.ways["robot/A1"].give("SubmitTask", task_id="t", **TASK)
    answered = site.ways[by].give(command, **fields)
    assert answered.rejected is not None
    assert answered.rejected.startswith(f"{by} speaks for ")
    *_, given, rejected = site.record.events
    assert isinstance(given, CommandGiven)
    assert isinstance(rejected, CommandRejected)
    assert given.issued_by == rejected.issued_by == by


def test_events_are_followed_from_any_place_by_what_they_are_about(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feed, "AT_ONCE", 3)
    site.ways["robot/A1"].give("ReportContext", robot="robot/A1")
    site.service._feed._kept = type(site.service._feed._kept)(maxlen=10)
    for number in range(20):
        site.ways["robot/A1"].give("SubmitTask", task_id=f"t{number}", **TASK)
    record = site.record
    auditor = site.ways["auditor/anna"]
    for after in (-1, 0, 40, len(record.events) - 5):
        seen = read(auditor.events(after=after), len(record.events) - after - 1)
        assert [event.seq for event in seen] == list(range(after + 1, len(record.events)))
        assert [event.type for event in seen] == [type(event).__name__ for event in record.events[after + 1 :]]
    for wanted, fits in (
        ({"task": "t7"}, lambda event: event.columns["task_id"] == "t7"),
        ({"robot": "robot/B1"}, lambda event: b'"robot/B1"' in event.row),
        (
            {"concern": "registry"},
            lambda event: event.type in ("CapabilityInstalled", "CapabilityAdvertised", "RegistryQueried"),
        ),
    ):
        assert all(fits(event) for event in read(auditor.events(after=-1, **wanted), 4))
    assert all(b'"robot/B1"' in event.row for event in read(site.ways["robot/B1"].events(after=-1), 10))


def test_who_follows_a_robot_that_is_none_is_told_which_there_are_unless_it_is_a_robot(site: Site) -> None:
    with pytest.raises(Refused, match="robot 'A1': there is none; expected one of robot/A1, robot/B1, "):
        read(site.ways["auditor/anna"].events(robot="A1"), 1)
    with pytest.raises(Refused, match=r"robot 'A1': there is none$"):
        read(site.ways["robot/A1"].events(robot="A1"), 1)


def test_who_follows_over_a_cut_goes_on_from_the_seq_that_it_was_told(site: Site) -> None:
    hub, anna = site.ways["service/hub"], site.ways["auditor/anna"]
    hub.give("SubmitTask", task_id="t", **TASK)
    federation = site.service._decider._federation
    assert federation is not None
    assert federation.cut() == "day.2"
    given = hub.give("SubmitTask", task_id="u", **TASK)
    seen = read(anna.events(after=-1), given.seq + 1)
    assert [event.seq for event in seen] == list(range(len(seen)))
    assert (seen[-1].type, seen[-1].columns["run_id"]) == ("CommandGiven", "day.2")
    assert read(anna.events(after=seen[-1].seq), 1)[0].type == "TaskArrived"


def test_who_follows_what_the_service_cannot_read_is_told_in_the_end(site: Site) -> None:
    site.ways["robot/A1"].give("SubmitTask", task_id="t", **TASK)
    site.service._feed._kept.clear()
    away = site.ledger.rename(site.ledger.with_name("away"))
    waited: list[float] = []

    def pause(seconds: float) -> None:
        waited.append(seconds)
        assert sum(waited) <= 1

    anna = Client(f"http://127.0.0.1:{site.port}", site.tokens["auditor/anna"], patience_s=1, pause=pause)
    with pytest.raises(Refused, match="the service does not answer"):
        next(anna.events(after=-1))
    away.rename(site.ledger)


def test_who_knows_more_events_than_the_run_has_is_told_that_some_are_lost(site: Site) -> None:
    newest = site.ways["robot/A1"].give("SubmitTask", task_id="t", **TASK).seq
    until(lambda: site.ways["auditor/anna"].known() > newest + 1)
    count = site.ways["auditor/anna"].known()
    with pytest.raises(
        Refused, match=f"after: found {count}, expected at most {count - 1}, .* they are lost: "
    ) as refused:
        next(site.ways["auditor/anna"].events(after=count))
    assert refused.value.status == 400
    assert site.asked("GET", f"/events?after={count - 1}", b"", "auditor/anna").startswith(b"HTTP/1.1 200 ")


def test_new_events_come_as_they_happen(site: Site) -> None:
    events = site.ways["auditor/anna"].events()
    seen: list[FollowedEvent] = []
    thread = threading.Thread(target=lambda: seen.extend(read(events, 4)), daemon=True)
    thread.start()
    until(lambda: b"fsar_subscriptions 1" in site.asked("GET", "/metrics"))
    site.ways["robot/A1"].give("SubmitTask", task_id="t", **TASK)
    thread.join(5)
    assert [event.type for event in seen[:2]] == ["CommandGiven", "TaskArrived"]


def test_who_asks_for_the_head_of_the_events_alone_follows_nothing(site: Site) -> None:
    head = f"HEAD /events HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {site.tokens['auditor/anna']}\r\n\r\n"
    answers = site.raw(f"{head}GET /health HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n".encode())
    assert b"text/event-stream" in answers
    assert b'"status":"ok"' in answers


def test_who_follows_is_told_nothing_more_once_its_token_is_taken_back(site: Site) -> None:
    seen: list[bytes] = []
    thread = threading.Thread(target=lambda: seen.append(site.asked("GET", "/events?after=-1", b"", "auditor/anna")))
    thread.start()
    until(lambda: b"fsar_subscriptions 1" in site.asked("GET", "/metrics"))
    take_back(site, "auditor/anna")
    site.ways["robot/A1"].give("SubmitTask", task_id="t", **TASK)
    thread.join()
    assert seen[0].startswith(b"HTTP/1.1 200 ")
    assert b"TaskArrived" not in seen[0]
    with pytest.raises(Refused, match="found no token of a principal"):
        next(site.ways["auditor/anna"].events(after=-1))
    assert b"fsar_subscriptions 0" in site.asked("GET", "/metrics")


def test_a_command_whose_token_is_taken_back_while_its_body_comes_is_not_taken(site: Site) -> None:
    body = msgspec.json.encode({"task_id": "t", **TASK})
    head = f"POST /commands/SubmitTask HTTP/1.1\r\nHost: x\r\nContent-Length: {len(body)}\r\nConnection: close\r\n"
    with socket.create_connection(("127.0.0.1", site.port)) as line:
        line.sendall(f"{head}Authorization: Bearer {site.tokens['robot/A1']}\r\n\r\n".encode() + body[:9])
        until(lambda: site.service._budgets)
        take_back(site, "robot/A1")
        line.sendall(body[9:])
        assert line.recv(1 << 16).startswith(b"HTTP/1.1 401 ")
    assert site.commands() == []


def test_while_the_principals_cannot_be_read_nobody_is_let_in_and_health_says_why(site: Site) -> None:
    file = site.ledger.with_name("principals")
    kept = file.read_bytes()
    for damage in (lambda: file.write_bytes(kept + b"{"), file.unlink):
        damage()
        for path in ("/overview", "/events"):
            answer = site.asked("GET", path, b"", "auditor/anna")
            assert answer.startswith(b"HTTP/1.1 503 ")
            assert b"no token can be checked" in answer
        assert b"principals" in site.asked("GET", "/health")
        assert b"\nfsar_healthy 0\n" in site.asked("GET", "/metrics")
        with pytest.raises(Refused, match="no token can be checked"):
            site.ways["robot/A1"].give("SubmitTask", task_id="t", **TASK)
    file.write_bytes(kept)
    assert site.ways["robot/A1"].give("SubmitTask", task_id="t", **TASK).rejected is None
    assert b'"status":"ok"' in site.asked("GET", "/health")


def test_the_same_key_from_many_threads_is_decided_once(site: Site) -> None:
    answers: list[Any] = []

    def give() -> None:
        with Client(f"http://127.0.0.1:{site.port}", site.tokens["robot/A1"]) as way:
            answers.append(way.give("SubmitTask", key="k", task_id="t", **TASK).seq)

    threads = [threading.Thread(target=give) for _ in range(20)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(answers) == 20
    assert len(set(answers)) == len(site.commands()) == 1
    with pytest.raises(Refused, match="found another SubmitTask than the SubmitTask at seq") as refused:
        site.ways["robot/A1"].give("SubmitTask", key="k", task_id="u", **TASK)
    assert refused.value.status == 409


def test_on_a_full_disk_commands_are_refused_reads_go_on_and_with_room_again_all_goes_on(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(feed, "REOPEN_S", 0.2)
    a = site.ways["robot/A1"]
    first = a.give("SubmitTask", task_id="t", **TASK)
    with monkeypatch.context() as patch:
        for name in ("write", "pwrite", "writev", "fsync", "fdatasync"):
            patch.setattr(os, name, full)
        answer = site.asked("POST", "/commands/SubmitTask", msgspec.json.encode({"task_id": "u", **TASK}))
        assert answer.startswith(b"HTTP/1.1 503 ")
        assert b"nothing was decided" in answer
        assert site.asked("GET", "/health").startswith(b"HTTP/1.1 503 ")
        assert read(site.ways["auditor/anna"].events(after=first.seq - 1), 1)[0].seq == first.seq
    until(lambda: site.asked("GET", "/health").startswith(b"HTTP/1.1 200 "))
    assert a.give("SubmitTask", key="v", task_id="v", **TASK).rejected is None
    assert [event.parameters.count('"v"') for event in site.commands()][-1] == 1
    seen = read(site.ways["auditor/anna"].events(after=-1), len(site.record.events))
    assert [event.seq for event in seen] == list(range(len(seen)))
    assert is_good(site.ledger)


def test_without_memory_to_decide_or_to_close_nothing_is_decided_and_with_it_again_all_goes_on(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(feed, "REOPEN_S", 0.2)
    with monkeypatch.context() as patch:
        patch.setattr(Federation, "decide_all", refused)
        patch.setattr(Writer, "close", refused)
        answer = site.asked("POST", "/commands/ReportContext", b'{"robot": "robot/A1"}')
        assert answer.startswith(b"HTTP/1.1 503 ")
    assert site.ways["robot/A1"].give("ReportContext", robot="robot/A1").rejected is None
    assert is_good(site.ledger)


def test_a_client_says_that_another_program_answers() -> None:
    class Other(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"<html>welcome</html>")

        do_POST = do_GET

    with ThreadingHTTPServer(("127.0.0.1", 0), Other) as other:
        threading.Thread(target=other.serve_forever, daemon=True).start()
        for ask in (Client.known, partial(Client.give, command="ReportContext", robot="robot/A1")):
            with (
                Client(f"http://127.0.0.1:{other.server_port}", "token", patience_s=0) as client,
                pytest.raises(Refused, match=r"found b'<html>welcome</html>', expected the answer of `fsar-ledger"),
            ):
                ask(client)
        other.shutdown()


def test_when_too_many_wait_more_are_told_to_come_again(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(feed, "WAITING", 0)
    answer = site.asked("POST", "/commands/ReportContext", b'{"robot": "robot/A1"}')
    assert answer.startswith(b"HTTP/1.1 503 ")
    assert b"retry-after: 1" in answer.lower()
    assert not site.commands()


def test_it_serves_over_tls(tmp_path: Path) -> None:
    certificate = tmp_path / "certificate.pem"
    key = certificate.with_suffix(".key")
    made = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 1 -subj /CN=localhost"
    named = ["-addext", "subjectAltName=DNS:localhost", "-keyout", f"{key}", "-out", f"{certificate}"]
    subprocess.run(["openssl", *made.split(), *named], check=True, capture_output=True)
    certificate.write_text(certificate.read_text() + key.read_text())
    with Site(tmp_path, certificate=certificate) as site:
        assert site.ways["robot/A1"].give("ReportContext", robot="robot/A1").rejected is None
        with pytest.raises(Refused, match="does not answer"):
            Client(f"https://localhost:{site.port}", site.tokens["robot/A1"], patience_s=0.1).give("ReportContext")
