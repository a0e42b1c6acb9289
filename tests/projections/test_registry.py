"""The registry's records by domain: what a change touches, what a copy keeps, and what a search walks past."""

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.registry import (
    AvailabilityChanged,
    CapabilityAdvertised,
    CapabilityDeprecated,
    CapabilityInstalled,
    CapabilityRemoved,
    CapabilityWithdrawn,
    RegistryCached,
)
from fsar_ledger.projections import registry
from fsar_ledger.projections.registry import Offers, Registry, advertisement, enclosing, offers, surface
from tests import past

A, B, C, D = Robot("robot/A1"), Robot("robot/B1"), Robot("robot/C1"), Robot("robot/D1")

DOMAINS = {A: "", B: "hall", C: "hall/cell", D: "yard/cell/rack"}


def populated() -> Registry:
    """Four robots in four domains, each with two modules."""
    state = registry.INITIAL
    for robot, domain in DOMAINS.items():
        state = registry.evolve(state, past.joined(robot, robot[6], domain=domain))
        for capability in ("lift", "open"):
            state = registry.evolve(state, past.installed(robot, capability))
    return state


def evolved(state: Registry, *events: registry.HANDLES) -> Registry:
    for event in events:
        state = registry.evolve(state, event)
    return state


NAMES, CAPABILITIES = st.sampled_from(sorted(DOMAINS)), st.sampled_from(("lift", "open"))
CHANGES = st.one_of(
    st.builds(CapabilityAdvertised, robot=NAMES, capability=CAPABILITIES, version=st.sampled_from(("1.0.0", "2.0.0"))),
    st.builds(CapabilityWithdrawn, NAMES, CAPABILITIES, st.just("x")),
    st.builds(CapabilityRemoved, NAMES, CAPABILITIES),
    st.builds(CapabilityInstalled, robot=NAMES, capability=CAPABILITIES, version=st.just("1.0.0")),
    st.builds(
        AvailabilityChanged,
        robot=NAMES,
        capability=st.one_of(st.none(), CAPABILITIES),
        availability=st.sampled_from(("busy", "offline")),
        reason=st.just("x"),
    ),
    st.builds(CapabilityDeprecated, robot=NAMES, capability=CAPABILITIES, version=st.sampled_from(("1.0.0", "2.0.0"))),
)


@given(st.lists(CHANGES, max_size=40))
@settings(max_examples=200, deadline=None)
def test_the_records_are_those_of_a_plain_table(changes: list[Any]) -> None:
    """The model: one dictionary of what is installed, one of version, availability and deprecation by robot and
    capability."""
    state, table = populated(), dict[tuple[str, str], tuple[str, str, bool]]()
    installed = {(robot, capability) for robot in DOMAINS for capability in ("lift", "open")}
    for event in changes:
        state = registry.evolve(state, event)
        key = (event.robot, event.capability)
        match event:
            case CapabilityInstalled():
                installed.add(key)
            case CapabilityAdvertised():
                table[key] = (event.version, "ready", False)
                again = past.installed(event.robot, event.capability, event.version)
                state, installed = registry.evolve(state, again), installed | {key}
            case CapabilityWithdrawn():
                table.pop(key, None)
            case CapabilityRemoved():
                table.pop(key, None)
                installed.discard(key)
            case AvailabilityChanged():
                about = [known for known in table if known[0] == event.robot and event.capability in (None, known[1])]
                table.update({known: (table[known][0], event.availability, table[known][2]) for known in about})
            case CapabilityDeprecated():
                if key in table and table[key][0] == event.version:
                    table[key] = (*table[key][:2], True)
    shown = {(robot, record.capability): record for robot in DOMAINS for record in surface(state, robot)}
    assert {key: (record.version, record.availability, record.is_deprecated) for key, record in shown.items()} == table
    for capability in ("lift", "open"):
        assert sorted(record.robot for record in offers(state.offers, capability)) == sorted(
            robot for robot, name in table if name == capability
        )
        assert {(robot, capability) for robot in DOMAINS if registry.possesses(state, robot, capability)} <= installed
    assert_tidy(state.offers)


def assert_tidy(found: Offers) -> None:
    """The ways lead to every domain below in which somebody offers the capability, and to no other."""
    assert all(found.records.values())
    for name, inner in found.below.items():
        assert_tidy(inner)
        assert {capability for capability, names in found.ways.items() if name in names} == set(inner.records) | set(
            inner.ways
        )
    assert all(len(set(names)) == len(names) > 0 for names in found.ways.values())


def test_the_registries_around_a_domain_go_outward_and_name_the_one_just_left() -> None:
    state = evolved(populated(), *[past.advertised(robot, "lift") for robot in DOMAINS])
    levels = [
        (path, [record.robot for record in offers(level, "lift", but)])
        for path, level, but in enclosing(state.offers, "hall/cell")
    ]
    assert levels == [("hall/cell", ["robot/C1"]), ("hall", ["robot/B1"]), ("", ["robot/A1", "robot/D1"])]


def test_a_domain_that_nobody_advertises_in_is_passed_over() -> None:
    state = evolved(populated(), past.advertised(B, "lift"))
    assert [path for path, _, _ in enclosing(state.offers, "hall/other/corner")] == ["hall", ""]
    assert [path for path, _, _ in enclosing(registry.INITIAL.offers, "hall")] == [""]


def test_a_change_touches_only_the_registries_on_its_path() -> None:
    before = evolved(populated(), *[past.advertised(robot, "lift") for robot in DOMAINS])
    after = evolved(before, past.available(C, "lift", "busy", "x"))
    assert after.offers.below["yard"] is before.offers.below["yard"]
    assert after.offers.records is before.offers.records
    assert after.offers.ways is before.offers.ways
    assert after.offers.below["hall"].below["cell"] is not before.offers.below["hall"].below["cell"]


def test_a_copy_keeps_what_was_offered_when_it_was_taken() -> None:
    state = evolved(populated(), past.advertised(B, "lift"), RegistryCached(A, 5))
    state = evolved(state, CapabilityWithdrawn(B, "lift", "x"))
    assert list(offers(state.offers, "lift")) == []
    assert [record.robot for record in offers(state.caches[A].offers, "lift")] == ["robot/B1"]


def test_what_was_never_advertised_can_be_withdrawn_deprecated_and_removed_without_effect() -> None:
    state = populated()
    after = evolved(
        state, CapabilityWithdrawn(D, "lift", "x"), CapabilityDeprecated(robot=D, capability="lift", version="1.0.0")
    )
    assert advertisement(after, D, "lift") is None
    assert list(offers(after.offers, "lift")) == []
    assert not registry.possesses(evolved(after, CapabilityRemoved(D, "lift")), D, "lift")
