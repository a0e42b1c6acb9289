"""Check that the columns of an answer can be shown as they are."""

import re
from collections.abc import Sequence

from fsar_ledger.errors import QueryFailed

SHOWN = 200
"""Characters of a name or line that a message repeats."""
_NAME = re.compile(r"\"(?:[^\"]|\"\")*\"|'(?:[^']|'')*'")
_UNSHOWABLE = re.compile(r"\b(?:BIGNUM|BIT|GEOMETRY|TIME WITH TIME ZONE|UHUGEINT|UNION|VARIANT)\b")
"""Types whose values Arrow or Python would silently change, or cannot hold."""


def check_columns(names: Sequence[str], kinds: Sequence[str]) -> None:
    """Check that the columns have distinct names, and types whose values arrive unchanged.

    Raises: QueryFailed.
    """
    seen: set[str] = set()
    for name, kind in zip(names, kinds, strict=True):
        if name in seen:
            raise QueryFailed(f"SQL: found two columns named {name[:SHOWN]!r}; give one of them another name with AS")
        if found := _UNSHOWABLE.search(_NAME.sub(" ", kind)):
            raise QueryFailed(
                f"SQL: column {name[:SHOWN]!r} holds {found[0]}, which an answer cannot show as it is; make it text, "
                "as in CAST(... AS VARCHAR)"
            )
        seen.add(name)
