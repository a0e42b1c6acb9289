"""The concerns that a run may observe, one word each.

An event type belongs to the concern that its file is named after, unless `BESIDE` says otherwise.
"""

from collections.abc import Mapping

# See docs/decisions/unobserved-is-null.md.
CONCERNS: tuple[str, ...] = (
    "fleet",  # robots and their membership
    "registry",  # capabilities, advertisements, availability, look-ups
    "trust",
    "policy",  # rules and windows, a robot's own and the fleet's
    "task",
    "request",  # requests between robots, from the gap to the end, and how they are decided
    "authority",  # claims, grants, revocations
    "execution",  # who does what, and routine
    "recovery",  # failures and what is done about them
    "supervision",  # supervisors: calls, answers, absences
    "knowledge",  # what a decider has been told
    "message",  # what the agents of one robot tell each other
    "command",  # commands from outside that were rejected
    "world",  # what happens to robots: obstructions, wear, outages, encounters, injected attempts
)
"""Every concern, in the order in which runs store them. Runs of our own handlers observe all of them."""

BESIDE: Mapping[str, str | None] = {
    "RunStarted": None,
    "ExperimentPlanned": None,
    "TaskArrived": "task",
    "PolicyWindowOpened": "policy",
    "PolicyWindowClosed": "policy",
    "SupervisorLeft": "supervision",
    "SupervisorReturned": "supervision",
    "ExecutionFailed": "recovery",
    "InternalHandoff": "message",
    "RoutineReported": "message",
}
"""The types, whatever their version, whose concern is not their file, and those of which every version is retired.

None: the type describes the run itself and belongs to no concern.
"""
