"""What a writer requires of an origin and of a key."""

from pathlib import Path

import pytest

from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.store.append import Writer
from tests.ledger.samples import ORIGIN


def test_a_key_of_another_origin_makes_no_ledger(tmp_path: Path) -> None:
    signer = Signer("example.org/other", bytes(32))
    with pytest.raises(UsageError, match=f"found a key named example.org/other, expected {ORIGIN}"):
        Writer(tmp_path / "ledger", ORIGIN, signer)
    assert not (tmp_path / "ledger").exists()


@pytest.mark.parametrize("origin", ["", "two words", "a+b", "a\nb", "x" * 300_000])
def test_what_is_no_name_is_no_origin(tmp_path: Path, origin: str) -> None:
    with pytest.raises(ValueError, match=r"found (an )?origin"):
        Writer(tmp_path / "ledger", origin)
    assert not (tmp_path / "ledger").exists()
