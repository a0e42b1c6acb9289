"""The state at a moment is that of a fresh simulation which was stopped then."""

from pathlib import Path

import pytest

import fsar_ledger
from fsar_ledger.analysis.moments import EVERY, Timeline
from fsar_ledger.analysis.situation import Situation, situation
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.events.policy import RolePolicyRuleSet
from fsar_ledger.events.trust import InitialTrustSet
from fsar_ledger.events.world import OutsiderRequestInjected
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.architectures.fsar.reports import JudgeRequest, ReportPresence, ReportWindow
from fsar_ledger.runtime.simulation import RunSpec, kernel, simulate_run
from fsar_ledger.view.spans import spans_of
from tests.analysis.conftest import OUTAGES, simulated
from tests.runtime.test_live import OPENING, A, B, Play, at_the_door

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


def now(play: Play) -> Situation:
    """How things stand at the end of the run."""
    timeline = Timeline(play.record)
    return situation(timeline.past(len(play.record.events) - 1), {}, None)


def test_a_request_stands_with_the_robot_to_which_it_has_gone_or_that_has_it() -> None:
    play = at_the_door()
    assert [(one.action_id, one.target, one.phase) for one in now(play).requests or ()] == [(OPENING, B, "asked")]
    play.does(ReportPresence(robot=B, is_on=False), JudgeRequest(robot=B, action_id=OPENING, accepts=True))
    assert [(one.target, one.phase) for one in now(play).requests or ()] == [(B, "received")]


@pytest.mark.parametrize("architecture", ["fsar", "cfc", "dhma", "jade", "alliance", "roboos"])
def test_an_outsiders_request_is_open_until_it_was_denied_or_executed(architecture: str) -> None:
    record = simulate_run(RunSpec(7, architecture, "full", "mixed-trust-inspection", 4, 0), Constants())
    timeline, types = Timeline(record), [type(event) for event in record.events]
    first, last = (
        [one.action_id for one in situation(timeline.past(seq), {}, None).requests or ()]
        for seq in (types.index(OutsiderRequestInjected), len(types) - 1)
    )
    assert any(name.startswith("injected-1-") for name in first)
    assert last == []


def test_an_own_step_is_no_request_to_somebody_unknown() -> None:
    timeline = Timeline(simulated("fsar", 0, Constants()))
    for seq in range(0, timeline.seq_at(60_000_000), 5):
        past = timeline.past(seq)
        for one in situation(past, {}, None).requests or ():
            if (action := past.state.execution.actions.get(one.action_id)) is not None:
                assert one.target == action.robot


def test_windows_of_one_name_stand_each_since_it_opened_itself() -> None:
    play = Play()
    for robot, scope in ((B, "local"), (B, "fleet"), (A, "local")):
        play.does(ReportWindow(robot=robot, scope=scope, window="night", outcome="deny"))  # type: ignore[arg-type]
    windows = ((one.robot, each) for one in now(play).robots or () for each in one.windows or ())
    found = {(robot, each.scope): round(each.since_s) for robot, each in windows}
    assert found == {(B, "local"): 1, (B, "fleet"): 2, (A, "local"): 3}


def test_the_trust_and_the_rules_of_a_robot_are_those_of_its_role_too() -> None:
    timeline = Timeline(simulated("fsar"))
    past = timeline.past(timeline.seq_at(0))
    for role in ("C", "D"):
        ruled = RolePolicyRuleSet(scope="fleet", role=role, outcome="deny", decided_by=FLEET_SUPERVISOR)
        past.add(ruled, past.time_us)

    def shown(robot: str | None) -> tuple[set[tuple[str, str]], list[str | None]]:
        found = situation(past, {}, robot)
        return {(one.robot, one.peer) for one in found.trust or ()}, [one.robot for one in found.rules or ()]

    trust, rules = shown(None)
    assert trust == {(f"role {one}", f"role {other}") for one, other in ("AB", "BA", "AD", "DA", "BC", "CB")}
    assert rules == ["role C", "role D"]
    assert shown("robot/D1") == ({("role A", "role D"), ("role D", "role A")}, ["role D"])
    assert shown("robot/A1") == ({one for one in trust if "role A" in one}, [])


def test_the_initial_trust_of_a_robot_that_joined_later_is_shown() -> None:
    timeline = Timeline(simulated("fsar"))
    past = timeline.past(timeline.seq_at(0))
    for is_trusting, scope in ((True, "session"), (False, "task")):
        initial = InitialTrustSet(robot=B, scope=scope, is_trusting=is_trusting, decided_by=FLEET_SUPERVISOR)  # type: ignore[arg-type]
        past.add(initial, past.time_us)
    for robot in (None, B):
        found = [(one.robot, one.peer, one.scope) for one in situation(past, {}, robot).trust or ()]
        assert found[-2:] == [(B, "every robot", "session"), ("every robot", B, "task")]
    assert not any("every robot" in (one.robot, one.peer) for one in situation(past, {}, A).trust or ())


def test_nothing_is_said_of_what_a_silent_robot_does_and_a_call_that_came_to_nothing_is_not_open(
    tmp_path: Path,
) -> None:
    now, fleet, b = [1_772_359_200], "supervisor/fleet", "robot/B1"
    periods = {"heartbeat_us": 2_000_000, "suspect_us": 4_000_000, "depart_us": 4_000_000}
    settings = [f"membership.{name}={period_us}" for name, period_us in periods.items()]
    with fsar_ledger.federate(
        tmp_path / "ledger", run="day", settings=settings, clock=lambda: now[0] * 1_000_000_000
    ) as hall:
        hall.give("ReportPresence", b, robot=b, is_on=True)
        hall.give("SetSupervisionDensity", fleet, issued_by=fleet, robot=b, review_every=1, reason="test")
        steps = ["A door.open.secure B"]
        hall.give("SubmitTask", "service/hub", robot="robot/A1", task_id="t", steps=steps, budget_us=600_000_000)
        hall.give("JudgeRequest", b, robot=b, action_id="t/1.1", accepts=True)
        for _ in range(20):
            now[0] += 1
            hall.advance()
    seen, ledger = [], fsar_ledger.Ledger(tmp_path / "ledger")
    for at_s in (1, 5, 10, None):  # the task goes on after 15 s
        found = ledger.state("day", at=at_s)
        [silent] = [robot for robot in found.standing.robots or () if robot.robot == b]
        seen.append((silent.is_idle, silent.departed, len(found.standing.calls or ())))
    assert seen == [(True, None, 1), (None, None, 1), (None, "silent", 0), (None, "silent", 0)]
    [call] = [span for span in spans_of(ledger.record("day")) if span.fact.track == "call"]
    assert call.end_us is not None
    assert 5_000_000 < call.end_us < 10_000_000
