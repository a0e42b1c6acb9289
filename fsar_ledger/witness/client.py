"""The HTTP client that asks witnesses, with limits on the size and the time of every answer.

Answers themselves are not trusted: callers believe only what a signature in one proves.
"""

import http.client
import ssl
from collections.abc import Callable, Sequence
from threading import Event, Thread
from typing import TypeVar
from urllib.parse import SplitResult, urlsplit

from fsar_ledger.witness.protocol import MAX_BODY_BYTES, Answer

ANSWER_S = 10.0
"""Seconds after which a witness that has not answered counts as silent."""

_One = TypeVar("_One")
_Found = TypeVar("_Found")


class NoAnswer(Exception):
    """Raised when a witness gave no usable answer; the message says why."""


def ask(url: str, path: str, body: bytes | None = None) -> Answer:
    """Send a POST with the body, or a GET without one, and return the answer.

    Redirects are not followed and proxies are not used.

    Raises:
        NoAnswer: The server cannot be reached, or its answer is not HTTP or is too long.
    """
    place = _parse_url(url)
    try:
        connection = _connection(place)
        try:
            connection.request("GET" if body is None else "POST", place.path.rstrip("/") + path, body)
            response = connection.getresponse()
            data = response.read(MAX_BODY_BYTES + 1)
        finally:
            connection.close()
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise NoAnswer(f"{url}: no answer ({_reason(error)})") from error
    if len(data) > MAX_BODY_BYTES:
        raise NoAnswer(f"{url}: an answer of more than {MAX_BODY_BYTES} bytes")
    return Answer(response.status, data.decode("utf-8", "replace"), response.headers.get("Content-Type", ""))


def ask_all(question: Callable[[_One], _Found], members: Sequence[_One]) -> list[_Found | NoAnswer]:
    """Ask all members at once and return each one's answer, in the order of the members.

    A member whose complete answer takes longer than `ANSWER_S` is silent, even if it sends a byte now and then.
    """
    found: list[_Found | NoAnswer] = [NoAnswer(f"no answer within {ANSWER_S:.0f} s")] * len(members)
    finished = [Event() for _ in members]
    all_finished = Event()

    def put(at: int, member: _One) -> None:
        try:
            found[at] = question(member)
        except NoAnswer as error:
            found[at] = error
        except Exception as error:  # an answer that breaks the parser in an unforeseen way is no answer either
            found[at] = NoAnswer(f"no answer that can be read ({type(error).__name__})")
        finished[at].set()
        if all(one.is_set() for one in finished):
            all_finished.set()

    for at, member in enumerate(members):
        Thread(target=put, args=(at, member), daemon=True).start()
    all_finished.wait(ANSWER_S if members else 0)
    return list(found)


def _parse_url(url: str) -> SplitResult:
    """Parse the URL of a witness. Raises: NoAnswer if it is not a usable one."""
    try:
        place = urlsplit(url)
        is_right = (
            place.scheme in ("http", "https")
            and bool(place.hostname)
            and (place.port is None or place.port > 0)
            and url.isascii()
            and url.isprintable()
        )
    except ValueError:
        is_right = False
    if not is_right or place.query or place.fragment or place.username is not None:
        raise NoAnswer(f"{url}: not a witness URL, expected http://HOST:PORT or https://HOST, with or without a path")
    return place


def _connection(place: SplitResult) -> http.client.HTTPConnection:
    host = place.hostname or ""
    if place.scheme == "https":
        return http.client.HTTPSConnection(host, place.port, timeout=ANSWER_S, context=ssl.create_default_context())
    return http.client.HTTPConnection(host, place.port, timeout=ANSWER_S)


def _reason(error: Exception) -> str:
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return f"{text or type(error).__name__:.120}"
