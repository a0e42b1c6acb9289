"""The commands `metrics` and `statistics`: the paper's judgement of a ledger."""

from typing import Annotated

import typer

from fsar_ledger.errors import UsageError

from .options import CsvOption, JsonOption, LedgerArgument, RawOption, VerifiedOption, examples
from .terminal import show

METRICS = examples(
    "fsar-ledger metrics out/ledger",
    "fsar-ledger metrics out/ledger --by scenario",
    "fsar-ledger metrics out/ledger --verified --json",
)
STATISTICS = examples("fsar-ledger statistics out/ledger", "fsar-ledger statistics out/ledger --csv")


def metrics(
    ledger: LedgerArgument,
    by: Annotated[str | None, typer.Option(metavar="scenario", help="One row for each scenario.", show_default=False)] = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    raw: RawOption = False,
) -> None:
    """Judge a ledger by the eight metrics of the paper.

    Mean, SD, 95 % interval and denominator for each architecture, configuration and fleet size. Shares are in [0,1], latency is in
    seconds; `-` in a table, null in JSON: the metric is not defined there.
    """
    from fsar_ledger.metrics.results import metric_rows

    from .answering import answering, warn_of_missing
    from .output import answer_text, plain

    if by not in (None, "scenario"):
        raise UsageError(f"--by {by}: expected --by scenario, or no --by")
    with answering(ledger, verified=verified) as database:
        rows = plain(metric_rows(database, by_scenario=by is not None))
        columns = [name for name in rows[0] if by or name != "scenario"] if rows else []
        chosen = [{name: row[name] for name in columns} for row in rows]
        show(answer_text(database.head, chosen, rows_verified=database.rows_verified, as_json=as_json, as_csv=as_csv, raw=raw), raw=raw)
        warn_of_missing(ledger, database)


def statistics(
    ledger: LedgerArgument, verified: VerifiedOption = False, as_json: JsonOption = False, as_csv: CsvOption = False, raw: RawOption = False
) -> None:
    """Compare the architectures of a ledger in pairs.

    For each metric and pair: paired t, Wilcoxon signed-rank, effect sizes, exact McNemar for human intervention, and Holm over the 24.
    """
    from fsar_ledger.metrics.results import statistic_rows

    from .answering import answering, warn_of_missing
    from .output import answer_text, plain

    with answering(ledger, verified=verified) as database:
        rows = plain(statistic_rows(database))
        show(answer_text(database.head, rows, rows_verified=database.rows_verified, as_json=as_json, as_csv=as_csv, raw=raw), raw=raw)
        warn_of_missing(ledger, database)
