"""pm4py reads the object-centric event log, and finds a process in it."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.api.record import import_records
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat, with_columns
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.source import Observed
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.exports import documents, named_in
from fsar_ledger.ledger.rows.codec import LedgerRun
from tests.exports.conftest import Asked
from tests.exports.test_shared import NAMES

pm4py = pytest.importorskip("pm4py", reason="make test-all installs it")
LISTS = {"busy", "candidates", "degraded", "fleet_deny", "fleet_review", "local_deny", "local_review", "path", "robots"}
NAMES_ANY = " OR ".join(
    f"coalesce(len({name}), 0) > 0" if name in LISTS | {"rejected"} else f"{name} IS NOT NULL" for name in sorted(NAMES)
)


@pytest.fixture(scope="module")
def log(ledger: fsar_ledger.Ledger, tmp_path_factory: pytest.TempPathFactory) -> Any:
    out = tmp_path_factory.mktemp("ocel") / "log.json"
    ledger.export(out, format="ocel")
    return pm4py.read_ocel2_json(str(out))


def test_it_has_every_event_that_names_something(log: Any, asked: Asked) -> None:
    stored = asked(f"SELECT type, count(*) AS n FROM events WHERE {NAMES_ANY} GROUP BY type")
    assert Counter(log.events["ocel:activity"]) == {row["type"].partition(".")[0]: row["n"] for row in stored}


def test_it_has_every_action_task_and_robot_of_every_run(log: Any, asked: Asked) -> None:
    (stored,) = asked(
        "SELECT count(DISTINCT (run_id, action_id)) FILTER (action_id IS NOT NULL) AS action, "
        "count(DISTINCT (run_id, task_id)) FILTER (task_id IS NOT NULL) AS task, "
        "count(*) FILTER (type = 'RobotJoined.v1') AS robot FROM events"
    )
    found = Counter(log.objects["ocel:type"])
    assert {kind: found[kind] for kind in stored} == stored


def test_an_event_is_related_to_each_that_it_names_in_its_role(log: Any, asked: Asked) -> None:
    row = next(
        row
        for row in asked("SELECT * FROM events WHERE type = 'ExecutionStarted.v1' ORDER BY run_id, seq")
        if row["requested_by"] not in (None, row["robot"])
    )
    relations = log.relations[log.relations["ocel:eid"].isin(_ids(log, row))]
    pairs = zip(relations["ocel:oid"], relations["ocel:qualifier"], strict=True)
    found = {oid.partition(":")[2]: role for oid, role in pairs}
    assert found[row["robot"]].startswith("executor, robot")
    assert found[row["requested_by"]].startswith("requester")
    assert found[f"action/{row['action_id']}"] == "action"
    assert found[f"task/{row['task_id']}"] == "task"


def test_what_is_no_name_is_an_attribute_with_its_value(log: Any, asked: Asked) -> None:
    row = asked("SELECT * FROM events WHERE type = 'ExecutionQueued.v1' ORDER BY run_id, seq")[0]
    event = log.events[log.events["ocel:eid"].isin(_ids(log, row))].iloc[0]
    for name in ("run_id", "seq", "caused_by", "capability", "step", "attempt", "is_delegated", "override"):
        assert event[name] == row[name], name
    assert event["ocel:timestamp"].timestamp() == pytest.approx(row["time_us"] / 1e6)


def _ids(log: Any, row: dict[str, Any]) -> set[str]:
    found = log.events[(log.events["run_id"] == row["run_id"]) & (log.events["seq"] == row["seq"])]
    return set(found["ocel:eid"])


def test_every_action_begins_with_the_beginning_of_its_step(log: Any, asked: Asked) -> None:
    (stored,) = asked("SELECT count(DISTINCT (run_id, action_id)) AS n FROM events WHERE action_id IS NOT NULL")
    flat = pm4py.ocel_flattening(log, "action")
    graph, starts, _ = pm4py.discover_dfg(flat)
    assert starts == {"StepBegan": stored["n"]}
    assert graph["StepBegan", "OwnStepDecided"] > 0


def test_a_petri_net_is_found_for_every_kind_of_object(log: Any) -> None:
    net = pm4py.discover_oc_petri_net(log)
    assert (
        set(net["petri_nets"]) == set(log.objects["ocel:type"]) >= {"robot", "supervisor", "task", "action", "request"}
    )
    assert {"StepBegan", "ExecutionStarted", "ExecutionFinished"} <= set(net["activities"])


def test_one_run_has_the_names_that_it_has_among_all(ledger: fsar_ledger.Ledger, log: Any, tmp_path: Path) -> None:
    answer = ledger.export(tmp_path / "run.json", format="ocel", run=2)
    one = pm4py.read_ocel2_json(str(tmp_path / "run.json"))
    assert len(one.events) == answer.row_count
    assert set(one.objects["ocel:oid"]) == {oid for oid in log.objects["ocel:oid"] if oid.startswith("2:")}


def test_events_have_the_time_of_day_of_a_run_that_has_one(at_noon: LedgerRun, tmp_path: Path) -> None:
    written = documents.write_ocel(tmp_path / "noon.json", [at_noon], {at_noon.run_id: 1})
    events = json.loads((tmp_path / "noon.json").read_text())["events"]
    assert len(events) == written.events
    assert events[0]["time"] == "2026-03-01T12:00:00.000000Z"


def test_a_run_from_before_1970_is_a_log_like_any_other(tmp_path: Path) -> None:
    events: list[Event] = [RunStarted(kind="foreign", observes=(), epoch="1955-03-01T12:00:00Z"), TaskCompleted("t")]
    documents.write_ocel(tmp_path / "log.json", [LedgerRun("hall", [0, 5_000_000], [None] * 2, events)], {})
    (time,) = pm4py.read_ocel2_json(str(tmp_path / "log.json")).events["ocel:timestamp"]
    assert time.isoformat() == "1955-03-01T12:00:05+00:00"


def test_observations_that_are_not_in_it_are_counted(tmp_path: Path) -> None:
    events: list[Event] = [RunStarted(kind="foreign", observes=())]
    events += [Observed(source="hall", kind="battery", objects=("robot/A1",), qualifiers=("robot",))] * 2
    written = documents.write_ocel(tmp_path / "log.json", [LedgerRun("hall", [0, 0, 0], [None] * 3, events)], {})
    assert written.notes[1] == (
        "3 events name no object and are not in the file; 2 of them are observations, which name their objects in open "
        "text"
    )


def test_an_event_that_is_imported_again_has_every_list_as_it_was(runs: list[LedgerRun], tmp_path: Path) -> None:
    run = next(run for run in runs if run.run_id.startswith("dhma.full.failure-recovery-chain"))
    odd = LedgerRun(run.run_id, run.times_us, run.caused_by, [*map(_with_odd_lists, run.events)])
    documents.write_ocel(tmp_path / "run.json", [odd], {})
    again = import_records(str(tmp_path / "again"), [str(tmp_path / "run.json")], format="ocel")
    assert again.made.not_understood == ()
    own = ("Observed", "RunStarted", "SourceOpened", "SourceClosed")
    found = [event for event in again.ledger.record("run").events if type(event).__name__ not in own]
    assert found == [event for event in odd.events if named_in(flat(event))]


def _with_odd_lists(event: Event) -> Event:
    """Return the event with nobody among its candidates, and its path, where it has one, from its end."""
    fields = flat(event)
    odd = {"path": fields["path"][::-1]} if fields.get("path") else {}
    return with_columns(event, **odd | ({"candidates": ()} if "candidates" in fields else {}))


def test_no_run_is_an_empty_log(tmp_path: Path) -> None:
    documents.write_ocel(tmp_path / "empty.json", [], {})
    found = json.loads((tmp_path / "empty.json").read_text())
    assert found == {"events": [], "objects": [], "eventTypes": [], "objectTypes": []}
