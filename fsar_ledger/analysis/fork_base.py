"""Recorded runs that can be forked, and the checks on the changes of a fork."""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs import OutsideCommand, Scenario, registered
from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.ledger.rows.runs import LedgerRun, parts_at, start_of
from fsar_ledger.runtime.change_texts import COMMAND, SHORT, fact_of, fact_text
from fsar_ledger.runtime.changeable import (
    CALL,
    KINDS,
    LIVE_KINDS,
    RESPONSE,
    FactPositions,
    Question,
    answer_of,
    facts_by_name,
    matching_names,
    numbers_of_calls,
)
from fsar_ledger.runtime.changes import (
    MODEL,
    Add,
    Answer,
    AnyChange,
    Budget,
    Changes,
    Commanded,
    Density,
    Drop,
    Move,
    Rule,
    Set,
    Trust,
    microseconds_of,
    seconds_text,
)
from fsar_ledger.runtime.forks import Fork, edited_environment, fork, live_again, run_again
from fsar_ledger.runtime.live import QuestionKey, commands_of
from fsar_ledger.runtime.own import problems_of_commands
from fsar_ledger.runtime.recipes import CannotReplay, Recipe, recipe_of
from fsar_ledger.runtime.simulation import founding_of
from fsar_ledger.runtime.world.checks import problems_of_end, problems_of_fact, problems_of_name

LIST = "`whatif LEDGER --run RUN --list` lists all"


class Base(NamedTuple):
    """A recorded run, its recipe, and the root of the ledger that holds it."""

    record: LedgerRun
    recipe: Recipe
    root: str

    @property
    def facts_by_name(self) -> FactPositions:
        """Return the indexes of the facts of its world, by name."""
        return facts_by_name(tuple(edited_environment(self.recipe).facts))


class Changeable(msgspec.Struct, frozen=True):
    """A fact or a question of a run that a change can name.

    `begins_s`, `ends_s`: when the fact happens, seconds of run time; None for a question and what has no end. `is_now`:
    what happens, or the answer. `short`: a shorter name.
    """

    name: str
    short: str | None
    begins_s: float | None
    ends_s: float | None
    is_now: str


class Rerun(NamedTuple):
    """A base made again as recorded, and its questions at ports, in order; those of a live run are `of_whom`."""

    base: Base
    asked: list[Question]
    of_whom: Sequence[QuestionKey] = ()

    def changeable(self) -> list[Changeable]:
        """Return the facts of the world in order of time, then the questions in the order asked, each once."""
        facts = edited_environment(self.base.recipe).facts
        items = []
        for name, indexes in self.base.facts_by_name.items():
            (begins_us, fact), (ends_us, _) = facts[indexes[0]], facts[indexes[-1]]
            ends_s = ends_us / 1_000_000 if len(indexes) > 1 else None
            items.append(Changeable(name, None, begins_us / 1_000_000, ends_s, fact_text(fact)))
        numbers = numbers_of_calls(self.asked)
        for ask in dict.fromkeys(self.asked):
            number = numbers.get(CALL + ask.name.partition(":")[2]) if ask.kind in _SHORT else None
            items.append(Changeable(ask.name, None if number is None else f"{ask.kind}:{number}", None, None, ask.text))
        items += [Changeable(name, None, None, None, f"{whom} says so by a command") for name, whom in self.of_whom]
        return items

    def with_answers(self, answers: Changes) -> "Rerun":
        """Return the live run, unchanged, whose forks let these changes answer what the record does not."""
        recipe = msgspec.structs.replace(self.base.recipe, changes=answers)
        return self._replace(base=self.base._replace(recipe=recipe))

    def fork(self, changes: Changes) -> Fork:
        """Return the fork with these changes; a name that matches nothing here changes nothing. Raises: UsageError."""
        return fork(self.base.recipe, self.base.record, self.base.root, changes)

    def checked_fork(self, changes: Changes) -> Fork:
        """Return the fork with these changes. Raises: UsageError; also if it cannot be played with an added fact."""
        try:
            forked = self.fork(changes)
        except (LookupError, ValueError, RuntimeError, TypeError) as error:
            added = [change for change in changes if isinstance(change, Add)]
            if isinstance(error, UsageError) or not added:
                raise
            for change in added:
                _require_meant(self, change)
            raise UsageError(
                f"change {added[0]}: the run cannot be simulated with it ({type(error).__name__}: {error!s:.200}), "
                "expected a fact that this fleet can meet"
            ) from error
        for change in (change for change in changes if isinstance(change, Add)):
            for problem in problems_of_name(fact_of(change.event), forked.record.events):
                raise UsageError(f"change {change}: {problem}")
        return forked

    def fork_with_effect(self, changes: Changes) -> Fork:
        """Return the fork with these changes. Raises: UsageError if one of them does nothing."""
        for change in changes:
            _require_meant(self, change)
        forked = self.checked_fork(changes)
        for change in changes:
            if isinstance(change, Answer):
                _require_used(self, change, forked)
            _require_named(self, change, forked)
        if rejected := _rejected_in(self.base, forked):
            raise UsageError(_rejection(forked.record.events[rejected[0]]))
        is_same = forked.parts_at is None and forked.end is None
        if is_same and any(not _is_of_model(change) for change in changes):
            text = printable.list_few(map(str, changes))
            raise UsageError(f"change {text}: it has no effect on the run; expected one that has")
        return forked

    def refused(self, change: AnyChange, forked: Fork) -> str | None:
        """Return why an addition, a constant or a command does not apply to the run; None: it does."""
        try:
            if isinstance(change, Add | Set | Commanded):
                _require_meant(self, change)
            _require_named(self, change, forked)
        except UsageError as error:
            return str(error)
        return None


