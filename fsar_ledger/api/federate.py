"""The verb and the function `federate`: a live federation on a ledger, commanded by robots and people."""

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import time as clock_time
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, checked, option
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Plain, Screen
from .key import origin_of as named_origin
from .key import signer_of
from .names import Names, Place, Run, names_of, run_to_write
from .verbs import KeyOption, OriginOption, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.designs.constants import Constants
    from fsar_ledger.events import Event
    from fsar_ledger.runtime.federation import Federation

    from .ledger import Ledger

CONTINUES = "every decision that was printed is on disk, and the same command continues the run"
FLEET: Any = declare("FLEET", "A .toml file with your own fleet, or the name of a registered one.")
ROBOTS: Any = declare("N", "How many robots the fleet has.", "one team", least=1)
SETTINGS: Any = declare("NAME=VALUE", "Set a constant, as `simulate` does; may be repeated.", flag="--set")
CUT: Any = declare(
    "WHEN",
    "When to end the run and continue it in a new one: daily, or at times in UTC, such as 06:00,14:00,22:00.",
    "never",
)
ISOLATED: Any = declare("ROBOT", "Govern only this robot, which is cut off from its fleet; needs --of.")
OF: Any = declare(
    "LEDGER", "With --isolated: the ledger of the fleet's run, or the robot's copy of it, to continue from."
)
"""The options that `federate` and `serve` share."""
TICK_S = 0.1
"""Seconds between decisions on what is due, such as timeouts, while no command arrives."""
BESIDE = ("command", "by", "key")
"""The keys that a line may have beside the fields of its command."""


@checked
def federate(
    out: Place,
    *,
    run: str,
    fleet: str | None = None,
    robots: int | None = None,
    settings: Sequence[str] = (),
    origin: str | None = None,
    key: Place | None = None,
    cut: str | None = None,
    isolated: str | None = None,
    of: Place | None = None,
    clock: Callable[[], int] = time.time_ns,
    on_commit: Callable[[int, bytes], None] | None = None,
) -> "Federation":
    """Return a live federation, whose decisions are a run of the ledger OUT.

    Args:
        out: A new folder, or that of a ledger.
        run: The name of the run; an existing one is continued, or the newest of those that continue it.
        fleet: The .toml file of a fleet (docs/own-fleet.md), or the name of a registered one; None: the paper's.
        robots: How many robots it has; None: one team.
        settings: Constants as NAME=VALUE, such as the budgets of recovery.
        origin: Publish a new ledger under this name.
        key: The file of the key that signs.
        cut: When the run is cut: `daily`, or times of the day in UTC (`06:00,14:00`); None: only by `Federation.cut`.
        isolated: The robot that continues alone, without the federation, if the run is its own.
        of: The ledger with the fleet's run, or the copy of it that this robot keeps.
        clock: The time in nanoseconds since 1970.
        on_commit: As `Federation`.

    Raises:
        UsageError: The fleet cannot be read or has another number of robots, `cut` is not a time, or only one of
            `isolated` and `of` is given; or as `Federation` or `isolation_of`.
    """
    from fsar_ledger.ledger.opening import open_ledger
    from fsar_ledger.runtime.federation import ORIGIN, Federation
    from fsar_ledger.runtime.isolation import isolation_of
    from fsar_ledger.sources.stored import kept_origin, origin_of

    if (isolated is None) is not (of is None):
        raise UsageError(f"{option('isolated')} and {option('of')}: found one of them, expected both, or none")
    if isolated is not None and (fleet is not None or robots is not None or settings):
        raise UsageError(
            f"{option('isolated')}: found a fleet or settings, expected only those of the ledger; leave them out"
        )
    isolated = isolated if isolated is None or "/" in isolated else f"robot/{isolated}"
    run_to_write(run)
    path, signer = Path(out), signer_of(key)
    name = origin_of(path, named_origin(origin), signer, ORIGIN)
    is_continued = kept_origin(path) is not None and open_ledger(path).has_run(run)
    federation = Federation(
        path,
        run,
        *_fleet_of(robots, fleet, settings),
        clock,
        origin=name,
        signer=signer,
        on_commit=on_commit,
        cuts_us=() if cut is None else _times_us(cut),
        isolation=None if isolated is None or of is None or is_continued else isolation_of(Path(of), isolated),
    )
    mismatch = None
    if is_continued and not _is_as_begun(federation, robots, fleet, settings):
        mismatch = "another fleet or other settings than at its beginning, expected the same or none; leave them out"
    if isolated is not None and federation.state.fleet.isolated != isolated:
        mismatch = f"another run, expected that of {isolated} alone"
    if mismatch is not None:
        federation.close()
        raise UsageError(f"{out}: run {printable.value(run)}: found {mismatch}")
    return federation


