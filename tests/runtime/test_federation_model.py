"""Random commands over random fleets: no invariant breaks, nothing raises, and what is rebuilt is what lives.

`python -m tests.runtime.test_federation_model 200000` plays at least so many steps and prints its counts.
"""

import sys
from collections import Counter
from typing import Any, get_args

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import OverrideLevel, Result, Robot
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import RequestIssued
from fsar_ledger.events.world import (
    ActuatorDegraded,
    ContextChanged,
    ObstructionAppeared,
    ObstructionCleared,
    PolicyWindowClosed,
    PolicyWindowOpened,
    SupervisorLeft,
    SupervisorReturned,
)
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.invariants import audit_rows, chosen
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import surface
from fsar_ledger.runtime.architectures.fsar.reports import ReportPresence
from fsar_ledger.runtime.handlers.commands import Command, acting
from fsar_ledger.runtime.handlers.fleet import JoinFleet, LeaveFleet
from fsar_ledger.runtime.handlers.request import AnswerOffer, ReportResult, RequestCapability
from fsar_ledger.runtime.handlers.supervision import RespondToCall
from fsar_ledger.runtime.handlers.task import SubmitTask
from fsar_ledger.runtime.handlers.trust import SetTrustThresholds
from tests import past
from tests.recycled import from_table
from tests.runtime.bench import HELPER, PUBLIC, ROBOTS, TRUST, Bench, arguments, founding

COUNTS: Counter[str] = Counter()
FINAL_STEPS = 5_000
MEMBERSHIP = ("RobotDeparted", "RobotReturned", "RobotSuspected", "RobotCleared")


