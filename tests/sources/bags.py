"""Small MCAP files of our own making, by the format's specification and the published messages of ROS 2."""

from collections.abc import Iterable
from io import BytesIO
from typing import Any, NamedTuple

import msgspec

BEGINS_NS = 1_772_359_200_000_000_000


class Said(NamedTuple):
    """A message: its topic, the name of its schema, and what it says, or its bytes where it is not JSON."""

    topic: str
    schema: str
    data: dict[str, Any] | bytes


def statuses(robot: str, *goals: tuple[int, int]) -> Said:
    """Say the status of these goals of an action `dock`, each by a number."""
    listed = [
        {"goal_info": {"goal_id": {"uuid": [goal] * 16}, "stamp": {"sec": 0, "nanosec": 0}}, "status": status}
        for goal, status in goals
    ]
    return Said(f"/{robot}/dock/_action/status", "action_msgs/msg/GoalStatusArray", {"status_list": listed})


def asked(robot: str) -> Said:
    """Say that a server got a request for a goal (service introspection)."""
    info = {"event_type": 1, "stamp": {"sec": 0, "nanosec": 0}, "client_gid": [7] * 16, "sequence_number": 1}
    topic = f"/{robot}/dock/_action/send_goal/_service_event"
    return Said(topic, "nav_msgs/action/Dock_SendGoal_Event", {"info": info, "request": [{}], "response": []})


def logged(text: str) -> Said:
    return Said("/log", "foxglove.Log", {"timestamp": {"sec": 0, "nsec": 0}, "level": 4, "message": text, "name": "r1"})


def honest_night() -> list[Said]:
    """Two goals of one robot, one of which is aborted, and what others say beside them."""
    return [
        asked("r1"),
        statuses("r1", (1, 1)),
        statuses("r1", (1, 2)),
        logged("bumper"),
        Said("/r1/scan", "sensor_msgs/msg/LaserScan", b"\x00\x01\x00\x00"),
        statuses("r1", (1, 4), (2, 1)),
        statuses("r1", (1, 4), (2, 2)),
        statuses("r1", (1, 4), (2, 6)),
    ]


def written(
    messages: Iterable[Said], *, compression: str = "ZSTD", chunks: bool = True, chunk_size: int = 300
) -> bytes:
    """Return a file with these messages, a second apart."""
    from mcap.writer import CompressionType, Writer

    out = BytesIO()
    writer: Any = Writer(out, chunk_size, CompressionType[compression], use_chunking=chunks)
    writer.start("ros2", "tests")
    channels: dict[str, int] = {}
    for at, (topic, schema, data) in enumerate(messages):
        encoding = "cdr" if isinstance(data, bytes) else "json"
        if topic not in channels:
            number = writer.register_schema(schema, "jsonschema" if encoding == "json" else "ros2msg", b"{}")
            channels[topic] = writer.register_channel(topic, encoding, number)
        raw = data if isinstance(data, bytes) else msgspec.json.encode(data)
        when = BEGINS_NS + at * 1_000_000_000
        writer.add_message(channels[topic], when, raw, when - 1_000_000, at)
    writer.finish()
    return out.getvalue()
