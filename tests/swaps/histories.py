"""Runs that between them take every decision that the architectures know; a swap in a handler shows in one of them."""

from collections.abc import Callable, Iterator
from hashlib import sha256

import msgspec

from fsar_ledger.designs import Budget, Density, Policy, TrustByRecord
from fsar_ledger.designs.constants import Constants, Outages, Structure
from fsar_ledger.designs.registered import fleet
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import FULL, MECHANISMS_OF, without
from fsar_ledger.events.envelope import Robot, Scenario, Supervisor, Workflow, flat
from fsar_ledger.events.trust import RoleTrustSet
from fsar_ledger.events.world import ActuatorDegraded, RobotCameBack, RobotWentOff
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.handlers.authority import GrantAuthority, RevokeAuthority
from fsar_ledger.runtime.handlers.candidates import Query
from fsar_ledger.runtime.handlers.commands import Command
from fsar_ledger.runtime.handlers.fleet import InstallCapability, JoinFleet
from fsar_ledger.runtime.handlers.policy import SetPolicyRule, SetRolePolicyRule
from fsar_ledger.runtime.handlers.recovery import ReportFailure
from fsar_ledger.runtime.handlers.registry import (
    AdvertiseCapability,
    ConsultRegistry,
    DeprecateCapability,
    ReportAvailability,
    UpgradeCapability,
)
from fsar_ledger.runtime.handlers.request import RequestCapability
from fsar_ledger.runtime.handlers.task import SubmitTask
from fsar_ledger.runtime.handlers.trust import SetRoleTrust, SetTrust, SetTrustThresholds
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from fsar_ledger.runtime.world import founding
from tests.runtime.commanded import commanded
from tests.runtime.live import played

History = Callable[[], list[Event]]

SCENARIOS: tuple[Scenario | Workflow, ...] = (
    *("door-relay", "mixed-trust-inspection", "failure-recovery-chain", "fleet-contention"),
    *("collaborative-delivery", "workflow-layered-recovery", "workflow-human-supervision"),
)


