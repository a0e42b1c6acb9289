"""Compares the predictions with the paper's numbers, and with the registered implications of its claims.

It reads only the result of `predictions.py`: nothing is simulated here, and the file is never replaced. No program can
guarantee that a number was not predicted again after the comparison; `tests/history.py` shows it from the commits of
the repository.
"""

from collections.abc import Callable, Iterator
from itertools import combinations, pairwise
from os import PathLike
from pathlib import Path
from typing import Any

import msgspec

from fsar_ledger.base.errors import FsarLedgerError, UsageError
from fsar_ledger.base.publishing import require_another
from fsar_ledger.events.configuration import FULL, MECHANISMS, PAPER_ARCHITECTURES, Configuration, without
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.definitions import Place, Table, printed, published_metrics
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.study_results import Cell, Check, Comparison, Outcome, Predicted, Predictions, read
from fsar_ledger.metrics.verdicts import MARGINS, Answer

from .predictions import CASES, SEEDS
from .result import require_out, stale, write

SAME = 22  # cells of 24 that must have the same answer for any seed; registered as `seeds`
SUCCESS, LOCALITY, CONFLICTS = "coordination_success", "governance_locality", "authority_conflicts"
COUNTS = tuple(metric.name for metric in published_metrics() if metric.scale == "count")
"""Metrics without an upper bound; the others of the ablation table are shares."""
TABLES: dict[Table, str] = {"results": CASES, "ablation": "ablation", "ablation_text": "ablation", "scaling": "scaling"}
"""The predictions that each table is compared with, as `PlannedExperiment.of`."""


class NotPredicted(Exception):
    """Raised when a number is not among the predictions; the message names it."""


class Numbers:
    """The predicted numbers, by experiment and cell."""

    def __init__(self, every: list[Predicted]) -> None:
        mean_index = Predicted.__struct_fields__.index("mean")  # the fields before it identify the number
        self._by_place = {msgspec.structs.astuple(number)[:mean_index]: number for number in every}

    def find(
        self,
        of: str,
        metric: str,
        architecture: Architecture | str = "fsar",
        *,
        seed: int | None = None,
        size: int = 4,
        teams: int | None = None,
        encounter_s: float = 90.0,
        configuration: Configuration | str = FULL,
        scenario: str | None = None,
    ) -> Predicted:
        """Return one prediction. Raises: NotPredicted."""
        place = (of, seed, size, teams, encounter_s, configuration, architecture, scenario, metric)
        if (predicted := self._by_place.get(place)) is None:
            raise NotPredicted(str(place))
        return predicted

    def mean(self, *place: Any, **named: Any) -> float | None:
        """Return the mean of one prediction. Raises: NotPredicted."""
        return self.find(*place, **named).mean


def judge(predictions: str | PathLike[str], out: str | PathLike[str]) -> None:
    """Compare predicted numbers with the paper's, and write the comparison; nothing is simulated.

    Raises:
        FsarLedgerError: the file is not such a record, or lacks a number.
        UsageError: it cannot be read, is of another model or other constants, or `out` is the same file or lies inside
            a ledger.
        WriteFailed: `out` cannot be written.
    """
    predictions, out = Path(predictions), Path(out)
    require_out(out)
    require_another(out, f"--out {out}", predictions, "PREDICTIONS")
    record = read(predictions, Predictions)
    if differs := stale(record):
        raise UsageError(
            f"{predictions}: found predictions {differs}; judge them with the version that wrote them, or predict again"
        )
    try:
        write(out, compared(record))
    except NotPredicted as error:
        raise FsarLedgerError(
            f"{predictions}: found no {error}, expected everything that `{Predictions.MADE_BY}` writes; write it again"
        ) from error


def compared(found: Predictions) -> Comparison:
    """Return all cells and predictions with their answers. Raises: NotPredicted if a number is missing."""
    numbers = Numbers(found.numbers)
    cells = [_cell(numbers, place) for table in TABLES for place in printed(table)]
    outcomes = [
        _outcome(prediction.name, prediction.implies, list(CHECKS[prediction.name](numbers)))
        for prediction in registration().prediction
    ]
    return Comparison(
        model_version=found.model_version,
        parameters=found.parameters,
        rules=found.rules,
        cells=cells,
        predictions=outcomes,
    )


