"""Cand(Q): the robots that may be asked, best first, and why every other one that offers it is left out.

Paper: sec:architecture:registry.
"""

from collections.abc import Callable, Iterable, Iterator
from itertools import filterfalse
from typing import Literal, get_args

import msgspec

from fsar_ledger.events.envelope import Availability, OverrideLevel, Robot
from fsar_ledger.projections import among
from fsar_ledger.projections.execution import Execution
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import ruled
from fsar_ledger.projections.registry import (
    Advertisement,
    CapabilityOffers,
    Contract,
    Offers,
    enclosing,
    offered_in,
    offers,
)
from fsar_ledger.projections.trust import covers, scope_of

from .attribution import is_idle, nearest_first

Version = tuple[int, int, int]
NOT = "not "


def version_of(text: str) -> Version | None:
    """Return the version as three numbers, missing ones 0; None when the text is no version."""
    parts = text.split(".")
    if len(parts) > 3 or not all(part.isascii() and part.isdecimal() and len(part) < 10 for part in parts):
        return None
    major, minor, patch = (int(part) for part in (*parts, "0", "0")[:3])
    return major, minor, patch


def is_range(text: str) -> bool:
    """Return whether the text is a range: empty (any), `1.2.0` (exactly), `^1.2` (compatible) or `>=1.2`."""
    return text == "" or version_of(text.removeprefix(_sign(text))) is not None


def is_in_range(version: str, wanted: str) -> bool:
    """Return whether the version lies in the range; a text that is no version lies only in the empty one.

    Compatible versions keep the first number that is not 0, as in semantic versioning: `^1.2` is from 1.2.0 to before
    2.0.0, `^0.2` from 0.2.0 to before 0.3.0. Paper: sec:architecture:registry (semantic matching).
    """
    if wanted == "":
        return True
    sign = _sign(wanted)
    parsed, lowest = version_of(version), version_of(wanted.removeprefix(sign))
    if parsed is None or lowest is None:
        return False
    if sign == "^":
        return lowest <= parsed < _breaking(lowest, wanted.count(".") + 1)
    return parsed >= lowest if sign == ">=" else parsed == lowest


def _sign(text: str) -> str:
    return "^" if text.startswith("^") else ">=" if text.startswith(">=") else ""


def _breaking(version: Version, count: int) -> Version:
    """Return the next version that may be incompatible; `count` is how many numbers the range states."""
    major, minor, patch = version
    if major > 0 or count == 1:
        return major + 1, 0, 0
    if minor > 0 or count == 2:
        return 0, minor + 1, 0
    return 0, 0, patch + 1


def is_suitable(
    contract: Contract, needs: Iterable[str], provides: Iterable[str] | None, resources: Iterable[str] | None
) -> bool:
    """Return whether the contract gives what is needed and asks for no more than is provided.

    None states nothing. Paper: sec:architecture:registry.
    """
    return (
        set(needs) <= set(contract.postconditions)
        and (provides is None or set(contract.preconditions) <= set(provides))
        and (resources is None or set(contract.resources) <= set(resources))
    )


def contradiction(contract: Contract) -> str | None:
    """Return why the contract is invalid in itself, or None.

    Preconditions and postconditions may differ, even be opposites: that is what execution is for. But
    neither may ask for a name and its `not` together, name anything twice, or name nothing. Paper: eq:adv.
    """
    for part, names in (
        ("precondition", contract.preconditions),
        ("postcondition", contract.postconditions),
        ("resource", contract.resources),
    ):
        for name in names:
            bare = name.removeprefix(NOT)
            if not bare or bare != bare.strip() or bare == "not" or bare.startswith(NOT):
                return f"{part} {name!r} is no name, expected a name or `not ` and a name"
            if names.count(name) > 1:
                return f"{part} {name} is named twice"
            if NOT + name in names:
                return f"{part}s {name} and {NOT}{name} contradict each other"
    if any(name.startswith(NOT) for name in contract.resources):
        return "a resource cannot be taken by not taking it, expected names without `not `"
    return None


def weaker(offered: Contract, installed: Contract) -> str | None:
    """Return why the offered contract promises more than the installed one keeps, or None.

    An offer may demand more and promise less, never the reverse.
    """
    if promised := sorted(set(offered.postconditions) - set(installed.postconditions)):
        return f"postcondition {promised[0]} is not one of the installed module"
    if demanded := sorted(set(installed.preconditions) - set(offered.preconditions)):
        return f"precondition {demanded[0]} of the installed module is left out"
    if taken := sorted(set(installed.resources) - set(offered.resources)):
        return f"resource {taken[0]} of the installed module is left out"
    return None


