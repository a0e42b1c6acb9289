"""The names of configurations: an architecture in full, or without some of its mechanisms. Paper: tab:ablation."""

from collections.abc import Iterable
from typing import Literal, TypeAlias, get_args

from .envelope import Architecture

Mechanism = Literal["trust-evaluation", "policy-composition", "layered-recovery", "shared-registry"]
MECHANISMS: tuple[Mechanism, ...] = get_args(Mechanism)
"""The mechanisms of FSAR that the paper's ablation table removes."""

PAPER_ARCHITECTURES: tuple[Architecture, ...] = ("fsar", "cfc", "dhma")
"""The three that the paper compares, which are simulated by default. Paper: sec:evaluation."""

ARCHITECTURES: tuple[Architecture, ...] = (
    "fsar",
    "cfc",
    "dhma",
    "roboos",
    "jade",
    "alliance",
)
"""Every architecture that can be simulated, in the order of runs and tables; each is a folder of its name in
`runtime/architectures/`.
"""

MECHANISMS_OF: dict[Architecture, dict[str, str]] = {
    "fsar": {
        "trust-evaluation": "trust in the requester is evaluated (else anyone is served)",
        "policy-composition": "requester's policy and fleet rule composed (else the executor's alone)",
        "layered-recovery": "layered recovery (else the supervisor at once)",
        "shared-registry": "a registry shows who can do what (else only peers that the robot has met)",
        "trust-by-record": "trust follows the record of results (else it stays as at the founding)",
        "engine-closing": "the coordination engine closes requests (else the requester does)",
        "boundary-revocation": "revocation waits for the request boundary (else no claim)",
        "start-recheck": "policy is checked again when delegated work starts (else it starts as admitted)",
        "fleet-recheck": "the fleet's rule is applied when delegated work starts (else the robot's own policy alone)",
        "own-work-check": "policy is checked when own steps and motions start (else nothing checks them)",
    },
    "cfc": {
        "safe-stop-claims": "context changes make robots and supervisors claim (else no claim)",
        "synced-copies": "decisions on periodically synced copies (else on the robots' present state)",
        "coordinator-queue": "the coordinator takes time for each item of work (else none)",
        "central-recovery": "every failure goes to the coordinator (else the robot itself retries first)",
        "unnamed-requests": "the coordinator's records name no requester (else the robot whose task it is)",
        "central-decisions": "the coordinator decides (else the acting robot is on record as the decider)",
    },
    "dhma": {
        "acknowledged-handoffs": "hand-offs take effect when acknowledged (else at once)",
        "planner-claims": "context changes make agents claim override (else no claim)",
        "recovery-disputes": "recovery is disputed by an engaged planner (else never)",
        "contract-questioning": "context changes put contracts in question (else they stand)",
        "policy-snapshots": "decisions on snapshots of policy (else on the present policy)",
        "hop-latency": "agents of a robot hear each other after a delay (else at once)",
        "handoff-records": "an executor's agents record how they pass delegated work on (else they do not)",
        "agent-decisions": "decisions pass through agents (else the robot is on record as the decider)",
        "nested-queries": "nested queries carry requests past visibility (else they fail)",
    },
}
"""Every mechanism that can be removed from each architecture: what it does, and what replaces it.

No two mechanisms share a name. The handlers check the paper's four; `runtime.knockouts` holds the others.
"""

EVERY_MECHANISM: tuple[str, ...] = tuple(name for names in MECHANISMS_OF.values() for name in names)

Configuration: TypeAlias = str
"""`full`, or `without-` and the removed mechanisms, joined by `+`.

For example `without-trust-evaluation` or `without-trust-evaluation+shared-registry`.
"""

FULL: Configuration = "full"
_WITHOUT = "without-"


def without(mechanisms: Iterable[str]) -> Configuration:
    """Name the configuration that lacks these mechanisms, each once, in the order of `EVERY_MECHANISM`."""
    lacking = set(mechanisms)
    return _WITHOUT + "+".join(name for name in EVERY_MECHANISM if name in lacking) if lacking else FULL


def removed_mechanisms(configuration: str) -> frozenset[str]:
    """Return the mechanisms that the configuration of this name lacks; none for any other text."""
    if configuration.startswith(_WITHOUT):
        return frozenset(configuration.removeprefix(_WITHOUT).split("+"))
    return frozenset()


def is_known(configuration: str) -> bool:
    """Return whether this names a configuration in which some architecture can be simulated."""
    return (
        any(map(removed_mechanisms(configuration).issubset, MECHANISMS_OF.values()))
        and without(removed_mechanisms(configuration)) == configuration
    )


def rank(configuration: Configuration) -> tuple[int, tuple[int, ...]]:
    """Return the rank of a known configuration: full first, then those that lack one mechanism, then two."""
    lacking = [EVERY_MECHANISM.index(name) for name in EVERY_MECHANISM if name in removed_mechanisms(configuration)]
    return len(lacking), tuple(lacking)


CONFIGURATIONS: tuple[Configuration, ...] = (FULL, *(without([mechanism]) for mechanism in MECHANISMS))
"""The configurations of the paper's ablation table: full, and without one mechanism each."""
