"""`view`: a page or a trace of a run, and what it answers to mistakes."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.world import PolicyWindowOpened
from fsar_ledger.ledger.rows.codec import LedgerRun
from tests.cli.conftest import Call, one_message
from tests.ledger.samples import append_all
from tests.sure import known

DATA = re.compile(r'<script type="application/json" id="data">(.*?)</script>', re.DOTALL)


def data_of(page: Path) -> dict[str, Any]:
    found = known(DATA.search(page.read_text("utf-8")))
    document: dict[str, Any] = json.loads(found[1])
    return document


def test_view_writes_a_page_of_the_first_run(ledger: Path, call: Call, tmp_path: Path) -> None:
    out = tmp_path / "run.html"
    said = call("view", ledger, "--out", out)
    assert (said.code, said.err) == (0, "")
    (run,) = data_of(out)["runs"]
    names = list(fsar_ledger.open_ledger(ledger).numbers())
    assert said.out == f"{out}: {out.stat().st_size:,} bytes, run {names[0]}\n"
    assert (run["run"], run["name"], run["ledger"]) == (names[0], "1", f"{ledger}")
    head = fsar_ledger.open_ledger(ledger).head
    assert (run["size"], run["root"], run["is_verified"]) == (head.size, head.root, True)


def test_the_words_are_those_of_log(ledger: Path, call: Call, tmp_path: Path) -> None:
    call("view", ledger, "--run", 3, "--out", tmp_path / "run.html")
    (run,) = data_of(tmp_path / "run.html")["runs"]
    lines = [json.loads(line) for line in call("log", ledger, "--run", 3, "--json").out.splitlines()]
    told = [run["words"][event[3]] for event in run["events"]]
    assert told == [[line[name] for name in ("sender", "receiver", "message", "note", "action_id")] for line in lines]


@pytest.mark.slow
def test_two_runs_say_where_they_part(ledger: Path, call: Call, tmp_path: Path) -> None:
    out = tmp_path / "two.html"
    said = call("view", ledger, "--run", 1, "--with", 2, "--out", out)
    assert said.code == 0, said.err
    first = data_of(out)["first_difference"]
    assert said.out.endswith(f": the first difference is event {first}\n")
    picture = fsar_ledger.open_ledger(ledger).view(out, 1, 2)
    assert (picture.first_difference, len(picture.runs)) == (first, 2)


@pytest.mark.slow
def test_another_ledger_is_asked_for_the_run_of_the_same_name(ledger: Path, call: Call, tmp_path: Path) -> None:
    """And a run beside its like differs nowhere."""
    record = fsar_ledger.open_ledger(ledger).record(2)
    append_all(tmp_path / "other", [[record]])
    said = call("view", ledger, "--run", 2, "--other", tmp_path / "other", "--out", tmp_path / "two.html")
    assert f"the rows of {tmp_path / 'other'} were not compared" in said.err
    assert f"{ledger}" not in said.err
    call("verify", tmp_path / "other")
    said = call("view", ledger, "--run", 2, "--other", tmp_path / "other", "--out", tmp_path / "two.html")
    assert (said.out.endswith(": no difference\n"), said.err) == (True, "")
    assert data_of(tmp_path / "two.html")["is_same"] is True
    said = call("view", ledger, "--run", 1, "--with", 1, "--other", tmp_path / "other", "--out", tmp_path / "two.html")
    assert "the first difference is event" in said.out


def test_a_trace_is_json_of_the_run(ledger: Path, call: Call, tmp_path: Path) -> None:
    out = tmp_path / "run.json"
    said = call("view", ledger, "--run", 2, "--perfetto", out)
    assert (said.code, said.err) == (0, "")
    name = fsar_ledger.open_ledger(ledger).record(2).run_id
    assert said.out == f"{out}: {out.stat().st_size:,} bytes, run {name}\n"
    assert json.loads(out.read_bytes())["otherData"] == {"run": name}


@pytest.mark.slow
def test_the_same_call_writes_the_same_bytes(ledger: Path, call: Call, tmp_path: Path) -> None:
    for name in ("a", "b"):
        call("view", ledger, "--out", tmp_path / f"{name}.html", "--perfetto", tmp_path / f"{name}.json")
    for suffix in (".html", ".json"):
        assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_the_record_of_another_system_is_shown_and_what_it_leaves_out_is_named(call: Call, tmp_path: Path) -> None:
    started = RunStarted(kind="foreign", observes=("policy",), records=("ExecutionStarted",), source="example.org")
    opened = PolicyWindowOpened(robot="robot/X9", scope="local", window="w", outcome="deny")  # type: ignore[arg-type]
    append_all(tmp_path / "ledger", [[LedgerRun("ward", (0, 7), (None, 0), (started, opened))]])
    said = call("view", tmp_path / "ledger", "--out", tmp_path / "ward.html").good()
    assert "not observed" in said.err
    (run,) = data_of(tmp_path / "ward.html")["runs"]
    assert {"execution in part", "recovery"} <= {*run["not_observed"]}
    assert "policy" not in run["not_observed"]


MISTAKES: dict[str, tuple[tuple[str, ...], *tuple[str, ...]]] = {
    "no file": ((), "expected a file to write", "--out FILE.html"),
    "another suffix": (("--out", "run.htm"), "--out run.htm", "'.htm'", "expected .html"),
    "no suffix": (("--out", "run"), "'nothing'", "expected .html"),
    "a trace with the suffix of a page": (("--perfetto", "run.html"), "--perfetto run.html", "expected .json"),
    "an unknown run": (("--run", "door-realy", "--out", "a.html"), "there is no such run", "door-relay"),
    "a number too large": (("--run", "999", "--out", "a.html"), "999"),
    "every run": (("--run", "all", "--out", "a.html"), "run all"),
    "a run beside itself": (("--run", "2", "--with", "2", "--out", "a.html"), "--with 2", "twice", "name another one"),
    "a plan": (("--run", "plan", "--out", "a.html"), "the plan of an experiment, expected a run"),
    "an unknown second run": (("--with", "nobody", "--out", "a.html"), "there is no such run"),
    "a trace of two": (("--with", "2", "--perfetto", "a.json"), "--perfetto a.json and --with 2", "shows one run"),
    "a trace with another ledger": (("--other", "x", "--perfetto", "a.json"), "--other x"),
    "no other ledger": (("--other", "nowhere", "--out", "a.html"), "nowhere"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_message_and_writes_nothing(
    mistake: str, ledger: Path, call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    arguments, *parts = MISTAKES[mistake]
    one_message(call("view", ledger, *arguments), 2, *parts)
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_written_inside_a_ledger_or_over_a_folder(ledger: Path, call: Call, tmp_path: Path) -> None:
    one_message(call("view", ledger, "--out", ledger / "run.html"), 2, "inside the ledger")
    one_message(call("view", ledger, "--perfetto", ledger / "run.json"), 2, "inside the ledger")
    (tmp_path / "folder.html").mkdir()
    one_message(call("view", ledger, "--out", tmp_path / "folder.html"), 2, "found a folder")
    assert not (ledger / "run.html").exists()


def test_a_file_that_cannot_be_written_is_said_to_be_so(ledger: Path, call: Call, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    one_message(call("view", ledger, "--out", tmp_path / "file" / "run.html"), 1, "cannot be written")


def test_mistakes_in_python_name_its_parameters(ledger: Path, tmp_path: Path) -> None:
    asked = fsar_ledger.open_ledger(ledger)
    with pytest.raises(fsar_ledger.FsarLedgerError, match="second=1: found run"):
        asked.view(tmp_path / "a.html", 1, second=1)
    with pytest.raises(fsar_ledger.FsarLedgerError, match=r"out=.*expected \.json"):
        asked.trace(tmp_path / "a.html")
    assert list(tmp_path.iterdir()) == []
