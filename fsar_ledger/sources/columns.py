"""The interface for programs in any language: what they record, and each event, by type and column names.

Events are lines of JSON with the name of their type and their stored columns. Unprintable characters in their texts
are escaped.
"""

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from datetime import UTC, datetime
from itertools import chain
from typing import TYPE_CHECKING, Any, BinaryIO

import msgspec

from fsar_ledger.base import utc
from fsar_ledger.base.errors import InvalidRun, UsageError, WriteFailed
from fsar_ledger.base.printable import counted, did_you_mean, escaped, value
from fsar_ledger.events import CONCERN_OF, CONCERNS, Event
from fsar_ledger.events.envelope import COORDINATOR, flat
from fsar_ledger.events.request import RequestAdmitted
from fsar_ledger.events.source import Observed
from fsar_ledger.events.world import PolicyWindowOpened
from fsar_ledger.ledger.rows.schema import LAYOUTS, MAX_INTEGER, OPENINGS, RECORDS, StoredType

from .adapter import BOM, MAX_LINE, json_object

if TYPE_CHECKING:
    from .recorder import Recorder

BY_ITSELF = ("RunStarted", "SourceOpened", "SourceClosed", "RunContinued")
"""The event types that a recorder adds by itself."""
LAYOUT_OF: dict[str, StoredType] = {
    name: layout
    for tag, layout in LAYOUTS.items()
    if tag not in OPENINGS and (name := tag.partition(".v")[0]) not in BY_ITSELF
}
"""The layouts of the event types that others can record, by name without version."""
MEASURES = frozenset({"budget_us", "t_max_us", "n_max", "fence"})
"""Columns of durations and counts, which are never negative."""
PRINCIPALS = frozenset(
    {
        *("robot", "peer", "helper", "supervisor", "decided_by", "path", "claimant", "holder", "sender", "receiver"),
        *("requested_by", "executed_by", "supervised_by", "on_behalf_of", "relay", "written_by", "robots"),
        *("candidates", "rejected", "busy", "degraded", "local_deny", "local_review", "fleet_deny", "fleet_review"),
    }
)
"""Columns that name principals, each by kind and name (`robot/A1`, `supervisor/A1`), or the coordinator.

`issued_by` is not among them, since a command may come from anybody.
"""
IDENTITIES = PRINCIPALS | {"task_id", "action_id", "request_id"}
"""Columns whose names are never empty."""
OUTCOMES = {"ExecutionFinished": "result", "RequestClosed": "result", "SupervisorResponded": "approves"}
"""Columns that record an outcome; an event without one would count as an unreported success."""
ALIGNED = (("names", "texts"), ("objects", "qualifiers"))
"""Columns of an observation that have the same length."""
_FLAW = re.compile(r"(?P<what>.*?)(?: - at `\$(?P<at>.*)`)?", re.DOTALL)


def event_of(tag: object, columns: Mapping[str, Any]) -> Event:
    """Return the event of this type (`ExecutionStarted`) with these columns; missing nullable columns are NULL.

    A decision without a path gets the path of its decider alone. Raises: UsageError, which names the field.
    """
    kind = tag.partition(".v")[0] if isinstance(tag, str) else ""
    layout = LAYOUT_OF.get(kind)
    if layout is None or tag not in (kind, layout.tag):
        hint = did_you_mean(kind, [*LAYOUT_OF, *BY_ITSELF]) if layout is None else f", {kind} or {layout.tag}"
        by_itself = " that a recorder does not add by itself" if kind in BY_ITSELF else hint
        raise UsageError(f"field type: found {value_text(tag)}, expected an event type{by_itself}")
    known = {field.name: field for field in layout.fields}
    if unknown := sorted(columns.keys() - known.keys()):
        raise UsageError(
            f"field {value(unknown[0])}: found it in {kind}, which has no such field"
            f"{did_you_mean(unknown[0], known)}; expected some of {', '.join(known)}"
        )
    if (outcome := OUTCOMES.get(kind)) is not None and outcome not in columns:
        raise UsageError(
            f"field {outcome}: found none, expected one in {kind}, since how it ended is never assumed; record what is "
            "known as an observation (Observed)"
        )
    event = laid_out(layout, columns)
    require_kinds(event)
    for first, second in ALIGNED if isinstance(event, Observed) else ():
        if len(getattr(event, first)) != len(getattr(event, second)):
            raise UsageError(
                f"field {second}: found {value_text(columns.get(second))}, expected one for each of `{first}`"
            )
    return event


