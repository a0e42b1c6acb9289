"""The verb `info`: what a ledger holds, its plans, which of their runs are there, and which worlds they met.

A plan on record says what is missing. Without one (live runs, ledgers from before plans were recorded) nothing does;
then the summary describes the shape of what is there, and never says that it is complete.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec import structs

from fsar_ledger import printable

from .answers import Answer, Screen
from .verbs import verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.observing import Unobserved
    from fsar_ledger.metrics.results import Model

    from .ledger import Ledger
    from .provenance import Provenance

# Grain: one row per model (kind of run, source, model version, constants), seed, fleet size, architecture,
# configuration and changes of forks; NULL where runs have none.
# A rectangle has, for each scenario of its model, seed and fleet size, all runs from 0 to the highest number there;
# runs without a number make none, nor do forks.
GROUPS = """
WITH sizes AS (
    SELECT run_id, count(*) AS event_count FROM events GROUP BY run_id
),

planned AS (
    SELECT DISTINCT run_id FROM planned_runs
),

groups AS (
    SELECT
        runs.kind,
        runs.source,
        runs.model_version,
        settings.parameter_set,
        runs.seed,
        runs.fleet_size,
        runs.architecture,
        runs.configuration,
        coalesce(list(DISTINCT runs.scenario) FILTER (runs.scenario IS NOT NULL), []) AS scenarios,
        max(runs.run) AS last,
        count(DISTINCT (runs.scenario, runs.run)) FILTER (
            runs.scenario IS NOT NULL AND runs.run IS NOT NULL
        ) AS numbered,
        settings.kind AS made_as,
        CASE WHEN settings.kind = 'fork' THEN settings.constants END AS changes,
        count(*) AS runs,
        count(*) FILTER (planned.run_id IS NULL) AS runs_unplanned,
        sum(sizes.event_count)::BIGINT AS events,
        list(runs.number ORDER BY runs.number) AS numbers
    FROM runs
    INNER JOIN sizes ON runs.run_id = sizes.run_id
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    LEFT JOIN planned ON runs.run_id = planned.run_id
    GROUP BY
        runs.kind,
        runs.source,
        runs.model_version,
        settings.parameter_set,
        runs.seed,
        runs.fleet_size,
        runs.architecture,
        runs.configuration,
        settings.kind,
        CASE WHEN settings.kind = 'fork' THEN settings.constants END
)

SELECT
    kind,
    source,
    model_version,
    parameter_set,
    seed,
    fleet_size,
    architecture,
    configuration,
    changes,
    len(scenarios) AS scenarios,
    runs,
    runs_unplanned,
    CASE
        WHEN changes IS NULL
            THEN
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
    "constants",
    "seed",
    "fleet_size",
    "architecture",
    "configuration",
    "changes",
    "scenarios",
    "runs",
    "runs_unplanned",
    "runs_to_rectangle",
    "events",
    "numbers",
)
"""The columns of `groups` that people are shown."""


