"""Ed25519 public keys for the second verifier: encodings of points of the base point's subgroup (RFC 8032)."""

# Section 5.1: the field, and the order of the base point.
P, L = 2**255 - 19, 2**252 + 27742317777372353535851937790883648493
Point = tuple[int, int]


def plus(one: Point, other: Point) -> Point:
    (x, y), (u, v) = one, other
    product = -121665 * pow(121666, -1, P) * x * u * y * v
    return (x * v + u * y) * pow(1 + product, -1, P) % P, (y * v + x * u) * pow(1 - product, -1, P) % P


def times(count: int, point: Point) -> Point:
    found = (0, 1)
    for digit in f"{count:b}":
        found = plus(found, found)
        found = plus(found, point) if digit == "1" else found
    return found


def point_of(raw: bytes) -> Point:
    """Decode the point, which has only one encoding (section 5.1.3). Raises ValueError if there is none."""
    sign, y = divmod(int.from_bytes(raw, "little"), 2**255)
    square = (y * y - 1) * pow(-121665 * pow(121666, -1, P) * y * y + 1, -1, P) % P
    root = pow(square, (P + 3) // 8, P)
    roots = [
        x % P
        for r in (root, root * pow(2, (P - 1) // 4, P))
        for x in (r, -r)
        if x * x % P == square and x % P % 2 == sign
    ]
    if not roots or y >= P:
        raise ValueError("no point")
    return roots[0], y


def is_key(raw: bytes) -> bool:
    """Return whether the bytes are a usable key.

    Under a point outside the subgroup, signatures need no secret, or verifiers disagree about them.
    """
    try:
        point = point_of(raw)
    except ValueError:
        return False
    return point != (0, 1) and times(L, point) == (0, 1)
