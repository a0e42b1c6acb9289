"""Checks of designs beyond their types: a fleet by itself, a scenario for a fleet, and a fact added to a run."""

import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from math import isfinite
from typing import NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.designs import Fleet, Policy, Robot, Scenario, Task, Workflow
from fsar_ledger.designs.constants import DURATIONS, END_US
from fsar_ledger.designs.registered import Field, field_name
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.world import (
    ObstructionAppeared,
    ObstructionCleared,
    OutsiderRequestInjected,
    PolicyWindowClosed,
    PolicyWindowOpened,
    TaskArrived,
)
from fsar_ledger.projections.fleet import Fleet as Founded
from fsar_ledger.projections.trust import is_within

_NAME = re.compile(r"[a-z][a-z0-9-]{0,38}[a-z0-9]")
_ROBOT = re.compile(r"[A-Za-z](?:[A-Za-z0-9_-]{0,38}[A-Za-z])?")
_ROLE = re.compile(r"[A-Za-z](?:[A-Za-z0-9_-]{0,38}[A-Za-z0-9])?")
_CAPABILITY = re.compile(r"[a-z][a-z0-9_-]*(?:\.[a-z0-9_-]+)+")
_DOMAIN = re.compile(r"(?:[A-Za-z0-9][A-Za-z0-9_-]{0,39}(?:/[A-Za-z0-9][A-Za-z0-9_-]{0,39})*)?")
_CONDITION = re.compile(r"[a-z][a-z0-9_-]*(?:\.[a-z0-9_-]+)*")
MOST_TIMES = 1_000


class Problem(NamedTuple):
    """A fault in a design: where it is, what was found and what was expected."""

    field: Field
    found: str
    expected: str

    def __str__(self) -> str:
        return f"{field_name(self.field)}: found {self.found}, expected {self.expected}"


def problems_of_fleet(fleet: Fleet) -> Iterator[Problem]:
    """Yield the problems of the fleet by itself, in the order of its fields."""
    yield from _malformed_name(
        ("name",), fleet.name, _NAME, "a name of lowercase letters, digits and -, such as ward-night"
    )
    robots, capabilities = (
        [entry.name for entry in fleet.robots],
        [capability.name for capability in fleet.capabilities],
    )
    if not robots:
        yield Problem(("robots",), "none", "at least one robot")
    for index, robot in enumerate(fleet.robots):
        prefix: Field = ("robots", index)
        yield from _malformed_name(
            (*prefix, "name"), robot.name, _ROBOT, "letters, digits, - and _, with a letter at both ends"
        )
        yield from _first((*prefix, "name"), robot.name, robots[:index], "another robot of this name")
        if robot.role is not None:
            yield from _malformed_name((*prefix, "role"), robot.role, _ROLE, "letters, digits, - and _, a letter first")
        if robot.supervisor is not None:
            field: Field = (*prefix, "supervisor")
            yield from _malformed_name(
                field, robot.supervisor, _NAME, "a name of lowercase letters, digits and -, such as maria"
            )
            if not robot.has_supervisor or robot.supervisor == "fleet":
                yield Problem(field, printable.value(robot.supervisor), "none: the fleet supervisor is in charge")
        path = "a path of names with / between, such as ward/night, or nothing for the fleet's own registry"
        yield from _malformed_name((*prefix, "domain"), robot.domain, _DOMAIN, path)
        yield from _each((*prefix, "capabilities"), robot.capabilities, capabilities, "the capabilities of the fleet")
    yield from _problems_of_capabilities(fleet, capabilities)
    yield from _each(("bodies",), fleet.bodies, fleet.roles, "the roles of the fleet")
    for index, substitute in enumerate(fleet.substitutes):
        yield from _unknown_name(
            ("substitutes", index, "of"), substitute.of, capabilities, "the capabilities of the fleet"
        )
        yield from _unknown_name(
            ("substitutes", index, "by"), substitute.by, capabilities, "the capabilities of the fleet"
        )
        earlier = [entry.of for entry in fleet.substitutes[:index]]
        yield from _first(("substitutes", index, "of"), substitute.of, earlier, "another substitute for it")
    yield from _problems_of_trust(fleet)
    for index, policy in enumerate(fleet.policies):
        yield from _unknown_name(("policies", index, "role"), policy.role, fleet.roles, "the roles of the fleet")
        if policy.capability is not None:
            field = ("policies", index, "capability")
            yield from _unknown_name(field, policy.capability, capabilities, "the capabilities of the fleet")
        yield from _within(("policies", index, "domain"), policy.domain, fleet)
        if _key(policy) in map(_key, fleet.policies[:index]):
            found = f"a second {policy.scope} rule of {policy.role} for {policy.capability or 'every capability'}"
            yield Problem(("policies", index), found, "each once in a domain")
    yield from _problems_of_spending(fleet)
    yield from _problems_of_shifts(fleet)