def laid_out(layout: StoredType, columns: Mapping[str, Any]) -> Event:
    """Return the event of this layout with these columns. Raises: UsageError for a value that is missing or wrong."""
    document: dict[str, Any] = {"type": layout.tag}
    for member in layout.members:
        inside = {
            field.name: columns.get(field.name) for field in member.fields if field.name in columns or field.is_nullable
        }
        if member.part is None:
            document |= inside
            continue
        if "path" in {field.name for field in member.fields} and "path" not in columns:
            inside["path"] = [columns["decided_by"]] if columns.get("decided_by") is not None else []
        document[member.name] = inside
    try:
        event: Event = msgspec.convert(document, layout.cls)
    except msgspec.ValidationError as error:
        raise UsageError(_flaw(layout, f"{error}")) from error
    require_names(event)
    for name, number in columns.items():
        if not isinstance(number, int):
            continue
        if abs(number) > MAX_INTEGER:
            raise UsageError(f"field {name}: found {number}, expected at most 2^53 - 1 in size")
        if name in MEASURES and number < 0:
            raise UsageError(f"field {name}: found {number} in {type(event).__name__}, expected 0 or more")
    require_outcome(event)
    return event


def require_names(event: Event) -> None:
    """Raises: UsageError for the name of a task, action, request or principal that is blank, as in `robot/`."""
    for column, name in _names(event):
        parts = name.split("/", 1) if column in PRINCIPALS else [name]
        if not all(map(str.strip, parts)):
            found = value(repr(name)) if name else "an empty text"
            raise UsageError(f"field {column}: found {found} in {type(event).__name__}, expected a name")


def require_kinds(event: Event) -> None:
    """Raises: UsageError for a principal without a kind, as in `A1`."""
    for column, name in _without_kind(event):
        if name != COORDINATOR:
            hint = value(f"{'supervisor' if column.startswith('supervis') else 'robot'}/{name}")
            found = f"found {value(name)} in {type(event).__name__}"
            raise UsageError(f"field {column}: {found}, expected a kind and a name, such as {hint}")


def require_full_names(event: Event, robots: Collection[str]) -> None:
    """Raises: UsageError for `B1` if one of these robots is `robot/B1`: it would be recorded as another robot."""
    for column, name in _without_kind(event):
        if f"robot/{name}" in robots:
            raise UsageError(
                f"field {column}: found {value(name)} in {type(event).__name__}, expected {value(f'robot/{name}')}, "
                "its name in the fleet"
            )


def _names(event: Event) -> Iterator[tuple[str, str]]:
    """Yield each name of a task, action, request or principal, with its column."""
    for column, content in flat(event).items():
        if column in IDENTITIES and content is not None:
            yield from ((column, name) for name in ((content,) if isinstance(content, str) else content))


def _without_kind(event: Event) -> Iterator[tuple[str, str]]:
    return ((column, name) for column, name in _names(event) if column in PRINCIPALS and "/" not in name)


def require_outcome(event: Event) -> None:
    """Raises: UsageError for an event whose outcome contradicts its type."""
    if isinstance(event, PolicyWindowOpened) and event.outcome == "allow":
        raise UsageError(
            "field outcome: found allow in PolicyWindowOpened, expected review or deny: a window restricts"
        )
    if isinstance(event, RequestAdmitted) and event.outcome == "deny":
        raise UsageError(
            "field outcome: found deny in RequestAdmitted, expected allow or review: a request that is not allowed is "
            "recorded as RequestDenied"
        )


