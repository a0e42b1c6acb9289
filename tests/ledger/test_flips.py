"""Single flipped bits never change an answer: a sample of what `make soak-flips` tries, and that it could find one."""

import shutil
from collections import Counter
from pathlib import Path

import pytest

from fsar_ledger.ledger.rows.layout import read_layout
from fsar_ledger.ledger.store import read
from tests.ledger.flips import KINDS, Answer, chosen, outcomes, undamaged, write_runs

SAMPLED = ("metrics", "explain", "prove")
"""The quick ones; the soak asks every command."""

Ledger = tuple[Path, Path]
"""The folder of a ledger, and one for files that commands write."""


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("flips") / "ledger"
    write_runs(path)
    return path


@pytest.fixture
def ledger(written: Path, tmp_path: Path) -> Ledger:
    out = tmp_path / "out"
    out.mkdir()
    return Path(shutil.copytree(written, tmp_path / "ledger")), out


def tried(ledger: Ledger, good: dict[str, Answer], count: int, kinds: dict[str, int]) -> Counter[str]:
    path, out = ledger
    return Counter(
        outcome for flip in chosen(path, count, 3, kinds) for outcome in outcomes(path, out, flip, good).values()
    )


@pytest.mark.slow
def test_no_flipped_bit_changes_an_answer(ledger: Ledger) -> None:
    good = undamaged(*ledger, SAMPLED)
    found = tried(ledger, good, 30, KINDS)
    assert found["wrong"] == 0
    assert found["refused"] >= 30


@pytest.mark.slow
def test_without_the_comparison_of_hashes_wrong_answers_are_found(
    ledger: Ledger, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = undamaged(*ledger, ("query",))
    monkeypatch.setattr(read, "read_segment", lambda path, file, *_: ((path / file).read_bytes(), None))
    layouts = {file.name: read_layout(file.read_bytes()) for file in (ledger[0] / "segments").iterdir()}
    monkeypatch.setattr(read, "check_layout", lambda path, _: layouts[path.name])

    assert tried(ledger, good, 12, {"segments": 1})["wrong"] > 0
