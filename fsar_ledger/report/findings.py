"""The findings of the ledgers: the printed numbers beside ours, and the relations that sections select from.

The parts besides the results are read here, each from a ledger that holds such runs: FSAR without a mechanism, larger
fleets, every architecture without one mechanism, the paper's workflows, and members that join and leave.
"""

import types
import typing
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pyarrow as pa

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.registered import PAPER_WORKFLOWS
from fsar_ledger.events.configuration import CONFIGURATIONS, EVERY_MECHANISM, FULL, PAPER_ARCHITECTURES, without
from fsar_ledger.metrics.database import Database, Value, connect
from fsar_ledger.metrics.definitions import Table
from fsar_ledger.metrics.library import generated
from fsar_ledger.metrics.multiverse import Multiverse
from fsar_ledger.metrics.provenance import completeness
from fsar_ledger.metrics.results import DialledRow, dialled_rows, measure_the_printed
from fsar_ledger.report import judge
from fsar_ledger.report.judge import FOUR_ROBOTS, Number


class Source(msgspec.Struct, frozen=True):
    """One packaged query: its name, and the SHA-256 of its text in hex."""

    name: str
    sha256: str


class Head(msgspec.Struct, frozen=True):
    """The head of a ledger (commits, events, root), its number of runs, whether it is complete, and its model."""

    commits: int
    events: int
    root: str
    runs: int
    completeness: str
    model_version: str | None


class Findings(msgspec.Struct, frozen=True, kw_only=True):
    """The content of the report of one head of a ledger, and of the ledgers beside it.

    heads: by part (results, ablation, scaling, mechanisms, workflows, churn), of the ledger that provides it.
    numbers: every printed number of the tables for which there are runs, with ours.
    relations: the answers of the packaged queries about these runs, by name.
    sources: these queries, with all that they read.
    parameters: the constants of the main runs by dotted name; parameters_sha256: their SHA-256 as recorded;
        model_version: that of these runs; model_versions: of all runs of the ledger.
    table_share: the share of experiments drawn from the main runs that print a results table as far out as the paper's;
        None if none are drawn.
    unjudged: which numbers are not judged, and why, in words; shown: the runs of the tables, if the ledger has others;
        differing: the pairs of runs that are left out because they met different worlds.
    multiverse: the cells under every reading of the text; None if not requested, or if the runs are not judged.
    """

    heads: dict[str, Head]
    numbers: tuple[Number, ...] = ()
    relations: Mapping[str, Any] = {}
    sources: tuple[Source, ...] = ()
    parameters: dict[str, str] = {}
    parameters_sha256: str | None = None
    model_version: str | None = None
    model_versions: tuple[str, ...] = ()
    table_share: float | None = None
    unjudged: str | None = None
    shown: str | None = None
    differing: tuple[str, ...] = ()
    multiverse: Multiverse | None = None


def sources_of(database: Database, names: Collection[str]) -> tuple[Source, ...]:
    """Return the packaged queries of these names with everything that they read; views of event types are left out."""
    generated_names = {query.name for query in generated()}
    needed = database.library.needs(database.library.find(name).relation for name in names)
    return tuple(
        Source(query.name, query.sha256)
        for query in sorted(needed, key=lambda query: query.name)
        if query.name not in generated_names
    )


_TYPES: Mapping[Any, pa.DataType] = {
    str: pa.string(),
    int: pa.int64(),
    float: pa.float64(),
    bool: pa.bool_(),
}


def arrow(rows: Iterable[msgspec.Struct], kind: type[msgspec.Struct]) -> pa.Table:
    """Return the rows as an Arrow table with a column for each field, also typed where no row has a value."""
    fields = msgspec.structs.fields(kind)
    schema = pa.schema([(field.encode_name, _arrow_type(field.type)) for field in fields])
    return pa.Table.from_pylist(
        [{field.encode_name: getattr(row, field.name) for field in fields} for row in rows], schema
    )


def _arrow_type(kind: Any) -> pa.DataType:
    """Return the Arrow type of a field; tuples of one type are lists, and anything else is text."""
    parts = [part for part in typing.get_args(kind) if part not in (type(None), Ellipsis)]
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return _arrow_type(parts[0])
    return pa.list_(_arrow_type(parts[0])) if typing.get_origin(kind) is tuple else _TYPES.get(kind, pa.string())


Relations = dict[str, pa.Table]

DIALLED = "without-shared-registry"
"""The configuration whose success is plotted over how often robots meet."""
WITHOUT_ONE = [without([name]) for name in EVERY_MECHANISM]

