"""Each verb is declared once: Python and the command line have its function, its parameters and its texts."""

import csv
import inspect
import io
import json
from importlib import import_module
from itertools import chain
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import pytest
from typer.main import get_command

import fsar_ledger
from benchmarks.every_command import example_of
from fsar_ledger import api
from fsar_ledger.api.verbs import VERBS, Option, declared, verb
from fsar_ledger.cli.app import GROUPS, _summary, app
from tests.cli.conftest import Call, one_message
from tests.quick import few

for module in iter_modules(api.__path__):
    import_module(f"{api.__name__}.{module.name}")
import_module("fsar_ledger.studies.verbs")
STUDIES = {name for name in VERBS if name.startswith("study ")} - {"study run multiverse"}
WITHOUT_FUNCTION = {"query", "serve", "demo", "witness serve", "record", "federate", "import", *STUDIES}
"""In Python a query is `Ledger.query`, whose parameters are those of the query; studies are `calibrate` and so on; a
recorder and a federation are context managers, and `import` a keyword."""
FORMS = {"json": "--json", "csv": "--csv", "ndjson": "--ndjson"}
ROWS = {"query failures": ()} | {
    name: tuple(word for word in example_of(verb) if word != "out/ledger")
    for name, verb in VERBS.items()
    if "ndjson" in verb.takes and name != "query"
}
"""The verbs whose answers are rows, and what a call of each needs, as in its first example."""


def command_of(name: str) -> Any:
    command: Any = get_command(app)
    for word in name.split():
        command = command.commands[word]
    return command


def test_every_verb_is_in_a_group_of_the_help() -> None:
    missing = {name.partition(" ")[0] for name in VERBS} - set(chain.from_iterable(GROUPS.values()))
    assert not missing, f"{', '.join(sorted(missing))}: name each in GROUPS of fsar_ledger/cli/app.py"


def test_a_verb_without_a_docstring_is_refused() -> None:
    def silent(ledger: Any) -> None:
        raise AssertionError(ledger)

    with pytest.raises(TypeError, match=r"test_verbs\.silent: found no docstring, expected one, whose first line is"):
        verb("silent out/ledger")(silent)


@pytest.mark.parametrize("name", sorted(VERBS.keys() - WITHOUT_FUNCTION))
def test_a_verb_is_the_same_function_in_python(name: str) -> None:
    attribute = name.removeprefix("maintain ").removeprefix("study run ").replace(" ", "_").replace("-", "_")
    home = fsar_ledger.Ledger if "ledger" in VERBS[name].parameters else fsar_ledger
    assert getattr(home, attribute) is VERBS[name].function


@pytest.mark.parametrize("name", sorted(VERBS))
def test_a_verb_has_one_text_and_one_declaration_of_each_parameter(name: str) -> None:
    verb, command = VERBS[name], command_of(name)
    documented = inspect.getdoc(verb.function) or ""
    assert documented.startswith(verb.help)
    assert command.help == verb.help
    own = {parameter: found for parameter, one in verb.parameters.items() if isinstance(found := declared(one), Option)}
    for parameter, found in own.items():
        if parameter in inspect.signature(verb.function).parameters:
            assert f"    {parameter}: {found.help}" in documented
    beside = set(verb.takes) | set(verb.beside)
    ledger = {"ledger"} & verb.parameters.keys()
    memory = {"memory"} if ledger and not any(found.flag == "--memory" for found in own.values()) else set()
    assert {one.name for one in command.params} - {"help"} == set(own) | beside | ledger | memory


def _documented_on_one_line() -> None:
    """Do this. Raises: as that."""


def test_the_help_of_a_command_ends_where_the_docstring_says_what_is_raised() -> None:
    assert VERBS["info"]._replace(function=_documented_on_one_line).help == "Do this."


@pytest.mark.parametrize("name", sorted(get_command(app).commands))  # type: ignore[attr-defined]
def test_the_help_of_all_commands_has_the_first_line_of_each(name: str) -> None:
    assert command_of(name).help.partition("\n")[0] == _summary(name)


@pytest.mark.parametrize("name", few(ROWS, ["query failures"]))
def test_rows_are_the_same_in_every_form(call: Call, ledger: Path, name: str) -> None:
    words = (*name.split(), ledger, *ROWS[name])
    whole, lines, table = (call(*words, FORMS[form]) for form in ("json", "ndjson", "csv"))
    assert {one.code for one in (whole, lines, table)} == {0}
    rows = [json.loads(line) for line in lines.out.splitlines()]
    shown = list(csv.DictReader(io.StringIO(table.out)))
    assert rows, f"{name} {' '.join(ROWS[name])}: found no row, expected a first example that finds one in this ledger"
    assert [{column: row.get(column) for column in rows[0]} for row in json.loads(whole.out)["rows"]] == rows
    assert [{column: value or None for column, value in row.items()} for row in shown] == [
        {column: None if value is None else _field(value) for column, value in row.items()} for row in rows
    ]


def _field(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))


@pytest.mark.parametrize("name", ROWS)
def test_two_forms_at_once_or_raw_text_without_csv_are_refused(call: Call, ledger: Path, name: str) -> None:
    words = (*name.split(), ledger, *ROWS[name])
    one_message(call(*words, "--json", "--csv"), 2, "found --json and --csv, expected one of them")
    one_message(call(*words, "--ndjson", "--csv"), 2, "--ndjson, expected one of them")
    one_message(call(*words, "--raw"), 2, "found --raw without --csv")
