"""Which neighbouring segments share runs, and so are read together."""

from collections.abc import Iterable, Sequence


def groups_of(segments: Iterable[Sequence[str]]) -> list[tuple[int, ...]]:
    """Return segments, each given by its runs, in groups that share no run, each of neighbours."""
    reach: dict[str, int] = {}
    ends: list[int] = []
    for number, runs in enumerate(segments):
        ends.append(number)
        for run in runs:
            ends[reach.setdefault(run, number)] = number
    groups: list[tuple[int, ...]] = []
    first = 0
    while first < len(ends):
        last = at = first
        while at <= last:
            last, at = max(last, ends[at]), at + 1
        groups.append(tuple(range(first, last + 1)))
        first = last + 1
    return groups
