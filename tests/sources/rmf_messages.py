"""Small recordings of Open-RMF messages, of our own making by the schemas of rmf_api_msgs."""

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

BEGINS = datetime(2026, 3, 1, 10, tzinfo=UTC)
FLEET = "tinyRobot"
Line = dict[str, Any]


def millis(at_s: float) -> int:
    return round((BEGINS.timestamp() + at_s) * 1000)


def update(at_s: float, kind: str, data: Line) -> Line:
    received = (BEGINS + timedelta(seconds=at_s)).isoformat().replace("+00:00", "Z")
    return {"type": f"{kind}_update", "data": data, "received": received}


def booking(name: str, **more: Any) -> Line:
    return {
        "id": name,
        "unix_millis_earliest_start_time": millis(0),
        "unix_millis_request_time": millis(0),
        "priority": {"type": "binary", "value": 1},
        "labels": ["app=dashboard"],
        "requester": "alice",
        **more,
    }


def state(at_s: float, name: str, status: str, *, robot: str | None = None, **more: Any) -> Line:
    data: Line = {"booking": booking(name), "category": "delivery", "detail": "", "status": status}
    if robot is not None:
        data["assigned_to"] = {"group": FLEET, "name": robot}
        data["unix_millis_start_time"], data["unix_millis_finish_time"] = millis(2), millis(at_s)
        data |= {"phases": phases("underway"), "active": 1, "completed": [], "pending": []}
    return update(at_s, "task_state", data | more)


def phases(status: str, name: str = "Go to [place:pantry]") -> Line:
    event = {"id": 1, "status": status, "name": name, "detail": "", "deps": []}
    return {"1": {"id": 1, "category": "Pick Up", "detail": "", "final_event_id": 0, "events": {"1": event}}}


def dispatched(robot: str | None) -> Line:
    assignment = {"fleet_name": FLEET} | ({} if robot is None else {"expected_robot_name": robot})
    return {"status": "dispatched", "assignment": assignment, "errors": []}


def log(at_s: float, name: str, text: str, tier: str = "info") -> Line:
    entry = {"seq": 0, "tier": tier, "unix_millis_time": millis(at_s), "text": text}
    return update(
        at_s, "task_log", {"task_id": name, "log": [], "phases": {"1": {"log": [], "events": {"1": [entry]}}}}
    )


def fleet(at_s: float, **tasks: str) -> Line:
    robots: Line = {
        name: {
            "name": name,
            "status": "working" if task else "idle",
            "task_id": task,
            "unix_millis_time": millis(at_s),
            "location": {"map": "L1", "x": 1.0, "y": 2.0, "yaw": 0.5},
            "battery": 0.8,
            "issues": [],
        }
        for name, task in tasks.items()
    }
    return update(at_s, "fleet_state", {"name": FLEET, "robots": robots})


def honest_day(robots: Iterable[str] = ("r1", "r2")) -> Iterator[Line]:
    """Each robot delivers, is interrupted and goes on; one task is cancelled, and nobody bids for another."""
    for at, robot in enumerate(robots):
        begins, name = 20.0 * at, f"delivery-{robot}"
        yield {
            "type": "dispatch_task_request",
            "request": {"category": "delivery", "description": {}, "requester": "alice", "labels": ["app=dashboard"]},
        }
        yield state(begins, name, "queued", dispatch={"status": "queued"})
        yield state(begins + 1, name, "queued", dispatch=dispatched(robot))
        yield state(begins + 2, name, "underway", robot=robot)
        yield fleet(begins + 2.5, **{robot: name})
        yield log(begins + 3, name, "Moving to pantry")
        stop = {"unix_millis_request_time": millis(begins + 4), "labels": ["bob"]}
        yield state(begins + 4, name, "underway", robot=robot, interruptions={"t1": stop})
        resumed = stop | {"resumed_by": {"unix_millis_request_time": millis(begins + 5), "labels": ["bob"]}}
        yield state(begins + 5, name, "underway", robot=robot, interruptions={"t1": resumed})
        yield state(begins + 6, name, "completed", robot=robot, active=None, completed=[1])
    cancelled = {"unix_millis_request_time": millis(101), "labels": ["carol"]}
    yield state(100, "patrol-1", "underway", robot="r1")
    yield state(101, "patrol-1", "canceled", robot="r1", cancellation=cancelled)
    nobody = {"status": "failed_to_assign", "errors": [{"code": 10, "category": "Not Feasible", "detail": "no bid"}]}
    yield state(110, "clean-1", "failed", dispatch=nobody)
