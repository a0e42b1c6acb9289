"""Read changes from their texts, and from TOML files. The inverse of `str` of a change (`changes.py`)."""

from collections.abc import Callable, Sequence
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any, get_args

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.registered import at_line, read_design
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.envelope import Operation, PolicyScope, Robot, local_supervisor
from fsar_ledger.events.world import (
    ActuatorDegraded,
    ContextChanged,
    Grade,
    LinkCameUp,
    LinkWentDown,
    ObstructionAppeared,
    ObstructionCleared,
    PeersMet,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RobotCalledAway,
    RobotCameBack,
    RobotWentOff,
    RoutineDue,
    SupervisorLeft,
    SupervisorReturned,
    WorldEvent,
)

from .changes import (
    Add,
    Answer,
    AnyChange,
    Architecture,
    Budget,
    Changes,
    Density,
    Drop,
    Move,
    Rule,
    Set,
    Trust,
    Verb,
    Without,
    seconds_text,
)
from .live import command_given

COMMAND = "command:"
"""The prefix of the names of commands from outside."""
MAX_TEXT = 10_000
"""Characters of a change; the longest, a task with its steps, has some hundreds."""
MAX_SECONDS = 9_007_199_254
FORMS = {
    "drop": "drop FACT, as in `drop window:fleet/B1/0`",
    "move": "move FACT +TIME or -TIME, as in `move context:A1/3 +5s`",
    "add": "add KIND:WHO TIME [for TIME] [WORD], as in `add obstruction:B1 20s for 5s`, or add TIME and the JSON of a "
    "fact of the world, or of a command as `federate` takes it",
    "answer": "answer QUESTION ANSWER, as in `answer call:2 deny`, or answer command:NAME/N FIELD=VALUE",
    "rule": "rule fleet|local OUTCOME [robot=R] [capability=C] [task=T] [from TIME], as in `rule fleet deny robot=B1`",
    "trust": "trust ROBOT PEER SCOPE [capability=C] [task=T] [from TIME], as in `trust A1 B1 none from 20s`",
    "budget": "budget ROBOT LEVEL TIME ATTEMPTS [from TIME], as in `budget A1 local 5s 1`",
    "density": "density ROBOT|all N [from TIME], as in `density all 2 from 30s`",
    "set": "set NAME=VALUE [from TIME], as in `set world.review_share=0.5`",
    "architecture": "architecture NAME, as in `architecture cfc`",
    "without": "without MECHANISM, as in `without shared-registry`",
}
"""The form of each change."""


_WITH_BEFORE = ("set", "architecture", "without")
"""The changes that state the previous value."""


class _File(msgspec.Struct, forbid_unknown_fields=True):
    """A TOML file of changes: `[[changes]]` tables with the fields of `changes.py`, or a list of their texts."""

    changes: list[Any]


def read_changes(path: Path) -> Changes:
    """Return the changes in a TOML file, whose `changes` is a list of texts or of tables.

    Raises:
        UsageError: The file cannot be read, or a change is invalid; with the line.
    """
    design, text = read_design(path, _File)
    changes: Changes = ()
    for number, entry in enumerate(design.changes):
        try:
            changes += parsed([entry if isinstance(entry, str) else str(msgspec.convert(entry, AnyChange))])
        except msgspec.ValidationError as error:
            message = printable.value(str(error).partition(" - at ")[0])
            raise UsageError(
                f"{at_line(str(path), text, ('changes', number))}: {message}; see docs/replay.md"
            ) from error
        except UsageError as error:
            raise UsageError(f"{at_line(str(path), text, ('changes', number))}: {error}") from error
    return changes


def parsed(texts: Sequence[str]) -> Changes:
    """Return the changes of these texts; one text may give two. Raises: UsageError, with the form it should have."""
    return tuple(change for text in texts for change in _parsed(text))


def _parsed(text: str) -> Changes:
    verb, _, rest = text.strip().partition(" ")
    rest, _, before = rest.partition(" instead of ") if verb in _WITH_BEFORE else (rest, "", "")
    if verb not in _PARSERS or len(text) > MAX_TEXT:
        hint = printable.did_you_mean(verb, FORMS) or ";"
        raise UsageError(
            f"change {printable.value(text)}: found {printable.value(verb) or 'nothing'}{hint} expected one of "
            f"{', '.join(FORMS)}"
        )
    try:
        result = _PARSERS[verb](rest.strip())
        changes = result if isinstance(result, tuple) else (result,)
        if before:
            changes = (msgspec.structs.replace(changes[0], before=before),)
        # Converting checks every field.
        return tuple(msgspec.convert(msgspec.to_builtins(change), AnyChange) for change in changes)
    except (ValueError, TypeError, msgspec.MsgspecError) as error:
        found_text = _error_prefix(error)
        raise UsageError(f"change {printable.value(text)}: {found_text}expected {FORMS[verb]}") from error


