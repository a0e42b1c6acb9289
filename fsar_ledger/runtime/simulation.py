"""One run: from its parameters to its events."""

from functools import lru_cache
from hashlib import sha256
from importlib import import_module
from typing import get_args

import msgspec

from fsar_ledger.constants import Constants, write_constants
from fsar_ledger.events import Event
from fsar_ledger.events.concerns import CONCERNS
from fsar_ledger.events.configuration import FULL, MECHANISMS, Configuration, lacks
from fsar_ledger.events.envelope import Architecture, Scenario, Workflow
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.codec import RunRecord
from fsar_ledger.projections.fold import State, fold

from .architectures.wiring import Wiring
from .kernel import Kernel
from .world.draws import Draws, run_key
from .world.scenarios import founding
from .world.schedule import schedule

MODEL_VERSION = "2"

ARCHITECTURES: tuple[Architecture, ...] = get_args(Architecture)
SCENARIOS: tuple[Scenario, ...] = get_args(Scenario)


class RunSpec(msgspec.Struct, frozen=True):
    """What makes a run the run it is; another value anywhere is another run."""

    seed: int
    architecture: Architecture
    configuration: Configuration
    scenario: Scenario | Workflow
    fleet_size: int
    run: int


_parameters = lru_cache(maxsize=8)(write_constants)


def wiring(architecture: Architecture, configuration: Configuration = FULL) -> Wiring:
    """The architecture's handlers and reactions, without what the configuration lacks; the paper's ablations are known to the handlers themselves."""
    module = import_module(f".architectures.{architecture}", __package__)
    whole: Wiring = getattr(module, architecture.upper())
    return whole if lacks(configuration) <= set(MECHANISMS) else _switched(architecture, configuration)


@lru_cache(maxsize=32)
def _switched(architecture: Architecture, configuration: Configuration) -> Wiring:
    """One object for all runs, so that the clock plans it once."""
    from .switches import switched

    return switched(wiring(architecture), architecture, configuration)


def run_started(spec: RunSpec, constants: Constants) -> RunStarted:
    """Event 0 of the run."""
    return RunStarted(
        kind="simulated",
        observes=CONCERNS,
        architecture=spec.architecture,
        configuration=spec.configuration,
        scenario=spec.scenario,
        seed=spec.seed,
        fleet_size=spec.fleet_size,
        run=spec.run,
        model_version=MODEL_VERSION,
        parameters=_parameters(constants),
    )


def run_id(started: RunStarted) -> str:
    """A readable name and a digest of all parameters, so that other parameters are another run."""
    digest = sha256(msgspec.json.encode(started, order="sorted")).hexdigest()[:12]
    name = f"{started.architecture}.{started.configuration}.{started.scenario}.n{started.fleet_size}.s{started.seed}.r{started.run:04d}"
    return f"{name}-{digest}"


def kernel(spec: RunSpec, constants: Constants, structure: Wiring | None = None) -> Kernel:
    """The run at its founding, before the world has done anything; `structure` replaces the architecture's own wiring."""
    facts = schedule(
        constants.world, spec.seed, spec.scenario, spec.run, spec.fleet_size, constants.outages, constants.load
    )
    draws = Draws(run_key(spec.seed, spec.scenario, spec.run), constants.world)
    return Kernel(
        structure or wiring(spec.architecture, spec.configuration), facts, draws, *founding_of(spec, constants)
    )


def founding_of(spec: RunSpec, constants: Constants) -> tuple[tuple[Event, ...], State]:
    """The events that the run begins with, and the state that all of them but the first make."""
    fleet = (spec.fleet_size, constants.world.floor_teams)
    return (run_started(spec, constants), *_founding(*fleet)), _founded(*fleet)


_founding = lru_cache(maxsize=4)(founding)


@lru_cache(maxsize=4)
def _founded(fleet_size: int, floor_teams: int) -> State:
    """The state of a fleet of which only the run is not known yet."""
    return fold(_founding(fleet_size, floor_teams))


def simulate_run(spec: RunSpec, constants: Constants, structure: Wiring | None = None) -> RunRecord:
    """The whole run."""
    one = kernel(spec, constants, structure)
    one.run()
    return RunRecord(run_id(run_started(spec, constants)), one.times_us, one.caused_by, one.events)
