"""The state of a run, folded from its events: this module routes each event to the projections that handle it.

`ROUTES[type]` names the slices that declare the event's type in their `HANDLES`; the `evolve` of each returns its next
value. Types that no projection handles are records for audit, from which nothing follows inside the run.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, get_args

from msgspec.structs import replace

from fsar_ledger.events import Event
from fsar_ledger.events.request import OfferAnswered, RequestClosed, RequestDenied, RequestUnanswered
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted

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
    put,
    recovery,
    registry,
    request,
    supervision,
    task,
    trust,
    without,
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


SLOTS: Mapping[str, Any] = {
    module.__name__.rpartition(".")[2]: module.__annotations__.get("INITIAL", type(module.INITIAL))
    for module in _PROJECTIONS
}
"""The slots of a state, and the type of each."""


class State:
    """All projections of one run, each in a slot of its name. `apply` replaces them; the values never change."""

    __slots__ = tuple(SLOTS)

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
        """Return another state with the same values."""
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


def apply(state: State, event: Event) -> None:
    """Apply the event to the state."""
    for slot, evolve in ROUTES.get(type(event), ()):
        setattr(state, slot, evolve(getattr(state, slot), event))
    if type(event) in ENDS:
        forget(state, event)


def fold(events: Iterable[Event]) -> State:
    """Return the state after these events."""
    state = State()
    for event in events:
        apply(state, event)
    return state


ENDS: frozenset[type[Event]] = frozenset(
    {TaskCompleted, TaskAbandoned, RequestClosed, RequestDenied, RequestUnanswered, OfferAnswered}
)
"""Events of these types may end something that a live run can forget."""
LATE, NAMES = 1 << 10, 1 << 16
"""What a live run keeps of the past: all about the last `LATE` tasks at least, and the last `NAMES` names."""
_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


# See docs/decisions/live-runs-forget.md.
def forget(state: State, event: Event) -> bool:
    """Forget what ended long ago, if that is due in this run; return whether it was.

    It is due in a live run after each 1,024 tasks, and when there are too many requests.
    """
    if not state.fleet.is_live:
        return False
    is_due = isinstance(event, TaskCompleted | TaskAbandoned) and len(state.context) % LATE == 0
    if not is_due and len(state.request.open) < state.request.most:
        return False
    names = [*state.context]
    recent = {*names[-LATE:]}
    _forget_requests(state, recent)
    _forget_actions(state, recent)
    _forget_questions(state)
    _forget_contexts(state, set(names) - recent)
    state.context = _but(state.context, names[:-NAMES])
    return True


def _forget_requests(state: State, recent: set[str]) -> None:
    """Forget the requests of tasks that are over, and all but the last ad hoc requests that are over."""
    requests, open_ = state.request, state.request.open
    idle = {name: item for name, item in open_.items() if not _is_at_a_robot(state, name)}
    adhoc = [item for item in idle.values() if item.is_adhoc and (item.is_over or item.is_unanswered)][: -LATE // 2]
    steps = [item for item in idle.values() if not item.is_adhoc and _is_past(state, item.task_id, recent)]
    past = requests.past
    for item in (*steps, *adhoc):
        requests = request.removed(requests, item.action_id)
    for item in adhoc:
        task_id, _, step = item.action_id.partition("/")
        for name in (item.action_id, f"{item.task_id}/", *([f"{task_id}/"] if step else [])):
            past = put(without(past, name), name, True)
    past = _but(past, [*past][:-NAMES])
    state.request = replace(requests, past=past, most=max(request.MOST, 2 * len(requests.open)))


def _is_at_a_robot(state: State, action_id: str) -> bool:
    """Return whether a robot has the action, or its failure is being recovered."""
    action = state.execution.actions.get(action_id)
    return action_id in state.recovery or (action is not None and action.stage != "withdrawn")


def _is_past(state: State, task_id: str, recent: set[str]) -> bool:
    return task_id not in state.task and task_id not in recent


def _forget_actions(state: State, recent: set[str]) -> None:
    """Forget the actions of such tasks that no robot has, and recoveries of actions that no robot executes."""
    for name, action in tuple(state.execution.actions.items()):
        is_asked_for = name in state.request.open or _is_at_a_robot(state, name)
        if not is_asked_for and _is_past(state, action.task_id, recent):
            state.execution = execution.forget_action(state.execution, name)
    state.recovery = _but(state.recovery, [name for name in state.recovery if name not in state.execution.actions])


def _forget_questions(state: State) -> None:
    """Forget the calls, approvals, orders and requesters of requests and actions that are gone."""
    requests, actions, asked, order = state.request.open, state.execution.actions, state.supervision, state.contention
    claims = state.authority
    calls = [
        number
        for number, call in asked.calls.items()
        if call.subject.action_id not in requests and call.subject.action_id not in actions
    ]
    approved = frozenset(name for name in asked.approved if name in requests or name in actions)
    state.supervision = replace(asked, approved=approved, calls=_but(asked.calls, calls))
    approvals = _but(claims.approvals, [key for key in claims.approvals if key not in requests and key not in actions])
    changes = authority.since(claims.changes, min(approvals.values(), default=None))
    state.authority = authority.Authority(claims.claims, claims.rights, approvals, changes)
    state.contention = replace(
        order,
        orders=_but(order.orders, [pair for pair in order.orders if not any(name in requests for name in pair)]),
        arrived=frozenset(name for name in order.arrived if name in requests),
    )
    state.trust = replace(
        state.trust, asked=_but(state.trust.asked, [name for name in state.trust.asked if name not in requests])
    )


def _forget_contexts(state: State, gone: set[str]) -> None:
    """Forget the rights, rules and trust of these contexts alone."""
    current, claims, rules = state.trust, state.authority, state.policy
    rights = tuple(right for right in claims.rights if right.context not in gone)
    state.authority = authority.Authority(claims.claims, rights, claims.approvals, claims.changes)
    state.policy = policy.Policy(
        _but(rules.rules, [rule for rule in rules.rules if rule[-1] in gone]),
        _but(rules.of_roles, [rule for rule in rules.of_roles if rule[-1] in gone]),
        rules.members,
    )
    if current.contexts & gone:
        state.trust = replace(
            current,
            contexts=current.contexts - gone,
            entries=_outside(current.entries, gone),
            of_roles={**_outside(current.of_roles, gone)},
            records=_but(current.records, [key for key in current.records if key[-1] in gone]),
        )


def _outside(entries: Mapping[_Key, trust.Entries], gone: set[str]) -> Mapping[_Key, trust.Entries]:
    """Return the entries of trust that are not for one of these contexts alone."""
    for key, about in tuple(entries.items()):
        left = {pair: scope for pair, scope in about.items() if pair[1] not in gone}
        if len(left) < len(about):
            entries = put(entries, key, left) if left else without(entries, key)
    return entries


def _but(entries: Mapping[_Key, _Value], keys: Iterable[_Key]) -> Mapping[_Key, _Value]:
    """Return the mapping without these keys."""
    for key in keys:
        entries = without(entries, key)
    return entries
