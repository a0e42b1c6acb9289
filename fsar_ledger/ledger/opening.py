"""Open a ledger of any format.

To answer from it, it is opened after the checks of `verify --quick`: the records, their chain and notes, and the file
`checkpoint` are compared here; the bytes of a segment when it is handed out (`View.segment`). Stray files are left to
`verify`, because no answer reads a file that no record names. So are the derived hashes, except those of a proof, which
is checked against the root, and of the index, whose lines are compared with their records.
"""

from pathlib import Path

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.ledger.chain.checkpoint import check_chain_checkpoint
from fsar_ledger.ledger.chain.read import ChainView, open_chain
from fsar_ledger.ledger.store import read, turns
from fsar_ledger.ledger.store.derived import check_checkpoint
from fsar_ledger.ledger.store.paths import COMMITS, MANIFEST, SEGMENTS
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.store.record import CHAINED, VERSION, Manifest, parse_manifest
from fsar_ledger.ledger.store.view import View


def manifest_of(path: Path) -> Manifest:
    """Return what the ledger at this path says of itself.

    Raises: NotALedger, FormatVersionMismatch, LedgerCorrupted as `open_ledger`.
    """
    return parse_manifest(path / MANIFEST, read.read_manifest(path), (VERSION, CHAINED))


def version_of(path: Path) -> int:
    """Return the format version of the ledger at this path. Raises: As `manifest_of`."""
    return manifest_of(path).version


def open_ledger(path: Path) -> View:
    """Open the ledger at this path: check its records against each other, without reading any events of segments.

    Raises:
        NotALedger: There is no ledger.
        FormatVersionMismatch: It was written in a format that this version does not know, or holds events of a later
            release.
        LedgerCorrupted: A record is missing, is not canonical, or contradicts the one before it; or a folder is a link.
    """
    data = read.read_manifest(path)
    if parse_manifest(path / MANIFEST, data, (VERSION, CHAINED)).version == CHAINED:
        return open_chain(path, data)
    return read.open_ledger(path)


def open_for_answers(path: Path) -> View:
    """Open the ledger at this path, and compare its checkpoint with its newest commits.

    An older note is accepted where a crash may leave it: that of the commit before or, in format 2, of any commit since
    which the journal holds all. If they do not fit, both are read once more while any writer waits.

    Raises:
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_ledger`; LedgerCorrupted also for any other
            checkpoint, or none.
    """
    view = open_ledger(path)
    problems = _doubts(view)
    if problems:
        with turns.turn(path / (COMMITS if version_of(path) == VERSION else SEGMENTS), is_shared=True):
            view = open_ledger(path)
            problems = _doubts(view)
    for problem in problems:
        raise LedgerCorrupted(
            f"{path}/{problem}: commits were removed, or the file was altered; run fsar-ledger verify, and "
            "fsar-ledger recover if it says so"
        )
    return view


def _doubts(view: View) -> list[Problem]:
    if isinstance(view, ChainView):
        return check_chain_checkpoint(view)
    assert isinstance(view, read.LedgerView)
    return check_checkpoint(view.path, view.records)[0]
