"""Replay makes the world again: a fact that was left out, added, moved or altered before the run was made and committed
is found.

Every invented run here is what the real handlers decide in that world, so that nothing but the world itself is wrong.
"""

import random
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from typing import Any, get_args

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, Membership, Outages
from fsar_ledger.events import Event
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Architecture, Robot, flat, with_columns
from fsar_ledger.events.world import (
    ActuatorDegraded,
    ContextChanged,
    ObstructionAppeared,
    ObstructionCleared,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RoutineDue,
    SupervisorLeft,
    TaskArrived,
    WorldEvent,
)
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Fact
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import (
    SCENARIOS,
    RunSpec,
    founding_of,
    handler_table_of,
    run_id,
    run_started,
    simulate_run,
)
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, run_key
from fsar_ledger.runtime.world.schedule import schedule
from tests.runtime.forgeries import changed, dropped
from tests.sure import known

CONSTANTS = Constants()
FACTS: tuple[type[Event], ...] = get_args(WorldEvent)
AWAY = RunSpec(9, "fsar", "full", "fleet-contention", 4, 7)
CALLED = RunSpec(9, "fsar", "full", "door-relay", 4, 7)
SPECS = [
    *(
        RunSpec(9, architecture, "full", scenario, 4, 1)
        for architecture in PAPER_ARCHITECTURES
        for scenario in SCENARIOS
    ),
    RunSpec(9, "fsar", "full", "workflow-door-relay", 4, 0),
    RunSpec(9, "fsar", "full", "workflow-layered-recovery", 4, 0),
    RunSpec(9, "cfc", "full", "mixed-trust-inspection", 8, 0),
    AWAY,
    CALLED,
]
Invent = Callable[[Sequence[Fact]], Sequence[Fact]]


def constants_of(spec: RunSpec) -> Constants:
    """Our own, but for one run in which robots and links fail, and one in which robots are called away."""
    other = {
        AWAY: Constants(outages=Outages(0.02, 8.0, 0.03, 6.0)),
        CALLED: Constants(membership=Membership(0.02, announced_share=1.0)),
    }
    return other.get(spec, CONSTANTS)


def world_of(spec: RunSpec) -> tuple[Fact, ...]:
    constants = constants_of(spec)
    return schedule(constants, spec.seed, spec.scenario, spec.run, spec.fleet_size)


def simulated_in(facts: Sequence[Fact], spec: RunSpec) -> LedgerRun:
    """The run that the real handlers make in a world of these facts, under the name of the honest one."""
    draws = Draws(run_key(spec.seed, spec.scenario, spec.run), CONSTANTS.world)
    one = Kernel(
        handler_table_of(spec.architecture), SimulatedEnvironment(facts, draws), *founding_of(spec, constants_of(spec))
    )
    one.run()
    return LedgerRun(run_id(run_started(spec, constants_of(spec))), one.times_us, one.caused_by, one.events)


honest = cache(lambda spec: simulate_run(spec, constants_of(spec)))


def first_other(spec: RunSpec, record: LedgerRun) -> int:
    """The first seq at which the record is not the honest one."""
    own = honest(spec)
    pairs = [list(zip(one.times_us, one.caused_by, one.events, strict=True)) for one in (own, record)]
    return next(
        (seq for seq, (left, right) in enumerate(zip(*pairs, strict=False)) if left != right), min(map(len, pairs))
    )


def without(*kinds: type[Event]) -> Invent:
    return lambda facts: [fact for fact in facts if not isinstance(fact[1], kinds)]


def moved(facts: Sequence[Fact]) -> Sequence[Fact]:
    """One obstruction comes a tenth of a second later."""
    at = next(at for at, (_, event) in enumerate(facts) if isinstance(event, ObstructionAppeared))
    time_us, event = facts[at]
    return sorted([*facts[:at], (time_us + 100_001, event), *facts[at + 1 :]], key=lambda fact: fact[0])


def eased(facts: Sequence[Fact]) -> Sequence[Fact]:
    """Every window asks for a review that denied, and the other way round."""
    other: Any = {"deny": "review", "review": "deny"}
    return [
        (at, msgspec.structs.replace(one, outcome=other[one.outcome]) if isinstance(one, PolicyWindowOpened) else one)
        for at, one in facts
    ]


def patient(facts: Sequence[Fact]) -> Sequence[Fact]:
    """Every task has twice the time."""
    return [
        (
            at,
            msgspec.structs.replace(one, budget_us=2 * (one.budget_us or 0), due_us=at + 2 * (one.budget_us or 0))
            if isinstance(one, TaskArrived)
            else one,
        )
        for at, one in facts
    ]


