"""The command `metrics`."""

from typing import Annotated

import typer

from .options import CsvOption, JsonOption, LedgerArgument, PoolOption, RawOption, VerifiedOption, examples
from .terminal import show

EXAMPLES = examples(
    "fsar-ledger metrics out/ledger",
    "fsar-ledger metrics out/ledger --by scenario",
    "fsar-ledger metrics out/ledger --pool seeds",
    "fsar-ledger metrics out/ledger --verified --json",
)


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
    """Judge a ledger by the metrics: the eight of the paper, then any that were added.

    Mean, SD, 95 % interval and denominator for each architecture, configuration and fleet size; runs of different
    seeds, constants, models or kinds have rows of their own. Shares are in [0,1], latency is in seconds; `-` in a
    table, null in JSON: the metric is not defined there.
    """
    from .answering import opened, warn
    from .output import answer_text, check_form, telling

    check_form(as_json=as_json, as_csv=as_csv, raw=raw)
    found = opened(ledger, verified=verified).metrics(by, pool)  # type: ignore[arg-type]  # it refuses any other text
    rows = found.rows()
    columns = found.columns if rows and (as_json or as_csv) else telling(rows)
    about = found.about
    text = answer_text(
        about.head,
        rows,
        columns,
        rows_verified=about.rows_verified,
        as_json=as_json,
        as_csv=as_csv,
        raw=raw,
        more=about.answer(),
    )
    show(text, raw=raw)
    warn(ledger, about)