A, B, C, D = (Robot(f"robot/{name}1") for name in "ABCD")
H_F, S, DOOR, LIFT = Supervisor("supervisor/fleet"), 1_000_000, "door.open.secure", "lift"
EVERYTHING: list[tuple[int, Command]] = [
    (1 * S, JoinFleet(Robot("robot/E1"), "E", 1, Supervisor("supervisor/E1"), "hall/cell", "floor/2")),
    (2 * S, InstallCapability(B, LIFT, "2.0.0", ("power",), ("up",), ("motor",))),
    (
        3 * S,
        AdvertiseCapability(
            B,
            LIFT,
            "2.0.0",
            ("power",),
            ("up",),
            ("motor",),
            policy_required=("day",),
            embodiment=("arm",),
            visible_to=("A",),
        ),
    ),
    (4 * S, ReportAvailability(B, LIFT, "busy", "tour")),
    (5 * S, UpgradeCapability(B, LIFT, "3.0.0", ("light",), ("high",), ("winch",))),
    (30 * S, GrantAuthority(H_F, A, B, "soft-priority", DOOR, "visit")),
    (31 * S, SetTrust(H_F, A, B, "session", DOOR, "visit", reason="known")),
    (32 * S, SetRoleTrust(H_F, "A", "D", "task", "", DOOR, "visit", reason="asked for")),
    (33 * S, SetPolicyRule(H_F, "fleet", D, DOOR, "visit", "review")),
    (34 * S, SetRolePolicyRule(H_F, "D", "allow", "", DOOR, "visit")),
    (35 * S, RequestCapability(A, B, DOOR, "visit", "q1", version="1.0.0")),
    (36 * S, ConsultRegistry(Query(A, "door.*"))),
    (37 * S, DeprecateCapability(B, DOOR, "1.0.0", "2.0.0")),
    (38 * S, SetTrust(H_F, B, A, "none", DOOR, "visit", reason="failure")),
    *((time * S // 2, ReportFailure(B, "q1", "obstruction")) for time in range(75, 96)),
    (50 * S, RevokeAuthority(H_F, A, B, "door.open.basic", "visit")),
]
"""Commands with another value in every field."""

TRUSTING: list[tuple[int, Command]] = [
    (1 * S, SetTrustThresholds(H_F, 1, 1)),
    (2 * S, SetTrust(H_F, A, D, "task", "carry.heavy", "round", reason="for now")),
    (3 * S, JoinFleet(Robot("robot/E1"), "E", 1, Supervisor("supervisor/E1"), "hall")),
    (4 * S, SetRoleTrust(H_F, "E", "E", "task", "hall", "carry.heavy", "round", reason="for now")),
    (5 * S, SetRoleTrust(H_F, "A", "C", "task", "", "inspect.visual", "round", reason="for now")),
    (6 * S, SetTrust(H_F, B, A, "capability", DOOR, "visit", reason="at first")),
    (6 * S, GrantAuthority(H_F, A, B, "soft-priority", DOOR, "round")),
    (7 * S, RequestCapability(A, B, DOOR, "visit", "q1")),
    (20 * S, SubmitTask(C, "round", ("C navigate.indoor", "C inspect.visual"), 60 * S)),
]
"""Trust follows the record, and ends with the task that it was given for."""


SILENT: list[tuple[int, Command]] = [
    (1 * S, ReportAvailability(B, "door.open.basic", "restricted", "inspection")),
    (10 * S, RequestCapability(A, B, DOOR, "visit", "q1")),
    (130 * S, RequestCapability(A, B, DOOR, "visit", "q2")),
]
OUTAGE: tuple[tuple[int, Event], ...] = (
    (5 * S, RobotWentOff(B)),
    (90 * S, RobotCameBack(B)),
    (120 * S, ActuatorDegraded(B, "lost")),
)
"""A robot is not as available in one capability as in another: it is off, it is back, its actuator wears."""


DESIGNED = msgspec.structs.replace(
    fleet(),
    trust_by_record=TrustByRecord(promote_after=2, downgrade_after=3),
    policies=(Policy("B", "review", "fleet", DOOR, "hall"),),
    density=(Density(4, "C"),),
    budgets=(Budget("local", 30.0, 2, "D"),),
)
"""A fleet of another design than the paper's, with a value in every field that the founding records."""


def _simulated(spec: RunSpec, constants: Constants) -> History:
    return lambda: list(simulate_run(spec, constants).events)


def histories() -> Iterator[History]:
    """Yield each run, those that show most first."""
    yield lambda: list(commanded().events)
    founded = RoleTrustSet(role="B", peer_role="A", scope="task", domain="", capability=DOOR)
    yield lambda: played(EVERYTHING, founded).events
    yield lambda: played(TRUSTING).events
    yield lambda: played(SILENT, facts=OUTAGE).events
    yield lambda: [Experiment(("fsar",), ("door-relay",), runs=1, seed=2, fleet_size=8).plan()]
    yield lambda: list(founding(8, fleet=DESIGNED))
    plain, silent = Constants(), Constants(outages=Outages(off_rate_per_s=0.01, link_rate_per_s=0.02))
    for run in range(2):
        for scenario in SCENARIOS:
            for architecture in MECHANISMS_OF:
                yield _simulated(RunSpec(42, architecture, FULL, scenario, 8, run), plain)
    for architecture, mechanisms in MECHANISMS_OF.items():
        for mechanism in mechanisms:
            for scenario in SCENARIOS[1:4]:
                yield _simulated(RunSpec(42, architecture, without([mechanism]), scenario, 4, 0), plain)
    for scenario in SCENARIOS[:5]:
        for architecture in MECHANISMS_OF:
            yield _simulated(RunSpec(43, architecture, FULL, scenario, 8, 0), silent)
    often = Constants(structure=msgspec.structs.replace(Structure(), local_attempts=3))
    for run in range(3):
        for configuration in (FULL, "without-central-recovery"):
            yield _simulated(RunSpec(42, "cfc", configuration, "failure-recovery-chain", 8, run), often)


def digest() -> str:
    """Return the SHA-256, in hex, of all that the runs record; a new field without a value does not change it."""
    found = sha256()
    for history in histories():
        for event in history():
            recorded = {name: value for name, value in flat(event).items() if value is not None}
            found.update(msgspec.json.encode([type(event).__name__, recorded]))
    return found.hexdigest()
