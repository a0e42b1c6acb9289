"""The results of studies as tables for people. Nothing here prints."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from fsar_ledger import printable
from fsar_ledger.api.fields import Row, plain
from fsar_ledger.api.names import known
from fsar_ledger.errors import UsageError
from fsar_ledger.metrics.effects import MADE_BY, Sensitivity, dozen, open_effects, reach
from fsar_ledger.metrics.multiverse import Chosen, Multiverse, Ranking
from fsar_ledger.metrics.study_results import Calibration, Comparison, Predictions, packaged, read
from fsar_ledger.printable import Shown
from fsar_ledger.studies.result import stale

from .tables import table

RESULTS: dict[str, type[Calibration | Predictions | Comparison]] = {
    "calibration": Calibration,
    "predictions": Predictions,
    "comparison": Comparison,
}
STUDIES = (*RESULTS, "sensitivity")

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


def shown(name: str, file: Path | None, *, wide: bool) -> Iterator[Shown]:
    """Yield the tables of a stored result, and whether it is stale.

    Raises:
        InvalidExperiment: There is no such study.
        UsageError: The file cannot be read, or none is given and the package has none.
        FsarLedgerError: It holds something else.
    """
    known("study", [name], STUDIES)
    if name == "sensitivity":
        if file is None:
            raise UsageError(f"study show sensitivity: expected a file of `{MADE_BY}`; the package has none")
        found = open_effects(file)
        yield from effects(found, wide=wide)
        differs = stale(found.about)
    else:
        kind = RESULTS[name]
        result = packaged(kind) if file is None else read(file, kind)
        if result is None:
            raise UsageError(f"study show {name}: expected a file of `{kind.MADE_BY}`; the package has none")
        for rows in _tables(result):
            yield table(rows, list(rows[0]), wide=wide)
            yield printable.line("")
        differs = stale(result)
    yield printable.line(f"stale: found results {differs}" if differs else "nothing that it rests on has changed since")


def _tables(result: Calibration | Predictions | Comparison) -> Iterator[list[Row]]:
    """Yield the tables of a result that have rows: the numbers of all scenarios together, and no single checks."""
    if isinstance(result, Calibration):
        parts = [plain(result.parameters), plain(result.residuals)]
    elif isinstance(result, Predictions):
        parts = [plain([one for one in result.numbers if one.scenario is None]), plain(result.cases)]
    else:
        outcomes: list[Row] = [
            {"name": one.name, "implies": one.implies, "held": one.held, "of": one.of, "holds": one.holds}
            for one in result.predictions
        ]
        parts = [plain(result.cells), outcomes]
    yield from filter(None, parts)


def effects(found: Sensitivity, *, wide: bool) -> Iterator[Shown]:
    """Yield how much was varied, and the table of the factors that matter most."""
    rows = dozen(found)
    still = sum(furthest == 0 for furthest in reach(found).values())
    yield printable.line(
        f"{len(found.about.factors)} factors, {found.about.evaluations:,} evaluations; {still} factors move "
        "nothing; in margins of the cell moved furthest:"
    )
    yield table(rows, list(rows[0]), wide=wide) if rows else printable.line("none moves anything")


def every_reading(found: Multiverse, *, wide: bool) -> Iterator[Shown]:
    """Yield the ranges, the rankings and the readings as tables."""
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


def _verdicts(rankings: Sequence[Ranking]) -> Iterator[str]:
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


def _columns(rows: Sequence[Row], columns: tuple[str, ...]) -> list[str]:
    """Return the columns to show: those of the setting after the first, those of `WHERE_ANY` at the end."""
    telling = [name for name in WHERE_TELLING if name in rows[0] and len({row[name] for row in rows}) > 1]
    return [columns[0], *telling, *columns[1:], *(name for name in WHERE_ANY if any(row.get(name) for row in rows))]


def _named(row: Ranking) -> Row:
    """Return the ranking with combinations of readings as text."""
    (told,) = plain([row])
    return {**told, "changed_under": _texts(row.changed_under), "fsar_not_best_under": _texts(row.fsar_not_best_under)}


def _texts(sets: tuple[Chosen, ...] | None) -> str | None:
    """Return the combinations in words; None where there are none, or nothing can be said."""
    return "; ".join(" + ".join(names) or OURS for names in sets) if sets else None
