"""What supervisors were asked, what they have approved, and how often they want to be asked. Paper: eq:supervision."""

from typing import assert_never

import msgspec

from fsar_ledger.events.supervision import SupervisionDensitySet, SupervisorCalled, SupervisorResponded

HANDLES = SupervisorCalled | SupervisorResponded | SupervisionDensitySet


class Supervision(msgspec.Struct, frozen=True, gc=False):
    """`approved`: actions whose review was approved; `calls`: action -> the call that is open; `review_every`: robot (None: all) -> density."""

    approved: frozenset[str] = frozenset()
    calls: dict[str, SupervisorCalled] = {}
    review_every: dict[str | None, int] = {}


INITIAL = Supervision()


def evolve(state: Supervision, event: HANDLES) -> Supervision:
    """Supervision after the event."""
    match event:
        case SupervisorCalled():
            return Supervision(state.approved, {**state.calls, event.action_id: event}, state.review_every)
        case SupervisorResponded():
            approved = state.approved | {event.action_id} if event.purpose == "review" and event.approves else state.approved
            return Supervision(approved, {name: call for name, call in state.calls.items() if name != event.action_id}, state.review_every)
        case SupervisionDensitySet():
            return Supervision(state.approved, state.calls, {**state.review_every, event.robot: event.review_every})
        case _:
            assert_never(event)
