"""Forks: runs that repeat another run up to a change and continue under the same draws.

A fork's environment is its base's with some facts and answers edited. A live run forks from its commands.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.constants import END_US
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.runs import parts_at, until
from fsar_ledger.projections.fleet import NEVER_US, Fleet

from .change_texts import COMMAND, altered, fact_of
from .changeable import (
    EditedEnvironment,
    FactPositions,
    Question,
    QuestionRecorder,
    continued,
    facts_by_name,
    happens_once,
    matching_names,
    united,
)
from .changes import (
    NOW,
    TO_0_15,
    UP_TO_0_16,
    Add,
    Answer,
    Budget,
    Changes,
    Commanded,
    Density,
    Drop,
    Move,
    OfFacts,
    Rule,
    Rules,
    Set,
    Trust,
    microseconds_of,
    seconds_text,
)
from .handlers.policy import SetPolicyRule
from .handlers.public import command_record, commands
from .handlers.recovery import SetRecoveryBudget
from .handlers.supervision import SetSupervisionDensity
from .handlers.trust import SetTrust
from .kernel import Kernel
from .live import End, LiveKernel
from .ports import Fact, World
from .recipes import Recipe, base_of, constants_by_time, require_possible, started_of, with_changes
from .simulation import draws_of, environment_of, fleet_founding, founding_of, handler_table_of, run_id
from .world import Draws, SimulatedEnvironment

_Placed = tuple[int, Event, int | None]
"""A fact in an edited world: its time, event, and index among the unedited facts, or None if it was added."""


def edited_facts(
    facts: Sequence[Fact],
    changes: Sequence[OfFacts],
    last_us: int = END_US,
    rules: Rules = NOW,
) -> tuple[Fact, ...]:
    """Return the facts with these changes, in order of time, no two at the same microsecond and none after `last_us`.

    Names are resolved in the facts as given. A name that no fact has changes nothing. A task that is moved or added is
    due when its budget ends. Spells of one principal that overlap through these changes end when both have ended.
    Earlier `rules` differ.

    Raises:
        UsageError: A fact would happen before the run begins, or after it has ended.
    """
    placed, names = _indexed_facts(facts), facts_by_name(tuple(facts))
    for change in changes:
        if rules == TO_0_15:
            remaining = _unplaced(placed)
            placed, names = _indexed_facts(remaining), facts_by_name(remaining)
        placed = _changed(placed, change, names, last_us, rules)
    return _unplaced(placed) if rules in UP_TO_0_16 else united(_unplaced(placed), _placed_by(changes, facts))


def _placed_by(changes: Sequence[OfFacts], facts: Sequence[Fact]) -> list[Event]:
    """Return the facts that the changes add or move."""
    names = facts_by_name(tuple(facts))
    moved = [name for change in changes if isinstance(change, Move) for name in matching_names(change.fact, names)]
    added = [fact_of(change.event) for change in changes if isinstance(change, Add)]
    return [*added, *(facts[index][1] for name in moved for index in names[name])]


def _indexed_facts(facts: Sequence[Fact]) -> list[_Placed]:
    return [(time_us, fact, index) for index, (time_us, fact) in enumerate(facts)]


def _unplaced(facts: list[_Placed]) -> tuple[Fact, ...]:
    return tuple((time_us, fact) for time_us, fact, _ in facts)


def _changed(facts: list[_Placed], change: OfFacts, names: FactPositions, last_us: int, rules: Rules) -> list[_Placed]:
    if isinstance(change, Add):
        time_us = _within(change, microseconds_of(change.at_s), last_us)
        return _apart(facts, [(time_us, fact_of(change.event), None)], rules)
    indices = {index for name in matching_names(change.fact, names) for index in names[name]}
    remaining = [entry for entry in facts if entry[2] not in indices]
    if isinstance(change, Drop):
        return remaining
    by_us = microseconds_of(change.by_s)
    moved: list[_Placed] = [
        (_within(change, time_us + by_us, last_us), fact, index) for time_us, fact, index in facts if index in indices
    ]
    return _apart(remaining, moved, rules)


def _within(change: Add | Move, time_us: int, last_us: int) -> int:
    if not 1 <= time_us <= last_us:
        raise UsageError(
            f"change {change}: found a fact at {seconds_text(time_us / 1_000_000)}, expected it after the beginning of "
            f"the run and before its last possible end, {seconds_text(last_us / 1_000_000)}"
        )
    return time_us


def _apart(facts: list[_Placed], inserted: list[_Placed], rules: Rules = NOW) -> list[_Placed]:
    """Return all facts in order of time; the inserted ones move to the next free microsecond."""
    taken = {time_us for time_us, *_ in facts}
    placed: list[_Placed] = []
    for time_us, fact, index in inserted:
        while time_us in taken:
            time_us += 1
        taken.add(time_us)
        if isinstance(fact, TaskArrived) and fact.budget_us is not None and rules == NOW:
            fact = msgspec.structs.replace(fact, due_us=time_us + fact.budget_us)
        placed.append((time_us, fact, index))
    return sorted((*facts, *placed), key=lambda entry: entry[0])


class Fork(NamedTuple):
    """A fork: its record, the first seq at which it differs from its base, and the questions it answered differently.

    `parts_at` ignores event 0, which always differs; None: the runs are equal. For a live run, `end` is where the fork
    ends early, and `left_out` are the recorded commands that would not have been given.
    """

    record: LedgerRun
    parts_at: int | None
    used: frozenset[str]
    end: End | None = None
    left_out: tuple[CommandGiven, ...] = ()


def world_of(recipe: Recipe) -> SimulatedEnvironment:
    """Return the world of the recipe without its changes; for a live run, its commands and the model's draws."""
    if recipe.live is not None:
        return SimulatedEnvironment(recipe.live.commands, draws_of(recipe.spec, recipe.constants))
    return environment_of(recipe.spec, recipe.constants)


