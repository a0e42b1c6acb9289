"""Where in a ledger the events of a run are, and whether the index agrees with the rows.

Signatures bind roots. Whoever can write the folder can chain a line of the index anew that leaves a run out, or a part
of one; its rows are there, and lead to the root.

A writer asks which runs there are, and how far they go: a run goes on where it stopped.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from fsar_ledger.base import printable
from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.events import Event
from fsar_ledger.events.fleet import RunContinued
from fsar_ledger.ledger.rows import codec, segment
from fsar_ledger.ledger.rows.blocks import BLOCK_COLUMNS, Block, Runs, blocks_of
from fsar_ledger.ledger.rows.runs import Flaw, LedgerRun, continuing, counted_on, require_alike, require_next, whole
from fsar_ledger.ledger.rows.schema import SCHEMAS, concerns_admitted
from fsar_ledger.ledger.store.derived import Index, Part, groups_of, require_lines
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import PREFIX, is_log


def event_count(parts: Iterable[Part]) -> int:
    """Return how many events these parts of runs have."""
    return sum(part.block.rows for part in parts)


def place_of(view: View, run: str, seq: int) -> int:
    """Return the index in the ledger of this event of the run.

    Raises:
        KeyError: The run has no such event; the argument is how many it has.
        LedgerCorrupted: A segment cannot be read, or does not hold the event.
    """
    parts = view.parts(run)
    part = next((part for part in parts if part.block.first <= seq < part.block.end), None)
    if part is None and seq >= (events := event_count(parts)):
        raise KeyError(events)
    for number in view.segments_of(parts if part is None else [part]):
        table = segment.read_table(view.segment(number), ["run_id", "seq"])
        row = pc.index(pc.and_(pc.equal(table["run_id"], run), pc.equal(table["seq"], seq)), True).as_py()
        if row >= 0:
            return view.first(number) + int(row)
    raise LedgerCorrupted(
        f"{view.path}: found no event {seq} of run {run} where the index says that it is; run fsar-ledger verify"
    )


class Places(NamedTuple):
    """The indexes in the ledger of the first and the last event of a run."""

    first: int
    last: int


def places_of(view: View, runs: Sequence[str]) -> dict[str, Places]:
    """Return where these runs begin and end. Raises: LedgerCorrupted if a segment cannot be read."""
    found: dict[str, Places] = {}
    for number in _segments_of(view, runs):
        names = view.table(number, ["run_id"])["run_id"]
        rows = pa.table({"run": names, "row": np.arange(len(names))}).filter(pc.is_in(names, pa.array(runs)))
        ends = rows.group_by("run").aggregate([("row", "min"), ("row", "max")]).to_pylist()
        for run, first, last in ((one["run"], one["row_min"], one["row_max"]) for one in ends):
            begun = found[run].first if run in found else view.first(number) + first
            found[run] = Places(begun, view.first(number) + last)
    return found


def event_at(view: View, place: int) -> dict[str, object]:
    """Return the event with this index in the ledger, as it is stored. Raises: LedgerCorrupted."""
    return msgspec.json.decode(view.event(place), type=dict[str, object])


def record_of(view: View, run: str, size: int | None = None) -> LedgerRun:
    """Return the events of the run of this name, as `records_of`; with `size`, of the first so many events alone.

    Event 0 must be one of these.
    """
    return records_of(view, [run], size)[0]


def records_of(view: View, runs: Sequence[str], size: int | None = None) -> list[LedgerRun]:
    """Return the events of these runs, each with those of the runs that it continues, as `continuing` does.

    Only the segments that hold them are decoded, each once.

    Raises:
        UsageError: The ledger has no such run.
        LedgerCorrupted: A segment cannot be read.
    """
    chains = {run: chain_of(view, run) for run in runs}
    pieces: dict[str, list[LedgerRun]] = {name: [] for names in chains.values() for name in names}
    for number in _segments_of(view, [*pieces]):
        for piece in codec.decode(_rows(view, number, [*pieces], size), is_whole=False):
            pieces[piece.run_id].append(piece)
    if lacking := [run for run in runs if not pieces[run]]:
        raise UsageError(f"{view.path}: run {printable.value(lacking[0])}: there is no such run")
    return [continuing([whole(pieces[name]) for name in names]) for names in chains.values()]


def pieces_of(view: View, run: str, size: int | None = None) -> Iterator[LedgerRun]:
    """Yield in order the pieces of what `record_of` returns, in memory that does not grow with the run.

    Raises: As that; LedgerCorrupted also if a piece is missing.
    """
    names = chain_of(view, run)
    current, rows, before = names[0], 0, 0  # rows of the current run so far, and how much higher its seqs are counted
    started: Event | None = None
    for number in _segments_of(view, names):
        for piece in codec.decode(_rows(view, number, names, size), is_whole=False):
            if piece.run_id != current:
                current, rows, before = piece.run_id, 0, before + rows - 1
            require_next(piece, rows)
            rows += len(piece.events)
            if piece.first == 0:
                started = started or piece.events[0]
                require_alike(piece, started, names[0])
            yield piece if current == names[0] else counted_on(piece, before)
    if started is None:
        raise UsageError(f"{view.path}: run {printable.value(run)}: there is no such run")


def end_of(view: View, run: str, size: int | None = None) -> int:
    """Return the time of the last event that `record_of` returns, in microseconds of run time. Raises: As that."""
    names = chain_of(view, run)
    for number in reversed(_segments_of(view, names)):
        if len(rows := _rows(view, number, names, size, ["run_id", "time_us"])):
            return int(rows["time_us"][-1].as_py())
    raise UsageError(f"{view.path}: run {printable.value(run)}: there is no such run")


def _segments_of(view: View, runs: Sequence[str]) -> list[int]:
    return view.segments_of([part for run in runs for part in view.parts(run)])


def _rows(view: View, number: int, runs: Sequence[str], size: int | None, columns: list[str] | None = None) -> pa.Table:
    """Return the rows that a segment has of these runs, of the first so many events of the ledger."""
    table = segment.read_table(view.segment(number), columns)
    table = table.slice(0, len(table) if size is None else max(0, size - view.first(number)))
    return table.filter(pc.is_in(table["run_id"], pa.array(runs)))


def continued_by(record: LedgerRun) -> str | None:
    """Return the name of the run that the one on record continues; None if it begins by itself."""
    second = record.events[1] if len(record.events) > 1 else None
    return second.continues if isinstance(second, RunContinued) else None


def chain_of(view: View, run: str) -> list[str]:
    """Return the runs that this one continues, the first first, as far as the ledger holds them, and itself."""
    before, found = earlier_runs(view), [run]
    while found[-1] in before:
        found.append(before[found[-1]])
    return found[::-1]


def whole_of(view: View, run: str) -> str:
    """Return the last of the runs that continue this one, so that all of them are read with it; itself if none does."""
    return wholes_of(view).get(run, run)


def wholes_of(view: View) -> Mapping[str, str]:
    """Return by its name each run that continues another or is continued, and the last of those that do."""
    found: dict[str, str] = {}
    for run, before in reversed([*earlier_runs(view).items()]):  # in the order in which they begin
        found[before] = found.setdefault(run, run)
    return found


def whole_runs(view: View) -> Iterator[LedgerRun]:
    """Yield every run as `View.runs`, and runs that continue each other as one. Raises: as that, and `continuing`."""
    wholes, held = wholes_of(view), dict[str, list[LedgerRun]]()
    for run in view.runs():
        whole = wholes.get(run.run_id, run.run_id)
        held.setdefault(whole, []).append(run)
        if run.run_id == whole:
            yield continuing(held.pop(whole))


def whole_groups(view: View) -> list[tuple[int, ...]]:
    """As `View.groups`; runs that continue each other are in one of them."""
    wholes = wholes_of(view)
    if not wholes:
        return view.groups()
    names = (table["run_id"].unique().to_pylist() for table in view.tables(["run_id"]))
    return groups_of([wholes.get(run, run) for run in runs] for runs in names)


def counted_rows(view: View, rows: pa.Table) -> pa.Table:
    """Return these columns `run_id` and `seq` of stored events as readers of whole runs have them.

    Event 0 of a run that continues another, which they leave out, has the seq of event 1.
    """
    wholes = wholes_of(view)
    if not wholes:
        return rows
    before = {run: seq_counted_on(view, run, 1) - 1 for run in rows["run_id"].unique().to_pylist() if run in wholes}
    pairs = zip(rows["run_id"].to_pylist(), rows["seq"].to_pylist(), strict=True)
    counted = ((run, max(seq, 1) + before[run] if before.get(run) else seq) for run, seq in pairs)
    found = [(wholes.get(run, run), seq) for run, seq in counted]
    return pa.table([[run for run, _ in found], [seq for _, seq in found]], schema=rows.schema)


def earlier_runs(view: View) -> Mapping[str, str]:
    """Return by its name each run that continues another one of the ledger, and the name of that.

    Raises:
        LedgerCorrupted: One does not follow the run that it says it continues; or as `View.index`.
    """
    if not any("continues" in SCHEMAS[release].names for release in {*view.releases}):
        return {}
    found = view.index.earlier()
    if isinstance(found, Flaw):
        raise LedgerCorrupted(f"{view.path}: {found}; run fsar-ledger verify")
    return found


def place_counted_on(view: View, run: str, seq: int) -> int:
    """As `place_of`, of an event whose seq counts on over the runs that this one continues."""
    before = 0
    for name in chain_of(view, run):
        size = event_count(view.parts(name))
        if name != run and seq - before >= size:
            before += size - 1
            continue
        try:
            return place_of(view, name, seq - before)
        except KeyError:
            raise KeyError(before + size) from None
    raise KeyError(0)


def seq_counted_on(view: View, run: str, seq: int) -> int:
    """Return the seq of this event of the run, counted on over those that it continues; its event 0 is not counted."""
    earlier = chain_of(view, run)[:-1]
    before = sum(event_count(view.parts(name)) - 1 for name in earlier)
    return before + max(seq, 1 if earlier else 0)


def compare_index(view: View) -> bool:
    """Compare the lines of the index for each segment that is not believed; return whether all could be read.

    Raises: LedgerCorrupted if the rows of a segment have other lines than the chain says.
    """
    is_read = True
    for number in range(len(view.chain.placed)):
        if number in view.believed:
            continue
        try:
            lines = view.index_lines(number)
        except LedgerCorrupted:  # whoever reads its rows is told
            is_read = False
            continue
        require_lines(view.path, view.chain.placed_in(number), lines)
        view.believed.add(number)
    return is_read


_MOST_SOUGHT = 64
"""How many runs are sought in the index by name before all of it is read, which takes about as long."""


class RunsAndPlans(NamedTuple):
    """The names of the runs that a ledger holds, and of its plans."""

    runs: frozenset[str]
    plans: frozenset[str]


class ExistingRuns:
    """The runs of a ledger, sought in its index as they are asked about.

    A writer believes the index, as it believes the rows: it only appends.

    Raises: LedgerCorrupted if rows must be read and cannot be.
    """

    def __init__(self, view: View) -> None:
        self._runs = Runs()
        self._is_log = is_log(view) if view.chain.size else None
        view.believe_index()
        self._index: Index | None = view.index  # None once all of it is read
        self._runs.continued = {before: run for run, before in view.index.continues().items()}
        self._sought: set[str] = set()
        self._indexed: set[str] = set()  # what these observe is not known: the index does not say it

    def add_from(self, view: View, first: int) -> None:
        """Add the events of this view from that index on. Raises: LedgerCorrupted if they cannot be read."""
        for table in view.tables_from(first, BLOCK_COLUMNS):
            self.add(blocks_of(table))

    def add(self, blocks: Iterable[Block]) -> None:
        """Add what was committed."""
        for block in blocks:
            self._is_log = _is_head(block)
            self._seek(block.run)
            self._runs.add(block)

    def _seek(self, run: str) -> None:
        """Take over what the index says of this run."""
        if self._index is None or run in self._sought:
            return
        if len(self._sought) == _MOST_SOUGHT:
            self._read_all()
            return
        self._sought.add(run)
        self._take_over(block for _, block in self._index.of_run(run))

    def _read_all(self) -> None:
        """Take over what the index says of all runs."""
        if self._index is not None:
            self._take_over(block for block in self._index.blocks() if block.run not in self._sought)
            self._index = None

    def _take_over(self, blocks: Iterable[Block]) -> None:
        for block in blocks:
            self._runs.add(block)
            self._indexed.add(block.run)

    def told(self) -> RunsAndPlans:
        """Return the names of these runs, and of the plans."""
        self._read_all()
        plans = frozenset(run for run, known in self._runs.known.items() if known.is_alone)
        return RunsAndPlans(frozenset(self._runs.known.keys() - plans), plans)

    def events(self, run: str) -> int:
        """Return how many events of this run the ledger holds."""
        self._seek(run)
        known = self._runs.known.get(run)
        return 0 if known is None else known.next

    def refused(self, blocks: Sequence[Block], view: View) -> Flaw | None:
        """Return why these blocks cannot be the next of this ledger; None if they can.

        Raises: LedgerCorrupted if the beginning of a run that goes on cannot be read.
        """
        seen: set[str] = set()
        for block in blocks:
            if block.run in seen:
                return Flaw(-1, block.run, block.first, "run_id", "the run twice in one commit", "each run once")
            seen.add(block.run)
            if (is_log := _is_head(blocks[0]) if self._is_log is None else self._is_log) != _is_head(block):
                found, expected = (
                    ("a run", "heads of shards alone, since the ledger is a log of shards; name the ledger of a shard")
                    if is_log
                    else ("the head of a shard", "runs and plans alone, as the ledger holds them")
                )
                return Flaw(-1, block.run, block.first, "type", found, expected)
            for run in (block.run, *(block.goes_on_from or ())[:1]):
                self._seek(f"{run}")
            if block.first and block.run in self._indexed:
                self._read_beginning(block.run, view)
            if (flaw := self._runs.flaw(block) or self._runs.backwards(block)) is not None:
                return flaw
            if block.first and block.run not in view.chain.going_on:
                return Flaw(-1, block.run, block.first, "seq", f"{block.first}", "no more of a run that has ended")
        return None

    def _read_beginning(self, run: str, view: View) -> None:
        """Read what the run observes. Raises: LedgerCorrupted."""
        view.believe_index()
        started = event_at(view, place_of(view, run, 0))
        observes, records = started.get("observes"), started.get("records")
        names = concerns_admitted(
            observes if isinstance(observes, list) else None, records if isinstance(records, list) else None
        )
        self._runs.known[run] = self._runs.known[run]._replace(observes=names)
        self._indexed.remove(run)


def _is_head(block: Block) -> bool:
    return block.is_alone and block.run.startswith(PREFIX)


def continued(blocks: Sequence[Block]) -> tuple[tuple[str, int], ...]:
    """Return, for the record of a commit, the runs that these blocks continue, and from which seq on."""
    return tuple(sorted([(block.run, block.first) for block in blocks if block.first]))
