"""Verify a ledger: check its rows, replay its runs, and ask witnesses."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from fsar_ledger.errors import UsageError, option
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.verify.report import Asked, VerifyReport
from fsar_ledger.metrics.verified import whole_look

from .key import anchor_of, trusted_of
from .names import Place
from .witness import Seen, seen_of
from .workload import Progress, readers_of

if TYPE_CHECKING:
    from fsar_ledger.runtime.replay import ReplayReport


class Verification(msgspec.Struct, frozen=True):
    """The findings of `verify`.

    `report` comes from deriving everything again, `replay` from playing the runs again, `witnessed` from witnesses.
    None means not asked for.
    """

    report: VerifyReport
    replay: "ReplayReport | None" = None
    witnessed: Seen | None = None

    @property
    def ok(self) -> bool:
        """Return whether none of them found anything, and enough witnesses saw the ledger."""
        return (
            self.report.ok
            and (self.replay is None or self.replay.ok)
            and (self.witnessed is None or self.witnessed.is_enough)
        )

    @property
    def problems(self) -> tuple[Problem, ...]:
        """Return where the ledger contradicts itself; differences found by a replay are in `replay.differences`."""
        return self.report.problems

    @property
    def root(self) -> str | None:
        """Return the Merkle root derived from the rows, in hex; None where there is any doubt."""
        return self.report.root


def verify_ledger(
    ledger: Path,
    quick: bool,
    anchor: Place | None,
    trusted_key: str | None,
    by_witnesses: tuple[Place | None, Sequence[Place], int | None],
    replays: tuple[bool, bool],
    workers: int | None,
    progress: Progress | None,
) -> Verification:
    """Verify the ledger; `by_witnesses` are the policy, the notes at hand and the present time.

    `replays` tell whether to replay, and to take the world from the record.

    Raises: As `Ledger.verify`.
    """
    is_replayed, is_recorded = replays
    if is_recorded and not is_replayed:
        raise UsageError(f"{option('recorded')}: expected it with {option('replay')}, of which it says in which world")
    if quick and is_replayed:
        raise UsageError(
            f"{option('quick')} and {option('replay')}: expected one of them; a quick look reads no rows, a replay "
            "all of them"
        )
    trusted, kept = trusted_of(trusted_key), anchor_of(anchor)
    policy, cosigned, now_s = by_witnesses
    # Before the check, during which the ledger may grow.
    seen = seen_of(ledger, None if policy is None else Path(policy), list(map(Path, cosigned)), trusted, now_s)
    if trusted is None and seen is not None:
        trusted = seen.log
    asked = Asked(quick, trusted, kept, seen.evidence.checkpoints if seen is not None else ())
    report = whole_look(ledger, readers_of(workers, ledger), progress, asked)
    return Verification(report, replayed(ledger, report, workers, progress, is_recorded) if is_replayed else None, seen)


def replayed(
    ledger: Path, report: VerifyReport, workers: int | None, progress: Progress | None, is_recorded: bool = False
) -> "ReplayReport":
    """Play every verified run again; return `NOT_REPLAYED` where `verify` found a problem.

    Raises: LedgerCorrupted if the ledger was damaged in between.
    """
    from fsar_ledger.runtime.replay import NOT_REPLAYED, replay

    if not report.ok:
        return NOT_REPLAYED
    return replay(ledger, readers_of(workers, ledger), progress, report.commits, is_recorded)
