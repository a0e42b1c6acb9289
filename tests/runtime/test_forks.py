"""A fork repeats its base up to what is changed, plays on under the same draws, and replays from its event 0 alone."""

from collections.abc import Sequence
from typing import Any

import msgspec
import pytest

from fsar_ledger.base.errors import InvalidExperiment, UsageError
from fsar_ledger.designs.constants import Constants, Load, Outages
from fsar_ledger.designs.registered import PAPER_SCENARIOS
from fsar_ledger.events import Event
from fsar_ledger.events.execution import ExecutionFailed, ExecutionStarted
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.policy import PolicyRuleSet
from fsar_ledger.events.recovery import RecoveryBudgetSet
from fsar_ledger.events.supervision import SupervisionDensitySet, SupervisorCalled, SupervisorResponded
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.events.world import ObstructionAppeared, PolicyWindowClosed, PolicyWindowOpened, RobotWentOff
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import parts_at
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.forks import Fork, fork, run_again
from fsar_ledger.runtime.recipes import Recipe, base_of, recorded_recipe, with_changes
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import RunSpec, run_id, simulate_run
from tests.quick import few
from tests.runtime.pinned import PINNED
from tests.sure import known

ROOT = "0a" * 32
S = 1_000_000
REVIEWED = 4  # a run of door-relay in which, in the pinned world, a supervisor is called
SHARE = Constants().world.review_share


def base(
    architecture: str = "fsar", run: int = 0, scenario: str = "door-relay", constants: Constants | None = None
) -> tuple[Recipe, LedgerRun]:
    spec, made_from = RunSpec(42, architecture, "full", scenario, 4, run), constants or Constants()
    return Recipe(spec, made_from), simulate_run(spec, made_from)


def forked(*texts: str, of: tuple[Recipe, LedgerRun] | None = None) -> Fork:
    recipe, record = of or base()
    return fork(recipe, record, ROOT, parsed(texts))


def started(record: LedgerRun) -> RunStarted:
    event = record.events[0]
    assert isinstance(event, RunStarted)
    return event


def of_type(record: LedgerRun, kind: type[Event]) -> list[tuple[int, Any]]:
    return [
        (time_us, event)
        for time_us, event in zip(record.times_us, record.events, strict=True)
        if isinstance(event, kind)
    ]


def require_fork(record: LedgerRun, found: Fork) -> None:
    """It repeats the base up to where it says, says it truly, and replays."""
    own = started(found.record)
    assert own.forked_from_run == record.run_id
    assert own.forked_from_root == ROOT
    last = len(record.events) - 1 if found.parts_at is None else found.parts_at - 1
    assert own.forked_from_seq == last
    assert found.record.events[1 : last + 1] == record.events[1 : last + 1]
    assert found.record.times_us[: last + 1] == record.times_us[: last + 1]
    assert found.record.caused_by[: last + 1] == record.caused_by[: last + 1]
    assert found.record.run_id == run_id(own) != record.run_id
    assert replay_run(found.record) is None


@pytest.mark.parametrize("architecture", ["fsar", "cfc", "dhma"])
def test_a_fork_without_a_change_does_the_same(architecture: str) -> None:
    for scenario in PAPER_SCENARIOS:
        of = base(architecture, 1, scenario)
        found = forked(of=of)
        assert found.parts_at is None
        assert found.record.events[1:] == of[1].events[1:]
        assert (found.record.times_us, found.record.caused_by) == (of[1].times_us, of[1].caused_by)
        require_fork(of[1], found)


@pytest.mark.parametrize("runs", few([5, 20], [], [5]))
def test_no_fork_of_the_whole_experiment_without_a_change_does_anything_else(runs: int) -> None:
    cells = [(name, run, one) for name in ("fsar", "cfc", "dhma") for run in range(runs) for one in PAPER_SCENARIOS]
    assert len(cells) == 15 * runs
    for architecture, run, scenario in cells:
        of = base(architecture, run, scenario)
        found = forked(of=of)
        assert found.parts_at is None
        assert replay_run(found.record) is None


