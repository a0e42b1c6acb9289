"""What leaves the federation's decisions goes through a port, and whatever answers there decides how a run goes on."""

from typing import get_args

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.designs.registered import PAPER_SCENARIOS
from fsar_ledger.events.envelope import Robot, Supervisor
from fsar_ledger.events.execution import ExecutionFinished, ExecutionStarted
from fsar_ledger.events.supervision import SupervisionDensitySet, SupervisorCalled, SupervisorResponded
from fsar_ledger.runtime.handlers.supervision import SetSupervisionDensity
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import AS_USUAL, DISAPPROVES, PREFERS_OTHER, Ask, Environment, Fact, Port, World
from fsar_ledger.runtime.simulation import RunSpec, environment_of, founding_of, handler_table_of, kernel
from tests.runtime.live import of
from tests.runtime.pinned import PINNED

S = 1_000_000
SPEC = RunSpec(42, "fsar", "full", "door-relay", 4, 1)
H_F, B = Supervisor("supervisor/fleet"), Robot("robot/B1")


NO_LENGTH = ("reliability", "verdict")


class Altered:
    """The simulated world, with other answers at one port: none takes more or less than this."""

    def __init__(
        self,
        spec: RunSpec,
        port: Port | None = None,
        length_us: int = S,
        constants: Constants = Constants(),  # noqa: B008
    ) -> None:
        self._world: World = environment_of(spec, constants)
        self._port, self._length_us = port, length_us
        self.asked: set[Ask] = set()
        self.facts: tuple[Fact, ...] = tuple(self._world.facts)
        self.latest_us: int | None = None

    def answer(self, ask: Ask) -> int:
        self.asked.add(ask)
        return self._length_us if ask.port == self._port and ask.what not in NO_LENGTH else self._world.answer(ask)


def played(spec: RunSpec, environment: Environment) -> Kernel:
    one = Kernel(handler_table_of(spec.architecture), environment, *founding_of(spec, Constants()))
    one.run()
    return one


def same(one: Kernel, other: Kernel) -> bool:
    return (one.events, one.times_us, one.caused_by) == (other.events, other.times_us, other.caused_by)


def whole(spec: RunSpec) -> Kernel:
    one = kernel(spec, Constants())
    one.run()
    return one


@pytest.mark.parametrize("architecture", ["fsar", "cfc", "dhma"])
def test_an_environment_that_passes_everything_on_changes_nothing(architecture: str) -> None:
    spec = RunSpec(42, architecture, "full", "door-relay", 4, 1)
    assert same(played(spec, Altered(spec)), whole(spec))


def test_every_port_is_asked_and_each_question_names_its_port() -> None:
    asked = set[Ask]()
    for architecture in ("fsar", "cfc", "dhma"):
        for scenario in PAPER_SCENARIOS:
            environment = Altered(RunSpec(42, architecture, "full", scenario, 4, 1))
            played(RunSpec(42, architecture, "full", scenario, 4, 1), environment)
            asked |= environment.asked
    ports = {what: {ask.port for ask in asked if ask.what == what} for what in {ask.what for ask in asked}}
    assert ports["message"] == {"network"}
    assert ports["response"] == ports["verdict"] == {"human"}
    assert ports["admission"] == ports["help"] == {"decision"}
    assert {
        port
        for what, found in ports.items()
        if what not in ("message", "response", "verdict", "admission", "help")
        for port in found
    } == {"body"}
    assert {ask.port for ask in asked} == set(get_args(Port))


def test_a_body_that_answers_otherwise_executes_otherwise() -> None:
    one = played(SPEC, Altered(SPEC, "body", 7 * S))
    begun = {event.subject.action_id: event.ends_us - time_us for time_us, event in of(one, ExecutionStarted)}
    assert set(begun.values()) == {7 * S}
    assert of(one, ExecutionFinished)


def test_a_human_who_answers_otherwise_is_on_record_with_that() -> None:
    one = Kernel(handler_table_of("fsar"), Altered(SPEC, "human", 3 * S), *founding_of(SPEC, Constants()))
    one.submit(S, SetSupervisionDensity(H_F, None, 1, "every admission is put before a supervisor"))
    one.run()
    asked = {event.subject.action_id: time_us for time_us, event in of(one, SupervisorCalled)}
    answered = {event.subject.action_id: time_us for time_us, event in of(one, SupervisorResponded)}
    assert answered
    assert {time_us - asked[action_id] for action_id, time_us in answered.items()} == {3 * S}


