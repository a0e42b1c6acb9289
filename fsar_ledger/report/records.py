"""Lay out the recorded results of the studies, where they have the model and the constants of the runs shown."""

from collections.abc import Mapping
from importlib.resources.abc import Traversable
from typing import TypeVar

import msgspec
import pyarrow as pa

from fsar_ledger.base import printable
from fsar_ledger.base.parameters import read_parameters
from fsar_ledger.designs.constants import Constants, with_all_groups, write_constants
from fsar_ledger.designs.dials import TRIED
from fsar_ledger.metrics.effects import MADE_BY, Sensitivity, dozen, reach
from fsar_ledger.metrics.robustness import (
    CellSpread,
    Ensemble,
    HeldRank,
    Placebo,
    RankCounts,
    Ranking,
    Rejections,
    SignCount,
    SystemGrade,
    SystemNumber,
    Systems,
)
from fsar_ledger.metrics.study_results import Calibration, Comparison, GroundedResult, changed, packaged
from fsar_ledger.report.findings import Findings, arrow
from fsar_ledger.report.printing import flat, words

MAX_NAMED = 5  # differing constants that a message names
_Grounded = TypeVar("_Grounded", bound=GroundedResult)


class DeclaredDial(msgspec.Struct, frozen=True):
    """A dial of a published system, and its declared value."""

    dial: str
    declared: int


class Drawn(msgspec.Struct, frozen=True):
    """The sample of a study: the number of points or repetitions, the runs of each, and the overall findings.

    `plausible` is of the ensemble, the rest of the placebo (as in `robustness.Placebo`).
    """

    size: int
    runs: int
    plausible: int | None = None
    pairs: int | None = None
    alpha: float | None = None
    largest_difference: float | None = None


def robustness(findings: Findings, folder: Traversable | None = None) -> dict[str, pa.Table]:
    """Return the results of `study run ranking`, `ensemble`, `placebo` and `systems` in this folder, as relations.

    Without a folder, they are the packaged ones.

    Results of another model than these runs' are left out, and, except for the ranking, those of other constants.
    """
    prior = packaged(Ranking, folder)
    return robustness_relations(
        prior if prior is not None and prior.model_version == findings.model_version else None,
        packaged_for(findings, Ensemble, folder),
        packaged_for(findings, Placebo, folder),
        packaged_for(findings, Systems, folder),
    )


def robustness_relations(
    prior: Ranking | None = None,
    around: Ensemble | None = None,
    control: Placebo | None = None,
    systems: Systems | None = None,
) -> dict[str, pa.Table]:
    """Return these results as relations: `prior`, `around` and `placebo` with one row each, and those of their tables.

    Without a result its relations have no rows.
    """
    return {
        "prior": arrow([Drawn(result.sample.size, result.sample.runs) for result in [prior] if result], Drawn),
        "prior_ranks": arrow(prior.ranks if prior else (), RankCounts),
        "around": arrow(
            [Drawn(result.sample.size, result.sample.runs, result.plausible) for result in [around] if result], Drawn
        ),
        "around_ranks": arrow(around.ranks if around else (), RankCounts),
        "around_cells": arrow(around.cells if around else (), CellSpread),
        "around_signs": arrow(around.signs if around else (), SignCount),
        "placebo": arrow(
            [
                Drawn(
                    result.sample.size, result.sample.runs, None, result.pairs, result.alpha, result.largest_difference
                )
                for result in [control]
                if result
            ],
            Drawn,
        ),
        "rejections": arrow(control.tests if control else (), Rejections),
        "system_numbers": arrow(systems.numbers if systems else (), SystemNumber),
        "system_grades": arrow(systems.grades if systems else (), SystemGrade),
        "declared_dials": arrow([DeclaredDial(dial, _declared(dial)) for dial in TRIED if systems], DeclaredDial),
        "system_held": arrow(systems.held if systems else (), HeldRank),
    }


def _declared(dial: str) -> int:
    group, _, name = dial.partition(".")
    value: int = getattr(getattr(with_all_groups(Constants()), group), name)
    return value


# See docs/decisions/fit-is-registered-first.md.
def packaged_for(findings: Findings, kind: type[_Grounded], folder: Traversable | None = None) -> _Grounded | None:
    """Return the result of this kind in this package or folder; None if absent, or of another model or constants.

    Raises: FsarLedgerError if the file is not such a result.
    """
    record = packaged(kind, folder)
    if record is None or record.model_version != findings.model_version:
        return None
    return record if dict(flat("", read_parameters(record.parameters))) == findings.parameters else None