HAS_SQL = "SELECT count(*) AS runs FROM runs WHERE {condition}"
COSTS_SQL = """
    SELECT * FROM coordination_cost
    WHERE
        list_contains($settings, setting) AND list_contains(['fsar', 'cfc', 'dhma'], architecture)
        AND configuration = 'full' AND teams_working = fleet_size // 4
"""
DIFFERENCES_SQL = """
    WITH held AS MATERIALIZED (
        SELECT * FROM mechanism_differences
        WHERE
            pools_seeds AND fleet_size = 4 AND list_contains($configurations, configuration)
            AND metric IN (SELECT metric FROM metric_definitions WHERE is_published)
    ), fullest AS (
        SELECT setting FROM held GROUP BY setting ORDER BY count(*) DESC, sum(n) DESC, setting LIMIT 1
    )
    SELECT held.*
    FROM held INNER JOIN fullest ON held.setting = fullest.setting
"""
DIGESTS_SQL = """
    SELECT list(DISTINCT runs.parameters_sha256 ORDER BY runs.parameters_sha256) AS digests
    FROM runs INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    WHERE settings.setting = $setting AND runs.parameters_sha256 IS NOT NULL
"""
GROUPS_SQL = """
    SELECT made_alike, count(*) AS runs
    FROM run_groups INNER JOIN runs USING (run_id)
    WHERE list_contains($names, runs.scenario)
    GROUP BY made_alike ORDER BY count(*) DESC, min(run_id)
"""
CHURN_SQL = """
    SELECT run_id, architecture, configuration, fleet_size FROM runs WHERE scenario = 'churn' ORDER BY number
"""
FIRST_SQL = """
    SELECT min_by(events.action_id, events.seq) AS action, min(events.run_id) AS run
    FROM events
    WHERE
        events.type = $kind AND events.run_id = (
            SELECT min(run_id) FROM runs INNER JOIN run_groups USING (run_id)
            WHERE made_alike = $made_alike AND scenario = $scenario
        )
"""


class Part(NamedTuple):
    """The findings of one ledger for one part of the report."""

    head: Head
    numbers: tuple[Number, ...] = ()
    relations: Relations = {}  # noqa: RUF012 - never changed


def ledger_head(database: Database, model_version: str | None) -> Head:
    """Return the head of this ledger, with the model of the runs shown. Raises: as `Database.rows`."""
    head = database.head
    [counted] = database.rows("SELECT count(*) AS runs FROM runs")
    commits, size, root = (0, 0, "") if head is None else (head.commits, head.events, head.root)
    return Head(commits, size, root, counted["runs"], completeness(database).sentence(), model_version)


# See docs/decisions/experiments-are-separate-ledgers.md.
def read_ledger(ledger: Path, demanded: str | None, *, is_workflows: bool = False) -> dict[str, Part]:
    """Return the parts that this ledger provides, by name.

    Raises:
        UsageError: It holds nothing for the report, or no workflow where it must.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, SequenceConflict: As `connect`.
    """
    with connect(ledger, demanded=demanded) as database:
        measure_the_printed(database)
        parts = _workflows(database)
        if is_workflows and not parts:
            raise UsageError(
                f"--workflows {ledger}: found no run of {', '.join(PAPER_WORKFLOWS)}; make one with "
                "`fsar-ledger simulate`"
            )
        if not is_workflows:
            parts |= experiments_of(database)
    if not parts:
        raise UsageError(
            f"--with {ledger}: found no run of a workflow, without a mechanism, of a fleet of other than four robots, "
            "or of the scenario churn, expected some of these; `fsar-ledger reproduce` makes all but the last"
        )
    return parts


def experiments_of(database: Database) -> dict[str, Part]:
    """Return the parts of this ledger's runs other than those of the paper's results table and workflows.

    Raises: as `Database.rows`.
    """
    parts = {}
    has_ablations = _has(database, "architecture = 'fsar' AND fleet_size = 4", list(CONFIGURATIONS[1:]))
    has_fleets = _has(database, "fleet_size <> 4 AND scenario IS DISTINCT FROM 'churn'", [FULL])
    rows = dialled_rows(database, pools_seeds=True) if has_ablations or has_fleets else []
    if has_ablations and (ablation := _ablation(database, rows)):
        parts["ablation"] = ablation
    if has_fleets and (scaling := _scaling(database, rows)):
        parts["scaling"] = scaling
    if _has(database, "fleet_size = 4", WITHOUT_ONE) and (part := _mechanisms(database)):
        parts["mechanisms"] = part
    if (churned := database.table(CHURN_SQL)).num_rows:
        relations = {"churned": churned, "departures": database.query("audit/churn")}
        parts["churn"] = Part(ledger_head(database, None), (), relations)
    return parts


def _has(database: Database, condition: str, configurations: list[str]) -> bool:
    """Return whether the ledger holds such runs, before anything is measured: most ledgers hold none."""
    sql = HAS_SQL.format(condition=f"{condition} AND list_contains($names, configuration)")
    return int(database.rows(sql, {"names": configurations})[0]["runs"]) > 0


def _judged(
    database: Database,
    table: Table,
    rows: Sequence[DialledRow],
    dial: Sequence[DialledRow],
    ones: Sequence[DialledRow] = (),
) -> list[Number]:
    return judge.beside(table, rows, judge.drawn_odds(database, table, rows), dial=dial, ones=ones)


