"""The digest of the state at a cut is compared where the state has the same shape, and is a remark where it has not."""

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.cli.app import run
from fsar_ledger.events.envelope import Principal, Robot
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.projections.request import Requests
from fsar_ledger.runtime.live import state_shape
from fsar_ledger.runtime.snapshot import shape_of, state_sha256
from tests.runtime.test_cuts import Day, S
from tests.runtime.test_wrong_cuts import other, written

OTHER_SHAPE, OTHER_DIGEST = "0123456789abcdef", "0" * 64


def day_with_a_cut(ledger: Path) -> Day:
    """A day on which a task is open when the run is cut."""
    day = Day(ledger)
    day.brings("t1")
    day.at(5 * S).one.cut()
    day.at(6 * S).brings("t2")
    day.one.close()
    return day


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> list[LedgerRun]:
    """The runs of such a day."""
    return list(open_ledger(day_with_a_cut(tmp_path_factory.mktemp("day") / "ledger").ledger).runs())


def remarks(ledger: Path) -> tuple[str, ...]:
    """What the replay remarks of a ledger in which nothing is in doubt."""
    found = fsar_ledger.Ledger(ledger).verify(replay=True)
    assert found.replay is not None
    assert found.ok, found.problems
    return found.replay.remarks


def test_a_digest_of_this_shape_is_compared_and_there_is_nothing_to_say(parts: list[LedgerRun], tmp_path: Path) -> None:
    assert remarks(written(tmp_path / "same", parts)) == ()
    assert run(["verify", str(written(tmp_path / "wrong", other(parts, state_sha256=OTHER_DIGEST))), "--replay"]) == 3


def test_a_digest_of_another_shape_accuses_nobody_and_is_said_not_to_be_compared(
    parts: list[LedgerRun], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = other(parts, state_sha256=OTHER_DIGEST, state_shape=OTHER_SHAPE)
    assert run(["verify", str(written(tmp_path / "other", told)), "--replay"]) == 0
    [remark] = [line for line in capsys.readouterr().out.splitlines() if line.startswith("state at cuts")]
    assert remark == (
        f"state at cuts: 1 digest of a state that was stored in another shape ({OTHER_SHAPE}, here {state_shape()}): "
        f"1 not compared, first of run hall.2, seq {len(parts[0].events)}; everything that it follows from was replayed"
    )


def test_who_makes_up_another_shape_alone_is_seen(parts: list[LedgerRun], tmp_path: Path) -> None:
    [remark] = remarks(written(tmp_path / "other", other(parts, state_shape=OTHER_SHAPE)))
    assert f"({OTHER_SHAPE}, here {state_shape()}): the same here" in remark


def test_another_shape_hides_nothing_else(parts: list[LedgerRun], tmp_path: Path) -> None:
    told = other(parts, state_sha256=OTHER_DIGEST, state_shape=OTHER_SHAPE, continues_root=OTHER_DIGEST)
    found = fsar_ledger.Ledger(written(tmp_path / "other", told)).verify(replay=True)
    assert found.replay is not None
    assert [one.field for one in found.replay.differences] == ["continues_root"]


def test_a_ledger_of_a_version_that_kept_the_state_by_another_name_is_not_accused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Requests.__name__ = "Asked"
    try:
        with monkeypatch.context() as then:
            then.setattr("fsar_ledger.runtime.live.state_shape", state_shape.__wrapped__)
            day = day_with_a_cut(tmp_path / "ledger")
    finally:
        Requests.__name__ = "Requests"
    [remark] = remarks(day.ledger)
    assert "1 not compared" in remark


def made(*fields: Any, name: str = "Known", module: str = "here") -> type[msgspec.Struct]:
    """A type with these fields."""
    return msgspec.defstruct(name, fields, kw_only=True, module=module)


INNER: Any = made(("robot", Robot))
FIELDS: Any = (
    ("robots", Mapping[Robot, tuple[INNER | None, ...]], msgspec.field(default_factory=dict)),
    ("most", int, 3),
)


@pytest.mark.parametrize(
    "changed",
    [
        made(("names", *FIELDS[0][1:]), FIELDS[1]),
        made(FIELDS[0], ("most", int, 4)),
        made(FIELDS[0], ("most", int)),
        made(FIELDS[0], ("most", int | None, 3)),
        made(*FIELDS, ("least", int, 0)),
        made(FIELDS[0]),
        made(("robots", Mapping[Robot, tuple[made(("name", Robot)) | None, ...]], FIELDS[0][2]), FIELDS[1]),  # type: ignore[misc]
        made(*FIELDS, name="Other"),
    ],
)
def test_the_shape_is_another_when_a_name_a_type_or_a_default_is(changed: type) -> None:
    assert shape_of([changed]) != shape_of([made(*FIELDS)])


def test_the_shape_is_the_same_where_nothing_that_is_digested_changes() -> None:
    of_text = made(("one", str | None), ("other", tuple[str, ...]))
    assert shape_of([made(("one", Robot | None), ("other", tuple[Principal, ...]), module="there")]) == shape_of(
        [of_text]
    )
    assert shape_of([made(("one", Literal["a", "b"] | None), ("other", tuple[Robot, ...]))]) == shape_of([of_text])
    assert shape_of([INNER, of_text]) == shape_of([of_text, INNER])


def test_one_more_field_with_a_default_changes_no_digest() -> None:
    known, more = made(*FIELDS), made(*FIELDS, ("seen", Mapping[str, int], msgspec.field(default_factory=dict)))
    robots = {Robot("robot/A1"): ()}
    assert state_sha256(known(robots=robots)) == state_sha256(more(robots=robots))
    assert state_sha256(more(robots=robots)) != state_sha256(more(robots=robots, seen={"robot/A1": 1}))


def test_the_shape_is_the_same_in_every_process() -> None:
    program = "from fsar_ledger.runtime.live import state_shape; print(state_shape())"
    for seed in "12":
        told = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True, env={"PYTHONHASHSEED": seed}
        )
        assert told.stdout.strip() == state_shape()
