"""A quick look at a ledger believes an anchor only if the stored hashes prove that it just grew."""

import shutil
from pathlib import Path

import pytest

from fsar_ledger.ledger.rows.runs import piece
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import CHAIN, NODES
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import recover, verify
from fsar_ledger.ledger.verify.report import Anchor, VerifyOptions, VerifyReport, read_anchor
from fsar_ledger.ledger.verify.trusted import NO_SEGMENT, ROWS_FIT
from tests.ledger.agreement_chain import anchor_at, records_of, relink, rewrite, tables_of
from tests.ledger.forgery import changed
from tests.ledger.samples import ORIGIN, made_up_run

RUN = made_up_run("run-0", 144, 1)
THEN = 40
"""The events of the first commit, of which somebody keeps the checkpoint."""


def grown(path: Path, size: int) -> Path:
    """Make a ledger of three commits of so many events, each in its segment."""
    with Writer(path, ORIGIN) as writer:
        for first in range(0, 3 * size, size):
            writer.append(stage(path, [piece(RUN, first, first + size)]))
    return path


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A ledger of three commits, in one segment."""
    path = grown(tmp_path / "ledger", 40)
    with Writer(path, ORIGIN) as writer:
        assert writer.compact() == 3
    return path


@pytest.fixture
def anchor(path: Path) -> Anchor:
    return read_anchor(anchor_at(path, THEN, None, path.with_name("anchor")))


def looked(path: Path, anchor: Anchor | None, *, is_quick: bool = True) -> VerifyReport:
    return verify(path, asked=VerifyOptions(is_quick=is_quick, anchor=anchor))


def test_that_the_record_of_the_anchors_commit_is_there_proves_nothing(path: Path, anchor: Anchor) -> None:
    records, _ = records_of(path)
    root = records[0]["tree_root"]
    tables = tables_of(path)
    rewrite(path, [changed(tables[0], "time_us", 0, -1)])
    records, frames = records_of(path)
    assert (records[0]["tree_size"], records[0]["tree_root"] != root) == (THEN, True)
    records[0]["tree_root"] = root
    relink(path, records, frames)
    assert looked(path, None).ok  # which reads no rows
    report = looked(path, anchor)
    assert [problem.found for problem in report.problems] == ["no way from its 40 events to the ledger's 120"]
    assert not looked(path, anchor, is_quick=False).ok


def test_hashes_that_are_missing_are_said_to_be_missing(path: Path, anchor: Anchor) -> None:
    (path / NODES).write_bytes(b"")
    report = looked(path, anchor)
    assert {problem.where for problem in report.problems} == {NODES}
    assert "fsar-ledger maintain recover" in report.problems[-1].expected


# --- what recover says of an anchor ---


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """A ledger of three commits of 48 events, of which the last segment is damaged; `all` is its checkpoint."""
    path = grown(tmp_path / "damaged", 48)
    shutil.copy(path / "checkpoint", tmp_path / "all")
    anchor_at(path, 50, None, tmp_path / "fifty")
    anchor_at(path, 97, None, tmp_path / "one-more")
    segment = max((path / "segments").iterdir())
    segment.write_bytes(segment.read_bytes()[:-9] + b"x" * 9)
    return path


@pytest.mark.parametrize(
    ("name", "vouched"),
    [
        ("fifty", 50),
        ("all", 96),  # the stored hashes lead from 96 events, a multiple of 16, to it
        ("one-more", None),  # for its last event, the hash of a row is needed
    ],
)
def test_recover_says_how_far_an_anchor_vouches_for_what_can_be_trusted(
    damaged: Path, name: str, vouched: int | None
) -> None:
    found = recover(damaged, asked=VerifyOptions(anchor=read_anchor(damaged.with_name(name))))
    assert (found.outcome, found.head.size, found.anchored) == ("damaged", 96, vouched)


def test_recover_says_what_each_later_commit_shows_alone(damaged: Path) -> None:
    with Writer(damaged, ORIGIN) as writer:
        writer.add([piece(made_up_run("run-1", 3, 2), 0, 3)])
    name = max(file.name for file in (damaged / "segments").iterdir())
    (of_segment, of_journal) = recover(damaged).later
    assert (of_segment.number, of_segment.found, of_segment.file) == (2, NO_SEGMENT, f"segments/{name}")
    assert f'"segment_sha256":"{of_segment.restore}"' in (damaged / CHAIN).read_text()
    assert (of_journal.number, of_journal.found, of_journal.file) == (3, ROWS_FIT, None)


def test_recover_says_that_another_history_vouches_for_nothing(damaged: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    with Writer(other, ORIGIN) as writer:
        writer.append(stage(other, [piece(made_up_run("run-1", 60, 2), 0, 60)]))
    for size in (50, 60):
        file = anchor_at(other, size, None, tmp_path / f"other-{size}")
        assert recover(damaged, asked=VerifyOptions(anchor=read_anchor(file))).anchored is None
