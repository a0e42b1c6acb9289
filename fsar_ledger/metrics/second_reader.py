"""The rows of a segment by DuckDB's own Parquet reader, compared with those that were decoded by pyarrow: a whole look believes neither alone.

Answers come from the one, proofs and replay from the other. `layout` leaves no way known to us in which a file could say two things to them;
this finds the ways that are not known. Values are compared one by one, not digests of them, which somebody could choose values to fit.
"""

import os
from functools import cache

import pyarrow as pa

from fsar_ledger.errors import QueryFailed

from .database import Database

_DECODED = "decoded_rows"


def read_again(path: str, decoded: pa.Table) -> tuple[str, str] | None:
    """Return what DuckDB finds in the segment at this path and what was expected, None if it finds the decoded rows.

    For `verify.Asked.second_reader`: it can be pickled, and keeps one connection for each process.
    """
    database = _database(os.getpid())
    database.hold(_DECODED, decoded)
    source = "FROM read_parquet('{}', hive_partitioning = false) AS a POSITIONAL JOIN {} AS b".format(path.replace("'", "''"), _DECODED)
    differences = {name: f'a."{name}" IS DISTINCT FROM b."{name}"' for name in decoded.column_names}
    try:
        if not database.direct(f"SELECT count(*) AS n {source} WHERE {' OR '.join(differences.values())}")["n"][0].as_py():
            return None
        counts = ", ".join(f'count(*) FILTER ({difference}) AS "{name}"' for name, difference in differences.items())
        found = database.direct(f"SELECT {counts} {source}").to_pylist()[0]
    except QueryFailed as error:
        return f"a segment that DuckDB cannot read ({error})", "rows that both of our readers read alike"
    finally:
        database.drop(_DECODED)
    name = next((name for name in found if found[name]), decoded.column_names[0])
    return f"{found[name]} values of column {name} that DuckDB reads otherwise than pyarrow", "rows that both of our readers read alike"


@cache
def _database(process: int) -> Database:
    """The connection of this process: one that was opened before a fork is no use after it."""
    return Database(None, (), threads=1, caches_files=False)
