"""A witness at work: it judges, remembers and cosigns, one request of a log at a time."""

from collections.abc import Callable, Sequence
from http import HTTPStatus
from threading import Lock

from fsar_ledger.errors import WriteFailed
from fsar_ledger.ledger.log.note import Note, VerifierKey
from fsar_ledger.witness.protocol import Answer, judge, name_of, parse_request
from fsar_ledger.witness.state import State

Clock = Callable[[], int]
"""The time in seconds since 1970."""


class Service:
    """What a witness does with a request, whichever way it came.

    Args:
        state: Its key and its memory.
        logs: The keys of the logs that it watches; the name of a key is the origin of its log.
        clock: What time it is.
        tell: Called with a line for the operator about each checkpoint of a watched log that was cosigned or refused.
    """

    def __init__(self, state: State, logs: Sequence[VerifierKey], clock: Clock, tell: Callable[[str], None]) -> None:
        self.tell = tell
        self._state, self._logs, self._clock = state, tuple(logs), clock
        self._origins = {name_of(key.name): key.name for key in logs}
        self._turns = {origin: Lock() for origin in self._origins.values()}

    def add_checkpoint(self, body: bytes) -> Answer:
        """The cosignature of the checkpoint in this request, which is remembered before; else why there is none."""
        try:
            request = parse_request(body)
        except ValueError as error:
            return Answer(HTTPStatus.BAD_REQUEST, f"{error}\n")
        origin = request.note.checkpoint.origin
        turn = self._turns.get(origin)
        if turn is None:
            return Answer(HTTPStatus.NOT_FOUND, "unknown log\n")
        with turn:
            newest = self._state.newest(origin)
            judged = judge(request, self._logs, newest.checkpoint if newest is not None else None)
            answer = judged if isinstance(judged, Answer) else self._cosign(judged)
        if answer.status != HTTPStatus.FORBIDDEN:  # anybody can send what the log did not sign
            size = request.note.checkpoint.size
            self.tell(
                f"{origin}: {size:,} events: {'cosigned' if answer.status == HTTPStatus.OK else f'refused ({answer.text.strip()})'}"
            )
        return answer

    def newest(self, name: str) -> Answer:
        """The newest checkpoint of the log of this name (see `name_of`), cosigned once more: as of now, no larger tree is known."""
        origin = self._origins.get(name)
        if origin is None:
            return Answer(HTTPStatus.NOT_FOUND, "unknown log\n")
        with self._turns[origin]:
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
