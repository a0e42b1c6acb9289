"""The verb `info`: the contents of a ledger, its plans, which of their runs exist, and which worlds they met.

A plan on record shows what is missing. Without one (live runs, ledgers older than plans), the summary describes the
shape of what exists, and never calls it complete.
"""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec import structs

from fsar_ledger.base import printable
from fsar_ledger.base.printable import counted

from .answers import Answer, Screen, head_json
from .verbs import verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.provenance import Provenance, Unobserved
    from fsar_ledger.metrics.results import Model

    from .ledger import Ledger

BEGINS = """
SELECT
    count(*) AS runs,
    strftime(min(epoch), '%Y-%m-%dT%H:%M:%SZ') AS first,
    strftime(max(epoch), '%Y-%m-%dT%H:%M:%SZ') AS last
FROM run_epochs
HAVING count(*) > 0
"""
# Grain: one row per model (kind of run, source, model version, constants), seed, fleet size, architecture,
# configuration and changes of forks; NULL where runs have none.
# A rectangle has, for each scenario of its model, seed and fleet size, all runs from 0 to the highest number there;
# runs without a number make none, nor do forks.
GROUPS = """
WITH groups AS (
    SELECT
        runs.kind,
        runs.source,
        runs.model_version,
        settings.parameter_set,
        runs.seed,
        runs.fleet_size,
        runs.architecture,
        runs.configuration,
        settings.kind AS made_as,
        CASE WHEN settings.kind = 'fork'
            THEN coalesce(nullif(array_to_string(started.changes, '; '), ''), 'no change')
        END AS changes,
        coalesce(list(DISTINCT runs.scenario) FILTER (runs.scenario IS NOT NULL), []) AS scenarios,
        max(runs.run) AS last,
        count(DISTINCT (runs.scenario, runs.run)) FILTER (
            runs.scenario IS NOT NULL AND runs.run IS NOT NULL
        ) AS numbered,
        count(*) AS runs,
        count(*) FILTER (runs.run_id NOT IN (SELECT run_id FROM planned_runs)) AS runs_unplanned,
        sum(sizes.events)::BIGINT AS events,
        list(runs.number ORDER BY runs.number) AS numbers
    FROM runs
    INNER JOIN (SELECT run_id, count(*) AS events FROM events GROUP BY run_id) AS sizes ON runs.run_id = sizes.run_id
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    INNER JOIN run_started AS started ON runs.run_id = started.run_id
    GROUP BY ALL
)

SELECT
    kind, source, model_version, parameter_set, seed, fleet_size, architecture, configuration, changes,
    len(scenarios) AS scenarios,
    runs,
    runs_unplanned,
    CASE WHEN changes IS NULL THEN
        len(list_distinct(flatten(list(scenarios) OVER world)))::HUGEINT
        * (max(last) OVER world + 1)::HUGEINT - numbered
    END AS runs_to_rectangle,
    events,
    numbers
FROM groups
WINDOW world AS (PARTITION BY kind, source, model_version, parameter_set, seed, fleet_size, made_as)
ORDER BY ALL
"""

MAX_DIFFERING = 1_000
"""Characters shown of the constants in which a model differs from others."""

COLUMNS = (
    *("constants", "seed", "fleet_size", "architecture", "configuration", "changes", "scenarios", "runs"),
    *("runs_unplanned", "runs_to_rectangle", "events", "numbers"),
)
"""The columns of `groups` that are shown as text."""