def _fleet_of(robots: int | None, fleet: str | None, settings: Sequence[str]) -> "tuple[Constants, int]":
    """Return the constants of a new fleet, and how many robots it has. Raises: UsageError."""
    from fsar_ledger.designs.constants import Constants
    from fsar_ledger.runtime.own import with_own
    from fsar_ledger.runtime.world import team_size

    constants, _ = with_own(Constants(), (), fleet, settings)
    team = team_size(constants.fleet)
    count = team if robots is None else robots
    if count < 1 or count % team:
        raise UsageError(f"robots: found {count}, expected a multiple of {team}, the robots of a team")
    return constants, count


def _is_as_begun(federation: "Federation", robots: int | None, fleet: str | None, settings: Sequence[str]) -> bool:
    """Return whether a run that is continued was begun with those of these that are given."""
    from fsar_ledger.runtime.own import with_own
    from fsar_ledger.runtime.recipes import recorded_constants

    begun = recorded_constants(federation.started, federation.size)
    return robots in (None, federation.started.fleet_size) and with_own(begun, (), fleet, settings)[0] == begun


def _times_us(cut: str) -> tuple[int, ...]:
    """Return these times of the day, in microseconds after midnight. Raises: UsageError."""
    try:
        times = [clock_time.fromisoformat(text.strip()) for text in ("00:00" if cut == "daily" else cut).split(",")]
        if any(moment.tzinfo is not None for moment in times):
            raise ValueError
    except ValueError as error:
        expected = "daily, or times of day in UTC, such as 06:00,14:00"
        raise UsageError(f"{option('cut', printable.value(cut))}: expected {expected}") from error
    return tuple(((moment.hour * 60 + moment.minute) * 60 + moment.second) * 1_000_000 for moment in times)


