"""Every command is measured, or it is said why not."""

from typing import Any

from typer.main import get_command

from benchmarks.every_command import COMMANDS, LEFT_OUT, from_examples
from fsar_ledger.api.verbs import VERBS
from fsar_ledger.cli.app import app


def test_every_command_is_measured_or_left_out_for_a_reason() -> None:
    group: Any = get_command(app)
    maintain = {f"maintain {name}" for name in group.commands["maintain"].commands}
    measured = {name if name in maintain else name.split()[0] for name in COMMANDS}
    assert not measured & LEFT_OUT.keys()
    commands = {name for name, one in group.commands.items() if not one.hidden} - {"maintain"}
    missing = (commands | maintain) - measured - LEFT_OUT.keys()
    assert not missing, f"{sorted(missing)}: list each in COMMANDS or LEFT_OUT of benchmarks/every_command.py"
    assert measured | LEFT_OUT.keys() == commands | maintain


def test_a_verb_that_is_not_listed_is_called_as_in_its_first_example() -> None:
    assert from_examples(VERBS.keys() - {"why"}) == {"why": "{ledger} 1:148"}
    assert from_examples(VERBS.keys() - {"export"}) == {"export": "{ledger} --out {out}.parquet"}
