"""The verb `sql`: a SELECT of your own."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

from fsar_ledger.base.errors import UsageError, option

from .verbs import STREAM, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.metrics.sandbox import Limits

    from .ledger import Ledger
    from .table import Rows, Table


MEMORY_MIB_MIN = 1024
SECONDS_MAX = 365 * 86_400


def limits_of(seconds: int | None = None, memory_mib: int | None = None) -> "Limits":
    """Return these limits, with defaults for the rest.

    Raises:
        UsageError: Less than a second or more than a year; or less memory than the process needs for the packaged
            queries, or more than a machine has.
    """
    from fsar_ledger.base.memory import MOST_MIB
    from fsar_ledger.metrics.sandbox import Limits

    default = Limits()
    seconds = default.seconds if seconds is None else seconds
    memory_mib = default.memory_bytes >> 20 if memory_mib is None else memory_mib
    if not 1 <= seconds <= SECONDS_MAX:
        raise UsageError(f"{option('seconds', seconds)}: expected at least 1 and at most {SECONDS_MAX}, a year")
    if not MEMORY_MIB_MIN <= memory_mib <= MOST_MIB:
        raise UsageError(
            f"{option('memory_mib', memory_mib)}: expected at least {MEMORY_MIB_MIN} (MiB), of which the process "
            f"itself takes 400, and at most {MOST_MIB}"
        )
    return Limits(seconds=seconds, memory_bytes=memory_mib << 20)


@contextmanager
def rows_of_select(ledger: "Ledger", select: str, seconds: int | None, memory_mib: int | None) -> "Iterator[Rows]":
    """Yield the answer of a SELECT; the time limit covers all of it. Raises: As `sql`."""
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.metrics.untrusted import stream_untrusted

    from .table import Rows

    limits = limits_of(seconds, memory_mib)
    with stream_untrusted(ledger.path, select, limits, ledger.demanded) as found:
        yield Rows(Provenance(found.head, found.rows_verified), found.columns, found.batches)


@verb(
    'sql out/ledger "SELECT type, count(*) AS events FROM events GROUP BY type ORDER BY events DESC"',
    "sql out/ledger \"SELECT * FROM request_denied WHERE run_id LIKE '%door-relay%'\" --csv",
    'sql out/ledger "SELECT denied_by, count(*) AS denials FROM denials(run := 1) GROUP BY denied_by"',
    'sql out/ledger "SHOW TABLES"',
    takes=STREAM,
    call=rows_of_select,
    is_apart=lambda _: True,
)
def sql(
    ledger: "Ledger",
    select: Annotated[str, argument("SELECT", "One SELECT in DuckDB's SQL.")],
    *,
    seconds: int | None = declare("N", "The time limit for a SELECT of your own.", "60"),
    memory_mib: int | None = declare(
        "MIB", "The memory limit for a SELECT of your own; at least 1024.", "4096", flag="--memory"
    ),
) -> "Table":
    """Answer a SELECT of your own.

    It can read `events`, one view for each event type, and all of `query --list`; a query with parameters is called,
    as in `FROM denials(run := 1)`. `SHOW TABLES` lists them all, `DESCRIBE NAME` the columns of one. It runs in a
    locked-down process that can read this ledger and nothing else.

    Raises:
        QueryFailed: It is not one SELECT, fails, needs something outside the ledger, or meets a limit.
    """
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.metrics.untrusted import table_untrusted

    from .table import Table

    rows, head, rows_verified = table_untrusted(ledger.path, select, limits_of(seconds, memory_mib), ledger.demanded)
    return Table(rows, Provenance(head, rows_verified))
