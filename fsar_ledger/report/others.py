"""What other ledgers than that of the results have to say.

Each is asked what it holds, and gives the sections of the report that this makes.
"""

from collections.abc import Mapping
from pathlib import Path

import msgspec

from fsar_ledger.errors import UsageError
from fsar_ledger.metrics.database import Database, connect
from fsar_ledger.report import beside, grades, mechanisms
from fsar_ledger.report.findings import Ablation, Mechanisms, Scaling, Workflows

WORKFLOWS_SQL = "SELECT count(*) AS runs FROM runs WHERE list_contains($names, scenario)"


class Others(msgspec.Struct, frozen=True):
    """What is known beside the results; None where no ledger holds it."""

    workflows: Workflows | None = None
    ablation: Ablation | None = None
    scaling: Scaling | None = None
    mechanisms: Mechanisms | None = None

    def queries(self) -> tuple[str, ...]:
        """The packaged queries that these rest on."""
        further = (
            *(beside.QUERIES if self.ablation or self.scaling else ()),
            *(mechanisms.QUERIES if self.mechanisms else ()),
        )
        return (*(grades.QUERIES if self.workflows else ()), *further)

    def over(self, other: "Others") -> "Others":
        """These, and of the other ones what is missing here."""
        return Others(*(getattr(self, name) or getattr(other, name) for name in self.__struct_fields__))


def others(ledgers: Mapping[Path, str | None], workflows: Path | None = None, *, pools_seeds: bool = False) -> Others:
    """Return what these ledgers say, each at the newest record that is demanded of it (None: any).

    Of two that hold the same, the first.

    `workflows` is one of them, if any, and has to hold workflows.

    Raises:
        UsageError: a ledger holds nothing that the report has a section for.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, SequenceConflict: as `connect`.
    """
    found = Others()
    for ledger, demanded in ledgers.items():
        if ledger == workflows:
            found = found.over(Others(workflows=grades.workflows(ledger, demanded)))
            continue
        with connect(ledger, demanded=demanded) as database:
            here = held(database, pools_seeds=pools_seeds)
            has_workflows = database.rows(WORKFLOWS_SQL, {"names": list(grades.WORKFLOWS)})[0]["runs"] > 0
        if has_workflows:
            here = Others(workflows=grades.workflows(ledger, demanded)).over(here)
        if here == Others():
            raise UsageError(
                f"--with {ledger}: found no run of a workflow, without a mechanism, or of another fleet than of four "
                "robots, "
                "expected some of these; `fsar-ledger reproduce` makes such ledgers"
            )
        found = found.over(here)
    return found


def held(database: Database, *, pools_seeds: bool = False) -> Others:
    """The ablations, the fleets of other sizes and the pairs with and without a mechanism that this ledger holds."""
    given = {"pools_seeds": pools_seeds}
    return Others(
        None,
        beside.ablation_of(database, **given),
        beside.scaling_of(database, **given),
        mechanisms.mechanisms_of(database, **given),
    )
