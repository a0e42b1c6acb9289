"""Report whether all planned runs exist, as a sentence to print beside numbers that rest on them."""

from typing import Any

import msgspec

from .database import Database

EXPERIMENTS = "SELECT * FROM experiments ORDER BY planned_count DESC, plan"
MISSING = "SELECT missing_count FROM missing_runs"
MAX_COMBINATIONS = 10_000
"""The most combinations of architecture, configuration and scenario in a plan that `missing_runs` reads."""

UNPLANNED = "SELECT count(*) AS runs FROM unplanned_runs"


class Completeness(msgspec.Struct, frozen=True):
    """What the plans of a ledger say about its runs: `unfinished` plans lack some, and no larger plan covers them.

    `unplanned` counts runs that no plan names.
    """

    plans: int
    unfinished: tuple[dict[str, Any], ...]
    unplanned: int
    missing: int | None
    """How many runs of these plans are missing, each counted once, however many plans name it.

    None if plans name too many to tell.
    """

    def warning(self) -> str | None:
        """Say what is missing; None if nothing is, as far as plans say."""
        if not self.unfinished:
            return None
        first, *others = self.unfinished
        more = f"; {len(others):,} more plans lack runs" if others else ""
        return (
            f"not complete: {first['missing_count']:,} of the {first['planned_count']:,} runs of a plan are "
            f"missing{more}"
        )

    def answer(self) -> dict[str, object]:
        """Return the same for programs: `complete` is None without a plan, or if some runs are in none.

        `missing_count` counts each run once.
        """
        told = None if not self.plans or self.unplanned else True
        return {"complete": False if self.unfinished else told, "missing_count": self.missing}

    def sentence(self) -> str:
        """Say what the plans say, in any case."""
        if not self.plans:
            return "no plan is on record, so nothing says whether these are all the runs that were meant"
        found = self.warning() or "all runs that were planned are there"
        return f"{found}; {self.unplanned:,} runs are in no plan" if self.unplanned else found


def completeness(database: Database) -> Completeness:
    """Return what the plans of this ledger say about its runs. Raises: as `Database.rows`."""
    rows = database.rows(EXPERIMENTS)
    [counted] = database.rows(UNPLANNED)
    unfinished = tuple(row for row in rows if row["missing_count"] and not row["larger_plans"])
    return Completeness(len(rows), unfinished, counted["runs"], _missing(database, unfinished))


def _missing(database: Database, unfinished: tuple[dict[str, Any], ...]) -> int | None:
    lacking: list[int] = [plan["missing_count"] for plan in unfinished]
    if len(unfinished) < 2:
        return sum(lacking)
    if any(
        len(plan["architectures"]) * len(plan["configurations"]) * len(plan["scenarios"]) > MAX_COMBINATIONS
        for plan in unfinished
    ):
        return None
    lacking = [row["missing_count"] for row in database.rows(MISSING)]
    return sum(lacking)
