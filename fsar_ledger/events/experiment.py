"""What was meant to be done: the experiment as it was planned, on record before the first of its runs."""

from .envelope import Event


class ExperimentPlanned(Event, frozen=True, kw_only=True):
    """An experiment was planned: `run_count` simulated runs for each architecture, configuration and scenario. The only event of a run of its own.

    Its runs are numbered from 0 to `run_count` - 1; every other field is as in the `RunStarted` of each of them. Who repeats or continues
    the experiment adds no second plan; who enlarges it adds that of the larger one.
    """

    architectures: tuple[str, ...]
    configurations: tuple[str, ...]
    scenarios: tuple[str, ...]
    run_count: int
    seed: int
    fleet_size: int
    model_version: str
    parameters: str


ExperimentEvent = ExperimentPlanned
