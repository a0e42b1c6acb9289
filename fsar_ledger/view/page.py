"""One page of HTML that shows a run, or two above each other: self-contained, and closed to everything else.

The page is `page.html` with `page.css` and `page.js` (both built from `src/` by `make page`) and the data as JSON. Its
Content-Security-Policy admits exactly these two texts, by their hashes, and no request at all. Every text of the
ledger reaches the page as JSON, with `<` escaped, and the screen as text.
"""

import base64
import hashlib
from collections.abc import Hashable
from importlib.resources import files
from typing import Any

import msgspec

from fsar_ledger.events.envelope import flat
from fsar_ledger.runtime.forks import parts_at

from .drawn import Drawn, concern_of, type_name
from .spans import Span

_ABOUT = ("architecture", "configuration", "scenario", "seed", "fleet_size", "kind", "source", "model_version")
"""The fields of event 0 that say which run it is."""


class PageOptions(msgspec.Struct, frozen=True):
    """A run to show, and where it comes from: the words that name its ledger in a command, and the head.

    `not_observed` names the concerns that its source does not record.
    """

    drawn: Drawn
    ledger: str
    size: int
    root: str
    is_verified: bool
    not_observed: tuple[str, ...]


def page(one: PageOptions, other: PageOptions | None = None) -> bytes:
    """Return the page for a run, or for two one above the other with their first difference marked."""
    shown = [one] if other is None else [one, other]
    first = None if other is None else parts_at(one.drawn.run, other.drawn.run)
    document = {
        "is_same": other is not None and first is None,
        "first_difference": first,
        "runs": [_document(run) for run in shown],
    }
    data = msgspec.json.encode(document).decode().replace("<", "\\u003c").replace(">", "\\u003e")
    parts = {name: files(__package__).joinpath(f"page.{name}").read_text("utf-8") for name in ("html", "css", "js")}
    text = parts["html"]
    for name, value in (
        ("SCRIPT_HASH", _hash(parts["js"])),
        ("STYLE_HASH", _hash(parts["css"])),
        ("STYLE", parts["css"]),
        ("SCRIPT", parts["js"]),
        ("DATA", data),
    ):
        text = text.replace(f"%{name}%", value, 1)
    return text.encode()


def _hash(text: str) -> str:
    """Return what admits this text in a Content-Security-Policy."""
    return "'sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() + "'"


def _place(value: Hashable, places: dict[Any, int]) -> int:
    """Return the place of a value that is written once and then named by its place."""
    return places.setdefault(value, len(places))


def _document(shown: PageOptions) -> dict[str, Any]:
    """Return the run as the page reads it (`src/data.ts` says how): lists instead of objects, repetition by number."""
    drawn = shown.drawn
    run = drawn.run
    words: dict[Any, int] = {}
    payloads: dict[Any, int] = {}
    types: dict[Any, int] = {}
    lanes = {lane.name: place for place, lane in enumerate(drawn.lanes)}
    events: list[list[Any]] = []
    before_us = 0
    for seq, event in enumerate(run.events):
        told = drawn.told[seq]
        fields = flat(event)
        kind = _place((type_name(event), concern_of(event), tuple(fields)), types)
        lane = -1 if told.lane is None else lanes[told.lane]
        payload = _place((kind, *fields.values()), payloads)
        events.append(
            [run.times_us[seq] - before_us, run.caused_by[seq], payload, _place(told.words, words), lane, told.task]
        )
        before_us = run.times_us[seq]
    about = flat(run.events[0])
    return {
        "run": run.run_id,
        "name": drawn.name,
        "ledger": shown.ledger,
        "size": shown.size,
        "root": shown.root,
        "is_verified": shown.is_verified,
        "not_observed": shown.not_observed,
        "about": [[name.replace("_", " "), f"{about[name]}"] for name in _ABOUT if about.get(name) is not None],
        "lanes": drawn.lanes,
        "types": list(types),
        "words": list(words),
        "payloads": list(payloads),
        "events": events,
        "spans": [_span(span, lanes) for span in drawn.spans],
        "arrows": [
            [lanes[one.sender], lanes[one.receiver], one.sent_us, one.arrived_us, one.seq, one.kind]
            for one in drawn.arrows
        ],
    }


def _span(span: Span, lanes: dict[str, int]) -> list[Any]:
    lane, *fact = span.fact
    return [lanes[lane], *fact, span.start_us, span.end_us, span.seq, span.until]
