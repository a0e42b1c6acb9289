"""A growing log, witnesses of it, and a clock that stands still."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import pytest

from fsar_ledger.ledger.log.hashing import parents
from fsar_ledger.ledger.log.merkle import consistency_proof, leaf_hash, root
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signer
from fsar_ledger.witness import Request, WitnessKey
from fsar_ledger.witness.server import Service, WitnessServer
from fsar_ledger.witness.state import State, new_state, open_state
from tests.cli.conftest import call as call  # re-exported as a fixture

ORIGIN = "example.org/log"
LOG = Signer(ORIGIN, bytes(range(32)))
STRANGER = Signer(ORIGIN, bytes(range(1, 33)))
NOW_S = 1_795_320_000


class Log:
    """A log with a tree of these leaves; `twist` makes one that differs after a common beginning."""

    def __init__(self, size: int, twist: int | None = None) -> None:
        self.leaves = [leaf_hash(b"%d %d" % (at, twist is not None and at >= twist)) for at in range(size)]

    def checkpoint(self, size: int) -> Checkpoint:
        """Return the checkpoint of the first `size` leaves."""
        return Checkpoint(ORIGIN, size, root(self.leaves[:size]))

    def note(self, size: int, signer: Signer = LOG) -> Note:
        """Return that checkpoint, signed."""
        checkpoint = self.checkpoint(size)
        return Note(checkpoint, (signer.sign(checkpoint),))

    def proof(self, old: int, new: int) -> tuple[bytes, ...]:
        """Prove that the tree of `new` begins with that of `old`."""
        return consistency_proof(self._node, old, new)

    def request(self, old: int, new: int) -> Request:
        """Return the request of the log to a witness that knows `old`."""
        return Request(old, self.proof(old, new), self.note(new))

    def _node(self, height: int, number: int) -> bytes:
        hashes = b"".join(self.leaves[number << height : (number + 1) << height])
        for _ in range(height):
            hashes = parents(hashes)
        return hashes


class Open(NamedTuple):
    """A witness running in this process, and what its operator was told."""

    state: State
    service: Service
    told: list[str]
    key: WitnessKey


@contextmanager
def at_work(folder: Path, now_s: int = NOW_S) -> Iterator[Open]:
    """Open the witness in this folder, making it first if there is none."""
    if not folder.exists():
        new_state(folder, f"example.org/{folder.name}")
    told: list[str] = []
    with open_state(folder) as state:
        yield Open(state, Service(state, [LOG.verifier], lambda: now_s, told.append), told, state.cosigner.key)


@contextmanager
def serving(service: Service) -> Iterator[WitnessServer]:
    """Serve the witness on a free port of this machine, with the test's clock."""
    from time import monotonic

    with WitnessServer("127.0.0.1", 0, service, monotonic) as server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def witness(tmp_path: Path) -> Iterator[Open]:
    """Provide a new witness of the log."""
    with at_work(tmp_path / "w1") as found:
        yield found
