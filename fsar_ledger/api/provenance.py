"""The provenance of an answer: what it holds for, and what it leaves open."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

import msgspec

from fsar_ledger.ledger.store.record import Head
from fsar_ledger.metrics.lacking import Completeness, Unobserved, completeness, unobserved

if TYPE_CHECKING:
    from fsar_ledger.metrics.database import Database
    from fsar_ledger.metrics.library import Query


class Provenance(msgspec.Struct, frozen=True):
    """The head that an answer holds for, and whether the rows that it was read from were compared with its root.

    `plans` says which planned runs are there; None where the answer does not depend on that. `not_observed` names the
    concerns that runs do not observe, and about which the answer says nothing there.
    """

    head: Head | None = None
    rows_verified: bool | None = None
    plans: Completeness | None = None
    not_observed: tuple[Unobserved, ...] = ()

    def answer(self) -> dict[str, object]:
        """Return what JSON answers say of this besides the head."""
        missing: dict[str, object] = {"not_observed": self.not_observed} if self.not_observed else {}
        return missing if self.plans is None else {**self.plans.answer(), **missing}


def of_run(provenance: Provenance, lacking: Iterable[str]) -> Provenance:
    """Return the provenance of an answer about all of one run, which does not observe these concerns."""
    return msgspec.structs.replace(provenance, not_observed=tuple(Unobserved(one, 1, 1) for one in lacking))


def of_rows(database: "Database", query: "Query | str | None" = None, run: str | None = None) -> Provenance:
    """Return the provenance of the rows of a query, for one run or for all."""
    found = database.library.find(query) if isinstance(query, str) else query
    missing = () if found is None else tuple(unobserved(database, found, run))
    return Provenance(database.head, database.rows_verified, None, missing)


def of_judgement(database: "Database") -> Provenance:
    """Return the provenance of an answer that judges all planned runs."""
    return Provenance(database.head, database.rows_verified, completeness(database))
