"""The world: the only home of randomness. It knows scenarios and robots, but not the architecture.

Here are its draws: pure functions of what they are used for, and the environment that answers with them. A draw is the
BLAKE2b hash of its name under the key of the run, so it does not depend on earlier draws, on any other stream, or on
the architecture. No name contains an architecture or a configuration.
"""

import struct
from collections.abc import Sequence
from hashlib import blake2b
from math import log

from fsar_ledger.designs.constants import END_US, Range, WorldConstants
from fsar_ledger.runtime.ports import AS_USUAL, Ask, Fact

FOREVER_US = (
    10**15
)  # some 30 years; longer durations are cut to this, so that every time is an integer that can be stored
_SHARE = 2.0**-53
_BLOCK = struct.Struct("<8Q")
_ONE = struct.Struct("<Q")


def run_key(seed: int, scenario: str, run: int) -> bytes:
    """Return the key under which all draws of one run are made."""
    return blake2b(f"{seed}|{len(scenario)}:{scenario}|{run}".encode(), digest_size=32).digest()


class Stream:
    """An endless sequence of uniform draws in [0, 1) under one name, for schedules that need many."""

    __slots__ = ("_block", "_buffer", "_key")

    def __init__(self, key: bytes, name: str) -> None:
        self._key = blake2b(name.encode(), digest_size=32, key=key).digest()
        self._block = 0
        self._buffer: list[float] = []

    def uniform(self) -> float:
        """Return the next draw in [0, 1)."""
        if not self._buffer:
            words = _BLOCK.unpack(blake2b(self._block.to_bytes(8, "little"), key=self._key).digest())
            self._buffer = [(word >> 11) * _SHARE for word in reversed(words)]
            self._block += 1
        return self._buffer.pop()

    def within_us(self, law: Range) -> int:
        """Return a uniformly distributed duration. Units: microseconds."""
        return round(min((law.low_s + (law.high_s - law.low_s) * self.uniform()) * 1e6, FOREVER_US))

    def exponential_us(self, mean_s: float) -> int:
        """Return an exponentially distributed duration of at least 1. Units: microseconds."""
        return max(1, round(min(-log(1.0 - self.uniform()) * mean_s * 1e6, FOREVER_US)))


class Draws:
    """Draws that answer during the run, named by stream and by the task, step, attempt and hop that use them."""

    __slots__ = ("_begun", "_laws", "_reliability")

    def __init__(self, key: bytes, world: WorldConstants) -> None:
        self._reliability = world.degraded_reliability
        laws = {
            "message": world.message,
            "approach": world.approach,
            "retry": world.retry,
            "response": world.response,
            **dict(world.durations),
        }
        self._laws = {
            stream: (law.low_s * 1e6, (law.high_s - law.low_s) * 1e6 * _SHARE) for stream, law in laws.items()
        }
        # Of each stream, the hash of what the names of its draws begin with: thousands of them follow.
        self._begun = {
            stream: blake2b(f"{stream}|".encode(), digest_size=8, key=key) for stream in (*laws, "reliability")
        }

    def answer(self, ask: Ask) -> int:
        """Draw the answer: a length in microseconds; to `reliability`, 1 if a degraded actuator holds, else 0."""
        stream, share_ppm = ask.what, ask.share_ppm
        if not share_ppm:
            return 0
        if stream in ("verdict", "admission", "help"):  # the model's supervisors and robots answer alike
            return AS_USUAL
        # See docs/decisions/draws-are-named.md.
        digest = self._begun[stream].copy()
        digest.update(ask.key.encode())
        word: int = _ONE.unpack(digest.digest())[0] >> 11
        if stream == "reliability":
            return int(word * _SHARE < self._reliability)
        low_us, scale = self._laws[stream]
        length_us = round(min(low_us + scale * word, FOREVER_US))
        return length_us if share_ppm == 1_000_000 else length_us * share_ppm // 1_000_000

    def middle(self, ask: Ask) -> int:
        """Return the middle of the law by which a length is drawn. Units: microseconds."""
        low_us, scale = self._laws[ask.what]
        return round(min(low_us + scale / (2 * _SHARE), FOREVER_US)) * ask.share_ppm // 1_000_000


class SimulatedEnvironment:
    """A world in which these facts happen and these draws answer."""

    __slots__ = ("answer", "facts", "latest_us", "middle")

    def __init__(self, facts: Sequence[Fact], draws: Draws) -> None:
        self.facts = facts
        self.latest_us: int | None = 2 * END_US  # no simulated run is longer: one that is still busy then is a bug
        self.answer = draws.answer
        self.middle = draws.middle