def _flaw(layout: StoredType, message: str) -> str:
    """Return the message for invalid columns of an event, from that of msgspec, which names the type and the path."""
    kind, match = layout.tag.partition(".v")[0], _FLAW.fullmatch(message)
    assert match is not None
    missing = re.search(r"missing required field `(\w+)`", match["what"])
    path = re.findall(r"[a-z_]\w*", match["at"] or "")
    name = missing[1] if missing else path[-1] if path else None
    members = [member for member in layout.members if member.name == name and member.part is not None]
    if members:
        name = ", ".join(field.name for field in members[0].fields if not field.is_nullable)
    text = f"found none, expected one in {kind}" if missing else f"{match['what']:.200} in {kind}"
    return f"field {name}: {text}" if name else f"{kind}: {text}"


def value_text(found: object) -> str:
    """Format a value for a message."""
    return value(found if isinstance(found, str) else msgspec.json.encode(found).decode())


BESIDE = ("type", "time", "caused_by")
"""The keys that a line may have beside the columns of its type."""


SAID_AT_ONCE = 20
"""Refused lines that are reported one by one; then one each time their number has doubled: no flood fills a disk."""


class _Refused:
    """The errors of refused lines by number, reported to the operator at once, in a bounded number of lines."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.lines, self._say, self._next = dict[int, str](), say, 1

    def add(self, number: int, why: str) -> None:
        """Add a line; report it if it is one of the first, or if their number has doubled since the last report."""
        self.lines[number] = why
        count = len(self.lines)
        if count < self._next:
            return
        so_far = f"{count:,} lines refused so far, the last: " if count > SAID_AT_ONCE else ""
        self._next = count + 1 if count < SAID_AT_ONCE else 2 * count
        self._say(f"{so_far}line {number}: {why}")

    def say_count(self) -> None:
        """Report how many lines were refused, if any were."""
        were = "was" if len(self.lines) == 1 else "were"
        if self.lines:
            self._say(f"{counted(len(self.lines), 'line')} {were} refused and not recorded")


def tell(
    recorder: "Recorder", file: BinaryIO, say: Callable[[str], None] = lambda _: None
) -> tuple[int, dict[int, str]]:
    """Record each line as it comes; return the number of events, and the error of each refused line by number.

    A time without a zone is UTC. `say` reports refused lines to the operator at once, and their number after an
    interruption. Raises: WriteFailed, which names the line to continue with.
    """
    events, refused = 0, _Refused(say)
    try:
        for number, line in numbered_lines(file):
            try:
                event, time, caused_by = parse_line(line.removeprefix(BOM) if number == 1 else line)
                _record(recorder, event, time, caused_by)
                events += 1
            except (UsageError, InvalidRun) as error:
                refused.add(number, f"{error}")
            except WriteFailed as error:
                raise WriteFailed(
                    f"{error}; {counted(events, 'event')} of the lines before line {number} "
                    f"{'is' if events == 1 else 'are'} on disk: continue with that line"
                ) from error
    except KeyboardInterrupt:
        refused.say_count()
        raise
    return events, refused.lines


def _record(recorder: "Recorder", event: Event, time: datetime | None, caused_by: int | None) -> None:
    try:
        recorder.event(event, at=time, caused_by=caused_by)
    except UsageError as error:
        if not f"{error}".startswith("at: "):  # the name that the time has in Python
            raise
        why = f"{error}".removeprefix("at: ").replace("`at`", "`time`").replace("`source_time`", "`source_time_us`")
        raise UsageError(f"field time: {why}") from error


def numbered_lines(file: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Yield each nonempty line with its number as it comes; of a line that is too long, its beginning.

    The beginning is too long as well, so that `object_of` refuses it.
    """
    number = 0
    while line := file.readline(MAX_LINE + 1):
        number += 1
        if not line.isspace() or len(line) > MAX_LINE:
            yield number, line
        while line and len(line) > MAX_LINE and not line.endswith(b"\n"):
            line = file.readline(MAX_LINE + 1)


