"""Causes: the smallest set of facts and answers with which an outcome still comes about, found over forks.

An outcome is a condition over a run, judged by SQL for many runs at once. `policy_violations > 0` compares a metric of
the run, `i3 > 0` how many events violate an invariant; a SELECT gives the `run_id` of each run that has the outcome. A
run in which a metric has no value neither has the outcome nor lacks it: without a task, nothing succeeded and nothing
failed.

A run's inputs are its world's facts and the answers at its ports. A fact that is taken away does not happen; without
an answer, an attempt holds, a supervisor answers as usual, and with `lengths`, a duration takes the middle of its
distribution. A set suffices if the outcome stands with it alone, and is 1-minimal if the outcome falls without any one
element. In the whole run without one element, new questions are answered as drawn, as in the fork. But-for tests alone
would miss causes when either of two suffices. A fact of the set without which the outcome has no value to compare is
presupposed, not a cause: without a task nothing fails, and nothing succeeds.

A live run's inputs are its commands. Without some of them it may ask a question that the record does not answer and
end there: it then neither has nor lacks the outcome, since how it would continue is unknown.

The search is the delta debugging of Zeller, Hildebrandt: Simplifying and Isolating Failure-Inducing Input (2002), with
many forks judged by one query.
"""

import re
from bisect import bisect_left
from collections.abc import Callable, Collection, Sequence
from itertools import pairwise
from typing import NamedTuple

import msgspec
import pyarrow as pa

from fsar_ledger.base import printable
from fsar_ledger.base.errors import QueryFailed, UsageError
from fsar_ledger.base.memory import without_collection
from fsar_ledger.ledger.rows.codec import LedgerRun, encode_coded
from fsar_ledger.metrics.database import from_table
from fsar_ledger.metrics.definitions import metrics
from fsar_ledger.metrics.invariants import invariants
from fsar_ledger.runtime.changeable import ATTEMPT, CALL, EditedEnvironment, Question, facts_by_name, name_of
from fsar_ledger.runtime.forks import edited_environment, kernel_of, run_to_end, world_of
from fsar_ledger.runtime.live import LiveKernel
from fsar_ledger.runtime.ports import Ask

from . import lines_of
from .fork_base import Rerun

_COMPARISON = re.compile(r"\s*([A-Za-z_0-9/]+)\s*(>=|<=|!=|<>|=|==|>|<)\s*(-?[0-9]+(?:\.[0-9]+)?)\s*")
_SELECT = re.compile(r"\s*(SELECT|WITH|FROM)\b", re.IGNORECASE)
_OPERATORS = {"==": "=", "!=": "<>"}
SECONDS, MEMORY_BYTES = 60, 1 << 32
"""The limits of a SELECT written by the user."""


class Outcome(NamedTuple):
    """A condition as given, and the SELECT of the runs that meet it; `is_own` if the user wrote that SELECT.

    `defined` is the SELECT of the runs that have a value to compare; empty: all of them.
    """

    text: str
    sql: str
    is_own: bool = False
    defined: str = ""

    def of(self, runs: Sequence[Sequence[object]]) -> list[bool | None]:
        """Return for each run, as (times, causes, events), whether it has the outcome; None where that is undefined.

        Raises:
            QueryFailed: The SELECT fails, or has no column `run_id` with names of runs.
        """
        records = [
            LedgerRun(f"{number}", run[0], run[1], run[2])  # type: ignore[arg-type]
            for number, run in enumerate(runs)
        ]
        with from_table(encode_coded(records)) as database:
            if self.is_own:
                database.check_one_select(self.sql)
                database.prepare(self.sql)
                database.lock(SECONDS, MEMORY_BYTES)
            table = database.table(self.sql)
            valued = {row["run_id"] for row in database.rows(self.defined)} if self.defined else None
        names = [record.run_id for record in records]
        matching = runs_named(table, names)
        return [None if valued is not None and name not in valued else name in matching for name in names]


