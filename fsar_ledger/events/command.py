"""Commands from outside: those given to a run, and those that could not be executed."""

from .envelope import Event, Principal


class CommandGiven(Event, frozen=True, kw_only=True):
    """A command was given to the run; what follows from it is caused by this event.

    A live run is determined by its commands; a simulated run has those of its scenario. `issued_by` is the identified
    sender; `key` is the sender's name for the command, the same when it is sent again; `parameters` are its fields, as
    JSON. Units: `source_time_us` run time at which it was given, according to the sender.

    Paper: sec:architecture:overview.
    """

    command: str
    issued_by: Principal
    parameters: str
    key: str | None = None
    source_time_us: int | None = None


class CommandRejected(Event, frozen=True, kw_only=True):
    """The command named something unknown, finished or impossible; nothing else happened.

    `subject` is what the command was about; `reason` says what was found and what was expected. `issued_by` is the
    principal in whose name it was given, such as the robot that works; the `CommandGiven` that caused this event names
    the sender.

    Paper: sec:architecture:overview.
    """

    command: str
    subject: str
    reason: str
    issued_by: Principal | None = None
