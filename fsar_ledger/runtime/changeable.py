"""What a change can name: the facts of a run's world and the questions that the run asks at its ports.

Facts with their ends: `window:fleet/B1/0` and `window:local/A1/3` (a policy window, opened and closed),
`obstruction:B1/0`, `crowding:B1/0`, `off:B1/0`, `link:B1/0`, `absence:A1/0`. Facts alone: `context:A1/3`,
`degradation:B1/0`, `routine:A1/7`, `encounter:A1/B1/0`, `task:A1-1`, `outsider:injected-1-1`, `sync:0`,
`snapshot:A1/0`. Numbers count from 0 in order of time. Questions, and the answers that they take:

| name | who is asked | answer |
|---|---|---|
| `call:2`, `call:A1-1/2.1/review/0` | the supervisor of the second call, or of this one | `approve`, `deny`, `other` |
| `response:A1-1/2.1/review/0` | how long that takes | a length, `never` |
| `attempt:A1-1/2.1/1` | whether a degraded actuator holds | `hold`, `fail` |
| `approach:KEY`, `retry:KEY`, `execution:KEY` | how long a robot's body takes | a length, `never` |
| `message:KEY` | how long a message takes | a length, `never` |

Commands from outside are facts, too: `command:LeaveFleet/0` is the first `LeaveFleet` that a scenario gives. In a live
run the facts are its commands: `command:ReportStart/0` is the first `ReportStart`. Robots are asked
`admission:A1-1/2.1` (whether they take the request) and `help:KEY` (whether they help), too, which take `accept`.

`deny` is no to a review; `other` puts the other of two competing actions first. To any other call they mean nothing.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.fleet import IsolationBegan, RunContinued
from fsar_ledger.events.world import (
    ActuatorDegraded,
    ContextChanged,
    LinkCameUp,
    LinkWentDown,
    ObstructionAppeared,
    ObstructionCleared,
    OutsiderRequestInjected,
    PeersMet,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RobotCalledAway,
    RobotCameBack,
    RobotWentOff,
    RoutineDue,
    SnapshotPhaseSet,
    SupervisorLeft,
    SupervisorReturned,
    SyncPhaseSet,
    TaskArrived,
)
from fsar_ledger.projections.fleet import NEVER_US

from .changes import MODEL, NEVER, Answer, seconds_text
from .ports import AS_USUAL, DISAPPROVES, PREFERS_OTHER, Ask, Fact, World
from .world import FOREVER_US, Draws
from .world.schedule import apart

FactPositions = dict[str, tuple[int, ...]]
"""By name, the indices of its facts among all facts of the run: one, or a beginning and an end."""


def _short(principal: str) -> str:
    return principal.partition("/")[2]


_WHOLE: dict[type[Event], Callable[[Any], str]] = {
    PolicyWindowOpened: lambda fact: f"window:{fact.window}",
    PolicyWindowClosed: lambda fact: f"window:{fact.window}",
    ObstructionAppeared: lambda fact: fact.obstruction.replace("/", ":", 1),
    ObstructionCleared: lambda fact: fact.obstruction.replace("/", ":", 1),
    TaskArrived: lambda fact: f"task:{fact.task_id}",
    OutsiderRequestInjected: lambda fact: f"outsider:{fact.task_id}",
}
"""Facts that have a name of their own; an end has the name of its beginning."""
_COUNTED: dict[type[Event], Callable[[Any], str]] = {
    SyncPhaseSet: lambda _: "sync:",
    SnapshotPhaseSet: lambda fact: f"snapshot:{_short(fact.robot)}/",
    ContextChanged: lambda fact: f"context:{_short(fact.robot)}/",
    ActuatorDegraded: lambda fact: f"degradation:{_short(fact.robot)}/",
    RobotWentOff: lambda fact: f"off:{_short(fact.robot)}/",
    RobotCalledAway: lambda fact: f"called:{_short(fact.robot)}/",
    LinkWentDown: lambda fact: f"link:{_short(fact.robot)}/",
    SupervisorLeft: lambda fact: f"absence:{_short(fact.supervisor)}/",
    RoutineDue: lambda fact: f"routine:{_short(fact.robot)}/",
    PeersMet: lambda fact: f"encounter:{_short(fact.robot)}/{_short(fact.peer)}/",
    CommandGiven: lambda fact: f"command:{fact.command}/",
}
"""Facts that are counted, with the prefix of their names."""
_ENDS: dict[type[Event], Callable[[Any], str]] = {
    RobotCameBack: lambda fact: f"off:{_short(fact.robot)}/",
    LinkCameUp: lambda fact: f"link:{_short(fact.robot)}/",
    SupervisorReturned: lambda fact: f"absence:{_short(fact.supervisor)}/",
}
"""Ends of the last counted spell, with the prefix of its name."""


@lru_cache(maxsize=64)
def facts_by_name(facts: tuple[Fact, ...]) -> FactPositions:
    """Return the indices of the facts by name; cuts of the run have no name, since they decide nothing."""
    indices: dict[str, tuple[int, ...]] = {}
    counts: Counter[str] = Counter()
    for index, (_, fact) in enumerate(facts):
        kind = type(fact)
        if kind in (RunContinued, IsolationBegan):
            continue
        if kind in _WHOLE:
            name = _WHOLE[kind](fact)
        elif kind in _COUNTED:
            stem = _COUNTED[kind](fact)
            name = f"{stem}{counts[stem]}"
            counts[stem] += 1
        else:
            stem = _ENDS[kind](fact)
            name = f"{stem}{max(0, counts[stem] - 1)}"
        indices[name] = (*indices.get(name, ()), index)
    return indices


def united(facts: tuple[Fact, ...], placed: Sequence[Event]) -> tuple[Fact, ...]:
    """Return the facts with overlapping spells merged, for the spells that begin or end with a placed fact.

    A merged spell lasts from the first beginning to the last end. `placed` are the facts that changes add or move.
    """
    kept, depths = list[Fact](), dict.fromkeys(filter(None, map(_spell, placed)), 0)
    for time_us, fact in facts:
        spell = _spell(fact)
        if spell in depths:
            is_end = type(fact) in _ENDS
            depth = depths[spell]
            depths[spell] = max(0, depth - 1) if is_end else depth + 1
            if depth > is_end:
                continue
        kept.append((time_us, fact))
    return tuple(kept)


def _spell(fact: Event) -> str | None:
    """Return the name prefix of the spells that the fact begins or ends; None for other facts."""
    if type(fact) in _ENDS:
        return _ENDS[type(fact)](fact)
    return _COUNTED[type(fact)](fact) if isinstance(fact, RobotWentOff | LinkWentDown | SupervisorLeft) else None


def continued(
    before: tuple[Fact, ...], after: tuple[Fact, ...], from_us: int, *, numbers_again: bool = False
) -> tuple[Fact, ...]:
    """Return the facts of one world that begin before this time, then those of the other, each with its end.

    Recurring facts follow the other world from then on, with their numbering continued; facts that happen once are not
    repeated, and no spell begins during a spell of the same principal. With `numbers_again`, facts of the other world
    whose number is already used are left out, as in releases up to 0.16.
    """
    first_indices, second_indices = facts_by_name(before), facts_by_name(after)
    kept = {name: indices for name, indices in first_indices.items() if before[indices[0]][0] < from_us}
    facts = [before[index] for indices in kept.values() for index in indices]
    until_us = {_spell(fact): time_us for time_us, fact in sorted(facts, key=lambda entry: entry[0]) if _spell(fact)}
    later = list[str]()
    for name, (first, *_) in second_indices.items():
        begins_us, fact = after[first]
        is_again = name in kept and (numbers_again or happens_once(fact))
        is_away = not numbers_again and begins_us <= until_us.get(_spell(fact), 0)
        if begins_us >= from_us and not is_again and not is_away:
            later.append(name)
    numbers = {} if numbers_again else _numbered_on(kept, later)
    facts += [
        (after[index][0], _numbered(after[index][1], numbers)) for name in later for index in second_indices[name]
    ]
    return apart(sorted(facts, key=lambda entry: entry[0]), NEVER_US)


def happens_once(fact: Event) -> bool:
    """Return whether there is one fact of this name in a world, whenever it happens there."""
    once = TaskArrived | OutsiderRequestInjected | SyncPhaseSet | SnapshotPhaseSet | SupervisorLeft | CommandGiven
    return isinstance(fact, once) or (isinstance(fact, ActuatorDegraded) and fact.grade != "lost")


def _numbered_on(kept: Iterable[str], later: Sequence[str]) -> dict[str, str]:
    """Return the new names of the later facts whose numbering continues after the kept ones, by their old names."""
    used, first = dict[str, int](), dict[str, int]()
    for name in kept:
        stem, _, number = name.rpartition("/")
        if number.isdecimal():
            used[stem] = max(used.get(stem, 0), int(number))
    for name in later:
        stem, _, number = name.rpartition("/")
        if stem in used:
            first.setdefault(stem, int(number))
    shifts = {stem: used[stem] + 1 - number for stem, number in first.items() if used[stem] >= number}
    parts = [name.rpartition("/") for name in later]
    return {f"{stem}/{number}": f"{stem}/{int(number) + shifts[stem]}" for stem, _, number in parts if stem in shifts}


def _numbered(fact: Event, numbers: Mapping[str, str]) -> Event:
    replace = msgspec.structs.replace
    match fact:
        case PolicyWindowOpened() | PolicyWindowClosed() | ContextChanged():
            name = numbers.get(f"window:{fact.window}")
            return fact if name is None else replace(fact, window=name.partition(":")[2])
        case ObstructionAppeared() | ObstructionCleared():
            name = numbers.get(_WHOLE[type(fact)](fact))
            return fact if name is None else replace(fact, obstruction=name.replace(":", "/", 1))
        case _:
            return fact


def matching_names(pattern: str, names: Sequence[str] | FactPositions) -> list[str]:
    """Return the names that a pattern with `*` matches, in their order; without `*`, the name itself if it is known."""
    if "*" not in pattern:
        return [pattern] if pattern in names else []
    plain = plain_pattern(pattern)
    return [name for name in names if fnmatchcase(name, plain)]


def plain_pattern(pattern: str) -> str:
    """Return the pattern for `fnmatchcase` in which `*` alone stands for any text."""
    return pattern.replace("[", "[[]").replace("?", "[?]")


CALL, RESPONSE, ATTEMPT, EXECUTION = "call", "response", "attempt", "execution"
_KINDS = {"verdict": CALL, "reliability": ATTEMPT}
_NAMED = ("message", RESPONSE, "approach", "retry")
KINDS = ("message", RESPONSE, "approach", "retry", EXECUTION, ATTEMPT, CALL)
LIVE_KINDS = ("admission", "help", *KINDS[1:])
"""The kinds of question of a simulated run, and of a live one, in which messages take no time."""

WORDS: dict[str, dict[str, int]] = {
    CALL: {"approve": AS_USUAL, "deny": DISAPPROVES, "other": PREFERS_OTHER},
    ATTEMPT: {"hold": 1, "fail": 0},
    "admission": {"accept": AS_USUAL},
    "help": {"accept": AS_USUAL},
}
"""By kind of question, the words that answer it; all others are answered by a length."""


class Question(NamedTuple):
    """A question that a run asked, by name, with the environment's answer; lengths in microseconds."""

    name: str
    answer: int

    @property
    def kind(self) -> str:
        """Return the kind of the question: its name up to the colon."""
        return self.name.partition(":")[0]

    @property
    def text(self) -> str:
        """Return the answer as the change `answer` takes it."""
        words = WORDS.get(self.kind)
        if words is not None:
            return next(word for word, answer in words.items() if answer == self.answer)
        return NEVER if self.answer >= FOREVER_US else seconds_text(self.answer / 1_000_000)


