"""What the sources of the published systems leave open, each with a value from its range.

They were chosen before any run of these architectures was counted, and nothing is fitted. A dial that a source gives
says so; a range is what the sources allow. Paper: tab:baseline_context.
"""

from typing import Annotated, TypeVar

import msgspec

_T = TypeVar("_T")
Dial = Annotated[_T, msgspec.Meta(extra={"from": "dial"})]


class Jade(msgspec.Struct, frozen=True):
    """JADE: a FIPA contract net with yellow pages. Units: microseconds unless the name says otherwise."""

    # No reply-by waits for ever (ContractNetInitiator, deadline -1); every architecture here waits 5 s for an answer.
    reply_by_us: Dial[int] = 5_000_000  # 0: none; 1 s to 30 s
    # The protocol has no recovery of a task; iterated rounds are FIPA's (SC00030H), and their number is the user's.
    rounds: Dial[int] = 3  # calls for proposals until the step is tried anew; 1 to 10
    subscribes: Dial[int] = 0  # 1: robots subscribe to the yellow pages; 0: they search them for every step (DFService)
    lease_us: Dial[int] = 0  # of an entry in the yellow pages; 0: for ever, the default (jade_domain_df_maxleasetime)
    dead_after_us: Dial[int] = 10_000_000  # a silent agent is removed (UDPNodeMonitoringService); 3 s to 10 s
    owner_is_named: Dial[int] = 1  # 1: AMSAgentDescription.ownership names the robot's supervisor; 0: nobody
    # JADE-S grants the right to send to an agent by a policy file; its author can only write down whom the fleet says
    # that a robot trusts. A grant by team would let every outsider of the scenarios in, who is of the team.
    permissions: Dial[int] = 0  # 1: with the add-on JADE-S, who is trusted may send a call; 0: whoever asks


class Alliance(msgspec.Struct, frozen=True):
    """ALLIANCE: motivational behaviours. Units: microseconds."""

    # A robot starts when its motivation has grown to the threshold: threshold / fast rate. The third-party values
    # (150 / 5 and 200 / 10 at 2 Hz) come to 15 s and 10 s for tasks of 100 s and 200 s; ours take a tenth of that.
    impatience_us: Dial[int] = 1_000_000  # 0.1 s to 15 s
    # Rates are of single robots and tasks; which robot is the faster is the designer's choice (the third-party values
    # of two behaviours are 15 s and 10 s). With equal ones teammates that sense a need together all start.
    stagger_us: Dial[int] = 0  # 0: equal rates; else how much longer than those of the team before a team's robots take
    # While a teammate is heard to work on it, motivation grows at the slow rate, until it has taken this long.
    patience_us: Dial[int] = 11_000_000  # 1.1 times the expected 10 s; 5 s to 30 s
    broadcast_us: Dial[int] = 2_000_000  # 0.5 Hz; 0.2 s if it were scaled as the delays are
    silence_us: Dial[int] = 10_000_000  # a teammate not heard for this long is taken to be idle; 1 s if it were scaled
    yield_us: Dial[int] = 7_500_000  # 0.75 times the expected 10 s, or once: then another that broadcasts may have it
    give_up_us: Dial[int] = 11_000_000  # 1.1 times the expected 10 s
    senses_policy: Dial[int] = 1  # 1: its own policy is sensory feedback: no motivation while it denies; 0: not sensed
    learns: Dial[int] = 0  # 1: L-ALLIANCE, patience follows the times that teammates have taken; 0: fixed


class Roboos(msgspec.Struct, frozen=True):
    """RoboOS: one master and a shared store. Units: microseconds unless the name says otherwise."""

    planning_us: Dial[int] = 242_000  # the master plans one task: CFC's time for an item; a curve to 10 s
    planning_retries: Dial[int] = 5  # of a task without a plan, which is then ignored (MODEL_RETRY_PLANNING)
    expiry_us: Dial[int] = 60_000_000  # of a robot's entry in the store (slaver/run.py, _heartbeat_loop)
    refresh_us: Dial[int] = 30_000_000  # and how often it is refreshed
    max_steps: Dial[int] = 20  # calls of tools in one subtask (slaver_agent.py, max_steps); 1: no second try
    # Whose checklist has manual help (error_definitions.py: that of an obstruction alone, E101).
    manual_help: Dial[int] = 1  # 1: as in the source; 2: every checklist ends with it; 0: none has it
    # No error of the source is a worn actuator. 302, an object drops: grasp again, no more; 303, as inherited from
    # vision: near position, another idle robot, the brain.
    worn_error: Dial[int] = 302  # 302 or 303
    # With a gate a refusal is a failed result, which gives up the task (ours: nobody in the source repeats a subtask).
    gate: Dial[int] = 0  # 1: a robot refuses what its own policy denies; 0: it does what it is told


TRIED: dict[str, tuple[int, ...]] = {
    "roboos.planning_us": (242_000, 1_000_000, 3_000_000, 10_000_000),
    "roboos.max_steps": (1, 20),
    "roboos.manual_help": (0, 1, 2),
    "roboos.worn_error": (302, 303),
    "roboos.gate": (0, 1),
    "jade.reply_by_us": (0, 1_000_000, 5_000_000, 30_000_000),
    "jade.rounds": (1, 3, 10),
    "jade.subscribes": (0, 1),
    "jade.owner_is_named": (0, 1),
    "jade.permissions": (0, 1),
    "alliance.impatience_us": (100_000, 300_000, 1_000_000, 3_000_000, 15_000_000),
    "alliance.stagger_us": (0, 300_000, 1_000_000),
    "alliance.patience_us": (5_000_000, 11_000_000, 30_000_000),
    "alliance.yield_us": (7_500_000, 10_000_000),
    "alliance.broadcast_us": (200_000, 2_000_000),
    "alliance.silence_us": (1_000_000, 10_000_000),
    "alliance.senses_policy": (0, 1),
    "alliance.learns": (0, 1),
}
"""Which values of a dial `study run systems` tries: the ends of what its source allows, and some between.

A dial that only acts between robots of one role is tried at every fleet size, since four robots have four roles.
Left out are those that a source gives as one number, and those that matter in outages alone.
"""