def _error_prefix(error: Exception) -> str:
    if isinstance(error, msgspec.MsgspecError):
        return f"{printable.value(str(error).partition(' - at ')[0])}; "
    return f"{error}; " if isinstance(error, _Unfit) else ""


class _Unfit(ValueError):
    """An invalid part of the text of a change."""


def seconds_of(text: str) -> float:
    """Return the seconds of `46.6`, `46.6s` or `46600ms`. Raises: ValueError."""
    is_milli = text.endswith("ms")
    number = text.removesuffix("ms" if is_milli else "s")
    try:
        seconds = Decimal(number) / (1_000 if is_milli else 1)
    except ArithmeticError as error:
        raise _Unfit(f"found {printable.value(text)} where a time belongs") from error
    if "e" in number.lower():
        raise _Unfit(f"found {printable.value(text)} where a time in plain digits belongs, as 1000s")
    if not seconds.is_finite() or not 0 <= seconds <= MAX_SECONDS:
        raise _Unfit(f"found {printable.value(text)} where a time of 0 to {MAX_SECONDS:,} s belongs")
    return float(seconds)


def _robot(text: str) -> Robot:
    name = text if "/" in text else f"robot/{text}"
    if not name.startswith("robot/"):
        raise _Unfit(f"found {printable.value(text)} where a robot belongs")
    return msgspec.convert(name, Robot)


def _words(text: str, minimum: int, maximum: int) -> list[str]:
    words = text.split()
    if not minimum <= len(words) <= maximum:
        raise _Unfit(f"found {printable.counted(len(words), 'word')} after the verb")
    return words


def _with_from(text: str) -> tuple[str, float | None]:
    """Split off the time from which a change holds; return the rest and that time, if any."""
    rest, marker, when = text.rpartition(" from ")
    return (rest, seconds_of(when.strip())) if marker else (text, None)


def _with_options(text: str, plain: int, names: Sequence[str]) -> tuple[list[str], dict[str, str], float]:
    """Return the plain words, the options NAME=VALUE, and the time from which the change holds."""
    rest, from_s = _with_from(text)
    words = rest.split()
    options = dict(word.split("=", 1) for word in words[plain:] if "=" in word)
    unknown = [word for word in words[plain:] if word.partition("=")[0] not in names or "=" not in word]
    if len(words) < plain or unknown or len(options) < len(words) - plain:
        raise _Unfit(f"found {printable.value(unknown[0]) if unknown else 'too few words, or an option twice'}")
    return words[:plain], options, from_s or 0.0


def _one_word(kind: type[Drop | Architecture | Without], text: str) -> Drop | Architecture | Without:
    return kind(*_words(text, 1, 1))


def _move(text: str) -> Move:
    fact, by = _words(text, 2, 2)
    if by[0] not in "+-":
        raise _Unfit(f"found {printable.value(by)} without + or -")
    return Move(fact, seconds_of(by[1:]) * (1 if by[0] == "+" else -1))


def _answer(text: str) -> Answer:
    question, _, answer = text.partition(" ")
    if not question.startswith(COMMAND):
        question, answer = _words(text, 2, 2)
    elif "=" not in answer:
        raise _Unfit(f"found {printable.value(answer) or 'no value'} where FIELD=VALUE belongs")
    return Answer(question, seconds_text(seconds_of(answer)) if answer[0].isdigit() else answer)


def _rule(text: str) -> Rule:
    (scope, outcome), options, from_s = _with_options(text, 2, ("robot", "capability", "task"))
    if "robot" in options:
        options["robot"] = _robot(options["robot"])
    return Rule(scope=scope, outcome=outcome, from_s=from_s, **options)  # type: ignore[arg-type]


def _trust(text: str) -> Trust:
    (robot, peer, scope), options, from_s = _with_options(text, 3, ("capability", "task"))
    return Trust(robot=_robot(robot), peer=_robot(peer), scope=scope, from_s=from_s, **options)  # type: ignore[arg-type]


