"""A log of OCEL 2.0 becomes observations; our own events in it come back, and only what the log shows is declared."""

import sqlite3
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.api.record import ImportResult, import_records
from fsar_ledger.base.errors import UsageError
from fsar_ledger.sources.adapter import Input
from fsar_ledger.sources.ocel import COLUMNS, OWN, Ocel
from tests.quick import few
from tests.recycled import asked
from tests.sources.ocel import CONTEXT, Log, database, event, honest_events, log, orders, written
from tests.sources.pages import printed_otherwise

Import = Callable[[Log | bytes | Path], ImportResult]
Change = Callable[[list[Log]], list[Log]]


@pytest.fixture
def imported(tmp_path: Path) -> Import:
    """Import this log, these bytes, or this file, each into a ledger of its own."""
    count = 0

    def made(found: Log | bytes | Path) -> ImportResult:
        nonlocal count
        count += 1
        path = found if isinstance(found, Path) else tmp_path / "log.json"
        if not isinstance(found, Path):
            path.write_bytes(found if isinstance(found, bytes) else written(found))
        return import_records(str(tmp_path / f"ledger-{count}"), [str(path)], format="ocel")

    return made


def rows(result: ImportResult, *kinds: str) -> list[dict[str, Any]]:
    """The events of these types."""
    found = asked(result.ledger.path, "SELECT * EXCLUDE (run_id) FROM events ORDER BY seq")
    return [row for row in found if row["type"].partition(".")[0] in kinds]


def verdicts(result: ImportResult) -> tuple[set[str], set[str]]:
    """The invariants that are broken, and those of which nothing can be told."""
    found = {row.invariant[:2]: row for row in result.ledger.audit().rows}
    return (
        {name for name, row in found.items() if row.holds is False},
        {name for name, row in found.items() if row.not_observed},
    )


def test_an_event_is_observed_with_its_objects_and_qualifiers_in_order_of_time(imported: Import) -> None:
    found = rows(imported(orders()), "Observed")
    assert [row["kind"] for row in found] == ["object/i1", "object/order", "place order", "pack item", "TaskCompleted"]
    placed = found[2]
    assert (placed["objects"], placed["qualifiers"]) == (["o1"], ["the thing, again"])
    assert dict(zip(placed["names"], placed["texts"], strict=True)) == {"id": "e1", "channel": "web"}
    assert [row["source_time_us"] for row in found[2:]] == [0, 10_000_000, 20_000_000]


def test_an_event_that_has_an_attribute_id_keeps_its_own_id_beside_it(imported: Import) -> None:
    (placed,) = rows(imported(log([event("e1", "place order", 10, id="17", channel="web")])), "Observed")
    assert dict(zip(placed["names"], placed["texts"], strict=True)) == {"id": "e1", "id/1": "17", "channel": "web"}


def test_an_object_is_observed_with_its_attributes_and_what_it_is_related_to(imported: Import) -> None:
    order = rows(imported(orders()), "Observed")[1]
    assert dict(zip(order["names"], order["texts"], strict=True)) == {"price": "10", "price@2026-03-01T10:00:05Z": "9"}
    assert dict(zip(order["objects"], order["qualifiers"], strict=True)) == {"o1": "object", "i1": "contains"}


def test_of_types_that_are_not_ours_nothing_is_derived_or_declared(imported: Import) -> None:
    made = imported(orders()).made
    assert (made.events, made.declared.observes, made.declared.records) == ({}, (), ())
    assert {one.kind for one in made.not_understood} == {"place order", "pack item", "TaskCompleted"}


def test_our_own_events_come_back_with_their_causes(imported: Import) -> None:
    made = imported(log(honest_events(), also=CONTEXT))
    (accepted,) = rows(made, "RequestAccepted")
    (admitted,) = rows(made, "RequestAdmitted")
    expected = {
        "task_id": "T1",
        "action_id": "T1/2",
        "requested_by": "robot/A",
        "decided_by": "robot/B",
        "executed_by": "robot/B",
        "supervised_by": "supervisor/B",
        "path": ["robot/B"],
        "caused_by": admitted["seq"],
    }
    assert {name: accepted[name] for name in expected} == expected
    assert made.made.not_understood == ()


