"""What is asked of the registry outside of a request, its copies, and the record of an answer (see `candidates`).

It is authoritative about discoverability, never about execution: the robot that is asked judges the request itself.
Paper: sec:architecture:registry.
"""

from typing import get_args

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import OverrideLevel, Principal, Robot, Subject
from fsar_ledger.events.registry import RegistryCached, RegistryConsulted, RegistryQueried
from fsar_ledger.projections.fold import State

from .attribution import recorded_by
from .candidates import Answer, Query, candidates, is_range
from .commands import Handlers
from .public import PublicCommand, absent_robot, carried_out, rejected

HANDLERS = Handlers()


def queried(
    state: State,
    query: Query,
    answer: Answer,
    task_id: str | None,
    action_id: str | None,
    relay: Robot | None = None,
) -> RegistryQueried:
    """Return the record of the registry's answer; the executor is the robot that the answer leads to, if any."""
    return RegistryQueried(
        subject=Subject(task_id, action_id),
        principals=recorded_by(
            state,
            query.requester,
            requested_by=query.requester,
            executed_by=answer.candidates[0] if answer.candidates else None,
        ),
        capability=query.capability,
        candidates=answer.candidates,
        relay=relay,
        rejected=answer.rejected,
        rejected_by=answer.rejected_by,
        domain=answer.domain,
        as_of_us=answer.as_of_us,
    )


class ConsultRegistry(PublicCommand):
    """Look into the registry outside of any request; with `cache_holder`, into that robot's copy."""

    query: Query
    cache_holder: Robot | None = None


class CacheRegistry(PublicCommand):
    """Give the robot a copy of the registry as it is now."""

    holder: Principal


@HANDLERS.decide(ConsultRegistry)
def consult_registry(state: State, command: ConsultRegistry) -> tuple[Event, ...]:
    """Answer from the registry; finding nobody is an answer too."""
    query = command.query
    wrong = absent_robot(state.fleet, query.requester, command.cache_holder) or _malformed(query)
    if wrong is None and command.cache_holder is not None and command.cache_holder not in state.registry.caches:
        wrong = f"{command.cache_holder} has no copy of the registry, expected one that was taken"
    if wrong is not None:
        return rejected(command, query.capability, wrong, query.requester)
    found = candidates(state, query, command.cache_holder)
    return (
        RegistryConsulted(
            requested_by=query.requester,
            capability=query.capability,
            candidates=found.candidates,
            rejected=found.rejected,
            rejected_by=found.rejected_by,
            domain=found.domain,
            as_of_us=found.as_of_us,
        ),
    )


def _malformed(query: Query) -> str | None:
    name = query.capability.removesuffix(".*")
    if not name or "*" in name:
        return (
            f"capability {query.capability!r} is no name, expected one such as grasp.robust or a group such as grasp.*"
        )
    if not is_range(query.version):
        return f"version {query.version!r} is no range, expected nothing, 1.2.0, ^1.2 or >=1.2"
    if query.override not in get_args(OverrideLevel):
        return f"override level {query.override!r} is unknown, expected one of {', '.join(get_args(OverrideLevel))}"
    if query.limit is not None and query.limit < 1:
        return f"limit {query.limit} finds nobody, expected at least 1"
    return None


@HANDLERS.decide(CacheRegistry)
def cache_registry(state: State, command: CacheRegistry) -> tuple[Event, ...]:
    """Give the holder a copy of the registry as it is now."""
    wrong = absent_robot(state.fleet, command.holder)
    return carried_out(command, command.holder, wrong, command.holder, RegistryCached(command.holder, command.now_us))
