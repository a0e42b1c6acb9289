"""The state at a moment is that of a fresh simulation which was stopped then."""

import pytest

from fsar_ledger.analysis.moments import EVERY, Timeline
from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.simulation import RunSpec, kernel
from tests.analysis.conftest import OUTAGES, simulated

CELLS = [(architecture, constants) for architecture in ("fsar", "cfc", "dhma") for constants in (Constants(), OUTAGES)]


@pytest.mark.parametrize(("architecture", "constants"), CELLS)
@pytest.mark.parametrize(
    ("run", "step"), [(0, 7), *(pytest.param(run, 1, marks=pytest.mark.slow) for run in range(1, 5))]
)
def test_the_state_at_a_time_is_that_of_a_simulation_stopped_then(
    architecture: str, constants: Constants, run: int, step: int
) -> None:
    record = simulated(architecture, run, constants)
    timeline = Timeline(record)
    stopped = kernel(RunSpec(42, architecture, "full", "door-relay", 4, run), constants)
    for time_us in sorted(set(record.times_us))[::step]:
        stopped.run(time_us)
        assert len(stopped.events) == timeline.seq_at(time_us) + 1
        assert timeline.past(timeline.seq_at(time_us)).state == stopped.state


def test_the_state_after_an_event_does_not_depend_on_what_is_kept(runs: list[LedgerRun]) -> None:
    for record in runs:
        timeline = Timeline(record)
        assert len(record.events) > EVERY
        for seq in (0, 1, EVERY - 2, EVERY - 1, EVERY, EVERY + 1, len(record.events) - 1):
            assert timeline.past(seq).state == fold(record.events[: seq + 1])


def test_states_of_two_moments_do_not_share_what_changes(runs: list[LedgerRun]) -> None:
    timeline = Timeline(runs[0])
    before = timeline.past(100).state
    again = timeline.past(100).state
    timeline.past(101)
    assert before == again
    assert before is not again
