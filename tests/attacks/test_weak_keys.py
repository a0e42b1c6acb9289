"""A public key of small order, under which anybody signs: with it any ledger or proof showed as signed."""

import shutil
from pathlib import Path

import pytest

from tests.attacks.conftest import Attack
from tests.cli.conftest import one_message
from tests.ledger.agreement_chain import rewrite, tables_of
from tests.ledger.samples import ORIGIN, append_all, made_up_batches
from tests.ledger.weak_keys import WEAK, Forger
from tests.quick import few

KINDS = ("order 1", "order 8, second, odd", "order 4, y = p")


@pytest.fixture(scope="module")
def unsigned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("unsigned") / "ledger"
    append_all(path, made_up_batches(2))
    return path


def signed_by_nobody(unsigned: Path, folder: Path, kind: str) -> tuple[Path, Forger]:
    """Make a ledger with a signature under each note for which nobody had a secret."""
    path, forger = Path(shutil.copytree(unsigned, folder / "ledger")), Forger(ORIGIN, WEAK[kind])
    rewrite(path, tables_of(path), forger)
    return path, forger


@pytest.mark.parametrize("kind", few(KINDS, [*KINDS][:1]))
def test_a_signature_without_a_secret_does_not_make_a_ledger_signed(
    unsigned: Path, tmp_path: Path, command: Attack, kind: str
) -> None:
    path, forger = signed_by_nobody(unsigned, tmp_path, kind)
    (tmp_path / "weak.pub").write_text(f"{forger}\n")
    for key in (forger, tmp_path / "weak.pub"):
        called = command("verify", path, "--trusted-key", key)
        assert "signed" not in called.out
        one_message(called, 2, "--trusted-key", "found a point", "expected an Ed25519 public key")


@pytest.mark.slow
def test_a_signature_without_a_secret_does_not_make_a_proof_signed(
    unsigned: Path, tmp_path: Path, command: Attack
) -> None:
    path, forger = signed_by_nobody(unsigned, tmp_path, "order 2")
    assert command("prove", path, "3", "--out", tmp_path / "3.tlog-proof").code == 0
    called = command("verify-proof", tmp_path / "3.tlog-proof", "--trusted-key", forger)
    assert "signed" not in called.out
    one_message(called, 2, "--trusted-key", "found a point of small order")
