"""The world of a fork: with other rates from a time on, and of those who are away twice at a time."""

import re
from collections.abc import Sequence

import msgspec
import pytest

from fsar_ledger.analysis.why import decisions
from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Supervisor
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import (
    ContextChanged,
    ObstructionAppeared,
    PeersMet,
    PolicyWindowClosed,
    PolicyWindowOpened,
    RobotCameBack,
    RobotWentOff,
    RoutineDue,
    SupervisorLeft,
    SupervisorReturned,
    TaskArrived,
)
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime import forks
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.changeable import continued
from fsar_ledger.runtime.changes import TO_0_16, TO_0_18, Add, Drop, Move, Rules
from fsar_ledger.runtime.forks import edited_environment, edited_facts
from fsar_ledger.runtime.ports import Fact
from fsar_ledger.runtime.recipes import Recipe, with_changes
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import RunSpec, environment_of
from tests.runtime.test_forks import S, base, forked, of_type

HALF = {
    RoutineDue: "set world.routine_rate_per_s=0.111 from 50s",
    ContextChanged: "set world.context_rate_per_s=0.012 from 50s",
    PolicyWindowOpened: "set world.fleet_rule_rate_per_s=0.0163 from 50s",
    ObstructionAppeared: "set world.obstruction_rate_per_s=0.006 from 50s",
    PeersMet: "set world.encounter_mean_s=180 from 50s",
}
"""By fact of the world, the change by which it happens half as often from a time on."""


