"""How a configuration is named: an architecture in full, or without some of its mechanisms. Paper: tab:ablation."""

from collections.abc import Iterable
from typing import Literal, TypeAlias, get_args

Mechanism = Literal["trust-evaluation", "policy-composition", "layered-recovery", "shared-registry"]
MECHANISMS: tuple[Mechanism, ...] = get_args(Mechanism)

Configuration: TypeAlias = str
"""`full`, or `without-` and the mechanisms that are taken out: `without-trust-evaluation`, `without-trust-evaluation+shared-registry`."""

FULL: Configuration = "full"
_WITHOUT = "without-"


def without(mechanisms: Iterable[str]) -> Configuration:
    """Return the name of the configuration that lacks these mechanisms; they stand in the paper's order, each once."""
    lacking = set(mechanisms)
    return _WITHOUT + "+".join(one for one in MECHANISMS if one in lacking) if lacking else FULL


def lacks(configuration: str) -> frozenset[str]:
    """Return the mechanisms that a configuration of this name lacks: none if it is another text."""
    return frozenset(configuration.removeprefix(_WITHOUT).split("+")) if configuration.startswith(_WITHOUT) else frozenset()


def is_known(configuration: str) -> bool:
    """Tell whether this is the name of a configuration that can be simulated."""
    return lacks(configuration) <= set(MECHANISMS) and without(lacks(configuration)) == configuration


def rank(configuration: Configuration) -> tuple[int, tuple[int, ...]]:
    """Return the place of a known configuration among others: full first, then those that lack one mechanism, then two."""
    lacking = [MECHANISMS.index(one) for one in MECHANISMS if one in lacks(configuration)]
    return len(lacking), tuple(lacking)


CONFIGURATIONS: tuple[Configuration, ...] = (FULL, *(without([one]) for one in MECHANISMS))
"""Those of the paper's ablation table: in full, and without one mechanism each."""
