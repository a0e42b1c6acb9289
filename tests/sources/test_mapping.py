"""A mapping derives from each record what it says, and is refused by line and field where it is wrong."""

import io
import re
import shlex
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.api.ledger import Ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.cli.app import run
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.source import Observed
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.sources.adapter import Derived, Input, Record
from fsar_ledger.sources.importing import Imported, import_files
from fsar_ledger.sources.mapping import Mapped, mapped

PAGE = Path(__file__).resolve().parents[2] / "docs" / "sources" / "mapping.md"
HEAD = """\
format = "acme/2"
observes = ["TaskArrived", "RequestIssued", "ExecutionFinished", "ExecutionFinished.executed_by"]
time = "/when"
kind = "/event"
objects = { "/robot" = "robot", "/by" = "asker" }
"""
FINISHED = {"task_id": "/job", "action_id": "{/job}/1", "robot": "robot/{/robot}", "result": "success"}


def rule(kind: str, match: str = "{}", *more: str, **fields: str) -> str:
    told = ", ".join(f'{name} = "{text}"' for name, text in fields.items())
    return "\n".join(["[[event]]", f"match = {match}", f'type = "{kind}"', *more, f"fields = {{ {told} }}", ""])


ARRIVED = rule("TaskArrived", '{ "/event" = "came" }', task_id="/job")
DONE = rule("ExecutionFinished", '{ "/event" = "done" }', **FINISHED)


def adapter(*parts: str) -> Mapped:
    return mapped(Path("acme.toml"), "\n".join(parts).encode())


def record(reader: Mapped, data: dict[str, Any]) -> Record:
    [one] = reader.read([Input("log", None, io.BytesIO(msgspec.json.encode(data)))])
    return one


def derived(data: dict[str, Any], *rules: str) -> list[Derived] | None:
    reader = adapter(HEAD, *rules)
    found = reader.derive(record(reader, data))
    return None if found is None else list(found)


def event(data: dict[str, Any], *rules: str) -> Any:
    found = derived(data, *rules)
    assert found is not None
    return found[0].event


def wrong(*parts: str) -> str:
    with pytest.raises(UsageError) as raised:
        adapter(*parts)
    return f"{raised.value}"


def imported(folder: Path, lines: list[dict[str, Any]], *parts: str) -> Imported:
    path = folder / "log.jsonl"
    path.write_bytes(b"".join(msgspec.json.encode(line) + b"\n" for line in lines))
    with path.open("rb") as file:
        return import_files(folder / "out", [Input("log", path, file)], adapter(*parts), run="log")


@pytest.mark.parametrize(
    ("match", "data", "is_met"),
    [
        ('{ "/a" = 1 }', {"a": 1}, True),
        ('{ "/a" = 1 }', {"a": 1.0}, True),
        ('{ "/a" = 1 }', {"a": True}, False),
        ('{ "/a" = true }', {"a": 1}, False),
        ('{ "/a" = true }', {"a": True}, True),
        ('{ "/a" = ["x", 2] }', {"a": 2}, True),
        ('{ "/a" = ["x", 2] }', {"a": "2"}, False),
        ('{ "/a" = "x", "/b" = "y" }', {"a": "x"}, False),
        ('{ "/a/b/1" = "x" }', {"a": {"b": [0, "x"]}}, True),
        ('{ "/a" = "x" }', {"a": ["x"]}, False),
        ("{}", {}, True),
    ],
)
def test_a_rule_matches_where_all_values_are_equal(match: str, data: dict[str, Any], is_met: bool) -> None:
    found = derived({"job": "t", **data}, rule("TaskArrived", match, task_id="/job"))
    assert (found is not None) == is_met


@pytest.mark.parametrize(
    ("pointer", "data"),
    [
        ("/a~1b", {"a/b": "t"}),
        ("/a~0b", {"a~b": "t"}),
        ("/a~01", {"a~1": "t"}),
        ("/", {"": "t"}),
        ("/a/", {"a": {"": "t"}}),
        ("/list/1", {"list": ["s", "t"]}),
        ("/0", {"0": "t"}),
    ],
)
def test_a_pointer_finds_its_value(pointer: str, data: dict[str, Any]) -> None:
    assert event(data, rule("TaskArrived", task_id=pointer)).task_id == "t"


@pytest.mark.parametrize("pointer", ["/list/2", "/list/-", "/list/01", "/list/٠", "/list/" + "9" * 5_000, "/t/0", "/x"])
def test_a_pointer_to_nothing_finds_nothing(pointer: str) -> None:
    assert derived({"list": ["s", "t"], "t": "text"}, rule("TaskArrived", task_id=pointer)) is None


