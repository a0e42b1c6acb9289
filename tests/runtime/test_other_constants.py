"""Replay under other constants: told as such, bounded, and refused where no world can be made."""

from itertools import cycle
from typing import get_args, get_type_hints

import msgspec
import pytest

from fsar_ledger.designs.constants import (
    DESIGNS,
    DURATIONS,
    Constants,
    Load,
    Outages,
    Range,
    Structure,
    WorldConstants,
    origins,
    write_constants,
)
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.world import ContextChanged, ObstructionAppeared, PolicyWindowOpened, RoutineDue
from fsar_ledger.metrics.constant_names import default_of, unlike_ours
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.recipes import constants_used, remarks_on
from fsar_ledger.runtime.run_replay import Difference, replay_run
from fsar_ledger.runtime.simulation import RunSpec, run_started, simulate_run
from fsar_ledger.runtime.world.schedule import arrivals_expected, schedule
from tests.runtime.forgeries import changed, renamed
from tests.runtime.pinned import FITTED
from tests.runtime.test_invented_world import CONSTANTS, SPECS, honest
from tests.sure import known

# --- other constants ---


def started_with(world: WorldConstants, spec: RunSpec = SPECS[0]) -> RunStarted:
    return run_started(spec, Constants(world))


def test_the_pinned_world_gives_every_constant_that_is_fitted_a_value() -> None:
    assert FITTED.keys() == {name for name, word in origins().items() if word == "fitted"}


def first_constant(group: str) -> str:
    """The name of a constant of the group, from its type."""
    hint = get_type_hints(Constants)[group]
    [kind] = [one for one in (hint, *get_args(hint)) if isinstance(one, type) and issubclass(one, msgspec.Struct)]
    return kind.__struct_fields__[0]


OURS = WorldConstants()
CALM = WorldConstants(obstruction_rate_per_s=1e-9, context_rate_per_s=1e-9, fleet_rule_rate_per_s=1e-9)


def test_a_run_under_other_constants_is_no_doubt_but_told() -> None:
    record = simulate_run(SPECS[0], Constants(CALM, Structure(local_attempts=9)))
    assert replay_run(record) is None
    started = record.events[0]
    assert isinstance(started, RunStarted)
    [remark] = remarks_on(constants_used([started, run_started(SPECS[1], CONSTANTS)]))
    assert remark == (
        f"other constants: 1 of 2 runs (1 of {SPECS[0].architecture}) met a world or a structure that is not "
        "this version's: "
        f"structure.local_attempts=9 (here 2), world.context_rate_per_s=1e-9 (here {OURS.context_rate_per_s}), "
        f"world.fleet_rule_rate_per_s=1e-9 (here {OURS.fleet_rule_rate_per_s}), "
        f"world.obstruction_rate_per_s=1e-9 (here {OURS.obstruction_rate_per_s})"
    )


def test_runs_of_one_seed_under_different_constants_are_said_to_be_no_pairs() -> None:
    one, other = (RunSpec(9, architecture, "full", "door-relay", 4, 1) for architecture in ("fsar", "cfc"))
    met = constants_used([started_with(CALM, one), started_with(WorldConstants(), other)])
    assert remarks_on(met)[-1].startswith("no pairs: under 1 of 1 combinations of seed, scenario, fleet size and run")
    assert "first under 9, door-relay, 4, 1;" in remarks_on(met)[-1]
    assert len(remarks_on(met)) == 2
    assert remarks_on(constants_used([run_started(one, CONSTANTS), run_started(other, CONSTANTS)])) == ()


def test_another_load_is_said_as_such_and_pairs_under_a_common_one_are_pairs() -> None:
    both = [Constants(), Constants(load=Load(task_sets=2))]
    one, other = (RunSpec(9, architecture, "full", "door-relay", 4, 1) for architecture in ("fsar", "cfc"))
    said = "another load: 2 of 4 runs (1 of fsar, 1 of cfc) had a non-default load: load.task_sets=2 (here 1)"
    assert remarks_on(
        constants_used([run_started(spec, constants) for spec in (one, other) for constants in both])
    ) == (said,)
    assert len(remarks_on(constants_used([run_started(one, constants) for constants in both]))) == 1
    assert remarks_on(constants_used([run_started(one, both[0]), run_started(other, both[1])]))[-1].startswith(
        "no pairs: under 1 of 1"
    )


