"""Commands that could not be carried out: bad input is recorded and changes nothing."""

from .envelope import Event, Principal


class CommandRejected(Event, frozen=True, kw_only=True):
    """The command named something unknown, finished or impossible; nothing else happened.

    `subject` is what the command was about; `reason` says what was found and what was expected.

    Paper: sec:architecture:overview.
    """

    command: str
    subject: str
    reason: str
    issued_by: Principal | None = None
