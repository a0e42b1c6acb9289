"""Measures how long rows take to become CSV, JSON and Parquet, against DuckDB's own COPY; prints the ratios.

python benchmarks/rows.py                        1,000,000 rows, the best of 3
python benchmarks/rows.py --rows 100000          fewer
python benchmarks/rows.py --ledger out/ledger    the commands `sql` and `export`, from start to end, against those of
                                                 DuckDB's command line, `duckdb`, over the same segments
"""

import argparse
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import duckdb
import pyarrow as pa

from fsar_ledger.api.files import write_table
from fsar_ledger.api.table import Table
from fsar_ledger.cli.render import Form

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
        file.writelines(form.pieces(answer, form.screen()))


def duckdb_copy(connection: duckdb.DuckDBPyConnection, kind: str, out: Path) -> None:
    """Write the rows of the table `answer` by COPY."""
    connection.execute(f"COPY answer TO '{out}' (FORMAT {COPY[kind]})")


def show(name: str, repeats: int, own: Callable[[Path], None], duckdbs: Callable[[Path], None], suffix: str) -> None:
    """Print the quickest of both, the bytes that they wrote, and the ratios."""
    with TemporaryDirectory() as folder:
        own_s, own_bytes = best(repeats, own, Path(folder, f"own.{suffix}"))
        duckdb_s, duckdb_bytes = best(repeats, duckdbs, Path(folder, f"duckdb.{suffix}"))
    print(
        f"{name:15} {own_s:6.2f} s and {own_bytes >> 20:5} MiB, DuckDB {duckdb_s:6.2f} s and {duckdb_bytes >> 20:5} "
        f"MiB: time {own_s / duckdb_s:.2f}, size {own_bytes / duckdb_bytes:.2f}",
        flush=True,
    )


def best(repeats: int, write: Callable[[Path], None], out: Path) -> tuple[float, int]:
    """Return the seconds of the quickest and the bytes of the file."""
    seconds = []
    for _ in range(repeats):
        began = time.perf_counter()
        write(out)
        seconds.append(time.perf_counter() - began)
    return min(seconds), out.stat().st_size


def compare_writers(rows: int, repeats: int) -> None:
    """Compare what makes text and files of rows in memory."""
    with duckdb.connect() as connection:
        table = connection.sql(ROWS.format(rows=rows)).to_arrow_table()
        connection.register("answer", table)
        print(f"{rows:,} rows of {table.num_columns} columns; ratios are ours to those of COPY")
        for kind in COPY:
            show(kind, repeats, partial(ours, table, kind), partial(duckdb_copy, connection, kind), kind)


def compare_commands(ledger: Path, repeats: int) -> None:
    """Compare commands that write all events, from their start to their end."""
    own_cli, duckdb_cli = Path(sys.executable).with_name("fsar-ledger"), shutil.which("duckdb")
    if duckdb_cli is None:
        raise SystemExit("duckdb: not found on the PATH; install DuckDB's command line")
    segments = ", ".join(f"'{path.resolve()}'" for path in sorted(ledger.glob("segments/*.parquet")))
    select = f"SELECT * FROM read_parquet([{segments}])"

    def shown(*command: object) -> Callable[[Path], None]:
        return lambda out: run(command, out)

    def written(*command: object) -> Callable[[Path], None]:
        return lambda out: run([str(word).replace("OUT", str(out)) for word in command], Path(os.devnull))

    print(f"all events of {ledger}; ratios are ours to those of DuckDB's command line")
    for form, mode in (("--csv", "-csv"), ("--json", "-json"), ("--ndjson", "-jsonlines")):
        own = shown(own_cli, "sql", ledger, "SELECT * FROM events", form, "--seconds", 600)
        show(f"sql {form}", repeats, own, shown(duckdb_cli, mode, "-c", select), "text")
    for kind in ("csv", "ndjson", "parquet"):
        own = written(own_cli, "export", ledger, "--out", "OUT")
        copy = written(duckdb_cli, "-c", f"COPY ({select}) TO 'OUT' (FORMAT {COPY[kind]})")
        show(f"export .{kind}", repeats, own, copy, kind)


def run(command: Sequence[object], out: Path) -> None:
    """Run the command with its answer in this file."""
    with out.open("wb") as file:
        subprocess.run(list(map(str, command)), stdout=file, stderr=subprocess.DEVNULL, check=True)


def main() -> None:
    """Print a line for each format."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--ledger", type=Path)
    asked = parser.parse_args()
    if asked.ledger is None:
        compare_writers(asked.rows, asked.repeats)
    else:
        compare_commands(asked.ledger, asked.repeats)


if __name__ == "__main__":
    main()