def name_of(ask: Ask) -> str | None:
    """Return the name of a question; None for what takes no time and has no name, and for a robot's own judgement."""
    if not ask.key or ask.port == "decision":
        return None
    what = ask.what
    return f"{_KINDS.get(what) or (what if what in _NAMED else EXECUTION)}:{ask.key}"


def question_name(ask: Ask) -> str:
    """Return the name of a question of a live run, in which robots are asked for their judgement, too."""
    return name_of(ask) or f"{ask.what}:{ask.key}"


def answer_of(kind: str, text: str) -> int | None:
    """Return the answer that this text gives to a question of this kind; None if it is not an answer.

    Units: microseconds for lengths.
    """
    words = WORDS.get(kind)
    if words is not None:
        return words.get(text)
    if text == NEVER:
        return FOREVER_US
    number = text.removesuffix("s")
    return round(float(number) * 1_000_000) if text.endswith("s") and number.replace(".", "", 1).isdigit() else None


class EditedEnvironment:
    """An environment with edited facts and edited answers to the questions that changes name.

    `used` are the questions answered differently so far, as the changes name them. `call:2` is the second call
    that the run puts before a supervisor, counted when it asks how long the answer takes.
    """

    def __init__(
        self,
        environment: World,
        facts: Sequence[Fact],
        answers: Sequence[Answer],
        draws: Callable[[int], Draws] | None = None,
    ) -> None:
        """Edit an environment; `draws` returns, by seed, the model's draws that may answer for a live fleet."""
        self.facts = facts
        self.latest_us = environment.latest_us
        self._draws = draws
        self.used: set[str] = set()
        self._environment = environment
        self._exact = {answer.question: answer.answer for answer in answers if "*" not in answer.question}
        self._patterns = [(plain_pattern(answer.question), answer) for answer in answers if "*" in answer.question]
        self._calls = 0
        self._asked_as: dict[str, str] = {}
        self.answer = self._edited if answers else environment.answer

    def use_environment(self, environment: World) -> None:
        """Replace the environment that answers all other questions."""
        self._environment = environment
        if not self._exact and not self._patterns:
            self.answer = environment.answer

    def _edited(self, ask: Ask) -> int:
        usual = self._environment.answer(ask)
        name = name_of(ask)
        if name is None:
            return usual
        asked_as, text = self._changed_answer(name, ask.key)
        answer = None if text is None else answer_of(name.partition(":")[0], text)
        if answer is None:
            return usual
        if answer != usual:
            self.used.add(asked_as)
        return answer

    def answer_anew(self, name: str, ask: Ask) -> int | None:
        """Return the changes' answer, given or drawn, to a question that a live run's record does not answer, if any.

        Raises:
            UsageError: The model has no law for it.
        """
        asked_as, text = self._changed_answer(name, ask.key)
        if text is None:
            return None
        self.used.add(asked_as)
        if not text.startswith(MODEL):
            return answer_of(name.partition(":")[0], text)
        try:
            assert self._draws is not None  # a live run
            return self._draws(int(text.removeprefix(MODEL))).answer(ask)
        except KeyError as error:
            raise UsageError(f"answer {asked_as} {text}: the model does not say how long {ask.what} takes") from error

    def _changed_answer(self, name: str, key: str) -> tuple[str, str | None]:
        """Return the name that the changes use for this question, and their answer; None: they give none."""
        kind = name.partition(":")[0]
        if kind == RESPONSE:
            self._calls += 1
            for numbered in (RESPONSE, CALL):
                if (text := self._exact.get(f"{numbered}:{self._calls}")) is not None:
                    self._exact[f"{numbered}:{key}"] = text
                    self._asked_as[f"{numbered}:{key}"] = f"{numbered}:{self._calls}"
        asked_as, text = self._asked_as.get(name, name), self._exact.get(name)
        if text is None:
            match = next((answer for pattern, answer in self._patterns if fnmatchcase(name, pattern)), None)
            if match is not None:
                asked_as, text = match.question, match.answer
        return asked_as, text


class QuestionRecorder:
    """An environment that records questions and answers, in order."""

    def __init__(self, environment: World) -> None:
        self.facts: tuple[Fact, ...] = tuple(environment.facts)
        self.latest_us = environment.latest_us
        self.asked: list[Question] = []
        self._answer = environment.answer

    def answer(self, ask: Ask) -> int:
        """Return the environment's answer, and record it."""
        answer = self._answer(ask)
        name = name_of(ask)
        if name is not None:
            self.asked.append(Question(name, answer))
        return answer


def numbers_of_calls(asked: Sequence[Question]) -> dict[str, int]:
    """Return the number of each call by its name, from 1; `call:1` is short for the call with that number."""
    names = [CALL + question.name.removeprefix(RESPONSE) for question in asked if question.kind == RESPONSE]
    return {name: number for number, name in reversed([*enumerate(names, start=1)])}
