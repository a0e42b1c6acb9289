"""A live run: a fleet that is really there, under the handlers of FSAR.

Robots and people give commands (`handlers/public.py`, `architectures/fsar/reports.py`), each on record as
`CommandGiven`. Nothing else comes from outside but the time, so the commands alone make the run again. With a change
they make another one, as far as they still answer what is asked (`LiveKernel`).
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
from fsar_ledger.designs.constants import Constants
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
from .handlers.public import commands, given, read, texts_of
from .handlers.request import ReportResult
from .kernel import Kernel
from .ports import ANSWERS_LATER, AS_USUAL, Ask, Fact, LiveEnvironment
from .simulation import MODEL_VERSION, constants_text, fleet_founding, handler_table_of
from .snapshot import shape_of, state_sha256

ARCHITECTURE = "fsar"
"""Whose handlers govern a live run: those of the others speak for their robots."""
SOURCE = "fsar-ledger"
GIVEN = (CommandGiven, RunContinued, IsolationBegan)  # what comes from outside in a live run
AT_ONCE_US = 1_000
"""What follows from a command within this time has followed when it is answered, a step that begins, for one."""


class Decision(msgspec.Struct, frozen=True):
    """What became of a command: the number of its record within the run, its events, and why it was rejected.

    `events` are those that it led to itself; `followed` what happened at once after them, as a request that a step
    makes. Of a command that was given before only `events` are told again.
    """

    seq: int
    events: tuple[Event, ...]
    rejected: str | None = None
    followed: tuple[Event, ...] = ()


def live_started(constants: Constants, robots: int, epoch: str | None = None) -> RunStarted:
    """Return event 0 of a live run of a fleet of so many robots."""
    return RunStarted(
        kind="live",
        observes=CONCERNS,
        architecture=ARCHITECTURE,
        configuration="full",
        fleet_size=robots,
        model_version=MODEL_VERSION,
        parameters=constants_text(constants),
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
        """Begin the run, or make it again from the commands on its record, until the last of its events.

        `known`: what the run knew before the record (`Kernel.known`); None: the record is all of it. `alone`: what
        founds the run of a robot alone, if that is not on the record.
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
        """Record the command and decide it, with what follows at once; no time is before the last event's."""
        kernel = self.kernel
        seq = kernel.happen(time_us, command)
        kernel.run(kernel.times_us[-1] + AT_ONCE_US)
        first = seq + 1 - kernel.first
        pairs = list(zip(kernel.events[first:], kernel.caused_by[first:], strict=True))
        decision = decision_of(seq, [event for event, cause in pairs if cause == seq])
        followed = tuple(event for event, cause in pairs if cause != seq)
        return msgspec.structs.replace(decision, followed=followed)

    def advance(self, time_us: int) -> None:
        """Decide all that is due by then, such as a budget that has run out."""
        self.kernel.run(time_us)

    def cut(self, time_us: int, run: str, seq: int, root: str) -> None:
        """Cut the run then: all that is due until then has been decided, and what follows is another run's.

        Until the cut it has this name and this number of its last event, in a ledger of this root.
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
        """Take out the events since the last call, to be recorded under this name; the run goes on."""
        return msgspec.structs.replace(self.kernel.take(), run_id=run_id, goes_on=True)


@cache
def state_shape() -> str:
    """Return the shape (`shape_of`) in which a live run keeps its state and what is pending."""
    return shape_of((State, Scheduled, *handler_table_of(ARCHITECTURE).decides))


def commands_of(record: LedgerRun) -> tuple[Fact, ...]:
    """Return the commands on record, and where the run was cut or its robot left alone, each with its time."""
    pairs = zip(record.times_us, record.events, strict=True)
    return tuple((time_us, event) for time_us, event in pairs if isinstance(event, GIVEN))


def decision_of(seq: int, events: list[Event]) -> Decision:
    """Return what became of the command that is this event of the run; `events` are those that it caused."""
    rejected = next((event.reason for event in events if isinstance(event, CommandRejected)), None)
    return Decision(seq, tuple(events), rejected)


def command_given(
    name: str, by: str, fields: Mapping[str, Any], key: str | None = None, sent_us: int | None = None
) -> CommandGiven:
    """Return the record of a command. Raises: UsageError, which names the field, for what is none."""
    kind = commands().get(name)
    if kind is None:
        raise UsageError(
            f"command {value(name)}: there is no such command{did_you_mean(name, commands()) or ';'} expected one of "
            f"{', '.join(sorted(commands()))}"
        )
    try:
        found = given(read(kind, msgspec.json.encode(fields).decode()), by, key=key, source_time_us=sent_us)
    except (msgspec.ValidationError, TypeError, UnicodeEncodeError) as error:
        raise UsageError(f"command {name}: {error!s:.300}") from error
    for field, number in fields.items():
        if isinstance(number, int) and abs(number) > MOST:
            raise UsageError(f"command {name}: field {field}: found {number}, expected at most 2^50 (35 years in us)")
    for text in (by, key or "", *texts_of(found.parameters)):
        if not text.isprintable():
            raise UsageError(f"command {name}: found {text!r:.80}, expected characters that can be printed")
    return found


MOST = 1 << 50
"""The largest number of a command: times that are added to such a one can still be recorded."""
REST = "/rest"
"""What the name of the question ends with of when an execution ends: `execution:t1/2.1/rest`."""
QuestionKey = tuple[str, str]
"""A question by name, and of whom it is asked."""


class LiveRecord(msgspec.Struct, frozen=True):
    """What a live run was made from: event 0, the commands, and of those not rejected, whether anything came of them.

    `until_us`: until when it is known what came from outside; NEVER_US where nothing more came about after the record.
    `asked`: when each question was asked; None until the run is made again.
    """

    started: RunStarted
    commands: tuple[Fact, ...]
    carried_out: Mapping[tuple[int, CommandGiven], bool]
    until_us: int
    asked: Mapping[QuestionKey, Sequence[int]] | None = None
    alone: tuple[Event, ...] = ()


def live_record(record: LedgerRun, started: RunStarted) -> LiveRecord:
    """Return what the live run on record was made from."""
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
    """Where a run with a change ends before all has happened: when, and what nobody on record says.

    `question` is its name, as `answer` takes it; None: the record ends there.
    """

    time_us: int
    question: str | None
    words: str


class _Ended(Exception):
    """Raised where the run ends."""


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
"""At which port a command answers about an action; all others do for the body of a robot."""


class _EndExecution(Command):
    """End an execution of unknown length when the model, or whoever changes the run, says so."""

    robot: Robot
    action_id: str
    number: int


# See docs/decisions/live-forks-end-unanswered.md.
class LiveKernel(Kernel):
    """A live run that is made again, perhaps with a change, from the commands on its record.

    A command that was carried out on record and cannot be here is left out: nobody would have given it. The run ends
    (`end`) where something is asked that nobody was asked on record at that time. `answer_anew` answers instead; None:
    it does not, either. Of an action about which it has answered at a port, nobody on record answers there any more.
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
        self._lost: set[tuple[str, str]] = set()  # actions, and at which port
        super().__init__(handler_table_of(ARCHITECTURE), LiveEnvironment(facts), *founding)
        self._answer = lambda ask: 0 if ask.port == "network" else None
        self._decides = {**self._decides, _EndExecution: self._end_execution}

    def run(self, until_us: int = NEVER_US, most: int = sys.maxsize) -> None:
        """As `Kernel.run`, but no further than to the end."""
        if self.end is None:
            with suppress(_Ended):
                super().run(until_us, most)

    def _unanswered(self, scheduled: Scheduled, ask: Ask, time_us: int) -> int | None:
        whom = self._whom(scheduled, ask)
        answer = None if whom is None else self._put(ask, whom, self._action(scheduled), time_us)
        if self.end is not None and ask is scheduled.ask:
            raise _Ended
        return ANSWERS_LATER if answer is None and ask.what == "help" else answer

    def _put(self, ask: Ask, whom: str, about: str, time_us: int) -> int | None:
        """Return the answer that no command on record gives; None: one does, perhaps by silence, or the run ends."""
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
            self.end = End(time_us, name, f"nobody on record says {unsaid}")
            return None
        self._lost.add((about, ask.port))
        return answer

    def _whom(self, scheduled: Scheduled, ask: Ask) -> str | None:
        """Return of whom it is asked; None: it does not matter, since nothing comes of any answer."""
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
        """Ask when the execution ends, as its robot will report: no handler asks that, since none can wait for it."""
        capability = self.state.execution.actions[action_id].capability
        length_us = self._put(Ask("body", capability, action_id + REST), robot, action_id, time_us)
        if length_us is not None:
            number = len(self.asked[f"execution:{action_id}{REST}", robot])
            self.submit(time_us + max(1, length_us), _EndExecution(robot, action_id, number))

    def _end_execution(self, state: State, command: _EndExecution) -> tuple[Event, ...]:
        """Report the result for a robot that still executes, and has not been interrupted since."""
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
        """Check that the run goes on. Raises: _Ended."""
        if self.end is not None:
            raise _Ended

    def _is_given(self, fact: Event, time_us: int) -> bool:
        """Return whether a command comes here, too; what was carried out on record and would be refused does not."""
        has_effect = self._live.carried_out.get((time_us, fact)) if isinstance(fact, CommandGiven) else None
        if not isinstance(fact, CommandGiven) or has_effect is None or not self._is_refused(fact, time_us, has_effect):
            return True
        self.left_out.append(fact)
        return False

    def _is_refused(self, fact: CommandGiven, time_us: int, has_effect: bool) -> bool:
        """Return whether the command would be rejected as things stand, or have no effect where it had one."""
        try:
            command = read(commands()[fact.command], fact.parameters)
        except (KeyError, msgspec.ValidationError):
            return False  # what no handler can read leads to nothing
        about = _about(fact)
        if (about, _PORTS.get(fact.command, "body")) in self._lost:
            return True
        command.now_us = time_us + 1
        events = self._decides[type(command)](self.state, command)
        return (has_effect and not events) or any(isinstance(event, CommandRejected) for event in events)


def _about(command: CommandGiven) -> str:
    """Return the action that a command on record is about; empty: it is about none."""
    try:
        fields = msgspec.json.decode(command.parameters, type=dict[str, Any])
    except msgspec.MsgspecError:
        return ""
    found = fields.get("action_id")
    return found if isinstance(found, str) else ""
