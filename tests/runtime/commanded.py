"""One run in which every command from outside is given that no simulated world gives: what only they emit is here."""

from fsar_ledger.events.envelope import Robot, Supervisor
from fsar_ledger.runtime.handlers.authority import GrantAuthority, RevokeAuthority
from fsar_ledger.runtime.handlers.candidates import Query
from fsar_ledger.runtime.handlers.commands import Command
from fsar_ledger.runtime.handlers.fleet import JoinFleet, LeaveFleet, RemoveCapability
from fsar_ledger.runtime.handlers.policy import SetPolicyRule, SetRolePolicyRule
from fsar_ledger.runtime.handlers.recovery import SetRecoveryBudget
from fsar_ledger.runtime.handlers.registry import (
    CacheRegistry,
    ConsultRegistry,
    DeprecateCapability,
    WithdrawCapability,
)
from fsar_ledger.runtime.handlers.request import AnswerOffer, RequestCapability
from fsar_ledger.runtime.handlers.supervision import SetSupervisionDensity
from fsar_ledger.runtime.handlers.task import SubmitTask
from fsar_ledger.runtime.handlers.trust import SetTrust, SetTrustThresholds
from fsar_ledger.runtime.kernel import Kernel
from tests import past
from tests.runtime.live import played

A, B, C, D = Robot("robot/A1"), Robot("robot/B1"), Robot("robot/C1"), Robot("robot/D1")

DOOR, H_F, S = "door.open.secure", Supervisor("supervisor/fleet"), 1_000_000
COMMANDS: list[tuple[int, Command]] = [
    (1 * S, JoinFleet(A, "A", 1)),  # a member already
    (1 * S, JoinFleet(Robot("robot/E1"), "E", 1)),
    (2 * S, CacheRegistry(A)),
    (3 * S, ConsultRegistry(Query(A, "grasp.*"), A)),
    (4 * S, SetTrustThresholds(H_F, 3, 2)),
    (5 * S, SetTrust(Supervisor("supervisor/B1"), B, D, "session", reason="worked well")),
    (6 * S, SetSupervisionDensity(H_F, B, 40, "quiet hour")),
    (7 * S, SetRecoveryBudget(Supervisor("supervisor/B1"), B, "local", 20 * S, 1)),
    (8 * S, GrantAuthority(H_F, D, B, "hard-preempt")),
    (9 * S, RequestCapability(A, B, DOOR, "visit", "q1")),
    (13 * S, RequestCapability(D, B, DOOR, "visit", "q2", "hard-preempt")),
    (40 * S, RequestCapability(A, B, "door.open.basic", "visit", "q3", "soft-priority")),  # more than is allowed
    (45 * S, AnswerOffer(A, "q3", True)),
    (60 * S, RevokeAuthority(H_F, A, B)),
    (61 * S, SetPolicyRule(H_F, "fleet", None, "carry.heavy", None, "allow")),
    (62 * S, SetPolicyRule(Supervisor("supervisor/D1"), "local", D, "carry.heavy", None, "deny")),
    (63 * S, RequestCapability(A, D, "carry.heavy", "visit", "q4")),  # mandated, and denied
    (64 * S, SetRolePolicyRule(H_F, "B", "review", capability=DOOR)),
    (70 * S, SubmitTask(C, "round", ("C navigate.indoor", "C inspect.visual"), 60 * S)),
    (80 * S, DeprecateCapability(C, "inspect.visual", "1.0.0")),
    (81 * S, WithdrawCapability(C, "inspect.visual", "cleaning")),
    (82 * S, RemoveCapability(C, "inspect.visual")),
    (90 * S, LeaveFleet(D)),
    (95 * S, JoinFleet(D, "D", 1, Supervisor("supervisor/D1"))),
]


def commanded() -> Kernel:
    """The finished run."""
    return played(COMMANDS, past.advertised(B, DOOR, override_allowed="hard-preempt"))
