"""Where in a ledger the events of a run are, and whether the index agrees with the rows.

Signatures bind roots. Anyone with write access to the folder can chain a forged line of the index that omits a run, or
part of one; its rows are still there, and lead to the root.

A writer needs to know the existing runs and their next sequence numbers: a run continues where it stopped.
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
from fsar_ledger.ledger.rows import codec
from fsar_ledger.ledger.rows.blocks import BLOCK_COLUMNS, Block, Runs, blocks_of
from fsar_ledger.ledger.rows.runs import Flaw, LedgerRun, continuing, counted_on, require_alike, require_next, whole_run
from fsar_ledger.ledger.rows.schema import SCHEMAS, concerns_admitted
from fsar_ledger.ledger.store.derived import Index, Part, groups_of, require_lines
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import PREFIX, is_log


def event_count(parts: Iterable[Part]) -> int:
    """Return the number of events in these parts of runs."""
    return sum(part.block.rows for part in parts)


def place_of(view: View, run: str, seq: int) -> int:
    """Return the index in the ledger of this event of the run.

    Raises:
        KeyError: The run has no such event; the argument is its number of events.
        LedgerCorrupted: A segment cannot be read, or does not hold the event.
    """
    parts = view.parts(run)
    part = next((part for part in parts if part.block.first <= seq < part.block.end), None)
    if part is None and seq >= (events := event_count(parts)):
        raise KeyError(events)
    for number in view.segments_of(parts if part is None else [part]):
        table = view.table(number, ["run_id", "seq"])
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
    """Return the first and last index of each run, by name. Raises: LedgerCorrupted if a segment cannot be read."""
    places: dict[str, Places] = {}
    for number in _segments_of(view, runs):
        names = view.table(number, ["run_id"])["run_id"]
        rows = pa.table({"run": names, "row": np.arange(len(names))}).filter(pc.is_in(names, pa.array(runs)))
        ends = rows.group_by("run").aggregate([("row", "min"), ("row", "max")]).to_pylist()
        for run, first, last in ((row["run"], row["row_min"], row["row_max"]) for row in ends):
            first_index = places[run].first if run in places else view.first(number) + first
            places[run] = Places(first_index, view.first(number) + last)
    return places


def event_at(view: View, place: int) -> dict[str, object]:
    """Return the stored event with this index in the ledger. Raises: LedgerCorrupted."""
    return msgspec.json.decode(view.event(place), type=dict[str, object])


def record_of(view: View, run: str, size: int | None = None) -> LedgerRun:
    """Return the events of this run, as `records_of`; with `size`, only those among the ledger's first `size` events.

    Event 0 of the run must be one of these.
    """
    return records_of(view, [run], size)[0]


def records_of(view: View, runs: Sequence[str], size: int | None = None) -> list[LedgerRun]:
    """Return the events of these runs, each joined by `continuing` with those of the runs that it continues.

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
    return [continuing([whole_run(pieces[name]) for name in names]) for names in chains.values()]


def pieces_of(view: View, run: str, size: int | None = None) -> Iterator[LedgerRun]:
    """Yield what `record_of` returns in pieces, in order, in memory that does not grow with the run.

    Raises: As `record_of`; LedgerCorrupted also if a piece is missing.
    """
    names = chain_of(view, run)
    current, rows, offset = names[0], 0, 0  # the current run, its rows so far, and the offset added to its seqs
    started: Event | None = None
    for number in _segments_of(view, names):
        for piece in codec.decode(_rows(view, number, names, size), is_whole=False):
            if piece.run_id != current:
                current, rows, offset = piece.run_id, 0, offset + rows - 1
            require_next(piece, rows)
            rows += len(piece.events)
            if piece.first == 0:
                started = started or piece.events[0]
                require_alike(piece, started, names[0])
            yield piece if current == names[0] else counted_on(piece, offset)
    if started is None:
        raise UsageError(f"{view.path}: run {printable.value(run)}: there is no such run")


def end_of(view: View, run: str, size: int | None = None) -> int:
    """Return the time of `record_of`'s last event, in microseconds of run time. Raises: As `record_of`."""
    names = chain_of(view, run)
    for number in reversed(_segments_of(view, names)):
        if len(rows := _rows(view, number, names, size, ["run_id", "time_us"])):
            return int(rows["time_us"][-1].as_py())
    raise UsageError(f"{view.path}: run {printable.value(run)}: there is no such run")


