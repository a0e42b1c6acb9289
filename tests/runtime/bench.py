"""A federation that is played from outside: public commands and the world's facts, one step at a time.

The bench is a kernel whose next step is chosen by a test. Beside the live state it keeps a second one, folded from
events that went through their stored form, so that what is rebuilt can be compared after every step.
"""

from collections.abc import Sequence
from functools import reduce
from heapq import heappop
from operator import or_
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgspec
from hypothesis import strategies as st

from fsar_ledger.designs.constants import DURATIONS, Constants, Membership, Range, WorldConstants, write_constants
from fsar_ledger.events import CONCERNS, EVENT_TYPES, Event
from fsar_ledger.events.envelope import Robot, Supervisor, robot_named
from fsar_ledger.events.fleet import RobotJoined, RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.runtime.architectures.fsar import FSAR
from fsar_ledger.runtime.handlers.commands import Command
from fsar_ledger.runtime.handlers.public import PublicCommand
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.world import Draws, SimulatedEnvironment, run_key
from tests import past

CAPABILITIES = ("navigate.indoor", "carry.package", "door.open.secure", "grasp.robust", "carry.heavy")
HELPER = Robot("robot/F1")
WATCHED = Membership(heartbeat_us=2_000_000, suspect_us=5_000_000, depart_us=10_000_000)
WORLD = WorldConstants(durations=(*DURATIONS, ("fly", Range(1.0, 2.0))))  # a robot may be given what no scenario knows
PUBLIC: tuple[type[Command], ...] = tuple(
    sorted((kind for kind in FSAR.decides if issubclass(kind, PublicCommand)), key=lambda kind: kind.__name__)
)
_encoder, _decoder = msgspec.json.Encoder(), msgspec.json.Decoder(reduce(or_, EVENT_TYPES))


class Bench(Kernel):
    """A live run of FSAR, played step by step. Units: `now_us` run time."""

    def __init__(self, founding: Sequence[Event]) -> None:
        self.now_us = 0
        self.rebuilt = State()
        super().__init__(FSAR, SimulatedEnvironment((), Draws(run_key(0, "live", 0), WORLD)), founding)

    def issue(self, command: Command) -> tuple[Event, ...]:
        """Somebody outside gives the command now; its events."""
        self.now_us += 1
        command.now_us = self.now_us
        events = self._decides[type(command)](self.state, command)
        if events:
            self._batch(events, self.now_us, 0)
        return events

    def let_happen(self, fact: Event) -> None:
        """The world does this now."""
        self.now_us += 1
        self._record(fact, self.now_us, 0)

    def proceed(self) -> bool:
        """Decide the next pending command; return False when none is pending."""
        if not self._pending.advance():
            return False
        due_us, _, cause, scheduled = heappop(self._pending.soon)
        command, ask = scheduled.command, scheduled.ask
        self.now_us = max(self.now_us + 1, due_us)
        command.now_us = self.now_us
        if ask is not None:
            answer = self._answer(ask)
            assert answer is not None
            command.answer = answer
        events = self._decides[type(command)](self.state, command)
        if events:
            self._batch(events, self.now_us, cause)
        return True

    def _record(self, event: Event, time_us: int, cause: int | None) -> None:
        apply(self.rebuilt, _decoder.decode(_encoder.encode(event)))
        super()._record(event, time_us, cause)

    def record(self, run_id: str) -> LedgerRun:
        """What was recorded so far."""
        return LedgerRun(run_id, self.times_us, self.caused_by, self.events)

    def refolded(self) -> State:
        """The state folded anew from all events."""
        return fold(self.events)


