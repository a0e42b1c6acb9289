"""Small recordings of VDA 5050 messages, of our own making by the published schemas."""

from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import msgspec

BEGINS = datetime(2026, 3, 1, 10, tzinfo=UTC)
MAKER = "KIT"
Line = dict[str, Any]


def stamp(at_s: float) -> str:
    return (BEGINS + timedelta(seconds=at_s)).isoformat().replace("+00:00", "Z")


def message(at_s: float, serial: str, kind: str, *, late_s: float = 0.1, **payload: Any) -> Line:
    header = {
        "headerId": 1,
        "timestamp": stamp(at_s),
        "version": "2.1.0",
        "manufacturer": MAKER,
        "serialNumber": serial,
    }
    topic = f"uagv/v2/{MAKER}/{serial}/{kind}"
    return {"topic": topic, "received": stamp(at_s + late_s), "payload": header | payload}


def order(at_s: float, serial: str, name: str, *actions: str) -> Line:
    nodes = [
        {
            "nodeId": "n1",
            "sequenceId": 0,
            "released": True,
            "actions": [{"actionId": one, "actionType": "pick"} for one in actions],
        }
    ]
    return message(at_s, serial, "order", orderId=name, orderUpdateId=0, nodes=nodes, edges=[])


def state(
    at_s: float,
    serial: str,
    name: str,
    *,
    nodes: int = 1,
    mode: str = "AUTOMATIC",
    errors: Iterable[Line] = (),
    **statuses: Any,
) -> Line:
    return message(
        at_s,
        serial,
        "state",
        orderId=name,
        orderUpdateId=0,
        lastNodeId="n0",
        driving=nodes > 0,
        operatingMode=mode,
        nodeStates=[{"nodeId": f"n{at}", "sequenceId": at, "released": True} for at in range(nodes)],
        edgeStates=[],
        actionStates=[
            {"actionId": one, "actionType": "pick", "actionStatus": status} for one, status in statuses.items()
        ],
        batteryState={"batteryCharge": 80.0, "charging": False},
        errors=list(errors),
        safetyState={"eStop": "NONE", "fieldViolation": False},
    )


def honest_night(vehicles: Iterable[str] = ("0001", "0002")) -> Iterator[Line]:
    """A night in which every vehicle gets an order, picks, and is done; one pick fails and is tried again."""
    for at, serial in enumerate(vehicles):
        begins = 10.0 * at
        name, pick = f"order-{serial}", f"pick{serial}"
        states: list[dict[str, Any]] = [{pick: one} for one in ("WAITING", "RUNNING", "PAUSED", "FINISHED")]
        waits, runs, halts, ends = states
        yield message(begins, serial, "connection", connectionState="ONLINE")
        yield order(begins + 1, serial, name, pick)
        yield state(begins + 2, serial, name, **waits)
        yield state(begins + 3, serial, name, **runs)
        yield state(begins + 4, serial, name, **halts)
        yield state(begins + 5, serial, name, **runs)
        yield message(begins + 5.5, serial, "visualization", agvPosition={"x": 1.0, "y": 2.0})
        yield state(begins + 6, serial, name, nodes=0, **ends)


def long_night(vehicles: int) -> list[Line]:
    """A night of so many vehicles, 8 messages each."""
    return list(honest_night([f"{number:04}" for number in range(vehicles)]))


def written(lines: Iterable[Line]) -> bytes:
    return b"".join(msgspec.json.encode(line) + b"\n" for line in lines)