def _key(policy: Policy) -> tuple[str, str, str | None, str]:
    """Return the key of a rule; a second rule with the same key would replace it."""
    return policy.scope, policy.role, policy.capability, policy.domain


def _problems_of_capabilities(fleet: Fleet, names: Sequence[str]) -> Iterator[Problem]:
    lengths = dict(DURATIONS)
    for index, capability in enumerate(fleet.capabilities):
        prefix: Field = ("capabilities", index)
        yield from _malformed_name(
            (*prefix, "name"), capability.name, _CAPABILITY, "a name with a dot in it, such as door.open"
        )
        yield from _first((*prefix, "name"), capability.name, names[:index], "another capability of this name")
        for number, condition in enumerate(capability.postconditions):
            field = (*prefix, "postconditions", number)
            yield from _malformed_name(
                field, condition, _CONDITION, "a condition in lowercase letters, such as load.held"
            )
            yield from _first(field, condition, capability.postconditions[:number], "the same condition")
        yield from _each((*prefix, "visible_to"), capability.visible_to, fleet.roles, "the roles of the fleet")
        if capability.lasts_s is None:
            if capability.name not in lengths:
                yield Problem((*prefix, "lasts_s"), "nothing", "how long it takes, such as lasts_s = [2.0, 6.0]")
        elif not 0 <= capability.lasts_s[0] <= capability.lasts_s[1] <= END_US / 1e6:
            found = " to ".join(map(printable.number, capability.lasts_s))
            yield Problem(
                (*prefix, "lasts_s"), found, f"two durations, the shorter first, from 0 to {END_US / 1e6:g} s"
            )


def _problems_of_trust(fleet: Fleet) -> Iterator[Problem]:
    seen: set[tuple[str, str, str]] = set()
    for index, trust in enumerate(fleet.trust):
        prefix: Field = ("trust", index)
        yield from _unknown_name((*prefix, "role"), trust.role, fleet.roles, "the roles of the fleet")
        yield from _unknown_name((*prefix, "peer_role"), trust.peer_role, fleet.roles, "the roles of the fleet")
        yield from _within((*prefix, "domain"), trust.domain, fleet)
        pairs = {(trust.role, trust.peer_role, trust.domain)}
        if trust.is_mutual:
            pairs.add((trust.peer_role, trust.role, trust.domain))
        if pairs & seen:
            role, peer_role, _ = min(pairs & seen)
            yield Problem((*prefix, "role"), f"trust of {role} in {peer_role} a second time", "one entry for each pair")
        seen |= pairs
    for name in ("promote_after", "downgrade_after"):
        if (number := getattr(fleet.trust_by_record, name)) < 0:
            yield Problem(("trust_by_record", name), f"{number}", "so many results in a row, or 0: never")


def _problems_of_spending(fleet: Fleet) -> Iterator[Problem]:
    """Yield the problems of the supervision densities and the recovery budgets."""
    for index, density in enumerate(fleet.density):
        prefix: Field = ("density", index)
        if density.role is not None:
            yield from _unknown_name((*prefix, "role"), density.role, fleet.roles, "the roles of the fleet")
        if density.role in [earlier.role for earlier in fleet.density[:index]]:
            yield Problem(prefix, f"a second density of {density.role or 'every role'}", "each once")
        if density.review_every < 0:
            yield Problem((*prefix, "review_every"), f"{density.review_every}", "one admission in so many, or 0: none")
    for index, budget in enumerate(fleet.budgets):
        prefix = ("budgets", index)
        if budget.role is not None:
            yield from _unknown_name((*prefix, "role"), budget.role, fleet.roles, "the roles of the fleet")
        if (budget.role, budget.level) in [(earlier.role, earlier.level) for earlier in fleet.budgets[:index]]:
            yield Problem(
                prefix, f"a second budget of {budget.role or 'every role'} at level {budget.level}", "each once"
            )
        minimum = 1 if budget.level == "human" else 0  # an otherwise unresolved failure must reach a person
        end_s = END_US / 1e6
        if not minimum <= budget.time_s <= end_s:
            expected = f"seconds from {minimum} to {end_s:g} at level {budget.level}"
            yield Problem((*prefix, "time_s"), printable.number(budget.time_s), expected)
        if budget.attempts < minimum:
            yield Problem((*prefix, "attempts"), f"{budget.attempts}", f"at least {minimum} at level {budget.level}")


