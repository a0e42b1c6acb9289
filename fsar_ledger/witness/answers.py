"""What the witnesses of a policy saw of a ledger, for whoever verifies it, and in words."""

from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, option
from fsar_ledger.ledger.log.note import VerifierKey
from fsar_ledger.ledger.store.manifest import parse_manifest, read_manifest
from fsar_ledger.ledger.store.paths import MANIFEST
from fsar_ledger.witness.evidence import Evidence, ask_witnesses, read_cosigned
from fsar_ledger.witness.policy import Policy, read_policy

_LAST_SECOND = 253_402_300_799  # of the year 9999


class WitnessAnswer(NamedTuple):
    """What the witnesses of a policy saw of a ledger; one of the keys of `logs` must have signed what they cosigned."""

    policy: Policy
    logs: tuple[VerifierKey, ...]
    evidence: Evidence

    @property
    def log(self) -> VerifierKey | None:
        """Return the key that must have signed the ledger, where there is no choice."""
        return self.logs[0] if len(self.logs) == 1 else None

    @property
    def is_enough(self) -> bool:
        """Return whether enough witnesses saw anything."""
        return self.evidence.size > 0

    def lines(self, events: int) -> list[str]:
        """Describe what they saw, for people; `events` counts the ledger's."""
        size, statements = self.evidence.size, self.evidence.statements
        rest = "" if size >= events else f"; fewer saw the newest {events - size:,}"
        return [
            (
                f"witnessed: {min(size, events):,} of {events:,} events, by {self._heard()} (enough: "
                f"{self.policy.rule()}){rest}"
            ),
            *(
                f"witness {one.witness}: its word does not count: {one.reason}"
                for one in statements
                if one.reason is not None
            ),
        ]

    def doubt(self, ledger: Path) -> str:
        """Describe why too few of them saw anything."""
        reasons = "; ".join(
            f"{one.witness}: {one.reason}" for one in self.evidence.statements if one.reason is not None
        )
        return (
            f"{self.policy.file}: found {self._heard() or 'no cosignature that counts'} ({reasons}), expected "
            f"{self.policy.rule()}; {ledger} may be "
            "consistent, but nothing shows that it is what they saw: ask again, or find out why they are silent"
        )

    def _heard(self) -> str:
        return listed({one.witness: one.time_s for one in self.evidence.statements if one.time_s is not None})

    def json(self) -> dict[str, object]:
        """Return what they saw, for JSON."""
        return {
            "policy": self.policy.file,
            "ok": self.is_enough,
            "size": self.evidence.size,
            "witnesses": self.evidence.statements,
        }


def answers_of(
    ledger: Path,
    policy: Path | None,
    cosigned: Sequence[Path] | None,
    trusted: VerifierKey | None,
    now_s: int | None,
) -> WitnessAnswer | None:
    """Return what the witnesses of the policy saw of the ledger; None without a policy.

    They are asked now, or have answered in these files.

    Raises:
        UsageError: The policy is invalid, or does not fit the other arguments.
        NotALedger, FormatVersionMismatch: There is no ledger.
        LedgerCorrupted: The ledger is of a log that the policy does not name.
    """
    if policy is None:
        if cosigned:
            raise UsageError(
                f"{option('cosigned')}: found no {option('witness_policy')}, expected the policy that names the "
                "witnesses"
            )
        return None

    read = read_policy(policy)
    logs = _logs_of(read, trusted)
    try:
        origin = parse_manifest(ledger / MANIFEST, read_manifest(ledger)).origin
    except LedgerCorrupted:
        return None  # `verify` reports it, with whatever else is wrong
    logs = tuple(key for key in logs if key.name == origin)
    if not logs:
        raise LedgerCorrupted(
            f"{ledger}: found a ledger of {origin}, expected one of a log that {policy} or {option('trusted_key')} "
            "names"
        )
    if now_s is None:
        raise UsageError("witness policy: found no time, expected now_s, seconds since 1970; cosignatures have dates")
    if cosigned:
        return WitnessAnswer(read, logs, read_cosigned(read, logs, origin, now_s, cosigned))
    return WitnessAnswer(read, logs, ask_witnesses(read, logs, origin, now_s))


def _logs_of(policy: Policy, trusted: VerifierKey | None) -> tuple[VerifierKey, ...]:
    """Return the keys, one of which must have signed what the witnesses cosigned."""
    if policy.quorum is None:
        raise UsageError(
            f"{policy.file}: found `quorum none`, expected a witness or a group; without one nothing is shown"
        )
    if trusted is None and not policy.logs:
        raise UsageError(f"{policy.file}: found no log, expected a line `log KEY`, or {option('trusted_key', 'KEY')}")
    if trusted is not None and policy.logs and trusted not in policy.logs:
        raise UsageError(f"{option('trusted_key')}: found {trusted.key}, expected a log of {policy.file}")
    return policy.logs if trusted is None else (trusted,)


def listed(times: dict[str, int]) -> str:
    """Return witnesses and when they cosigned, in words."""
    return ", ".join(f"{name} ({_time(time_s)})" for name, time_s in times.items())


def _time(time_s: int) -> str:
    return (
        datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        if time_s <= _LAST_SECOND
        else f"second {time_s:,}"
    )
