"""Whether all is there that was planned, as a sentence beside numbers that rest on it."""

from typing import Any

import msgspec

from .database import Database

EXPERIMENTS = "SELECT * FROM experiments ORDER BY planned_count DESC, plan"
UNPLANNED = "SELECT count(*) AS runs FROM unplanned_runs"


class Completeness(msgspec.Struct, frozen=True):
    """What the plans of a ledger say of its runs: `unfinished` plans lack some, and no larger plan covers them; `unplanned` counts runs that no plan names."""

    plans: int
    unfinished: tuple[dict[str, Any], ...]
    unplanned: int

    def warning(self) -> str | None:
        """What is missing; None where nothing is, as far as plans say."""
        if not self.unfinished:
            return None
        first, *others = self.unfinished
        more = f"; {len(others):,} more plans lack runs" if others else ""
        return f"not complete: {first['missing_count']:,} of the {first['planned_count']:,} runs of a plan are missing{more}"

    def answer(self) -> dict[str, object]:
        """The same for programs: `complete` is None where no plan tells, or some runs are in none; `missing_count` sums what each unfinished plan lacks."""
        told = None if not self.plans or self.unplanned else True
        return {"complete": False if self.unfinished else told, "missing_count": sum(plan["missing_count"] for plan in self.unfinished)}

    def sentence(self) -> str:
        """What the plans say, whatever it is."""
        if not self.plans:
            return "no plan is on record, so nothing says whether these are all the runs that were meant"
        found = self.warning() or "all runs that were planned are there"
        return f"{found}; {self.unplanned:,} runs are in no plan" if self.unplanned else found


def completeness(database: Database) -> Completeness:
    """What the plans of this ledger say of its runs. Raises: as `Database.rows`."""
    rows = database.rows(EXPERIMENTS)
    [counted] = database.rows(UNPLANNED)
    return Completeness(len(rows), tuple(row for row in rows if row["missing_count"] and not row["larger_plans"]), counted["runs"])
