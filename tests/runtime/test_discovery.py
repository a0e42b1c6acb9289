"""FSAR: what the registry answers a robot with a gap, and whom it says it left out."""

from typing import Any

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.envelope import Robot, Subject
from fsar_ledger.events.registry import CapabilityWithdrawn, RegistryQueried
from fsar_ledger.events.world import OutsiderRequestInjected
from fsar_ledger.projections.fold import apply, fold
from fsar_ledger.projections.registry import Offers
from fsar_ledger.runtime.architectures.fsar.authority import AnswerOutsider
from fsar_ledger.runtime.architectures.fsar.discovery import QueryRegistry
from fsar_ledger.runtime.handlers.candidates import Query, candidates
from fsar_ledger.runtime.simulation import RunSpec, run_started
from fsar_ledger.runtime.world import founding
from tests import past
from tests.runtime.histories import given
from tests.runtime.live import decided
from tests.sure import only


def test_the_registry_says_by_which_filter_it_left_others_out() -> None:
    spec = RunSpec(1, "fsar", "full", "door-relay", 8, 0)
    step = past.began(Subject("A2-1", "A2-1/1.1"), Robot("robot/A2"), 1, "door.open.secure", "B")
    arrived = past.arrived("A2-1", Robot("robot/A2"), ("A door.open.secure B",), team=2, budget_us=1, due_us=1)
    distrust = past.trusted(Robot("robot/B1"), Robot("robot/A2"), "none")
    state = fold((run_started(spec, Constants()), *founding(8), arrived, step, distrust))
    answer = only(RegistryQueried, decided(state, QueryRegistry("A2-1/1.1")))
    assert (answer.candidates, answer.relay, answer.rejected) == (("robot/B2",), None, ("robot/B1",))
    assert answer.rejected_by == ("trust",)


def test_who_is_reached_through_a_peer_is_not_rejected_beside_it() -> None:
    spec = RunSpec(1, "fsar", "full", "door-relay", 8, 0)
    step = past.began(Subject("D2-1", "D2-1/1.1"), Robot("robot/D2"), 1, "door.open.secure", "B")
    arrived = past.arrived("D2-1", Robot("robot/D2"), ("D door.open.secure B",), team=2, budget_us=1, due_us=1)
    state = fold((run_started(spec, Constants()), *founding(8), arrived, step))
    answer = only(RegistryQueried, decided(state, QueryRegistry("D2-1/1.1")))
    assert (answer.candidates, answer.relay) == (("robot/B2",), "robot/A2"), "the nearest team's"
    assert (answer.rejected, answer.rejected_by) == (("robot/B1",), ("trust",))
    apply(state, past.available(Robot("robot/B2"), None, "offline", "charging"))
    assert only(RegistryQueried, decided(state, QueryRegistry("D2-1/1.1"))).candidates == ("robot/B1",)


def test_an_outsider_that_asks_for_what_nobody_shows_is_refused_by_visibility() -> None:
    injected = OutsiderRequestInjected(
        task_id="injected-1-1", robot=Robot("robot/D1"), peer=Robot("robot/C1"), capability="inspect.visual"
    )
    shown, _ = decided(given("fsar", injected), AnswerOutsider("injected-1-1"))
    hidden, _ = decided(
        given("fsar", injected, CapabilityWithdrawn(Robot("robot/C1"), "inspect.visual", "x")),
        AnswerOutsider("injected-1-1"),
    )
    assert (shown.rejected_by, hidden.rejected_by) == (("trust",), ("visibility",))  # type: ignore[attr-defined]


def test_a_search_that_ends_in_its_own_domain_reads_no_other() -> None:
    """What lies in the other domain here cannot be read at all."""
    founding_of_two = (
        past.joined(Robot("robot/A9"), "A", domain="hall"),
        past.joined(Robot("robot/B9"), "B", domain="hall"),
        past.trusted(Robot("robot/B9"), Robot("robot/A9"), "task"),
    )
    state = given(
        "fsar",
        *founding_of_two,
        past.joined(Robot("robot/B8"), "B", domain="yard"),
        past.trusted(Robot("robot/B8"), Robot("robot/A9"), "task"),
    )
    for robot in (Robot("robot/B9"), Robot("robot/B8")):
        apply(state, past.installed(robot, "lift"))
        apply(state, past.advertised(robot, "lift"))
    whole = state.registry.offers
    unreadable: Any = None
    state.registry = msgspec.structs.replace(
        state.registry, offers=Offers(whole.records, {**whole.below, "yard": unreadable}, whole.ways)
    )
    assert candidates(state, Query(Robot("robot/A9"), "lift")).candidates == ("robot/B9",)
    apply(state, past.trusted(Robot("robot/B9"), Robot("robot/A9"), "none"))
    with pytest.raises(AttributeError):
        candidates(state, Query(Robot("robot/A9"), "lift"))