def runs_named(found: pa.Table, runs: Collection[str]) -> set[str]:
    """Return the runs that the rows of an outcome name. Raises: QueryFailed if the rows do not name runs."""
    if "run_id" not in found.column_names:
        named = printable.list_few(map(printable.value, found.column_names))
        raise QueryFailed(f"outcome: found the columns {named}, expected run_id of each run with the outcome")
    run_ids = set(found.column("run_id").to_pylist())
    if run_ids and run_ids.isdisjoint(runs):
        named = printable.value(f"{run_ids.pop()}")
        raise QueryFailed(
            f"outcome: found the run_id {named}, which no run has, expected those of runs: `SELECT run_id FROM runs`"
        )
    return run_ids


def outcome_of(text: str) -> Outcome:
    """Return the outcome that a text describes. Raises: UsageError for an unknown name or form."""
    if _SELECT.match(text):
        return Outcome(text, text, is_own=True)
    match = _COMPARISON.fullmatch(text)
    if match is None:
        raise UsageError(
            f"outcome {printable.value(text)}: expected a metric or an invariant and a number, such as "
            "`policy_violations > 0` or `i3 > 0`, or a SELECT of run_id"
        )
    name, operator, number = match[1], _OPERATORS.get(match[2], match[2]), match[3]
    if name in (metric.name for metric in metrics()):
        defined = f"SELECT run_id FROM {name} WHERE value IS NOT NULL"
        return Outcome(text, f"SELECT run_id FROM {name} WHERE value {operator} {number}", defined=defined)
    aliases = {alias: query.relation for query in invariants() for alias in (query.relation, query.relation[:2])}
    relation = aliases.get(name.lower())
    if relation is None:
        names = [metric.name for metric in metrics()] + sorted(aliases)
        hint = printable.did_you_mean(name, names) or ";"
        raise UsageError(
            f"outcome {printable.value(text)}: there is no metric or invariant {printable.value(name)}{hint} expected "
            f"one of {', '.join(metric.name for metric in metrics())}, or an invariant, i1 to i5 and a1 to a5"
        )
    counted = f"SELECT run_id, count(DISTINCT seq) AS events FROM {relation} GROUP BY run_id"
    return Outcome(
        text,
        f"SELECT runs.run_id FROM runs LEFT JOIN ({counted}) AS found ON runs.run_id = found.run_id "
        f"WHERE coalesce(found.events, 0) {operator} {number}",
    )


Progress = Callable[[int], None]
USUAL = {ATTEMPT: 1, CALL: 0}
"""The default answers: an attempt holds, and the supervisor answers as the model's do."""
ALL_ELSE = "*"
"""In a set: questions that the original run does not ask are answered as drawn, too, and not as usual."""
MOST_AT_ONCE = 200
"""Forks judged together; more take more memory and no less time."""


class Element(msgspec.Struct, frozen=True):
    """A fact or an answer that a run took from outside: its name, and its description as in `log`.

    `seq` is the event of a fact, and `begins_s` when it happens in seconds of run time; None for an answer.
    `is_necessary`: the outcome falls if it alone is removed. `change` is the change text that removes it.
    """

    name: str
    words: str
    seq: int | None
    begins_s: float | None
    is_necessary: bool
    change: str


class Cause(msgspec.Struct, frozen=True):
    """A smallest set that suffices for an outcome, of `candidates` facts and answers; `forks` were played to find it.

    Members by what happens if they alone are removed: `elements`: the outcome falls; `presupposed`: there is nothing to
    judge; `unknown`: how the live run would continue is unknown. `also_necessary` are candidates outside the set
    whose removal alone makes the outcome fall, because it would be prevented or come about differently; a set can
    suffice without them.
    """

    outcome: str
    elements: tuple[Element, ...]
    presupposed: tuple[Element, ...]
    unknown: tuple[Element, ...]
    also_necessary: tuple[Element, ...]
    candidates: int
    forks: int