def _budget(text: str) -> Budget:
    (robot, level, time, attempts), _, from_s = _with_options(text, 4, ())
    return Budget(
        robot=_robot(robot),
        level=level,  # type: ignore[arg-type]
        time_s=seconds_of(time),
        attempts=int(attempts),
        from_s=from_s,
    )


def _density(text: str) -> Density:
    (robot, review_every), _, from_s = _with_options(text, 2, ())
    return Density(robot=None if robot == "all" else _robot(robot), review_every=int(review_every), from_s=from_s)


def _set(text: str) -> Set:
    rest, from_s = _with_from(text)
    name, equals, value = rest.partition("=")
    number = msgspec.json.decode(value) if equals else None
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise _Unfit(f"found {printable.value(value) or 'no value'} where a number belongs")
    return Set(constant=name.strip(), value=number, from_s=from_s)


def _add(text: str) -> Add | tuple[Add, ...]:
    first, _, rest = text.partition(" ")
    if ":" in first:
        return _added(first, rest.split())
    if isinstance(fields := msgspec.json.decode(rest), dict) and "command" in fields:
        return Add(seconds_of(first), fact_text(fact_of(rest)))
    text = _newest(rest)  # as it was given, so that the changes of a fork are read as they are stored
    _checked(msgspec.json.decode(text, type=WorldEvent))
    return Add(seconds_of(first), text)


def fact_text(event: Event) -> str:
    """Format a fact of the world, or a command of a live run, as `add` takes it."""
    if isinstance(event, CommandGiven):
        fields = {"command": event.command, "by": event.issued_by, **({} if event.key is None else {"key": event.key})}
        return msgspec.json.encode(fields | msgspec.json.decode(event.parameters)).decode()
    return msgspec.json.encode(event).decode()


def fact_of(text: str) -> Event:
    """Parse the output of `fact_text`. Raises: msgspec.MsgspecError; UsageError for an invalid command."""
    fields = msgspec.json.decode(text)
    if isinstance(fields, dict) and "command" in fields:
        name, by, key = (fields.pop(field, None) for field in ("command", "by", "key"))
        if not isinstance(name, str) or not isinstance(by, str) or not isinstance(key, str | None):
            raise _Unfit("found a command without texts for `command` and `by`")
        return command_given(name, by, fields, key)
    fact: Event = msgspec.json.decode(text, type=WorldEvent)
    return fact


def altered(command: CommandGiven, change: Answer) -> CommandGiven:
    """Return the command with the change's field set. Raises: UsageError, MsgspecError if it is invalid."""
    name, _, text = change.answer.partition("=")
    try:
        value = msgspec.json.decode(text)
    except msgspec.DecodeError:
        value = text
    fields = {**msgspec.json.decode(command.parameters), name: value}
    try:
        return command_given(command.command, command.issued_by, fields, command.key, command.source_time_us)
    except UsageError as error:
        raise UsageError(f"change {change}: {error}") from error


def _newest(text: str) -> str:
    """Return the JSON, with the newest version of its type if it names none."""
    fields = msgspec.json.decode(text)
    tags = {kind.__name__: kind.__struct_config__.tag for kind in get_args(WorldEvent)}
    if not isinstance(fields, dict):
        raise _Unfit("found JSON that is no object")
    name = fields.get("type")
    return msgspec.json.encode({**fields, "type": tags.get(name, name)}).decode()


def _added(name: str, words: list[str]) -> tuple[Add, ...]:
    """Return the facts that `add KIND:WHO TIME [for TIME] [WORD]` is short for: a beginning and an end, or one."""
    kind, _, who = name.partition(":")
    if kind not in SHORT or not words:
        hint = printable.did_you_mean(kind, SHORT) or ";"
        raise _Unfit(f"found {printable.value(kind)}{hint} known are {', '.join(SHORT)}")
    at_s, rest = seconds_of(words[0]), words[1:]
    for_s = seconds_of(rest[1]) if rest[:1] == ["for"] and len(rest) > 1 else None
    extra = [*rest[2:]] if for_s is not None else rest
    is_spell, make = SHORT[kind]
    if (for_s is None) == is_spell or len(extra) > 1:
        raise _Unfit(f"{kind} takes {'a length: for TIME' if is_spell else 'no length'}, and at most one more word")
    known = WORDS.get(kind, ())
    if (kind == "routine" and not extra) or (extra and extra[0] not in known):
        takes = f"one of {', '.join(known)}" if known else "nothing more"
        raise _Unfit(f"found {printable.value(extra[0]) if extra else 'no word'} at the end; {kind} takes {takes}")
    lasting = "" if for_s is None else f"-for-{seconds_text(for_s)}"  # what begins together need not end together
    events = make(who, f"{seconds_text(at_s)}{lasting}", *extra)
    times = (at_s,) if for_s is None else (at_s, at_s + for_s)
    return tuple(Add(time_s, _checked(event)) for time_s, event in zip(times, events, strict=True))