def kernel_of(recipe: Recipe, edited: World) -> Kernel:
    """Return the run at its founding in this environment, with all its commands submitted."""
    if recipe.live is not None:
        assert isinstance(edited, EditedEnvironment)
        events, founded = fleet_founding(recipe.spec.fleet_size, recipe.constants, recipe.live.alone)
        return LiveKernel(((started_of(recipe), *events), founded), edited.facts, recipe.live, edited.answer_anew)
    table = handler_table_of(recipe.spec.architecture, recipe.spec.configuration)
    founding, founded = founding_of(recipe.spec, recipe.constants)
    kernel = Kernel(table, edited, founding, founded)
    command(kernel, recipe)
    return kernel


def edited_environment(recipe: Recipe) -> EditedEnvironment:
    """Return the world of the recipe with its changes of constants, facts and answers."""
    unedited = world_of(recipe)
    facts: tuple[Fact, ...] = tuple(unedited.facts)
    for from_us, era in eras(recipe):
        facts = continued(facts, tuple(era.facts), from_us, numbers_again=recipe.rules in UP_TO_0_16)
    fact_changes = [change for change in recipe.changes if isinstance(change, Drop | Move | Add)]
    answers = [change for change in recipe.changes if isinstance(change, Answer)]
    facts = _altered(facts, answers, recipe.rules)
    if recipe.live is None:
        facts = edited_facts(facts, fact_changes, rules=recipe.rules)
        return EditedEnvironment(unedited, facts, answers)
    facts = edited_facts(facts, fact_changes, recipe.live.until_us)
    fleet = fleet_founding(recipe.spec.fleet_size, recipe.constants, recipe.live.alone)[1].fleet
    issued = [(change, _commanded(fleet, change)) for change in recipe.changes if isinstance(change, Commanded)]
    commanded: list[_Placed] = [
        (max(1, microseconds_of(change.from_s)), command_record(command, command.issued_by), None)
        for change, command in issued
    ]
    facts = _unplaced(_apart(_indexed_facts(facts), commanded))

    def draws(seed: int) -> Draws:
        return draws_of(msgspec.structs.replace(recipe.spec, seed=seed), recipe.constants)

    return EditedEnvironment(unedited, facts, answers, cache(draws))


