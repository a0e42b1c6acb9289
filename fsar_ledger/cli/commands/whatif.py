"""The command `whatif`: forks of runs with a change, and what the change does."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    AuditedOption,
    JsonOption,
    LedgerArgument,
    VerifiedOption,
    WideOption,
    examples,
)
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show
from fsar_ledger.errors import UsageError
from fsar_ledger.printable import Shown, counted

if TYPE_CHECKING:
    from fsar_ledger.analysis.whatif import Effects
    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.api.whatif import WhatIf

EXAMPLES = examples(
    'fsar-ledger whatif out/ledger --run 1 --change "drop window:*"',
    'fsar-ledger whatif out/ledger --run 1 --change "add window:fleet/B1 20s for 5s" --out out/forks',
    'fsar-ledger whatif out/ledger --all-runs --architecture fsar --change "rule fleet deny robot=B1 from 20s"',
    "fsar-ledger whatif out/ledger --run 1 --list",
)
AFTER_INTERRUPTION = "what is committed stays; the same call again makes what is missing"

NAMES = {"base_mean": "base", "fork_mean": "fork"}
COLUMNS = (
    *("metric", "differing_pairs", "base_mean", "fork_mean", "difference"),
    *("low", "high", "interval", "test", "p", "gain"),
)


def whatif(
    ledger: LedgerArgument,
    run: Annotated[
        str | None,
        typer.Option("--run", metavar="RUN", help="Fork this run: its number, its name, or a unique part of it."),
    ] = None,
    all_runs: Annotated[bool, typer.Option("--all-runs", help="Fork every simulated run.")] = False,
    change: Annotated[
        list[str] | None,
        typer.Option("--change", metavar="TEXT", help="What is otherwise; may be repeated.", show_default=False),
    ] = None,
    changes: Annotated[
        Path | None, typer.Option("--changes", metavar="FILE", help="A .toml file of changes.", show_default=False)
    ] = None,
    architecture: AuditedOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="LEDGER", help="Store each fork beside its base in this ledger.", show_default="nowhere"
        ),
    ] = None,
    lists: Annotated[bool, typer.Option("--list", help="List what changes of the run can name.")] = False,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    wide: WideOption = False,
) -> None:
    """Fork runs with a change, and show what it does: in one run, or over all in pairs.

    A fork repeats its run up to the change and plays on under the same draws, so that nothing differs but what the
    change does. Changes are `drop FACT`, `move FACT +5s`, `add KIND:WHO TIME for TIME`, `answer QUESTION ANSWER`,
    `rule`, `trust`, `budget`, `density`, `set NAME=VALUE`, `architecture NAME`, `without MECHANISM`; docs/replay.md has
    each. The table has every metric in base and fork; over all runs, the difference with a 95 % interval, how many
    pairs differ, p, and how many times as many independent runs would be as precise (gain).
    """
    from fsar_ledger.cli.answering import opened, warn

    asked = opened(ledger, verified=verified)
    if lists:
        _list(ledger, asked, run, as_json=as_json, wide=wide)
        return
    if (run is None) == (not all_runs):
        found = "--run and --all-runs" if all_runs else "neither --run nor --all-runs"
        raise UsageError(f"found {found}, expected one of them")
    if run is not None and architecture:
        raise UsageError(f"--run {run} and --architecture: found one run, expected --architecture with --all-runs")
    texts = [*(change or ()), *([] if changes is None else [_file(changes)])]
    if not texts:
        raise UsageError("found no change, expected --change TEXT or --changes FILE; --list says what can be named")
    with Progress("played", "forks") as progress:
        answer = asked.whatif(texts, run, architecture=architecture, out=out, progress=progress)
    warn(ledger, answer.provenance)
    show(_json(answer) if as_json else _text(asked, answer, out, wide=wide))


def _file(place: Path) -> str:
    if place.suffix != ".toml":
        raise UsageError(f"--changes {place}: expected a .toml file")
    return str(place)


def _list(ledger: Path, asked: "Ledger", run: str | None, *, as_json: bool, wide: bool) -> None:
    from fsar_ledger.cli.answering import warn
    from fsar_ledger.cli.output import answer_json
    from fsar_ledger.cli.tables import table

    if run is None:
        raise UsageError("--list: found no run, expected --run RUN")
    found = asked.changeable(run)
    warn(ledger, found.provenance)
    rows = found.rows()
    show(answer_json(found.provenance, {"changeable": rows}) if as_json else table(rows, found.columns, wide=wide))


def _json(answer: "WhatIf") -> Shown:
    from msgspec import structs

    from fsar_ledger.cli.output import answer_json

    forks = [structs.asdict(one) for one in answer.forks]
    kept = None if answer.kept is None else {"size": answer.kept.size, "root": answer.kept.root}
    effects = [structs.asdict(one) for one in answer.effects]
    told = None if answer.story is None else structs.asdict(answer.story)
    story = told and {name: value for name, value in told.items() if name != "provenances"}
    document = {"changes": answer.changes, "story": story, "forks": forks, "effects": effects, "kept": kept}
    return answer_json(answer.provenance, document)


def _text(asked: "Ledger", answer: "WhatIf", out: Path | None, *, wide: bool) -> Shown:
    from fsar_ledger.cli.output import run_text
    from fsar_ledger.cli.stories import story

    parts = [printable.lines(*(f"change: {one}" for one in answer.changes))]
    if answer.story is not None:
        name = answer.story.first
        parts += [
            printable.lines(run_text(name, asked.numbers().get(name)), ""),
            story(answer.story, ("base", "fork"), wide=wide),
            printable.lines(""),
        ]
    else:
        parts += [_effects(one, wide=wide) for one in answer.effects]
    if answer.kept is not None and out is not None:
        place = printable.word(out)
        parts.append(
            printable.lines(
                f"kept in {place}: {counted(len(answer.forks), 'fork')}, each beside its base, root {answer.kept.root}"
            )
        )
    return printable.joined(*parts)


def _effects(found: "Effects", *, wide: bool) -> Shown:
    from fsar_ledger.api.fields import plain
    from fsar_ledger.cli.tables import table

    rows = [{NAMES.get(name, name): row[name] for name in COLUMNS} for row in plain(found.rows)]
    who = found.architecture or "-"
    if found.configuration not in (None, "full"):
        who += f" {found.configuration}"
    head = f"{who}: {counted(found.pairs, 'pair')}, {found.diverging:,} of them part"
    return printable.joined(printable.lines("", head), table(rows, list(rows[0]), wide=wide), printable.lines(""))
