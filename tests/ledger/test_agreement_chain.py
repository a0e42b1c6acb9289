"""Two verifiers that share no code agree on ledgers, good and damaged, and name the same first file."""

import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.ledger.rows.runs import LedgerRun, piece
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.locations import ExistingRuns
from fsar_ledger.ledger.store.paths import CHAIN, JOURNAL
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.v1 import upgrade
from fsar_ledger.ledger.verify import verify
from tests.ledger.agreement import Case, event_types, independent, judged
from tests.ledger.keep_release import LEDGERS
from tests.ledger.samples import ORIGIN, contents, made_up_run
from tests.ledger.test_chain import RUNS, SIGNER, write
from tests.quick import few


def second(path: Path) -> Any:
    """Let the second verifier look."""
    return independent("independent_chain").Verifier(path, None, None, event_types()).verify()


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
def test_both_find_nothing_wrong_with_a_good_ledger(tmp_path: Path, change: Callable[[Path], None]) -> None:
    path = write(tmp_path / "ledger")
    change(path)
    size, root, signature, _ = second(path)
    report = verify(path)
    assert (size, root, signature) == (report.events, report.root, report.signature)


def test_both_find_nothing_wrong_with_an_empty_and_with_an_upgraded_ledger(tmp_path: Path) -> None:
    Writer(tmp_path / "empty", ORIGIN).close()
    upgrade(LEDGERS / "0.8.1" / "ledger", tmp_path / "upgraded")
    for name in ("empty", "upgraded"):
        assert judged(Case(name, tmp_path / name, True)).difference == ""


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
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, how: str
) -> None:
    monkeypatch.setattr(ExistingRuns, "refused", lambda *_: None)
    path, (pieces, event) = tmp_path / "ledger", FORGED[what]
    with Writer(path, ORIGIN) as writer:
        for one in pieces:
            writer.append(stage(path, [one])) if how == "append" else writer.add([one])
    problem = verify(path).problems[0]
    with pytest.raises(independent().ProblemError) as caught:
        second(path)
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


@pytest.mark.parametrize("count", few([1, 2, 12], [], [1]))
def test_both_name_the_same_first_file_of_a_damaged_ledger(tmp_path: Path, count: int) -> None:
    step = {1: 5, 2: 3, 12: 1}[count]
    path = write(tmp_path / "ledger")
    found = 0
    for what, files in list(damages(path, count, step)):
        for name in contents(path).keys() - files.keys():
            (path / name).unlink()
        for name, data in files.items():
            (path / name).parent.mkdir(exist_ok=True)
            (path / name).write_bytes(data)
        outcome = judged(Case(what, path, None))
        assert outcome.difference == ""
        found += not outcome.is_good
        if (path / "commits").exists():
            (path / "commits" / "000000000000.json").unlink()
            (path / "commits").rmdir()
    assert found > (60 if step == 1 else 30)