def _altered(facts: tuple[Fact, ...], changes: Sequence[Answer], rules: Rules) -> tuple[Fact, ...]:
    """Return the facts, with the commands that the changes name altered: as for questions, a name before a pattern."""
    names, edited, said, is_now = facts_by_name(facts), list(facts), set[tuple[int, str]](), rules == NOW
    for change in sorted(changes, key=lambda change: is_now and "*" in change.question):
        if change.question.startswith(COMMAND):
            field = change.answer.partition("=")[0]
            for index in (index for name in matching_names(change.question, names) for index in names[name]):
                time_us, command = edited[index]
                assert isinstance(command, CommandGiven)
                if not is_now or (index, field) not in said:
                    edited[index] = time_us, altered(command, change)
                said.add((index, field))
    return tuple(edited)


def eras(recipe: Recipe) -> list[tuple[int, World]]:
    """Return each time from which the world has other constants, with that world, in order. Units: microseconds."""
    return [
        (from_us, environment_of(recipe.spec, constants)) for from_us, constants in constants_by_time(recipe).items()
    ]


def command(kernel: Kernel, recipe: Recipe) -> None:
    """Submit the supervisors' commands of this recipe. Raises: UsageError if the architecture does not decide one."""
    for change in recipe.changes:
        if isinstance(change, Add) and isinstance(fact := fact_of(change.event), CommandGiven):
            decided = sorted(name for name, kind in commands().items() if kernel.decides(kind))
            if fact.command not in decided:
                raise UsageError(
                    f"change {change}: {recipe.spec.architecture} decides no {fact.command}, expected one of "
                    f"{', '.join(decided)}, or a run of fsar, which decides every command"
                )
        if isinstance(change, Rule | Trust | Budget | Density):
            issued = _commanded(kernel.state.fleet, change)
            if not kernel.decides(type(issued)):
                raise UsageError(
                    f"change {change}: {recipe.spec.architecture} decides no such command, expected a run of fsar"
                )
            kernel.submit(max(1, microseconds_of(change.from_s)), issued)


def _commanded(fleet: Fleet, change: Commanded) -> SetPolicyRule | SetTrust | SetRecoveryBudget | SetSupervisionDensity:
    """Return the command of a change, issued by the supervisor in charge."""
    match change:
        case Rule():
            supervisor = None
            if change.scope == "local" and change.robot is not None and change.robot in fleet.robots:
                supervisor = fleet.robots[change.robot].supervisor
            return SetPolicyRule(
                issued_by=supervisor or FLEET_SUPERVISOR,
                scope=change.scope,
                robot=change.robot,
                capability=change.capability,
                context=change.task,
                outcome=change.outcome,
            )
        case Trust():
            return SetTrust(
                issued_by=FLEET_SUPERVISOR,
                robot=change.robot,
                peer=change.peer,
                scope=change.scope,
                capability=change.capability,
                context=change.task,
                reason="changed",
            )
        case Budget():
            return SetRecoveryBudget(
                issued_by=FLEET_SUPERVISOR,
                robot=change.robot,
                level=change.level,
                t_max_us=microseconds_of(change.time_s),
                n_max=change.attempts,
            )
        case Density():
            robot = change.robot
            return SetSupervisionDensity(
                issued_by=FLEET_SUPERVISOR, robot=robot, review_every=change.review_every, reason="changed"
            )


def run_to_end(kernel: Kernel, edited: EditedEnvironment, recipe: Recipe) -> None:
    """Run to the end, switching to each era's world at its time; a live run ends where its record ends."""
    if recipe.live is not None:
        kernel.run(recipe.live.until_us)
        return
    for from_us, environment in eras(recipe):
        kernel.run(from_us - 1)
        edited.use_environment(environment)
        kernel.set_environment(edited)
    kernel.run()


