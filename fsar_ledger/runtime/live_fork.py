"""A live run with a change: its commands make it again, as far as they still answer what is asked there."""

import sys
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.command import CommandGiven, CommandRejected
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ExecutionResumed, ExecutionStarted
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.recovery import AssistanceRequested
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.projections.fleet import NEVER_US
from fsar_ledger.projections.fold import State

from .architectures.fsar.recovery import AskPeers
from .architectures.fsar.reports import commands, read
from .changeable import question_name
from .handlers.commands import ActionCommand, Command, Respond, Scheduled
from .handlers.request import ReportResult
from .kernel import Kernel
from .live import ARCHITECTURE, commands_of
from .ports import ANSWERS_LATER, AS_USUAL, Ask, Fact, LiveEnvironment
from .simulation import handler_table_of
from .world.draws import FOREVER_US

REST = "/rest"
"""What the name of the question ends with of when an execution ends: `execution:t1/2.1/rest`."""
Asked = tuple[str, str]
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
    asked: Mapping[Asked, Sequence[int]] | None = None


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
    return LiveRecord(started, commands_of(record), carried_out, record.times_us[-1])


class End(NamedTuple):
    """Where a run with a change ends before all has happened: when, and what nobody on record says.

    `question` is its name, as `answer` takes it; None: a command that answers otherwise than it is asked.
    """

    time_us: int
    question: str | None
    words: str


class _Ended(Exception):
    """Raised where the run ends."""


class _Kind(NamedTuple):
    """What is unknown where a question of this kind is not answered, and the commands that answer it."""

    unsaid: str
    answers: tuple[str, ...]


_ATTEMPT = _Kind("how {whom}'s attempt about {about} ends", ("ReportAttempt",))
_END = _Kind("when {whom} ends {about}", ("ReportResult", "ReportFailure", "ReportAssistance"))
_CALL = _Kind("what {whom} says about {about}", ("RespondToCall",))
_KINDS = {
    "admission": _Kind("whether {whom} takes {about}", ("JudgeRequest",)),
    "help": _Kind("whether {whom} helps with {about}", ("JudgeAssistance",)),
    "approach": _Kind("when {whom} begins {about}", ("ReportStart",)),
    "execution": _Kind("when {whom} begins {about}, and for how long", ("ReportStart",)),
    "end": _END,
    "retry": _ATTEMPT,
    "attempt": _END,
    "response": _CALL,
    "call": _CALL,
}


class _Awaited(NamedTuple):
    """What is awaited, of whom, and the command that waits for it; None: the end of an execution."""

    kind: _Kind
    words: str
    whom: str
    command: Command | None


class _EndExecution(Command):
    """End an execution of unknown length when the model, or whoever changes the run, says so."""

    robot: Robot
    action_id: str
    number: int


