"""An actuator holds as far as it is sound, and what an attempt with it achieves. Paper: sec:model:recovery."""

import msgspec
import pytest

from fsar_ledger.events.envelope import Subject
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.recovery import AttemptRolledBack, RecoveryAttempted, RecoveryAttemptFailed
from fsar_ledger.events.supervision import ActuatorServiced
from fsar_ledger.events.world import ActuatorDegraded, Grade
from fsar_ledger.projections.fold import apply
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.architectures.fsar.recovery import RollBack, StartRecovery
from fsar_ledger.runtime.handlers.commands import EndAttempt, FinishAttempt
from tests.runtime.failures import ACTION, D, executing, failed, taken
from tests.runtime.live import decided


@pytest.mark.parametrize(
    ("grade", "drawn", "holds"),
    [(None, 0, True), ("unreliable", 1, True), ("unreliable", 0, False), ("slipping", 1, False), ("lost", 1, False)],
)
def test_an_actuator_holds_as_far_as_it_is_sound(grade: Grade | None, drawn: int, holds: bool) -> None:
    worn = () if grade is None else (ActuatorDegraded(D, grade),)
    [ended] = decided(
        executing(D, "grasp.robust", *worn), FinishAttempt(ACTION, 3_000_000, now_us=3_000_000, answer=drawn)
    )
    assert isinstance(ended, ExecutionFailed) is not holds


def test_a_slipping_grip_achieves_part_of_its_contract_which_is_rolled_back_and_is_lost_after_it() -> None:
    state = failed(executing(D, "grasp.robust", ActuatorDegraded(D, "slipping")), cause="degradation", failure=2)
    taken(state, decided(state, StartRecovery(ACTION, now_us=2_000_001)))
    [first] = taken(state, decided(state, EndAttempt(ACTION, 1, now_us=4_000_000, answer=1)))
    assert first == RecoveryAttemptFailed(
        subject=Subject("A1-1", ACTION), robot=D, failure=2, number=1, result="partial", achieved=("load.gripped",)
    )
    assert state.world.degraded == {D: "lost"}
    [back] = [one for react in FSAR.reacts[RecoveryAttemptFailed] for one in react(state, first, 4_000_000)]
    assert back.command == RollBack(ACTION, 2, 1, ("load.gripped",))
    assert [wait.what for wait in back.waits] == ["retry"], "it takes time"
    undone, again = taken(state, decided(state, msgspec.structs.replace(back.command, now_us=5_500_000)))
    assert undone == AttemptRolledBack(
        subject=Subject("A1-1", ACTION), robot=D, failure=2, number=1, undone=("load.gripped",)
    )
    assert isinstance(again, RecoveryAttempted)
    second, _ = taken(state, decided(state, EndAttempt(ACTION, 2, now_us=6_000_000, answer=1)))
    assert second == RecoveryAttemptFailed(
        subject=Subject("A1-1", ACTION), robot=D, failure=2, number=2, result="failure", achieved=()
    )
    apply(state, ActuatorServiced(D))
    assert state.world.degraded == {}


def test_an_unreliable_actuator_that_fails_is_not_worn_by_it() -> None:
    state = failed(executing(D, "grasp.robust", ActuatorDegraded(D)), cause="degradation")
    taken(state, decided(state, StartRecovery(ACTION, now_us=2_000_001)))
    ended, _ = taken(state, decided(state, EndAttempt(ACTION, 1, now_us=4_000_000, answer=0)))
    assert ended == RecoveryAttemptFailed(subject=Subject("A1-1", ACTION), robot=D, failure=1, number=1)
    assert state.world.degraded == {D: "unreliable"}
