"""The command `why`: why an event happened, and which events made a verdict."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli import completing
from fsar_ledger.cli.options import JsonOption, LedgerArgument, SvgOption, VerifiedOption, WideOption, examples
from fsar_ledger.cli.terminal import show
from fsar_ledger.errors import UsageError

if TYPE_CHECKING:
    from fsar_ledger.analysis.why import Made, Read
    from fsar_ledger.analysis.words import Line
    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.api.why import Why

EXAMPLES = examples(
    "fsar-ledger why out/ledger 1:148",
    "fsar-ledger why out/ledger 1:148 --depth 1 --svg out/why.svg",
    "fsar-ledger why out/ledger --run 2 --verdict violation",
)
MAX_WORDS = 1_000
MAX_VALUE = 80
INDENT = "    "


def why(
    ledger: LedgerArgument,
    event: Annotated[
        str | None,
        typer.Argument(
            metavar="[EVENT]", help="RUN:SEQ, or the event's place in the ledger, as for `prove`.", show_default=False
        ),
    ] = None,
    depth: Annotated[
        int,
        typer.Option(
            "--depth",
            metavar="N",
            min=1,
            help="1: how the event came about; 2: and how the events came about that it rests on; and so on.",
        ),
    ] = 2,
    svg: SvgOption = None,
    run: Annotated[
        str | None,
        typer.Option(
            "--run",
            metavar="RUN",
            help="With --verdict: the run, by number, name, or a part of it that no other run has.",
            show_default=False,
            autocompletion=completing.runs,
        ),
    ] = None,
    verdict: Annotated[
        str | None,
        typer.Option(
            "--verdict",
            metavar="KIND",
            help="Instead of an event: list violation, conflict, late, unattributed, or an invariant, as i4.",
            show_default=False,
        ),
    ] = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    wide: WideOption = False,
) -> None:
    """Say why an event happened: what triggered it, what the decision read, and what was answered.

    The run is made again, and the decision watched while it reads the state: every field and key, also those that were
    not there, each with the event that last wrote it. With --verdict, list the verdicts of a kind on a run (a start
    against policy, a conflict of authority, a late task, a record without a principal) and the events that made each.
    """
    from fsar_ledger.cli.answering import opened

    if (event is None) == (verdict is None):
        raise UsageError("why: expected an EVENT, as RUN:SEQ, or --run RUN and --verdict KIND")
    if verdict is not None and run is None:
        raise UsageError(f"--verdict {verdict}: expected the run, too; give --run RUN")
    if verdict is None and run is not None:
        raise UsageError(f"--run {run}: expected it with --verdict only; EVENT names the run")
    if verdict is not None and svg is not None:
        raise UsageError(f"--svg {svg}: found no event to draw, expected EVENT without --verdict")
    asked = opened(ledger, verified=verified)
    if event is not None:
        _event(ledger, asked, event, depth, svg, as_json=as_json)
    elif verdict is not None and run is not None:
        _verdicts(ledger, asked, run, verdict, as_json=as_json, wide=wide)


def _event(ledger: Path, asked: "Ledger", event: str, depth: int, svg: Path | None, *, as_json: bool) -> None:
    from fsar_ledger.cli.answering import warn
    from fsar_ledger.cli.output import answer_json, run_text, run_word
    from fsar_ledger.ledger.store.paths import require_outside

    if svg is not None:
        if svg.suffix != ".svg":
            raise UsageError(f"--svg {svg}: expected a name that ends in .svg")
        require_outside(svg, f"--svg {svg}")
    found = asked.why(event, depth=depth)
    if svg is not None:
        found.draw(svg)
    warn(ledger, found.provenance)
    if as_json:
        answer = {"run": found.run, "seq": found.seq, "triggers": found.triggers, "made": found.made}
        show(answer_json(found.provenance, answer | {"lines": {str(seq): line for seq, line in found.lines.items()}}))
        return
    number = asked.numbers().get(found.run)
    proven = printable.word(f"{run_word(found.run, number)}:{found.seq}")
    hint = f"`fsar-ledger prove {printable.word(ledger)} {proven}` proves event {found.seq} to others"
    show(printable.lines(run_text(found.run, number), "", *Tree(found).lines(), "", hint, *([str(svg)] if svg else ())))


def _verdicts(ledger: Path, asked: "Ledger", run: str, kind: str, *, as_json: bool, wide: bool) -> None:
    from fsar_ledger.cli.answering import warn
    from fsar_ledger.cli.output import answer_json, run_text, run_word
    from fsar_ledger.cli.tables import table

    name = asked.record(run).run_id
    found = asked.verdicts(name, kind)
    warn(ledger, found.provenance)
    rows, number = found.rows(), asked.numbers().get(name)
    if as_json:
        show(answer_json(found.provenance, {"run": name, "verdict": kind, "rows": rows}))
        return
    if not rows:
        nothing = (
            f"no {kind} on record; not all that it rests on was observed"
            if found.provenance.not_observed
            else f"no {kind}"
        )
        show(printable.lines(run_text(name, number), nothing))
        return
    shown = [{**row, "time_s": f"{row['time_s']:.3f}"} for row in rows]
    first = printable.word(f"{run_word(name, number)}:{rows[0]['seq']}")
    hint = f"`fsar-ledger why {printable.word(ledger)} {first}` says why event {rows[0]['seq']} happened"
    above = printable.lines(run_text(name, number), "")
    show(printable.joined(above, table(shown, list(shown[0]), wide=wide), printable.lines("", hint)))


class Tree:
    """The answer as an indented tree. How an event came about is told once, where it is first needed from the top."""

    def __init__(self, found: "Why") -> None:
        self._found = found
        self._made = {seq: one for one in found.made for seq in range(one.seq, one.seq + one.count)}
        self._under = {found.made[0].seq: found.made[0].seq}
        for one in found.made:
            for seq in one.rests_on:
                if seq in self._made:
                    self._under.setdefault(self._made[seq].seq, one.seq)
        self._told: set[int] = set()

    def lines(self) -> Iterator[str]:
        """Yield the event, its triggers, and how it came about."""
        yield self._line(self._found.seq)
        if self._found.triggers:
            yield ""
            yield "triggers, the last one first"
            yield from (self._line(seq) for seq in self._found.triggers)
        yield ""
        yield from self._origin(self._found.made[0], "")

    def _line(self, seq: int) -> str:
        line = self._found.lines[seq]
        return f"{seq:>6} {line.time_s:>10.3f} s  {_words(line)}"

    def _origin(self, one: "Made", indent: str) -> Iterator[str]:
        """Yield how a batch came about, and below it what it rests on."""
        self._told.add(one.seq)
        if one.count > 1 and one.origin != "founding":
            yield f"{indent}made at once: events {one.seq} to {one.seq + one.count - 1}"
        if one.origin in ("founding", "world"):
            yield indent + ("the run begins with it" if one.origin == "founding" else "a fact of the world")
            return
        yield f"{indent}decided by {one.handler} on {one.command}"
        if one.scheduled_by is not None:
            yield f"{indent}scheduled by {one.scheduled_by}"
        for answered in one.answers:
            yield f"{indent}asked {answered.port}: {printable.value(answered.question)}, answered {answered.answer}"
        groups = _by_writer((*one.scheduled_reads, *one.reads))
        if one.triggered_by is not None:
            yield from self._below(one, one.triggered_by, "triggered by", groups.pop(one.triggered_by, []), indent)
        for fact in one.waited_for:
            yield from self._below(one, fact, "waited for", groups.pop(fact, []), indent)
        unwritten = groups.pop(None, [])
        for seq, reads in groups.items():
            if seq is not None:
                yield from self._below(one, seq, "read of", reads, indent)
        if unwritten:
            yield f"{indent}read, and nothing had written it"
            yield from (f"{indent}{INDENT}{read}" for read in unwritten)

    def _below(self, above: "Made", seq: int, how: str, reads: Sequence[str], indent: str) -> Iterator[str]:
        """Yield an event that a batch rests on, what was read of it, and how it came about if its place is here."""
        line, deeper = self._found.lines[seq], indent + INDENT
        yield f"{indent}{how} {seq}  {line.time_s:.3f} s  {_words(line)}"
        yield from (f"{deeper}{read}" for read in reads)
        made = self._made.get(seq)
        if made is None or made.origin == "founding":
            return
        if made.seq in self._told or self._under[made.seq] != above.seq:
            under = self._under[made.seq]
            yield f"{deeper}(told under {self._found.seq if under == self._found.made[0].seq else under})"
        else:
            yield from self._origin(made, deeper + INDENT if reads else deeper)


def _words(line: "Line") -> str:
    action = "" if line.action_id is None else f"{printable.value(line.action_id)}  "
    return action + printable.value(line.text, MAX_WORDS)


def _by_writer(reads: "Sequence[Read]") -> dict[int | None, list[str]]:
    """Return by the event that wrote it what was read, a line for each place; the earliest event first.

    What the presence of a key says is left out where something under that key was read.
    """
    places = {read.place for read in reads}
    found: dict[int | None, dict[str, dict[str, str]]] = {}
    for read in reads:
        if read.name.startswith("has ") and f"{read.place}[{read.name[4:]}]" in places:
            continue
        of_writer = found.setdefault(read.written_by, {})
        of_writer.setdefault(read.place, {})[read.name] = f"{read.name} = {_value(read)}"
        for seq in read.elements:
            if seq != read.written_by:
                found.setdefault(seq, {}).setdefault(read.place, {})[read.name] = f"{read.name}, in part"
    ordered = sorted(found.items(), key=lambda one: -1 if one[0] is None else one[0])
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
    from fsar_ledger.api.fields import json_bytes

    shown = read.value if isinstance(read.value, str) else json_bytes(read.value).decode()
    return printable.value(shown, MAX_VALUE) or '""'