class Contents(Answer, msgspec.Struct, frozen=True):
    """The runs of a ledger in groups, their models with constants, and the plans.

    A group has one model, seed, fleet size, architecture and configuration. `not_observed` names the concerns that some
    runs do not observe.
    """

    groups: list[dict[str, Any]]
    models: list[dict[str, Any]]
    plans: list[dict[str, Any]]
    missing: int | None
    """Planned runs that are missing, each counted once; None if the plans name too many to count."""

    provenance: "Provenance"
    not_observed: tuple["Unobserved", ...] = ()
    begins: Mapping[str, Any] | None = None
    """How many runs have a time of day, and when the first and the last begin; None if none has."""

    shards: list[dict[str, Any]] = []
    """The origin, folder and head of each shard of a federation."""

    @property
    def run_count(self) -> int:
        """Count all runs, whatever their group."""
        return sum(group["runs"] for group in self.groups)

    @property
    def unplanned(self) -> dict[str, int]:
        """Count, by kind, the runs that no plan names."""
        counts: dict[str, int] = {}
        for group in self.groups:
            counts[group["kind"]] = counts.get(group["kind"], 0) + group["runs_unplanned"]
        return {kind: count for kind, count in counts.items() if count}

    @property
    def is_complete(self) -> bool | None:
        """Return whether all planned runs exist; None without a plan, or if no plan names some run."""
        if any(plan["missing_count"] for plan in self.plans):
            return False
        return None if self.unplanned or not self.plans else True

    def document(self, screen: Screen) -> Mapping[str, object]:
        """Return all fields."""
        assert self.provenance.head is not None  # only rows in memory have none
        return {
            "ledger": str(screen.path),
            "commits": self.provenance.head.commits,
            "groups": self.groups,
            "models": self.models,
            "plans": self.plans,
            "runs": self.run_count,
            "runs_unplanned": self.unplanned,
            "is_complete": self.is_complete,
            "missing_count": self.missing,
            "not_observed": self.not_observed,
            "begins": self.begins,
            **({"shards": self.shards} if self.shards else {}),
        }

    def text(self, screen: Screen) -> Iterator[printable.SafeText]:
        """Yield the contents without the parameters, which are too many."""
        head = self.provenance.head
        assert head is not None
        remark = "" if self.provenance.rows_verified else " (the rows were not compared with it)"
        contents = f"{counted(head.size, 'event')} in {counted(head.commits, 'commit')}"
        if self.shards:
            contents = f"{counted(head.events, 'event')} in {counted(len(self.shards), 'shard')}"
        yield printable.lines(
            f"{screen.path}: {contents}",
            f"root {head.root}{remark}",
            *self.summary(),
        )
        if rows := self.rows():
            yield printable.line("")
            yield screen.table(rows)

    def summary(self) -> Iterator[str]:
        """Yield lines on the runs, the plans and the models."""
        from fsar_ledger.metrics.provenance import unobserved_text

        yield from self._standing()
        if forks := sum(group["runs"] for group in self.groups if group["changes"] is not None):
            forked = f"{counted(forks, 'fork')} among them" if forks < self.run_count else "all of them forks"
            yield f"{forked}; the query `forks` shows of which runs, and how far they repeat them"
        if begins := self.begins:
            dated, first, last = begins["runs"], begins["first"], begins["last"]
            several = f"{counted(dated, 'run')} with a time of day begin from {first} to {last}"
            yield several if dated > 1 else f"the run with a time of day begins {first}"
        for plan in self.plans:
            if plan["missing_count"] and not plan["larger_plans"]:
                yield _unfinished(plan)
        if smaller := sum(bool(plan["larger_plans"]) for plan in self.plans):
            yield (
                f"enlarged: {smaller:,} of {len(self.plans):,} plans {_are(smaller)} part of a larger one; runs, run "
                "ids and metrics are as if only the larger one had been planned, the root is not"
            )
        if self.is_complete is not False:
            yield from self._rectangle()
        if len(self.models) == 1:
            yield _described(self.models[0])
        else:
            yield from map(_among_others, self.models[: printable.NAMED])
            more = len(self.models) - printable.NAMED
            yield from [f"and {more:,} more, --json names all"] if more > 0 else []
        if self.not_observed:
            yield f"not observed, so no answer is about it: {unobserved_text(self.not_observed)}"

    def _standing(self) -> Iterator[str]:
        total = counted(self.run_count, "run")
        if not self.plans:
            remark = "no plan is on record, so nothing shows whether any are missing"
            yield f"{total}; {remark}" if self.groups else "no runs yet, and no plan on record"
            return
        of_plans = "complete: all planned runs are there"
        if self.is_complete is False:
            lacking = "" if self.missing is None else f": {counted(self.missing, 'planned run')} {_are(self.missing)}"
            of_plans = f"not complete{lacking and f'{lacking} missing'}"
        if not self.unplanned:
            yield f"{total}, {of_plans}"
            return
        kinds = ", ".join(f"{count:,} {printable.value(kind)}" for kind, count in self.unplanned.items())
        yield from (total, f"planned runs: {of_plans}")
        yield f"other runs: {kinds}; no plan names them, so nothing shows whether any are missing"

    def _rectangle(self) -> Iterator[str]:
        """Describe the shape of the runs, if no plan shows what is missing."""
        measured = [group["runs_to_rectangle"] for group in self.groups if group["runs_to_rectangle"] is not None]
        of_all = "each group {} all runs of all scenarios of its model, seed and fleet size"
        if missing := sum(measured):
            yield f"not a rectangle: {counted(missing, 'run')} fewer than if {of_all.format('had')}"
        elif measured and not self.plans:
            yield f"a rectangle: {of_all.format('has')}"

    def rows(self) -> list[dict[str, Any]]:
        """Return the groups as shown in text, without uninformative columns."""
        is_dull = {
            "constants": len(self.models) == 1,
            "runs_unplanned": not self.plans or not self.unplanned,
            "changes": all(group["changes"] is None for group in self.groups),
        }
        return [{name: group[name] for name in COLUMNS if not is_dull.get(name)} for group in self.groups]


