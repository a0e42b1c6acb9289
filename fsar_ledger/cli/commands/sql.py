"""The command `sql`."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger.cli.options import (
    SHOWN_ROWS,
    CsvOption,
    JsonOption,
    LedgerArgument,
    LimitOption,
    MemoryOption,
    NdjsonOption,
    RawOption,
    SecondsOption,
    VerifiedOption,
    WideOption,
    examples,
)
from fsar_ledger.printable import Shown

if TYPE_CHECKING:
    from fsar_ledger.cli.streaming import Form
    from fsar_ledger.metrics.sandbox import Limits

EXAMPLES = examples(
    'fsar-ledger sql out/ledger "SELECT type, count(*) AS events FROM events GROUP BY type ORDER BY events DESC"',
    "fsar-ledger sql out/ledger \"SELECT * FROM request_denied WHERE run_id LIKE '%door-relay%'\" --csv",
    'fsar-ledger sql out/ledger "SELECT denied_by, count(*) AS denials FROM denials(run := 1) GROUP BY denied_by"',
    'fsar-ledger sql out/ledger "SHOW TABLES"',
)


def sql(
    ledger: LedgerArgument,
    select: Annotated[str, typer.Argument(metavar="SELECT", help="One SELECT in DuckDB's SQL.", show_default=False)],
    as_json: JsonOption = False,
    as_csv: CsvOption = False,
    as_ndjson: NdjsonOption = False,
    raw: RawOption = False,
    limit: LimitOption = SHOWN_ROWS,
    wide: WideOption = False,
    verified: VerifiedOption = False,
    seconds: SecondsOption = None,
    memory: MemoryOption = None,
) -> None:
    """Answer a SELECT of your own.

    It can read `events`, one view for each event type, and all of `query --list`; a query with parameters is called,
    as in `FROM denials(run := 1)`. `SHOW TABLES` lists them all, `DESCRIBE NAME` the columns of one. It runs in a
    locked-down process that can read this ledger and nothing else.
    """
    from fsar_ledger.api.limits import limits_of
    from fsar_ledger.cli.streaming import Form

    form = Form(as_json=as_json, as_csv=as_csv, as_ndjson=as_ndjson, raw=raw, limit=limit, wide=wide)
    form.show(answer_select(ledger, select, limits_of(seconds, memory), form, verified=verified))


def answer_select(ledger: Path, select: str, limits: "Limits", form: "Form", *, verified: bool) -> Iterable[Shown]:
    """Return the answer of the SELECT as text, in pieces; the time limit covers all of it.

    Raises: As `Ledger.sql`.
    """
    from fsar_ledger.cli.answering import opened, warn
    from fsar_ledger.cli.streaming import Kept

    asked = opened(ledger, verified=verified)
    with asked.stream(select, limits) as (provenance, columns, batches):
        text = Kept(form.pieces(provenance, columns, batches, asked.numbers))
    warn(ledger, provenance)
    return text
