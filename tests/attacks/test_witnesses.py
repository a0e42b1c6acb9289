"""The log's own key used to rewrite a ledger or drop its newest commits: every signature is right.

Only someone who saw more can tell. The witness is of this tree; the auditor uses everything that the commands of the
checkout under attack offer.
"""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.witness.cosign import cosign
from fsar_ledger.witness.policy import read_policy
from fsar_ledger.witness.state import new_state
from tests.attacks.conftest import Attack
from tests.cli.conftest import Called
from tests.ledger.damage import SIGNER, write_ledger
from tests.ledger.samples import ORIGIN, made_up_run
from tests.witness.processes import honest


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """Make a signed ledger of two commits in `2`, the same after three, which a witness saw, in `3`, and a policy."""
    write_ledger(tmp_path / "whole", (200, 80, 60), tmp_path)
    (tmp_path / "log.pub").write_text(f"{SIGNER.verifier}\n")
    new_state(tmp_path / "w", "example.org/w")
    with honest(tmp_path / "w", [tmp_path / "log.pub"]) as witness:
        (tmp_path / "policy").write_text(f"log {SIGNER.verifier}\n{witness.line('w')}quorum w\n")
        assert list(cosign(tmp_path / "3", read_policy(tmp_path / "policy")).times) == ["w"]
        yield tmp_path


def audited(command: Attack, folder: Path, ledger: Path) -> Called:
    """Return what an auditor with the log's public key is told, asking witnesses where the command line can."""
    offered = command("verify", "--help", COLUMNS="200").out
    policy = ("--witness-policy", folder / "policy") if "--witness-policy" in offered else ()
    return command("verify", ledger, "--trusted-key", folder / "log.pub", *policy)


@pytest.mark.slow
def test_dropped_tails_are_found_without_an_anchor(command: Attack, folder: Path) -> None:
    called = audited(command, folder, folder / "2")
    assert called.code == 3, called.out
    assert "found 280 events, expected at least 340" in called.err


@pytest.mark.slow
def test_a_rewrite_with_the_same_key_is_found_without_an_anchor(command: Attack, folder: Path) -> None:
    shutil.copytree(folder / "1", folder / "other")
    with Writer(folder / "other", ORIGIN, SIGNER) as writer:
        writer.append(stage(folder / "other", [made_up_run("run-9999", 300, seed=99)]))
    called = audited(command, folder, folder / "other")
    assert called.code == 3, called.out
    assert "history was rewritten" in called.err
