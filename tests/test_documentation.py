"""The documentation names what there is, and what it shows is what happens."""

import re
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from importlib.resources import files
from io import BytesIO, TextIOWrapper
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command

import fsar_ledger
from fsar_ledger.cli.app import app, run
from fsar_ledger.ledger.log.note import parse_note
from fsar_ledger.ledger.store.keys import read_verifier
from fsar_ledger.metrics.library import library
from fsar_ledger.studies.result import KINDS
from fsar_ledger.witness import Cosigner
from tests.cli.conftest import SMALL
from tests.ledger.keep_release import LEDGERS
from tests.sources.vda import honest_night, written

ROOT = Path(__file__).resolve().parent.parent
README = (ROOT / "README.md").read_text("utf-8")
README_BYTES_MAX = 10_240
DECISIONS = ROOT / "docs" / "decisions"
PAGES = {path.name: path.read_text("utf-8") for path in sorted((ROOT / "docs").glob("*.md"))}
LABEL = re.compile(r"\b(?:eq|sec|tab|fig|app):[a-z0-9_:-]*[a-z0-9]")
LABELS = set((ROOT / "tests" / "paper_labels.txt").read_text().split())


def listed(group: Any, *words: str) -> Iterator[tuple[str, Any]]:
    """Each command that help lists, with the words that call it."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from listed(command, *words, name)
        else:
            yield " ".join([*words, name]), command


COMMANDS: dict[str, Any] = dict(listed(get_command(app)))
STUDIES = {f"study run {name}" for name in KINDS} | {"study show"}
# The last two need each other (tests/witness/test_processes.py), and a comparison and what is shown need what another
# study writes (tests/studies).
LONG = {"reproduce", *STUDIES, "serve", "demo", "witness serve", "witness ask"}


def sources() -> Iterator[Path]:
    for folder, suffix in (("fsar_ledger", ".py"), ("queries", ".sql"), ("reports", ".toml"), ("docs", ".md")):
        yield from sorted((ROOT / folder).rglob(f"*{suffix}"))
    yield ROOT / "README.md"


def wrong_labels(text: str) -> list[str]:
    """Labels that the paper does not have, and `Paper:` texts that give none."""
    unknown = [label for label in LABEL.findall(text) if label not in LABELS]
    empty = [line.strip() for line in re.findall(r"Paper: [^\n]*", text) if not LABEL.search(line)]
    return unknown + empty


def wrong_readings(text: str, known: set[str]) -> list[str]:
    return [reading for reading in re.findall(r"Reading: (R\d+)", text) if reading not in known]


def readings() -> set[str]:
    text = files("fsar_ledger.reports").joinpath("readings.toml").read_text("utf-8")
    return {passage["id"] for passage in tomllib.loads(text)["passage"]}


def examples() -> Iterator[tuple[str, str]]:
    """Each example of each command's help."""
    for name, command in COMMANDS.items():
        for line in (command.epilog or "").splitlines():
            if line.startswith("  fsar-ledger "):
                yield name, line.strip()


def test_every_label_of_the_paper_exists() -> None:
    texts = {f"{path}": path.read_text("utf-8") for path in sources() if path.name != "library.py"}
    wrong = {name: found for name, text in texts.items() if (found := wrong_labels(text))}
    assert wrong == {}, "tests/paper_labels.txt has the labels"


def test_a_wrong_or_missing_label_is_found() -> None:
    assert wrong_labels('"""A claim. Paper: eq:auth, eq:authority."""') == ["eq:authority"]
    assert wrong_labels("-- Paper: chapter 3\n") == ["Paper: chapter 3"]


def test_every_reading_is_listed() -> None:
    listed = set(re.findall(r"^\| (R\d+) \|", PAGES["readings.md"], flags=re.MULTILINE))
    assert listed == readings()
    assert [wrong for path in sources() for wrong in wrong_readings(path.read_text("utf-8"), listed)] == []


def test_an_unknown_reading_is_found() -> None:
    assert wrong_readings("Reading: R1, Reading: R999", readings()) == ["R999"]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_is_documented_and_has_examples(name: str) -> None:
    assert f"`fsar-ledger {name}" in PAGES["commands.md"], "run `python docs/write.py commands.md`"
    assert [example for command, example in examples() if command == name], "give `verb` an example"


def test_every_query_is_documented() -> None:
    listed = set(re.findall(r"^\| `([^`]+)`", PAGES["queries.md"], flags=re.MULTILINE))
    assert listed == set(library().queries), "run `python docs/write.py queries.md`"