class Humans(Altered):
    """The simulated world, with supervisors who answer every call like this."""

    def __init__(self, spec: RunSpec, verdict: int, constants: Constants = Constants()) -> None:  # noqa: B008
        super().__init__(spec, constants=constants)
        self._verdict = verdict

    def answer(self, ask: Ask) -> int:
        return self._verdict if ask.what == "verdict" else super().answer(ask)


@pytest.mark.parametrize("architecture", ["fsar", "cfc", "dhma"])
def test_a_supervisor_who_says_no_to_reviews_is_on_record_with_that(architecture: str) -> None:
    for verdict, approves in ((AS_USUAL, {True}), (DISAPPROVES, {False}), (PREFERS_OTHER, {True})):
        found: list[SupervisorResponded] = []
        for scenario in PAPER_SCENARIOS:
            spec = RunSpec(42, architecture, "full", scenario, 4, 1)
            one = Kernel(handler_table_of(architecture), Humans(spec, verdict, PINNED), *founding_of(spec, PINNED))
            one.submit(S, SetSupervisionDensity(H_F, None, 1, "every admission is put before a supervisor"))
            one.run()
            found += [event for _, event in of(one, SupervisorResponded)]
        assert {event.approves for event in found if event.purpose == "review"} == approves
        assert all(event.approves for event in found if event.purpose != "review")


def test_a_supervisor_who_puts_the_other_action_first_turns_the_order_round() -> None:
    spec = RunSpec(42, "fsar", "full", "workflow-human-supervision", 4, 0)
    usual, other = (played(spec, Humans(spec, verdict)) for verdict in (AS_USUAL, PREFERS_OTHER))
    (one,), (turned,) = ([event for _, event in of(run, SupervisorResponded)] for run in (usual, other))
    assert isinstance(one, SupervisorResponded)
    assert isinstance(turned, SupervisorResponded)
    assert (one.purpose, turned.purpose) == ("ordering", "ordering")
    assert None not in (one.preferred, turned.preferred)
    assert one.preferred != turned.preferred


def test_a_run_that_is_stopped_at_any_time_and_goes_on_is_the_same_run() -> None:
    at_once, in_steps = whole(SPEC), kernel(SPEC, Constants())
    for until_us in range(0, at_once.times_us[-1] + S, 7 * S):
        in_steps.run(until_us)
        assert in_steps.times_us[-1] <= until_us
        assert in_steps.events == at_once.events[: len(in_steps.events)]
        assert len(in_steps.events) == sum(time_us <= until_us for time_us in at_once.times_us)
    in_steps.run()
    assert same(in_steps, at_once)


def test_a_command_from_outside_is_decided_at_its_time() -> None:
    one = kernel(SPEC, Constants())
    one.run(10 * S)
    due_us = one.submit(20 * S, SetSupervisionDensity(H_F, B, 2, "a quiet hour"))
    one.run()
    assert due_us == 20 * S
    assert [(time_us, one.caused_by[one.events.index(event)]) for time_us, event in of(one, SupervisionDensitySet)] == [
        (20 * S, 0)
    ]


def test_commands_from_outside_never_share_an_instant_with_each_other_or_with_a_fact() -> None:
    one = kernel(SPEC, Constants())
    one.run(10 * S)
    fact_us = next(time_us for time_us, _ in one._facts if time_us > 10 * S)
    given = [one.submit(fact_us, SetSupervisionDensity(H_F, B, every, "a quiet hour")) for every in (2, 3)]
    assert given == [fact_us + 1, fact_us + 2]
    one.run()
    assert [time_us for time_us, _ in of(one, SupervisionDensitySet)] == given


def test_a_command_for_a_time_that_has_passed_is_refused() -> None:
    one = kernel(SPEC, Constants())
    one.run(10 * S)
    with pytest.raises(ValueError, match=f"at {S} microseconds, expected it after {one.times_us[-1]}"):
        one.submit(S, SetSupervisionDensity(H_F, B, 2, "too late"))


def test_a_simulated_run_has_a_latest_end_and_another_environment_need_not_have_one() -> None:
    assert environment_of(SPEC, Constants()).latest_us is not None
    one = Kernel(handler_table_of("fsar"), Altered(SPEC), *founding_of(SPEC, Constants()))
    late_us = 3 * environment_of(SPEC, Constants()).latest_us  # type: ignore[operator]
    one.submit(late_us, SetSupervisionDensity(H_F, B, 2, "a year later"))
    one.run()
    assert one.times_us[-1] == late_us
