"""The verb `why`: why an event happened, and which events led to a verdict of SQL, in words."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Row, Screen, figure_place
from .names import Place, Run
from .verbs import WIDE, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.analysis import Line
    from fsar_ledger.analysis.reads import Read
    from fsar_ledger.analysis.why import DecisionTrace
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.metrics.provenance import Provenance

    from .ledger import Ledger
    from .table import Table

MAX_WORDS = 1_000
MAX_VALUE = 80
INDENT = "    "
_ORIGINS = {
    "founding": "the run begins with it",
    "world": "a fact of the world",
    "command": "it came from outside; the record says no more about why",
}
"""The description of an event that no handler decided, by origin."""


class Why(Answer, msgspec.Struct, frozen=True, kw_only=True):
    """Why an event of a run happened.

    Attributes:
        run: The name of the run.
        seq: The event.
        triggers: The chain of triggers: the event's, the trigger of that one, and so on to a fact of the world, a
            command from outside or event 0.
        made: How the event came about, then the events that it rests on, as deep as requested.
        lines: Every event that is named, in the words of `log`, by seq.
        provenance: The provenance of the answer.
    """

    run: str
    seq: int
    triggers: tuple[int, ...]
    made: tuple["DecisionTrace", ...]
    lines: dict[int, "Line"]
    provenance: "Provenance"

    def draw(self, file: Place, kind: str | None = None) -> None:
        """Draw the event and what it rests on, as SVG or PDF by the suffix; the file is replaced if it exists.

        Raises:
            UsageError: The name has another suffix, or the file lies inside a ledger.
            WriteFailed: The file cannot be written.
        """
        from fsar_ledger.base.publishing import publish
        from fsar_ledger.report.sequence import arcs

        path, form = figure_place(file, kind)
        if path.suffix[1:] != form:
            raise UsageError(f"--{kind} {file}: expected a name that ends in .{kind}")
        links, reads = _links(self.seq, self.made), _read_notes(self.made)
        lines = ((seq, self.lines[seq]) for seq in sorted({self.seq, *(end for link in links for end in link[:2])}))
        rows = [
            {
                "seq": seq,
                "time_s": line.time_s,
                "words": f"{line.action_id}  {line.text}" if line.action_id else line.text,
                "read": reads.get(seq, ""),
            }
            for seq, line in lines
        ]
        publish(path, arcs(rows, links, self.seq, form))

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return how the event came about, and every event that is named."""
        lines = {str(seq): line for seq, line in self.lines.items()}
        return {"run": self.run, "seq": self.seq, "triggers": self.triggers, "made": self.made, "lines": lines}

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield the answer as an indented tree."""
        hint = screen.proof_hint(self.run, self.seq)
        yield printable.lines(screen.run_text(self.run), "", *Tree(self).lines(), "", hint)


def _explain_or_list(
    ledger: "Ledger",
    event: str | None = None,
    depth: int = 2,
    run: Run | None = declare(
        "RUN", "With --verdict: the run, by number, name, or a part of it that no other run has.", complete="runs"
    ),
    verdict: str | None = declare(
        "KIND", "Instead of an event: list violation, conflict, late, unattributed, or an invariant, such as i4."
    ),
) -> Answer:
    from .lookup import present, resolve_run
    from .table import Listing

    if (event is None) == (verdict is None):
        raise UsageError("why: expected an EVENT, as RUN:SEQ, or --run RUN and --verdict KIND")
    if event is not None:
        if run is not None:
            raise UsageError(f"--run {run}: expected it with --verdict only; EVENT names the run")
        return why(ledger, event, depth=depth)
    if run is None:
        raise UsageError(f"--verdict {verdict}: expected the run, too; give --run RUN")
    name = resolve_run(present(ledger)[0], run, ledger.demanded, is_whole=True)

    def hint(screen: Screen, first: Row) -> str:
        arguments = f"{printable.word(screen.path)} {screen.event_word(name, first['seq'])}"
        return f"`fsar-ledger why {arguments}` says why event {first['seq']} happened"

    return Listing(
        run=name,
        found=verdicts(ledger, name, f"{verdict}"),
        time="time_s",
        nothing=f"{verdict}",
        unseen="not everything that it rests on was observed",
        hint=hint,
        undrawn="found no event to draw, expected EVENT without --verdict",
        about={"verdict": verdict},
    )


@verb(
    "why out/ledger 1:148",
    "why out/ledger 1:148 --depth 1 --svg out/why.svg",
    "why out/ledger --run 2 --verdict violation",
    takes=("svg", *WIDE),
    call=_explain_or_list,
)
def why(
    ledger: "Ledger",
    event: Annotated[
        str | tuple[Run, int],
        argument("EVENT", "RUN:SEQ, or the event's place in the ledger, as for `prove`."),
    ],
    *,
    depth: int | None = declare(
        "N",
        "1: how the event came about; 2: also how the events behind it came about; and so on.",
        least=1,
        value=2,
    ),
) -> Why:
    """Say why an event happened: what triggered it, what the decision read, and what was answered.

    The run is replayed, and the decision is watched while it reads the state: every field and key, also missing ones,
    each with the event that last wrote it. With --verdict, list the verdicts of a kind on a run (a start against
    policy, a conflict of authority, a late task, a record without a principal) and the events behind each.

    Raises:
        UsageError: There is no such event, or the run cannot be made again, or not as it is recorded.
    """
    from .lookup import present, recorded
    from .prove import asked_event, found_event

    view, provenance = present(ledger)
    if isinstance(event, str):
        run, seq = found_event(view, *asked_event(view, event, ledger.demanded), ledger.demanded)
        return why_of(recorded(ledger, view, run), provenance, seq, depth)
    return why_of(recorded(ledger, view, event[0]), provenance, event[1], depth)


def verdicts(ledger: "Ledger", run: Run, kind: str) -> "Table":
    """Return the verdicts of one kind on a run, each with the events that made it.

    A kind is `violation` (a start against policy), `conflict` (of authority), `late` (a task), `unattributed` (a record
    that lacks a principal), or an invariant, as `i4`.

    Raises:
        UsageError: There is no such run or kind.
    """
    from fsar_ledger.metrics.invariants import verdict_rows
    from fsar_ledger.metrics.provenance import of_rows

    from .lookup import about_run, present
    from .table import Table

    with about_run(present(ledger)[0], run, ledger.demanded, is_whole=True) as (database, name, _):
        rows, query = verdict_rows(database, name, kind)
        return Table(rows, of_rows(database, query, name))


def why_of(record: "LedgerRun", provenance: "Provenance", seq: int, depth: int | None) -> Why:
    """Return why the event of the run happened.

    Raises:
        UsageError: There is no such event, the depth is not positive, or the run cannot be made again as recorded.
    """
    from fsar_ledger.analysis import lines_of
    from fsar_ledger.analysis.why import reasons

    if depth is not None and depth < 1:
        raise UsageError(f"{option('depth', depth)}: expected 1 or more")
    if not 0 <= seq < len(record.events):
        raise UsageError(
            f"EVENT {printable.value(record.run_id)}:{seq}: found {len(record.events):,} events in the run, expected a "
            f"seq from 0 to {len(record.events) - 1}"
        )
    result = reasons(record, seq, depth)
    lines = lines_of([record], [(record.run_id, named) for named in result.seqs])
    by_seq = {seq: line for (_, seq), line in sorted(lines.items())}
    return Why(**msgspec.structs.asdict(result), lines=by_seq, provenance=provenance)


def _links(seq: int, traces: "Sequence[DecisionTrace]") -> list[tuple[int, int, bool]]:
    """Return (cause, effect, whether it is the trigger) for each event that another rests on; `seq` is its batch."""
    links = []
    for trace in traces:
        effect = seq if trace is traces[0] else trace.seq
        links += [(cause, effect, cause == trace.triggered_by) for cause in trace.rests_on]
    return links


def _read_notes(traces: "Sequence[DecisionTrace]") -> dict[int, str]:
    """Return what the decision in question read of each event, by seq."""
    reads: dict[int, dict[str, dict[str, None]]] = {}
    for read in (*traces[0].scheduled_reads, *traces[0].reads):
        for seq in (read.written_by, *read.elements):
            if seq is not None:
                reads.setdefault(seq, {}).setdefault(read.place, {})[read.name] = None
    return {
        seq: "read: " + "; ".join(f"{place}: {printable.list_few(names)}" for place, names in places.items())
        for seq, places in reads.items()
    }


class Tree:
    """The answer as an indented tree, with the origin of each event once, where it is first needed from the top."""

    def __init__(self, found: Why) -> None:
        self._found = found
        self._made = {seq: trace for trace in found.made for seq in range(trace.seq, trace.seq + trace.count)}
        self._under = {found.made[0].seq: found.made[0].seq}
        for trace in found.made:
            for seq in trace.rests_on:
                if seq in self._made:
                    self._under.setdefault(self._made[seq].seq, trace.seq)
        self._told: set[int] = set()

    def lines(self) -> Iterator[str]:
        """Yield the event, its triggers, and how it came about."""
        yield self._line(self._found.seq)
        if self._found.triggers:
            yield ""
            yield "triggers, newest first"
            yield from (self._line(seq) for seq in self._found.triggers)
        yield ""
        yield from self._origin(self._found.made[0], "")

    def _line(self, seq: int) -> str:
        line = self._found.lines[seq]
        return f"{seq:>6} {line.time_s:>10.3f} s  {line.words}"

    def _origin(self, trace: "DecisionTrace", indent: str) -> Iterator[str]:
        """Yield how a batch came about, and below it what it rests on."""
        self._told.add(trace.seq)
        if trace.count > 1 and trace.origin != "founding":
            yield f"{indent}made at once: events {trace.seq} to {trace.seq + trace.count - 1}"
        if trace.handler is None:
            yield indent + _ORIGINS[trace.origin]
            return
        yield f"{indent}decided by {trace.handler} on {trace.command}"
        if trace.scheduled_by is not None:
            yield f"{indent}scheduled by {trace.scheduled_by}"
        for reply in trace.answers:
            yield f"{indent}asked {reply.port}: {printable.value(reply.question)}, answered {reply.answer}"
        groups = _by_writer((*trace.scheduled_reads, *trace.reads))
        if trace.triggered_by is not None:
            yield from self._below(
                trace, trace.triggered_by, "triggered by", groups.pop(trace.triggered_by, []), indent
            )
        for fact in trace.waited_for:
            yield from self._below(trace, fact, "waited for", groups.pop(fact, []), indent)
        unwritten = groups.pop(None, [])
        for seq, reads in groups.items():
            if seq is not None:
                yield from self._below(trace, seq, "read of", reads, indent)
        if unwritten:
            yield f"{indent}read before anything had written it"
            yield from (f"{indent}{INDENT}{read}" for read in unwritten)

    def _below(self, above: "DecisionTrace", seq: int, how: str, reads: Sequence[str], indent: str) -> Iterator[str]:
        """Yield an event that a batch rests on, what was read of it, and how it came about if it is explained here."""
        line, deeper = self._found.lines[seq], indent + INDENT
        yield f"{indent}{how} {seq}  {line.time_s:.3f} s  {line.words}"
        yield from (f"{deeper}{read}" for read in reads)
        trace = self._made.get(seq)
        if trace is None or trace.origin == "founding":
            return
        if trace.seq in self._told or self._under[trace.seq] != above.seq:
            parent = self._under[trace.seq]
            yield f"{deeper}(shown under {self._found.seq if parent == self._found.made[0].seq else parent})"
        else:
            yield from self._origin(trace, deeper + INDENT if reads else deeper)


def _by_writer(reads: "Sequence[Read]") -> dict[int | None, list[str]]:
    """Return what was read, a line for each place, by the event that wrote it; the earliest event first.

    The presence of a key is left out if a value under that key was read.
    """
    places = {read.place for read in reads}
    by_writer: dict[int | None, dict[str, dict[str, str]]] = {}
    for read in reads:
        if read.name.startswith("has ") and f"{read.place}[{read.name[4:]}]" in places:
            continue
        written = by_writer.setdefault(read.written_by, {})
        written.setdefault(read.place, {})[read.name] = f"{read.name} = {_value(read)}"
        for seq in read.elements:
            if seq != read.written_by:
                by_writer.setdefault(seq, {}).setdefault(read.place, {})[read.name] = f"{read.name}, in part"
    ordered = sorted(by_writer.items(), key=lambda item: -1 if item[0] is None else item[0])
    return {
        seq: [
            f"{printable.value(place)}: {printable.value(', '.join(names.values()), MAX_WORDS)}"
            for place, names in places.items()
        ]
        for seq, places in ordered
    }


def _value(read: "Read") -> str:
    if read.is_absent:
        return "absent"
    from .texts import json_bytes

    text = read.value if isinstance(read.value, str) else json_bytes(read.value).decode()
    return printable.value(text, MAX_VALUE) or '""'
