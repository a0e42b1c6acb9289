"""Supervision: what supervisors are asked, what they approved, and how often they review. Paper: eq:supervision."""

from collections.abc import Mapping
from typing import assert_never

import msgspec
from msgspec.structs import replace

from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.request import RequestAdmitted
from fsar_ledger.events.supervision import Purpose, SupervisionDensitySet, SupervisorCalled, SupervisorResponded

from . import put, without

HANDLES = SupervisorCalled | SupervisorResponded | SupervisionDensitySet | RequestAdmitted | FailureResolved


class Supervision(msgspec.Struct, frozen=True, gc=False):
    """What is open between robots and their supervisors.

    `approved`: actions whose review was approved; `calls`: number of the call (from 1, within the run) -> the call,
    while open; `review_every`: robot (None: every one) -> density; `admissions`: executor -> number of requests it has
    admitted; `called`: number of calls so far.
    """

    approved: frozenset[str] = frozenset()
    calls: Mapping[int, SupervisorCalled] = {}
    review_every: Mapping[Robot | None, int] = {}
    admissions: Mapping[Robot, int] = {}
    called: int = 0


INITIAL = Supervision()


def density(state: Supervision, robot: Robot) -> int:
    """Return n, where every n-th admission by the robot is submitted to a supervisor; 0 is none.

    A density of the robot's own takes precedence over the one for every robot.
    """
    return state.review_every.get(robot, state.review_every.get(None, 0))


def is_asked(state: Supervision, action_id: str, purpose: Purpose) -> bool:
    """Return whether a call for this purpose is open for the action."""
    return any((call.subject.action_id, call.purpose) == (action_id, purpose) for call in state.calls.values())


def evolve(state: Supervision, event: HANDLES) -> Supervision:
    """Return supervision after the event."""
    match event:
        case RequestAdmitted():
            if event.principals.executed_by is None:
                return state
            count = state.admissions.get(event.principals.executed_by, 0) + 1
            return replace(state, admissions=put(state.admissions, event.principals.executed_by, count))
        case SupervisorCalled():
            number = state.called + 1
            return replace(state, calls=put(state.calls, number, event), called=number)
        case SupervisorResponded():
            approved = (
                state.approved | {event.subject.action_id}
                if event.purpose == "review" and event.approves
                else state.approved
            )
            calls = _without(state.calls, event.subject.action_id, event.purpose)
            return replace(state, approved=approved, calls=calls)
        case FailureResolved():
            return replace(state, calls=_without(state.calls, event.subject.action_id, "recovery"))
        case SupervisionDensitySet():
            return replace(state, review_every=put(state.review_every, event.robot, event.review_every))
        case _:
            assert_never(event)


def _without(calls: Mapping[int, SupervisorCalled], action_id: str, purpose: str) -> Mapping[int, SupervisorCalled]:
    """Return the calls that stay open once this one is answered.

    The first supervisor's answer counts for all who were asked the same.
    """
    for number, call in calls.items():
        if (call.subject.action_id, call.purpose) == (action_id, purpose):
            calls = without(calls, number)
    return calls
