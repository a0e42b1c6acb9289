"""Two verifiers that share no code agree on ledgers, good and damaged, and name the same first file."""

import json
import random
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.rows.run_slices import piece
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.locations import ExistingRuns
from fsar_ledger.ledger.store.paths import CHAIN, JOURNAL
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.v1 import upgrade
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.agreement import ROOT
from tests.ledger.keep_release import LEDGERS
from tests.ledger.samples import ORIGIN, contents, made_up_run
from tests.ledger.test_chain import RUNS
from tests.quick import few

SIGNER = Signer(ORIGIN, b"k" * 32)
TYPES = json.loads((ROOT / "docs" / "event-types.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def independent() -> Iterator[Any]:
    """Import the second verifier as its command does."""
    sys.path.insert(0, str(ROOT / "tests"))
    try:
        import independent_chain  # type: ignore[import-not-found]

        yield independent_chain
    finally:
        sys.path.remove(str(ROOT / "tests"))


def write(path: Path) -> Path:
    """Write a ledger with two segments, of which the second ends within a run, and two commits in its journal."""
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.append(stage(path, RUNS[:1]))
        writer.append(stage(path, [piece(RUNS[1], 0, 20)]))
        writer.add([piece(RUNS[1], 20, 25), piece(RUNS[2], 0, 5)])
        writer.add([piece(RUNS[2], 5, 30)])
    return path


def judged(independent: Any, path: Path) -> tuple[str | None, str | None]:
    """Return the first file that each verifier doubts, None where it doubts none."""
    problems = verify(path).problems
    try:
        independent.Verifier(path, None, None, TYPES).verify()
    except independent.ProblemError as error:
        return (problems[0].where if problems else None), error.where
    return (problems[0].where if problems else None), None


def _sealed(path: Path) -> None:
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.seal()


def _compacted(path: Path) -> None:
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.compact()
        writer.add([piece(RUNS[1], 25, 30)])


def _nothing(path: Path) -> None:
    pass


@pytest.mark.parametrize("change", [_nothing, _sealed, _compacted])
def test_both_find_nothing_wrong_with_a_good_ledger(
    independent: Any, tmp_path: Path, change: Callable[[Path], None]
) -> None:
    path = write(tmp_path / "ledger")
    change(path)
    assert judged(independent, path) == (None, None)
    size, root, signature, _ = independent.Verifier(path, None, None, TYPES).verify()
    report = verify(path)
    assert (size, root, signature) == (report.events, report.root, report.signature)


def test_both_find_nothing_wrong_with_an_empty_and_with_an_upgraded_ledger(independent: Any, tmp_path: Path) -> None:
    Writer(tmp_path / "empty", ORIGIN).close()
    upgrade(LEDGERS / "0.8.1" / "ledger", tmp_path / "upgraded")
    for name in ("empty", "upgraded"):
        assert judged(independent, tmp_path / name) == (None, None)


LONGER = made_up_run("run-0", 40, 0)
NARROW = msgspec.structs.replace(
    RUNS[3], events=[msgspec.structs.replace(RUNS[3].events[0], observes=("registry",)), *RUNS[3].events[1:]]
)
FORGED: dict[str, tuple[list[LedgerRun], tuple[str, int] | None]] = {
    "a gap": ([piece(RUNS[1], 0, 10), piece(RUNS[1], 12, 20)], ("run-1", 12)),
    "some events again": ([piece(RUNS[1], 0, 10), piece(RUNS[1], 8, 20)], ("run-1", 8)),
    "a run again": ([RUNS[0], made_up_run("run-0", 12, 9)], ("run-0", 0)),
    "a concern that the run does not observe": ([piece(NARROW, 0, 1), piece(NARROW, 1, 30)], ("run-3", 1)),
    "more of a run that has ended": (
        [RUNS[0], LedgerRun("run-0", LONGER.times_us[30:], LONGER.caused_by[30:], LONGER.events[30:], 30)],
        None,
    ),
    "no beginning": ([piece(RUNS[2], 5, 9)], None),
}
"""What a writer refuses, and the event that verifiers name if one has stored it all the same; None: the checkpoint."""


@pytest.mark.parametrize("how", ["append", "add"])
@pytest.mark.parametrize("what", FORGED)
def test_both_name_the_event_that_breaks_a_rule_across_commits(
    independent: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, how: str
) -> None:
    monkeypatch.setattr(ExistingRuns, "refused", lambda *_: None)
    path, (pieces, event) = tmp_path / "ledger", FORGED[what]
    with Writer(path, ORIGIN) as writer:
        for one in pieces:
            writer.append(stage(path, [one])) if how == "append" else writer.add([one])
    problem = verify(path).problems[0]
    with pytest.raises(independent.ProblemError) as caught:
        independent.Verifier(path, None, None, TYPES).verify()
    theirs = caught.value
    assert problem.where == theirs.where
    assert (problem.commit, problem.run, problem.seq) == (theirs.commit, theirs.run, theirs.seq)
    assert (problem.run, problem.seq) == (event or (None, None))


def damages(path: Path, count: int, step: int) -> Iterator[tuple[str, dict[str, bytes]]]:
    """Yield damages: what was done, and the files with what they hold then; of each STEP-th line."""
    draw, good = random.Random(7), contents(path)
    for name, data in good.items():
        others = {other: held for other, held in good.items() if other != name}
        yield f"{name} is gone", others
        yield f"{name} is longer", others | {name: data + b"x"}
        for _ in range(count):
            at = draw.randrange(len(data))
            yield f"{name} is cut at {at}", others | {name: data[:at]}
            changed = bytes([data[at] ^ 1 << draw.randrange(8)])
            yield f"{name} is changed at {at}", others | {name: data[:at] + changed + data[at + 1 :]}
    for name in (CHAIN, JOURNAL):
        lines = good[name].splitlines(keepends=True)
        for at in range(0, len(lines), step):
            yield f"{name} lacks line {at}", good | {name: b"".join(lines[:at] + lines[at + 1 :])}
            yield f"{name} has line {at} twice", good | {name: b"".join([*lines[:at], lines[at], *lines[at:]])}
            yield f"{name} ends before line {at}", good | {name: b"".join(lines[:at])}
            swapped = [*lines[: at - 1], lines[at], lines[at - 1], *lines[at + 1 :]]
            yield f"{name} has line {at} earlier", good | {name: b"".join(swapped) if at else good[name]}
    for stray in ("stray", "segments/stray", "commits/000000000000.json"):
        yield f"{stray} is there", good | {stray: b"x"}


@pytest.mark.parametrize("count", few([1, 2, 12], [1]))
def test_both_name_the_same_first_file_of_a_damaged_ledger(independent: Any, tmp_path: Path, count: int) -> None:
    step = 5 if count == 1 else 1
    path = write(tmp_path / "ledger")
    found = 0
    for what, files in list(damages(path, count, step)):
        for name in contents(path).keys() - files.keys():
            (path / name).unlink()
        for name, data in files.items():
            (path / name).parent.mkdir(exist_ok=True)
            (path / name).write_bytes(data)
        ours, theirs = judged(independent, path)
        assert ours == theirs, what
        found += ours is not None
        if (path / "commits").exists():
            (path / "commits" / "000000000000.json").unlink()
            (path / "commits").rmdir()
    assert found > (60 if step == 1 else 30)
