"""MCAP files (version 0 of the format), among them those of rosbag2: every message, and what its JSON says.

Only messages that are encoded as JSON can be read. Others, such as CDR, which ROS 2 writes by default, are observations
with kind, topic, times and hash, and nothing follows from them.

| message | becomes |
|---|---|
| a status in an `action_msgs/msg/GoalStatusArray` that is ACCEPTED, or later, for the first time | `RequestAccepted` |
| EXECUTING | `ExecutionStarted` |
| SUCCEEDED | `ExecutionFinished` |
| ABORTED, CANCELED | `ExecutionFailed`, but for CANCELED; `ExecutionWithdrawn` |
| a `ServiceEvent` (service introspection), a `foxglove.Log`, anything else | an observation |

The robot is the namespace of the topic: `/r1/dock/_action/status` is of `robot/r1`, and its action is `dock`. A topic
without a namespace names no robot, and nothing follows from it. A goal is the task and the action.
"""

import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from typing import Any, BinaryIO, Literal, NamedTuple

import lz4.frame
import msgspec
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Message, Schema

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import value
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Parties, RequestSubject, Robot, Subject, recorded_robot
from fsar_ledger.events.execution import ExecutionFailed, ExecutionFinished, ExecutionStarted, ExecutionWithdrawn
from fsar_ledger.events.request import RequestAccepted

from .adapter import Derived, Input, Record, no_record, shown, unreadable

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 1 << 28
"""Bytes of one record of the file; a length beyond it is damage."""
MAX_KEPT = 1 << 24
"""Bytes that are hashed of a part of the file that cannot be read."""
STATUSES = ("UNKNOWN", "ACCEPTED", "EXECUTING", "CANCELING", "SUCCEEDED", "CANCELED", "ABORTED")
SERVICE_EVENTS = ("REQUEST_SENT", "REQUEST_RECEIVED", "RESPONSE_SENT", "RESPONSE_RECEIVED")
LOG_LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")


class Framed(NamedTuple):
    """A record of the file: its bytes may be fewer than it says."""

    opcode: int
    content: bytes
    is_whole: bool


