"""Happenings: the facts of a run's world under names that people can type, each with its end if it has one.

`window:fleet/B1/0` and `window:local/A1/3` (a policy window, opened and closed), `obstruction:B1/0`, `crowding:B1/0`,
`off:B1/0`, `link:B1/0`, `absence:A1/0` (each with its end), `context:A1/3`, `degradation:B1/0`, `routine:A1/7`,
`encounter:A1/B1/0`, `task:A1-1`, `outsider:injected-1-1`, `sync:0`, `snapshot:A1/0`. Numbers count from 0 in order of
time.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Any

from fsar_ledger.events import Event
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
    RobotCameBack,
    RobotWentOff,
    RoutineDue,
    SnapshotPhaseSet,
    SupervisorLeft,
    SupervisorReturned,
    SyncPhaseSet,
    TaskArrived,
)

from .ports import Fact

Happenings = dict[str, tuple[int, ...]]
"""By name, the places of its facts among all facts of the run: one, or a beginning and an end."""


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
"""Facts that have a name of their own; an end has that of its beginning."""
_COUNTED: dict[type[Event], Callable[[Any], str]] = {
    SyncPhaseSet: lambda _: "sync:",
    SnapshotPhaseSet: lambda fact: f"snapshot:{_short(fact.robot)}/",
    ContextChanged: lambda fact: f"context:{_short(fact.robot)}/",
    ActuatorDegraded: lambda fact: f"degradation:{_short(fact.robot)}/",
    RobotWentOff: lambda fact: f"off:{_short(fact.robot)}/",
    LinkWentDown: lambda fact: f"link:{_short(fact.robot)}/",
    SupervisorLeft: lambda fact: f"absence:{_short(fact.supervisor)}/",
    RoutineDue: lambda fact: f"routine:{_short(fact.robot)}/",
    PeersMet: lambda fact: f"encounter:{_short(fact.robot)}/{_short(fact.peer)}/",
}
"""Facts that are counted: what their names begin with."""
_ENDS: dict[type[Event], Callable[[Any], str]] = {
    RobotCameBack: lambda fact: f"off:{_short(fact.robot)}/",
    LinkCameUp: lambda fact: f"link:{_short(fact.robot)}/",
    SupervisorReturned: lambda fact: f"absence:{_short(fact.supervisor)}/",
}
"""Ends of the last counted spell: what the names of those begin with."""


@lru_cache(maxsize=64)
def happenings(facts: tuple[Fact, ...]) -> Happenings:
    """Return the places of the facts by name."""
    found: dict[str, tuple[int, ...]] = {}
    counts: Counter[str] = Counter()
    for at, (_, fact) in enumerate(facts):
        kind = type(fact)
        if kind in _WHOLE:
            name = _WHOLE[kind](fact)
        elif kind in _COUNTED:
            stem = _COUNTED[kind](fact)
            name = f"{stem}{counts[stem]}"
            counts[stem] += 1
        else:
            stem = _ENDS[kind](fact)
            name = f"{stem}{max(0, counts[stem] - 1)}"
        found[name] = (*found.get(name, ()), at)
    return found


def meant(pattern: str, names: Sequence[str] | Happenings) -> list[str]:
    """Return the names that a pattern with `*` means, in their order; the name alone where it has none."""
    if "*" not in pattern:
        return [pattern] if pattern in names else []
    plain = pattern.replace("[", "[[]").replace("?", "[?]")
    return [name for name in names if fnmatchcase(name, plain)]