def _ablation(database: Database, all_rows: Sequence[DialledRow]) -> Part | None:
    """Return FSAR without some mechanisms, at the encounter rate with most of these. Paper: tab:ablation."""
    rows = [row for row in all_rows if (row.architecture, row.fleet_size) == ("fsar", FOUR_ROBOTS)]
    tables: dict[tuple[str, float | None], list[DialledRow]] = {}
    for row in rows:
        tables.setdefault((row.made_alike_but, row.encounter_mean_s), []).append(row)
    names = {key: {row.configuration for row in group} for key, group in tables.items()}
    ablated = [key for key in tables if names[key] & set(CONFIGURATIONS[1:])]
    if not ablated:
        return None
    chosen = max(ablated, key=lambda key: (len(names[key]), sum(row.n for row in tables[key])))
    table = tables[chosen]
    dial = [row for row in rows if row.made_alike_but == chosen[0] and row.configuration == DIALLED]
    numbers = _judged(database, "ablation", table, dial) + _judged(database, "ablation_text", table, dial)
    head = ledger_head(database, table[0].model_version)
    return Part(head, tuple(numbers), {"encounters": arrow(dial, DialledRow)})


def _scaling(database: Database, all_rows: Sequence[DialledRow]) -> Part | None:
    """Return fleets of other sizes than four robots, with comparable fleets of four. Paper: tab:scaling."""
    rows = [row for row in all_rows if row.configuration == FULL and row.architecture in PAPER_ARCHITECTURES]
    sizes: dict[str, set[int]] = {}
    counts: Counter[str] = Counter()
    for row in rows:
        if row.fleet_size is not None and row.teams_working is not None:
            sizes.setdefault(row.made_alike_but, set()).add(row.fleet_size)
            counts[row.made_alike_but] += row.n
    larger = [alike for alike, of_alike in sizes.items() if of_alike - {FOUR_ROBOTS}]
    if not larger:
        return None
    chosen = max(larger, key=lambda alike: (len(sizes[alike]), counts[alike]))
    means = {row.encounter_mean_s for row in rows if row.made_alike_but == chosen and row.fleet_size != FOUR_ROBOTS}
    table = [row for row in rows if row.made_alike_but == chosen and row.encounter_mean_s in means]
    over_all = _over_all(table)
    of_all = [row for row in table if row.fleet_size is not None and row.teams_working == row.fleet_size // FOUR_ROBOTS]
    ones = [row for row in over_all if row.teams_working == 1]
    numbers = _judged(database, "scaling", of_all, over_all, ones)
    settings: dict[str, Value] = {"settings": sorted({row.setting for row in table})}
    relations = {"loads": arrow(over_all, DialledRow), "costs": database.table(COSTS_SQL, settings)}
    return Part(ledger_head(database, table[0].model_version), tuple(numbers), relations)


def _over_all(rows: Sequence[DialledRow]) -> list[DialledRow]:
    """Return the rows over all scenarios whose runs cover all of them equally often."""
    loads = {row.teams_working for row in rows}
    counts = {load: judge.run_counts(row for row in rows if row.teams_working == load) for load in loads}
    return [
        row
        for row in rows
        if row.scenario is None and judge.is_complete(counts[row.teams_working].get(judge.shape_of(row), {}))
    ]


def _mechanisms(database: Database) -> Part | None:
    """Return the contribution of each mechanism to each metric, in the setting that has the most of them."""
    differences = database.table(DIFFERENCES_SQL, {"configurations": WITHOUT_ONE})
    if not differences.num_rows:
        return None
    head = ledger_head(database, differences["model_version"][0].as_py())
    digests = database.table(DIGESTS_SQL, {"setting": differences["setting"][0].as_py()})
    return Part(head, (), {"differences": differences, "digests": digests})


def _workflows(database: Database) -> dict[str, Part]:
    """Return the results of the runs of the paper's workflows, in the setting that most of them share."""
    groups = database.rows(GROUPS_SQL, {"names": list(PAPER_WORKFLOWS)})
    if not groups:
        return {}
    main, others = groups[0]["made_alike"], sum(row["runs"] for row in groups[1:])
    coverage = "SELECT * FROM mechanism_coverage WHERE made_alike = $made_alike ORDER BY ALL"
    relations = {
        "coverage": database.table(coverage, {"made_alike": main}),
        "other_workflows": pa.table({"runs": [others]}),
    }
    for name, scenario, kind in (
        ("request_timeline", PAPER_WORKFLOWS[0], "RequestIssued.v1"),
        ("failure_timeline", PAPER_WORKFLOWS[1], "ExecutionFailed.v1"),
    ):
        [first] = database.rows(FIRST_SQL, {"made_alike": main, "scenario": scenario, "kind": kind})
        if first["action"] is not None:
            parameters = {"run": first["run"], "action": first["action"]}
            relations[name] = database.query(f"audit/{name}", parameters)
    return {"workflows": Part(ledger_head(database, None), (), relations)}
