"""Which version satisfies which range, which contract suits which query, and which contradicts itself.

Paper: sec:architecture:registry.
"""

from collections.abc import Iterable

from fsar_ledger.projections.registry import Contract

Version = tuple[int, int, int]
NOT = "not "


def version_of(text: str) -> Version | None:
    """Return the version as three numbers, missing ones 0; None when the text is no version."""
    parts = text.split(".")
    if len(parts) > 3 or not all(part.isascii() and part.isdecimal() and len(part) < 10 for part in parts):
        return None
    major, minor, patch = (int(part) for part in (*parts, "0", "0")[:3])
    return major, minor, patch


def is_range(text: str) -> bool:
    """Tell whether the text is a range: empty (any), `1.2.0` (exactly), `^1.2` (compatible) or `>=1.2`."""
    return text == "" or version_of(text.removeprefix(_sign(text))) is not None


def is_in_range(version: str, wanted: str) -> bool:
    """Tell whether the version lies in the range; a text that is no version lies only in the empty one.

    Compatible is what keeps the first number that is not 0, as in semantic versioning: `^1.2` is from 1.2.0 to before
    2.0.0, `^0.2` from 0.2.0 to before 0.3.0. Paper: sec:architecture:registry (semantic matching).
    """
    if wanted == "":
        return True
    sign = _sign(wanted)
    found, lowest = version_of(version), version_of(wanted.removeprefix(sign))
    if found is None or lowest is None:
        return False
    if sign == "^":
        return lowest <= found < _breaking(lowest, wanted.count(".") + 1)
    return found >= lowest if sign == ">=" else found == lowest


def _sign(wanted: str) -> str:
    return "^" if wanted.startswith("^") else ">=" if wanted.startswith(">=") else ""


def _breaking(version: Version, given: int) -> Version:
    """Return the next version that may be incompatible; `given` is how many numbers the range states."""
    major, minor, patch = version
    if major > 0 or given == 1:
        return major + 1, 0, 0
    if minor > 0 or given == 2:
        return 0, minor + 1, 0
    return 0, 0, patch + 1


def is_suitable(
    contract: Contract, needs: Iterable[str], provides: Iterable[str] | None, resources: Iterable[str] | None
) -> bool:
    """Tell whether the contract gives what is needed and asks for no more than is provided.

    None states nothing. Paper: sec:architecture:registry.
    """
    return (
        set(needs) <= set(contract.postconditions)
        and (provides is None or set(contract.preconditions) <= set(provides))
        and (resources is None or set(contract.resources) <= set(resources))
    )


def contradiction(contract: Contract) -> str | None:
    """Return what is wrong with the contract in itself, or None.

    What must hold before and what holds after may differ, even be opposites: that is what execution is for. But
    neither may ask for a name and its `not` together, name anything twice, or name nothing. Paper: eq:adv.
    """
    for part, names in (
        ("precondition", contract.preconditions),
        ("postcondition", contract.postconditions),
        ("resource", contract.resources),
    ):
        for name in names:
            bare = name.removeprefix(NOT)
            if not bare or bare != bare.strip() or bare == "not" or bare.startswith(NOT):
                return f"{part} {name!r} is no name, expected a name or `not ` and a name"
            if names.count(name) > 1:
                return f"{part} {name} is named twice"
            if NOT + name in names:
                return f"{part}s {name} and {NOT}{name} contradict each other"
    if any(name.startswith(NOT) for name in contract.resources):
        return "a resource cannot be taken by not taking it, expected names without `not `"
    return None


def weaker(offered: Contract, installed: Contract) -> str | None:
    """Return why the offered contract promises more than the installed one keeps, or None.

    An offer may demand more and promise less, never the reverse.
    """
    if promised := sorted(set(offered.postconditions) - set(installed.postconditions)):
        return f"postcondition {promised[0]} is not one of the installed module"
    if demanded := sorted(set(installed.preconditions) - set(offered.preconditions)):
        return f"precondition {demanded[0]} of the installed module is left out"
    if taken := sorted(set(installed.resources) - set(offered.resources)):
        return f"resource {taken[0]} of the installed module is left out"
    return None
