"""The state of a run, folded from its events: this module routes each event to the projections that handle it.

`ROUTES[type]` names the slices that declare the event's type in their `HANDLES`; the `evolve` of each returns its next
value. Types that no projection handles are records for audit, from which nothing follows inside the run.
"""

from collections.abc import Callable, Iterable
from typing import Any, get_args

from fsar_ledger.events import EVENT_TYPES, Event

from . import (
    authority,
    budget,
    contention,
    context,
    execution,
    fleet,
    knowledge,
    motivation,
    policy,
    recovery,
    registry,
    request,
    supervision,
    task,
    trust,
    world,
)

_PROJECTIONS = (
    authority,
    budget,
    contention,
    context,
    execution,
    fleet,
    knowledge,
    motivation,
    policy,
    recovery,
    registry,
    request,
    supervision,
    task,
    trust,
    world,
)


class State:
    """All projections of one run, each in a slot of its name. `apply` replaces them; the values never change."""

    __slots__ = tuple(projection.__name__.rpartition(".")[2] for projection in _PROJECTIONS)

    def __init__(self) -> None:
        self.authority = authority.INITIAL
        self.budget = budget.INITIAL
        self.contention = contention.INITIAL
        self.context = context.INITIAL
        self.execution = execution.INITIAL
        self.fleet = fleet.INITIAL
        self.knowledge = knowledge.INITIAL
        self.motivation = motivation.INITIAL
        self.policy = policy.INITIAL
        self.recovery = recovery.INITIAL
        self.registry = registry.INITIAL
        self.request = request.INITIAL
        self.supervision = supervision.INITIAL
        self.task = task.INITIAL
        self.trust = trust.INITIAL
        self.world = world.INITIAL

    def __eq__(self, other: object) -> bool:
        return isinstance(other, State) and all(getattr(self, slot) == getattr(other, slot) for slot in self.__slots__)

    __hash__ = None  # type: ignore[assignment]

    def copy(self) -> "State":
        """Return a state of its own with the same values."""
        other = State.__new__(State)
        for slot in self.__slots__:
            setattr(other, slot, getattr(self, slot))
        return other


_Evolve = Callable[[Any, Any], Any]


def _routes() -> dict[type[Event], tuple[tuple[str, _Evolve], ...]]:
    routes: dict[type[Event], tuple[tuple[str, _Evolve], ...]] = {}
    for projection in _PROJECTIONS:
        slot = projection.__name__.rpartition(".")[2]
        for event_type in get_args(projection.HANDLES) or (projection.HANDLES,):
            routes[event_type] = (*routes.get(event_type, ()), (slot, projection.evolve))
    return routes


ROUTES = _routes()
STATELESS = frozenset(EVENT_TYPES) - ROUTES.keys()


def apply(state: State, event: Event) -> None:
    """Apply the event to the state."""
    for slot, evolve in ROUTES.get(type(event), ()):
        setattr(state, slot, evolve(getattr(state, slot), event))


def fold(events: Iterable[Event]) -> State:
    """Return the state after these events."""
    state = State()
    for event in events:
        apply(state, event)
    return state