def base_of_record(record: LedgerRun, root: str) -> Base:
    """Return the record as a base. Raises: UsageError if this version cannot make the run, or it is a fork."""
    run, started = printable.value(record.run_id), start_of(record)
    if started.changes is not None:
        raise UsageError(
            f"run {run}: found a fork, expected the run that it forks from, "
            f"{printable.value(started.forked_from_run or '?')}; give all changes at once"
        )
    try:
        return Base(record, recipe_of(record, started), root)
    except CannotReplay as error:
        raise UsageError(f"run {run}: {error}; only such a run can be replayed with a change") from error


def rerun(base: Base) -> Rerun:
    """Make the base again. Raises: UsageError naming the first event that differs from the record."""
    of_whom: Iterable[QuestionKey] = ()
    questions: list[Question] = []
    try:
        if base.recipe.live is None:
            remade, questions = run_again(base.recipe)
        else:
            remade, recipe = live_again(base.recipe)
            base = base._replace(recipe=recipe)
            of_whom = (recipe.live.asked or ()) if recipe.live is not None else ()
    except (LookupError, ValueError, RuntimeError, TypeError) as error:
        raise UsageError(
            f"run {printable.value(base.record.run_id)}: it cannot be replayed ({error!s:.300}); run "
            "`fsar-ledger verify --replay`"
        ) from error
    seq = parts_at(base.record, remade)
    if seq is not None or remade.events[0] != base.record.events[0]:
        raise UsageError(
            f"run {printable.value(base.record.run_id)}, event {seq or 0}: the record is not what its world and its "
            "handlers make, so it cannot be forked; run `fsar-ledger verify --replay`, which says what differs"
        )
    return Rerun(base, questions, tuple(of_whom))


def _is_of_model(change: AnyChange) -> bool:
    """Return whether the change lets the model answer what the record of a live run does not."""
    return isinstance(change, Answer) and change.answer.startswith(MODEL)


def _require_meant(rerun: Rerun, change: AnyChange) -> None:
    """Check that a change applies to the run. Raises: UsageError, with the nearest name."""
    base = rerun.base
    last_us = base.record.times_us[-1]
    match change:
        case Answer() if change.question.startswith(COMMAND):
            if not matching_names(change.question, base.facts_by_name):
                raise _unknown("command", change, change.question, list(base.facts_by_name))
        case Drop() | Move():
            names = base.facts_by_name
            if not matching_names(change.fact, names):
                raise _unknown("fact", change, change.fact, list(names))
        case Add():
            _require_members(base, change)
        case Answer():
            _require_answer(change, LIVE_KINDS if base.recipe.live is not None else KINDS)
        case _:
            pass
    from_s = getattr(change, "at_s", None) if isinstance(change, Add) else getattr(change, "from_s", None)
    if isinstance(change, Add | Set | Commanded) and from_s is not None and from_s * 1_000_000 > last_us:
        raise UsageError(
            f"change {change}: the run has ended by then, at {seconds_text(last_us / 1_000_000)}; expected an earlier "
            "time"
        )


