"""A live run: a real fleet under the handlers of FSAR.

Robots and people give commands (`handlers/public.py`, `architectures/fsar/reports.py`), each recorded as
`CommandGiven`. The only other input is the time, so a run is rebuilt from its commands alone. With a change they give
another run, as long as they still answer what it asks (`LiveKernel`).
"""

import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import did_you_mean, value
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.events import CONCERNS, Event
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ExecutionResumed, ExecutionStarted
from fsar_ledger.events.fleet import IsolationBegan, RunContinued, RunStarted
from fsar_ledger.events.recovery import AssistanceRequested
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.projections.fleet import NEVER_US
from fsar_ledger.projections.fold import State

from .changeable import question_name
from .handlers.commands import ActionCommand, Command, Respond, Scheduled
from .handlers.isolation import founded_alone
from .handlers.public import command_record, commands, read, texts_of
from .handlers.request import ReportResult
from .kernel import Kernel
from .ports import ANSWERS_LATER, AS_USUAL, Ask, Fact, LiveEnvironment
from .simulation import MODEL_VERSION, fleet_founding, handler_table_of
from .snapshot import shape_of, state_sha256

ARCHITECTURE = "fsar"
"""The architecture of live runs: the handlers of the others decide for their robots."""
SOURCE = "fsar-ledger"
GIVEN = (CommandGiven, RunContinued, IsolationBegan)  # events of a live run that come from outside
AT_ONCE_US = 1_000
"""What a command causes within this time, such as the beginning of a step, is decided before its answer is given."""


class Decision(msgspec.Struct, frozen=True):
    """The decision of a command: the seq of its record in the run, its events, and why it was rejected.

    `events` are those that it caused itself; `followed` are those at once after them, such as a request that a step
    makes. A repeated command returns only `events`.
    """

    seq: int
    events: tuple[Event, ...]
    rejected: str | None = None
    followed: tuple[Event, ...] = ()


def live_started(constants: Constants, robots: int, epoch: str | None = None) -> RunStarted:
    """Return event 0 of a live run of a fleet of this many robots."""
    return RunStarted(
        kind="live",
        observes=CONCERNS,
        architecture=ARCHITECTURE,
        configuration="full",
        fleet_size=robots,
        model_version=MODEL_VERSION,
        parameters=write_constants(constants),
        source=SOURCE,
        epoch=epoch,
    )


# See docs/decisions/live-runs-are-their-commands.md.
class LiveRun:
    """A live run in progress. Times are run time, in microseconds, and never go back."""

    def __init__(
        self,
        started: RunStarted,
        constants: Constants,
        record: LedgerRun | None = None,
        known: tuple[Any, ...] | None = None,
        alone: tuple[Event, ...] = (),
    ) -> None:
        """Begin the run, or rebuild it from the commands on record, up to the last recorded event.

        `known`: the run before the record (`Kernel.saved_state`); None: it is complete. `alone`: the founding events
        of the run of a robot alone, if the record lacks them.
        """
        alone = alone or founded_alone(() if record is None else record.events)
        events, founded = fleet_founding(started.fleet_size or 0, constants, alone)
        environment = LiveEnvironment(() if record is None else commands_of(record))
        self.kernel = Kernel(handler_table_of(ARCHITECTURE), environment, (started, *events), founded)
        if known is not None:
            self.kernel.recall(known)
        if record is not None:
            self.kernel.run(record.times_us[-1])

    def give(self, time_us: int, command: CommandGiven) -> Decision:
        """Record the command and decide it, with what follows at once, no earlier than the last event."""
        kernel = self.kernel
        seq = kernel.happen(time_us, command)
        kernel.run(kernel.times_us[-1] + AT_ONCE_US)
        first = seq + 1 - kernel.first
        pairs = list(zip(kernel.events[first:], kernel.caused_by[first:], strict=True))
        decision = decision_of(seq, [event for event, cause in pairs if cause == seq])
        followed = tuple(event for event, cause in pairs if cause != seq)
        return msgspec.structs.replace(decision, followed=followed)

    def advance(self, time_us: int) -> None:
        """Decide everything due by then, such as an exhausted budget."""
        self.kernel.run(time_us)

    def cut(self, time_us: int, run: str, seq: int, root: str) -> None:
        """Cut the run: decide everything due by then; what follows belongs to another run.

        `run` is its name until the cut, `seq` its last event, and `root` that of the ledger.
        """
        time_us = self.kernel.clear(time_us)
        continued = RunContinued(
            continues=run,
            continues_seq=seq,
            continues_root=root,
            state_sha256=state_sha256(self.kernel.stands(time_us)),
            state_shape=state_shape(),
        )
        self.kernel.happen(time_us, continued)

    def take(self, run_id: str) -> LedgerRun:
        """Remove and return the events since the last call, to be recorded under this name; the run goes on."""
        return msgspec.structs.replace(self.kernel.take(), run_id=run_id, goes_on=True)