def _cell(numbers: Numbers, place: Place) -> Cell:
    where: dict[str, Any] = {"size": place.fleet_size, "configuration": place.configuration, "scenario": place.scenario}
    predicted = numbers.find(TABLES[place.table], place.metric, place.architecture, **where)
    one_team = (
        numbers.mean("scaling", place.metric, place.architecture, teams=1, **where) if place.fleet_size > 4 else None
    )
    paper, declaration = printed(place.table)[place].value, registration().declaration_for(place.table, place._asdict())
    judged = verdicts.judge(predicted, paper)
    by_text: dict[str, Answer | None] = {"cannot_follow": "no", "unspecified": None}
    return Cell(
        **place._asdict(),
        kind=declaration.kind,
        paper=paper,
        ours=predicted.mean,
        ours_one_team=one_team,
        n=predicted.n,
        margin=judged.margin,
        low=judged.low,
        high=judged.high,
        distance=judged.distance,
        gives=by_text.get(declaration.kind, judged.gives),
    )


def _outcome(name: str, implies: str, checks: list[Check]) -> Outcome:
    answers = [check.holds for check in checks]
    holds = False if False in answers else None if None in answers or not answers else True
    return Outcome(name=name, implies=implies, holds=holds, held=answers.count(True), of=len(answers), checks=checks)


# --- the implications of each prediction, as registered ---


def _seeds(numbers: Numbers) -> Iterator[Check]:
    cells = list(printed("results").items())

    def answers(of: str, seed: int | None) -> list[Answer]:
        predicted = (numbers.find(of, place.metric, place.architecture, seed=seed) for place, _ in cells)
        return [verdicts.judge(number, paper.value).gives for number, (_, paper) in zip(predicted, cells, strict=True)]

    first = answers(CASES, None)
    for seed in SEEDS:
        same = sum(answer == other for answer, other in zip(first, answers("seeds", seed), strict=True))
        yield _check(f"cells answered as with the seeds of the verdicts, with seed {seed}", same, low=SAME)


def _twelve(numbers: Numbers) -> Iterator[Check]:
    for metric in dict.fromkeys(place.metric for place in printed("scaling")):
        for architecture in PAPER_ARCHITECTURES:
            for teams in (None, 1):
                eight, twelve, sixteen = (
                    numbers.mean("scaling", metric, architecture, size=size, teams=teams) for size in (8, 12, 16)
                )
                yield _between(
                    f"{metric}, {architecture}, 12 robots, {_teams(teams)}", twelve, (eight, sixteen), MARGINS[metric]
                )


def _twenty_eight(numbers: Numbers) -> Iterator[Check]:
    for teams in (None, 1):
        at_16, at_28 = (numbers.mean("scaling", LOCALITY, size=size, teams=teams) for size in (16, 28))
        yield _between(f"{LOCALITY}, fsar, 28 robots, {_teams(teams)}", at_28, (at_16,), MARGINS[LOCALITY])
        falls: dict[str, float | None] = {}
        for architecture in PAPER_ARCHITECTURES:
            before, after = (
                numbers.mean("scaling", SUCCESS, architecture, size=size, teams=teams) for size in (16, 28)
            )
            falls[architecture] = None if before is None or after is None else before - after
        for architecture in ("cfc", "dhma"):
            text = f"fall of {SUCCESS} from 16 to 28 robots, fsar and {architecture}, {_teams(teams)}"
            yield _less(text, falls["fsar"], falls[architecture])


