"""The plan of an experiment, on record before the first of its runs."""

from .envelope import Event


class ExperimentPlanned(Event, frozen=True, kw_only=True):
    """An experiment was planned: `run_count` simulated runs for each architecture, configuration and scenario.

    The plan is the only event of a run of its own. The planned runs are numbered from 0 to `run_count` - 1; every other
    field is as in the `RunStarted` of each of them. Repeating or continuing the experiment adds no second plan;
    enlarging it adds the plan of the larger one.
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
