"""The verbs `state` and `step`: the situation at a moment of a run, and a walk through its moments."""

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from operator import itemgetter
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Screen
from .names import Time, microseconds
from .verbs import JSON, Gives, OneRunOption, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.analysis.moments import Belief
    from fsar_ledger.analysis.situation import RobotNow, RuleNow, Situation, TrustNow
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.projections.fold import State

    from .ledger import Ledger

BESIDE = "    "


class Moment(Answer, msgspec.Struct, frozen=True, kw_only=True):
    """The situation in a run at a time.

    `seq` is the last event that had happened by then, and `event_s` its time; `ends_s` that of the last of the run.
    `clock` is the time in UTC, None if the run has no epoch. `commit` is the commit of the ledger, from 1, that
    recorded the run. `beliefs` are what a decider had been told, None unless requested. `state` are the projections
    themselves. Units: seconds of run time.
    """

    run: str
    at_s: float
    seq: int
    event_s: float
    ends_s: float
    clock: str | None
    commit: int
    standing: "Situation"
    beliefs: "list[Belief] | None"
    state: "State"
    provenance: "Provenance"

    def document(self, screen: Screen) -> Mapping[str, object]:
        """Return all but the projections."""
        return {name: value for name, value in Answer.document(self, screen).items() if name != "state"}

    def text(self, screen: Screen) -> Iterator[printable.SafeText]:
        """Yield the situation, and what was believed."""
        ends = " of" if self.at_s <= self.ends_s else ", after the recorded events, which end at"  # with --by-commit
        yield printable.lines(
            screen.run_text(self.run),
            *([] if self.clock is None else [f"at {self.clock}"]),
            f"at {self.at_s:.3f} s{ends} {self.ends_s:.3f} s, after event {self.seq} at {self.event_s:.3f} s",
            f"recorded with commit {self.commit}",
            *standing_lines(self.standing),
        )
        if self.beliefs is not None:
            beliefs = (f"{BESIDE}{line}" for line in map(_belief, self.beliefs))
            yield printable.lines("", "what it had been told, and what was true", *beliefs)


@verb(
    "state out/ledger --run 1 --at 46.6s",
    "state out/ledger --run 2 --at 72s --as-known-by coordinator",
    "state out/ledger --run 1 --at 72s --robot B1 --json",
    takes=JSON,
)
def state(
    ledger: "Ledger",
    run: OneRunOption,
    at: Time = declare(
        "TIME", "Within the run: 46.6, 46.6s or 46600ms, or 2026-03-01T10:00Z if it has an epoch.", "its end"
    ),
    *,
    robot: str | None = declare("ROBOT", "Only what involves this robot.", "all"),
    as_known_by: str | None = declare(
        "DECIDER", "Also what this decider had been told: coordinator, robot/A1, service/registry, agent/A1/planning."
    ),
    by_commit: int | None = declare("N", "Only what the ledger had recorded after N commits.", "all"),
) -> Moment:
    """Show a fleet at a moment of a run: who does what, what waits, what is in force, and what is open.

    There are two kinds of time: --at is a moment of the run, and --by-commit says how much the ledger had recorded.
    With --as-known-by, also show what a decider had been told by then, how old that was, and what was true: it decides
    by what it was told.

    Raises:
        UsageError: There is no such run, robot or decider, `at` is no time of the run, or the run came later.
    """
    from fsar_ledger.analysis import commits_of
    from fsar_ledger.analysis.moments import beliefs, past_at
    from fsar_ledger.analysis.situation import situation
    from fsar_ledger.ledger.store.locations import end_of, pieces_of, seq_counted_on
    from fsar_ledger.metrics.provenance import of_run

    from .lookup import about_run, clock, present, robot_of, time_of

    view, provenance = present(ledger)
    with about_run(view, run, ledger.demanded) as (database, name, _):
        at_us = time_of(database, "at", at, name)
        robot_name = None if robot is None else robot_of(database, robot, name)
        busy_us = _busy_us(database, name)
    commits = len(view.commits)
    run_commits = commits_of(view, name)

    def commit_with(seq: int) -> int:
        return run_commits[bisect_right(run_commits, seq, key=itemgetter(0)) - 1][1] + 1

    if by_commit is not None:
        if not 0 <= by_commit <= commits:
            raise UsageError(f"{option('by_commit', by_commit)}: expected 0 to {commits}, the commits of the ledger")
        if by_commit < (commit := commit_with(seq_counted_on(view, name, 0))):
            raise UsageError(
                f"{option('by_commit', by_commit)}: by then the ledger had recorded nothing of run "
                f"{printable.value(name)}, which came with commit {commit}"
            )
    size = None if by_commit is None else view.commits[by_commit - 1].tree_size
    ends_us = end_of(view, name, size)
    at_us = ends_us if at_us is None else at_us
    past = past_at(pieces_of(view, name, size), at_us)
    standing = situation(past, busy_us, robot_name)
    return Moment(
        run=name,
        at_s=at_us / 1e6,
        seq=past.seq,
        event_s=past.time_us / 1e6,
        ends_s=ends_us / 1e6,
        clock=clock(past.started, at_us),
        commit=commit_with(past.seq),
        standing=standing,
        beliefs=None if as_known_by is None else beliefs(past, as_known_by, at_us),
        state=past.state,
        provenance=of_run(provenance, standing.not_observed),
    )


