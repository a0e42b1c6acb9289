"""Random commands over random fleets: no invariant breaks, nothing raises, and what is rebuilt is what lives.

`python -m tests.runtime.test_federation_model 100000` plays at least so many steps and prints its counts.
"""

import sys
from collections import Counter
from typing import Any

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule, run_state_machine_as_test

from fsar_ledger.events.command import CommandRejected
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
from fsar_ledger.ledger.codec import encode
from fsar_ledger.metrics.database import from_table
from fsar_ledger.metrics.invariants import audit_rows, chosen
from fsar_ledger.projections.fold import State
from tests.runtime.bench import PUBLIC, ROBOTS, TRUST, Bench, arguments, founding

COUNTS: Counter[str] = Counter()


class Federation(RuleBasedStateMachine):
    """One fleet, played by whoever may command it."""

    def __init__(self) -> None:
        super().__init__()
        self.bench: Bench | None = None
        self.things = 0

    @initialize(fleet=ROBOTS, trust=TRUST)
    def found(self, fleet: list[Any], trust: list[Any]) -> None:
        self.bench = Bench(founding(fleet, trust))

    @property
    def live(self) -> Bench:
        assert self.bench is not None
        return self.bench

    def robot(self, data: st.DataObject) -> str:
        return data.draw(st.sampled_from(list(self.live.state.fleet.robots)))

    def new(self, kind: str) -> str:
        self.things += 1
        return f"{kind}/{self.things}"

    @rule(data=st.data(), times=st.integers(1, 5))
    def command(self, data: st.DataObject, times: int) -> None:
        for _ in range(times):
            self.command_once(data)

    def command_once(self, data: st.DataObject) -> None:
        kind = data.draw(st.sampled_from(PUBLIC))
        command = kind(**data.draw(arguments(self.live.state, kind)))
        before = {slot: getattr(self.live.state, slot) for slot in State.__slots__}
        events = self.live.issue(command)
        if any(isinstance(event, CommandRejected) for event in events):
            assert len(events) == 1
            assert before == {slot: getattr(self.live.state, slot) for slot in State.__slots__}
            COUNTS["rejections"] += 1
        COUNTS["commands"] += 1

    @rule(times=st.integers(1, 12))
    def proceed(self, times: int) -> None:
        for _ in range(times):
            if not self.live.proceed():
                return
            COUNTS["steps"] += 1

    @rule(data=st.data(), scope=st.sampled_from(["local", "fleet"]), outcome=st.sampled_from(["deny", "review"]))
    def open_window(self, data: st.DataObject, scope: Any, outcome: Any) -> None:
        self.live.happen(PolicyWindowOpened(self.robot(data), scope, self.new("window"), outcome))

    @rule(data=st.data())
    def close_window(self, data: st.DataObject) -> None:
        world = self.live.state.world
        opened = [(robot, "local", name) for robot, held in world.local.items() for name, _ in held]
        opened += [(robot, "fleet", name) for robot, held in world.fleet.items() for name, _ in held]
        if opened:
            self.live.happen(PolicyWindowClosed(*data.draw(st.sampled_from(opened))))  # type: ignore[arg-type]

    @rule(data=st.data())
    def change_context(self, data: st.DataObject) -> None:
        self.live.happen(ContextChanged(self.robot(data)))

    @rule(data=st.data(), grade=st.sampled_from(["unreliable", "slipping", "lost"]))
    def degrade(self, data: st.DataObject, grade: Any) -> None:
        self.live.happen(ActuatorDegraded(self.robot(data), grade))

    @rule(data=st.data())
    def obstruct(self, data: st.DataObject) -> None:
        self.live.happen(ObstructionAppeared(self.robot(data), self.new("obstruction")))

    @rule(data=st.data())
    def clear(self, data: st.DataObject) -> None:
        inside = [(robot, name) for robot, names in self.live.state.world.obstructions.items() for name in names]
        if inside:
            self.live.happen(ObstructionCleared(*data.draw(st.sampled_from(inside))))

    @rule(data=st.data())
    def leave(self, data: st.DataObject) -> None:
        present = [robot.supervisor for robot in self.live.state.fleet.robots.values() if robot.supervisor]
        present = [name for name in present if name not in self.live.state.world.off_shift]
        if present:
            self.live.happen(SupervisorLeft(data.draw(st.sampled_from(present))))

    @precondition(lambda self: self.bench is not None and self.bench.state.world.off_shift)
    @rule(data=st.data())
    def come_back(self, data: st.DataObject) -> None:
        self.live.happen(SupervisorReturned(data.draw(st.sampled_from(sorted(self.live.state.world.off_shift)))))

    @invariant()
    def what_is_rebuilt_is_what_lives(self) -> None:
        if self.bench is not None:
            COUNTS["checks"] += 1
            assert self.bench.rebuilt == self.bench.state

    def teardown(self) -> None:
        if self.bench is None:
            return
        COUNTS["histories"] += 1
        COUNTS["events"] += len(self.bench.events)
        COUNTS.update(f"event {type(event).__name__}" for event in self.bench.events)
        assert self.bench.refolded() == self.bench.state
        with from_table(encode([self.bench.record("live")])) as database:
            broken = [(row.invariant, row.first_seq, row.first_found) for row in audit_rows(database, chosen(())) if row.events]
        assert broken == [], broken


SETTINGS = settings(
    max_examples=20, stateful_step_count=60, deadline=None, database=None, suppress_health_check=list(HealthCheck), phases=(Phase.generate, Phase.shrink)
)
TestFederation = Federation.TestCase
TestFederation.settings = SETTINGS


def soak(steps: int) -> None:
    """So many steps are played; raises on the first that breaks something."""
    done = 0
    while done < steps:
        run_state_machine_as_test(Federation, settings=settings(SETTINGS, max_examples=50, stateful_step_count=200))
        done = COUNTS["checks"]
        print(f"{done:,} steps, " + ", ".join(f"{COUNTS[name]:,} {name}" for name in ("histories", "events", "commands", "rejections")), flush=True)


if __name__ == "__main__":
    soak(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)
