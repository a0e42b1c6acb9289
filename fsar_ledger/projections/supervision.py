"""What supervisors were asked, what they have approved, and how often they want to be asked. Paper: eq:supervision."""

from typing import assert_never

import msgspec

from fsar_ledger.events.request import RequestAdmitted
from fsar_ledger.events.supervision import Purpose, SupervisionDensitySet, SupervisorCalled, SupervisorResponded

HANDLES = SupervisorCalled | SupervisorResponded | SupervisionDensitySet | RequestAdmitted

Call = tuple[str, Purpose]  # action, what is asked about it


class Supervision(msgspec.Struct, frozen=True, gc=False):
    """What stands between robots and their supervisors.

    `approved`: actions whose review was approved; `calls`: the calls that are open, in order;
    `review_every`: robot (None: every one) -> density; `admissions`: executor -> requests it has admitted.
    """

    approved: frozenset[str] = frozenset()
    calls: dict[Call, SupervisorCalled] = {}
    review_every: dict[str | None, int] = {}
    admissions: dict[str, int] = {}


INITIAL = Supervision()


def density(state: Supervision, robot: str) -> int:
    """One in so many admissions of the robot is put before a supervisor; its own density before every robot's; 0 is none."""
    return state.review_every.get(robot, state.review_every.get(None, 0))


def evolve(state: Supervision, event: HANDLES) -> Supervision:
    """Supervision after the event."""
    match event:
        case RequestAdmitted():
            if event.executed_by is None:
                return state
            count = state.admissions.get(event.executed_by, 0) + 1
            return Supervision(state.approved, state.calls, state.review_every, {**state.admissions, event.executed_by: count})
        case SupervisorCalled():
            calls = {**state.calls, (event.action_id, event.purpose): event}
            return Supervision(state.approved, calls, state.review_every, state.admissions)
        case SupervisorResponded():
            answered = (event.action_id, event.purpose)
            approved = state.approved | {event.action_id} if event.purpose == "review" and event.approves else state.approved
            calls = {name: call for name, call in state.calls.items() if name != answered}
            return Supervision(approved, calls, state.review_every, state.admissions)
        case SupervisionDensitySet():
            return Supervision(state.approved, state.calls, {**state.review_every, event.robot: event.review_every}, state.admissions)
        case _:
            assert_never(event)