def _busy_us(database: "Database", run: str) -> dict[str, int]:
    """Return until when each robot of the run may be busy with what began before its record."""
    rows = database.rows("SELECT robot, until_us FROM busy_before WHERE run_id = $run", {"run": run})
    return {row["robot"]: row["until_us"] for row in rows}


def standing_lines(found: "Situation") -> Iterator[str]:
    """Yield the lines of a situation: a paragraph for each robot, and one for each kind of open item."""
    for robot in found.robots or ():
        yield ""
        yield from _robot(robot)
    for name, lines in _lists(found).items():
        if lines:
            yield ""
            yield name
            yield from (f"{BESIDE}{line}" for line in lines)
    if found.not_observed:
        yield ""
        yield f"not observed, so not shown: {', '.join(found.not_observed)}"


def _robot(robot: "RobotNow") -> Iterator[str]:
    none = "no supervisor" if robot.has_supervisor is False else "supervisor ?"
    signs = [f"supervisor {printable.value(robot.supervisor)}"] if robot.supervisor else [none]
    signs += [f"DEPARTED ({robot.departed})"] if robot.departed else []
    signs += ["OFF"] if robot.is_on is False else []
    signs += ["NOT LINKED"] if robot.is_linked is False else []
    signs += [f"actuator {robot.grade}"] if robot.grade else []
    role, team = printable.value(robot.role or "?"), robot.team or "?"
    yield f"{printable.value(robot.robot)}  role {role}, team {team}; {', '.join(signs)}"
    if not robot.work:
        yield f"{BESIDE}{'idle' if robot.is_idle else 'what it does is not observed'}"
    for work in robot.work:
        what = f" {printable.value(work.capability)}" if work.capability else ""
        whose = f" for {printable.value(work.on_behalf_of)}" if work.on_behalf_of else ""
        until = "" if work.ends_s is None else f", until {work.ends_s:.3f} s"
        late = "; its beginning is not on record" if work.capability is None and work.stage != "helping" else ""
        yield f"{BESIDE}{work.stage} {printable.value(work.action_id)}{what}{whose}{until}{late}"
    if robot.queue:
        yield f"{BESIDE}waiting: {printable.list_few(map(printable.value, robot.queue))}"
    if robot.obstructions:
        yield f"{BESIDE}in its way: {printable.list_few(map(printable.value, robot.obstructions))}"
    for window in robot.windows or ():
        yield (
            f"{BESIDE}{window.scope} policy: {window.outcome}, window {printable.value(window.window)} since "
            f"{window.since_s:.3f} s (event {window.seq})"
        )
    for availability, names in (robot.offers or {}).items():
        if availability != "ready":
            yield f"{BESIDE}offers as {availability}: {printable.list_few(map(printable.value, names))}"


def _steps_done(count: int) -> str:
    """Describe the progress of a task whose number of steps is not on record."""
    return f"{count} steps done; the total is not on record" if count else "its steps are not on record"


