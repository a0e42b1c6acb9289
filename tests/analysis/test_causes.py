"""A cause suffices for its outcome, and nothing of it can be left out; futures say from when on nothing helps."""

from random import Random

import msgspec
import pytest

from fsar_ledger.analysis import avoidability
from fsar_ledger.analysis.avoidability import curve
from fsar_ledger.analysis.causes import Cause, Outcome, Search, cause, outcome_of
from fsar_ledger.analysis.fork_base import Rerun, base_of_record, rerun
from fsar_ledger.base.errors import QueryFailed, UnknownQuery, UsageError
from fsar_ledger.designs.constants import Constants
from fsar_ledger.designs.registered import PAPER_SCENARIOS
from fsar_ledger.events.execution import ExecutionFinished
from fsar_ledger.events.world import ContextChanged, PeersMet, PolicyWindowOpened, RoutineDue
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.database import from_table
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.changes import Drop
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Fact, World
from fsar_ledger.runtime.recipes import Recipe
from fsar_ledger.runtime.simulation import RunSpec, environment_of, simulate_run
from tests.analysis.conftest import simulated

ROOT = "0" * 64
VIOLATED = outcome_of("policy_violations > 0")


def again(record: LedgerRun) -> Rerun:
    return rerun(base_of_record(record, ROOT))


def metric(record: LedgerRun, name: str) -> float | None:
    """A metric of one run, by the query of that name."""
    with from_table(encode([record])) as database:
        (row,) = database.rows(f"SELECT value FROM {name}")
    value: float | None = row["value"]
    return value


def require_smallest(base: Rerun, outcome: Outcome, found: Cause, *, lengths: bool = False) -> None:
    search = Search(base, outcome, lengths=lengths)
    causes, presupposed = ({one.name for one in part} for part in (found.elements, found.presupposed))
    names = frozenset(causes | presupposed)
    assert search.holds(names), "it suffices"
    assert not any(search.judge([names - {name} for name in names])), "nothing can be left out"
    assert set(search.judge([names - {name} for name in causes])) <= {False}, "without a cause it is prevented"
    assert set(search.judge([names - {name} for name in presupposed])) <= {None}, "and not merely undefined"
    necessary = {name for name in causes if search.without_one([name]) == [False]}
    assert {one.name for one in found.elements if one.is_necessary} == necessary


VIOLATES = 24
"""A run of FSAR with one violation, which comes from a task and a window of policy."""


@pytest.mark.slow
def test_a_violated_policy_comes_from_a_task_and_a_window() -> None:
    base = again(simulated("fsar", VIOLATES))
    found = cause(base, VIOLATED)
    require_smallest(base, VIOLATED, found)
    assert sorted(one.name.partition(":")[0] for one in found.elements) == ["task", "window"]
    assert found.candidates == len(Search(base, VIOLATED).candidates)


@pytest.mark.slow
def test_without_a_necessary_cause_the_forked_run_does_not_have_the_outcome() -> None:
    base = again(simulated("fsar", VIOLATES))
    found = cause(base, VIOLATED)
    assert any(one.is_necessary for one in found.elements)
    for one in found.elements:
        forked = base.fork_with_effect(parsed([one.change]))
        assert (metric(forked.record, "policy_violations") == 0) == one.is_necessary


@pytest.mark.slow
@pytest.mark.parametrize(
    ("architecture", "text"), [("cfc", "recovery_containment < 1"), ("dhma", "coordination_success < 1")]
)
def test_what_the_fork_without_a_cause_asks_anew_is_answered_as_the_world_answers_it(
    architecture: str, text: str
) -> None:
    made = simulate_run(RunSpec(11, architecture, "full", "fleet-contention", 4, 0), Constants())
    base, outcome = again(made), outcome_of(text)
    for one in cause(base, outcome).elements:
        forked = base.fork_with_effect(parsed([one.change])).record
        has = outcome.of([(forked.times_us, forked.caused_by, forked.events)])
        assert (has == [False]) == one.is_necessary


@pytest.mark.slow
def test_with_a_cause_alone_the_forked_run_has_the_outcome() -> None:
    base = again(simulated("fsar", VIOLATES))
    kept = {one.name for one in cause(base, VIOLATED).elements}
    others = tuple(Drop(name) for name in base.base.facts_by_name if name not in kept)
    assert metric(base.fork(others).record, "policy_violations") == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("architecture", "number", "text", "kinds"),
    [
        ("fsar", 32, "coordination_success < 1", ["window"]),
        ("cfc", 22, "recovery_containment < 1", []),
        pytest.param("dhma", 8, "reassignment_latency_s > 0", [], marks=pytest.mark.soak),
    ],
)
def test_what_only_makes_the_outcome_defined_is_no_cause_of_it(
    architecture: str, number: int, text: str, kinds: list[str]
) -> None:
    base = again(simulated(architecture, number))
    found = cause(base, outcome_of(text))
    require_smallest(base, outcome_of(text), found)
    assert sorted({one.name.partition(":")[0] for one in found.elements}) == kinds
    assert any(one.name.startswith("task:") for one in found.presupposed)


