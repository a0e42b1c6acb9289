"""Handlers that break a rule are caught by the invariants, and baselines and ablations break what they give up."""

from typing import Any

import pytest

from fsar_ledger.events import Event
from fsar_ledger.events.configuration import Configuration
from fsar_ledger.events.envelope import Architecture, Scenario, with_columns
from fsar_ledger.events.execution import ExecutionStarted, RoutinePerformed, RoutineWithheld
from fsar_ledger.events.recovery import RecoveryEscalated
from fsar_ledger.events.request import RequestAccepted
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.invariants import audit_rows, chosen, invariants
from fsar_ledger.runtime.architectures import HandlerTable
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.execution import start as start_as_fsar
from fsar_ledger.runtime.handlers.commands import DecideRoutine, StartAction
from fsar_ledger.runtime.handlers.execution import started
from tests.queries.test_invariants import RUNS, record
from tests.recycled import from_table


def changed(event: type[Event], **fields: Any) -> HandlerTable:
    """FSAR, with every handler that emits this event saying something else in it."""

    def mutated(decide: Any) -> Any:
        return lambda state, command: tuple(
            with_columns(one, **fields) if isinstance(one, event) else one for one in decide(state, command)
        )

    return HandlerTable({command: mutated(decide) for command, decide in FSAR.decides.items()}, FSAR.reacts)


def unchecked_start(state: Any, command: StartAction) -> tuple[Any, ...]:
    """FSAR's handler without its look at policy."""
    would_be = start_as_fsar(state, command)
    return (started(state, state.execution.actions[command.action_id], command),) if would_be else ()


def unchecked_routine(state: Any, command: DecideRoutine) -> tuple[Any, ...]:
    """FSAR's handler, which moves whatever it is told."""
    return tuple(
        RoutinePerformed(one.principals, one.robot, one.operation)
        for one in FSAR.decides[DecideRoutine](state, command)
        if isinstance(one, RoutinePerformed | RoutineWithheld)
    )


MUTATED: tuple[tuple[str, HandlerTable], ...] = (
    ("i2 a4", changed(RequestAccepted, decided_by="service/coordination")),
    ("i4", changed(RecoveryEscalated, level="fleet")),
    ("a5", changed(ExecutionStarted, supervised_by=None)),
    ("a2", changed(ExecutionStarted, executed_by="service/recovery")),
    ("i3 a3", HandlerTable({**FSAR.decides, StartAction: unchecked_start}, FSAR.reacts)),
    ("i3", HandlerTable({**FSAR.decides, DecideRoutine: unchecked_routine}, FSAR.reacts)),
)


@pytest.mark.parametrize(("names", "structure"), MUTATED, ids=[f"{one}-{at}" for at, (one, _) in enumerate(MUTATED)])
def test_a_mutated_handler_is_caught(names: str, structure: HandlerTable) -> None:
    with from_table(encode([record(*run, structure=structure) for run in RUNS]), threads=1) as database:
        assert [row.holds for row in audit_rows(database, chosen(names.split()))] == [False] * len(names.split())


BROKEN_BY_DESIGN = {
    ("cfc", "full"): {"i2", "i3", "i4", "i5", "a1", "a3", "a4", "a5"},
    ("dhma", "full"): {"i1", "i2", "i3", "i4", "i5", "a1", "a3", "a4"},
    ("fsar", "without-layered-recovery"): {"i4"},
    ("fsar", "without-policy-composition"): {"i3", "a3"},
    ("fsar", "without-shared-registry"): {"i5"},
}


@pytest.mark.parametrize(
    ("architecture", "configuration"),
    [
        broken if broken == ("fsar", "without-policy-composition") else pytest.param(*broken, marks=pytest.mark.slow)
        for broken in BROKEN_BY_DESIGN
    ],
)
def test_what_a_baseline_or_an_ablation_gives_up_is_reported_and_nothing_else(
    architecture: Architecture, configuration: Configuration
) -> None:
    scenarios: tuple[Scenario, ...] = (
        "door-relay",
        "collaborative-delivery",
        "failure-recovery-chain",
        "fleet-contention",
    )
    records = [record(scenario, run, architecture, configuration) for scenario in scenarios for run in range(8)]
    with from_table(encode(records), threads=1) as database:
        broken = {row.invariant[:2] for row in audit_rows(database, invariants()) if row.events}
    assert broken == BROKEN_BY_DESIGN[architecture, configuration]
