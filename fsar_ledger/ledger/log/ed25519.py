"""Which Ed25519 public keys can be trusted (RFC 8032, section 5.1).

A key is a point on a curve with 8 L points, where L is prime. Honest keys are multiples of the base point: the L points
of the prime-order subgroup. Under a point of small order (1, 2, 4 or 8), anybody can sign anything without a secret. A
key with a small-order component lets verifiers disagree. A point in a second encoding is a second key for the same
secret. Chalkias, Garillot, Nikolaenko, "Taming the many EdDSAs" (2020), lists these encodings; common libraries accept
most of them. Python integers are good enough here: nothing is secret, and each key is read once.
"""

from functools import lru_cache

KEY_BYTES = 32
_P = 2**255 - 19
_L = 2**252 + 27742317777372353535851937790883648493
_D = -121665 * pow(121666, -1, _P) % _P
_SQRT_OF_MINUS_1 = pow(2, (_P - 1) // 4, _P)

Point = tuple[int, int, int, int]
"""Extended coordinates (X, Y, Z, T): x = X / Z, y = Y / Z, x y = T / Z."""

_IDENTITY: Point = (0, 1, 1, 0)


@lru_cache(maxsize=64)
def flaw_of(public: bytes) -> str | None:
    """Return why this public key cannot be trusted, in words that follow "found"; None if it can.

    Takes about 1.5 ms, once per key.
    """
    if len(public) != KEY_BYTES:
        return f"{len(public)} bytes"
    written = int.from_bytes(public, "little")
    y, sign = written % 2**255, written >> 255
    if y >= _P:
        return "a point that is not written in its one way"
    x = _x_of(y)
    if x is None:
        return "no point of the curve"
    if x == 0 and sign:
        return "a point that is not written in its one way"
    if x & 1 != sign:
        x = _P - x
    point = (x, y, 1, x * y % _P)
    if _is_identity(_times(8, point)):
        return "a point of small order, under which anybody can sign"
    return None if _is_identity(_times(_L, point)) else "a point with a part of small order"


def _x_of(y: int) -> int | None:
    """Return one of the two x coordinates for this y; None if no point has it."""
    above, below = (y * y - 1) % _P, (_D * y * y + 1) % _P
    square = above * pow(below, -1, _P) % _P
    root = pow(square, (_P + 3) // 8, _P)
    for x in (root, root * _SQRT_OF_MINUS_1 % _P):
        if x * x % _P == square:
            return x
    return None


def _plus(a: Point, b: Point) -> Point:
    """Add two points, by a formula that holds for every pair."""
    low, high = (a[1] - a[0]) * (b[1] - b[0]) % _P, (a[1] + a[0]) * (b[1] + b[0]) % _P
    product, doubled = 2 * a[3] * b[3] * _D % _P, 2 * a[2] * b[2] % _P
    e, f, g, h = high - low, doubled - product, doubled + product, high + low
    return e * f % _P, g * h % _P, f * g % _P, e * h % _P


def _times(count: int, point: Point) -> Point:
    """Return `count` times the point."""
    product = _IDENTITY
    while count:
        if count & 1:
            product = _plus(product, point)
        point = _plus(point, point)
        count >>= 1
    return product


def _is_identity(point: Point) -> bool:
    return point[0] == 0 and point[1] == point[2]
