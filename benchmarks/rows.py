"""Measures how long rows take to become CSV, JSON and Parquet, against DuckDB's own COPY; prints the ratios.

python benchmarks/rows.py                    1,000,000 rows, the best of 3
python benchmarks/rows.py --rows 100000      fewer
"""

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import duckdb
import pyarrow as pa

from fsar_ledger.api.files import write_table
from fsar_ledger.api.provenance import Provenance
from fsar_ledger.api.table import Table
from fsar_ledger.cli.streaming import Form

ROWS = """
SELECT
    'fsar.full.door-relay.n4.s42.r' || (i // 500) AS run_id,
    i AS seq,
    i * 1001 AS time_us,
    CASE WHEN i % 3 = 0 THEN NULL ELSE 'robot/B' || (i % 7) END AS robot,
    'A1-' || i || '/1.' || (i % 5) AS action_id,
    ['soft-priority', 'none', 'veto'][1 + i % 3] AS reason,
    i % 2 = 0 AS is_remote,
    i / 7 AS share,
    [i, i + 1] AS places,
    ['robot/A' || (i % 4), 'robot/C1'] AS candidates
FROM range({rows}) AS t(i)
"""
COPY = {"csv": "csv", "ndjson": "json", "json": "json, ARRAY true", "parquet": "parquet, COMPRESSION zstd"}


def ours(table: pa.Table, kind: str, out: Path) -> None:
    """Write the rows as `query --csv`, `--ndjson` and `--json` do, and as `export` writes Parquet."""
    if kind == "parquet":
        write_table(out, table)
        return
    answer = Table(table)
    form = Form(as_csv=kind == "csv", as_ndjson=kind == "ndjson", as_json=kind == "json")
    with out.open("w", encoding="utf-8", newline="") as file:
        file.writelines(form.pieces(Provenance(), answer.columns, answer.batches()))


def duckdb_copy(connection: duckdb.DuckDBPyConnection, kind: str, out: Path) -> None:
    """Write the rows of the table `answer` by COPY."""
    connection.execute(f"COPY answer TO '{out}' (FORMAT {COPY[kind]})")


def best(repeats: int, write: Callable[[Path], None], out: Path) -> tuple[float, int]:
    """Return the seconds of the quickest and the bytes of the file."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        write(out)
        seconds.append(time.perf_counter() - began)
    return min(seconds), out.stat().st_size


def main() -> None:
    """Print a line for each format."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=3)
    asked = parser.parse_args()
    with duckdb.connect() as connection, TemporaryDirectory() as folder:
        table = connection.sql(ROWS.format(rows=asked.rows)).to_arrow_table()
        connection.register("answer", table)
        print(f"{asked.rows:,} rows of {table.num_columns} columns; ratios are ours to DuckDB's")
        for kind in COPY:
            one, other = Path(folder, f"own.{kind}"), Path(folder, f"copy.{kind}")
            own, own_bytes = best(asked.repeats, partial(ours, table, kind), one)
            copy, copy_bytes = best(asked.repeats, partial(duckdb_copy, connection, kind), other)
            print(
                f"{kind:8} {own:6.2f} s and {own_bytes >> 20:4} MiB, COPY {copy:6.2f} s and {copy_bytes >> 20:4} MiB: "
                f"time {own / copy:.2f}, size {own_bytes / copy_bytes:.2f}"
            )


if __name__ == "__main__":
    main()