class Federation(RuleBasedStateMachine):
    """One fleet, played by whoever may command it."""

    def __init__(self) -> None:
        super().__init__()
        self.bench: Bench | None = None
        self.things = 0
        self.has_helper = False

    @initialize(fleet=ROBOTS, trust=TRUST, has_helper=st.booleans())
    def found(self, fleet: list[Any], trust: list[Any], has_helper: bool) -> None:
        self.bench = Bench(founding(fleet, trust, has_helper))
        self.has_helper = has_helper

    @property
    def live(self) -> Bench:
        assert self.bench is not None
        return self.bench

    def robot(self, data: st.DataObject) -> Robot:
        return data.draw(st.sampled_from([name for name in self.live.state.fleet.robots if name != HELPER]))

    def new(self, kind: str) -> str:
        self.things += 1
        return f"{kind}/{self.things}"

    @rule(data=st.data(), times=st.integers(1, 5))
    def command(self, data: st.DataObject, times: int) -> None:
        for _ in range(times):
            self.command_once(data)

    def command_once(self, data: st.DataObject) -> None:
        kind = data.draw(st.sampled_from(PUBLIC))
        self.play(kind(**data.draw(arguments(self.live.state, kind))))

    def play(self, command: Command) -> None:
        """Give the command; check that a rejection changes nothing."""
        if self.has_helper and isinstance(command, SetTrustThresholds):
            return  # the helper's trust stays
        before = {slot: getattr(self.live.state, slot) for slot in State.__slots__}
        events = self.live.issue(command)
        if any(isinstance(event, CommandRejected) for event in events):
            assert len(events) == 1
            assert before == {slot: getattr(self.live.state, slot) for slot in State.__slots__}
            COUNTS["rejections"] += 1
        COUNTS["commands"] += 1
        if (
            self.has_helper
            and isinstance(command, JoinFleet)
            and any(isinstance(event, RobotJoined) for event in events)
        ):
            self.live.let_happen(past.trusted(HELPER, command.robot, "persistent"))

    @rule(data=st.data(), override=st.sampled_from(get_args(OverrideLevel)), urgent=st.booleans())
    def ask_whom_one_trusts(self, data: st.DataObject, override: OverrideLevel, urgent: bool) -> None:
        """A request that has a good chance: the executor trusts the requester and offers the capability."""
        state = self.live.state
        able = [
            (requester, executor, offer.capability)
            for (executor, requester), entries in state.trust.entries.items()
            if any(scope != "none" for scope in entries.values())
            for offer in surface(state.registry, executor)
        ]
        if able:
            requester, executor, capability = data.draw(st.sampled_from(able))
            parents = [
                None,
                *(
                    name
                    for name, action in state.execution.actions.items()
                    if action.is_delegated and action.robot == requester
                ),
            ]
            level: OverrideLevel = override if urgent else "none"
            name = self.new("action")
            self.play(
                RequestCapability(
                    requester,
                    executor,
                    capability,
                    self.new("context"),
                    name,
                    level,
                    data.draw(st.sampled_from(parents)),
                )
            )

    @rule(
        data=st.data(), budget_us=st.sampled_from([1_000_000, 30_000_000, 90_000_000]), is_time_critical=st.booleans()
    )
    def give_a_task(self, data: st.DataObject, budget_us: int, is_time_critical: bool) -> None:
        """A task that members of one team can do, some of it by others."""
        state = self.live.state
        owner = self.robot(data)
        team = [
            robot
            for robot in state.fleet.robots.values()
            if robot.team == state.fleet.robots[owner].team and robot.name != HELPER
        ]
        own = [f"{robot.role} {module}" for robot in team for module in state.registry.modules.get(robot.name, ())]
        others = [
            f"{robot.role} {module} X"
            for robot in team
            for modules in state.registry.modules.values()
            for module in modules
        ]
        if own and others:
            steps = tuple(data.draw(st.lists(st.sampled_from(own + others), min_size=1, max_size=4)))
            self.play(SubmitTask(owner, self.new("task").replace("/", "-"), steps, budget_us, None, is_time_critical))

    @rule(data=st.data())
    def carry_on(self, data: st.DataObject) -> None:
        """Whoever is asked something answers: an offer, a call, a result."""
        state = self.live.state
        answers: list[Command] = [
            RespondToCall(call.supervisor, call.subject.action_id, approves)
            for call in state.supervision.calls.values()
            for approves in (True, False)
        ]
        answers += [
            AnswerOffer(request.requester, name, is_accepted)
            for name, request in state.request.open.items()
            if request.offered is not None
            for is_accepted in (True, False)
        ]
        fences = state.fleet.fences
        answers += [
            ReportResult(action.robot, name, result, fence=fences.get(action.robot))
            for name, action in state.execution.actions.items()
            if action.stage == "running"
            for result in get_args(Result)
        ]
        if answers:
            self.play(data.draw(st.sampled_from(answers)))

    @rule(times=st.integers(1, 25))
    def proceed(self, times: int) -> None:
        for _ in range(times):
            if not self.live.proceed():
                return
            COUNTS["steps"] += 1

    @rule(data=st.data())
    def leave_the_fleet(self, data: st.DataObject) -> None:
        """A member leaves; what it had must not stay open."""
        robot = self.robot(data)
        self.play(LeaveFleet(robot))
        self.check_departed(robot)

    def check_departed(self, robot: Robot) -> None:
        state = self.live.state
        if robot not in state.fleet.departed:
            return
        COUNTS["departed, checked"] += 1
        assert robot not in state.execution.current
        assert not state.execution.queues.get(robot)
        assert not [one for held in state.authority.claims.values() for one in held if one.claimant == robot]
        assert all(record.availability == "offline" for record in surface(state.registry, robot))
        for task in state.task.values():
            if not task.action_id or acting(task, task.step) != robot:
                continue
            request, action = state.request.open[task.action_id], state.execution.actions.get(task.action_id)
            is_taken_over = request.is_received and (action is None or action.robot != robot)
            is_settled = request.is_over or (action is not None and action.stage == "withdrawn")
            assert is_taken_over or is_settled or task.action_id in state.recovery, task

    @precondition(lambda self: self.bench is not None and self.bench.state.fleet.departed)
    @rule(data=st.data(), is_itself=st.sampled_from([True, True, True, False]))
    def return_to_the_fleet(self, data: st.DataObject, is_itself: bool) -> None:
        state = self.live.state
        known = state.fleet.robots[data.draw(st.sampled_from(list(state.fleet.departed)))]
        key = known.public_key if is_itself else "another"
        self.play(
            JoinFleet(known.name, known.role, known.team, known.supervisor, known.domain, known.place, public_key=key)
        )
        assert (known.name not in self.live.state.fleet.departed) is is_itself

    @rule(data=st.data())
    def say_that_one_is_there(self, data: st.DataObject) -> None:
        """A heartbeat: from then on the robot is watched, and its silence is found out."""
        robot = self.robot(data)
        self.play(ReportPresence(robot, True, fence=self.live.state.fleet.fences.get(robot)))

    @invariant()
    def nothing_waits_for_who_has_departed(self) -> None:
        if self.bench is not None:
            for robot in self.bench.state.fleet.departed:
                self.check_departed(robot)

    @rule(data=st.data(), scope=st.sampled_from(["local", "fleet"]), outcome=st.sampled_from(["deny", "review"]))
    def open_window(self, data: st.DataObject, scope: Any, outcome: Any) -> None:
        self.live.let_happen(
            PolicyWindowOpened(robot=self.robot(data), scope=scope, window=self.new("window"), outcome=outcome)
        )

    @rule(data=st.data())
    def close_window(self, data: st.DataObject) -> None:
        world = self.live.state.world
        opened = [(robot, "local", name) for robot, held in world.local.items() for name, _ in held]
        opened += [(robot, "fleet", name) for robot, held in world.fleet.items() for name, _ in held]
        if opened:
            robot, scope, window = data.draw(st.sampled_from(opened))
            self.live.let_happen(PolicyWindowClosed(robot, scope, window))  # type: ignore[arg-type]

    @rule(data=st.data())
    def change_context(self, data: st.DataObject) -> None:
        self.live.let_happen(ContextChanged(self.robot(data)))

    @rule(data=st.data(), grade=st.sampled_from(["unreliable", "slipping", "lost"]))
    def degrade(self, data: st.DataObject, grade: Any) -> None:
        self.live.let_happen(ActuatorDegraded(self.robot(data), grade))

    @rule(data=st.data())
    def obstruct(self, data: st.DataObject) -> None:
        self.live.let_happen(ObstructionAppeared(self.robot(data), self.new("obstruction")))

    @rule(data=st.data())
    def clear(self, data: st.DataObject) -> None:
        inside = [(robot, name) for robot, names in self.live.state.world.obstructions.items() for name in names]
        if inside:
            robot, obstruction = data.draw(st.sampled_from(inside))
            self.live.let_happen(ObstructionCleared(robot, obstruction))

    @rule(data=st.data())
    def leave(self, data: st.DataObject) -> None:
        present = [robot.supervisor for robot in self.live.state.fleet.robots.values() if robot.supervisor]
        present = [name for name in present if name not in self.live.state.world.off_shift]
        if present:
            self.live.let_happen(SupervisorLeft(data.draw(st.sampled_from(present))))

    @precondition(lambda self: self.bench is not None and self.bench.state.world.off_shift)
    @rule(data=st.data())
    def come_back(self, data: st.DataObject) -> None:
        self.live.let_happen(SupervisorReturned(data.draw(st.sampled_from(sorted(self.live.state.world.off_shift)))))

    @invariant()
    def what_is_rebuilt_is_what_lives(self) -> None:
        if self.bench is not None:
            COUNTS["checks"] += 1
            assert self.bench.rebuilt == self.bench.state

    def teardown(self) -> None:
        if self.bench is None:
            return
        for _ in range(FINAL_STEPS):  # what is under way comes to its end
            if not self.bench.proceed():
                waiting = [task for task in self.bench.state.task.values() if task.step < len(task.steps)]
                orphans = [task for task in waiting if acting(task, task.step) in self.bench.state.fleet.departed]
                assert orphans == [], "departures do not create orphaned tasks"
                break
            COUNTS["steps"] += 1
        COUNTS["histories"] += 1
        COUNTS["events"] += len(self.bench.events)
        COUNTS.update(f"event {type(event).__name__}" for event in self.bench.events)
        assert self.bench.refolded() == self.bench.state
        with from_table(encode([self.bench.record("live")])) as database:
            broken = {
                row.invariant: (row.first_seq, row.first_found)
                for row in audit_rows(database, chosen(()))
                if row.events
            }
            unattributed = database.rows("SELECT action_id, found FROM i5_audit_attributability")
        # A request that finds nobody has no execution principal, nor has a gap whose task ends before the registry is
        # asked, and I5 says so.
        queries = [event for event in self.bench.events if isinstance(event, (RequestIssued, RegistryQueried))]
        asked = {
            event.subject.action_id for event in queries if self.has_helper or event.principals.executed_by is not None
        }
        assert [
            row for row in unattributed if row["action_id"] in asked or row["found"] != "no executor can be recovered"
        ] == []
        broken.pop("i5_audit_attributability", None)
        assert broken == {}, broken


SETTINGS = settings(
    max_examples=20,
    stateful_step_count=60,
    deadline=None,
    database=None,
    suppress_health_check=list(HealthCheck),
    phases=(Phase.generate,),
)
TestFederation = Federation.TestCase
TestFederation.settings = settings(SETTINGS, derandomize=True, max_examples=4)


def soak(steps: int) -> None:
    """So many steps are played; raises on the first that breaks something."""
    done = 0
    while done < steps:
        run_state_machine_as_test(Federation, settings=settings(SETTINGS, max_examples=50, stateful_step_count=200))
        done = COUNTS["checks"]
        print(
            f"{done:,} steps, "
            + ", ".join(f"{COUNTS[name]:,} {name}" for name in ("histories", "events", "commands", "rejections"))
            + "".join(f", {COUNTS[f'event {name}']:,} {name}" for name in MEMBERSHIP),
            flush=True,
        )


if __name__ == "__main__":
    soak(int(sys.argv[1]) if len(sys.argv) > 1 else 200_000)
