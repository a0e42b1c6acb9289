"""The command `compare`: a paired table of any two sides, from one ledger or two."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    CsvOption,
    JsonOption,
    LedgerArgument,
    PoolOption,
    RawOption,
    VerifiedOption,
    WideOption,
    examples,
)
from fsar_ledger.cli.terminal import say, show
from fsar_ledger.printable import counted

if TYPE_CHECKING:
    from fsar_ledger.api.compare import Comparison
    from fsar_ledger.metrics.sides import LeftOut, Paired, Side, SideRow

EXAMPLES = examples(
    "fsar-ledger compare out/ledger --first fsar --second cfc",
    "fsar-ledger compare out/ledger --first fsar --second dhma --by scenario",
    "fsar-ledger compare out/ledger out/large --first fsar --verified --json",
)
LEFT_OUT = {
    "facts": "did not meet the same facts of the world, although made under the same constants",
    "repeated": "cannot be told from others: one side has several runs of one seed, scenario and number",
    "unobserved": "are not known to have met the same world, which one of them does not observe",
}
FAULTS = ("facts", "repeated")
"""Differences that no experiment makes on purpose, as in `statistics`."""
SIDE_HELP = (
    "ARCHITECTURE[:CONFIGURATION][@CONSTANTS][/ROBOTS]: `fsar`, `fsar:without-layered-recovery`, `cfc@B`, "
    "`dhma/8`; constants by the letters of `info`."
)
FirstOption = Annotated[
    str | None, typer.Option("--first", metavar="NAME", help=SIDE_HELP, show_default="the first of two")
]
SecondOption = Annotated[
    str | None,
    typer.Option(
        "--second", metavar="NAME", help="The same; of OTHER, if it is given.", show_default="the other of two"
    ),
]


def compare(
    ledger: LedgerArgument,
    other: Annotated[
        Path | None, typer.Argument(metavar="OTHER", help="The ledger of the second side.", show_default="the same")
    ] = None,
    first: FirstOption = None,
    second: SecondOption = None,
    by: Annotated[
        str | None, typer.Option(metavar="scenario", help="One row for each scenario.", show_default=False)
    ] = None,
    pool: PoolOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
    wide: WideOption = False,
) -> None:
    """Compare any two sides in pairs, from one ledger or two.

    A side is an architecture with its configuration, constants, model and fleet size.

    Runs are paired by seed, scenario and number. For each metric: both means, first minus second with its 95 %
    interval, the number of pairs that differ at all, p of the paired t-test, or of the exact sign test where few
    differ, Holm over these tests, and d_z. The t-test has as many degrees of freedom as pairs differ, less one;
    `statistics` counts every pair, so that its p differs. Containment and latency are ratios over all pairs. The answer
    also says how many pairs met the same facts of the world, how many only the same draws, and which constants differ.
    """
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import check_form

    check_form(as_json=as_json, as_csv=as_csv, raw=raw)
    second_ledger = None if other is None else opened(other, verified=verified)
    found = opened(ledger, verified=verified).compare(first, second, second_ledger, by, pool)  # type: ignore[arg-type]
    if as_json:
        _show_json(found)
    else:
        _show_text(found.sides, found, by_scenario=by is not None, as_csv=as_csv, raw=raw, wide=wide)
    for place, provenance in zip((ledger, other), found.provenances, strict=False):
        if place is not None:
            warn(place, provenance)
    if any(one.differs in FAULTS for one in found.left_out):
        raise typer.Exit(1)


def _show_json(found: "Comparison") -> None:
    from msgspec import structs

    from fsar_ledger.cli.output import answer_json
    from fsar_ledger.metrics.sides import Paired

    both = found.sides
    described = [{"name": side.name, **structs.asdict(side)} for side in both]
    provenance, *others = found.provenances
    further = [
        {
            "head": one.head and {"size": one.head.size, "root": one.head.root},
            "rows_verified": one.rows_verified,
            **one.answer(),
        }
        for one in others
    ]
    document = {
        "other": further[0] if further else None,
        "first": described[0],
        "second": described[1],
        "pairs": found.pairs,
        **{field.name: getattr(found, field.name) for field in structs.fields(Paired)},
        "remarks": [*_pairing(both, found), *_missing(both, found), *_how_to_read(found)],
    }
    show(answer_json(provenance, document))


def _show_text(
    both: "tuple[Side, Side]", found: "Paired", *, by_scenario: bool, as_csv: bool, raw: bool, wide: bool
) -> None:
    from fsar_ledger.api.fields import csv_text, plain
    from fsar_ledger.cli.tables import table
    from fsar_ledger.metrics.sides import SideRow

    rows = plain(found.rows)
    columns = [name for name in SideRow.__struct_fields__ if name != "scenario" or by_scenario]
    above, below = _pairing(both, found), [*_missing(both, found), *_how_to_read(found)]
    if as_csv:
        say(*above, *below)
        show(csv_text(rows, columns, raw=raw), raw=raw)
        return
    dull = {"seed": found.seeds <= 1, "family_tests": True}
    shown = table(rows, [name for name in columns if not dull.get(name)], wide=wide) if rows else printable.lines()
    blank = [""] if rows else []
    show(printable.joined(printable.lines(*above, *blank), shown, printable.lines(*(blank if below else []), *below)))


def _pairing(both: "tuple[Side, Side]", found: "Paired") -> list[str]:
    """Return lines on what is compared, what the pairs share, and which constants differ."""
    first, second = both
    lines = [f"first: {_described(first)}", f"second: {_described(second)}"]
    if not found.pairs:
        left = " that is not left out" if found.left_out else ""
        lines.append(
            f"nothing to compare: no run of both has the same seed, scenario and number{left}; simulate one as the "
            "other"
        )
        lines += [f"found {side.held()}" for side in both]
    else:
        lines.append(f"{counted(found.pairs, 'pair')} by seed, scenario and number: {_shared(found)}")
        if first.fleet_size != second.fleet_size:
            lines.append(
                f"the fleets differ in size ({first.fleet_size} and {second.fleet_size} robots): the robots that both "
                "have meet what is drawn for them"
            )
    lines += [f"left out: {_left_out(one)}" for one in found.left_out]
    differing = [f"{one.name}={one.first_value} and {one.second_value}" for one in found.constants]
    unread = " as far as they are on record" if first.parameter_set is None or second.parameter_set is None else ""
    said = (
        f"the constants are the same{unread}"
        if not differing
        else f"constants that differ, first and second: {printable.some(differing)}"
    )
    return [*lines, said]


def _described(side: "Side") -> str:
    named = (side.kind, side.source, side.model_version and f"model {side.model_version}")
    return f"{side}, {', '.join(printable.value(one) for one in named if one)}"


def _shared(found: "Paired") -> str:
    """Return how many pairs share their facts, only their draws, or only their seed."""
    parts = {
        "met the same facts of the world": found.same_facts,
        "share what was drawn, but not the facts, because their constants or robots differ": found.same_draws,
        "share only seed, scenario and number, because their models differ or are not on record": found.same_seed,
    }
    return "; ".join(f"{count:,} {what}" for what, count in parts.items() if count)


def _left_out(one: "LeftOut") -> str:
    place: dict[str, Any] = one.one
    scenario, first, second = (printable.value(str(place[name])) for name in ("scenario", "first", "second"))
    where = f"first under seed {place['seed']}, {scenario}, run {place['run']}: {first} and {second}"
    return f"{counted(one.pairs, 'pair')} that {LEFT_OUT[one.differs]}; {where}"


def _missing(both: "tuple[Side, Side]", found: "Paired") -> list[str]:
    """Return lines on what the numbers leave out."""
    lines = []
    for side, alone, which in zip(both, (found.first_alone, found.second_alone), ("first", "second"), strict=True):
        nameless = side.run_count - side.named_count
        if found.pairs and alone:
            lines.append(f"{counted(alone, 'run')} of the {which} side {'has' if alone == 1 else 'have'} no partner")
        if found.pairs and nameless:
            lines.append(
                f"{counted(nameless, 'run')} of the {which} side without seed, scenario, number or size "
                f"{'is' if nameless == 1 else 'are'} in no pair"
            )
    if found.pairs and found.absent:
        lines.append(
            f"no pair of runs in which both have a value of {', '.join(found.absent)}: undefined, or not observed"
        )
    return lines


def _how_to_read(found: "Paired") -> list[str]:
    """Return lines on how to read the numbers, and why some rows have none."""
    from fsar_ledger.metrics.definitions import metric_named

    if not found.rows:
        return []
    alike = [row for row in found.rows if row.n and not row.differing_pairs]
    few = [row for row in found.rows if row.test == "sign" and metric_named(row.metric).scale != "yes-no"]
    lines = [
        (
            "differences are first minus second; containment and latency are ratios over all pairs; Holm adjusts "
            f"{found.rows[0].family_tests} tests together"
        )
    ]
    if fewer := [row for row in found.rows if row.test == "paired t" and row.differing_pairs < row.n]:
        lines.append(
            "paired t has as many degrees of freedom as pairs differ, less one; `statistics` counts every pair, so "
            f"that its p differs: {_cells(fewer)}"
        )
    if any(row.metric == "human_intervention" for row in found.rows):
        lines.append("human_intervention is the share of runs that called the fleet supervisor")
    if alike:
        lines.append(f"no pair differs, so there is no test: {_cells(alike)}")
    if few:
        lines.append(f"exact sign test, since few pairs differ, or all alike: {_cells(few)}")
    return lines


def _cells(rows: "list[SideRow]") -> str:
    return printable.some(
        [row.metric if row.scenario is None else f"{row.metric} ({printable.value(row.scenario)})" for row in rows]
    )
