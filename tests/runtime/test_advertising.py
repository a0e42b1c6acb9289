"""A robot shows of itself what it possesses, on its own terms; what it cannot show is refused and changes nothing."""

from typing import Any

import msgspec
import pytest
from hypothesis import given as forall
from hypothesis import settings
from hypothesis import strategies as st

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.registry import (
    CapabilityAdvertised,
    CapabilityDeprecated,
    CapabilityInstalled,
    CapabilityWithdrawn,
)
from fsar_ledger.events.world import ActuatorDegraded
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.projections.registry import Contract, advertisement, possesses, surface
from fsar_ledger.runtime.handlers.commands import Command
from fsar_ledger.runtime.handlers.registry import (
    HANDLERS,
    AdvertiseCapability,
    DeprecateCapability,
    FinishRollOut,
    ReportAvailability,
    UpgradeCapability,
    WithdrawCapability,
    advertise_capability,
    finish_roll_out,
)
from tests import past
from tests.runtime.histories import A, B, given, happen, types
from tests.runtime.live import decided, refusal
from tests.sure import known, only

DOOR = (B, Robot("door.open.secure"))
GRIP = past.installed(
    B,
    "grasp",
    "1.4.0",
    preconditions=("object.seen",),
    postconditions=("object.held", "object.level"),
    resources=("arm",),
)


def advertise(**fields: Any) -> AdvertiseCapability:
    return AdvertiseCapability(**{"robot": "robot/B1", "capability": "grasp", "version": "1.4.0", **fields})


def test_an_advertisement_has_all_seven_fields_and_who_may_see_it() -> None:
    terms = {
        "trust_required": "task",
        "policy_required": ("delivery",),
        "override_allowed": "soft-priority",
        "availability": "busy",
        "embodiment": ("arm",),
        "visibility": "domain",
        "visible_to": ("A",),
    }
    [event] = advertise_capability(given("fsar", GRIP), advertise(**terms))
    state = given("fsar", GRIP, event)
    record = known(advertisement(state.registry, B, "grasp"))
    assert record.version == "1.4.0"
    assert record.contract == Contract(GRIP.preconditions, GRIP.postconditions, GRIP.resources)
    assert {name: getattr(record, name) for name in terms} == terms


def test_an_advertisement_may_demand_more_and_promise_less_than_the_module() -> None:
    command = advertise(
        preconditions=("object.seen", "zone.clear"), postconditions=("object.held",), resources=("arm", "lamp")
    )
    [event] = advertise_capability(given("fsar", GRIP), command)
    assert types((event,)) == ["CapabilityAdvertised"]


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (advertise(robot="robot/Z9"), "unknown robot robot/Z9"),
        (advertise(capability="teleport"), "does not possess teleport"),
        (advertise(version="1.5.0"), "expected 1.4.0"),
        (advertise(postconditions=("object.held", "object.sorted")), "postcondition object.sorted"),
        (advertise(preconditions=()), "precondition object.seen"),
        (advertise(resources=()), "resource arm"),
        (advertise(preconditions=("object.seen", "not object.seen")), "contradict"),
        (advertise(postconditions=("object.held", "not object.held")), "contradict"),
        (advertise(preconditions=("object.seen", "")), "is no name"),
        (advertise(resources=("arm", "arm")), "named twice"),
        (advertise(trust_required="blind"), "trust scope 'blind' is unknown"),
        (advertise(override_allowed="total"), "override level"),
        (advertise(availability="asleep"), "availability"),
        (advertise(visibility="secret"), "visibility"),
        (advertise(visible_to=("",)), "empty name"),
    ],
)
def test_what_cannot_be_advertised_is_refused(command: AdvertiseCapability, reason: str) -> None:
    assert reason in refusal(advertise_capability(given("fsar", GRIP), command))


def test_a_withdrawn_capability_is_off_the_surface_and_still_possessed() -> None:
    [event] = decided(given("fsar"), WithdrawCapability(*DOOR, "jammed"))
    assert event == CapabilityWithdrawn(DOOR[0], DOOR[1], "jammed")
    state = given("fsar", event)
    assert advertisement(state.registry, *DOOR) is None
    assert possesses(state.registry, *DOOR)
    assert types(decided(state, WithdrawCapability(*DOOR, "again"))) == ["CommandRejected"]


def test_a_robot_reports_the_availability_of_one_capability_or_of_all() -> None:
    [one] = decided(given("fsar"), ReportAvailability(*DOOR, "restricted", "inspection"))
    [everything] = decided(given("fsar"), ReportAvailability(B, None, "offline", "charging"))
    found = [record.availability for record in surface(given("fsar", one).registry, B)]
    assert found == ["ready", "ready", "restricted"]
    assert {record.availability for record in surface(given("fsar", everything).registry, B)} == {"offline"}