def test_a_future_without_a_value_has_not_avoided_the_outcome() -> None:
    base = again(simulated("dhma", 8))
    for one in curve(base, outcome_of("reassignment_latency_s > 0"), futures=6, moments=4).chances:
        assert (one.avoided, one.futures + one.undefined) == (0, 6)
        assert (one.share is None) == (one.futures == 0)


def outcomes_of(record: LedgerRun, draw: Random) -> list[str]:
    """Conditions that the run meets, on some metrics."""
    found = []
    for name, worse in (
        *(("policy_violations", ">"), ("authority_conflicts", ">"), ("human_intervention", ">")),
        *(("coordination_success", "<"), ("recovery_containment", "<"), ("reassignment_latency_s", ">")),
    ):
        value = metric(record, name)
        if value is not None and ((worse == ">" and value > 0) or (worse == "<" and value < 1)):
            bound = value * draw.uniform(0.2, 0.9) if worse == ">" else value + (1 - value) * draw.uniform(0.1, 0.8)
            found.append(f"{name} {worse} {bound:.6f}")
    return found


@pytest.mark.parametrize(
    "outcomes", [pytest.param(2, marks=pytest.mark.slow), pytest.param(50, marks=pytest.mark.soak)]
)
def test_causes_of_random_outcomes_suffice_and_are_smallest(outcomes: int) -> None:
    draw = Random(15)
    judged = 0
    while judged < outcomes:
        record = simulated(
            draw.choice(("fsar", "cfc", "dhma")), draw.randrange(20), scenario=draw.choice(PAPER_SCENARIOS)
        )
        asked = outcomes_of(record, draw)
        if not asked:
            continue
        base, outcome = again(record), outcome_of(draw.choice(asked))
        try:
            found = cause(base, outcome)
        except UsageError:  # it occurs even if nothing happens
            assert Search(base, outcome).holds(frozenset())
            continue
        require_smallest(base, outcome, found)
        judged += 1


@pytest.mark.slow
def test_lengths_can_be_causes_too() -> None:
    base = again(simulated("fsar", VIOLATES))
    found = cause(base, VIOLATED, lengths=True)
    require_smallest(base, VIOLATED, found, lengths=True)
    assert found.candidates > len(Search(base, VIOLATED).candidates)


@pytest.mark.slow
def test_a_length_is_taken_away_by_the_answer_that_its_law_has_in_the_middle() -> None:
    base = again(simulated("fsar"))
    record = base.base.record
    time_us = next(
        time_us
        for time_us, event in zip(record.times_us, record.events, strict=True)
        if isinstance(event, ExecutionFinished) and event.subject.action_id == "A1-1/1.1"
    )
    then = outcome_of(
        "SELECT run_id FROM events WHERE type = 'ExecutionFinished.v1' AND action_id = 'A1-1/1.1' "
        f"AND time_us = {time_us}"
    )
    found = cause(base, then, lengths=True)
    lengths = [one for one in found.elements if one.seq is None]
    assert "execution:A1-1/1.1" in [one.name for one in lengths]
    for one in lengths:
        forked = base.fork_with_effect(parsed([one.change])).record
        assert then.of([(forked.times_us, forked.caused_by, forked.events)]) == [not one.is_necessary]


def test_an_outcome_that_the_run_does_not_have_has_no_cause() -> None:
    with pytest.raises(UsageError, match="the run does not have it"):
        cause(again(simulated("fsar")), outcome_of("policy_violations > 1"))