def forked_under(rules: Rules, *texts: str) -> LedgerRun:
    """The record of such a fork as an earlier release made it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(forks, "with_changes", lambda *of: msgspec.structs.replace(with_changes(*of), rules=rules))
        return forked(*texts).record


def spec(seed: int) -> RunSpec:
    return RunSpec(seed, "fsar", "full", "door-relay", 4, 0)


def facts_of(seed: int, *texts: str) -> Sequence[Fact]:
    return edited_environment(with_changes(Recipe(spec(seed), Constants()), parsed(texts))).facts


@pytest.mark.parametrize("kind", HALF, ids=lambda kind: kind.__name__)
def test_a_rate_that_holds_from_a_time_on_is_that_of_a_world_that_always_had_it(kind: type[Event]) -> None:
    from_the_start = HALF[kind].removesuffix(" from 50s")
    for seed in range(5):
        later, always = (
            [time_us for time_us, fact in facts if isinstance(fact, kind) and time_us >= 50 * S]
            for facts in (facts_of(seed, HALF[kind]), facts_of(seed, from_the_start))
        )
        other = PolicyWindowOpened  # those of the robot's own context are as frequent as before
        assert later == always or kind is other
        assert kind is not other or len(later) == len(always)


def test_what_happened_before_a_time_is_as_it_was_and_a_task_comes_once() -> None:
    for seed in range(5):
        facts, usual = facts_of(seed, *HALF.values()), environment_of(spec(seed), Constants()).facts
        assert [one for one in facts if one[0] < 50 * S] == [one for one in usual if one[0] < 50 * S]
        tasks = tasks_of(facts_of(seed, "set world.jitter.high_s=60 from 10s"))
        assert sorted(tasks) == sorted({*tasks}) == sorted(tasks_of(usual))


def tasks_of(facts: Sequence[Fact]) -> list[str]:
    return [fact.task_id for _, fact in facts if isinstance(fact, TaskArrived)]


@pytest.mark.parametrize("text", [HALF[ContextChanged], HALF[PolicyWindowOpened], HALF[ObstructionAppeared]])
def test_no_two_windows_or_obstructions_of_a_world_have_one_name(text: str) -> None:
    for seed in range(20):
        facts = [fact for _, fact in facts_of(seed, text)]
        for kind, name in ((PolicyWindowOpened, "window"), (ObstructionAppeared, "obstruction")):
            names = [getattr(fact, name) for fact in facts if isinstance(fact, kind)]
            assert len(names) == len({*names})
        closed = {fact.window for fact in facts if isinstance(fact, PolicyWindowClosed)}
        assert closed <= {fact.window for fact in facts if isinstance(fact, PolicyWindowOpened)}
        named = [fact.window for fact in facts if isinstance(fact, ContextChanged) and fact.window is not None]
        opened = {fact.window for fact in facts if isinstance(fact, PolicyWindowOpened) and fact.scope == "local"}
        assert {*named} == opened
        assert len(named) == len(opened)


def test_a_robot_that_is_off_does_not_go_off_again_in_the_world_after() -> None:
    off, back = RobotWentOff(Robot("robot/B1")), RobotCameBack(Robot("robot/B1"))
    before = ((20 * S, off), (40 * S, back), (90 * S, off), (95 * S, back))
    after = ((1 * S, off), (2 * S, back), (35 * S, off), (50 * S, back), (60 * S, off), (61 * S, back))
    assert continued(before, after, 30 * S) == ((20 * S, off), (40 * S, back), (60 * S, off), (61 * S, back))


def away(texts: Sequence[str], *usual: Fact) -> list[tuple[float, str]]:
    changes = [one for one in parsed(texts) if isinstance(one, Add | Move | Drop)]
    return [(time_us / S, type(fact).__name__) for time_us, fact in edited_facts(usual, changes)]


LEFT, BACK = SupervisorLeft(Supervisor("supervisor/A1")), SupervisorReturned(Supervisor("supervisor/A1"))


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["add absence:A1 40s for 100s"], (18, 140)),
        (["add absence:A1 10s for 20s"], (10, 48)),
        (["add absence:A1 20s for 5s"], (18, 48)),
        (["add absence:A1 10s for 100s"], (10, 110)),
        (["add absence:A1 40s for 100s", "add absence:A1 130s for 20s"], (18, 150)),
        (["move absence:A1/0 +20s", "add absence:A1 30s for 10s"], (30, 68)),
    ],
    ids=str,
)
def test_who_is_away_twice_at_a_time_is_back_when_both_have_ended(texts: list[str], expected: tuple[int, int]) -> None:
    found = away(texts, (18 * S, LEFT), (48 * S, BACK))
    assert found == [(expected[0], "SupervisorLeft"), (expected[1], "SupervisorReturned")]


def test_absences_apart_and_those_of_others_stay_apart() -> None:
    usual = ((18 * S, LEFT), (48 * S, BACK))
    assert [time_s for time_s, _ in away(["add absence:A1 50s for 5s"], *usual)] == [18, 48, 50, 55]
    assert [time_s for time_s, _ in away(["add absence:B1 20s for 50s"], *usual)] == [18, 20, 48, 70]
    assert [time_s for time_s, _ in away(["drop absence:A1/0"], *usual)] == []


def test_a_fork_of_an_earlier_release_that_read_such_changes_otherwise_is_no_forgery() -> None:
    """Releases to 0.16 took away what had a used number, and ended two absences with the first."""
    for texts in (
        ("set world.fleet_rule_rate_per_s=0.0163 from 50s", "set world.routine_rate_per_s=0.111 from 50s"),
        ("add off:B1 20s for 30s", "add off:B1 25s for 50s"),
    ):
        old, new = forked_under(TO_0_16, *texts), forked(*texts).record
        assert old.events != new.events
        assert replay_run(old) is None
        assert replay_run(new) is None
        last = max(seq for seq, cause in enumerate(old.caused_by) if cause)
        assert [*decisions(old, [last])] == [last], "why it happened can be asked, too"


TASK = '{"type":"TaskArrived","task_id":"A1-9","robot":"robot/A1","team":1,"steps":["A navigate.indoor"],'


@pytest.mark.parametrize("text", ["move task:A1-2 +60s", "move task:A1-1 -5s", f'add 90s {TASK}"budget_us":30000000}}'])
def test_a_task_that_is_moved_or_added_is_due_when_its_budget_ends(text: str) -> None:
    found, earlier = forked(text).record, forked_under(TO_0_18, text)
    dues = [[event.due_us for _, event in of_type(record, TaskArrived)] for record in (base()[1], earlier, found)]
    budgets = [time_us + event.budget_us for time_us, event in of_type(found, TaskArrived)]
    assert dues[2] == budgets
    assert dues[1][:2] == dues[0], "to 0.18 it was due when it was before, or never"
    assert replay_run(found) is None
    assert replay_run(earlier) is None


def test_a_task_that_is_added_late_is_not_given_up_before_it_begins() -> None:
    (done,) = (
        time_us
        for time_us, event in of_type(forked(f'add 90s {TASK}"budget_us":30000000}}').record, TaskCompleted)
        if event.task_id == "A1-9"
    )
    assert done < 120 * S


RATE = "set world.fleet_rule_rate_per_s=0.2"


@pytest.mark.parametrize("constant", [RATE, f"{RATE} from 50s"])
def test_a_fact_that_a_constant_puts_elsewhere_is_not_named_beside_it(constant: str) -> None:
    facts = base()[1].events
    window = [fact.window for fact in facts if isinstance(fact, PolicyWindowOpened) and fact.scope == "fleet"][-1]
    for text in (f"drop window:{window}", f"move window:{window} +1s"):
        with pytest.raises(UsageError, match=f"change {re.escape(text)}: under {RATE}.* has another fact of this name"):
            forked(constant, text)
    assert not of_type(forked(constant, "drop window:*").record, PolicyWindowOpened)


def test_a_fact_that_a_constant_leaves_where_it_is_is_named_beside_it() -> None:
    for constant in (f"{RATE} from 50s", "set world.message.high_s=0.3"):
        assert "fleet/B1/0" in windows_of(forked(constant).record)
        assert "fleet/B1/0" not in windows_of(forked(constant, "drop window:fleet/B1/0").record)
    start = "set world.start.high_s=5"
    assert {*tasks_of(facts_of(42, start))} == {"A1-1", "A1-2"}
    assert [*tasks_of(facts_of(42, start, "drop task:A1-1"))] == ["A1-2"], "a task is the same whenever it arrives"
    assert forked(start, "drop task:A1-1").parts_at is not None


def windows_of(record: LedgerRun) -> set[str]:
    return {fact.window for _, fact in of_type(record, PolicyWindowOpened)}


def test_a_fork_with_a_lower_rate_from_a_time_on_repeats_its_base_until_then() -> None:
    record, found = base()[1], forked("set world.routine_rate_per_s=0.111 from 50s")
    assert found.parts_at is not None
    assert record.times_us[found.parts_at] >= 50 * S


def test_windows_that_a_fork_has_from_one_moment_on_each_last_as_long_as_asked() -> None:
    texts = ("add window:fleet/B1 20s for 5s", "add window:fleet/B1 20s for 30s review")
    windows = {fact.window for _, fact in facts_of(0, *texts) if isinstance(fact, PolicyWindowOpened)}
    more = windows - {fact.window for _, fact in facts_of(0) if isinstance(fact, PolicyWindowOpened)}
    assert len(more) == 2
    ways = {
        fact.obstruction
        for _, fact in facts_of(0, "add obstruction:B1 20s for 5s", "add obstruction:B1 20s for 9s")
        if isinstance(fact, ObstructionAppeared) and "at-20s" in fact.obstruction
    }
    assert len(ways) == 2
