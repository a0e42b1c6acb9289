"""A run goes on from its snapshot as from its record, and a snapshot that does not count changes nothing."""

import hashlib
import os
import pickle
import random
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.runtime import federation, snapshot
from fsar_ledger.runtime.federation import Federation
from fsar_ledger.runtime.kernel import Kernel
from tests.quick import few

NOW = count(1_772_359_200)
PLACE = "ledger.snapshots"


def federate(folder: Path, run: str = "day") -> Federation:
    return fsar_ledger.federate(folder / "ledger", run=run, clock=lambda: next(NOW) * 10**9)


def play(one: Federation, draws: random.Random, steps: int) -> None:
    """Tasks that begin, fail, are recovered and judged, and some that nobody ends."""
    for _ in range(steps):
        task = f"t{draws.getrandbits(40)}"
        work: dict[str, Any] = {
            "task_id": task,
            "steps": ["A door.open.secure B"],
            "budget_us": draws.randint(1, 90) * 1_000_000,
        }
        one.give("SubmitTask", "robot/A1", key=task, robot="robot/A1", **work)
        action: dict[str, Any] = {"robot": "robot/B1", "action_id": f"{task}/1.1"}
        for name, fields in (
            ("JudgeRequest", {"accepts": draws.random() < 0.8}),
            ("ReportStart", {}),
            ("ReportFailure", {"cause": "jam"}),
            ("ReportPresence", {"is_on": draws.random() < 0.5}),
        ):
            if draws.random() < 0.7:
                own: dict[str, Any] = {"robot": "robot/B1"} if name == "ReportPresence" else action
                one.give(name, "robot/B1", **own, **fields)


def kept(folder: Path) -> Path:
    [found] = [one for one in (folder / PLACE).iterdir() if one.suffix != ".lock"]
    return found


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The numbers of events that each federation made again when it was opened."""
    found: list[int] = []
    run = Kernel.run

    def counted(kernel: Kernel, *limits: Any) -> None:
        before = len(kernel.events)
        run(kernel, *limits)
        found.append(len(kernel.events) - before)

    monkeypatch.setattr(Kernel, "run", counted)
    return found


@pytest.mark.parametrize("seed", few(range(4), [0]))
def test_a_run_that_goes_on_from_a_snapshot_is_the_run_that_goes_on_from_its_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: list[int], seed: int
) -> None:
    monkeypatch.setattr(federation, "KEEP_AFTER", 60)
    draws = random.Random(seed)
    with federate(tmp_path) as one:
        play(one, draws, 20)
    made.clear()
    with federate(tmp_path) as one:
        assert 0 < one.size - max(made, default=0) < one.size
        known, state, keys, pending = made[:], one.state, one._keys, sorted(one._live.kernel._pending, key=repr)
    kept(tmp_path).unlink()
    made.clear()
    with federate(tmp_path) as whole:
        assert max(made) > max(known, default=0)
        assert whole.state == state
        assert whole._keys == keys
        assert sorted(whole._live.kernel._pending, key=repr) == pending
        play(whole, draws, 5)
    assert fsar_ledger.Ledger(tmp_path / "ledger").verify(replay=True).ok


def test_a_ledger_that_is_given_as_the_present_folder_has_its_snapshots_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(federation, "KEEP_AT_END", 1)
    (tmp_path / "ledger").mkdir()
    monkeypatch.chdir(tmp_path / "ledger")
    with fsar_ledger.federate(".", run="day", clock=lambda: next(NOW) * 10**9) as one:
        play(one, random.Random(1), 1)
    assert kept(tmp_path).is_file()


def test_the_same_command_again_is_decided_once_after_a_snapshot_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(federation, "KEEP_AT_END", 1)
    task: dict[str, Any] = {"robot": "robot/A1", "task_id": "t", "steps": ["A navigate.indoor"], "budget_us": 10**9}
    with federate(tmp_path) as one:
        first = one.give("SubmitTask", "robot/A1", key="k", **task)
    with federate(tmp_path) as one:
        assert one.give("SubmitTask", "robot/A1", key="k", **task).seq == first.seq
        with pytest.raises(UsageError, match="found another SubmitTask"):
            one.give("SubmitTask", "robot/A1", key="k", **{**task, "task_id": "u"})


class Evil:
    def __reduce__(self) -> Any:
        return os.mkdir, ("evil",)


def damaged(data: bytes) -> bytes:
    return data[:-1] + bytes([data[-1] ^ 1])


def with_header(data: bytes, **fields: object) -> bytes:
    line, _, rest = data.partition(b"\n")
    header = msgspec.structs.replace(msgspec.json.decode(line, type=snapshot.Snapshot), **fields)
    return msgspec.json.encode(header) + b"\n" + rest


def evil(data: bytes) -> bytes:
    rest = pickle.dumps(Evil())
    return with_header(data, sha256=hashlib.sha256(rest).hexdigest()).partition(b"\n")[0] + b"\n" + rest


WRONG = {
    "damaged": damaged,
    "cut": lambda data: data[:-40],
    "empty": lambda _: b"",
    "no snapshot": lambda _: b"\xff\n",
    "of another run": lambda data: with_header(data, run="night"),
    "of another ledger": lambda data: with_header(data, root="0" * 64),
    "of a ledger that was longer": lambda data: with_header(data, size=10**9),
    "of other code": lambda data: with_header(data, code="0" * 64),
    "evil": evil,
}


@pytest.mark.parametrize("wrong", WRONG)
def test_a_snapshot_that_does_not_count_is_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, made: list[int], wrong: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(federation, "KEEP_AT_END", 1)
    with federate(tmp_path) as one:
        play(one, random.Random(1), 5)
        state, size = one.state.copy(), one.size
    path = kept(tmp_path)
    path.write_bytes(WRONG[wrong](path.read_bytes()))
    made.clear()
    with federate(tmp_path) as one:
        assert one.state == state
        assert max(made) > size / 2
    assert not (tmp_path / "evil").exists()


def test_a_disk_that_refuses_a_snapshot_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(federation, "KEEP_AFTER", 1)
    (tmp_path / PLACE).write_text("a file in its place")
    with federate(tmp_path) as one:
        play(one, random.Random(1), 2)
    assert fsar_ledger.Ledger(tmp_path / "ledger").verify(replay=True).ok
