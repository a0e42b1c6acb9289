"""Recovery beside a writer when ledger.json is lost: both lock the ledger's folder, which stays the same."""

import shutil
from pathlib import Path
from threading import Thread

import pytest

from fsar_ledger.errors import WriteFailed
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.read import LedgerView, open_ledger
from fsar_ledger.ledger.verify.recover import recover
from fsar_ledger.ledger.verify.rederive import Redo, SetAside, derive
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches

BATCHES = made_up_batches(4, runs=2, size=60)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    append_all(tmp_path / "ledger", BATCHES[:3])
    return tmp_path / "ledger"


@pytest.mark.parametrize("manifest", [None, b"{}"])
def test_a_recovery_beside_a_writer_is_refused_where_the_description_is_lost(
    path: Path, manifest: bytes | None
) -> None:
    with Writer(path, ORIGIN) as writer:
        staged = stage(path, BATCHES[3])
        (path / "ledger.json").unlink()
        if manifest is not None:
            (path / "ledger.json").write_bytes(manifest)
        before = contents(path)
        with pytest.raises(WriteFailed, match="found a writer at work"):
            recover(path)
        assert contents(path) == before
        assert writer.append(staged).commits == 4
    assert recover(path).outcome == "mended"
    assert open_ledger(path).head.commits == 4


def test_a_writer_that_opens_while_the_description_is_made_again_waits_for_the_end(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path / "ledger.json").unlink()
    shutil.rmtree(path / "tile")
    writer = Thread(target=append_all, args=(path, BATCHES[3:]))
    commits: list[int] = []

    def derive_beside_a_writer(view: LedgerView, redo: Redo | None, set_aside: SetAside) -> list[str]:
        writer.start()
        writer.join(0.3)
        commits.append(len(list((path / "commits").iterdir())))
        return derive(view, redo, set_aside)

    monkeypatch.setattr("fsar_ledger.ledger.verify.recover.derive", derive_beside_a_writer)
    assert recover(path).outcome == "mended"
    writer.join(20)
    assert commits == [3]
    assert open_ledger(path).head.commits == 4
    assert verify(path).ok
