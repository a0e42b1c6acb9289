"""The registry's answers: who offers what, to whom, and why every other robot is left out.

It is authoritative about discoverability, never about execution: the robot that is asked judges the request itself.
Paper: sec:architecture:registry.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Literal, get_args

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import OverrideLevel, Principal, Robot, Subject
from fsar_ledger.events.registry import RegistryCached, RegistryConsulted, RegistryQueried
from fsar_ledger.projections.execution import Execution
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import ruled
from fsar_ledger.projections.registry import Advertisement, Offers, enclosing, offers
from fsar_ledger.projections.trust import covers, scope_of
from fsar_ledger.projections.world import World

from .attribution import is_idle, nearest_first, recorded_by
from .commands import Actors, Decides, PublicCommand, Reacts
from .matching import is_in_range, is_range, is_suitable
from .rejection import rejected, unknown_robot

Filter = Literal["visibility", "version", "contract", "trust", "policy", "authority", "availability", "embodiment"]
FILTERS: tuple[Filter, ...] = get_args(Filter)  # in the order in which they are asked


class Query(msgspec.Struct, frozen=True):
    """Q = (r_A, e*, sigma, B, P): who asks for what, in which context, and what is stated about it.

    `capability` is a name or a group (`grasp.*`); `version` a range (see `matching.is_in_range`). `provides` are the
    preconditions that the requester establishes and `resources` what is there to be taken, None where it does not say;
    `needs` the postconditions that it wants, `embodiment` what the body must be. `override` is the level that the
    request will ask for; `limit` ends the search at so many admissible ready candidates.

    Paper: sec:architecture:registry.
    """

    requester: Robot
    capability: str
    context: str | None = None
    version: str = ""
    provides: tuple[str, ...] | None = None
    needs: tuple[str, ...] = ()
    resources: tuple[str, ...] | None = None
    override: OverrideLevel = "none"
    embodiment: tuple[str, ...] = ()
    limit: int | None = None


class Answer(msgspec.Struct, frozen=True):
    """Cand(Q): the robots that may be asked, best first, each with its capability that matched (`capabilities`).

    Each robot of `rejected` offers what was asked for and was left out by the filter at the same place of
    `rejected_by`. `domain` is the registry that answered, `as_of_us` (run time) the age of the copy that it read, None
    for the present.
    """

    candidates: tuple[Robot, ...]
    capabilities: tuple[str, ...]
    rejected: tuple[Robot, ...]
    rejected_by: tuple[Filter, ...]
    domain: str = ""
    as_of_us: int | None = None


def candidates(state: State, query: Query, cache_holder: Robot | None = None) -> Answer:
    """Return Cand(Q), from the nearest registry around the requester that has a candidate, else from the fleet's.

    Every other robot that matches by name in the registries that were asked is either candidate or rejected; under a
    `limit` only those that the search came to. A robot that matches more than once counts by its best record.
    With a `cache_holder` the answer is that of its copy: old offers, while trust and rules are those of now.

    Raises:
        KeyError: the requester is no member of the fleet, or the holder has no copy.
    """
    cache = None if cache_holder is None else state.registry.caches[cache_holder]
    read = state.registry.offers if cache is None else cache.offers
    left_out: dict[Robot, Filter] = {}
    found: dict[Robot, Advertisement] = {}
    answering = ""
    for domain, level, but in enclosing(read, state.registry.domains[query.requester]):
        answering = domain
        _search(state, query, level, but, cache is None, found, left_out)
        if found:
            break
    ranked = _nearest(state.fleet, found, query)
    if len(ranked) > 1:
        ranked = tuple(
            sorted(
                ranked,
                key=lambda robot: (_rank(state.execution, found[robot], cache is None), found[robot].is_deprecated),
            )[: query.limit]
        )
    others = _nearest(state.fleet, left_out, query)
    return Answer(
        ranked,
        tuple(found[robot].capability for robot in ranked),
        others,
        tuple(left_out[robot] for robot in others),
        answering,
        None if cache is None else cache.as_of_us,
    )


def _nearest(fleet: Fleet, robots: Iterable[Robot], query: Query) -> tuple[Robot, ...]:
    found = list(robots)
    return nearest_first(fleet, found, query.requester) if len(found) > 1 else tuple(found)


def _search(
    state: State,
    query: Query,
    level: Offers,
    but: str | None,
    is_present: bool,
    found: dict[Robot, Advertisement],
    left_out: dict[Robot, Filter],
) -> None:
    """Sort every match of one registry into found and left out, until enough are ready."""
    ready = 0
    for record in _matches(level, query.capability, but):
        robot = record.robot
        if robot == query.requester or (robot in found and not found[robot].is_deprecated):
            continue
        by = rejecting_filter(state, query, record)
        if by is not None:
            if robot not in found and (robot not in left_out or FILTERS.index(by) > FILTERS.index(left_out[robot])):
                left_out[robot] = by
            continue
        found[robot] = record
        left_out.pop(robot, None)
        if query.limit is not None:
            ready += not record.is_deprecated and _rank(state.execution, record, is_present) == 0
            if ready == query.limit:
                break
    for robot in [robot for robot, record in found.items() if record.is_deprecated]:
        if any(record.capability == found[robot].capability and not record.is_deprecated for record in found.values()):
            del found[robot]
            left_out[robot] = "version"


def _matches(level: Offers, wanted: str, but: str | None) -> Iterator[Advertisement]:
    """Yield Match(e, e*): the records of the name or, for a group, of each name in it."""
    names = [wanted]
    if wanted.endswith(".*"):
        names = sorted(
            {name for names in (level.records, level.ways) for name in names if name.startswith(wanted[:-1])}
        )
    for name in names:
        yield from offers(level, name, but)


def _rank(execution: Execution, record: Advertisement, is_present: bool) -> int:
    """Return 0 for ready, 1 busy, 2 degraded; no copy shows that a robot is executing just now."""
    if record.availability == "degraded":
        return 2
    return int(record.availability == "busy" or (is_present and not is_idle(execution, record.robot)))


def rejecting_filter(state: State, query: Query, record: Advertisement, but: Filter | None = None) -> Filter | None:
    """Return the first filter (except `but`) that leaves the record out of the answer, or None when it is admissible.

    Paper: sec:architecture:registry.
    """
    for name, rejects in _REJECTS:
        if name != but and rejects(state, query, record):
            return name
    return None


def hides(state: State, record: Advertisement, requester: Robot, asker: Robot, context: str | None) -> bool:
    """Tell whether the record is not Visible_Gamma to the requester.

    The asker stands before the robot for the requester: itself, or a relay. Without trust evaluation no record is
    hidden. Paper: eq:advertise.
    """
    if "trust-evaluation" in state.fleet.without:
        return False
    if record.visible_to and state.fleet.robots[requester].role not in record.visible_to:
        return True
    if record.visibility == "domain":
        asking = state.registry.domains[requester]
        return record.domain != "" and asking != record.domain and not asking.startswith(record.domain + "/")
    return (
        record.visibility == "trust-gated"
        and scope_of(state.trust, record.robot, asker, record.capability, context) == "none"
    )


def _distrusts(state: State, query: Query, record: Advertisement) -> bool:
    """Tell whether TrustOK fails by the record that is read (see `trust.trusts` for the present one).

    Paper: eq:delegable.
    """
    if "trust-evaluation" in state.fleet.without:
        return False
    return not covers(
        scope_of(state.trust, record.robot, query.requester, record.capability, query.context), record.trust_required
    )


def _forbids(state: State, query: Query, record: Advertisement) -> bool:
    """Tell whether the advertisement is for other contexts, or a declared rule of the robot denies.

    What closes for a while is the robot's to judge. So is a denial against the fleet's mandate: the robot is shown, so
    that the conflict comes up and is escalated.
    """
    if record.policy_required and query.context not in record.policy_required:
        return True
    about = (record.robot, record.capability, query.context)
    return ruled(state.policy, "local", *about) == "deny" and ruled(state.policy, "fleet", *about) != "allow"


_REJECTS: tuple[tuple[Filter, Callable[[State, Query, Advertisement], bool]], ...] = (
    ("visibility", lambda state, query, record: hides(state, record, query.requester, query.requester, query.context)),
    ("version", lambda _state, query, record: not is_in_range(record.version, query.version)),
    (
        "contract",
        lambda _state, query, record: not is_suitable(record.contract, query.needs, query.provides, query.resources),
    ),
    ("trust", _distrusts),
    ("policy", _forbids),
    (
        "authority",
        lambda _state, query, record: query.override == "emergency-only" and record.override_allowed == "none",
    ),
    ("availability", lambda _state, _query, record: record.availability in ("offline", "restricted")),
    ("embodiment", lambda _state, query, record: not set(query.embodiment) <= set(record.embodiment)),
)


def queried(
    fleet: Fleet,
    world: World,
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
            fleet,
            world,
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


def consult_registry(state: State, command: ConsultRegistry) -> tuple[Event, ...]:
    """Answer from the registry; finding nobody is an answer too."""
    query = command.query
    wrong = unknown_robot(state.fleet, query.requester, command.cache_holder) or _malformed(query)
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


def cache_registry(state: State, command: CacheRegistry) -> tuple[Event, ...]:
    """Give the holder a copy of the registry as it is now."""
    wrong = unknown_robot(state.fleet, command.holder)
    if wrong is not None:
        return rejected(command, command.holder, wrong, command.holder)
    return (RegistryCached(command.holder, command.now_us),)


DECIDES: Decides = {ConsultRegistry: consult_registry, CacheRegistry: cache_registry}
ACTORS: Actors = {}
REACTS: Reacts = {}
