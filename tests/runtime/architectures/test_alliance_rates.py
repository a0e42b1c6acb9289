"""ALLIANCE: with rates of their own teammates that sense a need together do not all start."""

from fsar_ledger.designs.dials import Alliance
from fsar_ledger.events.execution import ExecutionQueued
from fsar_ledger.events.task import TaskCompleted
from tests.runtime.architectures.test_alliance import B2, FAR, HOP, B, S, of, ran
from tests.runtime.live import when

BOTH_SENSE_IT = [(S, FAR)]
"""Two robots that can open the door learn of it by messages that take the same time."""


def test_with_equal_rates_teammates_that_sense_a_need_together_both_start() -> None:
    assert len(when(ran(BOTH_SENSE_IT), ExecutionQueued)) > 1
    assert {event.robot for event in of(ran(BOTH_SENSE_IT), ExecutionQueued)} == {B, B2}


def test_with_rates_of_its_own_the_robot_of_the_second_team_is_slower_and_hears_the_first_in_time() -> None:
    run = ran(BOTH_SENSE_IT, dials=Alliance(stagger_us=2 * HOP))
    assert {event.robot for event in of(run, ExecutionQueued)} == {B}
    assert when(run, TaskCompleted)
