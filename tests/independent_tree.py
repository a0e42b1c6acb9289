"""Subtrees of a ledger, for `independent_chain.py`; imports nothing of the package."""

from independent_verifier import sha256  # type: ignore[import-not-found]


class Forest(list[bytes]):
    """Complete subtrees, largest first, of `size` leaves in all; leaves may be added behind them."""

    def __init__(self, subtrees: list[bytes], size: int):
        super().__init__(subtrees)
        self.size = size

    def __add__(self, leaves: list[bytes]) -> "Forest":  # type: ignore[override]
        found, size = list(self), self.size
        for leaf in leaves:
            found.append(leaf)
            size += 1
            bits = size
            while not bits & 1:
                right, left = found.pop(), found.pop()
                found.append(sha256(b"\x01", left, right))
                bits >>= 1
        return Forest(found, size)


def places_between(old: int, new: int) -> list[tuple[int, int, int]]:
    """Return place in `nodes`, height and number of each root that becomes complete between these numbers of leaves."""
    found = []
    for j in range(30):
        height = 4 + 2 * j
        for number in range(old >> height, new >> height):
            b = (number + 1) * 4**j - 1
            place = j
            while b:
                place, b = place + b, b // 4
            found.append((place, height, number))
    return sorted(found)
