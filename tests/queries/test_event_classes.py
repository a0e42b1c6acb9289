"""The one table that says what each event type is to a judge fits the event types."""

from fsar_ledger.ledger.rows.schema import LAYOUTS
from tests.queries.histories import answer

PRINCIPALS = {"requested_by", "executed_by", "supervised_by"}
ROWS = answer("facts/event_classes")
CLASSES = {row[0]: row[1:] for row in ROWS}
UNJUDGED = {"ExecutionQueued.v1"}  # it repeats the principals that the execution will record


def fields(tag: str) -> set[str]:
    return {field.name for field in LAYOUTS[tag].fields}


def test_a_type_has_one_class() -> None:
    assert sorted(row[0] for row in ROWS) == sorted(CLASSES), (
        "each row more is a decision and a record more for each event of its type"
    )


def test_every_record_is_somebodys_part_in_the_action() -> None:
    for tag, (*_, part) in CLASSES.items():
        assert part == "executor" or (part == "requester" and "requested_by" in fields(tag))


def test_every_class_is_of_an_event_type() -> None:
    assert CLASSES.keys() <= LAYOUTS.keys()


def test_decisions_are_the_types_with_a_path_and_a_decider() -> None:
    assert {tag for tag, (decision, *_) in CLASSES.items() if decision} == {
        tag for tag in LAYOUTS if {"path", "decided_by"} <= fields(tag)
    }


def test_every_record_has_the_principals_that_it_requires() -> None:
    for tag, (_, record, *required, _part) in CLASSES.items():
        assert all(required) == any(required) == (record is not None)
        assert record is None or fields(tag) >= PRINCIPALS


def test_no_type_with_principals_is_forgotten() -> None:
    assert {tag for tag in LAYOUTS if fields(tag) >= PRINCIPALS} <= CLASSES.keys() | UNJUDGED
