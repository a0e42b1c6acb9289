"""What `verify` is asked, and what it reports."""

import msgspec

from fsar_ledger.ledger.log.note import Signed, VerifierKey
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, NODES
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.verify.notes import Anchor
from fsar_ledger.ledger.verify.segment import SecondReader

MAX_PROBLEMS = 100
"""The most problems that a report names; a ledger with more is lost anyway."""


class VerifyOptions(msgspec.Struct, frozen=True):
    """What `verify` is asked to check beyond the ledger itself.

    With `is_quick`, no rows are read: only the chain of records, the hashes of the files and the notes are checked.
    `witnessed` are more anchors, whose signatures were checked where they came from. `second_reader` reads the rows of
    each segment again, with other code, and compares them; it can be pickled.
    """

    is_quick: bool = False
    trusted: VerifierKey | None = None
    anchor: Anchor | None = None
    witnessed: tuple[Anchor, ...] = ()
    second_reader: SecondReader | None = None

    def sizes(self) -> set[int]:
        """Return the sizes of the anchors' trees."""
        anchors = (self.anchor, *self.witnessed)
        return {anchor.note.checkpoint.size for anchor in anchors if anchor is not None and anchor.note is not None}


NOT_LOOKED_AT = ("rows of segments", NODES, INDEX, f"continues, goes_on and index_sha256 in {CHAIN}")
"""What a quick look does not look at."""


class VerifyReport(msgspec.Struct, frozen=True):
    """The findings of `verify`.

    Units: `commits`, `events` and `runs` count what was read without doubt; `signed` counts commits.

    `root` is the Merkle root in hex over the rows themselves (as recorded, if rows were not read), None if there is any
    doubt. `signer` is the trusted key (`name+id`) if one was given, else the one that the newest note names; `anchored`
    counts the events of the anchor. `remarks` are not doubts: what a crash may leave behind, and what a quick look
    leaves open. `not_looked_at` names what that did not compare with anything; nothing if it was not quick.
    `record_sha256` is the hash of the newest commit record (of ledger.json if there is none), which vouches for all
    before; None if there is any doubt.
    """

    ok: bool
    problems: tuple[Problem, ...]
    commits: int
    events: int
    runs: int
    root: str | None
    signature: Signed = "unsigned"
    signer: str | None = None
    signed: int = 0
    is_quick: bool = False
    anchored: int | None = None
    remarks: tuple[str, ...] = ()
    record_sha256: str | None = None
    not_looked_at: tuple[str, ...] = ()
