"""`export --as` from the command line: what it says, and what it answers to mistakes."""

import sys
from pathlib import Path

import pytest

import fsar_ledger
from tests.cli.conftest import Call, call, one_message

__all__ = ["call"]  # a fixture


@pytest.mark.parametrize("format", ["ocel", "otlp"])
def test_the_answer_says_what_is_in_the_file_and_what_is_not(
    ledger: fsar_ledger.Ledger, call: Call, tmp_path: Path, format: str
) -> None:
    out = tmp_path / "run.json"
    first, *notes = call("export", ledger.path, "--as", format, "--run", 1, "--out", out).good().out.splitlines()
    answer = ledger.export(out, format=format, run=1)
    assert first == f"{out}: {answer.row_count:,} events"
    assert notes == list(answer.notes)
    assert any("1970-01-01T00:00:00Z" in note for note in notes)


@pytest.mark.slow
def test_perfetto_is_the_trace_that_view_writes(ledger: fsar_ledger.Ledger, call: Call, tmp_path: Path) -> None:
    said = call("export", ledger.path, "--as", "perfetto", "--run", 2, "--out", tmp_path / "a.json").good().out
    call("view", ledger.path, "--run", 2, "--perfetto", tmp_path / "b.json").good()
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    assert said.endswith(f": {len(ledger.record(2).events):,} events\n")


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ("--as xes --out OUT.json", ("--as xes", "expected delta, mcap, ocel, otlp or perfetto", "choose")),
        ("--as ocel --out OUT.mcap", ("OUT.mcap", "'.mcap'", "expected .json", "choose")),
        ("--as mcap --out OUT.json", ("OUT.json", "'.json'", "expected .mcap", "choose")),
        ("--as delta --out OUT.json", ("OUT.json", "expected the name of a new folder", "choose")),
        ("--as delta --out TAKEN", ("TAKEN", "found a file or folder", "expected a free path")),
        ("--as delta --run 1 --out OUT", ("--run 1", "whole segments", "leave the run out")),
        ("--as otlp --run 99 --out OUT.json", ("99", "expected")),
        ("--as otlp --out LEDGER/traces.json", ("inside the ledger", "choose")),
        ("--as perfetto --out OUT.json", ("6 runs", "expected one", "--run")),
        ("--as ocel --tiles --out OUT.json", ("--as ocel", "tiles", "expected none", "leave one out")),
        ("--as ocel --query failures --out OUT.json", ("--as ocel", "a query", "leave one out")),
        ("--run 1 --out OUT.csv", ("--run 1", "found no format", "--as FORMAT")),
    ],
)
def test_a_wrong_call_is_one_message_and_writes_nothing(
    ledger: fsar_ledger.Ledger, call: Call, tmp_path: Path, words: str, parts: tuple[str, ...]
) -> None:
    (tmp_path / "TAKEN").mkdir()
    before = sorted(ledger.path.rglob("*"))
    places = {"OUT": str(tmp_path / "OUT"), "TAKEN": str(tmp_path / "TAKEN"), "LEDGER": str(ledger.path)}
    for name, place in places.items():
        words = words.replace(name, place)
    one_message(call("export", ledger.path, *words.split()), 2, *parts)
    assert [path.name for path in tmp_path.iterdir()] == ["TAKEN"]
    assert sorted(ledger.path.rglob("*")) == before


@pytest.mark.parametrize(
    ("format", "name", "library", "extra"),
    [("mcap", "a.mcap", "mcap", "mcap"), ("delta", "a", "deltalake", "lake")],
)
def test_an_absent_library_is_named_with_how_to_install_it(
    ledger: fsar_ledger.Ledger,
    call: Call,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    format: str,
    name: str,
    library: str,
    extra: str,
) -> None:
    for module in (library, f"{library}.writer", f"{library}.exceptions"):
        monkeypatch.setitem(sys.modules, module, None)
    said = call("export", ledger.path, "--as", format, "--out", tmp_path / name)
    one_message(said, 2, f"--as {format}", f"no library {library}", f'pip install "fsar-ledger[{extra}]"')
    assert list(tmp_path.iterdir()) == []


def test_progress_is_told_in_commits_and_ends_with_the_last(ledger: fsar_ledger.Ledger, tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    ledger.export(tmp_path / "a.json", format="otlp", progress=lambda done, count: seen.append((done, count)))
    commits = ledger.head.commits
    assert seen == sorted(seen)
    assert seen[-1] == (commits, commits)
