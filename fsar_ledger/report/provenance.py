"""Say in one word where the value of each constant is from, as its type in `constants.py` does."""

from typing import Annotated, Any, get_args, get_origin, get_type_hints

import msgspec

from fsar_ledger import constants

WORDS = {
    "paper": "printed in the paper",
    "fitted": "fitted to the paper's results table; the record of the fit is `reports/calibration.json`",
    "chosen after fits": "ours, and chosen or kept while the cells of that table were looked at, in the study before "
    "the first fit or since; "
    "most move a cell, and none is a prediction",
    "chosen": "ours, and none of the 24 cells depends on it",
}
"""What each word means."""

GIVEN = "given"
"""The word for a value that is not this release's default."""


def origins() -> dict[str, str]:
    """Return the word for each constant by dotted name, in the order of the file.

    "" if its type says nothing, or more than one thing.
    """
    found: dict[str, str] = {}
    groups = {name: kind for name, kind in _hints(constants.Constants).items() if name not in constants.DESIGNS}
    for group, kind in groups.items():
        [inner] = [one for one in (kind, *get_args(kind)) if isinstance(one, type) and issubclass(one, msgspec.Struct)]
        for name, hint in _hints(inner).items():
            found |= _split(f"{group}.{name}", _word(hint))
    return found


def _hints(kind: type[msgspec.Struct]) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _word(hint: Any) -> str:
    if get_origin(hint) is not Annotated:
        return ""
    words = [meta.extra["from"] for meta in hint.__metadata__ if isinstance(meta, msgspec.Meta) and meta.extra]
    return words[0] if len(words) == 1 else ""


def _split(name: str, word: str) -> dict[str, str]:
    """Return the words of durations: one constant for each capability, some of them the paper's."""
    if name != "world.durations":
        return {name: word}
    return {
        f"{name}.{capability}": "paper" if capability in constants.PRINTED_DURATIONS else word
        for capability, _ in constants.DURATIONS
    }