EACH = [
    ["drop window:*"],
    ["drop task:A1-2"],
    ["move window:fleet/B1/1 +2s"],
    ["move task:A1-1 -5s"],
    ["add obstruction:B1 20s for 5s"],
    ["add window:fleet/B1 24s for 8s"],
    ["add off:B1 24s for 10s", "add link:A1 60s for 3s"],
    ["add absence:B1 1s for 200s"],
    ["add context:A1 30s", "add degradation:B1 5s lost", "add routine:A1 31s motion", "add encounter:A1/B1 40s"],
    ["add degradation:A1 9s unreliable"],
    ["answer call:1 deny"],
    ["answer response:1 never"],
    ["answer response:* 1s"],
    ["answer message:* 0.5s"],
    ["answer execution:* 9s"],
    ["set world.review_share=0.9"],
    ["set structure.poll_us=500000", "set world.message.high_s=0.1"],
    ["set outages.off_rate_per_s=0.02", "set outages.off_mean_s=5"],
    ["set load.task_sets=2", "set load.interval_s=20"],
    ["set world.obstruction_rate_per_s=0.1 from 30s"],
    ["set world.response.high_s=300 from 60s", "set world.message.high_s=0.05 from 90s"],
]


@pytest.mark.parametrize("texts", EACH, ids="; ".join)
@pytest.mark.parametrize("architecture", ["fsar", "cfc", "dhma"])
def test_a_fork_of_every_kind_of_change_repeats_its_base_and_replays(architecture: str, texts: list[str]) -> None:
    of = base(architecture, constants=PINNED)
    found = forked(*texts, of=of)
    require_fork(of[1], found)
    recipe = recorded_recipe(started(found.record), len(found.record.events))
    assert base_of(recipe) == of[0]
    assert with_changes(of[0], parsed(texts)) == recipe


FROM_A_TIME: list[tuple[str, type[Event]]] = [
    ("rule fleet review robot=B1 capability=door.open.secure from 60s", PolicyRuleSet),
    ("rule local deny robot=B1 from 60s", PolicyRuleSet),
    ("trust A1 B1 none from 60s", TrustSet),
    ("budget B1 local 1s 0 from 60s", RecoveryBudgetSet),
    ("density all 1 from 60s", SupervisionDensitySet),
]


@pytest.mark.parametrize(("text", "kind"), FROM_A_TIME)
def test_what_holds_from_a_time_on_changes_nothing_before(text: str, kind: type[Event]) -> None:
    of = base()
    found = forked(text, of=of)
    require_fork(of[1], found)
    assert next(time_us for time_us, _ in of_type(found.record, kind) if time_us) == 60 * S
    assert found.parts_at is not None
    assert found.record.times_us[found.parts_at] == 60 * S


@pytest.mark.parametrize("architecture", ["cfc", "dhma"])
def test_only_fsar_decides_what_supervisors_command(architecture: str) -> None:
    with pytest.raises(UsageError, match=f"{architecture} decides no such command"):
        forked("rule fleet deny", of=base(architecture))


def test_a_window_that_is_dropped_neither_opens_nor_closes() -> None:
    found = forked("drop window:fleet/B1/1")
    edges = [*of_type(found.record, PolicyWindowOpened), *of_type(found.record, PolicyWindowClosed)]
    assert edges
    assert all(getattr(event, "window", None) != "fleet/B1/1" for _, event in edges)


def test_a_window_that_is_moved_keeps_its_length() -> None:
    of = base(constants=PINNED)
    found = forked("move window:fleet/B1/1 +2s", of=of)
    lengths_us = set()
    for record, shift_us in ((of[1], 0), (found.record, 2 * S)):
        (opened,), (closed,) = [
            [at for at, one in of_type(record, kind) if one.window == "fleet/B1/1"]
            for kind in (PolicyWindowOpened, PolicyWindowClosed)
        ]
        assert opened == 71_697_922 + shift_us
        lengths_us.add(closed - opened)
    [length_us] = lengths_us
    assert length_us > 0


def test_an_added_fact_happens_at_its_time() -> None:
    found = forked("add obstruction:B1 20s for 5s", "add off:C1 21s for 1s")
    assert (20 * S, "robot/B1") in [
        (at, getattr(one, "robot", "")) for at, one in of_type(found.record, ObstructionAppeared)
    ]
    assert [at for at, _ in of_type(found.record, RobotWentOff)] == [21 * S]


def test_a_supervisor_who_says_no_is_on_record_with_that() -> None:
    of = base(run=REVIEWED, constants=PINNED)
    (asked,) = of_type(of[1], SupervisorCalled)[:1]
    found = forked("answer call:1 deny", of=of)
    answers = [one for at, one in of_type(found.record, SupervisorResponded) if at > asked[0]]
    assert isinstance(answers[0], SupervisorResponded)
    assert not answers[0].approves
    assert found.used == {"call:1"}


