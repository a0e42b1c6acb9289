"""Read the sections of the report that ledgers other than that of the results provide.

Workflows, ablation, scaling and mechanisms each come from whichever ledger holds such runs.
"""

from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from fsar_ledger.base.errors import UsageError
from fsar_ledger.metrics.database import Database, connect
from fsar_ledger.report import ablation_scaling, grades, mechanisms
from fsar_ledger.report.findings import Ablation, Mechanisms, Scaling, Workflows

WORKFLOWS_SQL = "SELECT count(*) AS runs FROM runs WHERE list_contains($names, scenario)"


class OtherSections(msgspec.Struct, frozen=True):
    """The sections beside the results; None for one that no ledger has runs for."""

    workflows: Workflows | None = None
    ablation: Ablation | None = None
    scaling: Scaling | None = None
    mechanisms: Mechanisms | None = None

    def queries(self) -> tuple[str, ...]:
        """Return the packaged queries that these sections rest on."""
        return (
            *(grades.QUERIES if self.workflows else ()),
            *(ablation_scaling.QUERIES if self.ablation or self.scaling else ()),
            *(mechanisms.QUERIES if self.mechanisms else ()),
        )

    def or_else(self, other: "OtherSections") -> "OtherSections":
        """Return these sections, with those that are missing taken from the other."""
        return OtherSections(*(getattr(self, name) or getattr(other, name) for name in self.__struct_fields__))


# See docs/decisions/experiments-are-separate-ledgers.md.
def read_ledgers(
    ledgers: Mapping[Path, str | None], workflows: Path | None = None, *, pools_seeds: bool = False
) -> OtherSections:
    """Return the sections that these ledgers provide; where two provide the same one, the first ledger's.

    Args:
        ledgers: Each with the newest record that it must have (None: any).
        workflows: The one of them that must hold workflows, if any.
        pools_seeds: Whether runs of all seeds are taken together.

    Raises:
        UsageError: A ledger holds nothing that the report has a section for.
        NotALedger, FormatVersionMismatch, LedgerCorrupted, SequenceConflict: As `connect`.
    """
    found = OtherSections()
    for ledger, demanded in ledgers.items():
        if ledger == workflows:
            found = found.or_else(OtherSections(workflows=grades.workflows(ledger, demanded)))
            continue
        # A ledger of large fleets may have a run of tens of millions of events, which cannot be judged in parts.
        with TemporaryDirectory(prefix="fsar-ledger-") as spilled, connect(ledger, demanded=demanded) as database:
            database.spill(Path(spilled))
            here = read_database(database, pools_seeds=pools_seeds)
            has_workflows = database.rows(WORKFLOWS_SQL, {"names": list(grades.WORKFLOWS)})[0]["runs"] > 0
        if has_workflows:
            here = OtherSections(workflows=grades.workflows(ledger, demanded)).or_else(here)
        if here == OtherSections():
            raise UsageError(
                f"--with {ledger}: found no run of a workflow, without a mechanism, or of another fleet than of four "
                "robots, expected some of these; `fsar-ledger reproduce` makes such ledgers"
            )
        found = found.or_else(here)
    return found


def read_database(database: Database, *, pools_seeds: bool = False) -> OtherSections:
    """Return the sections of this ledger, except for workflows."""
    given = {"pools_seeds": pools_seeds}
    return OtherSections(
        None,
        ablation_scaling.ablation_of(database, **given),
        ablation_scaling.scaling_of(database, **given),
        mechanisms.mechanisms_of(database, **given),
    )
