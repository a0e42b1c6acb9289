"""Measure how much each mechanism contributes to each number.

Each architecture is compared in full and without one mechanism, on the same worlds, metric by metric.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import msgspec

from fsar_ledger.events.configuration import (
    EVERY_MECHANISM,
    MECHANISMS_OF,
    ON_RECORD_ALONE,
    removed_mechanisms,
    without,
)
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.definitions import published_metrics
from fsar_ledger.report import printing
from fsar_ledger.report.findings import ARCHITECTURES, MAIN_FLEET_SIZE, Findings, Mechanisms, Row, interval
from fsar_ledger.report.result_rows import ledger_head
from fsar_ledger.report.sections import Sourced, head_words

QUERY = "statistics/mechanism_differences"
QUERIES = (QUERY,)
LEVEL = 0.05  # a mechanism carries a number below this p, adjusted over all tests of the table
MAX_OTHERS = 2  # mechanisms named beside the one that carries most

HELD_SQL = """
    SELECT count(*) AS runs
    FROM runs
    WHERE fleet_size = $fleet_size AND list_contains($configurations, configuration)
"""
ROWS_SQL = f"""
    SELECT *
    FROM {QUERY.partition("/")[2]}
    WHERE pools_seeds = $pooled AND fleet_size = $fleet_size AND list_contains($configurations, configuration)
        AND metric IN (SELECT metric FROM metric_definitions WHERE is_published)
"""
DIGESTS_SQL = """
    SELECT DISTINCT runs.parameters_sha256
    FROM runs
    INNER JOIN run_settings AS settings ON runs.run_id = settings.run_id
    WHERE settings.setting = $setting AND runs.parameters_sha256 IS NOT NULL
    ORDER BY runs.parameters_sha256
"""


def mechanisms_of(database: Database, *, pools_seeds: bool = False) -> Mechanisms | None:
    """Return what each mechanism adds to each metric, in the setting that has the most of them.

    None if the ledger holds no architecture without a mechanism.
    """
    chosen: dict[str, Any] = {
        "fleet_size": MAIN_FLEET_SIZE,
        "configurations": [without([name]) for name in EVERY_MECHANISM],
    }
    if not database.rows(HELD_SQL, chosen)[0]["runs"]:
        return None
    tables: dict[tuple[str, int | None], list[Row]] = {}
    for row in database.rows(ROWS_SQL, chosen | {"pooled": pools_seeds}):
        tables.setdefault((row["setting"], row["seed"]), []).append(row)
    if not tables:
        return None
    rows = max(tables.values(), key=lambda one: (len(one), sum(row["n"] for row in one)))
    head = ledger_head(database, rows[0]["model_version"])
    digests = tuple(row["parameters_sha256"] for row in database.rows(DIGESTS_SQL, {"setting": rows[0]["setting"]}))
    return Mechanisms(head, tuple(sorted(map(_named, rows), key=_place)), digests)


def _named(row: Row) -> Row:
    """Return the row with its mechanism and its interval as a pair.

    `is_marked`: the interval excludes 0. `stands`: the difference is significant after adjustment over all tests.
    """
    [mechanism] = removed_mechanisms(row["configuration"])
    ends = interval(row["ci_low"], row["ci_high"])
    is_marked = ends is not None and not ends[0] <= 0 <= ends[1]
    stands = row["p_holm"] is not None and row["p_holm"] < LEVEL
    return row | {"mechanism": mechanism, "interval": ends, "is_marked": is_marked, "stands": stands}


def _place(row: Row) -> tuple[int, int, int]:
    """Return the sort key of the table: the paper's architectures, their mechanisms and metrics in order."""
    names = list(MECHANISMS_OF[row["architecture"]])
    return ARCHITECTURES.index(row["architecture"]), names.index(row["mechanism"]), row["position"]


def carried(found: Mechanisms) -> list[Row]:
    """Return a row for each cell of the results table: what carries most of it, what else, and how many were tested.

    `mean` and `n` are over the pairs of that mechanism; if none stands, over those of the one with most pairs. Another
    mechanism with another number of pairs says so.
    """
    cells = []
    for spec in published_metrics():
        for architecture in ARCHITECTURES:
            asked = [row for row in found.rows if (row["metric"], row["architecture"]) == (spec.name, architecture)]
            bearing = sorted((row for row in asked if row["stands"]), key=lambda row: -abs(row["mean_difference"]))
            cell: Row = {"metric": spec.name, "architecture": architecture, "asked": len(asked)}
            most = bearing[0] if bearing else None
            cell |= {
                name: None if most is None else most[name]
                for name in ("mechanism", "mean_difference", "interval", "p_holm")
            }
            shown = most or max(asked, key=lambda row: row["n"], default=None)
            cell |= {
                name: None if shown is None else shown[source] for name, source in (("mean", "full_mean"), ("n", "n"))
            }
            cell["others"] = _others(bearing[1:], cell["n"])
            cell["words"] = _words(cell["mechanism"]) if most else "none of these" if asked else None
            cells.append(cell)
    return cells