def _loads(numbers: Numbers) -> Iterator[Check]:
    def mean_at(metric: str, architecture: str, teams: int) -> float | None:
        of, working = ("loads", teams) if teams in (2, 3) else ("scaling", 1 if teams == 1 else None)
        return numbers.mean(of, metric, architecture, size=16, teams=working)

    for architecture in PAPER_ARCHITECTURES:
        for fewer, more in pairwise(range(1, 5)):
            before, after = mean_at(SUCCESS, architecture, fewer), mean_at(SUCCESS, architecture, more)
            high = None if before is None else before + MARGINS[SUCCESS]
            yield _check(f"{SUCCESS}, {architecture}, {_teams(more)}", after, high=high, is_known=before is not None)
            before, after = mean_at(CONFLICTS, architecture, fewer), mean_at(CONFLICTS, architecture, more)
            low = None if before is None else before - MARGINS[CONFLICTS]
            yield _check(f"{CONFLICTS}, {architecture}, {_teams(more)}", after, low=low, is_known=before is not None)
    for teams in range(1, 5):
        for architecture in ("cfc", "dhma"):
            yield _less(
                f"{CONFLICTS}, fsar and {architecture}, {_teams(teams)}",
                mean_at(CONFLICTS, "fsar", teams),
                mean_at(CONFLICTS, architecture, teams),
            )


def _encounters(numbers: Numbers) -> Iterator[Check]:
    def mean_at(metric: str, mean_s: float) -> float | None:
        return numbers.mean("encounters", metric, encounter_s=mean_s, configuration=without(["shared-registry"]))

    for low_s, mean_s, high_s in ((30.0, 50.0, 90.0), (90.0, 200.0, 300.0)):
        yield _between(
            f"{SUCCESS} at {mean_s:g} s",
            mean_at(SUCCESS, mean_s),
            (mean_at(SUCCESS, low_s), mean_at(SUCCESS, high_s)),
            0.0,
        )
    for metric in _ablated():
        if metric != SUCCESS:
            yield _between(
                f"{metric} at 200 s, as at 50 s", mean_at(metric, 200.0), (mean_at(metric, 50.0),), MARGINS[metric]
            )


def _triples(numbers: Numbers) -> Iterator[Check]:
    """Yield the checks of triples of mechanisms; where the sum is outside the metric's range, nothing is implied."""
    for triple in combinations(MECHANISMS, 3):
        for metric in _ablated():
            full = numbers.mean("ablation", metric)
            alone = [numbers.mean("ablation", metric, configuration=without([mechanism])) for mechanism in triple]
            together = numbers.mean("triples", metric, configuration=without(triple))
            known = [value for value in alone if value is not None]
            expected = (
                None
                if full is None or len(known) < len(triple)
                else round(full + sum(value - full for value in known), 9)
            )
            if expected is None or (expected >= 0.0 and (metric in COUNTS or expected <= 1.0)):
                yield _between(f"{metric} {without(triple)}", together, (expected,), MARGINS[metric])


CHECKS: dict[str, Callable[[Numbers], Iterator[Check]]] = {
    "seeds": _seeds,
    "twelve": _twelve,
    "twenty-eight": _twenty_eight,
    "loads": _loads,
    "encounters": _encounters,
    "triples": _triples,
}
"""The checks that each registered prediction implies, by its name."""


def _between(text: str, value: float | None, ends: tuple[float | None, ...], margin: float) -> Check:
    known = [end for end in ends if end is not None]
    is_known = len(known) == len(ends)
    return _check(
        text,
        value,
        min(known) - margin if is_known else None,
        max(known) + margin if is_known else None,
        is_known=is_known,
    )


def _check(
    text: str, value: float | None, low: float | None = None, high: float | None = None, *, is_known: bool = True
) -> Check:
    holds = None if value is None or not is_known else (low is None or low <= value) and (high is None or value <= high)
    return Check(text, value, low, high, holds)


def _less(text: str, value: float | None, other: float | None) -> Check:
    """Return the check that the value is less than the other."""
    return Check(text, value, None, other, None if value is None or other is None else value < other)


def _ablated() -> list[str]:
    return list(dict.fromkeys(place.metric for place in printed("ablation")))


def _teams(teams: int | None) -> str:
    return "all teams" if teams is None else f"{teams} team{'s' if teams > 1 else ''}"