def _lists(situation: "Situation") -> Mapping[str, list[str]]:
    text = printable.value
    return {
        "tasks": [
            f"{text(task.task_id)} of {text(task.robot or '?')}: "
            + (_steps_done(task.steps_done) if task.steps is None else f"{task.steps_done} of {task.steps} steps done")
            + (f", now {text(task.step)}" if task.step else "")
            + (f", attempt {task.attempt}" if task.attempt > 1 else "")
            + ("" if task.due_s is None else f"; due {task.due_s:.3f} s")
            for task in situation.tasks or ()
        ],
        "requests": [
            f"{text(one.action_id)} {text(one.capability)}: {text(one.requester)} -> {text(one.target or '?')}, "
            f"{one.phase}"
            for one in situation.requests or ()
            if one.target != one.requester
        ],
        "claims": [
            f"{text(claim.action_id)} {claim.dimension}: {text(claim.claimant)}" for claim in situation.claims or ()
        ],
        "recoveries": [
            f"{text(recovery.action_id)} at {text(recovery.robot)}: {text(recovery.cause or 'cause not on record')}, "
            + (f"level {recovery.level}, {recovery.attempts} attempts" if recovery.level else "how is not observed")
            + ("" if recovery.since_s is None else f", since {recovery.since_s:.3f} s")
            for recovery in situation.recoveries or ()
        ],
        "calls": [
            f"{call.number}: {text(call.supervisor)} about {text(call.action_id)}, {call.purpose}"
            for call in situation.calls or ()
        ],
        "supervisors off shift": [text(name) for name in situation.off_shift or ()],
        "rules": [
            f"{rule.scope} {rule.outcome} for {text(rule.robot or 'every robot')}{_limits(rule)}"
            for rule in situation.rules or ()
        ],
        "trust": [
            f"{text(trust.robot)} -> {text(trust.peer)}: {trust.scope}{_limits(trust)}"
            for trust in situation.trust or ()
        ],
    }


def _limits(rule: "RuleNow | TrustNow") -> str:
    """Return the capability and the task that a rule or trust is limited to."""
    capability = f", {printable.value(rule.capability)}" if rule.capability else ""
    return capability + (f", task {printable.value(rule.task)}" if rule.task else "")


def _belief(belief: "Belief") -> str:
    about = f"{printable.value(belief.about)}, {belief.what}"
    holds = "what is true is not observed" if belief.holds is None else f"is {belief.holds}"
    if belief.believed is None:
        return f"{about}: {'never told' if belief.was_told is False else 'what it was told is not observed'}; {holds}"
    age = "" if belief.age_s is None else f" ({belief.age_s:.3f} s old)"
    return f"{about}: {belief.believed}{age}" + (f", {holds}" if belief.is_stale is not False else "")


class Steps:
    """A walk through a run of a ledger: its current event, what happened there, and the situation."""

    def __init__(
        self, record: "LedgerRun", provenance: "Provenance", busy_us: Mapping[str, int], at_us: int | None
    ) -> None:
        """Begin after the last event of that time; None: at event 0. Raises: as `Database.rows`."""
        from fsar_ledger.analysis import lines_of
        from fsar_ledger.analysis.moments import Timeline, Walk
        from fsar_ledger.analysis.situation import Coverage
        from fsar_ledger.metrics.provenance import of_run

        self.run = record.run_id
        self.provenance = of_run(provenance, Coverage(record.events[0]).lacking.values())
        self._record, self._busy_us = record, busy_us
        self._timeline = Timeline(record)
        lines = lines_of([record], [(record.run_id, seq) for seq in range(len(record.events))])
        self.words = [lines[(record.run_id, seq)].text for seq in range(len(record.events))]
        self._walk = Walk(record, self.words, 0 if at_us is None else self._timeline.seq_at(at_us))

    @property
    def seq(self) -> int:
        """Return the seq of the current event."""
        return self._walk.seq

    @property
    def size(self) -> int:
        """Return the number of events."""
        return len(self._record.events)

    def time_s(self, seq: int) -> float:
        """Return when an event happened, in seconds of run time."""
        return self._record.times_us[seq] / 1e6

    def move(self, name: str, about: str = "") -> str | None:
        """Make a move (`analysis/moments.py: MOVES`); return why it leads nowhere, or None.

        Raises:
            UsageError: There is no such move, it lacks what it needs, or a time is invalid.
        """
        return self._walk.move(name, about, self._seq_at)

    def fields(self) -> Iterator[tuple[str, object]]:
        """Yield the fields of the current event, its type, time and cause first."""
        from fsar_ledger.events.envelope import flat

        event = self._record.events[self.seq]
        yield "type", event.__struct_config__.tag
        yield "time_s", self.time_s(self.seq)
        yield "caused_by", self._record.caused_by[self.seq]
        yield from flat(event).items()

    def standing(self, robot: str | None = None) -> "Situation":
        """Return the situation after the current event."""
        from fsar_ledger.analysis.situation import situation

        return situation(self._timeline.past(self.seq), self._busy_us, robot)

    def _seq_at(self, text: str) -> int:
        time_us = microseconds("go", text)
        if time_us is None:
            raise UsageError("go: found no time, expected one, such as 46.6s")
        return self._timeline.seq_at(time_us)


