"""Runs, robots and their membership (`eq:fleet`, `eq:runtime`)."""

from typing import Literal

from .envelope import Architecture, Configuration, Event, Scenario


class RunStarted(Event, frozen=True):
    """A run has begun; event 0 of every run, with everything that another run would do differently.

    `parameters` is the canonical JSON of all world and structural constants.
    """

    kind: Literal["simulated", "live"]
    seed: int
    architecture: Architecture
    configuration: Configuration
    scenario: Scenario
    fleet_size: int
    run: int
    model_version: str
    parameters: str


class RobotJoined(Event, frozen=True):
    """A robot is part of the fleet, under its own supervisor. Paper: eq:fleet."""

    robot: str
    role: str
    team: int
    supervisor: str


FleetEvent = RunStarted | RobotJoined