def test_one_length_among_many_is_named_alone_and_a_group_that_may_be_absent_by_its_defaults() -> None:
    durations = tuple((name, Range(1.0, 4.5) if name == "grasp.robust" else length) for name, length in DURATIONS)
    other = Constants(WorldConstants(durations=durations), load=Load(teams_working=1), outages=Outages(from_s=3.0))
    assert unlike_ours(write_constants(other)) == [
        "load.teams_working=1 (here default)",
        "outages.from_s=3 (here 0)",
        'world.durations["grasp.robust"].high_s=4.5 (here 4)',
    ]
    assert unlike_ours(write_constants(Constants(load=Load(), outages=Outages()))) == []


def test_every_group_that_may_be_absent_has_defaults() -> None:
    groups = [name for name in Constants.__struct_fields__ if name not in DESIGNS]
    assert [name for name in groups if default_of(f"{name}.{first_constant(name)}") is None] == []


def test_remarks_are_few_and_short_whatever_the_constants() -> None:
    odd = [
        WorldConstants(obstruction_rate_per_s=rate, durations=(("\x1b[2J" * 1000, CONSTANTS.world.message),))
        for rate in range(1, 50)
    ]
    sides = cycle([RunSpec(9, architecture, "full", "door-relay", 4, 1) for architecture in ("fsar", "cfc")])
    remarks = remarks_on(constants_used([started_with(world, spec) for world, spec in zip(odd, sides, strict=False)]))
    assert len(remarks) == 7
    assert remarks[5] == "other constants: 44 more sets"
    assert all(len(remark) < 1000 and remark.isprintable() for remark in remarks)


ENDLESS = {
    "obstructions without end": WorldConstants(obstruction_rate_per_s=1e300),
    "a horizon without end": WorldConstants(horizon_s=1e300),
    "a rate below nothing": WorldConstants(context_rate_per_s=-1.0),
    "robots meet all the time": WorldConstants(encounter_mean_s=1e-9),
    "robots meet before they met": WorldConstants(encounter_mean_s=-90.0),
}
EMPTY = {
    "a rate of nothing": WorldConstants(fleet_rule_rate_per_s=0.0),
    "hardly ever": WorldConstants(routine_rate_per_s=5e-324),
}


def replayed_in(world: WorldConstants) -> Difference:
    """In what a run differs that says it met this world."""
    record = honest(SPECS[0])
    started = msgspec.structs.replace(record.events[0], parameters=write_constants(Constants(world)))
    return known(replay_run(renamed(changed(record, 0, started))))


@pytest.mark.parametrize("name", list(ENDLESS))
def test_a_world_that_nobody_can_make_is_a_finding_at_once(name: str) -> None:
    difference = replayed_in(ENDLESS[name])
    assert (difference.seq, difference.field) == (0, "parameters")


@pytest.mark.parametrize("name", list(EMPTY))
def test_a_world_in_which_something_never_happens_is_made_and_differs_where_it_did(name: str) -> None:
    difference = replayed_in(EMPTY[name])
    assert (difference.seq or 0) > 0
    assert difference.actual.endswith("which the world of this run does not have")


@pytest.mark.parametrize("fleet_size", [4, 64])
def test_the_rates_lead_one_to_expect_what_comes(fleet_size: int) -> None:
    runs = [schedule(CONSTANTS, 3, "door-relay", run, fleet_size) for run in range(8)]
    counted = sum(
        isinstance(event, ContextChanged | ObstructionAppeared | RoutineDue) or "Met" in type(event).__name__
        for run in runs
        for _, event in run
    )
    counted += sum(isinstance(event, PolicyWindowOpened) and event.scope == "fleet" for run in runs for _, event in run)
    assert counted / len(runs) == pytest.approx(arrivals_expected(CONSTANTS, fleet_size), rel=0.1)


def test_the_largest_fleet_is_within_the_bounds() -> None:
    assert Experiment(("fsar",), ("door-relay",), 1, fleet_size=256).fleet_size == 256
    assert arrivals_expected(CONSTANTS, 256) < 1_000 * 256 / 2
