"""What an event can hold: text that can be printed."""

from itertools import chain
from typing import Any

import msgspec

from fsar_ledger.base.printable import escaped
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import flat


def storable_text(text: str) -> str:
    """Return the text as an event may hold it: escaped if it has characters that cannot be printed."""
    return text if text.isprintable() else escaped(text)


def storable(event: Event) -> Event:
    """Return the event with what cannot be printed in its texts escaped."""
    texts = chain.from_iterable(one if isinstance(one, tuple) else (one,) for one in flat(event).values())
    if all(not isinstance(text, str) or text.isprintable() for text in texts):
        return event
    return msgspec.convert(_escaped(msgspec.to_builtins(event)), type(event))


def _escaped(found: Any) -> Any:
    if isinstance(found, str):
        return storable_text(found)
    if isinstance(found, dict):
        return {name: _escaped(one) for name, one in found.items()}
    return [_escaped(one) for one in found] if isinstance(found, (list, tuple)) else found


def text_of(raw: bytes) -> str:
    """Return what the bytes say as an event may hold it; in hexadecimal if they are no text."""
    try:
        return storable_text(raw.decode())
    except UnicodeDecodeError:
        return raw.hex()