class Walkthrough(Answer):
    """A walk, and the script that is played on it; without one the user walks by keys."""

    def __init__(self, steps: Steps, script: str | None, walk: "Callable[[Steps, str], None] | None") -> None:
        self._steps, self._script, self._walk = steps, script, walk
        self.provenance = steps.provenance

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield where each move of the script lands."""
        steps = self._steps
        if self._script is None:
            assert self._walk is not None  # `_walkthrough` requires one
            self._walk(steps, screen.run_text(steps.run))
            return
        for move in filter(None, (part.strip() for part in self._script.split(";"))):
            name, _, about = move.partition(" ")
            if name == "state":
                yield printable.lines(*standing_lines(steps.standing()), "")
            elif name == "record":
                fields = ((field, value) for field, value in steps.fields() if value is not None)
                yield printable.lines(*(f"    {field} = {printable.value(str(value))}" for field, value in fields))
            elif reason := steps.move(name, about.strip()):
                yield printable.line(f"{move}: {reason}")
            else:
                words = printable.value(steps.words[steps.seq], 1_000)
                yield printable.lines(f"{steps.seq:>6} {steps.time_s(steps.seq):>10.3f} s  {words}")


def _walkthrough(
    ledger: "Ledger",
    run: str,
    at: Time = None,
    script: str | None = declare("MOVES", "Moves separated by ; instead of keys."),
    walk: Annotated["Callable[[Steps, str], None] | None", Gives("walk")] = None,
) -> Walkthrough:
    if script is None and walk is None:
        raise UsageError('step: found no terminal to walk on, expected one, or --script "next-decision; state"')
    return Walkthrough(step(ledger, run, at), script, walk)


@verb(
    'step out/ledger --run 1 --script "go 40s; next-decision; cause; state"',
    'step out/ledger --run 2 --script "next-of B1; next-refusal; record"',
    takes=("verified",),
    call=_walkthrough,
)
def step(
    ledger: "Ledger",
    run: OneRunOption,
    at: Time = declare("TIME", "Start at this time: 46.6, 46.6s or 46600ms.", "event 0"),
) -> Steps:
    """Walk through a run event by event, with the record and the state of the fleet at each.

    Keys: right and left for the next event and the one before, d for the next decision (D: before), r refusal, c back
    to the cause, b the next event of a robot, g a time or event, / a text, home, end, q.

    Moves of a script: next, previous, next-decision, previous-decision, next-refusal, cause, next-of ROBOT, go TIME or
    SEQ, find TEXT, first, last; state and record show how things stand and what the event holds.

    Raises:
        UsageError: There is no such run, or `at` is no time of it.
    """
    from .lookup import about_run, present, recorded, time_of

    view, provenance = present(ledger)
    with about_run(view, run, ledger.demanded) as (database, name, _):
        at_us, busy_us = time_of(database, "at", at, name), _busy_us(database, name)
    return Steps(recorded(ledger, view, name), provenance, busy_us, at_us)