@pytest.mark.parametrize("found", [orders(), log(honest_events(), also=CONTEXT)], ids=["orders", "run"])
def test_a_database_says_what_the_same_log_says_in_json(imported: Import, tmp_path: Path, found: Log) -> None:
    # The objects of a database come by type, and its bytes are not those of the document.
    beside = ("record_number", "record_sha256", "seq", "caused_by")

    def told(result: ImportResult) -> list[str]:
        kept = rows(result, "Observed", *OWN)
        return sorted(repr({name: one for name, one in row.items() if name not in beside}) for row in kept)

    assert told(imported(found)) == told(imported(database(tmp_path / "log.sqlite", found)))


def test_events_of_a_database_are_in_order_of_time_however_their_times_are_written(
    imported: Import, tmp_path: Path
) -> None:
    """As texts, `10:00:00Z` comes after `10:00:00.500Z`, and `12:00:01+02:00` after both and `10:00:03Z`."""
    times = ["10:00:00Z", "10:00:00.500Z", "12:00:01+02:00", "10:00:03Z"]
    kinds = ["started", "ended"] * 2
    events = [event(f"e{at}", kind, 0) for at, kind in enumerate(kinds)]
    for one, time in zip(events, times, strict=True):
        one["time"] = f"2026-03-01T{time}"
    found = rows(imported(database(tmp_path / "log.sqlite", log(events))), "Observed")
    assert [(row["kind"], row["time_us"]) for row in found] == list(
        zip(kinds, [0, 500_000, 1_000_000, 3_000_000], strict=True)
    )


def test_an_event_whose_time_is_no_text_in_a_database_is_on_record(imported: Import, tmp_path: Path) -> None:
    path = database(tmp_path / "a.sqlite", orders())
    edited(path, "UPDATE event_packitem SET ocel_time = CAST(x'ff' AS TEXT)")
    assert imported(edited(path, "UPDATE event_placeorder SET ocel_time = 1772359210")).made.records == 5


def test_a_run_that_is_honest_and_complete_offends_nothing(imported: Import) -> None:
    assert verdicts(imported(log(honest_events(), also=CONTEXT))) == (set(), set())


@pytest.mark.parametrize("robots", [["A", "B"], ["A"]])
def test_a_run_that_is_honest_offends_nothing_beside_a_fleet_that_names_its_robots(
    tmp_path: Path, robots: list[str]
) -> None:
    file, fleet = tmp_path / "run.json", tmp_path / "fleet.toml"
    file.write_bytes(written(log(honest_events(), also=CONTEXT)))
    fleet.write_text("[robots]\n" + "".join(f'{name} = "agv"\n' for name in robots))
    made = import_records(str(tmp_path / "ledger"), [str(file)], format="ocel", fleet=str(fleet))
    assert verdicts(made)[0] == set()


def changed(kind: str, **columns: str) -> Change:
    """A change of the last event of this type: these objects in these parts."""

    def change(events: list[Log]) -> list[Log]:
        one = [each for each in events if each["type"] == kind][-1]
        for name, value in columns.items():
            for related in one["relationships"]:
                related["qualifier"] = ", ".join(part for part in related["qualifier"].split(", ") if part != name)
            one["relationships"].append({"objectId": f"1:{value}", "qualifier": name})
        return events

    return change


def left_out(kind: str) -> Change:
    """A change that leaves out the events of this type."""
    return lambda events: [each for each in events if each["type"] != kind]


def failed_twice(events: list[Log]) -> list[Log]:
    columns: dict[str, Any] = {"task": "T1", "action": "T1/1", "robot": "robot/A", "failure": 1, "cause": "slip"}
    return [*events, *(event(f"1:9{at}", "ExecutionFailed", 90 + at, run="1", **columns) for at in range(2))]


OFFENCES: dict[str, Change] = {
    "i1": changed("OwnStepDecided", decider="robot/X", path="robot/X"),
    "i2": left_out("RequestAccepted"),
    "i3": left_out("PolicyWindowClosed"),
    "i4": failed_twice,
    "a1": left_out("OwnStepDecided"),
    "a2": changed("ExecutionStarted", executor="service/registry"),
    "a3": left_out("PolicyWindowClosed"),
    "a4": changed("RequestAccepted", decider="coordinator", path="coordinator"),
    "a5": left_out("RequestIssued"),
}