def _problems_of_shifts(fleet: Fleet) -> Iterator[Problem]:
    for index, spell in enumerate(fleet.off_shift):
        prefix: Field = ("off_shift", index)
        end_s = END_US / 1e6
        if not 0 <= spell.from_s < end_s:
            yield Problem((*prefix, "from_s"), printable.number(spell.from_s), f"seconds from 0, below {end_s:g}")
        if spell.to_s is not None and not spell.from_s < spell.to_s <= end_s:
            yield Problem(
                (*prefix, "to_s"),
                printable.number(spell.to_s),
                f"more than from_s, at most {end_s:g}, or none: to the end",
            )
        supervised = [robot.name for robot in fleet.robots if robot.has_supervisor]
        yield from _each(
            (*prefix, "robots"), spell.robots, supervised, "the robots that have a supervisor of their own"
        )
        if not spell.robots and not supervised:
            yield Problem(prefix, "a spell that concerns no supervisor", "robots that have a supervisor of their own")


def problems_of_design(design: Scenario | Workflow, fleet: Fleet) -> Iterator[Problem]:
    """Return the problems of the scenario or the workflow for this fleet, in the order of its fields."""
    return problems_of_workflow(design, fleet) if isinstance(design, Workflow) else problems_of_scenario(design, fleet)


def problems_of_scenario(scenario: Scenario, fleet: Fleet) -> Iterator[Problem]:
    """Yield the problems of the scenario, by itself or for this fleet, in the order of its fields."""
    yield from _malformed_name(
        ("name",), scenario.name, _NAME, "a name of lowercase letters, digits and -, such as night-shift"
    )
    if scenario.name.startswith("workflow-"):
        yield Problem(("name",), printable.value(scenario.name), "a name that does not begin like those of workflows")
    robots = {robot.name: robot for robot in fleet.robots}
    yield from _problems_of_tasks(scenario.tasks, robots, fleet)
    for index, injection in enumerate(scenario.injections):
        prefix: Field = ("injections", index)
        yield from _unknown_name(
            (*prefix, "requester"), injection.requester, robots, f"the robots of fleet {fleet.name}"
        )
        yield from _unknown_name((*prefix, "target"), injection.target, robots, f"the robots of fleet {fleet.name}")
        if injection.requester in robots and injection.target in robots:
            requester, target = robots[injection.requester], robots[injection.target]
            expected_from = f"the capabilities of {target.name}"
            yield from _unknown_name((*prefix, "capability"), injection.capability, target.capabilities, expected_from)
            if requester is target or _trusts(fleet, target, requester):
                expected = "two robots of which the target's role does not trust the requester's"
                yield Problem((*prefix, "requester"), f"{requester.name}, whom {target.name} trusts", expected)
        if not 1 <= injection.times <= MOST_TIMES:
            yield Problem((*prefix, "times"), str(injection.times), f"1 to {MOST_TIMES:,}")
    if (count := sum(injection.times for injection in scenario.injections)) > MOST_TIMES:
        yield Problem(("injections",), f"{count:,} requests per team", f"at most {MOST_TIMES:,}")
    yield from _each(("degradable",), scenario.degradable, robots, f"the robots of fleet {fleet.name}")