def test_a_template_takes_values_of_every_kind() -> None:
    data = {"job": 17, "ok": True, "part": {"a": [1]}}
    assert event(data, rule("TaskArrived", task_id="{/job}-{/ok}-{/part}")).task_id == '17-true-{"a":[1]}'


def test_a_value_of_the_record_is_not_read_as_a_template() -> None:
    assert event({"job": "{/secret}", "secret": "s"}, rule("TaskArrived", task_id="{/job}")).task_id == "{/secret}"


def test_a_list_gives_a_list_and_so_does_a_pointer_to_one() -> None:
    told = FINISHED | {"achieved": "/held"}
    data = {"job": "t", "robot": "A1", "held": ["gripped", "raised"]}
    assert event(data, rule("ExecutionFinished", **told)).achieved == ("gripped", "raised")
    listed = rule("ExecutionFinished", **FINISHED).replace(" }", ', achieved = ["by {/robot}", "/job"] }')
    assert event(data, listed).achieved == ("by A1", "t")


def test_a_number_of_the_mapping_stands_for_itself() -> None:
    assert event({"job": "t"}, rule("TaskArrived", task_id="/job").replace(" }", ", team = 3 }")).team == 3


@pytest.mark.parametrize(
    "data",
    [
        {"event": "done", "robot": "A1"},
        {"event": "done", "robot": None, "job": "t"},
        {"event": "done", "robot": "A1", "job": 17},
        {"event": "done", "robot": "A1", "job": None},
    ],
)
def test_a_record_that_lacks_a_value_or_has_another_kind_is_not_understood(data: dict[str, Any]) -> None:
    assert derived(data, DONE) is None


def test_a_record_with_a_number_that_no_ledger_holds_is_not_understood_and_ends_no_import() -> None:
    arrived = rule("TaskArrived", task_id="/job", budget_us="/budget")
    assert event({"job": "t", "budget": 2**53 - 1}, arrived).budget_us == 2**53 - 1
    assert derived({"job": "t", "budget": 2**53}, arrived) is None


def test_a_record_that_tells_twice_how_something_ended_has_ended_neither_way() -> None:
    """Readers of JSON silently drop one of both."""
    twice = b'{"event": "failed", "event": "done", "job": "t", "robot": "A1"}\n'
    one = twice.replace(b'"event": "failed", ', b"")
    records = list(adapter(HEAD, DONE).read([Input("jobs", None, io.BytesIO(twice + one))]))
    assert [record.kind == "unreadable" for record in records] == [True, False]
    assert "field event: found it more than once" in records[0].values["why"]


def test_a_record_that_does_not_tell_how_something_ended_has_not_ended_well() -> None:
    finished = rule("ExecutionFinished", **FINISHED | {"result": "/result"})
    data = {"job": "t", "robot": "A1"}
    assert event({**data, "result": "partial"}, finished).result == "partial"
    assert derived(data, finished) is derived({**data, "result": None}, finished) is None
    silent = rule("ExecutionFinished", **{name: text for name, text in FINISHED.items() if name != "result"})
    assert "expected its result among `fields`, since how it ended is never assumed" in wrong(HEAD, silent)


def test_a_field_that_may_be_unknown_is_none_where_the_record_lacks_it() -> None:
    told = FINISHED | {"executed_by": "robot/{/by}"}
    assert event({"job": "t", "robot": "A1"}, rule("ExecutionFinished", **told)).principals.executed_by is None


def test_an_item_of_a_list_that_is_missing_makes_the_list_missing() -> None:
    listed = rule("ExecutionFinished", **FINISHED).replace(" }", ', achieved = ["/held", "done"] }')
    assert event({"job": "t", "robot": "A1", "held": None}, listed).achieved == ()


def test_a_record_is_derived_whole_or_not_at_all() -> None:
    both = rule("TaskArrived", task_id="/job"), rule("ExecutionFinished", **FINISHED)
    assert [type(one.event).__name__ for one in derived({"job": "t", "robot": "A1"}, *both) or ()] == [
        "TaskArrived",
        "ExecutionFinished",
    ]
    assert derived({"job": "t"}, *both) is None


def test_what_is_not_understood_is_counted_by_kind_and_kept(tmp_path: Path) -> None:
    lines: list[dict[str, Any]] = [
        {"event": "came", "job": "t"},
        {"event": "battery", "charge": 0.5},
        {"event": "done", "job": "t"},
        {"event": "battery", "charge": 0.4},
    ]
    made = imported(tmp_path, lines, HEAD, ARRIVED, DONE)
    assert made.events == {"TaskArrived": 1}
    assert [(one.kind, one.count, one.first) for one in made.not_understood] == [("battery", 2, 2), ("done", 1, 3)]
    assert sum(isinstance(one, Observed) for one in Ledger(tmp_path / "out").record("log").events) == 4


