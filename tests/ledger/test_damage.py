"""Damage to ledgers is found, and only what a crash may leave passes for that; `python -m
tests.ledger.damage_soak` tries all."""

import shutil
from collections import Counter
from pathlib import Path

import pytest

from fsar_ledger.ledger.store.paths import CHAIN, JOURNAL
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyReport
from tests.ledger.damage import LEDGERS, Allowance, cases, files_of, is_placed, look, verdict, write_closed
from tests.ledger.once import decoded_once
from tests.quick import few


@pytest.mark.parametrize("step", few([43, 211, 907], [907], [211]))
@pytest.mark.parametrize("name", LEDGERS)
def test_a_flip_or_a_cut_anywhere_is_found_in_its_place_or_left_as_by_a_crash(
    tmp_path: Path, name: str, step: int
) -> None:
    path = tmp_path / "ledger"
    LEDGERS[name](path)
    allowance, found = Allowance(path), Counter[str]()
    with decoded_once():
        for file in files_of(path):
            good = (path / file).read_bytes()
            for at in range(0, len(good), step if file.endswith(".parquet") else max(1, step // 9)):
                changed = bytes([good[at] ^ 1 << at % 8])
                for is_cut, data in ((True, good[:at]), (False, good[:at] + changed + good[at + 1 :])):
                    (path / file).write_bytes(data)
                    how = look(path, allowance, file, at, is_cut=is_cut)
                    assert how in ("placed", "left"), (file, at, is_cut)
                    found[how] += 1
            (path / file).write_bytes(good)
    assert found["placed"] > 30
    assert (found["left"] > 0) == (name != "closed")


@pytest.mark.slow
def test_a_file_that_is_gone_or_in_the_place_of_another_is_found(tmp_path: Path) -> None:
    path = tmp_path / "ledger"
    write_closed(path)
    shutil.copytree(path, tmp_path / "whole")
    with decoded_once():
        for case in list(cases(path)):
            case.do()
            assert is_placed(verify(path), case.places), case.name
            for left in (path, tmp_path / "aside"):
                shutil.rmtree(left) if left.is_dir() else left.unlink(missing_ok=True)
            shutil.copytree(tmp_path / "whole", path)


def test_the_judge_of_damage_sees_what_is_missed_and_what_is_told_of_another_file(tmp_path: Path) -> None:
    LEDGERS["left open"](tmp_path / "ledger")
    allowance, report = Allowance(tmp_path / "ledger"), verify(tmp_path / "ledger")
    assert report.root is not None
    assert verdict(report, allowance, JOURNAL, 0, is_cut=True) == "missed"
    other = VerifyReport(True, (), 0, 0, 0, allowance.root(JOURNAL, 0, is_cut=True))
    assert verdict(other, allowance, JOURNAL, 0, is_cut=True) == "left"
    assert verdict(other, allowance, CHAIN, 0, is_cut=True) == "missed"
    (tmp_path / "ledger" / "nodes").write_bytes(b"x")
    assert verdict(verify(tmp_path / "ledger"), allowance, JOURNAL, 0, is_cut=False) == "found"