def problems_of_fact(fact: Event, fleet: Fleet, founded: Founded) -> Iterator[Problem]:
    """Yield the problems of a fact of the world that is added to a run of this fleet, as it is founded."""
    robots = [*founded.robots]
    supervisors = sorted({robot.supervisor for robot in founded.robots.values() if robot.supervisor is not None})
    for name, known in (("robot", robots), ("peer", robots), ("supervisor", supervisors)):
        named = getattr(fact, name, None)
        if named is not None and named not in known:
            hint = printable.did_you_mean(named, known)
            yield Problem((name,), printable.value(named), f"one of the fleet ({printable.list_few(known)}){hint}")
            return
    if isinstance(fact, OutsiderRequestInjected):
        names = [capability.name for capability in fleet.capabilities]
        yield from _unknown_name(("capability",), fact.capability, names, "the capabilities of the fleet")
    if not isinstance(fact, TaskArrived):
        return
    if not fact.task_id or "/" in fact.task_id or ":" in fact.task_id:
        yield Problem(("task_id",), printable.value(fact.task_id) or "none", "a name without a slash or a colon")
    if fact.robot is None:
        yield Problem(("robot",), "none", "a robot of the fleet")
        return
    team = founded.robots[fact.robot].team
    if fact.team != team:
        yield Problem(("team",), f"{fact.team or 'none'}", f"{team}, that of {fact.robot}")
    if not 0 < (fact.budget_us or 0) <= END_US:
        found = "none" if fact.budget_us is None else f"{fact.budget_us:,}"
        yield Problem(("budget_us",), found, f"its budget, 1 to {END_US:,} microseconds")
    owner = fact.robot.removeprefix("robot/").removesuffix(f"{team}")
    task = Task(owner, fact.steps, checkpoints=fact.checkpoints)
    for problem in _problems_of_tasks([task], {robot.name: robot for robot in fleet.robots}, fleet):
        yield problem._replace(field=problem.field[2:])


_NAMED: dict[type[Event], str] = {
    TaskArrived: "task_id",
    OutsiderRequestInjected: "task_id",
    PolicyWindowOpened: "window",
    ObstructionAppeared: "obstruction",
}
"""The fields that name facts; what has a name has it alone."""
_ENDS: dict[type[Event], type[Event]] = {
    PolicyWindowClosed: PolicyWindowOpened,
    ObstructionCleared: ObstructionAppeared,
}


def problems_of_name(fact: Event, events: Sequence[Event]) -> Iterator[Problem]:
    """Yield a problem if another of the events, which include the fact, has its name."""
    field = _NAMED.get(type(fact))
    name = None if field is None else getattr(fact, field)
    if isinstance(fact, CommandGiven) and fact.command == "SubmitTask":
        field, name = "task_id", msgspec.json.decode(fact.parameters)["task_id"]
    if field is not None:
        others = [event for event in events if _NAMED.get(type(event)) == field and getattr(event, field) == name]
        if len(others) > 1:
            yield Problem((field,), f"{printable.value(f'{name}')}, which is taken", "a new name")


def problems_of_end(fact: Event, before: Iterable[Event]) -> Iterator[Problem]:
    """Yield a problem if the fact ends a window or an obstruction that is not there after the events before it."""
    kind = type(fact)
    if kind in _ENDS:
        begins = _ENDS[kind]
        field = _NAMED[begins]
        alike = [event for event in before if type(event) in (kind, begins) and _about(event) == _about(fact)]
        last = [type(event) for event in alike[-1:]]
        if last != [begins]:
            name = printable.value(getattr(fact, field))
            yield Problem((field,), f"{name}, which is not there then", "one that is")


def _about(event: Event) -> list[str | None]:
    return [getattr(event, name, None) for name in ("robot", "scope", "window", "obstruction")]


def problems_of_workflow(workflow: Workflow, fleet: Fleet) -> Iterator[Problem]:
    """Yield the problems of the workflow, by itself or for this fleet, in the order of its fields."""
    if not workflow.name.startswith("workflow-"):
        yield Problem(("name",), printable.value(workflow.name), "a name that begins with workflow-")
    robots = {robot.name: robot for robot in fleet.robots}
    yield from _problems_of_tasks(workflow.tasks, robots, fleet)
    for index, wear in enumerate(workflow.wear):
        yield from _unknown_name(("wear", index, "robot"), wear.robot, robots, f"the robots of fleet {fleet.name}")


