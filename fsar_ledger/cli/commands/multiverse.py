"""The command `multiverse`."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    CsvOption,
    JsonOption,
    LedgerArgument,
    PoolOption,
    RawOption,
    SvgOption,
    VerifiedOption,
    WideOption,
    examples,
)
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show

if TYPE_CHECKING:
    from fsar_ledger.api.fields import Row
    from fsar_ledger.metrics.multiverse import Chosen, Multiverse, Ranking

EXAMPLES = examples(
    "fsar-ledger multiverse out/ledger",
    "fsar-ledger multiverse out/ledger --metric authority_conflicts --json",
    "fsar-ledger multiverse out/ledger --metric human_intervention --svg out/multiverse.svg",
)
OURS = "our reading"
CELL = ("metric", "architecture", "paper", "ours", "lowest", "highest", "combinations", "most_moving", "moved_by")
RANKING = (
    "metric",
    "better",
    "order",
    "combinations",
    "same_order",
    "changed_under",
    "fsar_best",
    "fsar_not_best_under",
)
WHERE_TELLING = ("configuration", "fleet_size", "seed", "kind", "source", "model_version", "constants")
"""Columns that a table for people shows only where they tell rows apart."""
WHERE_ANY = ("undefined", "runs_not_observed")
"""Columns that it shows only where a value is not 0."""

MetricOption = Annotated[
    list[str] | None,
    typer.Option("--metric", metavar="NAME", help="Only this metric; may be repeated.", show_default="all"),
]


def multiverse(
    ledger: LedgerArgument,
    metric: MetricOption = None,
    pool: PoolOption = None,
    svg: SvgOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
    wide: WideOption = False,
) -> None:
    """Compute the results table under every reading that the paper's text allows.

    For each cell: the paper's number, ours, the lowest and the highest mean over all combinations of readings, and the
    reading that moves it most when it alone replaces ours. For each metric: whether the order of the architectures is
    the same under all combinations, under how many FSAR is best, and the smallest combinations that change either.
    Nothing is simulated again. --json also has the mean under each combination.
    """
    from fsar_ledger.api.fields import csv_text, plain
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.output import answer_json, check_form
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.metrics.multiverse import Cell, Multiverse

    check_form(as_json=as_json, as_csv=as_csv, raw=raw)
    if svg is not None:
        require_outside(svg, f"--svg {svg}")
    asked = opened(ledger, verified=verified)
    with Progress("read", "combinations of readings") as progress:
        found = asked.multiverse(metric, pool, progress=progress)  # type: ignore[arg-type]
    provenance = found.provenance
    if as_json:
        answer = {name: getattr(found, name) for name in Multiverse.__struct_fields__}
        show(answer_json(provenance, answer))
    elif as_csv:
        show(csv_text(plain(found.cells), Cell.__struct_fields__, raw=raw), raw=raw)
    else:
        show(printable.joined(*_told(found, wide=wide)))
    if svg is not None:
        found.draw(svg)
    warn(ledger, provenance)


def _told(found: "Multiverse", *, wide: bool) -> "Iterator[printable.Shown]":
    """Yield the ranges, the rankings and the readings as tables."""
    from fsar_ledger.api.fields import plain
    from fsar_ledger.cli.tables import table

    if not found.cells:
        yield printable.line("no runs to read")
        return
    cells, rankings = plain(found.cells), [_named(row) for row in found.rankings]
    readings: list[Row] = [{"name": one.name, "instead of": one.reading, "says": one.title} for one in found.readings]
    for number, (rows, columns) in enumerate(((cells, CELL), (rankings, RANKING), (readings, tuple(readings[0])))):
        if number:
            yield printable.line("")
        yield table(rows, _columns(rows, columns), wide=wide)
        if rows is rankings:
            yield printable.lines("", *_verdicts(found.rankings))


def _verdicts(rankings: "Sequence[Ranking]") -> Iterator[str]:
    """Yield in how many rankings FSAR is best, and in how many our order stays, under every combination."""
    for what, counted in (
        ("FSAR is the best one", "fsar_best"),
        ("the order of the architectures is ours", "same_order"),
    ):
        judged = [row for row in rankings if getattr(row, counted) is not None]
        always = sum(getattr(row, counted) == row.combinations for row in judged)
        never = sum(getattr(row, counted) == 0 for row in judged)
        some = len(judged) - always - never
        if judged:
            yield (
                f"{what} under every combination in {always} of {printable.counted(len(judged), 'ranking')}, under "
                f"some in {some}, under none in {never}"
            )
        else:
            yield (
                f"whether {what}: nothing to rank; that takes means of two "
                f"architectures{', one of them FSAR' if counted == 'fsar_best' else ''}"
            )


def _columns(rows: "Sequence[Row]", columns: tuple[str, ...]) -> list[str]:
    """Return the columns to show: those of the setting after the first, those of `WHERE_ANY` at the end."""
    telling = [name for name in WHERE_TELLING if name in rows[0] and len({row[name] for row in rows}) > 1]
    return [columns[0], *telling, *columns[1:], *(name for name in WHERE_ANY if any(row.get(name) for row in rows))]


def _named(row: "Ranking") -> "Row":
    """Return the ranking with combinations of readings as text."""
    from fsar_ledger.api.fields import plain

    (told,) = plain([row])
    return {**told, "changed_under": _texts(row.changed_under), "fsar_not_best_under": _texts(row.fsar_not_best_under)}


def _texts(sets: "tuple[Chosen, ...] | None") -> str | None:
    """Return the combinations in words; None where there are none, or nothing can be said."""
    return "; ".join(" + ".join(names) or OURS for names in sets) if sets else None
