"""Principals: what stands for a robot is checked before it is taken for one."""

import pytest

from fsar_ledger.events.envelope import (
    COORDINATOR,
    FLEET_SUPERVISOR,
    TRUST,
    Parties,
    Principal,
    RequestSubject,
    Robot,
    Service,
    agent,
    as_robot,
)
from fsar_ledger.events.request import RequestIssued
from fsar_ledger.events.trust import TrustThresholdsSet
from fsar_ledger.projections import request, trust

A1, B1 = Robot("robot/A1"), Robot("robot/B1")
OTHERS = (COORDINATOR, FLEET_SUPERVISOR, TRUST, agent(A1, "planning"), Service("robot"), Service(""))


def issued(by: Principal) -> RequestIssued:
    principals = Parties(requested_by=by, executed_by=B1, supervised_by=None).decided(by)
    return RequestIssued(
        subject=RequestSubject("visit", "q1", "q1"),
        principals=principals,
        capability="door.open",
        carried_policy="allow",
    )


def test_a_robot_is_taken_for_one() -> None:
    assert as_robot(A1) == A1
    assert request.evolve(request.INITIAL, issued(A1)).open["q1"].requester == A1


@pytest.mark.parametrize("other", OTHERS)
def test_no_other_principal_is_taken_for_a_robot(other: Principal) -> None:
    with pytest.raises(ValueError, match=f"found the principal '{other}', expected a robot such as 'robot/A1'"):
        as_robot(other)


@pytest.mark.parametrize("other", OTHERS)
def test_a_request_of_any_principal_can_be_followed(other: Principal) -> None:
    following = trust.evolve(trust.INITIAL, TrustThresholdsSet(1, 1, FLEET_SUPERVISOR))
    assert request.evolve(request.INITIAL, issued(other)).open["q1"].requester == other
    trust.evolve(following, issued(other))
