"""DHMA: talks between the agents of a robot, with their duration, their record and their path in one definition.

A talk is the row of agents through which the work goes. Each hop in it takes the latency of an internal message and
leaves one record, in every phase; what is decided at its end has these agents as its path. Paper:
sec:evaluation:baselines. Reading: R21.
"""

from functools import lru_cache
from itertools import pairwise

from fsar_ledger.events.envelope import Agent, AgentKind, Robot, agent
from fsar_ledger.events.request import InternalHandoff
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.handlers.actors import named
from fsar_ledger.runtime.handlers.attribution import recorded_by
from fsar_ledger.runtime.handlers.commands import Actors, Command, Decides, Reacts, Scheduled, hop, hops
from fsar_ledger.runtime.ports import Ask

Talk = tuple[AgentKind, ...]
Said = tuple[tuple[Ask, ...], Scheduled]

CALL: Talk = ("planning", "communication")  # the planner wants another robot asked
EVALUATION: Talk = (
    "communication",
    "planning",
    "execution",
)  # a call comes in, is judged, and the means for it are confirmed
RELAY: Talk = ("communication", "planning")  # word from another robot reaches the planner
TO_PLANNING: Talk = ("communication", "planning")  # an award goes from agent to agent ...
TO_EXECUTION: Talk = ("planning", "execution")
FROM_PLANNING: Talk = ("planning", "communication")  # ... and each acknowledges it
FROM_EXECUTION: Talk = ("execution", "planning")
SETTLEMENT: Talk = ("communication", "planning", "execution", "communication")  # what a double booking comes to
VOIDING: Talk = ("execution", "communication", "planning", "communication")  # a contract that no longer holds
OWN_STEP: Talk = ("planning", "execution")
OWN_RESULT: Talk = ("execution", "planning")
RESULT: Talk = ("execution", "communication")
RECOVERY: Talk = (
    "execution",
    "recovery",
    "planning",
    "recovery",
)  # a failure, or how an attempt ended: recovery hears of it and asks the planner
REPLANNING: Talk = ("execution", "planning", "execution", "planning")  # the change, the new plan, its confirmation
RENEGOTIATION: Talk = (
    "communication",
    "planning",
    "communication",
    "planning",
    "communication",
)  # the other robot agrees to it


class HandOver(Command):
    """Record a talk between the agents of a robot."""

    robot: Robot
    agents: Talk


def hand_over(state: State, command: HandOver) -> tuple[InternalHandoff, ...]:
    """Record each hop, without a requester: no message between agents names one."""
    names = path(command.robot, command.agents)
    parties = recorded_by(state.fleet, state.world, command.robot, requested_by=None, executed_by=command.robot)
    # See docs/decisions/dhma-hops-are-records.md.
    return tuple([InternalHandoff(parties, sender, receiver) for sender, receiver in pairwise(names)])


def talk(
    fleet: Fleet,
    robot: Robot,
    agents: Talk,
    key: str,
    name: int | str,
    before: tuple[Ask, ...] = (),
    after_us: int = 0,
) -> Said:
    """Return how long these agents talk, and schedule the record of it.

    The talk begins after what comes `before` it, and after `after_us`.
    """
    said = (hop(fleet, key, name),) if len(agents) == 2 else hops(fleet, key, str(name), len(agents) - 1)
    lengths = (*before, *said)
    return lengths, Scheduled(HandOver(robot, agents), after_us, lengths)


@lru_cache(1 << 15)  # a talk of every robot of a large fleet: most of its events are hops
def path(robot: Robot, agents: Talk) -> tuple[Agent, ...]:
    """Return the path of a decision that went through these agents of the robot, decider last."""
    return tuple(agent(robot, kind) for kind in agents)


DECIDES: Decides = {HandOver: hand_over}
ACTORS: Actors = {HandOver: named}
REACTS: Reacts = {}