@cache
def state_shape() -> str:
    """Return the shape (`shape_of`) of a live run's state and pending commands."""
    return shape_of((State, Scheduled, *handler_table_of(ARCHITECTURE).decides))


def commands_of(record: LedgerRun) -> tuple[Fact, ...]:
    """Return the commands on record, and the cuts and isolations, each with its time."""
    pairs = zip(record.times_us, record.events, strict=True)
    return tuple((time_us, event) for time_us, event in pairs if isinstance(event, GIVEN))


def decision_of(seq: int, events: list[Event]) -> Decision:
    """Return the decision of the command with this seq; `events` are those that it caused."""
    rejected = next((event.reason for event in events if isinstance(event, CommandRejected)), None)
    return Decision(seq, tuple(events), rejected)


def command_given(
    name: str, by: str, fields: Mapping[str, Any], key: str | None = None, sent_us: int | None = None
) -> CommandGiven:
    """Return the event of a command. Raises: UsageError, which names the field, for an invalid one."""
    kind = commands().get(name)
    if kind is None:
        raise UsageError(
            f"command {value(name)}: there is no such command{did_you_mean(name, commands()) or ';'} expected one of "
            f"{', '.join(sorted(commands()))}"
        )
    try:
        event = command_record(read(kind, msgspec.json.encode(fields).decode()), by, key=key, source_time_us=sent_us)
    except (msgspec.ValidationError, TypeError, UnicodeEncodeError) as error:
        raise UsageError(f"command {name}: {error!s:.300}") from error
    for field, number in fields.items():
        if isinstance(number, int) and abs(number) > MOST:
            raise UsageError(f"command {name}: field {field}: found {number}, expected at most 2^50 (35 years in us)")
    for text in (by, key or "", *texts_of(event.parameters)):
        if not text.isprintable():
            raise UsageError(f"command {name}: found {text!r:.80}, expected characters that can be printed")
    return event


MOST = 1 << 50
"""The largest number in a command: the sum of such a time and others can still be recorded."""
REST = "/rest"
"""The suffix of the name of the question when an execution ends: `execution:t1/2.1/rest`."""
QuestionKey = tuple[str, str]
"""The name of a question, and who is asked."""


class LiveRecord(msgspec.Struct, frozen=True):
    """The inputs of a live run: event 0, the commands, and whether each that was not rejected had an effect.

    `until_us`: until when the inputs are known; NEVER_US where nothing happened after the record. `asked`: when each
    question was asked; None until the run is rebuilt.
    """

    started: RunStarted
    commands: tuple[Fact, ...]
    carried_out: Mapping[tuple[int, CommandGiven], bool]
    until_us: int
    asked: Mapping[QuestionKey, Sequence[int]] | None = None
    alone: tuple[Event, ...] = ()


def live_record(record: LedgerRun, started: RunStarted) -> LiveRecord:
    """Return the inputs of the live run on record."""
    causes = {cause for cause in record.caused_by if cause is not None}
    pairs = zip(record.events, record.caused_by, strict=True)
    refused = {cause for event, cause in pairs if isinstance(event, CommandRejected)}
    carried_out = {
        (record.times_us[seq], event): seq in causes
        for seq, event in enumerate(record.events)
        if isinstance(event, CommandGiven) and seq not in refused
    }
    last_us, alone = record.times_us[-1], founded_alone(record.events)
    return LiveRecord(started, commands_of(record), carried_out, last_us, alone=alone)


