"""Our own queries may put into a folder what does not fit into memory."""

from pathlib import Path

import pytest

from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.metrics.database import from_rows

LARGE = "SELECT max(word) AS word FROM (SELECT hash(range)::VARCHAR AS word FROM range(1000000) ORDER BY word OFFSET 1)"


def test_without_a_folder_nothing_is_spilled_and_with_one_the_answer_is_there(tmp_path: Path) -> None:
    with from_rows([]) as database:
        database._connection.execute("SET memory_limit = '50MB'")
        with pytest.raises(FsarLedgerError, match="memory"):
            database.rows(LARGE)
        database.spill(tmp_path / "it's spilled")
        assert len(database.rows(LARGE)) == 1