def _problems_of_tasks(tasks: Sequence[Task], robots: dict[str, Robot], fleet: Fleet) -> Iterator[Problem]:
    if not tasks:
        yield Problem(("tasks",), "none", "at least one task")
    for index, task in enumerate(tasks):
        prefix: Field = ("tasks", index)
        yield from _unknown_name((*prefix, "owner"), task.owner, robots, f"the robots of fleet {fleet.name}")
        if not (isfinite(task.offset_s) and 0 <= task.offset_s <= END_US / 1e6):
            yield Problem((*prefix, "offset_s"), printable.number(task.offset_s), f"seconds from 0 to {END_US / 1e6:g}")
        if not task.steps:
            yield Problem((*prefix, "steps"), "none", "at least one step")
        for number, step in enumerate(task.steps):
            yield from _problems_of_step((*prefix, "steps", number), step, robots, fleet)
        numbers = [str(number) for number in range(1, len(task.steps) + 1)]
        yield from _each((*prefix, "checkpoints"), task.checkpoints or (), numbers, "the numbers of its steps")


def _problems_of_step(field: Field, step: str, robots: dict[str, Robot], fleet: Fleet) -> Iterator[Problem]:
    words = step.split(" ")
    if not 2 <= len(words) <= 3 or not all(words):
        yield Problem(
            field, printable.named(step), "ROBOT CAPABILITY, or ROBOT CAPABILITY TARGET for one that it delegates"
        )
        return
    actor, capability, *target = words
    yield from _unknown_name(field, actor, robots, f"the robots of fleet {fleet.name}")
    names = [entry.name for entry in fleet.capabilities]
    yield from _unknown_name(field, capability, names, "the capabilities of the fleet")
    for doer in target or [actor]:
        if doer not in robots:
            if target:
                yield from _unknown_name(field, doer, robots, f"the robots of fleet {fleet.name}")
        elif capability in names and capability not in robots[doer].capabilities:
            capable = [name for name, robot in robots.items() if capability in robot.capabilities and name != actor]
            hint = f", or {actor} {capability} {capable[0]} to delegate it" if capable and not target else ""
            own = f"{doer}'s own: {', '.join(robots[doer].capabilities) or 'none'}"
            yield Problem(field, f"{capability}, which {doer} cannot do", f"a capability of {own}{hint}")
    if target and target[0] == actor:
        yield Problem(field, f"{actor} as its own target", f"{actor} {capability} for its own step, or another robot")


def _trusts(fleet: Fleet, robot: Robot, peer: Robot) -> bool:
    """Return whether the robot trusts the peer at the founding, by the entry of the smallest domain of both."""
    roles = robot.kind, peer.kind
    entries = [
        (len(entry.domain), entry.scope)
        for entry in fleet.trust
        if roles == (entry.role, entry.peer_role) or (entry.is_mutual and roles == (entry.peer_role, entry.role))
        if is_within(robot.domain, entry.domain) and is_within(peer.domain, entry.domain)
    ]
    return max(entries, default=(0, "none"), key=lambda entry: entry[0])[1] != "none"


def _within(field: Field, domain: str, fleet: Fleet) -> Iterator[Problem]:
    if not any(is_within(robot.domain, domain) for robot in fleet.robots):
        domains = tuple(dict.fromkeys(robot.domain for robot in fleet.robots if robot.domain))
        yield from _unknown_name(field, domain, domains, "the domains of the fleet's robots, or one around them")


def _malformed_name(field: Field, name: str, pattern: re.Pattern[str], expected: str) -> Iterator[Problem]:
    if not pattern.fullmatch(name):
        yield Problem(field, printable.named(name), expected)


def _first(field: Field, name: str, earlier: Sequence[str], found: str) -> Iterator[Problem]:
    if name in earlier:
        yield Problem(field, f"{found}: {printable.value(name)}", "each once")


def _each(field: Field, names: Sequence[str], known: Collection[str], what: str) -> Iterator[Problem]:
    for index, name in enumerate(names):
        yield from _unknown_name((*field, index), name, known, what)
        yield from _first((*field, index), name, names[:index], "it twice")


def _unknown_name(field: Field, name: str, known: Collection[str], what: str) -> Iterator[Problem]:
    if name not in known:
        hint = printable.did_you_mean(name, known)
        yield Problem(field, printable.named(name), f"one of {what} ({', '.join(known) or 'none'}){hint}")