class Decisions(Answer):
    """The decisions of a federation on commands read from lines, each a line of JSON once it is on disk."""

    def __init__(self, federation: "Federation", lines: BinaryIO) -> None:
        self._federation, self._lines, self._refused = federation, lines, 0

    @property
    def exit_code(self) -> int:
        """Return 1 if a line was not a command."""
        return 1 if self._refused else 0

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield a line for each command, and for decisions without one; the run can continue after the last."""
        from fsar_ledger.sources.adapter import BOM

        with self._federation as federation:
            for numbered in _ticking(self._lines):
                yield from _event_lines(federation.advance())
                if numbered is None:
                    continue
                number, line = numbered
                try:
                    yield _line(_decided(federation, line.removeprefix(BOM) if number == 1 else line))
                except UsageError as error:
                    self._refused += 1
                    yield _line({"line": number, "error": f"{error}"})
            yield from _event_lines(federation.advance())


def _ticking(lines: BinaryIO) -> Iterator[tuple[int, bytes] | None]:
    """Yield each line with its number as it arrives, and None every `TICK_S` while none does."""
    from fsar_ledger.sources.columns import numbered_lines

    arrivals: SimpleQueue[tuple[int, bytes] | None] = SimpleQueue()

    def read() -> None:
        for numbered in numbered_lines(lines):
            arrivals.put(numbered)
        arrivals.put(None)

    Thread(target=read, name="commands", daemon=True).start()
    while True:
        try:
            numbered = arrivals.get(timeout=TICK_S)
        except Empty:
            yield None
            continue
        if numbered is None:
            return
        yield numbered


def _decided(federation: "Federation", line: bytes) -> Mapping[str, object]:
    """Return the outcome of the command in this line. Raises: UsageError if it is not a command."""
    from fsar_ledger.runtime.live import command_given
    from fsar_ledger.sources.columns import object_of

    row = object_of(line, "command")
    for name in ("command", "by"):
        if not isinstance(row.get(name), str):
            raise UsageError(f"field {name}: found {row.get(name)!r:.80}, expected text")
    if not isinstance(row.get("key"), str | None):
        raise UsageError(f"field key: found {row['key']!r:.80}, expected text")
    fields = {name: row[name] for name in row.keys() - set(BESIDE)}
    decision = federation.decide(command_given(row["command"], row["by"], fields, row.get("key")))
    outcome = {"seq": decision.seq, "rejected": decision.rejected, "events": _names(decision.events)}
    return outcome | ({"followed": _names(decision.followed)} if decision.followed else {})


def _event_lines(events: "Sequence[Event]") -> Iterator[SafeText]:
    if events:
        yield _line({"events": _names(events)})


def _names(events: "Sequence[Event]") -> list[Mapping[str, object]]:
    from fsar_ledger.events.envelope import flat

    keys = (
        "action_id",
        "task_id",
        "robot",
        "helper",
        "supervisor",
        "requested_by",
        "executed_by",
        "reason",
        "fence",
    )
    rows = [(type(event).__name__, flat(event)) for event in events]
    return [
        {"type": kind, **{name: row[name] for name in keys if row.get(name) is not None}}
        for kind, row in rows
        if kind != "CommandGiven"
    ]


def _line(document: Mapping[str, object]) -> SafeText:
    return printable.lines(msgspec.json.encode(document).decode())


@verb(
    "federate out/site day    # reads standard input",
    name="federate",
    takes=(),
    after_interruption=CONTINUES,
)
def federate_lines(
    out: Annotated[Place, argument("OUT", "A new folder, or that of a ledger to add to.")],
    run: Annotated[str, argument("RUN", "The name of the run; an existing one is continued.")],
    *,
    fleet: str | None = FLEET,
    robots: int | None = ROBOTS,
    settings: Names = SETTINGS,
    origin: OriginOption = None,
    key: KeyOption = None,
    cut: str | None = CUT,
    isolated: str | None = ISOLATED,
    of: Place | None = OF,
) -> Decisions:
    """Govern a real fleet: read commands from standard input, write decisions to standard output.

    A line is a JSON object with `command`, `by`, perhaps `key`, and the fields of the command (docs/live.md). The line
    that answers it is printed once the decision is on disk. Decisions that no command triggers, such as timeouts, are
    printed as they are made.

    Raises:
        UsageError: The fleet cannot be read or has another number of robots, or the run is not live.
        WriteFailed: A write failed; what is committed stays.
    """
    constants = names_of(settings) or ()
    arguments: dict[str, Any] = {
        "fleet": fleet,
        "robots": robots,
        "settings": constants,
        "isolated": isolated,
        "of": of,
    }
    federation = federate(out, run=run, origin=origin, key=key, cut=cut, **arguments)
    return Decisions(federation, sys.stdin.buffer)


RUN: Any = declare("RUN", "The run of a robot alone: its number, its name, or a unique part of it.", "the newest")


def _handed_over_line(ledger: "Ledger", *, run: Run | None = RUN) -> Answer:
    fields = hand_over(ledger, run=run)
    return Plain(msgspec.json.encode({"command": "HandOver", "by": fields["robot"], **fields}).decode() + "\n")


@verb(
    "hand-over out/a1    # a line for `fsar-ledger federate out/hall morning`",
    name="hand-over",
    takes=(),
    call=_handed_over_line,
)
def hand_over(ledger: "Ledger", *, run: Run | None = RUN) -> dict[str, Any]:
    """Make the command that hands an isolated robot's run over to its fleet.

    On the command line it is printed as one line for `federate`; in Python its fields are returned. The fleet accepts
    each result of the robot, or answers what has overtaken it.

    Raises:
        UsageError: There is no such run, it is not that of a robot alone, or the ledger is the log of a federation.
    """
    from fsar_ledger.ledger.opening import open_ledger
    from fsar_ledger.runtime.isolation import handed_over, require_single

    from .lookup import present, resolve_run

    require_single(open_ledger(ledger.path))
    view, _ = present(ledger)
    names = view.run_names.runs
    is_given = run is not None or not names
    return handed_over(view, resolve_run(view, run, ledger.demanded, is_whole=True) if is_given else names[-1])