def test_an_outcome_that_needs_nothing_has_no_cause() -> None:
    with pytest.raises(UsageError, match="occurs even if nothing happens"):
        cause(again(simulated("fsar")), outcome_of("policy_violations < 5"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("policy_violatons > 0", "did you mean policy_violations"),
        ("i9 > 0", "there is no metric or invariant i9"),
        ("policy_violations", "expected a metric or an invariant and a number"),
        ("policy_violations > much", "expected a metric or an invariant and a number"),
        ("", "expected a metric or an invariant and a number"),
    ],
)
def test_an_outcome_that_cannot_be_read_is_an_error(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        outcome_of(text)


def test_an_outcome_can_be_an_invariant_or_a_select() -> None:
    violated, quiet = simulated("cfc"), simulated("fsar", 1)
    runs = [(run.times_us, run.caused_by, run.events) for run in (violated, quiet)]
    assert outcome_of("policy_violations > 0").of(runs) == [True, False]
    assert outcome_of("i2 = 0").of(runs) == [False, True]
    assert outcome_of("I2 > 0").of(runs) == [True, False]
    empty = (violated.times_us[:1], violated.caused_by[:1], violated.events[:1])
    assert outcome_of("coordination_success < 1").of([*runs, empty])[2] is None
    assert outcome_of("SELECT run_id FROM run_started WHERE architecture = 'fsar'").of(runs) == [False, True]


@pytest.mark.parametrize(
    "select",
    [
        "SELECT 1 AS one",
        "SELECT run_id FROM nothing",
        "SELECT run_id FROM '/etc/passwd'",
        "SELECT 1; DROP TABLE events",
    ],
)
def test_a_select_that_gives_no_runs_is_an_error(select: str) -> None:
    run = simulated("fsar", 1)
    with pytest.raises((QueryFailed, UnknownQuery)):
        outcome_of(select).of([(run.times_us, run.caused_by, run.events)])


@pytest.mark.slow
def test_before_its_window_opens_a_violation_can_be_avoided_and_after_it_cannot() -> None:
    base = again(simulated("fsar", VIOLATES))
    found = curve(base, VIOLATED, futures=12, moments=8)
    (name,) = [one.name for one in cause(base, VIOLATED).elements if one.name.startswith("window:")]
    assert found.closing_seq is not None
    closing = base.base.record.events[found.closing_seq]
    assert isinstance(closing, PolicyWindowOpened)
    assert f"window:{closing.window}" == name
    assert found.last_open_s is not None
    for one in found.chances:
        assert None not in (one.low, one.share, one.high)
        assert (one.low or 0.0) <= (one.share or 0.0) <= (one.high or 0.0)
        assert (one.avoided > 0) or one.at_s > found.last_open_s
    assert [one.at_s for one in found.chances] == sorted(one.at_s for one in found.chances)


def test_a_future_has_all_that_happens_in_its_world_from_its_moment_on(monkeypatch: pytest.MonkeyPatch) -> None:
    moment_us, worlds, played = 60_000_000, list[World](), list[tuple[Fact, ...]]()
    kinds = (RoutineDue, PeersMet, ContextChanged)  # again and again, under no name of their own

    class Played(Exception): ...

    def met(_: Recipe, world: World) -> Kernel:
        played.append(tuple(world.facts))
        raise Played

    base = again(simulated("fsar", VIOLATES))
    for number in range(8):
        spec = base.base.recipe.spec
        worlds.append(environment_of(msgspec.structs.replace(spec, seed=spec.seed + 1 + number), Constants()))
        monkeypatch.setattr(avoidability, "kernel_of", met)
        with pytest.raises(Played):
            avoidability._future(base, moment_us, worlds[-1])
    for world, facts in zip(worlds, played, strict=True):
        for kind in kinds:
            later, drawn = (
                [time_us for time_us, one in each if isinstance(one, kind) and time_us > moment_us]
                for each in (facts, world.facts)
            )
            assert later == drawn


def test_an_outcome_that_never_comes_is_avoided_to_the_end() -> None:
    found = curve(again(simulated("fsar")), outcome_of("policy_violations > 99"), futures=3, moments=3)
    assert [one.avoided for one in found.chances] == [3, 3, 3]
    assert found.closing_seq is None


def test_what_is_decided_while_nothing_happens_is_closed_by_the_next_event() -> None:
    run = simulated("fsar")
    begins_us, ends_us = 136_881_061, 146_006_465  # moments between two events of the run
    assert not any(begins_us < time_us <= ends_us for time_us in run.times_us)
    quiet = outcome_of(
        "SELECT run_id FROM runs WHERE run_id NOT IN "
        f"(SELECT run_id FROM events WHERE time_us > {begins_us} AND time_us <= {ends_us})"
    )
    found = curve(again(run), quiet, futures=2, moments=28)
    assert begins_us / 1_000_000 in [one.at_s for one in found.chances if one.avoided]
    assert not any(one.avoided for one in found.chances if one.at_s > begins_us / 1_000_000)
    assert found.last_open_s == begins_us / 1_000_000
    assert found.closing_seq == next(seq for seq, time_us in enumerate(run.times_us) if time_us > ends_us)
