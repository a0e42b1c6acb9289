"""Find the event that a user means, and prove it."""

from pathlib import Path

from fsar_ledger import printable
from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.chain.places import event_at, place_of
from fsar_ledger.ledger.chain.proof import Proof, prove
from fsar_ledger.ledger.chain.read import View
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.metrics.verified import is_verified

from .lookup import resting_on_rows, run_in
from .names import MAX_DIGITS


def prove_event(ledger: Path, event: str, demanded: str | None = None) -> Proof:
    """Prove the event of this name: `RUN:SEQ`, the run as `run_of` knows it, or the event's place in the ledger.

    Raises:
        UsageError: There is no such event, or more than one such run.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers` and `prove`.
    """
    view = open_for_answers(ledger)
    run, seq = asked_event(view, event, demanded)
    return prove(view, _index_of(view, run, seq, demanded))


def asked_event(view: View, event: str, demanded: str | None) -> tuple[str | None, str]:
    """Return the full name of the run and the digits of the seq, or None and the digits of a place in the ledger.

    Raises:
        UsageError: It is no name of an event, or there is no such run, or more than one.
        SequenceConflict: As `is_verified`.
    """
    asked, _, seq = event.rpartition(":")
    if not (seq.isascii() and seq.isdecimal()) or event.startswith(":"):
        raise UsageError(
            f"EVENT {event}: found no number, expected RUN:SEQ, as a run and the seq of an event in it, or the "
            "event's place in the ledger"
        )
    is_verified(view, demanded)
    return run_in(view, asked, demanded) if asked else None, seq


def found_event(view: View, run: str | None, seq: str, demanded: str | None) -> tuple[str, int]:
    """Return run and seq of the event that `asked_event` gave. Raises: UsageError if there is no such event."""
    found = event_at(view, _index_of(view, run, seq, demanded))
    return str(found["run_id"]), int(str(found["seq"]))


def _index_of(view: View, run: str | None, seq: str, demanded: str | None) -> int:
    """Return the place in the ledger, from 0, of this event of the run; without a run it is its place already.

    Raises:
        UsageError: There is no such event.
    """
    if run is None:
        if len(seq) > MAX_DIGITS or int(seq) >= view.head.size:
            raise UsageError(
                f"EVENT {seq}: found {view.head.size:,} events in {view.path}, expected a number below that, or RUN:SEQ"
            )
        return int(seq)
    with resting_on_rows(is_verified(view, demanded)):
        try:
            return place_of(view, run, int(seq[: MAX_DIGITS + 1]))
        except KeyError as error:
            (events,) = error.args
            raise UsageError(
                f"EVENT {printable.value(run)}:{seq}: found {events:,} events in the run, expected a seq from 0 to "
                f"{events - 1}"
            ) from error