def fork(base: Recipe, record: LedgerRun, root: str, changes: Changes) -> Fork:
    """Return the fork of a run: the base with these changes.

    Args:
        base: The recipe of the base.
        record: The record of the base, which its recipe reproduces.
        root: The root of the ledger that holds the base.
        changes: The changes; none gives a null fork.

    Raises:
        UsageError: A change names something that does not exist, or is impossible.
    """
    recipe = with_changes(base, changes)
    require_possible(recipe)
    _require_same_facts(base, changes)
    edited = edited_environment(recipe)
    kernel = kernel_of(recipe, edited)
    run_to_end(kernel, edited, recipe)
    end = kernel.end if isinstance(kernel, LiveKernel) else None
    first = parts_at(record if end is None else until(record, end.time_us), record_of(kernel))
    if end is None and first is not None and recipe.live is not None and recipe.live.until_us != NEVER_US:
        end = End(recipe.live.until_us, None, "the record ends there, and the run continues")
    origin = msgspec.structs.replace(
        started_of(base),
        forked_from_root=root,
        forked_from_run=record.run_id,
        forked_from_seq=_last_shared(record, first),
        changes=(),
    )
    kernel.events[0] = started_of(recipe, origin)
    left_out = tuple(kernel.left_out) if isinstance(kernel, LiveKernel) else ()
    return Fork(record_of(kernel), first, frozenset(edited.used), end, left_out)


def _require_same_facts(base: Recipe, changes: Changes) -> None:
    """Check that the constants which are set leave the facts that other changes name. Raises: UsageError."""
    sets = tuple(change for change in changes if isinstance(change, Set))
    named = [change for change in changes if isinstance(change, Drop | Move)]
    if not sets or not named or base.live is not None:
        return
    before, after = (edited_environment(with_changes(base, chosen)).facts for chosen in ((), sets))
    names, others = facts_by_name(tuple(before)), facts_by_name(tuple(after))
    for change in named:
        if change.fact not in names:  # a pattern is of whatever there is
            continue
        time_us, fact = before[names[change.fact][0]]
        other_us = after[others[change.fact][0]][0] if change.fact in others else None
        if other_us != time_us and (other_us is None or not happens_once(fact)):
            raise UsageError(
                f"change {change}: under {printable.list_few(map(str, sets))} the run has another fact of this name "
                "or none; expected a fact that it has at the same time with and without, or a pattern with *"
            )


def live_again(base: Recipe) -> tuple[LedgerRun, Recipe]:
    """Run the live run of this recipe again; return its record, and the recipe with its questions and its end.

    If nothing follows the record without further input, no question was open, and a fork can go on (`NEVER_US`).
    """
    assert base.live is not None
    kernel = kernel_of(base, edited_environment(base))
    assert isinstance(kernel, LiveKernel)
    kernel.run(base.live.until_us)
    rerun = record_of(kernel)
    record = LedgerRun(rerun.run_id, [*rerun.times_us], [*rerun.caused_by], [*rerun.events])
    asked = {question: tuple(times_us) for question, times_us in kernel.asked.items()}
    kernel.run(most=len(rerun.events) + 1)
    until_us = NEVER_US if len(kernel.events) == len(record.events) else base.live.until_us
    live = msgspec.structs.replace(base.live, asked=asked, until_us=until_us)
    return record, msgspec.structs.replace(base, live=live)


def run_again(base: Recipe) -> tuple[LedgerRun, list[Question]]:
    """Run the simulated run of this recipe, which has no changes; return its record and the questions it asked."""
    environment = QuestionRecorder(environment_of(base.spec, base.constants))
    kernel = kernel_of(base, environment)
    kernel.run()
    return record_of(kernel), environment.asked


def last_shared(recipe: Recipe, record: LedgerRun) -> int:
    """Return the last seq up to which a fork repeats its base, which is run again."""
    base, _ = run_again(base_of(recipe))
    return _last_shared(base, parts_at(base, record))


def _last_shared(base: LedgerRun, first: int | None) -> int:
    return (len(base.events) if first is None else first) - 1


def record_of(kernel: Kernel) -> LedgerRun:
    """Return the record of the run so far."""
    started = kernel.events[0]
    assert isinstance(started, RunStarted)
    return LedgerRun(run_id(started), kernel.times_us, kernel.caused_by, kernel.events)
