"""Commands from outside: those given to a run, and those that could not be executed."""

from .envelope import Event, Principal


class CommandGiven(Event, frozen=True, kw_only=True):
    """A command came to the run; what it leads to is caused by this event. A live run is its commands.

    A simulated run has those of its scenario. `issued_by` is who gave it, as the door knows them; `key` the name by
    which they tell whether it is the same one again; `parameters` its fields, as JSON. Units: `source_time_us` run time
    at which they say that they gave it.

    Paper: sec:architecture:overview.
    """

    command: str
    issued_by: Principal
    parameters: str
    key: str | None = None
    source_time_us: int | None = None


class CommandRejected(Event, frozen=True, kw_only=True):
    """The command named something unknown, finished or impossible; nothing else happened.

    `subject` is what the command was about; `reason` says what was found and what was expected. `issued_by` is in whose
    name it was: a robot's for its work, whoever gave it (the `CommandGiven` that is the cause says who).

    Paper: sec:architecture:overview.
    """

    command: str
    subject: str
    reason: str
    issued_by: Principal | None = None
