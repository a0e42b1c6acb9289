"""Commands answer people with tables and programs with JSON and CSV that say the same."""

import csv
import io
import json
import os
import sys
from pathlib import Path

import polars as pl
import pytest

from fsar_ledger import __version__
from fsar_ledger.api.simulate import ONE_SCENARIO
from fsar_ledger.api.verbs import ONE_ARCHITECTURE, either
from fsar_ledger.designs import registered
from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.metrics.definitions import metrics
from tests.cli.conftest import SMALL, Call, Called, in_a_process
from tests.ledger.samples import contents
from tests.running import ran

HEAVY = {"duckdb", "pyarrow", "polars", "scipy", "numpy", "matplotlib", "pydantic", "typst", "msgspec"}


def rows_of(called: Called) -> list[dict[str, str]]:
    assert called.code == 0, called.err
    return list(csv.DictReader(io.StringIO(called.out)))


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from fsar_ledger.cli.app import run; run(['--help']); run(['simulate', '--help']); "
        f"run(['query', '--help']); print(*{HEAVY} & sys.modules.keys(), file=sys.stderr)"
    )
    done = ran([sys.executable, "-c", code], check=True)
    assert done.stderr.split() == []


def test_help_lists_every_registered_scenario_and_architecture(call: Call) -> None:
    said = " ".join(call("simulate", "--help").out.split()).replace("- ", "-")
    assert all(name in said for name in registered.scenarios())
    assert either(["night", "day", "a-sixth"]) == "a-sixth, day or night"
    assert either(registered.scenarios()) == ONE_SCENARIO
    assert either(ARCHITECTURES) == ONE_ARCHITECTURE


def test_the_version_is_told_without_typer() -> None:
    code = (
        "import sys; sys.argv[1:] = ['--version']; from fsar_ledger.__main__ import main; main(); print('typer' in "
        "sys.modules)"
    )
    done = ran([sys.executable, "-c", code], check=True)
    assert done.stdout == f"fsar-ledger {__version__}\nFalse\n"


@pytest.mark.slow
def test_a_command_answers_without_pandas_which_pyarrow_would_load(call: Call, ledger: Path, tmp_path: Path) -> None:
    (tmp_path / "pandas.py").write_text("raise SystemExit('pandas is loaded')")
    path = os.pathsep.join((str(tmp_path), *sys.path))
    called = in_a_process("metrics", ledger, "--json", surroundings={"PYTHONPATH": path}).good()
    assert called.out == call("metrics", ledger, "--json").out


def test_no_arguments_show_the_help(call: Call) -> None:
    assert call().out == call("--help").out
    assert call("--help").out.startswith("Usage: fsar-ledger")


def test_simulate_says_what_was_committed(call: Call, ledger: Path, tmp_path: Path) -> None:
    said = call("simulate", tmp_path / "again", *SMALL, "--json")
    head = json.loads(call("info", ledger, "--json").out)["head"]
    assert json.loads(said.out)["head"] == head
    assert f"{head['size']:,} events" in call("simulate", tmp_path / "again", *SMALL).out


@pytest.mark.slow
def test_info_tells_a_complete_ledger_from_one_that_lacks_runs(call: Call, ledger: Path, tmp_path: Path) -> None:
    whole = json.loads(call("info", ledger, "--json").out)
    assert (whole["is_complete"], whole["runs"]) == (True, 12)
    assert {group["runs_to_rectangle"] for group in whole["groups"]} == {0}
    assert sum(group["events"] for group in whole["groups"]) + len(whole["plans"]) == whole["head"]["size"]
    assert whole["models"][0]["parameters"]
    assert "12 runs, complete" in call("info", ledger).out
    uneven = tmp_path / "uneven"
    for architecture, runs in (("fsar", "3"), ("cfc", "2")):
        call("simulate", uneven, *SMALL[:2], "--architecture", architecture, "--runs", runs, "--workers", "1")
    partial = json.loads(call("info", uneven, "--json").out)
    assert partial["is_complete"] is True  # each was planned so
    assert {group["architecture"]: group["runs_to_rectangle"] for group in partial["groups"]} == {"fsar": 0, "cfc": 1}
    assert "not a rectangle: 1 run fewer than if each group had all runs" in call("info", uneven).out


@pytest.mark.slow
def test_metrics_have_the_agreed_columns_in_every_format(call: Call, ledger: Path) -> None:
    answer = json.loads(call("metrics", ledger, "--json").out)
    assert set(answer) == {"head", "rows_verified", "rows", "complete", "missing_count"}
    assert set(answer["head"]) == {"size", "root"}
    agreed = {
        *("architecture", "configuration", "fleet_size", "metric", "mean", "sd"),
        *("n", "ci_low", "ci_high", "published_convention_mean"),
    }
    assert agreed <= set(answer["rows"][0])
    assert len(answer["rows"]) == 3 * len(metrics())
    from_csv = rows_of(call("metrics", ledger, "--csv"))
    assert [float(row["mean"]) if row["mean"] else None for row in from_csv] == [row["mean"] for row in answer["rows"]]
    table = call("metrics", ledger).out.splitlines()
    assert len(table) == 2 + 3 * len(metrics())
    assert table[0].split()[0] == "architecture"