INVENTED: dict[str, Invent] = {
    "nothing goes wrong": without(
        ObstructionAppeared,
        ObstructionCleared,
        PolicyWindowOpened,
        PolicyWindowClosed,
        ActuatorDegraded,
        ContextChanged,
        SupervisorLeft,
    ),
    "nothing is in the way": without(ObstructionAppeared, ObstructionCleared),
    "no policy ever denies": without(PolicyWindowOpened, PolicyWindowClosed),
    "no context changes": without(ContextChanged),
    "no routine": without(RoutineDue),
    "an obstruction comes later": moved,
    "denials are reviews": eased,
    "tasks have more time": patient,
    "an obstruction more": lambda facts: [
        *facts,
        (facts[-1][0] + 1, ObstructionAppeared(Robot("robot/A1"), "obstruction/A1/99")),
    ],
    "the last fact is missing": lambda facts: facts[:-1],
    "the last fact comes later": lambda facts: [*facts[:-1], (facts[-1][0] + 1, facts[-1][1])],
    "two facts change places": lambda facts: [
        *facts[:40],
        (facts[40][0], facts[41][1]),
        (facts[41][0], facts[40][1]),
        *facts[42:],
    ],
    "no world at all": lambda _: (),
}


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
@pytest.mark.parametrize("name", list(INVENTED))
def test_a_run_in_an_invented_world_is_found_where_it_leaves_its_own(name: str, architecture: Architecture) -> None:
    spec = RunSpec(9, architecture, "full", "fleet-contention", 4, 1)
    record = simulated_in(INVENTED[name](world_of(spec)), spec)
    difference = known(replay_run(record))
    assert (difference.run, difference.seq) == (record.run_id, first_other(spec, record))
    assert "of this run does not have" in difference.actual or difference.handler == "world.schedule.schedule"


@pytest.mark.slow
def test_no_kind_of_fact_can_be_left_out() -> None:
    tried = set()
    for spec in SPECS:
        facts = world_of(spec)
        for kind in {type(event) for _, event in facts}:
            record = simulated_in(without(kind)(facts), spec)
            difference = known(replay_run(record))
            assert difference.seq == first_other(spec, record)
            assert difference.expected.startswith(f"{kind.__struct_config__.tag} at "), difference
            assert difference.handler == "world.schedule.schedule"
            tried.add(kind)
    assert tried == set(FACTS)


def test_a_difference_says_which_fact_was_found_and_which_was_expected() -> None:
    spec = RunSpec(9, "fsar", "full", "fleet-contention", 4, 1)
    facts = world_of(spec)
    at = next(at for at, (_, event) in enumerate(facts) if isinstance(event, ObstructionAppeared))
    missing, invented = facts[at], (facts[at][0], ObstructionCleared(Robot("robot/A1"), "obstruction/A1/0"))
    difference = known(replay_run(simulated_in([*facts[:at], invented, *facts[at + 1 :]], spec)))
    assert isinstance(missing[1], ObstructionAppeared)
    assert difference.expected == (
        f"ObstructionAppeared.v1 at {missing[0]} microseconds (robot {missing[1].robot!r}, obstruction "
        f"{missing[1].obstruction!r})"
    )
    found = (
        f"ObstructionCleared.v1 at {missing[0]} microseconds (robot 'robot/A1', obstruction 'obstruction/A1/0'), "
        "which the world of this run does not have"
    )
    assert difference.actual == found
    assert str(difference).endswith(
        f"seq {difference.seq}, field type: found {found}, expected {difference.expected} from world.schedule.schedule"
    )


OTHERS: dict[type, Any] = {str: "another", int: 7_777_777, bool: True, tuple: ("another",), type(None): "another"}


def altered(draw: random.Random, record: LedgerRun, seq: int) -> LedgerRun:
    """The record with one fact left out, moved, or altered in one field."""
    event = record.events[seq]
    match draw.randrange(3):
        case 0:
            return dropped(record, seq)
        case 1:
            return changed(record, seq, time_us=record.times_us[seq] + draw.choice((-1, 1)))
    name, value = draw.choice(list(flat(event).items()))
    return changed(record, seq, with_columns(event, **{name: OTHERS[type(value)]}))


def test_any_single_fact_of_any_run_that_is_missing_or_another_is_found_at_its_place() -> None:
    draw = random.Random(17)
    found = set()
    for spec in SPECS:
        record = honest(spec)
        assert replay_run(record) is None
        facts = [seq for seq, event in enumerate(record.events) if isinstance(event, FACTS)]
        assert len(facts) == len(world_of(spec))  # all of the schedule is in the record, to its end
        for seq in {facts[-1], *draw.sample(facts, min(4, len(facts)))}:
            difference = known(replay_run(altered(draw, record, seq)))
            assert difference.seq == seq
            found.add(type(record.events[seq]))
    assert len(found) > 5


@pytest.mark.slow
def test_every_fact_that_is_left_out_of_a_random_world_in_which_the_run_is_made_is_found() -> None:
    draw = random.Random(18)
    made = 0
    for _ in range(60):
        spec = RunSpec(
            draw.randrange(2**53),
            draw.choice(PAPER_ARCHITECTURES),
            "full",
            draw.choice(SCENARIOS),
            draw.choice((4, 8)),
            draw.randrange(20),
        )
        facts = world_of(spec)
        for at in draw.sample(range(len(facts)), 12):
            with suppress(RuntimeError):  # such a run has no end
                difference = known(replay_run(simulated_in([*facts[:at], *facts[at + 1 :]], spec)))
                assert difference.expected.startswith(
                    f"{facts[at][1].__struct_config__.tag} at {facts[at][0]} microseconds"
                )
                made += 1
    assert made > 600
