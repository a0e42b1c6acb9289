"""The command that a page on a format shows."""

import re
import shlex
from pathlib import Path

import pytest

from fsar_ledger.cli.app import run

PAGES = Path(__file__).resolve().parents[2] / "docs" / "sources"


def printed_otherwise(page: str, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """Run the command; return the lines that the page shows and that it does not print."""
    (block,) = re.findall(r"```console\n(.*?)```", (PAGES / page).read_text("utf-8"), flags=re.DOTALL)
    command, *shown = block.splitlines()
    assert command.startswith("$ fsar-ledger ")
    assert run(shlex.split(command)[2:]) == 0
    printed = capsys.readouterr().out.splitlines()
    return [line for line in shown if line not in printed]
