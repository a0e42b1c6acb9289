"""Send a ledger's newest checkpoint to witnesses, each with a proof that the log only grew since the one it has.

The HTTP client limits the size and the time of every response. Responses themselves are not trusted: callers rely only
on what a signature in one proves.
"""

import http.client
import ssl
from collections.abc import Callable
from http import HTTPStatus
from pathlib import Path
from threading import Event, Thread
from typing import TypeVar
from urllib.parse import SplitResult, urlsplit

import msgspec

from fsar_ledger.base.errors import LedgerCorrupted, UsageError
from fsar_ledger.ledger.log.merkle import consistency_proof
from fsar_ledger.ledger.log.note import Note, Signature
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.read import View
from fsar_ledger.witness.policy import Policy, Witness

from . import ADD_CHECKPOINT, MAX_BODY_BYTES, SIZE, Answer, Request, parse_cosigned

ANSWER_S = 10.0
"""Seconds after which a witness that has not responded counts as silent."""

_Found = TypeVar("_Found")


class NoAnswer(Exception):
    """Raised when a witness gave no usable response; the message says why."""


def send_request(url: str, path: str, body: bytes | None = None) -> Answer:
    """Send a POST with the body, or a GET without one, and return the response.

    Redirects are not followed and proxies are not used.

    Raises:
        NoAnswer: The server cannot be reached, or its response is not HTTP or is too long.
    """
    parts = _parse_url(url)
    try:
        connection = _connection(parts)
        try:
            connection.request("GET" if body is None else "POST", parts.path.rstrip("/") + path, body)
            response = connection.getresponse()
            data = response.read(MAX_BODY_BYTES + 1)
        finally:
            connection.close()
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise NoAnswer(f"{url}: no answer ({_reason(error)})") from error
    if len(data) > MAX_BODY_BYTES:
        raise NoAnswer(f"{url}: an answer of more than {MAX_BODY_BYTES} bytes")
    return Answer(response.status, data.decode("utf-8", "replace"), response.headers.get("Content-Type", ""))


def ask_all(
    question: Callable[[Witness], _Found], policy: Policy, otherwise: str = ""
) -> list[tuple[Witness, _Found | NoAnswer]]:
    """Query all witnesses of a policy at once and return each one's response, in their order.

    A witness whose complete response takes longer than `ANSWER_S` is silent, even if it sends a byte now and then.

    Raises: UsageError if none has a URL; its message ends with `otherwise`.
    """
    outcomes: dict[str, _Found | NoAnswer] = {
        witness.name: NoAnswer(
            f"the policy has no URL for {witness.name}" if witness.url is None else f"no answer within {ANSWER_S:.0f} s"
        )
        for witness in policy.witnesses
    }
    finished = {witness.name: Event() for witness in policy.witnesses if witness.url is not None}
    if not finished:
        raise UsageError(f"{policy.file}: found no witness with a URL, expected at least one{otherwise}")
    all_finished = Event()

    def put(witness: Witness) -> None:
        try:
            outcomes[witness.name] = question(witness)
        except NoAnswer as error:
            outcomes[witness.name] = error
        except Exception as error:  # a response that breaks the parser unexpectedly counts as none
            outcomes[witness.name] = NoAnswer(f"no answer that can be read ({type(error).__name__})")
        finished[witness.name].set()
        if all(event.is_set() for event in finished.values()):
            all_finished.set()

    for witness in policy.witnesses:
        if witness.name in finished:
            Thread(target=put, args=(witness,), daemon=True).start()
    all_finished.wait(ANSWER_S)
    return [(witness, outcomes[witness.name]) for witness in policy.witnesses]


def _parse_url(url: str) -> SplitResult:
    """Parse the URL of a witness. Raises: NoAnswer if it is not usable."""
    try:
        parts = urlsplit(url)
        is_right = (
            parts.scheme in ("http", "https")
            and bool(parts.hostname)
            and (parts.port is None or parts.port > 0)
            and url.isascii()
            and url.isprintable()
        )
    except ValueError:
        is_right = False
    if not is_right or parts.query or parts.fragment or parts.username is not None:
        raise NoAnswer(f"{url}: not a witness URL, expected http://HOST:PORT or https://HOST, with or without a path")
    return parts


def _connection(parts: SplitResult) -> http.client.HTTPConnection:
    host = parts.hostname or ""
    if parts.scheme == "https":
        return http.client.HTTPSConnection(host, parts.port, timeout=ANSWER_S, context=ssl.create_default_context())
    return http.client.HTTPConnection(host, parts.port, timeout=ANSWER_S)


