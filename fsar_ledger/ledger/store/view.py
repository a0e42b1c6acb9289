"""How far a ledger goes, and where its runs are."""

import msgspec

from fsar_ledger.ledger.log import merkle
from fsar_ledger.ledger.rows.blocks import Block


class Head(msgspec.Struct, frozen=True):
    """How far a ledger goes: commits, events, the Merkle root over them in hex, and the last run."""

    commits: int
    size: int
    root: str
    last_run: str | None = None


EMPTY_HEAD = Head(0, 0, merkle.EMPTY_ROOT.hex())


class Part(msgspec.Struct, frozen=True):
    """A part of a run: those of the events from index `first` to `end` of the ledger that are its own.

    Events of other runs may be among them. The block has neither `observes` nor `concerns`.
    """

    first: int
    end: int
    block: Block


class Extent(msgspec.Struct, frozen=True):
    """How many events a run or plan has, and between which indexes of the ledger they are, perhaps among others."""

    run: str
    rows: int
    first: int
    end: int


class RunNames(msgspec.Struct, frozen=True):
    """The names of a ledger's runs, and of its plans, each in the order of their first events."""

    runs: tuple[str, ...] = ()
    plans: tuple[str, ...] = ()

    def numbers(self) -> dict[str, int]:
        """Return the number that names each run, from 1; none that is itself the name of a run or a plan."""
        names = {*self.runs, *self.plans}
        return {name: number for number, name in enumerate(self.runs, start=1) if f"{number}" not in names}