def _require_named(rerun: Rerun, change: AnyChange, forked: Fork) -> None:
    """Check that the fork has what the change names: its task, or what it ends. Raises: UsageError."""
    if isinstance(change, Add):
        fact, count = fact_of(change.event), bisect_left(forked.record.times_us, microseconds_of(change.at_s))
        events = forked.record.events
        before = events[: events.index(fact, count)] if fact in events[count:] else events
        for problem in problems_of_end(fact, before):
            raise UsageError(f"change {change}: {problem}")
    if not isinstance(change, Rule | Trust) or change.task is None:
        return
    records = (rerun.base.record, forked.record)
    tasks = {event.task_id: None for record in records for event in record.events if isinstance(event, TaskArrived)}
    if change.task not in tasks:
        raise _unknown("task", change, change.task, [*tasks])


def _require_members(base: Base, change: Add) -> None:
    """Check that an added fact is about robots and supervisors of this fleet. Raises: UsageError."""
    fact = fact_of(change.event)
    if base.recipe.live is not None and not isinstance(fact, CommandGiven):
        raise UsageError(
            f"change {change}: found a fact of the world, expected a command that reports it to a live run, such as "
            'add 20s {"command": "ReportPresence", "by": "robot/B1", "robot": "robot/B1", "is_on": false}'
        )
    if base.recipe.live is not None:
        return  # the handlers decide whether it can be carried out
    design = base.recipe.constants.fleet or registered.fleet()
    if isinstance(fact, CommandGiven):
        command = OutsideCommand(change.at_s, fact.command, fact.issued_by, fact.parameters)
        for problem in problems_of_commands(Scenario("", (), commands=(command,)), design):
            raise UsageError(f"change {change}: {problem._replace(field=problem.field[2:])}")
        return
    fleet = founding_of(base.recipe.spec, base.recipe.constants)[1].fleet
    for problem in problems_of_fact(fact, design, fleet):
        raise UsageError(f"change {change}: {problem}")


def _require_answer(change: Answer, kinds: Sequence[str]) -> None:
    """Check that the question is of a known kind and can be answered so. Raises: UsageError."""
    kind = change.question.partition(":")[0]
    is_live = kinds is LIVE_KINDS
    is_of_model = is_live and _is_of_model(change)
    if kind not in kinds and not (is_of_model and change.question == "*"):
        raise _unknown("question", change, change.question, [f"{known}:" for known in kinds])
    if is_of_model:
        if not change.answer.removeprefix(MODEL).isdecimal():
            raise UsageError(f"change {change}: found {printable.value(change.answer)}, expected {MODEL} and a seed")
        return
    if is_live and kind in _SHORT and "/" not in change.question and "*" not in change.question:
        raise UsageError(
            f"change {change}: found a number, expected the name of the call, as printed where the fork ends"
        )
    if answer_of(kind, change.answer) is None:
        words = {CALL: "approve, deny or other", "attempt": "hold or fail", "admission": "accept", "help": "accept"}
        expected = words.get(kind, "a length, such as 2.5s, or never")
        expected += f", or {MODEL} and a seed" if is_live else ""
        raise UsageError(f"change {change}: found {printable.value(change.answer)}, expected {expected}")


def _require_used(rerun: Rerun, change: Answer, forked: Fork) -> None:
    """Check that a question was answered otherwise. Raises: UsageError, saying why it was not."""
    if change.question in forked.used or change.question.startswith(COMMAND) or _is_of_model(change):
        return
    if rerun.base.recipe.live is not None:
        asked = matching_names(change.question, [name for name, _ in rerun.of_whom])
        raise UsageError(
            f"change {change}: {asked[0]} was also asked on record; expected a change of the command that answers it, "
            f"such as answer {COMMAND}NAME/N FIELD=VALUE, or drop and add; {LIST}"
            if asked
            else f"change {change}: it has no effect, nobody is asked this in the fork"
        )
    names = {question.name: question for question in rerun.asked}
    calls = numbers_of_calls(rerun.asked)
    short = {
        f"{kind}:{number}": f"{kind}{name.removeprefix(CALL)}" for name, number in calls.items() for kind in _SHORT
    }
    full = short.get(change.question, change.question)
    questions = [names[name] for name in matching_names(full, list(names))]
    if not questions and full not in short.values():
        raise _unknown("question", change, change.question, [*short, *names])
    if not questions:
        raise UsageError(f"change {change}: it has no effect, the call is settled before it is answered")
    why = f"the answer is {questions[0].text} already; expected another answer"
    if any(question.text != change.answer for question in questions):
        why = "with the other changes nobody asks that, or another of them answers it"
    raise UsageError(f"change {change}: it has no effect, {why}")


