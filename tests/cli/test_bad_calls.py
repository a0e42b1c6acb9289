"""What a user gets wrong is answered by one clear message and the agreed exit code."""

import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from fsar_ledger.cli import app
from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.runtime.experiment import ORIGIN
from tests.cli.conftest import SMALL, Call, one_message
from tests.ledger.samples import contents
from tests.quick import few


@pytest.fixture
def copy(ledger: Path, tmp_path: Path) -> Path:
    """A ledger that a test may damage."""
    return Path(shutil.copytree(ledger, tmp_path / "copy"))


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--architecture", "fsra"), ("architecture 'fsra'", "did you mean fsar", "cfc")),
        (("--scenario", "door_relay"), ("scenario 'door_relay'", "did you mean door-relay")),
        (("--without", "trust-eval"), ("mechanism 'trust-eval'", "did you mean trust-evaluation")),
        (("--architecture", "zzzz"), (f"architecture 'zzzz'; expected one of {', '.join(ARCHITECTURES)}\n",)),
        (("--runs", "0"), ("runs", "0")),
        (("--runs", "-3"), ("runs", "-3")),
        (("--runs", "many"), ("--runs", "'many'", "fsar-ledger simulate --help")),
        (("--fleet-size", "6"), ("6", "4")),
        (("--fleet-size", "0"), ("0",)),
        (("--teams-working", "2"), ("teams working: found 2", "expected 1 to 1")),
        (("--task-sets", "9"), ("task sets: found 9", "expected 1 to 5")),
        (("--seed", "-1"), ("seed", "-1")),
        (("--workers", "0"), ("--workers 0", "at least 1")),
        (("--colour",), ("--colour",)),
        (("--architecture", "cfc", "--without", "shared-registry"), ("cfc", "fsar")),
    ],
)
def test_an_impossible_experiment_is_refused_before_anything_is_written(
    call: Call, tmp_path: Path, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    one_message(call("simulate", tmp_path / "new", *arguments), 2, *parts)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("simulat",), ("'simulate'",)),
        (("recover", "LEDGER"), ("No such command 'recover'", "fsar-ledger --help")),  # its name before 0.9.0
        (("query", "policy_violation", "LEDGER"), ("policy_violations", "did you mean")),
        (("query", "failures"), ("NAME and LEDGER", "--list")),
        (("query", "failures", "LEDGER", "--param", "robot"), ("NAME=VALUE",)),
        (("query", "failures", "LEDGER", "--param", "=x"), ("NAME=VALUE",)),
        (("query", "failures", "LEDGER", "--param", "colour=red"), ("colour",)),
        (("query", "failures", "LEDGER", "--param", "a=1", "--param", "a=2"), ("'1'",)),
        (("metrics", "LEDGER", "--by", "robot"), ("--by scenario",)),
        (("export", "LEDGER", "--out", "events.txt"), ("expected .csv, .parquet, .ndjson or .jsonl",)),
        (("export", "LEDGER", "--out", "events"), ("expected .csv, .parquet, .ndjson or .jsonl",)),
    ],
    ids=lambda words: " ".join(words),
)
def test_a_wrong_call_is_one_message_and_writes_nothing(
    call: Call,
    ledger: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    parts: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    one_message(call(*(ledger if word == "LEDGER" else word for word in arguments)), 2, *parts)
    assert list(tmp_path.iterdir()) == []


def leaves(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every command that does something, with the words that call it."""
    for name, one in getattr(command, "commands", {}).items():
        yield from leaves(one, (*path, name))
    if not hasattr(command, "commands"):
        yield path, command


DOUBLED = [
    (path, option.opts[0])
    for path, command in leaves(app._commands())
    for option in command.params
    if option.param_type_name == "option" and not (option.multiple or option.is_flag)
]


@pytest.mark.parametrize(("path", "option"), DOUBLED, ids=[" ".join((*path, option)) for path, option in DOUBLED])
def test_an_option_with_one_value_is_refused_if_it_is_given_twice_or_without_it(
    call: Call, path: tuple[str, ...], option: str
) -> None:
    told = f"`fsar-ledger {' '.join(path)} --help`"
    one_message(call(*path, option, "1", f"{option}=2"), 2, f"{option}: found it 2 times, expected it once", told)
    one_message(call(*path, option), 2, option, f"(see {told})")


def test_options_of_several_values_and_flags_may_be_given_twice(call: Call, ledger: Path) -> None:
    assert call("log", ledger, "--about", "policy", "--about", "trust", "--json", "--json").code == 0
    assert call("query", "denials", ledger, "--param", "run=1", "--param", "action=all").code == 0


def test_an_output_that_is_no_ledger_is_left_alone(call: Call, tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "cat.txt").write_text("miau")
    one_message(call("simulate", folder, *SMALL), 2, str(folder))
    one_message(call("simulate", folder / "cat.txt", *SMALL), 2, "cat.txt")
    assert contents(folder) == {"cat.txt": b"miau"}


@pytest.mark.parametrize("command", ["info", "metrics", "statistics", "compare", "verify"])
def test_a_place_without_ledger_is_named(call: Call, tmp_path: Path, command: str) -> None:
    one_message(call(command, tmp_path / "nowhere"), 2, str(tmp_path / "nowhere"), "simulate")


@pytest.mark.parametrize("command", ["info", "metrics", "verify", "maintain recover"])
def test_an_interrupted_creation_is_no_damage_and_can_be_finished(call: Call, tmp_path: Path, command: str) -> None:
    ledger = tmp_path / "begun"
    for name in ("segments", "staging", "staging/ledger.json.0123456789abcdef.tmp"):
        if name.endswith(".tmp"):
            (ledger / name).write_bytes(b"{")
        else:
            (ledger / name).mkdir(parents=True)
        one_message(
            call(*command.split(), ledger),
            2,
            str(ledger),
            "creation was interrupted",
            "run the command that creates it again",
        )
    with Writer(ledger, ORIGIN):
        pass
    assert call(*command.split(), ledger).code == 0


@pytest.mark.parametrize(
    "name", ["chain.jsonl", "segments/000000000000-000000000001.parquet", "nodes", "staging/x.parquet", "checkpoint"]
)
def test_a_ledger_without_its_ledger_json_is_not_taken_for_one_that_was_only_begun(
    call: Call, tmp_path: Path, name: str
) -> None:
    (tmp_path / "segments").mkdir()
    (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / name).write_bytes(b"")
    called = call("verify", tmp_path)
    assert (called.code, "ledger.json" in called.err) == (3, True)


@pytest.mark.parametrize(
    "arguments",
    [
        ("info", "PATH"),
        ("verify", "PATH"),
        ("sql", "PATH", "SELECT 1"),
        ("query", "failures", "PATH"),
        ("maintain", "recover", "PATH", "--json"),
        ("simulate", "PATH", *SMALL),
        ("export", "elsewhere", "--out", "PATH.csv"),
    ],
)
def test_a_path_that_is_not_utf_8_is_refused_before_anything_is_done(
    call: Call, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    path = tmp_path / os.fsdecode(b"l\xff")
    one_message(call(*[argument.replace("PATH", str(path)) for argument in arguments]), 2, "l\\udcff", "UTF-8")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["maintain recover", "verify"])
def test_a_file_whose_name_is_not_utf_8_is_named_in_json(call: Call, copy: Path, command: str) -> None:
    (copy / "segments" / os.fsdecode(b"x\xff")).write_bytes(b"")
    assert "x\\udcff" in json.dumps(json.loads(call(*command.split(), copy, "--json").out), ensure_ascii=False).replace(
        "\\\\", "\\"
    )


@pytest.mark.parametrize(
    "command", ["simulate", "reproduce", "maintain recover", "info", "export", "study run sensitivity"]
)
def test_after_ctrl_c_each_command_says_what_is_left(call: Call, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "_commands", lambda: SimpleNamespace(main=interrupted))
    left = {
        "simulate": "the same command continues from there",
        "reproduce": "the same command continues from there",
        "maintain recover": "run it again",
        "study run sensitivity": "the same command continues from there",
    }
    one_message(call(*command.split(), "x"), 130, "interrupted; ", left.get(command, "nothing was changed"))


@pytest.mark.parametrize(
    ("command", "code", "part"),
    [("info", 2, "version"), ("metrics", 2, "version"), ("simulate", 2, "version"), ("verify", 3, "format version 99")],
)
def test_a_ledger_of_another_format_version_is_refused(
    call: Call, copy: Path, command: str, code: int, part: str
) -> None:
    manifest = copy / "ledger.json"
    manifest.write_text(re.sub('"version":[12]', '"version":99', manifest.read_text()))
    before = contents(copy)
    called = call(command, copy)
    assert (called.code, "99" in called.err, part in called.err) == (code, True, True)
    assert contents(copy) == before


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (("metrics",), ()),
        (("statistics",), ()),
        (("compare",), ("--first", "fsar", "--second", "cfc")),
        (("info",), ()),
        (("query", "failures"), ()),
        (("sql",), ("SELECT 1",)),
        (("export",), ("--out", "events.csv")),
        (("report",), ("--out", "report.pdf")),
    ],
)
def test_a_missing_segment_is_named(
    call: Call,
    copy: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    before: tuple[str, ...],
    after: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    segment = next((copy / "segments").iterdir())
    segment.unlink()
    one_message(call(*before, copy, *after), 3, segment.name)
    assert list(tmp_path.iterdir()) == [copy]


def test_verify_names_each_place_and_ends_with_3(call: Call, copy: Path) -> None:
    place = "chain.jsonl"
    (copy / place).write_bytes((copy / place).read_bytes().replace(b"rows", b"rowz", 1))
    called = call("verify", copy)
    assert called.code == 3
    assert called.out == ""
    assert place in called.err
    assert "found" in called.err
    assert "Traceback" not in called.err


@pytest.mark.parametrize(
    "text",
    few(
        [
            *("SELEKT 1", "SELECT", "SELECT nothing FROM events"),
            *("SELECT * FROM eventz", "", "DROP VIEW events", "SELECT 1; SELECT 2"),
        ],
        ["SELEKT 1", "SELECT * FROM eventz", "DROP VIEW events"],
    ),
)
def test_wrong_sql_is_explained(call: Call, ledger: Path, text: str) -> None:
    called = call("sql", ledger, text)
    assert called.code == 2
    assert called.out == ""
    assert called.err.startswith("fsar-ledger: SQL")
    assert "Traceback" not in called.err


WRITERS = [
    ("export", "LEDGER", "--out", "PLACE.parquet"),
    ("export", "LEDGER", "--query", "metrics/run_metrics", "--out", "PLACE.csv"),
    ("open", "LEDGER", "--out", "PLACE.duckdb"),
    ("prove", "LEDGER", "8", "--out", "PLACE.tlog-proof"),
    ("report", "LEDGER", "--out", "PLACE.pdf"),
    ("explain", "LEDGER", "--run", "1", "--request", "A1-1/2.1", "--svg", "PLACE.svg"),
    ("explain", "LEDGER", "--run", "1", "--request", "A1-1/2.1", "--pdf", "PLACE.pdf"),
    ("key", "new", "PLACE.key"),
    ("study", "run", "calibration", "--out", "PLACE.json"),
    ("study", "run", "predictions", "--out", "PLACE.json"),
    ("study", "run", "comparison", "predictions.json", "--out", "PLACE.json"),
    ("reproduce", "--out", "PLACE"),
]


@pytest.mark.parametrize("command", WRITERS)
def test_no_command_writes_into_any_ledger(
    call: Call, ledger: Path, copy: Path, tmp_path: Path, command: tuple[str, ...]
) -> None:
    (tmp_path / "link").symlink_to(copy / "segments")
    before = contents(copy)
    for place in (copy / "x", copy / "new" / "x", copy / "staging" / ".." / "x", tmp_path / "link" / "x"):
        arguments = [argument.replace("LEDGER", str(ledger)).replace("PLACE", str(place)) for argument in command]
        one_message(call(*arguments), 2, "inside the ledger", str(copy), "outside")
        assert contents(copy) == before


@pytest.mark.parametrize(
    ("which", "lost"),
    [
        *(("new", lost) for lost in ("chain.jsonl", "ledger.json", "segments")),
        *(("old", lost) for lost in ("commits", "ledger.json", "segments")),
    ],
)
def test_a_damaged_ledger_is_written_into_no_more_than_a_whole_one(
    call: Call, ledger: Path, older: Path, tmp_path: Path, which: str, lost: str
) -> None:
    ledger = Path(shutil.copytree({"new": ledger, "old": older}[which], tmp_path / "copy"))
    (ledger / lost).rename(ledger.parent / "lost")
    before = contents(ledger)
    one_message(call("key", "new", ledger / "fleet.key"), 2, "inside the ledger")
    assert contents(ledger) == before


def test_a_link_that_leads_into_a_ledger_is_no_way_around(call: Call, ledger: Path, copy: Path, tmp_path: Path) -> None:
    (tmp_path / "events.csv").symlink_to(copy / "events.csv")
    (copy / "staging" / "out.csv").symlink_to(tmp_path / "elsewhere.csv")
    for out in (tmp_path / "events.csv", copy / "staging" / "out.csv"):
        one_message(call("export", ledger, "--out", out), 2, "inside the ledger")
        assert out.is_symlink()
    assert not (tmp_path / "elsewhere.csv").exists()


@pytest.mark.parametrize("arguments", [("export", "x.csv"), ("export", "x.parquet"), ("report", "x.pdf")])
def test_an_output_that_cannot_be_written_is_named(
    call: Call, ledger: Path, tmp_path: Path, arguments: tuple[str, str]
) -> None:
    (tmp_path / "file").write_text("in the way")
    one_message(call(arguments[0], ledger, "--out", tmp_path / "file" / arguments[1]), 1, arguments[1])
    (tmp_path / arguments[1]).mkdir()
    one_message(call(arguments[0], ledger, "--out", tmp_path / arguments[1]), 1, arguments[1])
    assert {path.name for path in tmp_path.iterdir()} == {"file", arguments[1]}


def test_a_report_that_cannot_be_written_is_not_begun(call: Call, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    for out, found in ((tmp_path, "it is a folder"), (tmp_path / "file" / "x" / "x.pdf", "is a file")):
        one_message(call("report", tmp_path / "nowhere", "--out", out), 1, str(out), found)
    assert (tmp_path / "file").read_text() == "in the way"