def test_what_is_dated_by_another_record_is_counted(tmp_path: Path) -> None:
    times = [60, 70.5, 61, "soon", None, 70.5, -5]
    lines = [{"when": when, "event": "came", "job": f"t{at}"} for at, when in enumerate(times)]
    made = imported(tmp_path, [*lines, {"when": 1, "event": "battery"}], HEAD, ARRIVED)
    assert (made.undated, made.late, made.late_us) == (3, 1, 9_500_000)
    assert list(made.about_times()) == [
        "without a time: 3 records with events, dated as the one before",
        "earlier than a record before: 1 record with events, by up to 9.500 s, dated as that record; sort the "
        "input first, unless it is in order of arrival",
    ]


def test_an_event_is_caused_by_the_last_one_of_its_key_else_by_its_record(tmp_path: Path) -> None:
    came = rule("TaskArrived", '{ "/event" = "came" }', 'key = "{/job}"', task_id="/job")
    done = rule("ExecutionFinished", '{ "/event" = "done" }', 'cause = "{/job}"', **FINISHED)
    lines: list[dict[str, Any]] = [
        *({"event": "came", "job": job} for job in ("t", "u", "t")),
        *({"event": "done", "job": job, "robot": "A1"} for job in ("t", "u", "v")),
    ]
    imported(tmp_path, lines, HEAD, came, done)
    told = Ledger(tmp_path / "out").record("log")
    arrived = [at for at, one in enumerate(told.events) if isinstance(one, TaskArrived)]
    ended = [at for at, one in enumerate(told.events) if isinstance(one, ExecutionFinished)]
    assert [told.caused_by[at] for at in ended] == [arrived[2], arrived[1], ended[2] - 1]


@pytest.mark.parametrize(
    ("unit", "when", "found"),
    [
        ("s", 1.5, 1_500_000),
        ("ms", 1500, 1_500_000),
        ("us", 1500, 1500),
        ("ns", 1_772_359_200_123_456_789, 1_772_359_200_123_456),
        ("s", "1970-01-01T00:00:01", 1_000_000),
        ("s", "1970-01-01T01:00:01+01:00", 1_000_000),
        ("s", 1e300, None),
        ("s", -1, None),
        ("s", True, None),
        ("s", "noon", None),
        ("s", None, None),
    ],
)
def test_a_time_is_iso_8601_or_a_number_of_its_unit(unit: str, when: object, found: int | None) -> None:
    reader = adapter(HEAD.replace('time = "/when"', f'time = "/when"\nunit = "{unit}"'))
    assert record(reader, {"when": when}).source_us == found


def test_a_time_that_no_float_holds_is_none() -> None:
    [one] = adapter(HEAD).read([Input("log", None, io.BytesIO(b'{"when": 1' + b"0" * 400 + b"}"))])
    assert one.source_us is None


def test_a_record_tells_what_it_is_about_and_what_it_is_called() -> None:
    found = record(adapter(HEAD), {"event": "came", "robot": "A1", "by": None})
    assert (found.kind, found.objects, found.values["by"]) == ("came", {"A1": "robot"}, "null")
    assert record(adapter(HEAD), {"robot": "A1", "by": "A1"}).objects == {"A1": "robot, asker"}
    assert record(adapter(HEAD), {"event": None}).kind == "record"


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        (
            [HEAD, ARRIVED.replace("/job", "/jo~2b")],
            "acme.toml:10: event[0].fields.task_id: found /jo~2b, expected a JSON pointer",
        ),
        (
            [HEAD, rule("TaskArrived", task_id="t{/jo~b}")],
            "acme.toml:10: event[0].fields.task_id: found t{/jo~b}, expected a text in which braces hold",
        ),
        (
            [HEAD, rule("TaskArrived", task_id="robot/{job}")],
            "acme.toml:10: event[0].fields.task_id: found robot/{job}",
        ),
        (
            [HEAD, ARRIVED.replace('"/event"', '"event"')],
            "acme.toml:8: event[0].match.event: found event, expected a JSON pointer",
        ),
        ([HEAD.replace('"/when"', '"when"')], "acme.toml:3: time: found when, expected a JSON pointer"),
        ([HEAD.replace('"/robot" =', '"robot" =')], "acme.toml:5: objects.robot: found robot"),
        ([HEAD.replace('"/event"', '"/e~"')], "acme.toml:4: kind: found /e~"),
        (
            [HEAD, ARRIVED.replace("task_id", "taskid")],
            "acme.toml:10: event[0].fields.taskid: found taskid, expected a field of TaskArrived",
        ),
        (
            [HEAD, ARRIVED, ARRIVED.replace("TaskArrived", "TaskArived")],
            "acme.toml:14: event[1].type: found TaskArived, expected an event type; did you mean TaskArrived?",
        ),
        ([HEAD, rule("SourceClosed", source="x")], "acme.toml:9: event[0].type: found SourceClosed"),
        (
            [HEAD, rule("TaskCompleted", task_id="/job")],
            "event[0].type: found TaskCompleted, expected a type that `obs",
        ),
        ([HEAD, rule("TaskArrived", "{}", 'cause = "{a}"', task_id="/job")], "acme.toml:10: event[0].cause: found {a}"),
        (
            [HEAD.replace('"TaskArrived"', '"TaskArived"')],
            "acme.toml:2: observes[0]: found TaskArived, expected concerns",
        ),
        ([HEAD.replace("acme/2", "")], "acme.toml:1: format: found , expected a name and a version"),
        ([HEAD, 'colour = "red"'], "acme.toml:7: colour"),
        ([HEAD, "[[event]]"], "acme.toml:7: event[0]"),
        ([HEAD, "observes = ["], "acme.toml:"),
    ],
)
def test_what_is_wrong_with_a_mapping_is_told_by_line_and_field(parts: list[str], said: str) -> None:
    assert said in wrong(*parts)