def test_a_supervisor_who_never_answers_is_not_on_record() -> None:
    of = base(run=REVIEWED, constants=PINNED)
    assert of_type(of[1], SupervisorResponded)
    assert not of_type(forked("answer response:* never", of=of).record, SupervisorResponded)


def test_an_attempt_with_a_degraded_actuator_can_fail() -> None:
    of = base(scenario="failure-recovery-chain", run=3)
    fails = len(of_type(of[1], ExecutionFailed))
    found = forked("add degradation:B1 1s", "add degradation:A1 1s", "answer attempt:* fail", of=of)
    assert len(of_type(found.record, ExecutionFailed)) > fails
    require_fork(of[1], found)


def test_executions_take_as_long_as_is_answered() -> None:
    found = forked("answer execution:A1-1/1.1 9s")
    at, event = of_type(found.record, ExecutionStarted)[0]
    assert event.subject.action_id == "A1-1/1.1"
    assert event.ends_us - at == 9 * S


def test_another_architecture_or_mechanism_holds_from_the_start() -> None:
    of = base()
    for text, field, value in (
        ("architecture dhma", "architecture", "dhma"),
        ("without shared-registry", "configuration", "without-shared-registry"),
    ):
        found = forked(text, of=of)
        require_fork(of[1], found)
        assert getattr(started(found.record), field) == value
        assert " instead of " in (started(found.record).changes or ("",))[0]


def test_the_base_of_a_fork_has_the_groups_of_constants_that_it_had() -> None:
    for constants, text in (
        (Constants(), "set outages.loss_rate_per_s=0.001"),
        (Constants(outages=Outages(off_rate_per_s=0.001)), "set outages.loss_rate_per_s=0.001"),
        (Constants(load=Load(task_sets=2)), "set load.teams_working=1"),
    ):
        of = base(constants=constants)
        found = forked(text, of=of)
        recipe = recorded_recipe(started(found.record), len(found.record.events))
        assert base_of(recipe) == of[0]
        require_fork(of[1], found)


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        ([f"set world.review_share={SHARE}"], f"is {SHARE} already"),
        (["set world.review_shar=0.5"], "did you mean world.review_share"),
        (["set world.review_share=1.5"], "^change set world.review_share=1.5: found 1.5, expected a share"),
        (
            ["set world.review_share=-1 from 5s"],
            "^change set world.review_share=-1 from 5s: found -1, expected 0 or more",
        ),
        (["set structure.local_attempts=1.5"], "^change set structure.local_attempts=1.5: found 1.5, expected a whole"),
        (["set world.message.low_s=0.7"], "^change set world.message.low_s=0.7: found world.message from 0.7 to 0.5 s"),
        (["set structure.poll_us=1"], "^change set structure.poll_us=1: found 1, expected 1,000 or more"),
        (["set structure.poll_us=3 from 5s"], "found a time for structure.poll_us"),
        (["set world.floor_teams=2 from 5s"], "found a time for world.floor_teams"),
        (["set world.review_share=0.3", "set world.review_share=0.4"], "changed twice"),
        (["set world.review_share=0.3 from 5s", "set world.review_share=0.4 from 5s"], "one value for each name"),
        (["set world.absence_to_s=-60"], "^change set world.absence_to_s=-60: found world.absence from -50 to -60 s"),
        (
            ["answer approach:* 2s", "answer approach:* 3s"],
            "^change answer approach:\\* 3s: approach:\\* is changed twice",
        ),
        (["architecture fsar"], "has that already"),
        (["architecture cfc", "architecture dhma"], "changed twice"),
        (["without nothing"], "has that already"),
        (["without shared-registr"], "did you mean shared-registry"),
        (["move task:A1-1 -900s"], "found a fact at -"),
        (["move task:A1-1 +9000s"], "before its last possible end"),
    ],
)
def test_an_impossible_change_is_an_error(texts: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        forked(*texts)


def test_two_changes_of_a_range_are_judged_together() -> None:
    for later in ("", " from 5s"):
        both = [f"set world.message.low_s=0.6{later}", f"set world.message.high_s=0.9{later}"]
        assert forked(*both).record.events
        assert forked(*reversed(both)).record.events


def test_an_architecture_that_is_none_or_lacks_the_mechanism_is_an_error() -> None:
    for texts in (["architecture foo"], ["without planner-claims"]):
        with pytest.raises(InvalidExperiment):
            forked(*texts)


def forged(record: LedgerRun, **fields: object) -> LedgerRun:
    """The record with other fields in event 0, under the name that they give it."""
    other = msgspec.structs.replace(started(record), **fields)
    return LedgerRun(run_id(other), record.times_us, record.caused_by, [other, *record.events[1:]])


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"forked_from_seq": 5}, "forked_from_seq"),
        ({"forked_from_seq": None}, "forked_from_seq"),
        ({"forked_from_root": "0A" * 32}, "forked_from_root"),
        ({"forked_from_root": None}, "forked_from_root"),
        ({"forked_from_run": "another"}, "forked_from_run"),
        ({"forked_from_run": None}, "forked_from_run"),
        ({"changes": ("drop window:fleet/B1/0",)}, "type"),
        ({"changes": ()}, "type"),
        ({"changes": None}, None),
        ({"changes": ("drop  window:fleet/B1/1",)}, "changes"),
        ({"changes": ("drop window:fleet/B1/1", "jump")}, "changes"),
        ({"changes": ("drop window:fleet/B1/1", f"set world.review_share=0.5 instead of {SHARE}")}, "changes"),
    ],
)
def test_a_forged_origin_is_found(fields: dict[str, object], field: str | None) -> None:
    found = known(replay_run(forged(forked("drop window:fleet/B1/1").record, **fields)))
    assert found.field == field


