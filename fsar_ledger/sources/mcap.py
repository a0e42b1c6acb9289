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

from .adapter import BROKEN, Derived, Input, Record, json_object, json_text, no_record, unreadable

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD = 1 << 28
"""Bytes of one record of the file; a length beyond it is damage. Of a chunk that unpacks to more, only these are read.

A few kilobytes can unpack to more than any memory.
"""
MAX_KEPT = 1 << 24
"""Bytes that are hashed of a part of the file that cannot be read."""
STATUSES = ("UNKNOWN", "ACCEPTED", "EXECUTING", "CANCELING", "SUCCEEDED", "CANCELED", "ABORTED")
SERVICE_EVENTS = ("REQUEST_SENT", "REQUEST_RECEIVED", "RESPONSE_SENT", "RESPONSE_RECEIVED")
LOG_LEVELS = ("UNKNOWN", "DEBUG", "INFO", "WARNING", "ERROR", "FATAL")


class Framed(NamedTuple):
    """A record of the file, whose content may be shorter than it declares."""

    opcode: int
    content: bytes
    is_whole: bool


class Mcap:
    """A reader of MCAP files."""

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
        """Look for a readable status of a robot's action; without one, nothing is declared of what robots do.

        A stream, which cannot be read twice, may have one. Raises: UsageError for files without a record, or as `read`.
        """
        for log in inputs:
            if log.path is not None:
                _require_magic(log)
                log.file.seek(0)
        if any(log.path is None for log in inputs):
            return
        is_empty, self._has_statuses = True, False
        for record in Mcap().read(inputs):
            is_empty = False
            if _is_status(record):
                self._has_statuses = True
                break
        if is_empty:
            raise no_record(inputs)
        for log in inputs:
            log.file.seek(0)

    def declares(self) -> Iterable[str]:
        """Name what the status topics of all actions record, which excludes requesters and refusals."""
        if not self._has_statuses:
            return ()
        return (
            *("RequestAccepted", "RequestAccepted.decided_by", "RequestAccepted.executed_by"),
            *("ExecutionStarted", "ExecutionStarted.executed_by"),
            *("ExecutionFinished", "ExecutionFinished.executed_by"),
            *("ExecutionFailed", "ExecutionWithdrawn"),
        )

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        """Yield every message, in the order of the file. Raises: UsageError for a file that is not MCAP."""
        for log in inputs:
            _require_magic(log)
            self._channels, self._schemas = {}, {}
            is_ended = is_cut = False
            for framed in _framed(log.file):
                is_ended, is_cut = framed.opcode == Opcode.FOOTER, not framed.is_whole
                if framed.opcode == Opcode.CHUNK:
                    yield from self._chunk(framed)
                else:
                    yield from self._record(framed)
                if is_ended:
                    break
            if not is_ended and not is_cut:
                yield unreadable(b"", f"{log.name}: the file ends without a footer")
            rest = log.file.read(MAX_KEPT) if is_ended else b""
            if not MAGIC.startswith(rest):
                yield unreadable(rest.removeprefix(MAGIC), f"{log.name}: bytes after its end, as in joined files")

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
        """Yield a record for a message, and for what is cut or unreadable; keep schemas and channels."""
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
                data = json_object(message.data)
            except BROKEN as error:
                return unreadable(message.data, f"{channel.topic}: {error}")
            plain = ((name, json_text(item)) for name, item in data.items() if not isinstance(item, dict | list))
            values |= {f"message/{name}" if name in values else name: text for name, text in plain}
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
        """Return what has changed in the goals of an action; None if the record was not decoded."""
        if record.data is None or record.data[2] is None:
            return None
        _, topic, data = record.data
        robot, action = _robot_and_action(topic)
        if robot is None or not _is_status(record):
            return ()
        listed = data.get("status_list")
        goals = [goal for goal in listed if isinstance(goal, dict)] if isinstance(listed, list) else []
        return [Derived(event) for goal in goals for event in self._changed(topic, robot, action, goal)]

    def _changed(self, topic: str, robot: Robot, action: str, goal: Mapping[str, Any]) -> Iterator[Event]:
        """Yield the events of a goal whose status has advanced; a status never goes back."""
        name, status = _goal(goal), goal.get("status")
        if name is None or type(status) is not int or not 0 < status < len(STATUSES):
            return
        previous = self._statuses.get((topic, name), 0)
        if status <= previous or previous >= STATUSES.index("SUCCEEDED"):
            return
        self._statuses[topic, name] = status
        parties = Parties(requested_by=None, executed_by=robot, supervised_by=None)
        subject = Subject(name, name)
        if not previous:
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


def _require_magic(log: Input) -> None:
    if (magic := log.file.read(len(MAGIC))) != MAGIC:
        raise UsageError(
            f"{value(str(log.path or log.name))}: found {magic!r} at its beginning, expected a file of MCAP "
            f"({MAGIC!r}); give the format that it has (--as, --with)"
        )


def _framed(file: BinaryIO) -> Iterator[Framed]:
    """Yield the records of the file, or of an unpacked chunk, up to its end or the first damage."""
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
    """Return as much of a chunk as can be unpacked, and the error, empty if there is none."""
    try:
        match chunk.compression:
            case "zstd":
                data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(MAX_RECORD + 1)
            case "lz4":
                data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, MAX_RECORD + 1)
            case "":
                data = chunk.data
            case other:
                return b"", f"a chunk that is packed by {other}"
    except Exception as error:  # each library has its own
        return b"", f"a chunk that cannot be unpacked: {error!r}"
    if len(data) > MAX_RECORD:
        return data[:MAX_RECORD], f"a chunk that unpacks to more than {MAX_RECORD} bytes"
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        return data, "a chunk of which the CRC differs"
    return data, ""


def _kind(schema: str, data: Mapping[str, Any]) -> str:
    """Return the kind of a message, with the level of a log or the type of a service event."""
    info = data.get("info")
    if schema.endswith("_Event") and isinstance(info, dict):
        return f"{schema}/{_name_or_number(SERVICE_EVENTS, info.get('event_type'))}"
    if schema == "foxglove.Log":
        return f"{schema}/{_name_or_number(LOG_LEVELS, data.get('level'))}"
    return schema


def _name_or_number(names: tuple[str, ...], number: object) -> str:
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
    uuid = goal.get("uuid") if isinstance(goal, dict) else None
    if isinstance(uuid, list) and all(type(byte) is int and 0 <= byte < 256 for byte in uuid):
        return bytes(uuid).hex()
    return uuid if isinstance(uuid, str) and uuid else None
