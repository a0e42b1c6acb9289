"""The service of a witness: it judges, stores and cosigns checkpoints, one request per log at a time."""

from collections.abc import Callable, Sequence
from http import HTTPStatus
from threading import Lock

from fsar_ledger.errors import WriteFailed
from fsar_ledger.ledger.log.note import Note, VerifierKey
from fsar_ledger.witness.protocol import Answer, judge, origin_hash, parse_request
from fsar_ledger.witness.state import State

Clock = Callable[[], int]
"""A function that returns the time in seconds since 1970."""


class Service:
    """The answers of a witness to requests, independent of the transport.

    Args:
        state: Its key and the checkpoints that it cosigned.
        logs: The keys of the logs that it watches; the name of a key is the origin of its log.
        clock: Returns the present time.
        tell: Called with a line for the operator about each checkpoint of a watched log that was cosigned or refused.

    Raises: LedgerCorrupted if what is stored of a log lacks its signature, or has a damaged one.
    """

    def __init__(self, state: State, logs: Sequence[VerifierKey], clock: Clock, tell: Callable[[str], None]) -> None:
        state.require_signed(logs)
        self.tell = tell
        self._state, self._logs, self._clock = state, tuple(logs), clock
        self._origins = {origin_hash(key.name): key.name for key in logs}
        self._locks = {origin: Lock() for origin in self._origins.values()}

    def add_checkpoint(self, body: bytes) -> Answer:
        """Store and cosign the checkpoint in this request, or say why not."""
        try:
            request = parse_request(body)
        except ValueError as error:
            return Answer(HTTPStatus.BAD_REQUEST, f"{error}\n")
        origin = request.note.checkpoint.origin
        turn = self._locks.get(origin)
        if turn is None:
            return Answer(HTTPStatus.NOT_FOUND, "unknown log\n")
        with turn:
            newest = self._state.newest(origin)
            judged = judge(request, self._logs, newest.checkpoint if newest is not None else None)
            answer = judged if isinstance(judged, Answer) else self._cosign(judged)
        if answer.status != HTTPStatus.FORBIDDEN:  # anybody can send what the log did not sign
            size = request.note.checkpoint.size
            outcome = "cosigned" if answer.status == HTTPStatus.OK else f"refused ({answer.text.strip()})"
            self.tell(f"{origin}: {size:,} events: {outcome}")
        return answer

    def newest(self, name: str) -> Answer:
        """Return the newest checkpoint of the log of this name (see `origin_hash`), cosigned again as of now."""
        origin = self._origins.get(name)
        if origin is None:
            return Answer(HTTPStatus.NOT_FOUND, "unknown log\n")
        with self._locks[origin]:
            note = self._state.newest(origin)
            if note is None:
                return Answer(HTTPStatus.NOT_FOUND, "no checkpoint of this log was cosigned yet\n")
            signed = tuple(one for one in note.signatures if one.key != self._state.cosigner.key.key)
            cosignature = self._state.cosigner.cosign(note.checkpoint, self._clock())
        return Answer(HTTPStatus.OK, str(Note(note.checkpoint, (*signed, cosignature))))

    def _cosign(self, note: Note) -> Answer:
        cosignature = self._state.cosigner.cosign(note.checkpoint, self._clock())
        try:
            self._state.remember(Note(note.checkpoint, (*note.signatures, cosignature)))
        except WriteFailed as error:
            self.tell(str(error))
            return Answer(HTTPStatus.SERVICE_UNAVAILABLE, "the checkpoint could not be stored; nothing was cosigned\n")
        return Answer(HTTPStatus.OK, cosignature.line())
