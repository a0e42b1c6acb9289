"""Runs, robots and their membership (`eq:fleet`, `eq:runtime`)."""

from typing import Literal

from .envelope import Event, Robot, Supervisor


class RunStarted(Event, frozen=True, kw_only=True, tag="RunStarted.v2"):
    """A run has begun: event 0 of the run, with everything that distinguishes it from other runs.

    A run is simulated, live (commands from outside, decided by our handlers) or foreign (recorded by another system,
    named by `source`). `observes` names the concerns, some of `CONCERNS`, that its source records; the absence of
    events of any other concern means nothing. Architecture, configuration and scenario (or workflow) are open text,
    checked before a run is simulated; None: the run has none. `parameters` is JSON, an object of groups of constants; a
    group that the run does not have is left out.

    A fork repeats the run `forked_from_run` of a ledger with the root `forked_from_root` (hex) up to the event
    `forked_from_seq`, and says in `changes` what is otherwise (`runtime/changes.py`). Its other fields are its own.
    """

    kind: Literal["simulated", "live", "foreign"]
    observes: tuple[str, ...]
    # See docs/decisions/event-0-is-open-text.md.
    architecture: str | None = None
    configuration: str | None = None
    scenario: str | None = None
    seed: int | None = None
    fleet_size: int | None = None
    run: int | None = None
    model_version: str | None = None
    parameters: str | None = None
    source: str | None = None
    forked_from_root: str | None = None
    forked_from_run: str | None = None
    forked_from_seq: int | None = None
    changes: tuple[str, ...] | None = None


class RobotJoined(Event, frozen=True, kw_only=True):
    """A robot has joined the fleet, under its own supervisor H_i if it has one. Paper: eq:fleet, eq:runtime.

    `domain` is the path of the registry in which the robot advertises (`hall/cell`); empty is the fleet's own. `place`
    is where it works (`floor/2`): only robots at one place meet or get in each other's way; None: the fleet has one
    place.
    """

    robot: Robot
    role: str
    team: int
    supervisor: Supervisor | None
    domain: str = ""
    place: str | None = None


FleetEvent = RunStarted | RobotJoined