class End(NamedTuple):
    """Where a run with a change ends early: when, and which answer the record does not have.

    `question` is its name, as `answer` takes it; None: the record ends there.
    """

    time_us: int
    question: str | None
    words: str


class _Ended(Exception):
    """Raised where the run ends early."""


_UNSAID = {
    "admission": "whether {whom} takes {about}",
    "help": "whether {whom} helps with {about}",
    "approach": "when {whom} begins {about}",
    "execution": "when {whom} begins {about}, and for how long",
    "end": "when {whom} ends {about}",
    "retry": "how {whom}'s attempt about {about} ends",
    "attempt": "when {whom} ends {about}",
    "response": "what {whom} says about {about}",
    "call": "what {whom} says about {about}",
}
"""What is unknown where a question of this kind is not answered."""
_PORTS = {"JudgeRequest": "decision", "JudgeAssistance": "decision", "RespondToCall": "human"}
"""The port at which a command answers about an action; for all others it is the robot's body."""


class _EndExecution(Command):
    """Ends an execution of unknown length at the time that the model or a change gives."""

    robot: Robot
    action_id: str
    number: int


# See docs/decisions/live-forks-end-unanswered.md.
class LiveKernel(Kernel):
    """A live run rebuilt from the commands on its record, perhaps with a change.

    A command that was carried out on record and cannot be here is left out: nobody would have given it. The run ends
    (`end`) at a question that was not asked on record at that time, unless `answer_anew` answers it. Once that has
    answered about an action at a port, recorded answers about the action there no longer count.
    """

    def __init__(
        self,
        founding: tuple[Sequence[Event], Any],
        facts: Sequence[Fact],
        record: LiveRecord,
        answer_anew: Callable[[str, Ask], int | None],
    ) -> None:
        self.end: End | None = None
        self.asked: dict[QuestionKey, list[int]] = defaultdict(list)
        self.left_out: list[CommandGiven] = []
        self._live, self._answer_anew = record, answer_anew
        self._known = record.asked
        self._lost: set[tuple[str, str]] = set()  # actions, each with the port
        super().__init__(handler_table_of(ARCHITECTURE), LiveEnvironment(facts), *founding)
        self._answer = lambda ask: 0 if ask.port == "network" else None
        self._decides = {**self._decides, _EndExecution: self._end_execution}

    def run(self, until_us: int = NEVER_US, most: int = sys.maxsize) -> None:
        """As `Kernel.run`, but no further than `end`."""
        if self.end is None:
            with suppress(_Ended):
                super().run(until_us, most)

    def _unanswered(self, scheduled: Scheduled, ask: Ask, time_us: int) -> int | None:
        whom = self._asked_principal(scheduled, ask)
        answer = None if whom is None else self._put(ask, whom, self._action(scheduled), time_us)
        if self.end is not None and ask is scheduled.ask:
            raise _Ended
        return ANSWERS_LATER if answer is None and ask.what == "help" else answer

    def _put(self, ask: Ask, whom: str, about: str, time_us: int) -> int | None:
        """Return a new answer if the record gives none; None: it does, perhaps by silence, or the run ends."""
        name = question_name(ask)
        times = self.asked[name, whom]
        times.append(time_us)
        if self._known is None:
            return None
        known = self._known.get((name, whom), ())
        if (about, ask.port) not in self._lost and any(0 <= at_us - time_us <= AT_ONCE_US for at_us in known):
            return None
        answer = self._answer_anew(name, ask)
        if answer is None:
            unsaid = _UNSAID["end" if name.endswith(REST) else name.partition(":")[0]].format(whom=whom, about=about)
            self.end = End(time_us, name, f"the record does not say {unsaid}")
            return None
        self._lost.add((about, ask.port))
        return answer

    def _asked_principal(self, scheduled: Scheduled, ask: Ask) -> str | None:
        """Return who is asked; None: no answer would have an effect."""
        command = scheduled.command
        if ask is scheduled.ask:
            command.answer = ANSWERS_LATER if ask.what == "help" else AS_USUAL
            events = self._decides[type(command)](self.state, command)
            if ask.what == "help":
                return next((event.helper for event in events if isinstance(event, AssistanceRequested)), None)
            if not events:
                return None
        if isinstance(command, Respond):
            call = self.state.supervision.calls.get(command.call)
            return None if call is None else call.supervisor
        return self._actor(scheduled) or "nobody"

    def _action(self, scheduled: Scheduled) -> str:
        """Return the action that the command is about."""
        command = scheduled.command
        if isinstance(command, Respond):
            return self.state.supervision.calls[command.call].subject.action_id
        return command.action_id if isinstance(command, ActionCommand) else ""

    def _batch(self, events: Sequence[Event], time_us: int, cause: int | None) -> None:
        super()._batch(events, time_us, cause)
        for event in events:
            if isinstance(event, ExecutionStarted | ExecutionResumed) and event.ends_us is None:
                self._ask_for_the_rest(event.robot, event.subject.action_id, time_us)
        self._require_more()

    def _ask_for_the_rest(self, robot: Robot, action_id: str, time_us: int) -> None:
        """Ask when the execution ends. Handlers do not: a real robot reports it."""
        capability = self.state.execution.actions[action_id].capability
        length_us = self._put(Ask("body", capability, action_id + REST), robot, action_id, time_us)
        if length_us is not None:
            number = len(self.asked[f"execution:{action_id}{REST}", robot])
            self.submit(time_us + max(1, length_us), _EndExecution(robot, action_id, number))

    def _end_execution(self, state: State, command: _EndExecution) -> tuple[Event, ...]:
        """Report the result for a robot that still executes and has not been interrupted since."""
        action = state.execution.actions.get(command.action_id)
        asked = len(self.asked[f"execution:{command.action_id}{REST}", command.robot])
        if action is None or action.stage != "running" or action.robot != command.robot or command.number != asked:
            return ()
        done = ReportResult(executor=command.robot, action_id=command.action_id, result="success")
        done.now_us = command.now_us
        return self._decides[ReportResult](state, done)

    def _apply_fact(self, fact: Event, time_us: int) -> None:
        if self._known is None or self._is_given(fact, time_us):
            super()._apply_fact(fact, time_us)
        self._require_more()

    def _require_more(self) -> None:
        """Check that the run has not ended. Raises: _Ended."""
        if self.end is not None:
            raise _Ended

    def _is_given(self, fact: Event, time_us: int) -> bool:
        """Return whether the fact applies; a command that was carried out on record and would fail here does not."""
        has_effect = self._live.carried_out.get((time_us, fact)) if isinstance(fact, CommandGiven) else None
        if not isinstance(fact, CommandGiven) or has_effect is None or not self._is_refused(fact, time_us, has_effect):
            return True
        self.left_out.append(fact)
        return False

    def _is_refused(self, fact: CommandGiven, time_us: int, has_effect: bool) -> bool:
        """Return whether the command would be rejected now, or have no effect where it had one."""
        try:
            command = read(commands()[fact.command], fact.parameters)
        except (KeyError, msgspec.ValidationError):
            return False  # it has no effect if no handler can read it
        about = _about(fact)
        if (about, _PORTS.get(fact.command, "body")) in self._lost:
            return True
        command.now_us = time_us + 1
        events = self._decides[type(command)](self.state, command)
        return (has_effect and not events) or any(isinstance(event, CommandRejected) for event in events)


def _about(command: CommandGiven) -> str:
    """Return the action that a recorded command is about; empty: none."""
    try:
        fields = msgspec.json.decode(command.parameters, type=dict[str, Any])
    except msgspec.MsgspecError:
        return ""
    action_id = fields.get("action_id")
    return action_id if isinstance(action_id, str) else ""