def test_a_wrong_value_of_the_base_is_found() -> None:
    record = forked("set world.review_share=0.5").record
    assert replay_run(record) is None
    wrong = known(replay_run(forged(record, changes=("set world.review_share=0.5 instead of 0.2",))))
    assert wrong.field == "forked_from_run"


def test_a_forged_event_of_a_fork_is_found() -> None:
    found = forked("drop window:fleet/B1/1")
    at = found.parts_at or 0
    events: Sequence[Event] = [*found.record.events[:at], *found.record.events[at + 1 :]]
    shorter = LedgerRun(
        found.record.run_id,
        [*found.record.times_us[:at], *found.record.times_us[at + 1 :]],
        [*found.record.caused_by[:at], *found.record.caused_by[at + 1 :]],
        events,
    )
    assert replay_run(shorter) is not None


@pytest.mark.parametrize(
    "changes",
    [
        ("x" * 20_000,),
        tuple(f"drop window:none/{number}" for number in range(3_000)),
        ("add 5s {}",),
        ("drop " + "*" * 60 + "x",),
        ("set world.obstruction_rate_per_s=1000000 from 1s",),
        ("set world.horizon_s=1e300 from 1s",),
    ],
)
def test_hostile_changes_neither_crash_nor_hang_replay(changes: tuple[str, ...]) -> None:
    assert replay_run(forged(forked("drop window:fleet/B1/1").record, changes=changes)) is not None


def test_where_two_records_part_is_the_first_event_time_or_cause_that_is_not_the_same() -> None:
    _, record = base()
    last = len(record.events) - 1
    assert parts_at(record, record) is None
    for seq in (1, 200, last):
        times, causes, events = [*record.times_us], [*record.caused_by], [*record.events]
        times[seq] += 1
        causes[seq] = None if causes[seq] == 0 else 0
        events[seq] = record.events[0]
        for other in (
            LedgerRun(record.run_id, times, record.caused_by, record.events),
            LedgerRun(record.run_id, record.times_us, causes, record.events),
            LedgerRun(record.run_id, record.times_us, record.caused_by, events),
        ):
            assert parts_at(record, other) == parts_at(other, record) == seq


def test_event_0_names_the_run_and_does_not_count() -> None:
    _, record = base()
    named = [msgspec.structs.replace(started(record), run=9), *record.events[1:]]
    assert parts_at(record, LedgerRun("another", record.times_us, record.caused_by, named)) is None


def test_a_run_that_is_over_parts_at_the_event_that_it_lacks() -> None:
    _, record = base()
    shorter = LedgerRun(record.run_id, record.times_us[:-2], record.caused_by[:-2], record.events[:-2])
    assert parts_at(record, shorter) == parts_at(shorter, record) == len(record.events) - 2


def test_a_run_that_is_made_again_is_the_same_and_tells_what_it_asked() -> None:
    recipe, record = base(run=REVIEWED, constants=PINNED)
    again, asked = run_again(recipe)
    assert again.events == record.events
    kinds = {one.kind for one in asked}
    assert {"message", "execution", "approach", "response", "call"} <= kinds
    assert all(one.text for one in asked)
