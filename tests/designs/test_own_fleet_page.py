"""docs/own-fleet.md as it is printed: its files, its commands, and their answers but for digests."""

import re
import shlex
from pathlib import Path

import pytest

from fsar_ledger.cli.app import run
from fsar_ledger.designs import registered

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "own-fleet.md").read_text("utf-8")
BLOCKS = re.findall(r"^```(toml|console)\n(.*?)\n```$", PAGE, re.DOTALL | re.MULTILINE)


def without_digests(text: str) -> str:
    text = re.sub(r"\b[0-9a-f]{64}\b", "...", text)
    return "\n".join(line.rstrip() for line in re.sub(r"-[0-9a-f]{12}\b", "-...", text).strip().splitlines())


def answer(call: str, capsys: pytest.CaptureFixture[str]) -> str:
    program, *arguments = shlex.split(call)
    if program == "rm":
        for name in arguments:
            Path(name).unlink()
        return ""
    assert program == "fsar-ledger"
    run(arguments)
    out, err = capsys.readouterr()
    text = (out + err).replace(", ".join(registered.scenarios()), ", ".join(registered.PAPER_SCENARIOS))
    return without_digests(text)  # the page does not change when a scenario is added


@pytest.mark.slow
def test_the_page_of_own_fleets_shows_what_happens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    calls = 0
    for kind, text in BLOCKS:
        if kind == "toml":
            name = re.match(r"# ([\w-]+\.toml): ", text)
            assert name is not None
            Path(name[1]).write_text(text + "\n")
            continue
        for shown in re.split(r"^\$ ", text, flags=re.MULTILINE)[1:]:
            call, _, expected = shown.partition("\n")
            assert answer(call, capsys) == expected.strip(), call
            calls += 1
    assert calls > 10