def test_a_deprecated_version_names_its_successor() -> None:
    [event] = decided(given("fsar"), DeprecateCapability(*DOOR, "1.0.0", "2.0.0"))
    assert event == CapabilityDeprecated(robot=DOOR[0], capability=DOOR[1], version="1.0.0", successor="2.0.0")
    record = known(advertisement(given("fsar", event).registry, *DOOR))
    assert (record.is_deprecated, record.successor) == (True, "2.0.0")


WITHDRAWN = CapabilityWithdrawn(DOOR[0], DOOR[1], "jammed")
EMPTY = [CapabilityWithdrawn(B, name, "jammed") for name in ("navigate.indoor", "door.open.basic", "door.open.secure")]


@pytest.mark.parametrize(
    ("events", "command", "reason"),
    [
        ((), WithdrawCapability(Robot("robot/Z9"), "door.open.secure", "x"), "unknown robot"),
        ((), WithdrawCapability(B, "teleport", "x"), "does not advertise teleport"),
        ((), ReportAvailability(Robot("robot/Z9"), None, "busy", "x"), "unknown robot"),
        ((), ReportAvailability(B, "teleport", "busy", "x"), "does not advertise teleport"),
        ((), ReportAvailability("robot/B1", None, "asleep", "x"), "unknown, expected one of ready"),  # type: ignore[arg-type]
        (EMPTY, ReportAvailability(B, None, "busy", "x"), "advertises nothing"),
        ((), ReportAvailability(B, None, "offline", "no answer"), "expected a reason of its own"),
        ((), DeprecateCapability(Robot("robot/Z9"), "door.open.secure", "1.0.0"), "unknown robot"),
        ((WITHDRAWN,), DeprecateCapability(*DOOR, "1.0.0"), "does not advertise"),
        ((), DeprecateCapability(*DOOR, "2.0.0"), "expected 1.0.0"),
        (
            (CapabilityDeprecated(robot=DOOR[0], capability=DOOR[1], version="1.0.0"),),
            DeprecateCapability(*DOOR, "1.0.0"),
            "already",
        ),
        ((), DeprecateCapability(*DOOR, "1.0.0", "0.9.0"), "not newer"),
        ((), DeprecateCapability(*DOOR, "1.0.0", "next"), "no version"),
        ((), UpgradeCapability(Robot("robot/Z9"), "door.open.secure", "2.0.0"), "unknown robot"),
        ((), UpgradeCapability(B, "teleport", "2.0.0"), "does not possess"),
        ((), UpgradeCapability(*DOOR, "1.0.0"), "not newer"),
        ((), UpgradeCapability(*DOOR, "new"), "no version"),
        ((), UpgradeCapability(*DOOR, "2.0.0", preconditions=("lit", "not lit")), "contradict"),
        ((past.available(B, None, "offline", "x"),), UpgradeCapability(*DOOR, "2.0.0"), "is offline"),
        (
            (past.available(DOOR[0], DOOR[1], "restricted", "roll-out of 2.0.0"),),
            UpgradeCapability(*DOOR, "3.0.0"),
            "in no other roll-out",
        ),
        (
            (past.queued(Subject("t", "t/1"), B, A, "door.open.secure", principals=past.parties()),),
            UpgradeCapability(*DOOR, "2.0.0"),
            "in use by t/1",
        ),
    ],
)
def test_what_names_something_unknown_over_or_impossible_is_rejected(
    events: tuple[Event, ...], command: Command, reason: str
) -> None:
    assert reason in refusal(HANDLERS.decides[type(command)](given("fsar", *events), command))


def rolling_out(state: State, events: tuple[Event, ...]) -> FinishRollOut:
    """The command that will end the roll-out which these events, that the state takes in, have begun."""
    commands = []
    for event in events:
        apply(state, event)
        commands += (
            [scheduled.command for scheduled in HANDLERS.reacts[CapabilityInstalled](state, event, 0)]
            if isinstance(event, CapabilityInstalled)
            else []
        )
    return only(FinishRollOut, commands)


def test_a_roll_out_restricts_the_old_version_until_the_new_one_is_advertised_on_its_terms() -> None:
    terms = past.advertised(
        DOOR[0],
        DOOR[1],
        visible_to=("A",),
        trust_required="task",
        override_allowed="soft-priority",
        visibility="domain",
        embodiment=("arm",),
    )
    state = given("fsar", terms)
    events = decided(state, UpgradeCapability(*DOOR, "2.0.0", postconditions=("door.opened",)))
    assert types(events) == ["CapabilityInstalled", "AvailabilityChanged"]
    begun = rolling_out(state, events)
    record = known(advertisement(state.registry, *DOOR))
    assert (record.version, record.availability) == ("1.0.0", "restricted")
    assert begun == FinishRollOut(*DOOR)
    [shown] = finish_roll_out(state, begun)
    assert shown == msgspec.structs.replace(terms, version="2.0.0", postconditions=("door.opened",))
    apply(state, shown)
    assert decided(state, FinishRollOut(*DOOR)) == ()


