"""The names of configurations: an architecture in full, or without some of its mechanisms. Paper: tab:ablation."""

from collections.abc import Iterable
from typing import Literal, TypeAlias, get_args

from .envelope import Architecture

Mechanism = Literal["trust-evaluation", "policy-composition", "layered-recovery", "shared-registry"]
MECHANISMS: tuple[Mechanism, ...] = get_args(Mechanism)
"""FSAR's, those of the paper's ablation table."""

MECHANISMS_OF: dict[Architecture, dict[str, str]] = {
    "fsar": {
        "trust-evaluation": "trust in the requester is evaluated (else anybody is served)",
        "policy-composition": "requester's policy and fleet rule composed (else the executor's alone)",
        "layered-recovery": "layered recovery (else the supervisor at once)",
        "shared-registry": "a registry shows who can do what (else peers that were met)",
        "engine-closing": "closing by the coordination engine (else by the requester)",
        "boundary-revocation": "revocation waits for the request boundary (else no claim)",
        "start-recheck": "policy is checked again where delegated work starts (else it starts as admitted)",
        "own-work-check": "policy is checked where own steps and motions start (else nothing checks them)",
    },
    "cfc": {
        "safe-stop-claims": "context changes make robots and supervisors claim (else no claim)",
        "synced-copies": "decisions on copies synced now and then (else on robots as they are)",
        "coordinator-queue": "the coordinator takes time for each item of work (else none)",
        "central-recovery": "every failure goes to the coordinator (else the robot first tries again itself)",
        "unnamed-requests": "the coordinator's records name no requester (else the robot whose task it is)",
        "central-decisions": "the coordinator decides (else the robot that acts is on record as who did)",
    },
    "dhma": {
        "acknowledged-handoffs": "hand-off is acknowledged (else at once)",
        "planner-claims": "context changes make agents claim override (else no claim)",
        "recovery-disputes": "recovery is disputed by an engaged planner (else never)",
        "contract-questioning": "context changes put contracts in question (else they stand)",
        "policy-snapshots": "decisions on snapshots of policy (else on policy as it is)",
        "hop-latency": "agents of a robot hear each other after a while (else at once)",
        "handoff-records": "each hop between agents is on record (else none is)",
        "agent-decisions": "decisions pass through agents (else the robot is on record as who decided)",
        "nested-queries": "nested queries carry requests past visibility (else they come to nothing)",
    },
}
"""All that can be taken out of each architecture: what it does, and what replaces it.

No two mechanisms share a name. The handlers know the paper's four; `runtime.knockouts` holds the others.
"""

ON_RECORD_ALONE = frozenset(
    {"engine-closing", "unnamed-requests", "central-decisions", "handoff-records", "agent-decisions"}
)
"""Without these, the same is done at the same times, but the record names others for it or has less.

They show how a metric counts.
"""

EVERY_MECHANISM: tuple[str, ...] = tuple(name for names in MECHANISMS_OF.values() for name in names)

Configuration: TypeAlias = str
"""`full`, or `without-` and the mechanisms that are taken out.

`without-trust-evaluation`, `without-trust-evaluation+shared-registry`.
"""

FULL: Configuration = "full"
_WITHOUT = "without-"


def without(mechanisms: Iterable[str]) -> Configuration:
    """Name the configuration that lacks these mechanisms, each once, in the order of `EVERY_MECHANISM`."""
    lacking = set(mechanisms)
    return _WITHOUT + "+".join(one for one in EVERY_MECHANISM if one in lacking) if lacking else FULL


def lacks(configuration: str) -> frozenset[str]:
    """Return the mechanisms that a configuration of this name lacks: none if it is another text."""
    return (
        frozenset(configuration.removeprefix(_WITHOUT).split("+"))
        if configuration.startswith(_WITHOUT)
        else frozenset()
    )


def is_known(configuration: str) -> bool:
    """Tell whether this is the name of a configuration that can be simulated, of some architecture."""
    return (
        any(map(lacks(configuration).issubset, MECHANISMS_OF.values()))
        and without(lacks(configuration)) == configuration
    )


def rank(configuration: Configuration) -> tuple[int, tuple[int, ...]]:
    """Return the rank of a known configuration: full first, then those that lack one mechanism, then two."""
    lacking = [EVERY_MECHANISM.index(one) for one in EVERY_MECHANISM if one in lacks(configuration)]
    return len(lacking), tuple(lacking)


CONFIGURATIONS: tuple[Configuration, ...] = (FULL, *(without([one]) for one in MECHANISMS))
"""Those of the paper's ablation table: in full, and without one mechanism each."""
