"""The service as a process that is told to end, and killed."""

import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pytest

import fsar_ledger
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.service import add_principal
from fsar_ledger.service.client import Client, Refused
from tests.service.site import TASK, is_good, until
from tests.witness.processes import honest

pytestmark = pytest.mark.slow


class Process:
    """The command `serve`, as a process."""

    def __init__(self, folder: Path, port: int, *options: object) -> None:
        self.ledger = folder / "ledger"
        served = (self.ledger, "--principals", folder / "principals", "--port", port, "--rate", 10_000, *options)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "fsar_ledger", "serve", *map(str, served)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()

    def end(self, how: signal.Signals) -> tuple[int, str]:
        self.process.send_signal(how)
        said = self.process.communicate(timeout=30)[1]
        return self.process.returncode, said


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
def test_it_ends_when_it_is_told_with_the_ledger_closed(tmp_path: Path, how: signal.Signals) -> None:
    token = add_principal(tmp_path / "principals", "robot/A1")
    one = Process(tmp_path, 0)
    with Client(one.url, token) as way:
        way.give("SubmitTask", task_id="t", **TASK)
        events = way.events(after=0)
        next(events)
        code, said = one.end(how)
    assert (code, said) == (0, "fsar-ledger: ended: every decision that was answered is on disk\n")
    assert is_good(one.ledger)


def test_no_address_is_told_of_a_federation_that_is_refused(tmp_path: Path) -> None:
    add_principal(tmp_path / "principals", "robot/A1")
    one = Process(tmp_path, 0, "--robots", 7)
    said = one.process.communicate(timeout=30)[1]
    assert (one.process.returncode, one.url) == (2, "")
    assert said == "fsar-ledger: robots: found 7, expected a multiple of 4, the robots of a team\n"


def test_in_a_ledger_that_was_removed_nothing_is_decided_until_it_is_restored(tmp_path: Path) -> None:
    token = add_principal(tmp_path / "principals", "robot/A1")
    one = Process(tmp_path, 0)
    with Client(one.url, token, patience_s=0) as way:
        way.give("SubmitTask", task_id="t", **TASK)
        shutil.copytree(one.ledger, tmp_path / "backup")
        shutil.rmtree(one.ledger)
        for _ in range(2):
            with pytest.raises(Refused, match="the ledger was removed while it was"):
                way.give("ReportContext", robot="robot/A1")
        assert not one.ledger.exists()
        (tmp_path / "backup").rename(one.ledger)
    with Client(one.url, token) as way:
        way.give("ReportContext", robot="robot/A1")
    one.end(signal.SIGTERM)
    assert is_good(one.ledger)


def _has(found: list[str], more_than: int) -> bool:
    return len(found) > more_than


def _killed(tmp_path: Path, kills: int) -> None:
    """Kill the service so often under load; what was acknowledged is on record, once."""
    tokens = {name: add_principal(tmp_path / "principals", name) for name in ("robot/A1", "robot/B1", "robot/C1")}
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    acknowledged: list[str] = []
    is_over = threading.Event()

    def load(name: str) -> None:
        with Client(f"http://127.0.0.1:{port}", tokens[name], patience_s=60) as way:
            number = 0
            while not is_over.is_set():
                number += 1
                key = f"{name}:{number}"
                assert way.give("ReportContext", key=key, robot=name).rejected is None
                acknowledged.append(key)

    threads = [threading.Thread(target=load, args=(name,), daemon=True) for name in tokens]
    for number in range(kills):
        one = Process(tmp_path, port)
        if not number:
            for thread in threads:
                thread.start()
        enough = len(acknowledged) + 10
        until(partial(_has, acknowledged, enough), 60)
        time.sleep(0.37 * (number % 5) / 5)
        one.end(signal.SIGKILL)
    one = Process(tmp_path, port)
    is_over.set()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()
    assert one.end(signal.SIGTERM)[0] == 0
    [record] = open_ledger(one.ledger).runs()
    keys = [event.key for event in record.events if isinstance(event, CommandGiven)]
    assert len(keys) == len(set(keys))
    assert set(acknowledged) <= set(keys)
    assert len(acknowledged) > 10 * kills
    assert is_good(one.ledger)


