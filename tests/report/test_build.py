"""Reports of whole and incomplete ledgers, and outputs that cannot be written."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from fsar_ledger.base.errors import NotALedger, UsageError, WriteFailed
from fsar_ledger.base.publishing import publish
from fsar_ledger.report import build
from fsar_ledger.report.build import write_report
from tests.running import files_of_at_most

Make = Callable[..., Path]
REPORT = """
import sys
from pathlib import Path
from fsar_ledger.base.publishing import publish
from fsar_ledger.report.build import write_report
ledger, out, workflows = map(Path, sys.argv[1:])
write_report(ledger, out, workflows, numbers_out=out.with_name(out.name + ".json"))
"""


@pytest.mark.slow
def test_same_ledger_gives_the_same_bytes_in_another_process_with_another_hash_seed_and_zone(
    ledger: Path, workflows: Path, whole_report: Path, tmp_path: Path
) -> None:
    there = tmp_path / whole_report.name
    environment = os.environ | {"PYTHONHASHSEED": "7", "TZ": "Asia/Tokyo", "LC_ALL": "C"}
    subprocess.run([sys.executable, "-c", REPORT, ledger, there, workflows], env=environment, check=True)
    for name in ("report.pdf", "report.pdf.json"):
        assert (tmp_path / name).read_bytes() == whole_report.with_name(name).read_bytes()


@pytest.mark.parametrize(
    "contents",
    [
        pytest.param({"architectures": ("fsar",)}, marks=pytest.mark.slow),
        pytest.param(
            {"architectures": ("cfc", "dhma"), "scenarios": ("door-relay",), "runs": 1}, marks=pytest.mark.soak
        ),
        pytest.param({"architectures": ("fsar",), "configuration": "without-shared-registry"}, marks=pytest.mark.slow),
        pytest.param({"fleet_size": 8}, marks=pytest.mark.soak),
        {"architectures": ()},
    ],
    ids=["one architecture", "one run each", "an ablation alone", "another fleet size alone", "no run"],
)
def test_report_of_an_incomplete_ledger_is_made(make_ledger: Make, tmp_path: Path, contents: dict[str, object]) -> None:
    out = tmp_path / "new" / "report.pdf"
    write_report(make_ledger(**contents), out)
    assert out.read_bytes().startswith(b"%PDF")


def test_report_of_no_ledger_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotALedger):
        write_report(tmp_path / "nothing", tmp_path / "report.pdf")
    assert not (tmp_path / "report.pdf").exists()


@pytest.mark.parametrize("numbers", ["report.pdf", "folder/../report.pdf", "link"])
def test_report_and_numbers_in_the_same_file_are_refused(ledger: Path, tmp_path: Path, numbers: str) -> None:
    out = tmp_path / "report.pdf"
    out.write_bytes(b"old")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(out)
    with pytest.raises(UsageError, match="the same file"):
        write_report(ledger, out, numbers_out=tmp_path / numbers)
    assert out.read_bytes() == b"old"


def test_disk_that_takes_no_more_leaves_the_old_file(tmp_path: Path) -> None:
    out = tmp_path / "report.pdf"
    out.write_bytes(b"old")
    with files_of_at_most(1000), pytest.raises(WriteFailed, match="Nothing was changed"):
        publish(out, bytes(5000))
    assert [path.name for path in tmp_path.iterdir()] == ["report.pdf"]
    assert out.read_bytes() == b"old"


def test_full_folder_for_temporary_files_is_said() -> None:
    with files_of_at_most(1000), pytest.raises(WriteFailed, match="temporary files"):
        build.pdf(bytes(5000), {})