def _segments_of(view: View, runs: Sequence[str]) -> list[int]:
    return view.segments_of([part for run in runs for part in view.parts(run)])


def _rows(view: View, number: int, runs: Sequence[str], size: int | None, columns: list[str] | None = None) -> pa.Table:
    """Return a segment's rows of these runs, among the first `size` events of the ledger (None: all)."""
    table = view.table(number, columns)
    table = table.slice(0, len(table) if size is None else max(0, size - view.first(number)))
    return table.filter(pc.is_in(table["run_id"], pa.array(runs)))


def continued_by(record: LedgerRun) -> str | None:
    """Return the name of the run that this record continues; None if there is none."""
    second = record.events[1] if len(record.events) > 1 else None
    return second.continues if isinstance(second, RunContinued) else None


def chain_of(view: View, run: str) -> list[str]:
    """Return the runs that this one continues, earliest first, as far as the ledger holds them, and then itself."""
    earlier, chain = earlier_runs(view), [run]
    while chain[-1] in earlier:
        chain.append(earlier[chain[-1]])
    return chain[::-1]


def whole_of(view: View, run: str) -> str:
    """Return the last run in the chain that continues this one, which is read with all of them; itself if none does."""
    return wholes_of(view).get(run, run)


def wholes_of(view: View) -> Mapping[str, str]:
    """Return, for each run that continues another or is continued, the last run of its chain, by name."""
    wholes: dict[str, str] = {}
    for run, earlier in reversed([*earlier_runs(view).items()]):  # in the order in which they begin
        wholes[earlier] = wholes.setdefault(run, run)
    return wholes


def whole_runs(view: View) -> Iterator[LedgerRun]:
    """Yield every run as `View.runs`, joining those that continue each other. Raises: As that, and `continuing`."""
    wholes, pending = wholes_of(view), dict[str, list[LedgerRun]]()
    for run in view.runs():
        name = wholes.get(run.run_id, run.run_id)
        pending.setdefault(name, []).append(run)
        if run.run_id == name:
            yield continuing(pending.pop(name))


def whole_groups(view: View) -> list[tuple[int, ...]]:
    """Return the groups of `View.groups`, with runs that continue each other in the same group."""
    wholes = wholes_of(view)
    if not wholes:
        return view.groups()
    names = (table["run_id"].unique().to_pylist() for table in view.tables(["run_id"]))
    return groups_of([wholes.get(run, run) for run in runs] for runs in names)


def counted_rows(view: View, rows: pa.Table) -> pa.Table:
    """Return these columns `run_id` and `seq` of stored events as numbered in whole runs.

    Event 0 of a run that continues another, which whole runs omit, has the seq of event 1.
    """
    wholes = wholes_of(view)
    if not wholes:
        return rows
    offsets = {run: seq_counted_on(view, run, 1) - 1 for run in rows["run_id"].unique().to_pylist() if run in wholes}
    pairs = zip(rows["run_id"].to_pylist(), rows["seq"].to_pylist(), strict=True)
    counted = ((run, max(seq, 1) + offsets[run] if offsets.get(run) else seq) for run, seq in pairs)
    numbered = [(wholes.get(run, run), seq) for run, seq in counted]
    return pa.table([[run for run, _ in numbered], [seq for _, seq in numbered]], schema=rows.schema)


def earlier_runs(view: View) -> Mapping[str, str]:
    """Return, by name, the run of the ledger that each run continues.

    Raises:
        LedgerCorrupted: A run does not follow the one it claims to continue; or as `View.index`.
    """
    if not any("continues" in SCHEMAS[release].names for release in {*view.releases}):
        return {}
    earlier = view.index.earlier()
    if isinstance(earlier, Flaw):
        raise LedgerCorrupted(f"{view.path}: {earlier}; run fsar-ledger verify")
    return earlier