class Search:
    """The forks of one run with some of its inputs removed, and their outcomes."""

    def __init__(
        self, repeated: Rerun, outcome: Outcome, *, lengths: bool = False, progress: Progress | None = None
    ) -> None:
        """Collect the inputs of the run. `middles` are the lengths used in place of the world's, by name.

        Args:
            repeated: The run, made again.
            outcome: The outcome to explain.
            lengths: Whether the lengths of messages, ways, executions and responses count, too.
            progress: Called with the number of forks played.
        """
        self.played = 0
        self.ended: set[frozenset[str]] = set()
        self.middles: dict[str, int] = {}
        self._recipe = repeated.base.recipe
        self._edited = None if self._recipe.live is None else edited_environment(self._recipe)
        self._world = world_of(self._recipe)
        self._facts = tuple(self._world.facts)
        self._places = facts_by_name(self._facts)
        self._lengths = lengths
        self._outcome = outcome
        self._progress = progress
        self._known: dict[frozenset[str], bool | None] = {}
        answers = [
            question.name for question in dict.fromkeys(repeated.asked) if question.answer != USUAL.get(question.kind)
        ]
        if not lengths:
            answers = [name for name in answers if name.partition(":")[0] in USUAL]
        self.candidates: tuple[str, ...] = (*self._places, *dict.fromkeys(answers))

    def judge(self, sets: Sequence[frozenset[str]]) -> list[bool | None]:
        """Return for each set whether the outcome stands with it alone; None: undefined. Raises: QueryFailed."""
        new = [subset for subset in dict.fromkeys(sets) if subset not in self._known]
        for begin in range(0, len(new), MOST_AT_ONCE):
            batch = new[begin : begin + MOST_AT_ONCE]
            with without_collection():
                runs = [self._play(subset) for subset in batch]
            self._known |= dict(zip(batch, self._outcome.of(runs), strict=True))
            self._known |= dict.fromkeys(self.ended.intersection(batch))
            self.played += len(batch)
            if self._progress is not None:
                self._progress(self.played)
        return [self._known[subset] for subset in sets]

    def holds(self, one: frozenset[str]) -> bool:
        """Return whether the outcome is defined and stands with this set alone. Raises: QueryFailed."""
        return self.judge([one]) == [True]

    def without_one(self, names: Sequence[str]) -> list[bool | None]:
        """Return for each candidate whether the outcome stands in the whole run without it alone, as in its fork."""
        whole = frozenset((*self.candidates, ALL_ELSE))
        return self.judge([whole - {name} for name in names])

    def _play(self, kept: frozenset[str]) -> tuple[Sequence[int], Sequence[int | None], Sequence[object]]:
        removed = {index for name, indexes in self._places.items() if name not in kept for index in indexes}
        facts = [fact for index, fact in enumerate(self._facts) if index not in removed]
        usual, candidates = self._world.answer, {*self.candidates}

        def answer(ask: Ask) -> int:
            drawn = usual(ask)
            name = name_of(ask)
            if name is None or name in kept or (ALL_ELSE in kept and name not in candidates):
                return drawn
            kind = name.partition(":")[0]
            if kind in USUAL:
                return USUAL[kind]
            if not self._lengths:
                return drawn
            self.middles[name] = self._world.middle(ask)
            return self.middles[name]

        reduced = EditedEnvironment(self._world, facts, ())
        reduced.answer = answer
        if self._edited is not None:
            reduced = self._edited
            reduced.facts = facts
        kernel = kernel_of(self._recipe, reduced)
        run_to_end(kernel, reduced, self._recipe)
        if isinstance(kernel, LiveKernel) and kernel.end is not None:
            self.ended.add(kept)
        return kernel.times_us, kernel.caused_by, kernel.events


