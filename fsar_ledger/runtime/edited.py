"""The edited environment: another one, in which some facts and answers are otherwise."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from fsar_ledger.constants import END_US
from fsar_ledger.errors import UsageError

from .change_texts import fact_of
from .changes import Add, Answer, Drop, Move, OfFacts, microseconds_of, seconds_text
from .happenings import happenings, meant
from .ports import Ask, Environment, Fact
from .questions import CALL, RESPONSE, answer_of, name_of


class Edited:
    """An environment with other facts, and with these answers to the questions that they name.

    `used` are the questions that were answered otherwise so far, as the changes name them. `call:2` is the second call
    that the run puts before a supervisor, counted when it asks how long the answer takes.
    """

    def __init__(self, environment: Environment, facts: Sequence[Fact], answers: Sequence[Answer]) -> None:
        self.facts = facts
        self.latest_us = environment.latest_us
        self.used: set[str] = set()
        self._environment = environment
        self._exact = {one.question: one.answer for one in answers if "*" not in one.question}
        self._patterns = [(_plain(one.question), one) for one in answers if "*" in one.question]
        self._calls = 0
        self._asked_as: dict[str, str] = {}
        self.answer = self._edited if answers else environment.answer

    def answers_of(self, environment: Environment) -> None:
        """From now on, all else is answered by this environment."""
        self._environment = environment
        if not self._exact and not self._patterns:
            self.answer = environment.answer

    def _edited(self, ask: Ask) -> int:
        usual = self._environment.answer(ask)
        name = name_of(ask)
        if name is None:
            return usual
        kind = name.partition(":")[0]
        if kind == RESPONSE:
            self._calls += 1
            for numbered in (RESPONSE, CALL):
                if (text := self._exact.get(f"{numbered}:{self._calls}")) is not None:
                    self._exact[f"{numbered}:{ask.key}"] = text
                    self._asked_as[f"{numbered}:{ask.key}"] = f"{numbered}:{self._calls}"
        asked_as, text = self._asked_as.get(name, name), self._exact.get(name)
        if text is None:
            pattern = next((one for pattern, one in self._patterns if fnmatchcase(name, pattern)), None)
            if pattern is not None:
                asked_as, text = pattern.question, pattern.answer
        answer = None if text is None else answer_of(kind, text)
        if answer is None:
            return usual
        if answer != usual:
            self.used.add(asked_as)
        return answer


def _plain(pattern: str) -> str:
    return pattern.replace("[", "[[]").replace("?", "[?]")


def edited_facts(facts: Sequence[Fact], changes: Sequence[OfFacts]) -> tuple[Fact, ...]:
    """Return the facts with these changes, in order of time, no two at the same microsecond.

    A name that no fact has changes nothing.

    Raises:
        UsageError: A fact would happen before the run begins, or after it has ended.
    """
    found = tuple(facts)
    for change in changes:
        found = _changed(found, change)
    return found


def _changed(facts: tuple[Fact, ...], change: OfFacts) -> tuple[Fact, ...]:
    if isinstance(change, Add):
        return _apart(facts, [(_within(change, microseconds_of(change.at_s)), fact_of(change.event))])
    names = happenings(facts)
    places = {at for name in meant(change.fact, names) for at in names[name]}
    if not places:
        return facts
    left = tuple(fact for at, fact in enumerate(facts) if at not in places)
    if isinstance(change, Drop):
        return left
    by_us = microseconds_of(change.by_s)
    return _apart(left, [(_within(change, facts[at][0] + by_us), facts[at][1]) for at in sorted(places)])


def _within(change: Add | Move, time_us: int) -> int:
    if not 1 <= time_us <= END_US:
        raise UsageError(
            f"change {change}: found a fact at {seconds_text(time_us / 1_000_000)}, expected it after the beginning of "
            f"the run and before its last possible end, {seconds_text(END_US / 1_000_000)}"
        )
    return time_us


def _apart(facts: tuple[Fact, ...], more: list[Fact]) -> tuple[Fact, ...]:
    """Return all facts in order of time; those of `more` move to the next free microsecond."""
    taken = {time_us for time_us, _ in facts}
    placed: list[Fact] = []
    for time_us, fact in more:
        while time_us in taken:
            time_us += 1
        taken.add(time_us)
        placed.append((time_us, fact))
    return tuple(sorted((*facts, *placed), key=lambda fact: fact[0]))
