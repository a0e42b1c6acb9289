"""Answers about runs that span commits, and grow while they are read."""

from contextlib import suppress
from pathlib import Path

import pytest

from fsar_ledger.api.events import Filter, LogRequest, stream
from fsar_ledger.api.ledger import Ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.log.merkle import tree_root
from fsar_ledger.ledger.log.pack import Tile
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.runs import piece
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.metrics.provenance import Provenance
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.ledger.keep_release import LEDGERS
from tests.ledger.samples import contents
from tests.ledger.test_tiles import node_of

RUNS = [simulate_run(RunSpec(7, name, "full", "door-relay", 4, 0), Constants()) for name in ("fsar", "cfc")]
ORIGIN = "example.org/growing"


def write(path: Path) -> None:
    """Write both runs, turn by turn, into a ledger with segments and a journal."""
    with Writer(path, ORIGIN) as writer:
        for number, at in enumerate(range(0, max(len(run.events) for run in RUNS), 90)):
            pieces = [piece(run, at, at + 90) for run in RUNS if at < len(run.events)]
            if number % 2:
                writer.append(stage(path, pieces))
            else:
                writer.add(pieces)


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Ledger, Ledger]:
    """Return the same runs whole, and in pieces."""
    folder = tmp_path_factory.mktemp("both")
    with Writer(folder / "whole", ORIGIN) as writer:
        writer.append(stage(folder / "whole", RUNS))
    write(folder / "pieces")
    return Ledger(folder / "whole"), Ledger(folder / "pieces")


@pytest.mark.slow
def test_every_answer_is_that_of_whole_runs(both: tuple[Ledger, Ledger]) -> None:
    whole, pieces = both
    assert pieces.metrics().rows() == whole.metrics().rows()
    assert pieces.log("all").rows() == whole.log("all").rows()
    assert pieces.record(1) == whole.record(1)
    assert pieces.state(2, at=30).standing == whole.state(2, at=30).standing
    assert pieces.query("facts/decisions").rows() == whole.query("facts/decisions").rows()
    assert pieces.sql("SELECT count(*) AS n, sum(seq) AS s FROM events").rows() == (
        whole.sql("SELECT count(*) AS n, sum(seq) AS s FROM events").rows()
    )
    assert [row.holds for row in pieces.audit().rows] == [row.holds for row in whole.audit().rows]


@pytest.mark.slow
def test_events_of_runs_that_took_turns_are_those_of_whole_runs(both: tuple[Ledger, Ledger]) -> None:
    whole, pieces = both
    for run in RUNS:
        assert list(pieces.events(run=run.run_id)) == list(whole.events(run=run.run_id))
    assert sorted(pieces.events(), key=lambda one: (one.run, one.seq)) == sorted(
        whole.events(), key=lambda one: (one.run, one.seq)
    )


def test_tiles_of_an_upgraded_ledger_are_those_that_format_1_kept(tmp_path: Path) -> None:
    old = LEDGERS / "0.8.1" / "ledger"
    Ledger(old).upgrade(tmp_path / "new")
    count = Ledger(tmp_path / "new").export(tmp_path / "out", tiles=True).row_count
    kept, made = contents(old), contents(tmp_path / "out")
    assert made == {name: kept[name] for name in made}
    assert count == len(made) - 1 > 5


def test_tiles_are_those_of_the_tree_however_its_runs_are_cut(both: tuple[Ledger, Ledger], tmp_path: Path) -> None:
    _, pieces = both
    for number, ledger in enumerate(both):
        assert ledger.export(tmp_path / str(number), tiles=True).row_count > 3
    view = open_for_answers(pieces.path)
    assert (tmp_path / "1" / "checkpoint").read_text() == str(view.note())

    def read(tile: Tile) -> bytes:
        return (tmp_path / "1" / tile.name).read_bytes()

    assert tree_root(node_of(read, view.head.size), view.head.size).hex() == view.head.root
    with pytest.raises(UsageError, match="found a file or folder, expected a free path for a new folder"):
        pieces.export(tmp_path / "1", tiles=True)
    with pytest.raises(UsageError, match="expected tiles alone"):
        pieces.export(tmp_path / "2", "metrics/run_metrics", tiles=True)


def test_an_event_is_proven_in_whichever_piece_of_its_run_it_is(both: tuple[Ledger, Ledger]) -> None:
    _, pieces = both
    for seq in (0, 89, 90, 181, len(RUNS[0].events) - 1):
        assert f'"seq":{seq},' in pieces.prove(f"1:{seq}").event.decode()
    with pytest.raises(UsageError, match=f"found {len(RUNS[0].events)} events in the run"):
        pieces.prove(f"1:{len(RUNS[0].events)}")


def test_what_the_ledger_had_recorded_after_a_commit_is_a_part_of_the_run(both: tuple[Ledger, Ledger]) -> None:
    _, pieces = both
    early, late = pieces.state(1, at=200, by_commit=1), pieces.state(1, at=200)
    assert (early.seq, early.commit) == (89, 1)
    assert late.seq > 200
    assert late.commit == late.seq // 90 + 1


@pytest.mark.slow
def test_followers_are_told_every_event_once_while_the_journal_grows_and_is_sealed(tmp_path: Path) -> None:
    path, run = tmp_path / "ledger", RUNS[0]
    told: list[tuple[str, int]] = []
    turns = 0

    class Ended(Exception):
        pass

    with Writer(path, ORIGIN) as writer:
        writer.add([piece(run, 0, 50)])

        def grow() -> None:
            nonlocal turns
            turns += 1
            at = 50 * turns
            if at >= len(run.events):
                raise Ended
            if turns % 3 == 0:
                writer.seal()
            writer.add([piece(run, at, at + 50)])
            if turns % 4 == 0:
                writer.compact()

        tables = stream(path, LogRequest(Filter(None, None, None, None), ()), _about(path), None, grow)
        with suppress(Ended):
            for table in tables:
                told += [(row["run_id"], row["seq"]) for row in table.rows()]
    assert told == [(run.run_id, seq) for seq in range(len(run.events))]


def _about(path: Path) -> Provenance:
    return Provenance(Ledger(path).head, False)