def _checked(event: Event) -> str:
    """Return the text of a fact after checking each field. Raises: msgspec.MsgspecError, _Unfit."""
    text = fact_text(event)
    fact = fact_of(text)
    if isinstance(fact, PolicyWindowOpened) and fact.outcome == "allow":
        raise _Unfit("found a window that allows, where one restricts (review, deny)")
    if isinstance(fact, PeersMet) and fact.robot == fact.peer:
        raise _Unfit(f"found a meeting of {printable.value(fact.robot)} with itself, where two robots belong")
    return text


def _window(who: str, when: str, outcome: str = "deny") -> tuple[Event, ...]:
    scope, _, name = who.partition("/")
    if scope not in get_args(PolicyScope):
        raise _Unfit(f"found {printable.value(who)} where fleet/ROBOT or local/ROBOT belongs")
    robot, window = _robot(name), f"{who}/at-{when}"
    opened = PolicyWindowOpened(robot=robot, scope=scope, window=window, outcome=outcome)  # type: ignore[arg-type]
    return opened, PolicyWindowClosed(robot=robot, scope=scope, window=window)  # type: ignore[arg-type]


def _in_the_way(kind: str, who: str, when: str) -> tuple[Event, ...]:
    robot, obstruction = _robot(who), f"{kind}/{who}/at-{when}"
    return ObstructionAppeared(robot, obstruction), ObstructionCleared(robot, obstruction)


def _of_robot(kinds: tuple[Callable[..., Event], ...], who: str, _when: str, *word: str) -> tuple[Event, ...]:
    return tuple(kind(_robot(who), *word) for kind in kinds)


def _absence(who: str, _when: str) -> tuple[Event, ...]:
    supervisor = local_supervisor(_robot(who.removeprefix("supervisor/")))
    return SupervisorLeft(supervisor), SupervisorReturned(supervisor)


def _encounter(who: str, _when: str) -> tuple[Event, ...]:
    robot, _, peer = who.partition("/")
    return (PeersMet(_robot(robot), _robot(peer)),)


SHORT: dict[str, tuple[bool, Callable[..., tuple[Event, ...]]]] = {
    "window": (True, _window),
    "obstruction": (True, partial(_in_the_way, "obstruction")),
    "crowding": (True, partial(_in_the_way, "crowding")),
    "off": (True, partial(_of_robot, (RobotWentOff, RobotCameBack))),
    "called": (False, partial(_of_robot, (RobotCalledAway,))),
    "link": (True, partial(_of_robot, (LinkWentDown, LinkCameUp))),
    "absence": (True, _absence),
    "context": (False, partial(_of_robot, (ContextChanged,))),
    "degradation": (False, partial(_of_robot, (ActuatorDegraded,))),
    "routine": (False, partial(_of_robot, (RoutineDue,))),
    "encounter": (False, _encounter),
}
"""By kind of fact with a short form: whether it lasts, and the function that makes its events."""

WORDS: dict[str, tuple[str, ...]] = {
    "window": ("deny", "review"),
    "degradation": get_args(Grade),
    "routine": get_args(Operation),
}
"""By kind, the words that a short form may end in; that of `routine` must."""

_PARSERS: dict[str, Callable[[str], AnyChange | tuple[Add, ...]]] = {
    "drop": partial(_one_word, Drop),
    "move": _move,
    "add": _add,
    "answer": _answer,
    "rule": _rule,
    "trust": _trust,
    "budget": _budget,
    "density": _density,
    "set": _set,
    "architecture": partial(_one_word, Architecture),
    "without": partial(_one_word, Without),
}
assert set(_PARSERS) == set(get_args(Verb)) == set(FORMS)
