"""What writers of each format require of an origin and of a key."""

from pathlib import Path

import pytest

from fsar_ledger.errors import UsageError
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.writing import VERSIONS, open_writer
from tests.ledger.samples import ORIGIN


@pytest.mark.parametrize("version", VERSIONS)
def test_a_key_of_another_origin_makes_no_ledger(tmp_path: Path, version: int) -> None:
    signer = Signer("example.org/other", bytes(32))
    with pytest.raises(UsageError, match=f"found a key named example.org/other, expected {ORIGIN}"):
        open_writer(tmp_path / "ledger", ORIGIN, signer, version=version)
    assert not (tmp_path / "ledger").exists()


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("origin", ["", "two words", "a+b", "a\nb", "x" * 300_000])
def test_what_is_no_name_is_no_origin(tmp_path: Path, version: int, origin: str) -> None:
    with pytest.raises(ValueError, match=r"found (an )?origin"):
        open_writer(tmp_path / "ledger", origin, version=version)
    assert not (tmp_path / "ledger").exists()
