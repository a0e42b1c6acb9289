"""DHMA: each hop between agents of a robot leaves one record in every phase, and a decision's path is the way that its
talk went."""

import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from itertools import pairwise

import pytest

from fsar_ledger.designs.constants import Constants, WorldConstants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.events.request import InternalHandoff
from fsar_ledger.events.task import StepBegan
from fsar_ledger.runtime.architectures.dhma import agents
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Ask
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, kernel
from fsar_ledger.runtime.world.draws import Draws, SimulatedEnvironment, run_key
from tests.sure import known

HOP = re.compile(r"(.*)/hop(\D*)(\d*)$")
PHASES = {
    "": agents.CALL,
    "evaluate": agents.EVALUATION,
    "relay": agents.RELAY,
    "planning": agents.TO_PLANNING,
    "acknowledged": agents.FROM_PLANNING,
    "execution": agents.TO_EXECUTION,
    "confirmed": agents.FROM_EXECUTION,
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
}  # by the names of the hops
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


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: f"{spec.scenario}-{spec.seed}-{spec.run}")
def test_as_many_handoffs_are_on_record_as_hops_were_drawn(spec: RunSpec) -> None:
    one, hops = played(spec)
    assert len(handoffs(one.events)) == len(hops) > 0


def kinds(event: InternalHandoff) -> tuple[str, str]:
    return event.sender.rpartition("/")[2], event.receiver.rpartition("/")[2]


def drawn(events: list[Event], hops: set[str]) -> Iterator[tuple[str, str, str]]:
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
        yield phase, PHASES[phase][place], PHASES[phase][place + 1]


def test_in_every_phase_each_hop_is_on_record_between_the_agents_that_it_went_between() -> None:
    met = set[str]()
    for spec in SPECS:
        one, hops = played(spec)
        told = [*drawn(one.events, hops)]
        assert Counter(map(kinds, handoffs(one.events))) == Counter((sender, receiver) for _, sender, receiver in told)
        met |= {phase for phase, _, _ in told}
    assert met == PHASES.keys()


def test_a_handoff_names_no_origin_and_stays_in_one_robot() -> None:
    for spec in SPECS:
        for event in handoffs(played(spec)[0].events):
            assert event.principals.requested_by is None
            assert event.principals.executed_by is not None
            assert {name.rpartition("/")[0] for name in (event.sender, event.receiver)} == {
                event.principals.executed_by.replace("robot/", "agent/")
            }


def test_every_agent_on_a_path_but_the_last_has_handed_the_work_on() -> None:
    """Who is on the path of a decision beyond its decider was there because a hop went from it to the next, no later
    than a microsecond after."""
    seen = 0
    for spec in SPECS:
        one, _ = played(spec)
        hops = Counter(
            (event.sender, event.receiver, time)
            for time, event in zip(one.times_us, one.events, strict=True)
            if isinstance(event, InternalHandoff)
        )
        for time, event in zip(one.times_us, one.events, strict=True):
            path = flat(event).get("path", ())
            for sender, receiver in pairwise(path):
                seen += 1
                assert any(hops[sender, receiver, time + later] for later in range(2)) or _injected(event), (
                    type(event).__name__,
                    path,
                )
    assert seen > 500


def _injected(event: Event) -> bool:
    """An outsider's request, whose way to the other robot comes after the hop."""
    return str(flat(event).get("task_id", "")).startswith("injected")