@pytest.mark.parametrize("invariant", few(OFFENCES, ["i1", "a5"]))
def test_an_offence_is_found(imported: Import, invariant: str) -> None:
    types = {one["type"] for one in honest_events()}
    broken, _ = verdicts(imported(log(OFFENCES[invariant](honest_events()), also=(*CONTEXT, *types))))
    assert invariant in broken


def test_a_principal_that_one_event_lacks_is_not_declared_and_accuses_nobody(imported: Import) -> None:
    events = honest_events()
    for one in events:
        if one["type"] == "RequestAccepted":
            one["relationships"] = [it for it in one["relationships"] if it["qualifier"] != "supervisor"]
    assert verdicts(imported(log(events, also=CONTEXT))) == (set(), {"i5"})


def test_of_a_log_of_several_runs_nothing_is_derived(imported: Import) -> None:
    events = honest_events()
    for related in events[-1]["relationships"]:
        related["objectId"] = related["objectId"].replace("1:", "2:")
    made = imported(log(events, also=CONTEXT)).made
    assert (made.events, made.declared.records) == ({}, ())


def test_of_two_logs_of_two_runs_nothing_is_derived_though_each_calls_its_run_the_first(tmp_path: Path) -> None:
    events, files = honest_events(), []
    for name in ("monday", "tuesday"):
        about = [one | {"attributes": [*one["attributes"], {"name": "run_id", "value": name}]} for one in events]
        files.append(str(tmp_path / f"{name}.json"))
        Path(files[-1]).write_bytes(written(log(about, also=CONTEXT)))
    both = import_records(str(tmp_path / "both"), files, format="ocel").made
    assert (both.events, both.declared.records) == ({}, ())
    assert import_records(str(tmp_path / "one"), files[:1], format="ocel").made.events


def test_a_type_of_ours_of_which_one_event_cannot_come_back_is_not_declared(imported: Import) -> None:
    events = honest_events()
    events[-2]["relationships"] = []  # the last ExecutionFinished
    made = imported(log(events, also=CONTEXT)).made
    assert "ExecutionFinished" not in made.events
    assert "ExecutionFinished" not in made.declared.records


@pytest.mark.parametrize("kind", ["ExecutionFinished", "RequestClosed"])
def test_an_event_of_ours_that_does_not_tell_how_it_ended_has_not_ended_well(imported: Import, kind: str) -> None:
    events = honest_events()
    silent = next(one for one in events if one["type"] == kind)
    silent["attributes"] = [one for one in silent["attributes"] if one["name"] != "result"]
    made = imported(log(events, also=CONTEXT)).made
    assert kind not in made.events
    assert kind not in made.declared.records


def test_numbers_and_lists_that_another_writer_made_texts_of_come_back(imported: Import) -> None:
    task: dict[str, Any] = {
        "task": "T1",
        "robot": "robot/A",
        "steps": '["A go"]',
        "budget_us": 5.0,
        "is_time_critical": "1",
    }
    (arrived,) = rows(imported(log([event("1", "TaskArrived", 1, **task)])), "TaskArrived")
    assert (arrived["steps"], arrived["budget_us"], arrived["is_time_critical"]) == (["A go"], 5, True)


def test_an_integer_that_no_ledger_holds_is_not_declared_and_odd_names_are_escaped(imported: Import) -> None:
    odd: dict[str, Any] = {"robot": "robot/A\x00\n", "steps": '["\\u202e"]', "budget_us": 1}
    (arrived,) = rows(imported(log([event("1", "TaskArrived", 1, task="T", **odd)])), "TaskArrived")
    assert arrived["robot"] == "robot/A\\x00\\n"
    found = imported(log([event("1", "TaskArrived", 1, task="T", robot="robot/A", budget_us=2**60)])).made
    assert (found.events, found.declared.records, found.records) == ({}, (), 3)


@pytest.mark.parametrize("kind", OWN)
def test_no_qualifier_names_two_columns_of_a_type(kind: str) -> None:
    names = {field.name for field in OWN[kind].fields}
    assert not [one for one, column in COLUMNS.items() if one in names and column in names]