class Contents(Answer, msgspec.Struct, frozen=True):
    """The runs of a ledger in groups, their models with constants, and the plans.

    A group has one model, seed, fleet size, architecture and configuration. `not_observed` names the concerns that some
    runs do not observe.
    """

    groups: list[dict[str, Any]]
    models: list[dict[str, Any]]
    plans: list[dict[str, Any]]
    missing: int | None
    """Planned runs that are missing, each counted once; None where the plans name too many to count."""

    provenance: "Provenance"
    not_observed: tuple["Unobserved", ...] = ()

    @property
    def run_count(self) -> int:
        """Count all runs, whatever their group."""
        return sum(group["runs"] for group in self.groups)

    @property
    def unplanned(self) -> dict[str, int]:
        """Count, by kind, the runs that no plan names."""
        found: dict[str, int] = {}
        for group in self.groups:
            found[group["kind"]] = found.get(group["kind"], 0) + group["runs_unplanned"]
        return {kind: count for kind, count in found.items() if count}

    @property
    def is_complete(self) -> bool | None:
        """Return whether all planned runs are there; None without a plan, or beside runs that no plan names."""
        if any(plan["missing_count"] for plan in self.plans):
            return False
        return None if self.unplanned or not self.plans else True

    def document(self, screen: Screen) -> Mapping[str, object]:
        """Return all of it."""
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
        }

    def text(self, screen: Screen) -> Iterator[printable.SafeText]:
        """Yield what is there without the parameters, which are too many."""
        head = self.provenance.head
        assert head is not None
        standing = "" if self.provenance.rows_verified else " (the rows were not compared with it)"
        yield printable.lines(
            f"{screen.path}: {printable.counted(head.size, 'event')} in {printable.counted(head.commits, 'commit')}",
            f"root {head.root}{standing}",
            *self.summary(),
        )
        if rows := self.rows():
            yield printable.line("")
            yield screen.table(rows)

    def summary(self) -> list[str]:
        """Return lines on the runs and the plans."""
        return [
            *self._standing(),
            *self._forks(),
            *self._unfinished(),
            *self._enlarged(),
            *self._unlike(),
            *self._models(),
            *self._unseen(),
        ]

    def _standing(self) -> list[str]:
        from .plans import runs

        held = runs(self.run_count)
        if not self.plans:
            nothing = "no plan is on record, so nothing says whether they are all that was meant"
            return [f"{held}; {nothing}" if self.groups else "no runs yet, and no plan on record"]
        lacking = (
            "not complete"
            if self.missing is None
            else f"not complete: {printable.counted(self.missing, 'planned run')} {_are(self.missing)} missing"
        )
        of_plans = lacking if self.is_complete is False else "complete: all that was planned is there"
        if not self.unplanned:
            return [f"{held}, {of_plans}"]
        kinds = ", ".join(f"{count:,} {printable.value(kind)}" for kind, count in self.unplanned.items())
        return [
            held,
            f"planned runs: {of_plans}",
            f"other runs: {kinds}; no plan names them, so nothing says whether they are all that was meant",
        ]

    def _forks(self) -> list[str]:
        count = sum(group["runs"] for group in self.groups if group["changes"] is not None)
        if not count:
            return []
        said = f"{printable.counted(count, 'fork')} among them" if count < self.run_count else "all of them forks"
        return [f"{said}; the query forks says of which runs, and how far they repeat them"]

    def _unfinished(self) -> list[str]:
        """Return a line for each plan that lacks runs, except those that a larger plan covers."""
        from .plans import shape

        lines = []
        for plan in self.plans:
            if plan["missing_count"] and not plan["larger_plans"]:
                of_plan = f"{plan['there_count']:,} of {plan['planned_count']:,} runs of {shape(plan)}"
                further = (
                    f"go on with: {plan['continues_with']}"
                    if plan["continues_with"]
                    else "go on with the version and the constants that began it"
                )
                lines.append(f"interrupted, or still at work: {of_plan}; {further}")
        return lines

    def _enlarged(self) -> list[str]:
        smaller = sum(bool(plan["larger_plans"]) for plan in self.plans)
        if not smaller:
            return []
        of_all = f"{smaller:,} of {len(self.plans):,} plans {_are(smaller)} part of a larger one"
        return [
            f"enlarged: {of_all}; runs, run ids and metrics are as if it had been planned so large at once, the root "
            "is not"
        ]

    def _unlike(self) -> list[str]:
        """Describe the shape of what is there, where no plan says what is missing."""
        from .plans import runs

        if self.is_complete is False:
            return []
        measured = [group["runs_to_rectangle"] for group in self.groups if group["runs_to_rectangle"] is not None]
        missing = sum(measured)
        if missing:
            return [
                f"not a rectangle: {runs(missing)} less than if each group had all runs of all scenarios of its "
                "model, seed and fleet size"
            ]
        return (
            ["a rectangle: each group has all runs of all scenarios of its model, seed and fleet size"]
            if measured and not self.plans
            else []
        )

    def _models(self) -> list[str]:
        if len(self.models) == 1:
            return [_described(self.models[0])]
        more = len(self.models) - printable.NAMED
        return [
            *map(_among_others, self.models[: printable.NAMED]),
            *([f"and {more:,} more, --json names all"] if more > 0 else []),
        ]

    def _unseen(self) -> list[str]:
        from fsar_ledger.metrics.observing import shown

        return [f"not observed, so that no answer is about it: {shown(self.not_observed)}"] if self.not_observed else []

    def rows(self) -> list[dict[str, Any]]:
        """Return the groups as people are shown them, without columns that say nothing."""
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
    and (with --json) the parameters of their worlds. Without a plan on record nothing shows what is missing.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `connect`, and `models`.
    """
    from fsar_ledger.ledger.opening import open_ledger
    from fsar_ledger.metrics.observing import never_observed
    from fsar_ledger.metrics.plans import completeness
    from fsar_ledger.metrics.results import lettered, models

    from .plans import PlanRow, plans
    from .provenance import Provenance

    with ledger.database() as database:
        found = lettered(models(database))
        letters = {_key(structs.asdict(one)): letter for one, letter in found}
        groups = [
            {"constants": letters.get(_key(row)), **row, "numbers": ranges(row["numbers"])}
            for row in database.rows(GROUPS)
        ]
        planned = plans(database, PlanRow(ledger.path, open_ledger(ledger.path)))
        named = [_of_model(one, letter) for one, letter in found]
        missing = completeness(database).missing
        provenance = Provenance(database.head, database.rows_verified)
        return Contents(groups, named, planned, missing, provenance, tuple(never_observed(database)))


def ranges(numbers: Sequence[int]) -> str:
    """Return numbers in ascending order as ranges: `1-100`, `2-299 by 3`, `7, 9`."""
    parts, at = [], 0
    while at < len(numbers):
        step = numbers[at + 1] - numbers[at] if at + 1 < len(numbers) else 1
        end = at
        while end + 1 < len(numbers) and numbers[end + 1] - numbers[end] == step:
            end += 1
        if end - at < 2 and step != 1:  # two apart are no range, and the second may begin one
            end = at
        first, last = numbers[at], numbers[end]
        parts.append(str(first) if first == last else f"{first}-{last}" + (f" by {step}" if step > 1 else ""))
        at = end + 1
    return ", ".join(parts)


def _are(number: int) -> str:
    return "is" if number == 1 else "are"


def _key(row: Mapping[str, Any]) -> tuple[str | None, ...]:
    return row["kind"], row["source"], row["model_version"], row["parameter_set"]


def _of_model(one: "Model", letter: str | None) -> dict[str, Any]:
    """Describe a model for JSON; `differing` names its constants that differ from others of its kind and version."""
    return {
        "constants": letter,
        "kind": one.kind,
        "source": one.source,
        "model_version": one.model_version,
        "runs": one.runs,
        "differing": one.constants,
        "parameters": one.parameters,
        "parameters_sha256": one.sha256,
    }


def _described(model: Mapping[str, Any]) -> str:
    version = (
        "no model" if model["model_version"] is None else f"model version {printable.value(model['model_version'])}"
    )
    unread = (
        f"parameters that cannot be read, SHA-256 {model['parameters_sha256'][:12]}"
        if model["parameters"] is None
        else None
    )
    return ", ".join(
        filter(
            None,
            (printable.value(model["kind"]), model["source"] and printable.value(model["source"]), version, unread),
        )
    )


def _among_others(model: Mapping[str, Any]) -> str:
    """Describe a model beside others: its letter, and the constants that differ from theirs."""
    from .plans import runs

    letter = "no constants on record" if model["constants"] is None else f"constants {model['constants']}"
    differing = (
        f": {printable.value(model['differing'], MAX_DIFFERING)}"
        if model["differing"] and model["parameters"] is not None
        else ""
    )
    return f"{letter}: {_described(model)}, {runs(model['runs'])}{differing}"
