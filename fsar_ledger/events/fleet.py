"""Runs, robots and their membership (`eq:fleet`, `eq:runtime`)."""

from typing import Literal

from .envelope import Architecture, Configuration, Event, Setting


class RunStarted(Event, frozen=True):
    """A run has begun; event 0 of every run, with everything that another run would do differently.

    `parameters` is the canonical JSON of all world and structural constants.
    """

    kind: Literal["simulated", "live"]
    seed: int
    architecture: Architecture
    configuration: Configuration
    scenario: Setting
    fleet_size: int
    run: int
    model_version: str
    parameters: str


class RobotJoined(Event, frozen=True):
    """A robot is part of the fleet, under its own supervisor H_i, if it has one. Paper: eq:fleet, eq:runtime.

    `domain` is the path of the registry that the robot advertises in (`hall/cell`); empty is the fleet's own.
    `place` is where it works (`floor/2`): robots meet, and are in each other's way, where they are; None: the fleet has one place.
    """

    robot: str
    role: str
    team: int
    supervisor: str | None
    domain: str = ""
    place: str | None = None


FleetEvent = RunStarted | RobotJoined