def test_what_was_acknowledged_is_on_record_once_after_any_kill(tmp_path: Path) -> None:
    _killed(tmp_path, 5)


@pytest.mark.soak
def test_a_hundred_kills_lose_nothing(tmp_path: Path) -> None:
    _killed(tmp_path, 100)


def test_witnesses_are_asked_while_it_serves(tmp_path: Path) -> None:
    token = add_principal(tmp_path / "principals", "robot/A1")
    key, policy = tmp_path / "fleet.key", tmp_path / "policy"
    fsar_ledger.key_new(key, name="example.org/fleet")
    fsar_ledger.witness_new(tmp_path / "w1", name="example.org/w1")
    with honest(tmp_path / "w1", [f"{key}.pub"]) as witness:
        log = Path(f"{key}.pub").read_text().strip()
        policy.write_text(f"log {log}\n{witness.line('w1')}group enough 1 w1\nquorum enough\n")
        one = Process(tmp_path, 0, "--key", key, "--policy", policy, "--witness-every", 1)
        with Client(one.url, token) as way:
            way.give("SubmitTask", task_id="t", **TASK)
            until((tmp_path / "ledger.cosigned").exists)
            code, _ = one.end(signal.SIGTERM)
    assert code == 0
    kept = [tmp_path / "ledger.cosigned"]
    verified = fsar_ledger.Ledger(one.ledger).verify(witness_policy=policy, cosigned=kept, now_s=int(time.time()))
    assert verified.exit_code == 0


def test_a_policy_that_cannot_be_read_is_told_before_anything_begins(tmp_path: Path) -> None:
    add_principal(tmp_path / "principals", "robot/A1")
    one = Process(tmp_path, 0, "--policy", tmp_path / "none")
    _, said = one.process.communicate(timeout=30)
    assert (one.process.returncode, "none" in said) == (2, True)
    assert not one.ledger.exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ("--certificate", "none"),
            "--certificate none: No such file or directory, expected a certificate and its key",
        ),
        (
            ("--certificate", "principals"),
            "--certificate principals: found no such PEM, expected a certificate and its",
        ),
        (("--certificate-key", "principals"), "found no certificate for it, expected --certificate"),
    ],
)
def test_a_certificate_that_cannot_be_used_is_told_before_anything_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    add_principal(tmp_path / "principals", "robot/A1")
    one = Process(tmp_path, 0, *options)
    _, told = one.process.communicate(timeout=30)
    assert (one.process.returncode, told.count("\n")) == (2, 1)
    assert said in told
    assert not one.ledger.exists()


def test_the_address_is_told_once_however_often_the_disk_refuses(tmp_path: Path) -> None:
    token = add_principal(tmp_path / "principals", "robot/A1")
    one = Process(tmp_path, 0)
    unlimited = resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE)
    with Client(one.url, token, patience_s=0) as hasty, Client(one.url, token) as patient:
        for _ in range(2):
            assert patient.known()  # once the federation is open again
            resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE, (1, unlimited[1]))
            with pytest.raises(Refused, match="nothing was decided"):
                hasty.give("SubmitTask", task_id="t", **TASK)
            resource.prlimit(one.process.pid, resource.RLIMIT_FSIZE, unlimited)
        assert patient.give("SubmitTask", task_id="t", **TASK).rejected is None
    one.process.send_signal(signal.SIGTERM)
    assert one.process.communicate(timeout=30)[0] == ""
    assert is_good(one.ledger)


def test_a_second_service_of_a_run_is_refused_in_words(tmp_path: Path) -> None:
    add_principal(tmp_path / "principals", "robot/A1")
    first, second = (Process(tmp_path, 0) for _ in range(2))
    _, said = second.process.communicate(timeout=30)
    assert (second.process.returncode, "Traceback" in said) == (2, False)
    assert "another process governs it, expected none; stop that one first" in said
    assert first.end(signal.SIGTERM)[0] == 0