def _others(rows: Sequence[Row], pairs: int | None) -> str | None:
    """Name the next mechanisms with what they add, and their number of pairs if it differs from the first."""
    named = []
    for row in rows[:MAX_OTHERS]:
        of = "" if row["n"] == pairs else f" (of {printing.integer(row['n'])} pairs)"
        named.append(f"{_words(row['mechanism'])} {signed(row['metric'], row['mean_difference'])}{of}")
    more = [f"{len(rows) - MAX_OTHERS} more"] if len(rows) > MAX_OTHERS else []
    return ", ".join([*named, *more]) or None


def _words(mechanism: str) -> str:
    return mechanism.replace("-", " ")


def signed(metric: str, value: float) -> str:
    """Format a difference in the metric's printed unit, with its sign."""
    printed = printing.in_metric(metric, value)
    return printed if value <= 0 or not any(digit in "123456789" for digit in printed) else f"+{printed}"


def tables(findings: Findings, sourced: Sourced) -> dict[str, printing.Table]:
    """Return the tables of differences and of what carries each cell; none if no ledger has such runs."""
    found = findings.mechanisms
    if found is None:
        return {}
    source = sourced(QUERY)
    cells = [
        row
        | {"mean_difference": None if row["mean_difference"] is None else signed(row["metric"], row["mean_difference"])}
        for row in carried(found)
    ]
    return {"mechanism-differences": _wide(found.rows, source), "carried": printing.table("carried", cells, source)}


def _wide(rows: Iterable[Row], source: str) -> printing.Table:
    """Return a row for each mechanism and a column for each metric: what it adds, and below it the interval.

    Bold where the interval excludes 0.
    """
    lines: dict[tuple[str, str], dict[str, Any]] = {}
    for row in rows:
        line = lines.setdefault(
            (row["architecture"], row["mechanism"]),
            {"architecture": row["architecture"], "words": _words(row["mechanism"]), "n": 0},
        )
        line[row["metric"]] = row
        line["n"] = max(line["n"], row["n"])
    blank = dict.fromkeys(spec.name for spec in published_metrics())
    plain = printing.table("mechanism-differences", [blank | line for line in lines.values()], source)
    return msgspec.structs.replace(plain, rows=tuple(tuple(map(_difference, row)) for row in plain.rows))


def _difference(cell: printing.Cell) -> printing.Cell:
    """Format the cell of a metric: a lone 0 if no pair of runs differs, no interval if too few do."""
    if not isinstance(cell.value, dict):
        return cell
    row = cell.value
    value = [row["mean_difference"], row["ci_low"], row["ci_high"]]
    if row["mean_difference"] is None:
        return printing.Cell(value, printing.NOTHING, "quiet")
    if not row["differing_pairs"]:
        return printing.Cell(value, "0", "quiet")
    ends = (
        "no interval"
        if row["interval"] is None
        else " to ".join(printing.in_metric(row["metric"], end) for end in row["interval"])
    )
    return printing.Cell(
        value, f"{signed(row['metric'], row['mean_difference'])}\n{ends}", "strong" if row["is_marked"] else "plain"
    )


def _other_constants(found: Mechanisms, expected: str | None) -> str | None:
    """Name the constants of these runs if those of the results (None: unknown) differ from them."""
    if expected is None or expected in found.parameters_sha256:
        return None
    return printing.words(", ".join(digest[:12] for digest in found.parameters_sha256) or "not on record")


def sentences(findings: Findings) -> dict[str, Any] | None:
    """Return what the sentences say: the runs, how many tests stand, what each mechanism is. None without runs."""
    found = findings.mechanisms
    if found is None:
        return None
    tested = [row for row in found.rows if row["p_holm"] is not None]
    held = {(row["architecture"], row["mechanism"]) for row in found.rows}
    every = {(architecture, name) for architecture, names in MECHANISMS_OF.items() for name in names}
    return {
        **head_words(findings, found.head),
        "other_constants": _other_constants(found, findings.parameters_sha256),
        "mechanisms": len(held),
        "missing": len(every - held),
        "differences": len(found.rows),
        "unmoved": sum(not row["differing_pairs"] for row in found.rows),
        "marked": sum(row["is_marked"] for row in found.rows),
        "tests": len(tested),
        "standing": sum(row["stands"] for row in tested),
        "on_record": [
            _words(name) for name in EVERY_MECHANISM if name in ON_RECORD_ALONE and any(name == one for _, one in held)
        ],
        "meaning": [
            {
                "architecture": architecture.upper(),
                "each": [
                    {"name": _words(name), "what": what} for name, what in names.items() if (architecture, name) in held
                ],
            }
            for architecture, names in MECHANISMS_OF.items()
            if any(one == architecture for one, _ in held)
        ],
    }
