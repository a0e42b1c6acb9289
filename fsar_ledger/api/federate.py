"""The function `federate`: a live federation on a ledger, which robots and people give commands."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from fsar_ledger.base.errors import UsageError

from .names import Place

if TYPE_CHECKING:
    from fsar_ledger.runtime.federation import Federation


def federate(
    out: Place,
    *,
    run: str,
    fleet: str | None = None,
    robots: int | None = None,
    settings: Sequence[str] = (),
    origin: str | None = None,
    key: Place | None = None,
    clock: Callable[[], int] = time.time_ns,
) -> "Federation":
    """Return a live federation, whose decisions are a run of the ledger OUT.

    Args:
        out: A new folder, or that of a ledger.
        run: The name of the run; one that is there goes on.
        fleet: The .toml file of a fleet (docs/own-fleet.md), or the name of a registered one; None: the paper's.
        robots: How many robots it has; None: one team.
        settings: Constants as NAME=VALUE, such as the budgets of recovery.
        origin: Publish a new ledger under this name.
        key: The file of the key that signs.
        clock: The time in nanoseconds since 1970.

    Raises:
        UsageError: The fleet cannot be read or has another number of robots; or as `Federation`.
    """
    from fsar_ledger.designs.constants import Constants
    from fsar_ledger.ledger.store.keys import read_signer
    from fsar_ledger.runtime.federation import Federation
    from fsar_ledger.runtime.own import with_own
    from fsar_ledger.runtime.world.founding import team_size
    from fsar_ledger.sources.recorder import kept_origin

    constants, _ = with_own(Constants(), (), fleet, settings)
    team = team_size(constants.fleet)
    count = team if robots is None else robots
    if count < 1 or count % team:
        raise UsageError(f"robots: found {count}, expected a multiple of {team}, the robots of a team")
    signer = None if key is None else read_signer(Path(key))
    return Federation(Path(out), run, constants, count, clock, origin=kept_origin(Path(out)) or origin, signer=signer)