@pytest.mark.parametrize(
    "odd",
    [
        7,
        {},
        {"id": 1, "type": "x"},
        {"id": "x", "type": "x", "attributes": [7]},
        {"id": "x", "type": "x", "relationships": [{"qualifier": "x"}]},
        {"id": "x", "type": "x", "relationships": {"a": 1}},
        {"id": "x", "type": "x", "attributes": [{"name": 3}]},
    ],
)
def test_an_event_or_object_that_cannot_be_read_is_on_record(imported: Import, odd: object) -> None:
    found = orders()
    found["events"].append(odd)
    found["objects"].insert(0, odd)
    made = imported(found).made
    assert made.records == 7
    assert next(one.count for one in made.not_understood if one.kind == "unreadable") == 2


def test_an_event_that_has_two_types_is_on_record_and_is_neither(imported: Import) -> None:
    found = written(orders()).replace(
        b'"type":"TaskCompleted","time"', b'"type":"TaskAbandoned","type":"TaskCompleted","time"'
    )
    made = imported(found).made
    assert (made.records, made.events, made.not_understood[-1].kind) == (5, {}, "unreadable")


def test_an_event_in_another_encoding_is_on_record(imported: Import) -> None:
    made = imported(written(orders()).replace(b'"web"', b'"\xff"')).made
    assert (made.records, made.not_understood[-1].kind) == (5, "unreadable")


@pytest.mark.parametrize(
    "time", ["yesterday", None, 7, "9999-12-31T23:59:59Z", "0001-01-01T00:00:00+14:00", "2026-03-01", "\x00"]
)
def test_an_event_with_an_odd_time_is_on_record(imported: Import, time: object) -> None:
    found = orders()
    found["events"][0]["time"] = time
    assert imported(found).made.records == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "expected a log of OCEL 2.0"),
        (b'{"resourceSpans": []}', "found an object with resourceSpans"),
        (b'{"ocel:events": {}}', "found OCEL 1.0"),
        (b"[1]", "expected a log of OCEL 2.0"),
        (b'\n<?xml version="1.0"?><log></log>', "found XML, expected OCEL 2.0 in JSON or SQLite"),
        (written(orders())[:-20], "expected a log of OCEL 2.0: an object with events and objects, whole"),
        (b'{"events": {}, "objects": []}', "expected a log of OCEL 2.0"),
        (b'{"events": [], "objects": [], "eventTypes": 7}', "expected a log of OCEL 2.0"),
        (b"SQLite format 3\0" + b"\1" * 4096, "expected a whole SQLite database"),
    ],
)
def test_what_is_no_such_log_is_refused(imported: Import, text: bytes, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        imported(text)


def test_a_database_that_is_cut_short_is_refused(imported: Import, tmp_path: Path) -> None:
    whole = database(tmp_path / "a.sqlite", orders()).read_bytes()
    cut = tmp_path / "cut.sqlite"
    cut.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UsageError, match=r"cut\.sqlite: .*expected a whole SQLite database"):
        imported(cut)


def edited(path: Path, statement: str) -> Path:
    with sqlite3.connect(path) as found:
        found.execute(statement)
    found.close()
    return path


@pytest.mark.parametrize("statement", ["DROP TABLE event_object", "DELETE FROM event WHERE ocel_id = 'e1'"])
def test_a_database_that_lacks_a_part_is_refused(imported: Import, tmp_path: Path, statement: str) -> None:
    with pytest.raises(UsageError, match=r"a\.sqlite: found "):
        imported(edited(database(tmp_path / "a.sqlite", orders()), statement))


@pytest.mark.parametrize(
    "statement", ["DELETE FROM event_map_type WHERE ocel_type = 'pack item'", "DELETE FROM event_packitem"]
)
def test_an_event_that_has_no_row_for_its_type_is_on_record(imported: Import, tmp_path: Path, statement: str) -> None:
    assert imported(edited(database(tmp_path / "a.sqlite", orders()), statement)).made.records == 5


def test_standard_input_may_hold_json_and_no_database(tmp_path: Path) -> None:
    assert len(read(Ocel(), [written(orders())])) == 5
    with pytest.raises(UsageError, match="name the file of the database"):
        read(Ocel(), [database(tmp_path / "a.sqlite", orders()).read_bytes()])


def read(adapter: Ocel, texts: Sequence[bytes]) -> list[object]:
    return list(adapter.read([Input("stdin", None, BytesIO(text)) for text in texts]))


def test_the_command_of_the_page_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run.json").write_bytes(written(log(honest_events(), also=CONTEXT)))
    assert printed_otherwise("ocel.md", capsys) == []