def dangling(page: Path) -> list[str]:
    """Return the files that the page names and the places that it links to which do not exist."""
    text = page.read_text("utf-8")
    names = re.findall(
        r"`((?:fsar_ledger|queries|reports|docs|benchmarks|tests)/[\w./-]*)(?!.*\(new\):$)", text, re.MULTILINE
    )
    names += [f"fsar_ledger/{name}" for name in re.findall(r"`((?:events|projections|runtime)/[\w/]+\.py)`", text)]
    found = [name for name in names if not (ROOT / name).exists()]
    for file, anchor in re.findall(r"\]\((?!https?:)([^)#]*)#?([^)]*)\)", text):
        target = page.parent / file if file else page
        if not target.exists() or (anchor and anchor not in anchors(target.read_text("utf-8"))):
            found.append(f"{file}#{anchor}" if anchor else file)
    return found


def anchors(text: str) -> set[str]:
    """Return the names by which the headings of a page are linked to."""
    headings = re.findall(r"^#+ (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_file_and_link_that_a_page_names_exists() -> None:
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    assert {page.relative_to(ROOT).as_posix(): found for page in pages if (found := dangling(page))} == {}


def test_a_link_or_file_that_does_not_exist_is_found(tmp_path: Path) -> None:
    (tmp_path / "page.md").write_text(
        "# One thing, twice\n[a](#one-thing-twice) [b](#two) [c](gone.md) `tests/gone.py`\n"
    )
    assert dangling(tmp_path / "page.md") == ["tests/gone.py", "#two", "gone.md"]


def test_every_page_is_in_the_index() -> None:
    linked = set(re.findall(r"\]\(([\w.-]+)\)", PAGES["README.md"]))
    pages = {path.name for path in (ROOT / "docs").iterdir() if path.suffix in (".md", ".json", ".ipynb")}
    assert pages - {"README.md"} == linked


def test_every_decision_is_in_its_index() -> None:
    linked = re.findall(r"^- \[[^]]+\]\(([\w.-]+)\)$", (DECISIONS / "README.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(linked) == sorted(path.name for path in DECISIONS.iterdir() if path.name != "README.md")


def unknown_decisions(text: str) -> list[str]:
    """Return the decision files that a source names and that do not exist."""
    return [name for name in re.findall(r"docs/decisions/([\w.-]*\w)", text) if not (DECISIONS / name).is_file()]


def test_every_decision_that_code_names_exists() -> None:
    found = {
        path.relative_to(ROOT).as_posix(): unknown_decisions(path.read_text("utf-8"))
        for folder in ("fsar_ledger", "queries", "reports", "benchmarks", "tests")
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in (".py", ".c", ".sql", ".toml", ".typ") and path != Path(__file__).resolve()
    }
    assert {name: unknown for name, unknown in found.items() if unknown} == {}


def test_a_decision_that_does_not_exist_is_found() -> None:
    text = "# See docs/decisions/draws-are-named.md.\n# See docs/decisions/draws-are-gone.md: why\n"
    assert unknown_decisions(text) == ["draws-are-gone.md"]


def test_the_readme_is_short_and_says_where_it_runs() -> None:
    assert len(README.encode()) <= README_BYTES_MAX
    assert "POSIX system: Linux or macOS" in README
    assert re.findall(r"^make .*?(?=  )", README, flags=re.MULTILINE) == ["make reproduce", "make test"]


def readme_blocks() -> list[str]:
    """Return the commands of each user's first five minutes, and those on replay, as they are printed."""
    return re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)


def test_every_command_of_the_readme_parses() -> None:
    activation, *blocks = readme_blocks()
    assert (activation, len(blocks)) == (". .venv/bin/activate\n", 5)
    for line in "".join(blocks).splitlines():
        assert parses(line), line


MODEL = {label for label in LABELS if label.startswith(("eq:", "sec:model:", "sec:architecture:", "app:"))} | {
    *(f"{kind}{number}" for kind in "IA" for number in range(1, 6)),
    "Agent Core",
    "Local ECM Manager",
    "Local Policy Engine",
    "Local Recovery Manager",
    "Federation Interface",
    "Local Human Supervision Interface",
    "Shared ECM Registry",
    "Coordination Engine",
    "Trust and Authority Manager",
    "Fleet Policy Resolver",
    "Recovery Orchestrator",
    "Audit and Traceability Service",
    "Human Oversight Console",
    "isolated mode",
}


def model_rows(text: str) -> list[tuple[set[str], list[str], list[str]]]:
    """Return what each row of the table of the model is about, where it lives, and what holds it."""
    table = text.partition("## The model, line by line")[2].partition("\n## ")[0]
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if line.startswith("| ")
    ][1:]
    named = re.compile(r"`([^`]+)`")
    return [
        ({paper.partition(":")[0].strip("* "), *named.findall(label)}, named.findall(code), named.findall(test))
        for paper, label, code, test in rows
    ]


def unfounded(rows: list[tuple[set[str], list[str], list[str]]]) -> list[str]:
    """Files that do not exist, code that does not name its equation, and rows that nothing holds."""
    found = []
    for about, code, tests in rows:
        missing = [name for name in (*code, *(test.partition("::")[0] for test in tests)) if not (ROOT / name).exists()]
        found += [f"{name} does not exist" for name in missing]
        texts = [(ROOT / name).read_text("utf-8") for name in code if (ROOT / name).is_file()]
        found += [
            f"no file of the row names {label}"
            for label in about
            if label.startswith("eq:") and not any(label in text for text in texts)
        ]
        if not code or not any(name.startswith("tests/") for name in tests):
            found.append(f"{sorted(about)}: no code or no test")
        for name, _, function in (test.partition("::") for test in tests):
            if function and (ROOT / name).exists() and f"def {function}(" not in (ROOT / name).read_text("utf-8"):
                found.append(f"{name} has no {function}")
    return found


def test_every_part_of_the_model_is_listed_with_its_code_and_its_test() -> None:
    rows = model_rows(PAGES["paper-to-code.md"])
    assert MODEL - set().union(*(about for about, _, _ in rows)) == set()
    assert unfounded(rows) == []


def test_a_row_of_the_model_without_code_or_with_a_wrong_name_is_found() -> None:
    head = "## The model, line by line\n\n| paper | label | lives in | held by |\n|---|---|---|---|\n"
    assert unfounded(
        model_rows(head + "| trust | `eq:trust` | `fsar_ledger/events/task.py` | `tests/nothing.py` |\n")
    ) == ["tests/nothing.py does not exist", "no file of the row names eq:trust"]
    assert unfounded(
        model_rows(head + "| I1: coherence | `sec:model:invariants` | | `tests/test_house.py::test_no` |\n")
    ) == ["['I1', 'sec:model:invariants']: no code or no test", "tests/test_house.py has no test_no"]


@pytest.mark.parametrize(("name", "example"), list(examples()))
def test_every_example_is_a_call_that_parses(name: str, example: str) -> None:
    assert parses(example) == name


def parses(line: str) -> str:
    """Return the name of the command that the line calls; its options and arguments are ones that it takes."""
    program, *arguments = shlex.split(line, comments=True)
    assert program == "fsar-ledger"
    command: Any = typer.main.get_command(app)
    words = []
    while isinstance(command, typer.core.TyperGroup):
        words.append(arguments.pop(0))
        command = command.commands[words[-1]]
    command.make_context(" ".join(words), arguments)
    return " ".join(words)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which out/ledger is a small ledger, cosigned, out/workflows one of the workflows, question.sql a
    SELECT, out/old one of format 1, and what was kept before."""
    path = tmp_path_factory.mktemp("examples")
    (path / "question.sql").write_text("SELECT count(*) AS events FROM events\n")
    (path / "night.jsonl").write_bytes(written(honest_night()))
    (path / "fleet.toml").write_text('[robots]\n"KIT.0001" = "agv"\n"KIT.0002" = "agv"\n')
    shutil.copytree(LEDGERS / "0.8.1" / "ledger", path / "out" / "old")
    key, ledger = str(path / "out" / "fleet.key"), path / "out" / "ledger"
    assert run(["key", "new", key]) == 0
    assert run(["simulate", str(ledger), *SMALL, "--key", key]) == 0
    assert run(["verify", str(ledger)]) == 0  # else each answer says that its rows were not compared with the root
    assert run(["prove", str(ledger), "1234", "--out", str(path / "out" / "event.tlog-proof")]) == 0
    shutil.copy(ledger / "checkpoint", path / "monday")
    note, cosigner = parse_note("note", (ledger / "checkpoint").read_text()), Cosigner("example.org/w1", bytes(32))
    (path / "out" / "cosigned").write_text(f"{note}{cosigner.cosign(note.checkpoint, 1_795_000_000).line()}")
    (path / "witnesses.policy").write_text(f"log {read_verifier(key + '.pub')}\nwitness w1 {cosigner.key}\nquorum w1\n")
    names = [part for name in ("door-relay", "layered-recovery", "human-supervision") for part in ("--workflow", name)]
    assert run(["simulate", str(path / "out" / "workflows"), *names]) == 0
    hall = path / "out" / "hall"
    fsar_ledger.federate(hall, run="morning").close()
    fsar_ledger.federate(path / "out" / "a1", run="A1", isolated="robot/A1", of=hall).close()
    return path


PRINTED = (
    'fsar-ledger cause out/ledger --run 2 --outcome "policy_violations > 0"',
    'fsar-ledger cause out/ledger --run 2 --outcome "SELECT run_id FROM conflicts" --futures 0 --json',
    "fsar-ledger open out/ledger --out out/ledger.duckdb",
    "fsar-ledger study run multiverse out/ledger",
    "fsar-ledger report out/ledger --out out/report.pdf",
    "fsar-ledger report out/ledger --with out/workflows --with out/untrusting --out out/report.pdf",
    "fsar-ledger metrics out/ledger --by scenario",
    "fsar-ledger metrics out/ledger --pool seeds",
    "fsar-ledger statistics out/ledger --csv",
    "fsar-ledger compare out/ledger --first fsar --second dhma --by scenario",
    "fsar-ledger compare out/ledger out/large --first fsar --verified --json",
    "fsar-ledger diff out/ledger 1 1 --other out/large --verified --json",
    "fsar-ledger explain out/ledger --run 1 --json",
    "fsar-ledger log out/ledger",
)
"""Examples left to the soak: a page prints what the same call answers (`docs/replay.md`, `open.md`, `model.md`), or the
call is made about a ledger of an odd name (`tests/cli/test_odd_names.py`), or with `--numbers`, or about other ledgers
(`tests/report`, `tests/cli`)."""

ELSEWHERE = (
    "fsar-ledger study run multiverse out/ledger --metric human_intervention --svg out/multiverse.svg",
    "fsar-ledger explain out/ledger --run 1 --request A1-1/2.1",
    "fsar-ledger log out/ledger --run all --about requests,policy --json",
    "fsar-ledger audit out/ledger --architecture fsar --invariant i4 --json",
    *(example for name, example in examples() if name == "report" and ("--with" in example or "--numbers" in example)),
    *(one for name in {name for name, _ in examples()} for one in [one for of, one in examples() if of == name][1:]),
)
"""Examples that `make test` leaves to `make test-all`: others that it runs, or `docs/model.md`, do most of what they
do."""


LINES = {
    "record": b'{"type": "Observed", "source": "site", "kind": "door"}\n',
    "federate": b'{"command": "ReportContext", "by": "robot/A1", "robot": "robot/A1"}\n',
}
"""What standard input holds for an example that reads it."""

MADE = {shlex.split(example)[2]: example for name, example in examples() if name == "simulate"}
"""The example that makes each ledger that other examples read."""


def test_what_is_left_to_other_tiers_is_an_example() -> None:
    assert {*PRINTED, *ELSEWHERE} <= {example for _, example in examples()}


def tier_of(example: str) -> list[pytest.MarkDecorator]:
    """Return the mark of an example, if it has one."""
    return [pytest.mark.soak] if example in PRINTED else [pytest.mark.slow] if example in ELSEWHERE else []


@pytest.mark.parametrize(
    "example",
    [
        pytest.param(example, marks=tier_of(example))
        for name, example in examples()
        if name not in LONG and example != "fsar-ledger simulate out/ledger"
    ],
)
def test_every_quick_example_runs(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], example: str
) -> None:
    monkeypatch.chdir(folder)
    words = shlex.split(example, comments=True)[1:]
    for word in words[1:] if words[0] != "simulate" else ():
        if MADE.get(word, example) != example and not Path(word).exists():  # another process runs what makes it
            assert run(shlex.split(MADE[word], comments=True)[1:]) == 0
    capsys.readouterr()
    monkeypatch.setattr(sys, "stdin", TextIOWrapper(BytesIO(LINES.get(words[0], b""))))
    assert run(words) == 0
    assert capsys.readouterr().err == ""
    for report in re.findall(r"--out (\S+\.pdf)", example):
        assert Path(report).read_bytes().startswith(b"%PDF-")
