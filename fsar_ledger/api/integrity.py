"""The methods of `Ledger` that rest on hashes, signatures and witnesses."""

from pathlib import Path
from typing import TYPE_CHECKING

from .names import Place
from .workload import Progress, readers_of

if TYPE_CHECKING:
    from fsar_ledger.ledger.compacting import Compacted
    from fsar_ledger.ledger.store.view import Head
    from fsar_ledger.ledger.verify.recover import Recovery
    from fsar_ledger.witness.cosign import Cosigned


class Integrity:
    """The part of `Ledger` that verifies, proves, recovers, upgrades and compacts."""

    path: Path

    def recover(
        self,
        into: Place | None = None,
        *,
        anchor: Place | None = None,
        trusted_key: str | None = None,
        workers: int | None = None,
        progress: Progress | None = None,
    ) -> "Recovery":
        """Repair what a crash left; after tampering, find what can be trusted, and copy that `into` a new folder.

        Raises:
            UsageError: `into` exists.
            LedgerCorrupted: No commit can be trusted.
            WriteFailed: Another writer is at work, or a write failed.
        """
        from fsar_ledger.ledger.verify.recover import recover
        from fsar_ledger.ledger.verify.report import Asked

        from .key import anchor_of, trusted_of

        asked = Asked(trusted=trusted_of(trusted_key), anchor=anchor_of(anchor))
        return recover(self.path, readers_of(workers, self.path), progress, asked, None if into is None else Path(into))

    def upgrade(self, into: Place, *, progress: Progress | None = None) -> "Head":
        """Verify this ledger of format 1 and write it to the new folder `into` in today's format; return its head.

        Events, commits, signatures and roots are the same. The same call goes on after an interruption.

        Raises:
            UsageError: The ledger is not of format 1, its writer was interrupted, or something else is at `into`.
            LedgerCorrupted: It does not verify; nothing was written.
            WriteFailed: A write failed.
        """
        from fsar_ledger.ledger.v1 import upgrade

        return upgrade(self.path, Path(into), progress)

    def compact(self) -> "Compacted":
        """Put small segments together, and what is in the journal into one.

        Raises:
            LedgerCorrupted: A segment is not as placed.
            WriteFailed: A write failed.
        """
        from fsar_ledger.ledger.compacting import compact

        return compact(self.path)

    def witness_ask(self, policy: Place) -> "Cosigned":
        """Have the newest checkpoint cosigned by the witnesses of a C2SP tlog-policy; no event leaves.

        Raises:
            NotCosigned: Fewer cosigned than the policy demands.
        """
        from .witness import cosigned

        return cosigned(self.path, Path(policy))