def object_of(line: bytes, what: str) -> dict[str, Any]:
    """Return the JSON object in this line, which holds one event or command (`what`).

    Raises: UsageError if there is none, or if a key occurs twice, of which JSON readers would silently drop one.
    """
    if len(line) > MAX_LINE:
        raise UsageError(f"found more than {MAX_LINE:,} bytes, expected one {what} per line")
    try:
        return json_object(line)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        raise UsageError(f"{error!s:.200}; expected a JSON object") from error


def parse_line(line: bytes) -> tuple[Event, datetime | None, int | None]:
    """Return the event of a line, its time and its cause; None where the line has none.

    Raises: UsageError for an invalid line; it names the field.
    """
    row = object_of(line, "event")
    event = event_of(row.get("type"), {name: row[name] for name in row.keys() - set(BESIDE)})
    return event, _when(row.get("time")), _cause(row.get("caused_by"))


def _when(text: object) -> datetime | None:
    """Return a time of ISO 8601; without a zone it is UTC."""
    if text is None:
        return None
    try:
        if not isinstance(text, str):
            raise ValueError("no text")
        return utc.parsed(text).astimezone(UTC)
    except (ValueError, OverflowError) as error:
        raise UsageError(
            f"field time: found {value_text(text)}, expected a time such as 2026-03-01T10:00:00Z"
        ) from error


def _cause(number: object) -> int | None:
    if number is not None and type(number) is not int:
        raise UsageError(f"field caused_by: found {value_text(number)}, expected the number of an earlier event")
    return number


def storable_text(text: str) -> str:
    """Return the text as an event may hold it: escaped if it has unprintable characters."""
    return text if text.isprintable() else escaped(text)


def storable(event: Event) -> Event:
    """Return the event with its unprintable texts escaped."""
    texts = chain.from_iterable(item if isinstance(item, tuple) else (item,) for item in flat(event).values())
    if all(not isinstance(text, str) or text.isprintable() for text in texts):
        return event
    return msgspec.convert(_escaped(msgspec.to_builtins(event)), type(event))


def _escaped(node: Any) -> Any:
    if isinstance(node, str):
        return storable_text(node)
    if isinstance(node, dict):
        return {name: _escaped(child) for name, child in node.items()}
    return [_escaped(child) for child in node] if isinstance(node, (list, tuple)) else node


def text_of(raw: bytes) -> str:
    """Return the bytes as text that an event may hold; in hexadecimal if they are not text."""
    try:
        return storable_text(raw.decode())
    except UnicodeDecodeError:
        return raw.hex()


# See docs/decisions/sources-are-judged-by-types.md.
class Declared(msgspec.Struct, frozen=True):
    """What a source records: everything of the concerns it `observes`, and of others the `records` it names.

    `kinds` are the event types that the run may have.
    """

    observes: tuple[str, ...]
    records: tuple[str, ...]

    @property
    def kinds(self) -> frozenset[str]:
        """The event types, by name without version, that the run may have beside those that describe it."""
        whole = {kind for kind, concern in CONCERN_OF.items() if concern in self.observes}
        return frozenset(whole | {name for name in self.records if "." not in name})


def declared(names: Iterable[str]) -> Declared:
    """Return what these names declare: concerns, event types, and fields such as `RequestIssued.requested_by`.

    `RequestIssued.*` is the type with all of its fields. Each is named once, in the order of `CONCERNS` and of the
    event types. Naming a field names its type.

    Raises: UsageError for a name that is none of these.
    """
    requested = {
        expanded
        for name in names
        for expanded in (
            [record for record in RECORDS if record.startswith(name[:-1])] if name.endswith(".*") else [name]
        )
    }
    requested |= {name.partition(".")[0] for name in requested if "." in name}
    known: Collection[str] = (*CONCERNS, *RECORDS)
    for name in sorted(requested - set(known)):
        raise UsageError(
            f"observes: found {value(name)}, expected concerns ({', '.join(CONCERNS)}), event types, or fields of them "
            f"that may be NULL, as in ExecutionStarted.requested_by{did_you_mean(name, known)}"
        )
    return Declared(
        tuple(name for name in CONCERNS if name in requested), tuple(name for name in RECORDS if name in requested)
    )
