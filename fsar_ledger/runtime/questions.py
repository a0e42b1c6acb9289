"""Questions: what a run asks at its ports, under names that people can type, and the answers that they take.

| name | who is asked | answer |
|---|---|---|
| `call:2`, `call:A1-1/2.1/review/0` | the supervisor of the second call, or of this one | `approve`, `deny`, `other` |
| `response:A1-1/2.1/review/0` | how long that takes | a length, `never` |
| `attempt:A1-1/2.1/1` | whether a degraded actuator holds | `hold`, `fail` |
| `approach:KEY`, `retry:KEY`, `execution:KEY` | how long a robot's body takes | a length, `never` |
| `message:KEY` | how long a message takes | a length, `never` |

`deny` is no to a review; `other` puts the other of two competing actions first. To any other call they mean nothing.
"""

from collections.abc import Sequence
from typing import NamedTuple

from .changes import NEVER, seconds_text
from .ports import AS_USUAL, DISAPPROVES, PREFERS_OTHER, Ask, Environment, Fact
from .world.draws import FOREVER_US

CALL, RESPONSE, ATTEMPT, EXECUTION = "call", "response", "attempt", "execution"
_KINDS = {"verdict": CALL, "reliability": ATTEMPT}
_NAMED = ("message", RESPONSE, "approach", "retry")
KINDS = ("message", RESPONSE, "approach", "retry", EXECUTION, ATTEMPT, CALL)

WORDS: dict[str, dict[str, int]] = {
    CALL: {"approve": AS_USUAL, "deny": DISAPPROVES, "other": PREFERS_OTHER},
    ATTEMPT: {"hold": 1, "fail": 0},
}
"""By kind of question, the words that answer it; all others are answered by a length."""


class Asked(NamedTuple):
    """A question that a run asked, by name, with the environment's answer; lengths in microseconds."""

    name: str
    answer: int

    @property
    def kind(self) -> str:
        """Return what kind of question it is: the name up to the colon."""
        return self.name.partition(":")[0]

    @property
    def text(self) -> str:
        """Return the answer as `answer` takes it."""
        words = WORDS.get(self.kind)
        if words is not None:
            return next(word for word, answer in words.items() if answer == self.answer)
        return NEVER if self.answer >= FOREVER_US else seconds_text(self.answer / 1_000_000)


def name_of(ask: Ask) -> str | None:
    """Return the name of a question; None for what takes no time and has no name."""
    if not ask.key:
        return None
    what = ask.what
    return f"{_KINDS.get(what) or (what if what in _NAMED else EXECUTION)}:{ask.key}"


def answer_of(kind: str, text: str) -> int | None:
    """Return the answer that this text gives to a question of this kind; None if it gives none.

    Units: microseconds for lengths.
    """
    words = WORDS.get(kind)
    if words is not None:
        return words.get(text)
    if text == NEVER:
        return FOREVER_US
    number = text.removesuffix("s")
    return round(float(number) * 1_000_000) if text.endswith("s") and number.replace(".", "", 1).isdigit() else None


class Noting:
    """An environment that notes what is asked and answered, in order."""

    def __init__(self, environment: Environment) -> None:
        self.facts: tuple[Fact, ...] = tuple(environment.facts)
        self.latest_us = environment.latest_us
        self.asked: list[Asked] = []
        self._answer = environment.answer

    def answer(self, ask: Ask) -> int:
        """Answer as the environment does, and note it."""
        answer = self._answer(ask)
        name = name_of(ask)
        if name is not None:
            self.asked.append(Asked(name, answer))
        return answer


def numbers_of_calls(asked: Sequence[Asked]) -> dict[str, int]:
    """Return the number of each call by its name, from 1: the call of that number is `call:1` for short."""
    names = [CALL + one.name.removeprefix(RESPONSE) for one in asked if one.kind == RESPONSE]
    return {name: number for number, name in reversed([*enumerate(names, start=1)])}
