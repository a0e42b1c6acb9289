"""A share that was counted, and its interval."""

import math
from typing import NamedTuple

Z_95 = 1.959963984540054


class Share(NamedTuple):
    """A share, and the ends of its 95 % interval; None if nothing was counted."""

    share: float | None
    low: float | None
    high: float | None

    def rounded(self, digits: int = 4) -> "Share":
        """Return it with so many decimals."""
        return Share(*(None if one is None else round(one, digits) for one in self))


# See docs/decisions/intervals-keep-their-coverage.md.
def wilson(found: int, of: int) -> Share:
    """Return the share `found` of `of`, with its interval. Wilson, Probable Inference (1927)."""
    if not of:
        return Share(None, None, None)
    share, part = found / of, Z_95 * Z_95 / of
    centre = (share + part / 2) / (1 + part)
    half = math.sqrt(share * (1 - share) * part + part * part / 4) / (1 + part)
    return Share(share, 0.0 if not found else centre - half, 1.0 if found == of else centre + half)
