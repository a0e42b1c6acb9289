"""The commands `metrics` and `statistics`: the paper's judgement of a ledger."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.errors import UsageError

from .options import CsvOption, JsonOption, LedgerArgument, PoolOption, RawOption, VerifiedOption, examples, pools_seeds
from .terminal import say, show

if TYPE_CHECKING:
    from .output import Row

METRICS = examples(
    "fsar-ledger metrics out/ledger",
    "fsar-ledger metrics out/ledger --by scenario",
    "fsar-ledger metrics out/ledger --pool seeds",
    "fsar-ledger metrics out/ledger --verified --json",
)
STATISTICS = examples("fsar-ledger statistics out/ledger", "fsar-ledger statistics out/ledger --csv")
SETTING = ("family", "family_tests", "seed", "seeds", "kind", "source", "model_version", "constants")
"""Columns that a table for people has only where they tell rows apart."""


def metrics(
    ledger: LedgerArgument,
    by: Annotated[
        str | None, typer.Option(metavar="scenario", help="One row for each scenario.", show_default=False)
    ] = None,
    pool: PoolOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
) -> None:
    """Judge a ledger by the eight metrics of the paper.

    Mean, SD, 95 % interval and denominator for each architecture, configuration and fleet size; runs of different seeds, constants, models or
    kinds have rows of their own. Shares are in [0,1], latency is in seconds; `-` in a table, null in JSON: the metric is not defined there.
    """
    from fsar_ledger.metrics.results import metric_rows

    from .answering import answering, of_plans, warn_of_missing
    from .output import answer_text, plain

    if by not in (None, "scenario"):
        raise UsageError(f"--by {by}: expected --by scenario, or no --by")
    pooled = pools_seeds(pool)
    with answering(ledger, verified=verified) as database:
        rows = plain(metric_rows(database, by_scenario=by is not None, pools_seeds=pooled))
        columns = [name for name in rows[0] if by or name != "scenario"] if rows else []
        chosen = [{name: row[name] for name in columns} for row in rows]
        shown = columns if as_json or as_csv else _telling(chosen)
        show(
            answer_text(
                database.head,
                chosen,
                shown,
                rows_verified=database.rows_verified,
                as_json=as_json,
                as_csv=as_csv,
                raw=raw,
                more=of_plans(database),
            ),
            raw=raw,
        )
        warn_of_missing(ledger, database)


def _telling(rows: "Sequence[Row]") -> list[str]:
    """The columns without those of a setting that is the same in every row."""
    return [name for name in (rows[0] if rows else ()) if name not in SETTING or len({row[name] for row in rows}) > 1]


def statistics(
    ledger: LedgerArgument,
    pool: PoolOption = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
) -> None:
    """Compare the architectures of a ledger in pairs, and FSAR with itself without a mechanism.

    For each metric and pair: paired t, Wilcoxon signed-rank, effect sizes, exact McNemar for human intervention, and Holm over the 24 tests of the
    architectures, or over those of all ablations. Runs that did not meet the same world are named first, and left out: exit code 1 where facts differ
    that an experiment makes alike. What cannot be compared is said, and why. A run without failures counts as the paper counts it (containment 1,
    latency 0 s); `query statistics/pairwise_tests_defined` leaves such pairs out.
    Beside it, in the columns pooled_*, stands the test of what the results table prints: containment and latency pooled over failures.
    """
    from .answering import answering, of_plans, warn_of_missing
    from .comparing import compared
    from .output import check_form, csv_text, json_text, table_text

    pooled = pools_seeds(pool)
    check_form(as_json=as_json, as_csv=as_csv, raw=raw)
    with answering(ledger, verified=verified) as database:
        found = compared(database, pooled=pooled)
        if as_json:
            document = {
                **of_plans(database),
                "rows": found.rows,
                "differing_worlds": found.differing,
                "not_compared": found.not_compared,
                "remarks": [*found.remarks, *found.notes],
            }
            show(json_text(database.head, document, database.rows_verified))
        elif as_csv:
            say(*found.before, *found.after)
            show(csv_text(found.rows, found.columns, raw=raw), raw=raw)
        else:
            table = table_text(found.rows, _telling(found.rows)) if found.rows else printable.lines()
            above, below = (
                [*found.before, *([""] if found.before and found.rows else [])],
                ["", *found.after, *found.notes] if found.after or found.notes else [],
            )
            show(printable.joined(printable.lines(*above), table, printable.lines(*below)))
        warn_of_missing(ledger, database)
    if any(one.is_fault for one in found.differing):
        raise typer.Exit(1)