@verb("info out/ledger", "info out/ledger --json")
def info(ledger: "Ledger") -> Contents:
    """Show what a ledger holds, and whether it is complete.

    Shows the head, which planned runs are there, the runs by model, seed, fleet size, architecture and configuration,
    and (with --json) the parameters of their worlds. Without a plan on record, nothing shows what is missing.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `connect`, and `models`.
    """
    from fsar_ledger.ledger.opening import open_for_answers
    from fsar_ledger.ledger.store.shards import log_of, views_of
    from fsar_ledger.metrics.provenance import Provenance, completeness, never_observed
    from fsar_ledger.metrics.results import lettered, models
    from fsar_ledger.runtime.experiment_arguments import PlanRow, plans

    with ledger.database() as database:
        lettered_models = lettered(models(database))
        letters = {_key(structs.asdict(model)): letter for model, letter in lettered_models}
        groups = [
            {"constants": letters.get(_key(row)), **row, "numbers": printable.ranges(row["numbers"])}
            for row in database.rows(GROUPS)
        ]
        view = open_for_answers(ledger.path)
        planned = plans(database, PlanRow(ledger.path, view))
        described = [_of_model(model, letter) for model, letter in lettered_models]
        missing = completeness(database).missing
        provenance = Provenance(database.head, database.rows_verified)
        begins = next(iter(database.rows(BEGINS)), None)
        shards = (
            []
            if log_of(view) is view
            else [
                {"origin": shard.manifest.origin, "folder": str(shard.path), **head_json(shard.head)}
                for shard in views_of(view)
            ]
        )
        unobserved = tuple(never_observed(database))
        return Contents(groups, described, planned, missing, provenance, unobserved, begins, shards)


def _unfinished(plan: Mapping[str, Any]) -> str:
    """Describe a plan that lacks runs, and how to continue it."""
    from fsar_ledger.runtime.experiment_arguments import shape

    command = plan["continues_with"]
    go_on = f"with: {command}" if command else "with the version and the constants that began it"
    of_plan = f"{plan['there_count']:,} of {plan['planned_count']:,} runs of {shape(plan)}"
    return f"interrupted, or still running: {of_plan}; continue {go_on}"


def _are(number: int) -> str:
    return "is" if number == 1 else "are"


def _key(row: Mapping[str, Any]) -> tuple[str | None, ...]:
    return row["kind"], row["source"], row["model_version"], row["parameter_set"]


def _of_model(model: "Model", letter: str | None) -> dict[str, Any]:
    """Describe a model for JSON; `differing` names its constants that differ from others of its kind and version."""
    identity = {name: getattr(model, name) for name in ("kind", "source", "model_version", "runs")}
    parameters = {"differing": model.constants, "parameters": model.parameters, "parameters_sha256": model.sha256}
    return {"constants": letter, **identity, **parameters}


def _described(model: Mapping[str, Any]) -> str:
    version, parameters = model["model_version"], model["parameters"]
    parts: tuple[Any, ...] = (
        printable.value(model["kind"]),
        model["source"] and printable.value(model["source"]),
        "no model" if version is None else f"model version {printable.value(version)}",
        parameters is None and f"parameters that cannot be read, SHA-256 {model['parameters_sha256'][:12]}",
    )
    return ", ".join(filter(None, parts))


def _among_others(model: Mapping[str, Any]) -> str:
    """Describe a model beside others: its letter, and the constants that differ from theirs."""
    letter = "no constants on record" if model["constants"] is None else f"constants {model['constants']}"
    differing = model["differing"] if model["parameters"] is not None else None
    more = f": {printable.value(differing, MAX_DIFFERING)}" if differing else ""
    return f"{letter}: {_described(model)}, {counted(model['runs'], 'run')}{more}"