def fit_changed(findings: Findings, record: Calibration | None) -> str | None:
    """Return that the record of the fit is of another model or constants than these runs, or of other queries.

    None if it is of the same, or if either is missing.
    """
    versions = [findings.model_version] if findings.model_version else list(findings.model_versions)
    if record is None or not versions:
        return None
    if versions != [record.model_version]:
        ran = f"of version{'' if len(versions) == 1 else 's'} {printable.list_few(map(words, versions))}"
        unknown = "a model whose version is not on record"
        fitted = unknown if record.model_version is None else f"model version {words(record.model_version)}"
        return f"The model has changed since the fit: the constants were fitted to {fitted}, and these runs are {ran}."
    if own_rows := own_constants(findings.parameters).to_pylist():
        names = printable.list_few(words(row["name"]) for row in own_rows)
        return f"These runs have constants of their own, not those of the fit: {names}."
    if record.rules is None:
        return "The record of the fit does not say which queries judged its runs."
    later = printable.list_few(map(words, changed(record.rules)))
    return f"What judges the runs has changed since the fit: {later}." if later else None


def fit_relations(findings: Findings, record: Calibration | None) -> dict[str, pa.Table]:
    """Return the record of the fit as two relations: its one row (none without a record), and its constants."""
    recorded, record = record, record or Calibration()
    objective = record.objective
    row = {
        "constants": len(record.parameters),
        "objective": objective and objective.description,
        "start": objective and objective.start,
        "accepted": objective and objective.accepted,
        "seeds": record.seeds or None,
        "runs_per_scenario": record.runs_per_scenario,
        "evaluations": record.evaluations,
        "model_version": record.model_version,
        "identified": sum(direction.identified for direction in record.directions),
        "directions": len(record.directions),
        "command": record.command,
        "is_of_these_runs": fit_changed(findings, record) is None,
    }
    fitted = [msgspec.structs.asdict(direction) for direction in record.parameters]
    table = pa.Table.from_pylist([row]).slice(0, 0 if recorded is None else 1)
    return {"fit": table} | ({"fitted": pa.Table.from_pylist(fitted)} if fitted else {})


def predictions(found: Comparison | None) -> dict[str, pa.Table]:
    """Return the outcomes of the registered predictions, and the queries that have changed since, as relations."""
    if found is None or not found.predictions:
        return {}
    rows = [
        {
            "name": outcome.name,
            "implies": outcome.implies,
            "checks": f"{outcome.held} of {outcome.of}",
            "holds": outcome.holds,
        }
        for outcome in found.predictions
    ]
    later = pa.table({"name": pa.array(changed(found.rules), pa.string())})
    return {"predictions": pa.Table.from_pylist(rows), "changed_since": later}


def effects_of(findings: Findings, given: Sensitivity | None) -> tuple[dict[str, pa.Table], str | None]:
    """Return the effects of the constants that matter most as relations, or why those given are not of these runs."""
    if given is None:
        return {}, None
    expected = findings.model_version
    if given.model_version != expected:
        actual, wanted = (printable.value(version or "unknown") for version in (given.model_version, expected))
        return {}, _not_these(f"found effects of model {actual}, expected those of model {wanted}")
    theirs = dict(flat("", read_parameters(given.parameters)))
    differing = [
        name for name in {**theirs, **findings.parameters} if theirs.get(name) != findings.parameters.get(name)
    ]
    if differing:
        more = f" and {len(differing) - MAX_NAMED} more" if len(differing) > MAX_NAMED else ""
        named = ", ".join(map(printable.value, differing[:MAX_NAMED])) + more
        return {}, _not_these(f"found effects around other constants ({named})")
    study = {
        "factors": len(given.factors),
        "trajectories": given.trajectories,
        "evaluations": given.evaluations,
        "runs": given.runs,
        "still": sum(furthest == 0 for furthest in reach(given).values()),
    }
    later = pa.table({"name": pa.array(changed(given.rules), pa.string())})
    found_rows = [{**row, "position": position} for position, row in enumerate(dozen(given))]
    relations = {"effects": pa.Table.from_pylist(found_rows)} if found_rows else {}
    return relations | {"study": pa.Table.from_pylist([study]), "effects_changed": later}, None


def _not_these(why: str) -> str:
    return f"The effects of --sensitivity are not of these runs: {why}; make them again: {MADE_BY}."


def own_constants(parameters: Mapping[str, str]) -> pa.Table:
    """Return the constants of the runs whose value differs from this version's, with the latter; NULL: it has none."""
    ours = dict(flat("", msgspec.json.decode(write_constants(Constants()))))
    rows = [(name, value, ours.get(name)) for name, value in parameters.items() if ours.get(name) != value]
    names, values, defaults = zip(*rows, strict=True) if rows else ((), (), ())
    return pa.table(
        {
            "name": pa.array(names, pa.string()),
            "value": pa.array(values, pa.string()),
            "ours": pa.array(defaults, pa.string()),
        }
    )


def notes(findings: Findings, record: Calibration | None, effects_said: str | None) -> list[str]:
    """Return what a reader must know before the numbers, the most important first."""
    texts = [
        findings.unjudged,
        fit_changed(findings, record) and f"{fit_changed(findings, record)} So no number counts as fitted.",
        findings.shown,
        effects_said,
    ]
    if findings.differing:
        pairs = "Not every pair of runs met the same world. Such pairs have no part in any paired number"
        texts.insert(0, f"{pairs}: {'; '.join(findings.differing)}.")
    return [text for text in texts if text]