_SHORT = (CALL, RESPONSE)
"""The kinds of question that a number can stand for."""


def _unknown(what: str, change: AnyChange, unknown: str, names: Sequence[str]) -> UsageError:
    kind = unknown.partition(":")[0]
    is_kind = kind in (*LIVE_KINDS, *SHORT, "task", "outsider", "command")
    alike = [name for name in names if name.partition(":")[0] == kind or not is_kind]
    hint = printable.did_you_mean(unknown, alike) or ";"
    few = printable.list_few(map(printable.value, alike))
    options = f"expected one of {few}" if alike else "it has none of this kind"
    return UsageError(f"change {change}: the run has no {what} {printable.value(unknown)}{hint} {options}; {LIST}")


def _rejected_in(base: Base, forked: Fork) -> list[int]:
    """Return the seqs at which a fork rejects a command that its base does not have."""
    recorded = {event for event in base.record.events if isinstance(event, CommandRejected)}
    commands = set(commands_of(base.record))
    fork, rejected = forked.record, []
    for seq, (event, cause) in enumerate(zip(fork.events, fork.caused_by, strict=True)):
        is_on_record = cause is not None and (fork.times_us[cause], fork.events[cause]) in commands  # it was tried
        if isinstance(event, CommandRejected) and event not in recorded and not is_on_record:
            rejected.append(seq)
    return rejected


def _rejection(event: Event) -> str:
    """Return a rejection in words."""
    assert isinstance(event, CommandRejected)
    return f"{event.command} about {event.subject} is rejected: {event.reason}"


class Refusal(NamedTuple):
    """Why a change of a fork is refused, and whether the fork otherwise does the same as its base."""

    why: str
    is_same: bool


def refusal(rerun: Rerun, changes: Changes, forked: Fork) -> Refusal | None:
    """Return the refusal of changes in the fork, worded as by `fork_with_effect`; None: nothing is refused."""
    base, fork = rerun.base.record, forked.record
    refused = {change: why for change in changes if (why := rerun.refused(change, forked)) is not None}
    rejected = _rejected_in(rerun.base, forked)
    if not refused and not rejected:
        return None
    whys = [*refused.values(), *(_rejection(fork.events[seq]) for seq in rejected)]
    causes = [cause for seq in rejected if (cause := fork.caused_by[seq])]
    excluded = {*rejected, *(seq for seq in causes if isinstance(fork.events[seq], CommandGiven))}
    for seq, (time_us, cause, event) in enumerate(zip(fork.times_us, fork.caused_by, fork.events, strict=True)):
        if seq and not cause and any(_is_of(change, time_us, event, base.times_us[-1]) for change in refused):
            excluded.add(seq)
    return Refusal(whys[0], forked.end is None and _rest(fork, excluded) == _rest(base, ()))


def _is_of(change: AnyChange, time_us: int, event: Event, last_us: int) -> bool:
    """Return whether an uncaused event is that of the change, which is refused in a run that ends at `last_us`."""
    match change:
        case Add():
            is_then = 0 <= time_us - microseconds_of(change.at_s) < 100  # it moves to a free microsecond
            return is_then and event == fact_of(change.event)
        case Rule() | Trust() if change.task is not None and getattr(event, "context", None) == change.task:
            return True
        case Set() | Rule() | Trust() | Budget() | Density() if change.from_s is not None:
            return time_us >= microseconds_of(change.from_s) > last_us
        case _:
            return False


def _rest(record: LedgerRun, excluded: Iterable[int]) -> list[tuple[int, int | None, Event]]:
    """Return the events after event 0, without the excluded ones and their effects."""
    rest: list[tuple[int, int | None, Event]] = []
    skipped, positions = {*excluded}, {0: 0}
    for seq, (time_us, cause, event) in enumerate(zip(record.times_us, record.caused_by, record.events, strict=True)):
        if seq in skipped or cause in skipped:
            skipped.add(seq)
        elif seq:
            rest.append((time_us, None if cause is None else positions[cause], event))
            positions[seq] = len(rest)
    return rest
