"""What a ledger is evidence of: the questions of `Ledger` that hashes, signatures and witnesses answer."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .names import Place
from .workload import Progress, readers_of

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.proof import Proof
    from fsar_ledger.ledger.verify.recover import Recovery
    from fsar_ledger.witness.cosign import Cosigned

    from .verify import Verification


class Integrity:
    """The part of `Ledger` that verifies, proves and recovers."""

    path: Path
    _demanded: str | None

    def verify(
        self,
        *,
        quick: bool = False,
        anchor: Place | None = None,
        trusted_key: str | None = None,
        witness_policy: Place | None = None,
        cosigned: Sequence[Place] = (),
        replay: bool = False,
        workers: int | None = None,
        progress: Progress | None = None,
        now_s: int | None = None,
    ) -> "Verification":
        """Derive every hash, count and record again. Damage does not raise: see `ok` and `problems` of the answer.

        Args:
            quick: Read no rows.
            anchor: A copy of `checkpoint` that was kept elsewhere; the ledger must only have grown since.
            trusted_key: A public key that must have signed, as a .pub file or text.
            witness_policy: A C2SP tlog-policy; enough of its witnesses must have seen the ledger. Takes `now_s`.
            cosigned: Notes that show what witnesses saw; none: ask them.
            replay: Play every run again, too.
            workers: Processes at once; None: one per core, if there is enough to do.
            progress: Called with segments done and in all.
            now_s: The present time in seconds since 1970.

        Raises:
            NotALedger: There is none.
            UsageError: What was asked for makes no sense.
        """
        from .verify import verify_ledger

        return verify_ledger(
            self.path, quick, anchor, trusted_key, (witness_policy, cosigned, now_s), replay, workers, progress
        )

    def prove(self, event: str | int) -> "Proof":
        """Prove that an event, given as `RUN:SEQ` or by its number, is in the ledger.

        `str` of the answer is a C2SP tlog-proof.

        Raises:
            UsageError: There is no such event, or more than one such run.
        """
        from .prove import prove_event

        return prove_event(self.path, str(event), self._demanded)

    def recover(
        self,
        into: Place | None = None,
        *,
        anchor: Place | None = None,
        trusted_key: str | None = None,
        workers: int | None = None,
        progress: Progress | None = None,
    ) -> "Recovery":
        """Mend what a crash left; after tampering, find what can be trusted, and copy that `into` a new folder.

        Raises:
            UsageError: There is something at `into` already.
            LedgerCorrupted: No commit can be trusted.
            WriteFailed: Another writer is at work, or the disk refused.
        """
        from fsar_ledger.ledger.verify.recover import recover
        from fsar_ledger.ledger.verify.verify import Asked

        from .keys import anchor_of, trusted_of

        asked = Asked(trusted=trusted_of(trusted_key), anchor=anchor_of(anchor))
        return recover(self.path, readers_of(workers, self.path), progress, asked, None if into is None else Path(into))

    def witness_ask(self, policy: Place) -> "Cosigned":
        """Have the newest checkpoint cosigned by the witnesses of a C2SP tlog-policy; no event leaves.

        Raises:
            NotCosigned: Fewer cosigned than the policy demands.
        """
        from .witness import cosigned

        return cosigned(self.path, Path(policy))
