"""Which events are meant by run, time and robot: as a test of an event, and as a SELECT."""

from typing import NamedTuple

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.schema import COLUMNS, ENVELOPE

_ENVELOPE = {field.name for field in ENVELOPE}
NAMING = {name: kind for name, kind in COLUMNS.items() if name not in _ENVELOPE and kind in ("string", "strings")}
"""The columns that can name a robot."""


class Filter(NamedTuple):
    """Which events to take; None takes all. Times are microseconds, from `since_us` and before `until_us`."""

    run: str | None = None
    since_us: int | None = None
    until_us: int | None = None
    robot: str | None = None

    def takes(self, time_us: int, event: Event) -> bool:
        """Return whether to take an event of the run."""
        return (
            (self.since_us is None or time_us >= self.since_us)
            and (self.until_us is None or time_us < self.until_us)
            and (self.robot is None or names(event, self.robot))
        )

    def sql(self) -> tuple[str, dict[str, str | int]]:
        """Return the same filter as a SELECT over `events`, and its parameters."""
        conditions: list[str] = []
        values: dict[str, str | int] = {}
        for name, value, condition in (
            ("run", self.run, "run_id = $run"),
            ("since", self.since_us, "time_us >= $since"),
            ("until", self.until_us, "time_us < $until"),
        ):
            if value is not None:
                conditions.append(condition)
                values[name] = value
        if self.robot is not None:
            values |= {"robot": self.robot, "agents": _agents(self.robot)}
            conditions.append(f"({' OR '.join(_naming(name, kind) for name, kind in NAMING.items())})")
        where = f" WHERE {' AND '.join(conditions)}" if conditions else ""
        return f"SELECT * FROM events{where} ORDER BY run_id, seq", values


def _naming(name: str, kind: str) -> str:
    if kind == "string":
        return f'"{name}" = $robot OR starts_with("{name}", $agents)'
    return f'len(list_filter("{name}", lambda one: one = $robot OR starts_with(one, $agents))) > 0'


def _agents(robot: str) -> str:
    """Return the prefix of the principals of a robot's agents (DHMA splits a robot into four)."""
    return f"agent/{robot.removeprefix('robot/')}/"


def names(event: Event, robot: str) -> bool:
    """Return whether a field of the event, or an item of one, is this robot or an agent of it."""
    agents = _agents(robot)
    for value in flat(event).values():
        for text in value if isinstance(value, tuple) else (value,):
            if isinstance(text, str) and (text == robot or text.startswith(agents)):
                return True
    return False
