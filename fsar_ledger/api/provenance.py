"""What an answer holds for, and what it leaves open."""

from typing import TYPE_CHECKING

import msgspec

from fsar_ledger.ledger.store.read import Head
from fsar_ledger.metrics.observing import Unobserved, unobserved
from fsar_ledger.metrics.plans import Completeness, completeness

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.library import Query


class Provenance(msgspec.Struct, frozen=True):
    """The head of the ledger that was asked, and whether the rows that were read were compared with its root.

    `plans` says what is there of what was planned, None where the answer does not rest on that. `not_observed` are
    concerns that runs do not observe, so that the answer says nothing about them there.
    """

    head: Head | None = None
    rows_verified: bool | None = None
    plans: Completeness | None = None
    not_observed: tuple[Unobserved, ...] = ()

    def answer(self) -> dict[str, object]:
        """Return the parts of this, other than the head, that JSON answers have."""
        missing: dict[str, object] = {"not_observed": self.not_observed} if self.not_observed else {}
        return missing if self.plans is None else {**self.plans.answer(), **missing}


def of_rows(database: "Database", query: "Query | None" = None, run: str | None = None) -> Provenance:
    """Describe an answer that is the rows of a query, of one run or of all."""
    missing = () if query is None else tuple(unobserved(database, query, run))
    return Provenance(database.head, database.rows_verified, None, missing)


def of_judgement(database: "Database") -> Provenance:
    """Describe an answer that judges all that was planned."""
    return Provenance(database.head, database.rows_verified, completeness(database))