Filter = Literal["visibility", "version", "contract", "trust", "policy", "authority", "availability", "embodiment"]
FILTERS: tuple[Filter, ...] = get_args(Filter)  # in the order of evaluation
_GROUP = ".*"  # ends the name of a group of capabilities
_RANKS: dict[Availability, int] = {"busy": 1, "degraded": 2}  # of those that are not ready


class Query(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Q = (r_A, e*, sigma, B, P): who asks for what, in which context, and what is stated about it.

    `capability` is a name or a group (`grasp.*`); `version` a range (see `is_in_range`). `provides` are the
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

    Each robot of `rejected` offers what was requested and was excluded by the filter at the same index of
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

    Every other robot that matches by name in the registries searched is either candidate or rejected; under a `limit`
    only those that the search reached. A robot that matches more than once counts by its best record.
    With a `cache_holder` the answer is that of its copy: old offers, but current trust and rules.

    Raises:
        KeyError: the requester is no member of the fleet, or the holder has no copy.
    """
    cache = None if cache_holder is None else state.registry.caches[cache_holder]
    read = state.registry.offers if cache is None else cache.offers
    search = _Search(state, query, state.execution if cache is None else None)
    answering = ""
    for domain, level, but in enclosing(read, state.registry.members[query.requester][1]):
        answering = domain
        search.search_registry(level, but)
        if search.found:
            break
    left_out, ranked = search.left_out, search.ranked()[: query.limit]
    others = nearest_first(state.fleet, left_out, query.requester)
    return Answer(
        ranked,
        search.capabilities(ranked),
        others,
        tuple([left_out[robot] for robot in others]),
        answering,
        None if cache is None else cache.as_of_us,
    )


class _Search:
    """The results of a query in the registries searched so far.

    `found`: robot -> a record of the kind that admits it; `left_out`: robot -> the filter that rejects it. Without
    `execution`, as in a copy, no robot is known to be executing.
    """

    def __init__(self, state: State, query: Query, execution: Execution | None) -> None:
        self.found: dict[Robot, Advertisement] = {}
        self.left_out: dict[Robot, Filter] = {}
        self._kinds: list[Advertisement] = []  # the records that admitted robots
        self._state = state
        self._query = query
        self._execution = execution

    def search_registry(self, level: Offers, but: str | None) -> None:
        """Sort the matches of one registry (except those below `but`) into found and left out."""
        query = self._query
        if query.limit is None and not query.capability.endswith(_GROUP):
            for offered in offered_in(level, query.capability, but):
                for record, robots in alike(self._state, offered, query.requester):
                    self._put(rejecting_filter(self._state, query, record), record, robots)
        else:
            self._judge_each(_matches(level, query.capability, but))
        if any(kind.is_deprecated for kind in self._kinds):
            self._leave_out_replaced()

    def _leave_out_replaced(self) -> None:
        """Leave out the robots whose offer is deprecated, if another one of the same capability is not."""
        current = {kind.capability for kind in self._kinds if not kind.is_deprecated}
        for robot, record in list(self.found.items()):
            if record.is_deprecated and record.capability in current:
                del self.found[robot]
                self.left_out[robot] = "version"

    def _put(self, reason: Filter | None, record: Advertisement, robots: tuple[Robot, ...]) -> None:
        if reason is None:
            self._kinds.append(record)
            self.found.update(dict.fromkeys(robots, record))
        else:
            self.left_out.update(dict.fromkeys(robots, reason))

    def _judge_each(self, matches: Iterable[Advertisement]) -> None:
        """Judge the matches one by one: a group may match a robot more than once, and a limit ends the search."""
        query, ready = self._query, 0
        for record in matches:
            robot = record.robot
            if robot == query.requester or (robot in self.found and not self.found[robot].is_deprecated):
                continue
            reason = rejecting_filter(self._state, query, record)
            if reason is not None:
                prior = self.left_out.get(robot)
                if robot not in self.found and (prior is None or FILTERS.index(reason) > FILTERS.index(prior)):
                    self.left_out[robot] = reason
                continue
            self._kinds.append(record)
            self.found[robot] = record
            self.left_out.pop(robot, None)
            ready += not record.is_deprecated and self._rank(robot) == 0
            if ready == query.limit:
                break

    def ranked(self) -> tuple[Robot, ...]:
        """Return the robots found: the ready first, then the busy and the degraded; of each, the nearest first.

        Robots with a deprecated offer come last in each group.
        """
        robots = nearest_first(self._state.fleet, self.found, self._query.requester)
        if any(kind.availability in _RANKS or kind.is_deprecated for kind in self._kinds):
            return tuple(sorted(robots, key=lambda robot: (self._rank(robot), self.found[robot].is_deprecated)))
        busy = set() if self._execution is None else among(self._execution.current, self.found.keys())
        if not busy:
            return robots
        return (*filterfalse(busy.__contains__, robots), *filter(busy.__contains__, robots))

    def capabilities(self, robots: tuple[Robot, ...]) -> tuple[str, ...]:
        """Return the capability by which each of these robots was found."""
        names = {kind.capability for kind in self._kinds}
        if len(names) == 1:
            return (*names,) * len(robots)
        return tuple([self.found[robot].capability for robot in robots])

    def _rank(self, robot: Robot) -> int:
        """Return 0 for ready, 1 busy, 2 degraded; no copy shows that a robot is executing just now."""
        is_busy = self._execution is not None and not is_idle(self._execution, robot)
        return max(int(is_busy), _RANKS.get(self.found[robot].availability, 0))


# See docs/decisions/registry-judges-like-robots-once.md.
def alike(
    state: State, offered: CapabilityOffers, requester: Robot
) -> Iterator[tuple[Advertisement, tuple[Robot, ...]]]:
    """Yield robots, other than the requester, that every filter treats alike, and the record of one of them.

    Robots that a rule, or trust in the requester, names come alone.
    """
    entries, named = state.trust.entries, state.policy.named_robots
    for record, robots in offered.alike:
        alone = {requester}
        if entries or named:
            alone.update(robot for robot in robots if robot in named or (robot, requester) in entries)
        is_whole = len(alone) == 1 and requester not in offered.of
        others = robots if is_whole else tuple([robot for robot in robots if robot not in alone])
        if others:
            yield (record if record.robot == others[0] else offered.of[others[0]]), others
        for robot in robots if len(alone) > 1 else ():
            if robot in alone and robot != requester:
                yield offered.of[robot], (robot,)


def _matches(level: Offers, capability: str, but: str | None) -> Iterator[Advertisement]:
    """Yield Match(e, e*): the records of the name or, for a group, of each name in it."""
    names = [capability]
    if capability.endswith(_GROUP):
        names = sorted(
            {name for names in (level.records, level.ways) for name in names if name.startswith(capability[:-1])}
        )
    for name in names:
        yield from offers(level, name, but)


def rejecting_filter(state: State, query: Query, record: Advertisement, but: Filter | None = None) -> Filter | None:
    """Return the first filter (except `but`) that leaves the record out of the answer, or None when it is admissible.

    Paper: sec:architecture:registry.
    """
    for name, rejects in _REJECTS:
        if name != but and rejects(state, query, record):
            return name
    return None


def hides(state: State, record: Advertisement, requester: Robot, asker: Robot, context: str | None) -> bool:
    """Return whether the record is not Visible_Gamma to the requester.

    The asker addresses the robot for the requester: itself, or a relay. Without trust evaluation no record is
    hidden. Paper: eq:advertise.
    """
    if "trust-evaluation" in state.fleet.without:
        return False
    if record.visible_to and state.fleet.robots[requester].role not in record.visible_to:
        return True
    if record.visibility == "domain":
        domain = state.registry.members[requester][1]
        return record.domain != "" and domain != record.domain and not domain.startswith(record.domain + "/")
    return (
        record.visibility == "trust-gated"
        and scope_of(state.trust, record.robot, asker, record.capability, context) == "none"
    )


def _distrusts(state: State, query: Query, record: Advertisement) -> bool:
    """Return whether TrustOK fails by the record that is read (see `trust.trusts` for the present one).

    Paper: eq:delegable.
    """
    if "trust-evaluation" in state.fleet.without:
        return False
    return not covers(
        scope_of(state.trust, record.robot, query.requester, record.capability, query.context), record.trust_required
    )


def _forbids(state: State, query: Query, record: Advertisement) -> bool:
    """Return whether the advertisement is for other contexts, or a declared rule of the robot denies.

    A temporary closure is the robot's to judge. So is a denial against the fleet's mandate: the robot is shown, so
    that the conflict surfaces and is escalated.
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
