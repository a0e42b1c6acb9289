"""Lanes and arrows; a trace holds what the "Trace Event Format" asks for, and what Perfetto needs to draw it."""

import json
from typing import Any

import pytest

from fsar_ledger.events.envelope import recorded_robot
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.view import Words, draw_run, trace, type_name
from tests.view.conftest import ARCHITECTURES, plain_words

FIELDS = {
    "M": {"name", "ph", "pid", "tid", "args"},
    "X": {"name", "cat", "ph", "ts", "dur", "pid", "tid", "args"},
    "i": {"name", "cat", "ph", "s", "ts", "pid", "tid", "args"},
    "s": {"name", "cat", "ph", "id", "ts", "pid", "tid"},
    "f": {"name", "cat", "ph", "bp", "id", "ts", "pid", "tid"},
}
"""By phase, the fields that we write: those that the format demands for it, `cat`, `args`, and `bp` to bind a flow to
the slice that encloses its end."""


def events_of(run: LedgerRun) -> list[dict[str, Any]]:
    words = list(plain_words(run))
    robots = [event.robot for event in run.events if type_name(event) == "RobotJoined"]  # type: ignore[attr-defined]
    sent = [seq for seq, event in enumerate(run.events) if type_name(event) == "RequestIssued"]
    for seq in sent:
        words[seq] = Words(robots[0], robots[1], "request", None, None)
    document = json.loads(trace(draw_run(run, "1", words)))
    assert document["displayTimeUnit"] == "ms"
    assert document["otherData"] == {"run": run.run_id}
    found: list[dict[str, Any]] = document["traceEvents"]
    return found


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_every_event_has_the_fields_of_its_phase(architecture: str, runs: dict[str, LedgerRun]) -> None:
    found = events_of(runs[architecture])
    assert {event["ph"] for event in found} == FIELDS.keys()
    for event in found:
        assert event.keys() == FIELDS[event["ph"]]
        assert type(event["pid"]) is type(event["tid"]) is int
        assert all(type(event[name]) is int and event[name] >= 0 for name in ("ts", "dur") if name in event)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_every_process_and_thread_has_one_name(architecture: str, runs: dict[str, LedgerRun]) -> None:
    found = events_of(runs[architecture])
    named = [(event["pid"], event["tid"]) for event in found if event["name"] == "thread_name"]
    assert len(named) == len(set(named))
    assert {(event["pid"], event["tid"]) for event in found} <= set(named)
    processes = [event["args"]["name"] for event in found if event["name"] == "process_name"]
    assert len(processes) == len(set(processes))


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_slices_of_one_thread_nest(architecture: str, runs: dict[str, LedgerRun]) -> None:
    """Perfetto draws slices of a thread as a stack: two of them are apart, or one lies within the other."""
    slices = [event for event in events_of(runs[architecture]) if event["ph"] == "X"]
    slices.sort(key=lambda event: (event["ts"], -event["dur"]))
    open_us: dict[int, list[int]] = {}
    for event in slices:
        stack = open_us.setdefault(event["tid"], [])
        while stack and stack[-1] <= event["ts"]:
            stack.pop()
        assert not stack or event["ts"] + event["dur"] <= stack[-1]
        stack.append(event["ts"] + event["dur"])


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_every_event_is_an_instant_at_its_time(architecture: str, runs: dict[str, LedgerRun]) -> None:
    run = runs[architecture]
    instants = [event for event in events_of(run) if event["ph"] == "i"]
    assert [event["ts"] for event in instants] == list(run.times_us)
    assert [event["args"]["caused_by"] for event in instants] == list(run.caused_by)


def test_a_flow_begins_and_ends_within_slices(runs: dict[str, LedgerRun]) -> None:
    found = events_of(runs["fsar"])
    slices = [event for event in found if event["ph"] == "X"]
    begins = {event["id"]: event for event in found if event["ph"] == "s"}
    ends = {event["id"]: event for event in found if event["ph"] == "f"}
    assert begins.keys() == ends.keys()
    assert begins
    for number, begin in begins.items():
        assert begin["ts"] <= ends[number]["ts"]
        for end in (begin, ends[number]):
            assert any(one["tid"] == end["tid"] and one["ts"] <= end["ts"] < one["ts"] + one["dur"] for one in slices)


def test_robots_come_first_then_supervisors_then_services(runs: dict[str, LedgerRun]) -> None:
    for run in runs.values():
        kinds = [lane.name.partition("/")[0] for lane in draw_run(run, "1", plain_words(run)).lanes]
        assert kinds[:8] == ["robot"] * 4 + ["supervisor"] * 4
        assert kinds == sorted(kinds, key=("robot", "supervisor", "coordinator", "service").index)


def test_a_lane_says_of_its_robot_what_is_known(runs: dict[str, LedgerRun]) -> None:
    joined = [
        RobotJoined(robot=recorded_robot("robot/A"), role="agv", supervisor=None),
        RobotJoined(robot=recorded_robot("robot/B"), role="", team=2, place="floor/1", supervisor=None),
        RobotJoined(robot=recorded_robot("robot/C"), role="", supervisor=None),
    ]
    run = LedgerRun("night", [0] * 4, [None] * 4, [runs["fsar"].events[0], *joined])
    lanes = draw_run(run, "1", plain_words(run)).lanes
    assert [lane.about for lane in lanes] == ["role agv", "team 2, floor/1", ""]


def test_a_request_is_an_arrow_that_arrives_with_its_answer(runs: dict[str, LedgerRun]) -> None:
    run = runs["fsar"]
    sent = next(seq for seq, event in enumerate(run.events) if type_name(event) == "RequestIssued")
    answer = run.caused_by.index(sent)
    words = list(plain_words(run))
    asker, asked = run.events[sent].principals.requested_by, run.events[answer].principals.decided_by  # type: ignore[attr-defined]
    words[sent] = Words(asker, asked, "request", None, "A1-1/1.1")
    (arrow,) = draw_run(run, "1", words).arrows
    assert (arrow.sender, arrow.receiver, arrow.kind) == (asker, asked, "request")
    assert (arrow.sent_us, arrow.arrived_us) == (run.times_us[sent], run.times_us[answer])
    assert arrow.arrived_us > arrow.sent_us
