"""DHMA: only the hand-off of delegated work at its executor leaves records; every hop between agents takes time."""

import re
from collections import Counter
from collections.abc import Iterator
from functools import cache

from fsar_ledger.designs.constants import Constants, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Agent, agent, flat, robot_of
from fsar_ledger.events.request import InternalHandoff, RequestAccepted
from fsar_ledger.events.task import StepBegan
from fsar_ledger.runtime.architectures.dhma import agents
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Ask
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, kernel
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, run_key
from tests.sure import known

HOP = re.compile(r"(.*)/hop(\D*)(\d*)$")
HANDED_OVER = {
    "planning": agents.TO_PLANNING,
    "acknowledged": agents.FROM_PLANNING,
    "execution": agents.TO_EXECUTION,
    "confirmed": agents.FROM_EXECUTION,
}
UNRECORDED = {
    "": agents.CALL,
    "evaluate": agents.EVALUATION,
    "relay": agents.RELAY,
    "settle": agents.SETTLEMENT,
    "void": agents.VOIDING,
    "again": agents.RELAY,
    "told": agents.RECOVERY,
    "report": agents.RECOVERY,
    "other": agents.RENEGOTIATION,
    "query": agents.CALL,
    "own": agents.OWN_STEP,
    "own replan": agents.REPLANNING,
    "result": agents.RESULT,
    "own result": agents.OWN_RESULT,
    "handed": agents.CALL,
    "taken": agents.RELAY,
}
PHASES = HANDED_OVER | UNRECORDED  # by the names of the hops
SPECS = [
    RunSpec(seed, "dhma", "full", scenario, 4, run) for scenario in SCENARIOS for seed in (3, 4) for run in range(3)
]


class Heard(Draws):
    """The world's draws, and which internal messages were among them."""

    def __init__(self, spec: RunSpec) -> None:
        super().__init__(run_key(spec.seed, spec.scenario, spec.run), WorldConstants())
        self.hops: set[str] = set()

    def answer(self, ask: Ask) -> int:
        if ask.what == "message" and HOP.search(ask.key):
            self.hops.add(ask.key)
        return super().answer(ask)


@cache
def played(spec: RunSpec) -> tuple[Kernel, set[str]]:
    """A whole run and the internal hops that were drawn in it."""
    one, heard = kernel(spec, Constants()), Heard(spec)
    one._answer = SimulatedEnvironment((), heard).answer
    one.run()
    return one, heard.hops


def handoffs(events: list[Event]) -> list[InternalHandoff]:
    return [event for event in events if isinstance(event, InternalHandoff)]


def kinds(event: InternalHandoff) -> tuple[str, str]:
    return event.sender.rpartition("/")[2], event.receiver.rpartition("/")[2]


def drawn(events: list[Event], hops: set[str]) -> Iterator[tuple[str, tuple[str, str]]]:
    """Each hop that was drawn: its phase, and which agent talks to which in it."""
    own = {event.subject.action_id for event in events if isinstance(event, StepBegan) and event.target_role is None}
    for key in hops:
        match = known(HOP.match(key))
        served, name, ordinal = match.groups()
        phase = (
            f"own {name}"
            if name == "result" and served in own
            else "own replan"
            if name == "own" and "/replan" in served
            else name
        )
        place = 0 if len(PHASES[phase]) == 2 else int(ordinal)
        yield phase, (PHASES[phase][place], PHASES[phase][place + 1])


def test_a_hop_is_on_record_when_the_executor_passes_delegated_work_on_or_acknowledges_it_and_in_no_other_phase() -> (
    None
):
    met = set[str]()
    for spec in SPECS:
        one, hops = played(spec)
        told = [*drawn(one.events, hops)]
        met |= {phase for phase, _ in told}
        assert Counter(map(kinds, handoffs(one.events))) == Counter(
            between for phase, between in told if phase in HANDED_OVER
        )
    assert met == PHASES.keys()


def test_an_award_that_holds_leaves_the_four_records_of_case_4() -> None:
    """Communication to planning, planning to execution, and back; an award that was voided meanwhile leaves fewer."""
    way = [("communication", "planning"), ("planning", "execution"), ("execution", "planning")]
    way.append(("planning", "communication"))
    for spec in SPECS:
        one, _ = played(spec)
        passed = Counter(
            robot_of(Agent(event.claimant))
            for event in one.events
            if isinstance(event, AuthorityClaimed) and event.dimension == event.reason == "execution"
        )
        for robot, times in passed.items():
            found = Counter(kinds(event) for event in handoffs(one.events) if event.principals.executed_by == robot)
            assert found >= Counter(dict.fromkeys(way, times))


def test_who_is_on_a_path_took_part_in_a_talk_that_was_held() -> None:
    """A path of several agents is that of a talk, and no more decisions have it than there were such talks."""
    for spec in SPECS:
        one, hops = played(spec)
        paths = [flat(event).get("path") or () for event in one.events]
        decided = Counter(tuple(name.rpartition("/")[2] for name in path) for path in paths if len(path) > 1)
        first_hops = Counter(between for _, between in drawn(one.events, hops))
        assert decided.keys() <= {*PHASES.values()}
        for talk, times in decided.items():
            assert times <= first_hops[talk[0], talk[1]]


def test_whoever_accepts_an_award_is_the_only_agent_that_has_heard_of_it() -> None:
    accepted = [event for spec in SPECS for event in played(spec)[0].events if isinstance(event, RequestAccepted)]
    assert accepted
    for event in accepted:
        assert event.principals.path == (agent(known(event.principals.executed_by), "communication"),)


def test_a_handoff_names_no_origin_and_stays_in_one_robot() -> None:
    for spec in SPECS:
        for event in handoffs(played(spec)[0].events):
            assert event.principals.requested_by is None
            assert event.principals.executed_by is not None
            assert {name.rpartition("/")[0] for name in (event.sender, event.receiver)} == {
                agent(event.principals.executed_by, "planning").rpartition("/")[0]
            }
