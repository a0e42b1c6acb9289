"""The simulated environment: the schedule of the world happens, and its draws answer at every port."""

from collections.abc import Sequence

from fsar_ledger.constants import END_US
from fsar_ledger.runtime.ports import Fact

from .draws import Draws


class Simulated:
    """A world in which these facts happen and these draws answer."""

    __slots__ = ("answer", "facts", "latest_us", "middle")
    answers_alike = True

    def __init__(self, facts: Sequence[Fact], draws: Draws) -> None:
        self.facts = facts
        self.latest_us: int | None = 2 * END_US  # no simulated run is longer: one that is still busy then is a bug
        self.answer = draws.answer
        self.middle = draws.middle
