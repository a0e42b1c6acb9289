"""What is done without a mechanism is what its text says, and no more is taken out."""

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.events.configuration import Configuration
from fsar_ledger.events.envelope import Architecture, Principal, Robot, Scenario, Service
from fsar_ledger.events.execution import ExecutionHeld, ExecutionQueued, RoutineWithheld
from fsar_ledger.events.knowledge import WorkQueued
from fsar_ledger.events.recovery import RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.database import from_table
from fsar_ledger.metrics.results import metric_rows
from fsar_ledger.runtime.knockouts import decided_by
from fsar_ledger.runtime.simulation import SCENARIOS, RunSpec, simulate_run
from tests import past
from tests.runtime.pinned import PINNED


def played(
    architecture: Architecture,
    configuration: Configuration,
    scenario: Scenario,
    run: int,
    constants: Constants = Constants(),  # noqa: B008
) -> LedgerRun:
    return simulate_run(RunSpec(5, architecture, configuration, scenario, 4, run), constants)


@pytest.mark.parametrize(
    ("configuration", "expected"),
    [
        ("full", {"delegated", "own", "motion"}),
        ("without-start-recheck", {"own", "motion"}),
        ("without-own-work-check", {"delegated"}),
        ("without-start-recheck+own-work-check", set()),
    ],
)
def test_the_check_again_of_delegated_work_and_the_one_check_of_own_work_are_two_mechanisms(
    configuration: str, expected: set[str]
) -> None:
    events = played("fsar", configuration, "door-relay", 3, PINNED).events
    is_delegated = {
        event.subject.action_id: event.is_delegated for event in events if isinstance(event, ExecutionQueued)
    }
    held = {
        "delegated" if is_delegated[event.subject.action_id] else "own"
        for event in events
        if isinstance(event, ExecutionHeld)
    }
    assert held | {"motion" for event in events if isinstance(event, RoutineWithheld)} == expected


def of_recovery(attempts: int, budget_us: int) -> tuple[list[tuple[int, Principal | None]], list[int], set[str]]:
    """The attempts with who decided them, those that failed, and what of recovery the coordinator was given."""
    given = Constants()
    structure = msgspec.structs.replace(given.structure, local_attempts=attempts, local_budget_us=budget_us)
    events = played(
        "cfc",
        "without-central-recovery",
        "failure-recovery-chain",
        2,
        msgspec.structs.replace(given, structure=structure),
    ).events
    tried = [(event.number, event.principals.decided_by) for event in events if isinstance(event, RecoveryAttempted)]
    failed = [event.number for event in events if isinstance(event, RecoveryAttemptFailed)]
    return (
        tried,
        failed,
        {event.item for event in events if isinstance(event, WorkQueued)} & {"failure", "retry-failed"},
    )


def test_a_robot_that_recovers_alone_records_each_failed_attempt_and_keeps_to_its_budget() -> None:
    tried, failed, given = of_recovery(2, 30_000_000)
    assert {number for number, _ in tried} == {1, 2}
    assert failed.count(1) == sum(number == 2 for number, _ in tried)
    assert given == set(), "the coordinator hears of the last failed attempt alone"
    tried, failed, given = of_recovery(2, 1)
    assert {number for number, _ in tried} == {1}, "the time is over when the first attempt ends"
    assert (set(failed), given) == ({1}, {"retry-failed"})
    tried, _, given = of_recovery(0, 30_000_000)
    assert {decided_by for _, decided_by in tried} <= {"coordinator"}, (
        "a robot that may not try leaves it to the coordinator"
    )
    assert "failure" in given


def test_without_the_queue_nothing_waits_for_the_coordinator_not_even_what_no_helper_answered() -> None:
    outages = msgspec.structs.replace(Constants(), outages=Outages(off_rate_per_s=0.01, link_rate_per_s=0.02))
    queued = [
        (time, event)
        for run in range(12)
        for made in [played("cfc", "without-coordinator-queue", "failure-recovery-chain", run, outages)]
        for time, event in zip(made.times_us, made.events, strict=True)
        if isinstance(event, WorkQueued)
    ]
    assert "no answer" in {event.item for _, event in queued}
    assert [event for time, event in queued if event.ready_us > time] == []


def test_who_is_not_known_is_on_record_as_nobody_and_not_as_an_empty_name() -> None:
    closed = past.closed("action", past.principals(Service("coordination")), "task")
    [(unknown, no_path), (known, path)] = [
        (one.principals.decided_by, one.principals.path)  # type: ignore[attr-defined]
        for one in (decided_by(closed, name) for name in (None, Robot("robot/a")))
    ]
    assert (unknown, no_path) == (None, ())
    assert (known, path) == ("robot/a", ("robot/a",))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("architecture", "configuration", "carried"),
    [
        ("fsar", "without-layered-recovery", ("recovery_containment", "human_intervention")),
        ("cfc", "without-safe-stop-claims", ("authority_conflicts",)),
    ],
)
def test_without_a_mechanism_the_numbers_that_it_carries_are_others(
    architecture: Architecture, configuration: Configuration, carried: tuple[str, ...]
) -> None:
    def measured(configuration: Configuration) -> dict[str, float | None]:
        specs = (
            RunSpec(42, architecture, configuration, scenario, 4, run) for scenario in SCENARIOS for run in range(3)
        )
        with from_table(encode([simulate_run(spec, Constants()) for spec in specs]), threads=1) as database:
            return {row.metric: row.mean for row in metric_rows(database)}

    whole, without = measured("full"), measured(configuration)
    for metric in carried:
        assert whole[metric] != without[metric]