# See docs/decisions/live-forks-end-unanswered.md.
class LiveKernel(Kernel):
    """A live run that is made again, perhaps with a change, from the commands on its record.

    A command that was carried out on record and cannot be here is left out: nobody would have given it. The run ends
    (`end`) where something is asked that the record does not answer: it was not asked on record, or the answer was
    given before it is asked here, or is one that cannot be given here. `answer_anew` answers instead; None: it does
    not, either. Of an action that it has answered about, the record has nothing more to say.
    """

    def __init__(
        self,
        founding: tuple[Sequence[Event], Any],
        facts: Sequence[Fact],
        record: LiveRecord,
        answer_anew: Callable[[str, Ask], int | None],
    ) -> None:
        self.end: End | None = None
        self.asked: dict[Asked, list[int]] = defaultdict(list)
        self.left_out: list[CommandGiven] = []
        self._live, self._answer_anew = record, answer_anew
        self._known = record.asked
        self._open: dict[tuple[str, str], _Awaited] = {}  # by action, and by command that answers later
        self._lost: set[str] = set()  # actions
        self._said_us: dict[tuple[str, str], list[int]] = defaultdict(list)  # by action and command, when they came
        for (time_us, command), has_effect in record.carried_out.items():
            if has_effect:
                self._said_us[_about(command), command.command].append(time_us)
        self._changed = {_about(command) for _, command in record.carried_out.keys() - set(facts)}
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
        answer = None if whom is None else self._put(ask, whom, self._action(scheduled), time_us, scheduled.command)
        if self.end is not None and ask is scheduled.ask:
            raise _Ended
        return ANSWERS_LATER if answer is None and ask.what == "help" else answer

    def _put(self, ask: Ask, whom: str, about: str, time_us: int, command: Command | None = None) -> int | None:
        """Return the answer that a command on record does not give; None: one does, or the run ends."""
        name = question_name(ask)
        times = self.asked[name, whom]
        times.append(time_us)
        if self._known is None or self.end is not None:
            return None
        kind = _KINDS["end" if name.endswith(REST) else name.partition(":")[0]]
        words = kind.unsaid.format(whom=whom, about=about)
        known = self._known.get((name, whom), ())
        if len(times) <= len(known) and not self._is_said(kind, about, known[len(times) - 1], time_us):
            if about not in self._changed:
                awaited = _Awaited(kind, words, whom, command)
                self._open.update(dict.fromkeys([(about, one) for one in kind.answers], awaited))
            return None
        answer = self._answer_anew(name, ask)
        if answer is None:
            self.end = End(time_us, name, f"nobody on record says {words}")
            return None
        self._lost.add(about)
        return None if answer >= FOREVER_US else answer

    def _is_said(self, kind: _Kind, about: str, since_us: int, now_us: int) -> bool:
        """Return whether the record has nothing more to say about the action, or said it between these times."""
        times_us = (time_us for one in kind.answers for time_us in self._said_us[about, one])
        return about in self._lost or any(since_us < time_us <= now_us for time_us in times_us)

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
        """Return whether a command comes here, too; where it would have been an answer and is none, the run ends."""
        if not isinstance(fact, CommandGiven):
            return True
        about, has_effect = _about(fact), self._live.carried_out.get((time_us, fact))
        awaited = self._open.get((about, fact.command))
        refused = self._refusal(fact, time_us, bool(has_effect))
        if about in self._lost and has_effect is not None:
            refused = "the record has nothing more to say"
        if refused is None and awaited is not None:
            for one in awaited.kind.answers:
                self._open.pop((about, one), None)
        if refused is None or has_effect is None:
            return True
        if has_effect and about not in self._lost and self._is_awaited(about, awaited, time_us):
            assert awaited is not None
            said = f"nobody on record says {awaited.words}: the {fact.command} of {fact.issued_by} is refused there"
            self.end = End(time_us, None, f"{said}, {refused}")
        else:
            self.left_out.append(fact)
        return False

    def _is_awaited(self, about: str, awaited: _Awaited | None, time_us: int) -> bool:
        """Return whether this is still awaited, and something would come of it."""
        action, recovery = self.state.execution.actions.get(about), self.state.recovery.get(about)
        if awaited is None or awaited.command is None:
            return awaited is not None and action is not None and action.stage == "running"
        if isinstance(awaited.command, AskPeers):
            return recovery is not None and recovery.awaited == awaited.whom
        awaited.command.now_us = time_us
        return bool(self._decides[type(awaited.command)](self.state, awaited.command))

    def _refusal(self, fact: CommandGiven, time_us: int, has_effect: bool = True) -> str | None:
        """Return why the command would be rejected as things stand, or have no effect where it should; or None."""
        try:
            command = read(commands()[fact.command], fact.parameters)
        except (KeyError, msgspec.ValidationError):
            return None  # what no handler can read leads to nothing
        command.now_us = time_us + 1
        events = self._decides[type(command)](self.state, command)
        if has_effect and not events:
            return "since nothing comes of it"
        return next((event.reason for event in events if isinstance(event, CommandRejected)), None)


def _about(command: CommandGiven) -> str:
    """Return the action that a command on record is about; empty: it is about none."""
    try:
        fields = msgspec.json.decode(command.parameters, type=dict[str, Any])
    except msgspec.MsgspecError:
        return ""
    found = fields.get("action_id")
    return found if isinstance(found, str) else ""