def test_metrics_by_scenario_have_a_row_for_each(call: Call, ledger: Path) -> None:
    rows = json.loads(call("metrics", ledger, "--by", "scenario", "--json").out)["rows"]
    assert {row["scenario"] for row in rows} == {"door-relay", "failure-recovery-chain"}
    assert len(rows) == 2 * 3 * len(metrics())


@pytest.mark.slow
def test_statistics_compare_every_pair(call: Call, ledger: Path) -> None:
    rows = json.loads(call("statistics", ledger, "--json").out)["rows"]
    assert len(rows) == 3 * len(metrics())
    assert len(rows_of(call("statistics", ledger, "--csv"))) == 3 * len(metrics())


def test_queries_are_listed_and_answer(call: Call, ledger: Path) -> None:
    names = [query["name"] for query in json.loads(call("query", "--list", "--all", "--json").out)["queries"]]
    assert {"facts/failures", "metrics/run_metrics", "staging/request_issued"} <= set(names)
    assert [row["name"] for row in rows_of(call("query", "--list", "--all", "--csv"))] == names
    by_part = call("query", "run_metrics", ledger, "--csv")
    assert len(rows_of(by_part)) == 12 * len(metrics())
    assert by_part == call("query", "metrics/run_metrics", ledger, "--csv")


def test_a_long_table_is_cut_and_says_so(call: Call, ledger: Path) -> None:
    cut = call("query", "run_metrics", ledger, "--limit", "5").out.splitlines()
    assert len(cut) == 2 + 5 + 1
    assert cut[-1].startswith(f"... {12 * len(metrics()) - 5} more rows")
    assert len(call("query", "run_metrics", ledger, "--limit", "0").out.splitlines()) == 2 + 12 * len(metrics())


@pytest.mark.slow
def test_sql_answers_with_null_lists_and_text(call: Call, ledger: Path) -> None:
    select = "SELECT count(*) AS events, NULL AS nothing, ['a', 'b'] AS list, TRUE AS yes FROM events"
    size = json.loads(call("info", ledger, "--json").out)["head"]["size"]
    assert json.loads(call("sql", ledger, select, "--json").out)["rows"] == [
        {"events": size, "nothing": None, "list": ["a", "b"], "yes": True}
    ]
    assert rows_of(call("sql", ledger, select, "--csv")) == [
        {"events": str(size), "nothing": "", "list": '["a","b"]', "yes": "true"}
    ]
    assert call("sql", ledger, select).out.splitlines()[2].split() == [str(size), "-", '["a","b"]', "true"]


@pytest.mark.slow
def test_an_answer_without_rows_keeps_its_columns(call: Call, ledger: Path) -> None:
    select = "SELECT run_id, seq FROM events WHERE seq < 0"
    assert call("sql", ledger, select, "--csv").out == "run_id,seq\n"
    assert json.loads(call("sql", ledger, select, "--json").out)["rows"] == []


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_export_writes_every_event(call: Call, ledger: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / "new" / f"events.{suffix}"
    assert call("export", ledger, "--out", out).code == 0
    table = pl.read_csv(out, infer_schema=False) if suffix == "csv" else pl.read_parquet(out)
    head = json.loads(call("info", ledger, "--json").out)["head"]
    assert len(table) == head["size"]
    assert {"run_id", "seq", "type", "path"} <= set(table.columns)
    assert [path.name for path in out.parent.iterdir()] == [out.name]


def test_export_writes_the_answer_of_a_query(call: Call, ledger: Path, tmp_path: Path) -> None:
    out = tmp_path / "run_metrics.csv"
    assert call("export", ledger, "--query", "run_metrics", "--out", out).code == 0
    assert out.read_text().splitlines()[0].startswith("run_id,")
    assert len(out.read_text().splitlines()) == 1 + 12 * len(metrics())


def test_verify_says_what_was_checked(call: Call, ledger: Path) -> None:
    called = call("verify", ledger).good()
    assert "consistent, unsigned" in called.out
    answer = json.loads(call("verify", ledger, "--json").out)
    assert (answer["ok"], answer["problems"]) == (True, [])


@pytest.mark.parametrize(
    ("seed", "zone", "locale", "workers"),
    [pytest.param("1", "UTC", "C", "1", marks=pytest.mark.slow), ("77", "Asia/Kathmandu", "C.UTF-8", "2")],
)
def test_the_ledger_is_the_same_whatever_the_surroundings(
    ledger: Path, tmp_path: Path, seed: str, zone: str, locale: str, workers: str
) -> None:
    surroundings = {"PYTHONHASHSEED": seed, "TZ": zone, "LC_ALL": locale}
    assert in_a_process("simulate", tmp_path / "again", *SMALL[:-1], workers, surroundings=surroundings).code == 0
    assert contents(tmp_path / "again") == contents(ledger)