def smallest(search: Search) -> frozenset[str]:
    """Return a 1-minimal set of candidates with which alone the outcome stands. Raises: UsageError, QueryFailed."""
    whole = frozenset(search.candidates)
    if not search.holds(whole):
        raise UsageError("outcome: the run does not have it, expected one that it has; `metrics` shows what it has")
    if search.holds(frozenset()):
        raise UsageError(
            "outcome: it occurs even if nothing happens in the world, so no fact or answer causes it; expected one "
            "that needs a cause"
        )
    kept = list(search.candidates)
    parts = 8
    while True:
        parts = min(parts, len(kept))
        bounds = [len(kept) * number // parts for number in range(parts + 1)]
        chunks = [kept[begin:end] for begin, end in pairwise(bounds)]
        left = [frozenset(kept) - frozenset(chunk) for chunk in chunks]
        removable = [chunk for chunk, stands in zip(chunks, search.judge(left), strict=True) if stands]
        if removable:
            kept = _without(search, kept, removable)
            parts = max(2, min(parts, len(kept)))
        elif parts >= len(kept):
            return frozenset(kept)
        else:
            parts = min(2 * parts, len(kept))


def _without(search: Search, kept: list[str], removable: list[list[str]]) -> list[str]:
    """Return `kept` without as many of these chunks as can be removed with the outcome still standing, at least one.

    Each can be removed alone; half of them together may still be too many.
    """
    removed = removable
    while len(removed) > 1:
        remaining = frozenset(kept) - frozenset(name for chunk in removed for name in chunk)
        if search.holds(remaining):
            break
        removed = removed[: (len(removed) + 1) // 2]
    names = {name for chunk in removed for name in chunk}
    return [name for name in kept if name not in names]


def cause(repeated: Rerun, outcome: Outcome, *, lengths: bool = False, progress: Progress | None = None) -> Cause:
    """Return a smallest cause of the outcome of a run.

    Raises:
        UsageError: The run does not have the outcome, or it needs no cause.
        QueryFailed: The SELECT of the outcome fails.
    """
    search = Search(repeated, outcome, lengths=lengths, progress=progress)
    kept = smallest(search)
    names = [name for name in search.candidates if name in kept]
    alone = dict(zip(names, search.judge([kept - {name} for name in names]), strict=True))
    singles = search.without_one(search.candidates)
    necessary = {name for name, stands in zip(search.candidates, singles, strict=True) if stands is False}
    significant = kept | necessary
    targets = {entry.name: entry for entry in repeated.changeable() if entry.name in significant}
    seqs = {name: _seq(repeated, entry.begins_s) for name, entry in targets.items() if entry.begins_s is not None}
    record = repeated.base.record
    lines = lines_of([record], [(record.run_id, seq) for seq in seqs.values()])

    def element(name: str) -> Element:
        kind, entry, seq = name.partition(":")[0], targets[name], seqs.get(name)
        change = {ATTEMPT: f"answer {name} hold", CALL: f"answer {name} approve"}.get(kind, f"drop {name}")
        if name in search.middles:
            change = f"answer {name} {Question(name, search.middles[name]).text}"
        words = f"the answer is {entry.is_now}" if seq is None else lines[(record.run_id, seq)].text
        return Element(name, words, seq, entry.begins_s, name in necessary, change)

    return Cause(
        outcome.text,
        tuple(element(name) for name in names if alone[name] is False),
        tuple(element(name) for name in names if alone[name] is None and kept - {name} not in search.ended),
        tuple(element(name) for name in names if kept - {name} in search.ended),
        tuple(element(name) for name in search.candidates if name in necessary - kept),
        len(search.candidates),
        search.played,
    )


def _seq(repeated: Rerun, begins_s: float) -> int:
    """Return the seq of a fact's event; no two facts share a time, and only event 0 causes them."""
    record = repeated.base.record
    time_us = round(begins_s * 1_000_000)
    return next(
        seq for seq in range(bisect_left(record.times_us, time_us), len(record.events)) if record.caused_by[seq] == 0
    )