def test_a_roll_out_of_what_was_withdrawn_meanwhile_shows_nothing() -> None:
    state = given("fsar")
    happen(state, *decided(state, UpgradeCapability(*DOOR, "2.0.0")), WITHDRAWN)
    assert decided(state, FinishRollOut(*DOOR)) == ()


def test_an_upgrade_puts_nothing_on_the_surface_that_was_not_there() -> None:
    assert types(decided(given("fsar", WITHDRAWN), UpgradeCapability(*DOOR, "2.0.0"))) == ["CapabilityInstalled"]


@pytest.mark.parametrize(
    ("before", "meanwhile", "shown"),
    [
        (None, None, "ready"),
        (past.available(DOOR[0], DOOR[1], "degraded", "actuator"), None, "degraded"),
        (past.available(DOOR[0], DOOR[1], "busy", "tour"), None, "busy"),
        (past.available(B, "door.open.basic", "degraded", "actuator"), None, "ready"),  # that is another capability
        (ActuatorDegraded(B), None, "ready"),  # nobody has noticed yet
        (None, past.available(B, None, "ready", "all well"), "ready"),
        (None, past.available(B, None, "offline", "charging"), "offline"),
    ],
)
def test_a_new_version_is_as_available_as_the_robot_has_said(
    before: Event | None, meanwhile: Event | None, shown: str
) -> None:
    state = given("fsar", *([before] if before else []))
    command = rolling_out(state, decided(state, UpgradeCapability(*DOOR, "2.0.0")))
    happen(state, *[meanwhile] if meanwhile else [])
    advertised = only(CapabilityAdvertised, finish_roll_out(state, command))
    assert (advertised.version, advertised.availability) == ("2.0.0", shown)


def test_an_upgrade_during_a_roll_out_is_shown_once() -> None:
    state = given("fsar")
    first = rolling_out(state, decided(state, UpgradeCapability(*DOOR, "2.0.0")))
    apply(state, past.available(DOOR[0], DOOR[1], "ready", "in haste"))
    second = rolling_out(state, decided(state, UpgradeCapability(*DOOR, "3.0.0")))
    [advertised] = finish_roll_out(state, first)
    apply(state, advertised)
    assert advertised.version == "3.0.0"  # type: ignore[attr-defined]
    assert finish_roll_out(state, second) == ()


def test_what_is_installed_and_not_advertised_is_not_rolled_out() -> None:
    assert HANDLERS.reacts[CapabilityInstalled](given("fsar", GRIP), GRIP, 0) == ()


VERSIONS = st.sampled_from(("1.0.0", "2.0.0", "3.0.0"))
COMMANDS = st.one_of(
    st.builds(
        AdvertiseCapability,
        st.sampled_from(("robot/B1", "robot/Z9")),
        st.sampled_from(("door.open.secure", "lift")),
        st.sampled_from(("1.0.0", "2.0.0")),
    ),
    st.builds(WithdrawCapability, st.just("robot/B1"), st.just("door.open.secure"), st.just("x")),
    st.builds(
        ReportAvailability,
        st.just("robot/B1"),
        st.sampled_from((None, "door.open.secure")),
        st.sampled_from(("ready", "offline")),
        st.just("x"),
    ),
    st.builds(DeprecateCapability, st.just("robot/B1"), st.just("door.open.secure"), VERSIONS),
    st.builds(UpgradeCapability, st.just("robot/B1"), st.just("door.open.secure"), VERSIONS),
    st.builds(FinishRollOut, st.just("robot/B1"), st.just("door.open.secure")),
)


@forall(st.lists(COMMANDS, max_size=25))
@settings(max_examples=80, deadline=None)
def test_whatever_is_commanded_the_surface_is_part_of_what_is_possessed(commands: list[Command]) -> None:
    state = given("fsar")
    for command in commands:
        before = state.registry
        events = HANDLERS.decides[type(command)](state, command)
        happen(state, *events)
        if types(events) == ["CommandRejected"]:
            assert state.registry is before
        for record in surface(state.registry, B):
            assert possesses(state.registry, B, record.capability)
            installed = state.registry.modules[B][record.capability].version
            assert (
                record.version == installed
                or record.availability == "restricted"
                or any(isinstance(one, ReportAvailability) for one in commands)
            )