def test_a_mapping_that_is_no_text_is_refused() -> None:
    with pytest.raises(UsageError, match=r"acme\.toml:2: found bytes that are not UTF-8"):
        mapped(Path("acme.toml"), b'format = "a"\n\xff')


def test_a_line_that_is_no_object_is_kept_and_the_others_are_read(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_bytes(b'\xff\xfe\n[1]\n{"event":"came","job":"t"}\n{"event":"ca')
    with path.open("rb") as file:
        made = import_files(tmp_path / "out", [Input("log", path, file)], adapter(HEAD, ARRIVED), run="log")
    assert (made.records, made.events) == (4, {"TaskArrived": 1})
    assert [(one.kind, one.count) for one in made.not_understood] == [("unreadable", 3)]


@pytest.mark.parametrize("robot", ["", " "])
def test_a_record_that_names_nobody_is_not_understood_and_told_of_no_robot(tmp_path: Path, robot: str) -> None:
    to = rule("ExecutionFinished", '{ "/event" = "done" }', **FINISHED | {"robot": "robot/{/robot}"})
    lines = Input("log", None, io.BytesIO(msgspec.json.encode({"event": "done", "job": "t", "robot": robot})))
    made = import_files(tmp_path / "out", [lines], adapter(HEAD, to), run="log")
    assert (made.events, made.robots, [one.count for one in made.not_understood]) == ({}, (), [1])


def test_a_robot_of_the_fleet_without_its_kind_is_refused_and_not_told_as_a_stranger(tmp_path: Path) -> None:
    """`B1` beside a fleet of `robot/B1` would offend I1, though it is the same robot."""
    bare = rule("ExecutionFinished", '{ "/event" = "done" }', **FINISHED | {"robot": "/robot"})
    data = b'{"event":"done","job":"t","robot":"%s"}\n'

    def imported(robot: bytes, *rules: str) -> Imported:
        lines = Input("log", None, io.BytesIO(data % robot))
        return import_files(tmp_path / "out", [lines], adapter(HEAD, *rules), run="log", fleet={"B1": "lift"})

    with pytest.raises(UsageError, match=r"^record 1: field robot: found B1 in \w+, expected robot/B1, its name"):
        imported(b"B1", bare)
    assert imported(b"robot/B1", bare).robots == ("robot/B1",)


@pytest.mark.parametrize(
    "content",
    [b'[{"event": "came", "job": "t"}]', b"event,job\ncame,t\n", '{"event": "came", "job": "t"}'.encode("utf-16")],
    ids=["array", "csv", "utf-16"],
)
def test_a_file_without_one_object_a_line_is_refused_and_no_ledger_is_made(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    content: bytes,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "acme.toml").write_text(HEAD + ARRIVED)
    (tmp_path / "log.jsonl").write_bytes(content)
    assert run(["import", "out", "log.jsonl", "--with", "acme.toml"]) == 2
    assert "expected one JSON object per line" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_example_of_the_page_says_what_the_page_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = dict(re.findall(r"```(\w+)\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL))
    (tmp_path / "jobs.jsonl").write_text(blocks["json"])
    (tmp_path / "jobs.toml").write_text(blocks["toml"])
    assert run(shlex.split(blocks["sh"])[1:]) == 0
    assert capsys.readouterr().out.startswith(blocks["text"])
    rows = Ledger("out/jobs").query("audit/record_gaps").rows()
    judged = [row["judge"] for row in rows if row["is_observable"]]
    assert [Ledger("out/jobs").query(f"invariants/{judge}").rows() for judge in judged] == [[], []]