class Mcap:
    """Reads MCAP files."""

    name = "mcap"
    version = "1"
    format = "mcap/0"
    clock: Literal["arrival", "source"] = "arrival"
    is_sampled = False

    def __init__(self) -> None:
        self._statuses: dict[tuple[str, str], int] = {}
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._has_statuses = True

    def look(self, inputs: Sequence[Input]) -> None:
        """Look for a status of a robot's action that can be read; without one, nothing is said of what robots do.

        Of what cannot be read twice nobody knows. Raises: UsageError for files without a record, or as `read`.
        """
        if any(one.path is None for one in inputs):
            return
        is_empty, self._has_statuses = True, False
        for record in Mcap().read(inputs):
            is_empty = False
            if _is_status(record):
                self._has_statuses = True
                break
        if is_empty:
            raise no_record(inputs)
        for one in inputs:
            one.file.seek(0)

    def declares(self) -> Iterable[str]:
        """Name what the status topics of all actions say; who asked, and what was refused, they do not."""
        if not self._has_statuses:
            return ()
        return (
            *("RequestAccepted", "RequestAccepted.decided_by", "RequestAccepted.executed_by"),
            *("ExecutionStarted", "ExecutionStarted.executed_by"),
            *("ExecutionFinished", "ExecutionFinished.executed_by"),
            *("ExecutionFailed", "ExecutionWithdrawn"),
        )

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every message, in the order of the file. Raises: UsageError for a file that is no MCAP."""
        for one in inputs:
            if (found := one.file.read(len(MAGIC))) != MAGIC:
                raise UsageError(
                    f"{value(one.name)}: found {found!r} at its beginning, expected a file of MCAP ({MAGIC!r}); give "
                    "the format that it has (--as, --with)"
                )
            self._channels, self._schemas = {}, {}
            is_ended = is_cut = False
            for framed in _framed(one.file):
                is_ended, is_cut = framed.opcode == Opcode.FOOTER, not framed.is_whole
                if framed.opcode == Opcode.CHUNK:
                    yield from self._chunk(framed)
                else:
                    yield from self._record(framed)
                if is_ended:
                    break
            if not is_ended and not is_cut:
                yield unreadable(b"", f"{one.name}: the file ends without a footer")
            rest = one.file.read(MAX_KEPT) if is_ended else b""
            if not MAGIC.startswith(rest):
                yield unreadable(rest.removeprefix(MAGIC), f"{one.name}: bytes after its end, as in joined files")

    def _chunk(self, framed: Framed) -> Iterator[Record]:
        try:
            chunk = Chunk.read(ReadDataStream(BytesIO(framed.content)))
            data, why = _unpacked(chunk)
        except Exception as error:  # of the library, for bytes of any kind
            yield unreadable(framed.content, f"a chunk: {error!r}")
            return
        for inner in _framed(BytesIO(data)):
            yield from self._record(inner)
        if why or not framed.is_whole:
            yield unreadable(framed.content[:MAX_KEPT], why if framed.is_whole else "a chunk that was cut short")

    def _record(self, framed: Framed) -> Iterator[Record]:
        """Yield a message as a record, and what is cut or cannot be read; keep schemas and channels."""
        if not framed.is_whole:
            yield unreadable(framed.content[:MAX_KEPT], f"a record of type {framed.opcode} that was cut short")
            return
        stream = ReadDataStream(BytesIO(framed.content))
        try:
            if framed.opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
            elif framed.opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                self._channels[channel.id] = channel
            elif framed.opcode == Opcode.MESSAGE:
                yield self._message(Message.read(stream, len(framed.content)))
        except Exception as error:  # of the library, for bytes of any kind
            yield unreadable(framed.content[:MAX_KEPT], f"a record of type {framed.opcode}: {error!r}")

    def _message(self, message: Message) -> Record:
        channel = self._channels.get(message.channel_id)
        if channel is None:
            return unreadable(message.data, f"a message of channel {message.channel_id}, which is not described")
        schema = self._schemas.get(channel.schema_id)
        kind = schema.name if schema is not None else channel.message_encoding or "message"
        values: dict[str, str] = {"topic": channel.topic, "encoding": channel.message_encoding}
        data: dict[str, Any] | None = None
        if channel.message_encoding == "json":
            try:
                data = msgspec.json.decode(message.data, type=dict[str, Any])
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
                return unreadable(message.data, f"{channel.topic}: {error}")
            values |= {name: shown(one) for name, one in data.items() if not isinstance(one, dict | list)}
        return Record(
            _kind(kind, data or {}),
            message.data,
            (kind, channel.topic, data),
            values,
            {f"topic{channel.topic}": "topic"},
            message.publish_time // 1000,
            message.log_time // 1000,
        )

    def derive(self, record: Record) -> Iterable[Derived] | None:
        """Return what has changed in the goals of an action; None for what was not decoded."""
        if record.data is None or record.data[2] is None:
            return None
        _, topic, data = record.data
        robot, action = _robot_and_action(topic)
        if robot is None or not _is_status(record):
            return ()
        listed = data.get("status_list")
        goals = [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
        return [Derived(event) for goal in goals for event in self._changed(topic, robot, action, goal)]

    def _changed(self, topic: str, robot: Robot, action: str, goal: Mapping[str, Any]) -> Iterator[Event]:
        """Yield what the status of a goal says that the one before it did not; a status never goes back."""
        name, status = _goal(goal), goal.get("status")
        if name is None or type(status) is not int or not 0 < status < len(STATUSES):
            return
        before = self._statuses.get((topic, name), 0)
        if status <= before or before >= STATUSES.index("SUCCEEDED"):
            return
        self._statuses[topic, name] = status
        parties = Parties(requested_by=None, executed_by=robot, supervised_by=None)
        subject = Subject(name, name)
        if not before:
            yield RequestAccepted(RequestSubject(name, name, None), parties.decided(robot))
        match STATUSES[status]:
            case "EXECUTING":
                yield ExecutionStarted(subject=subject, principals=parties, robot=robot, capability=action)
            case "SUCCEEDED":
                yield ExecutionFinished(subject, parties, robot)
            case "ABORTED":
                yield ExecutionFailed(subject=subject, robot=robot, failure=1, cause="ABORTED")
                yield ExecutionWithdrawn(subject, robot, 1)
            case "CANCELED":
                yield ExecutionWithdrawn(subject, robot)


def _framed(file: BinaryIO) -> Iterator[Framed]:
    """Yield the records of the file, or of an unpacked chunk, until it ends or what follows is no record."""
    while head := file.read(9):
        length = int.from_bytes(head[1:], "little")
        if len(head) < 9 or length > MAX_RECORD:
            yield Framed(head[0], head + file.read(MAX_KEPT), False)
            return
        content = file.read(length)
        yield Framed(head[0], content, len(content) == length)
        if len(content) < length:
            return


def _unpacked(chunk: Chunk) -> tuple[bytes, str]:
    """Return as much of a chunk as can be unpacked, and what is wrong with it, if anything is."""
    try:
        match chunk.compression:
            case "zstd":
                data = zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data)
            case "lz4":
                data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data)
            case "":
                data = chunk.data
            case other:
                return b"", f"a chunk that is packed by {other}"
    except Exception as error:  # each library has its own
        return b"", f"a chunk that cannot be unpacked: {error!r}"
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        return data, "a chunk of which the CRC differs"
    return data, ""


def _kind(schema: str, data: Mapping[str, Any]) -> str:
    """Return the kind of a message; of a log and a service event it has the level and the event."""
    info = data.get("info")
    if schema.endswith("_Event") and isinstance(info, dict):
        return f"{schema}/{_named(SERVICE_EVENTS, info.get('event_type'))}"
    if schema == "foxglove.Log":
        return f"{schema}/{_named(LOG_LEVELS, data.get('level'))}"
    return schema


def _named(names: tuple[str, ...], number: object) -> str:
    return names[number] if isinstance(number, int) and 0 <= number < len(names) else f"{number}"


def _is_status(record: Record) -> bool:
    """Return whether the record is a status of an action of a robot, and was decoded."""
    if record.data is None or record.data[2] is None:
        return False
    kind, topic, _ = record.data
    return kind.endswith("GoalStatusArray") and _robot_and_action(topic)[0] is not None


def _robot_and_action(topic: str) -> tuple[Robot | None, str]:
    parts = topic.removesuffix("/_action/status").strip("/").split("/")
    return (recorded_robot("robot/" + "/".join(parts[:-1])) if len(parts) > 1 else None), parts[-1]


def _goal(status: Mapping[str, Any]) -> str | None:
    """Return the goal's UUID in hexadecimal, whether it is written as text or as 16 numbers."""
    info = status.get("goal_info")
    goal = info.get("goal_id") if isinstance(info, dict) else None
    found = goal.get("uuid") if isinstance(goal, dict) else None
    if isinstance(found, list) and all(type(one) is int and 0 <= one < 256 for one in found):
        return bytes(found).hex()
    return found if isinstance(found, str) and found else None
