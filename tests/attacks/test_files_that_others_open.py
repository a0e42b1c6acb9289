"""Exported files: a name in a ledger becomes a formula in a spreadsheet, or breaks a figure."""

import csv
from pathlib import Path
from xml.etree import ElementTree

import pytest

from fsar_ledger.constants import Constants
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.attacks.conftest import Attack
from tests.ledger.hostile import relabelled, stage_anything

FORMULA = "=HYPERLINK(A1&CHAR(47))"


def ledger_of(path: Path, before: str, behind: str) -> Path:
    """Make a ledger whose names begin and end like this."""
    run = simulate_run(RunSpec(5, "fsar", "full", "failure-recovery-chain", 4, 0), Constants())
    with Writer(path, "example.org/fleet") as writer:
        writer.append(stage_anything(path, [relabelled(run, lambda text: before + text + behind)]))
    return path


def test_no_cell_of_csv_is_a_formula(tmp_path: Path, command: Attack) -> None:
    ledger = ledger_of(tmp_path / "ledger", FORMULA, "")
    called = command("query", "failures", ledger, "--csv")
    assert called.code == 0
    assert FORMULA in called.out
    rows = list(csv.reader(called.out.splitlines()))
    assert [cell for row in rows for cell in row if cell.startswith("=")] == []


@pytest.mark.slow
def test_no_cell_of_an_exported_file_is_a_formula(tmp_path: Path, command: Attack) -> None:
    ledger = ledger_of(tmp_path / "ledger", FORMULA, "")
    assert command("export", ledger, "--out", tmp_path / "events.csv").code == 0
    with (tmp_path / "events.csv").open(encoding="utf-8", newline="") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    assert [cell for cell in cells if FORMULA in cell]
    assert [cell for cell in cells if cell.startswith("=")] == []


@pytest.mark.parametrize(
    "behind", [pytest.param("\x0b\x1f\ufffe", marks=pytest.mark.slow), "-->\x00<script>alert(1)</script>"]
)
def test_a_figure_is_well_formed_whatever_a_name_holds(tmp_path: Path, command: Attack, behind: str) -> None:
    ledger = ledger_of(tmp_path / "ledger", "", behind.replace("\x00", "\x01"))
    action = "A1-1/1.1" + behind.replace("\x00", "\x01")
    called = command("explain", ledger, "--request", action, "--svg", tmp_path / "timeline.svg")
    assert called.code == 0, called.err
    ElementTree.fromstring((tmp_path / "timeline.svg").read_bytes())


@pytest.mark.slow
def test_a_figure_is_small_however_long_a_name(tmp_path: Path, command: Attack) -> None:
    behind = " w" * 1_900  # a record carries the name, so no longer one is accepted
    ledger = ledger_of(tmp_path / "ledger", "", behind)
    called = command("explain", ledger, "--request", "A1-1/1.1" + behind, "--svg", tmp_path / "timeline.svg")
    assert called.code == 0, called.err
    assert (tmp_path / "timeline.svg").stat().st_size < 1_000_000