def _reason(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"{text or type(error).__name__:.120}"


_TRIES = 3  # the first gets the size that the witness has; another client may advance it before the second


class Cosigned(msgspec.Struct, frozen=True):
    """The result of requesting cosignatures from the witnesses of a policy.

    `note` has their cosignatures. By witness name, `times` are when each one cosigned (seconds since 1970) and `silent`
    why the others did not.
    """

    note: Note
    times: dict[str, int]
    silent: dict[str, str]


def published_note(view: View) -> Note:
    """Return the note of the newest commit.

    Raises:
        UsageError: There is no commit, or its checkpoint is unsigned.
    """
    note = view.note()
    if note is None:
        raise UsageError(f"{view.path}: found no commit, expected one whose checkpoint can be cosigned")
    if not note.signatures:
        raise UsageError(
            f"{view.path}: found an unsigned checkpoint, expected one signed by the ledger's key: "
            "witnesses cosign only signed ones; see simulate --key"
        )
    return note


def cosign(ledger: Path, policy: Policy) -> Cosigned:
    """Send the ledger's newest checkpoint to every witness of the policy that has a URL.

    Raises:
        UsageError: The policy has no URL, or the ledger has no signed checkpoint.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`.
    """
    view = open_ledger(ledger)
    note = published_note(view)
    silent: dict[str, str] = {}
    cosignatures: list[Signature] = []
    times: dict[str, int] = {}
    for witness, answer in ask_all(lambda witness: _obtain(view, note, witness), policy):
        if isinstance(answer, NoAnswer):
            silent[witness.name] = str(answer)
        else:
            times[witness.name], signature = answer
            cosignatures.append(signature)
    return Cosigned(Note(note.checkpoint, (*note.signatures, *cosignatures)), times, silent)


def _obtain(view: View, note: Note, witness: Witness) -> tuple[int, Signature]:
    """Return the time at which this witness cosigned the note, and its cosignature. Raises: NoAnswer."""
    url, size = witness.url or "", note.checkpoint.size
    old = 0
    for _ in range(_TRIES):
        answer = send_request(url, ADD_CHECKPOINT, str(Request(old, _proof(view, old, size), note)).encode())
        if answer.status == HTTPStatus.OK:
            return _cosignature(answer, note, witness)
        witness_size = answer.text.removesuffix("\n")
        is_size = (
            answer.media == SIZE
            and witness_size.isascii()
            and witness_size.isdecimal()
            and len(witness_size) <= len(str(1 << 63))
        )
        if answer.status != HTTPStatus.CONFLICT or not is_size:
            break
        old = int(witness_size)
        if old > size:
            raise NoAnswer(
                f"{url}: refused: it knows {old:,} events of this log, the ledger has {size:,}: "
                "this is an older copy, or the newest were removed"
            )
    else:
        raise NoAnswer(f"{url}: refused {_TRIES} times: each time it said that it knows a different size")
    meaning = _MEANINGS.get(answer.status, "")
    raise NoAnswer(f"{url}: refused with {answer.status}{meaning}")


_MEANINGS: dict[int, str] = {
    HTTPStatus.NOT_FOUND: ": it does not watch this log",
    HTTPStatus.FORBIDDEN: ": it does not trust the key that signed the checkpoint",
    HTTPStatus.CONFLICT: ": it knows another root of the same size: history was rewritten, or the witness lies",
    HTTPStatus.UNPROCESSABLE_ENTITY: (
        ": the ledger did more than grow since the state it knows: history was rewritten, or the witness lies"
    ),
}


def _proof(view: View, old: int, new: int) -> tuple[bytes, ...]:
    """Compute the consistency proof from the ledger's stored hashes. Raises: NoAnswer if one is missing."""
    try:
        return consistency_proof(view.node(new), old, new)
    except LedgerCorrupted as error:
        raise NoAnswer(str(error)) from error


def _cosignature(answer: Answer, note: Note, witness: Witness) -> tuple[int, Signature]:
    """Return the time and the newest cosignature of this witness in the response. Raises: NoAnswer if it has none."""
    try:
        cosigned = parse_cosigned("answer", f"{note.checkpoint.text()}\n{answer.text}".encode())
    except LedgerCorrupted as error:
        raise NoAnswer(f"{witness.url}: an answer without cosignatures") from error
    for signature in cosigned.signatures:
        time = witness.key.time_of(Note(note.checkpoint, (signature,)))
        if time is not None and time == witness.key.time_of(cosigned):
            return time, signature
    raise NoAnswer(f"{witness.url}: a cosignature that the key of {witness.name} did not make")