def founding(
    fleet: Sequence[tuple[str, int, bool, str, frozenset[str]]], trust: Sequence[tuple[int, int, Any]], has_helper: bool
) -> tuple[Event, ...]:
    """A live fleet of these robots (role, team, has a supervisor, domain, capabilities), with this trust between them
    by position.

    Robots are watched from their first heartbeat on. With a helper there is one robot more that can do everything for
    everybody and that no command names.
    """
    names = [robot_named(role, team) for role, team, *_ in fleet]
    parameters = write_constants(Constants(membership=WATCHED))
    events: list[Event] = [
        RunStarted(
            kind="live",
            observes=CONCERNS,
            architecture="fsar",
            configuration="full",
            fleet_size=len(fleet),
            parameters=parameters,
        )
    ]
    for name, (role, team, has_supervisor, domain, _) in zip(names, fleet, strict=True):
        events.append(
            RobotJoined(
                robot=name,
                role=role,
                team=team,
                supervisor=Supervisor(f"supervisor/{role}{team}") if has_supervisor else None,
                domain=domain,
            )
        )
    for name, (*_, capabilities) in zip(names, fleet, strict=True):
        for capability in sorted(capabilities):
            events += [past.installed(name, capability), past.advertised(name, capability)]
    for one, other, scope in trust:
        if one % len(names) != other % len(names):
            events.append(past.trusted(names[one % len(names)], names[other % len(names)], scope))
    if has_helper:
        events.append(RobotJoined(robot=HELPER, role="F", team=1, supervisor=Supervisor("supervisor/F1")))
        for capability in (*CAPABILITIES, "fly"):
            events += [past.installed(HELPER, capability), past.advertised(HELPER, capability)]
        events += [past.trusted(HELPER, name, "persistent") for name in names]
    return tuple(events)


ROBOTS = st.lists(
    st.tuples(
        st.sampled_from("ABCD"),
        st.integers(1, 2),
        st.booleans(),
        st.sampled_from(["", "hall", "hall/cell"]),
        st.frozensets(st.sampled_from(CAPABILITIES), min_size=1),
    ),
    min_size=2,
    max_size=6,
    unique_by=lambda robot: robot[:2],
)
TRUST = st.lists(
    st.tuples(st.integers(0, 5), st.integers(0, 5), st.sampled_from(["capability", "task", "session", "persistent"])),
    max_size=12,
)


def _names(state: State) -> dict[str, list[Any]]:
    """What a field of a command may name: mostly something that exists, sometimes something that does not."""
    robots = [name for name in state.fleet.robots if name != HELPER] * 3 + ["robot/Z9"]
    supervised = [
        robot.supervisor for robot in state.fleet.robots.values() if robot.supervisor and robot.name != HELPER
    ]
    supervisors = ["supervisor/fleet", *supervised] * 2 + ["supervisor/Z9"]
    actions = [*state.request.open, *state.execution.actions, "nothing/1.1"]
    tasks = [*state.task, "T1", "T2", "gone"]
    capabilities = [*CAPABILITIES] * 2 + ["fly"]
    return {
        **dict.fromkeys(
            ("robot", "requester", "executor", "peer", "helper", "holder", "requested_by", "executed_by"), robots
        ),
        **dict.fromkeys(("supervisor", "issued_by", "decided_by"), supervisors),
        **dict.fromkeys(("action_id", "request_id", "parent", "preferred"), actions),
        **dict.fromkeys(("task_id", "context"), tasks),
        "capability": capabilities,
        "claimant": [*robots, *supervisors],
        "version": ["1.0.0", "1.2.0", "2.0.0"],
        "domain": ["", "hall", "hall/cell"],
        "steps": [("A navigate.indoor",), ("A carry.package B", "B navigate.indoor"), ("A fly",), ()],
    }


def _typed(state: State, kind: Any) -> st.SearchStrategy[Any]:
    """Values of an annotation."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return arguments(state, kind).map(lambda values: kind(**values))
    if get_origin(kind) is Literal:
        return st.sampled_from([*get_args(kind) * 3, "weird"])  # mostly one of them, sometimes a word that nobody knows
    if get_origin(kind) is tuple:
        return st.lists(st.sampled_from(["door.closed", "not door.closed", "held", "plan"]), max_size=2).map(tuple)
    if kind is bool:
        return st.booleans()
    if kind is int:
        return st.sampled_from([-1, 0, 1, 2, 3, 5_000_000])
    return st.sampled_from(["", "x"])


def arguments(state: State, command: type[msgspec.Struct]) -> st.SearchStrategy[dict[str, Any]]:
    """Arguments of the command, by the names and the types of its fields."""
    names, hints = _names(state), get_type_hints(command)
    drawn: dict[str, st.SearchStrategy[Any]] = {}
    for field in msgspec.structs.fields(command):
        if field.name in ("now_us", "answer"):
            continue
        hint = hints[field.name]
        kinds = get_args(hint) if type(None) in get_args(hint) else (hint,)
        values = (
            st.sampled_from(names[field.name])
            if field.name in names
            else st.one_of(*[_typed(state, kind) for kind in kinds if kind is not type(None)])
        )
        drawn[field.name] = st.one_of(st.none(), values) if type(None) in kinds else values
    return st.fixed_dictionaries(drawn)