def place_counted_on(view: View, run: str, seq: int) -> int:
    """Return the index as `place_of`, for a seq that counts across the runs that this one continues."""
    offset = 0
    for name in chain_of(view, run):
        size = event_count(view.parts(name))
        if name != run and seq - offset >= size:
            offset += size - 1
            continue
        try:
            return place_of(view, name, seq - offset)
        except KeyError:
            raise KeyError(offset + size) from None
    raise KeyError(0)


def seq_counted_on(view: View, run: str, seq: int) -> int:
    """Return the seq of this event counted across the runs that its run continues, without the run's own event 0."""
    earlier = chain_of(view, run)[:-1]
    offset = sum(event_count(view.parts(name)) - 1 for name in earlier)
    return offset + max(seq, 1 if earlier else 0)


def compare_index(view: View) -> bool:
    """Compare the index lines of each segment not yet compared; return whether all could be read.

    Raises: LedgerCorrupted if the lines derived from a segment's rows differ from those in the chain.
    """
    is_read = True
    for number in range(len(view.chain.placed)):
        if number in view.believed:
            continue
        try:
            lines = view.index_lines(number)
        except LedgerCorrupted:  # reading its rows reports this
            is_read = False
            continue
        require_lines(view.path, view.chain.placed_in(number), lines)
        view.believed.add(number)
    return is_read


_MOST_SOUGHT = 64
"""The number of runs searched in the index by name before all of it is read, which takes about as long."""


class RunsAndPlans(NamedTuple):
    """The names of the runs and plans in a ledger."""

    runs: frozenset[str]
    plans: frozenset[str]


class ExistingRuns:
    """The existing runs of a ledger, looked up in its index on demand.

    A writer trusts the index, as it trusts the rows: it only appends.

    Raises: LedgerCorrupted if rows must be read and cannot be.
    """

    def __init__(self, view: View) -> None:
        self._runs = Runs()
        self._is_log = is_log(view) if view.chain.size else None
        view.believe_index()
        self._index: Index | None = view.index  # None once all of it is read
        self._runs.continued = {earlier: run for run, earlier in view.index.continues().items()}
        self._sought: set[str] = set()
        self._indexed: set[str] = set()  # runs whose `observes` is missing, as the index does not hold it

    def add_from(self, view: View, first: int) -> None:
        """Add the events of this view from index `first` on. Raises: LedgerCorrupted if they cannot be read."""
        for table in view.tables_from(first, BLOCK_COLUMNS):
            self.add(blocks_of(table))

    def add(self, blocks: Iterable[Block]) -> None:
        """Add these committed blocks."""
        for block in blocks:
            self._is_log = _is_head(block)
            self._seek(block.run)
            self._runs.add(block)

    def _seek(self, run: str) -> None:
        """Load this run from the index."""
        if self._index is None or run in self._sought:
            return
        if len(self._sought) == _MOST_SOUGHT:
            self._read_all()
            return
        self._sought.add(run)
        self._take_over(block for _, block in self._index.of_run(run))

    def _read_all(self) -> None:
        """Load all runs from the index."""
        if self._index is not None:
            self._take_over(block for block in self._index.blocks() if block.run not in self._sought)
            self._index = None

    def _take_over(self, blocks: Iterable[Block]) -> None:
        for block in blocks:
            self._runs.add(block)
            self._indexed.add(block.run)

    def runs_and_plans(self) -> RunsAndPlans:
        """Return the names of all runs and plans."""
        self._read_all()
        plans = frozenset(run for run, state in self._runs.known.items() if state.is_alone)
        return RunsAndPlans(frozenset(self._runs.known.keys() - plans), plans)

    def events(self, run: str) -> int:
        """Return the number of this run's events in the ledger."""
        self._seek(run)
        state = self._runs.known.get(run)
        return 0 if state is None else state.next

    def refused(self, blocks: Sequence[Block], view: View) -> Flaw | None:
        """Return why these blocks cannot be appended to this ledger; None if they can.

        Raises: LedgerCorrupted if the beginning of a continued run cannot be read.
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
        """Read `observes` of the run from its first event. Raises: LedgerCorrupted."""
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
    """Return `continues` of a commit's record: the runs that these blocks continue, each with its first seq."""
    return tuple(sorted([(block.run, block.first) for block in blocks if block.first]))
