"""A path is a path: ledgers and files whose names a glob, a shell or DuckDB would take for something else."""

import json
import shutil
import subprocess
from itertools import cycle
from pathlib import Path

import pytest

from fsar_ledger.base import printable
from fsar_ledger.ledger.store.append import Writer
from tests.cli.conftest import Call, Called
from tests.ledger.crash_trials import RUNS
from tests.ledger.samples import ORIGIN
from tests.quick import few

PLAIN = "plain-one"
PREDICTIONS = Path(__file__).parents[2] / "reports" / "predictions.json"
NAMES = (
    *("led*b", "led?b", "led[xy]b", "~/led", "led b", "led's", 'the "led"', "led\nfeed"),
    *("ledäm€", "-led", "$HOME/led", "file:led", "led%2a", "#led"),
)
ALL_IN_ONE = "-~*?[xy] 'led' \"m\"\n$ä"
MATCHED = ("ledxb", "led*xb", "led", "led feed", "ledxm€", "-~x1x 'led' \"m\"\n$ä")
"""Names that patterns among the others match, or nearly: a folder of each holds another ledger."""

ASKED = (
    ("verify",),
    ("info", "--json"),
    ("query", "run_metrics", "--verified", "--json"),
    ("sql", "SELECT run_id, count(*) AS n FROM events GROUP BY ALL ORDER BY ALL", "--csv"),
    ("query", "denials", "--csv"),
)
IN_TURN = tuple((verb,) for verb in ASKED)
"""What `make test-all` asks about each name, in turn; the soak asks all about each."""
ASKED_LESS = (
    ("metrics", "--json"),
    ("audit", "--architecture", "fsar", "--json"),
    ("explain", "--json"),
    ("log", "--json"),
    ("state", "--run", "1", "--at", "30s", "--json"),
    ("step", "--run", "1", "--script", "go 20s; state"),
    ("why", "1:20", "--json"),
    ("cause", "--run", "1", "--outcome", "SELECT run_id FROM executions", "--futures", "0", "--json"),
    ("diff", "1", "2", "--json"),
    ("compare", "--first", "fsar", "--second", "cfc", "--json"),
    ("study", "run", "multiverse", "--json"),
    ("statistics", "--json"),
    ("prove", "1:12"),
    ("whatif", "--run", "1", "--change", "drop window:*", "--json"),
    ("verify", "--replay"),
    ("bisect", "--first", "fsar", "--second", "cfc", "--outcome", "policy_violations > 0", "--json"),
    ("maintain", "compact", "--json"),
    ("maintain", "recover"),
)
WRITTEN = (
    (("export", "{ledger}", "--out", "{out}"), ".parquet"),
    (("export", "{ledger}", "--query", "runs", "--out", "{out}"), ".csv"),
    (("export", "{ledger}", "--query", "runs", "--out", "{out}"), ".ndjson"),
    (("export", "{ledger}", "--tiles", "--out", "{out}"), ".tiles"),
    (("export", "{ledger}", "--as", "ocel", "--out", "{out}"), ".json"),
    (("prove", "{ledger}", "3", "--out", "{out}"), ".tlog-proof"),
    (("view", "{ledger}", "--run", "1", "--out", "{out}"), ".html"),
    (("report", "{ledger}", "--out", "{out}"), ".pdf"),
    (("open", "{ledger}", "--out", "{out}"), ".duckdb"),
    (("explain", "{ledger}", "--run", "1", "--request", "A1-1/2.1", "--svg", "{out}"), ".svg"),
    (("study", "run", "comparison", "{predictions}", "--out", "{out}"), ".json"),
    (("key", "new", "{out}"), ".key"),
    (("simulate", "{out}", "--scenario", "door-relay", "--runs", "1", "--architecture", "fsar"), ".made"),
)
LONG = (".pdf", ".duckdb")
"""What takes seconds to write, and is written under one name, which has all odd letters of the others, but in the
soak."""
MADE = {
    ("maintain", "upgrade", "{old}", "--into", "{out}"): ".",
    ("whatif", "{ledger}", "--run", "1", "--change", "drop window:*", "--out", "{out}"): ".",
    ("maintain", "recover", "{damaged}", "--into", "{out}"): ".",
    ("reproduce", "--out", "{out}", "--only", "results", "--runs", "1"): "results",
    ("witness", "new", "{out}", "--name", "example.org/w1"): None,
}
"""Calls that make a folder, and where the ledger is in it, if there is one."""


def in_turn(verb: tuple[str, ...], ledger: str) -> tuple[str, ...]:
    """Return a call of the verb about the ledger, which comes after a name and before other arguments."""
    at = {"query": 2, "maintain": 2, "study": 3}.get(verb[0], 1)
    return (*verb[:at], path_of(ledger), *verb[at:])


def path_of(name: str) -> str:
    """Return how a user says this name, which is not to be an option."""
    return f"./{name}" if name.startswith("-") else name


def without(text: str, name: str) -> str:
    """Return the text with every form of this name in it alike."""
    for form in (printable.word(Path(name)), json.dumps(name)[1:-1], printable.escaped(name), printable.value(name)):
        text = text.replace(form, "(name)")
    return text


def as_read_by_a_shell(call: str) -> list[str]:
    """Return the words that a shell makes of the arguments of this call."""
    script = f"fsar-ledger() {{ printf '%s\\0' \"$@\"; }}; {call}"
    read = subprocess.run(["bash", "-c", script], capture_output=True, check=False)
    return read.stdout.decode().split("\0")[:-1]


@pytest.fixture(scope="module")
def crowded(ledger: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the same ledger under each name, and another under each that a pattern would match."""
    folder = tmp_path_factory.mktemp("crowded")
    for name in (PLAIN, *NAMES, ALL_IN_ONE):
        shutil.copytree(ledger, folder / name)
    for name in MATCHED:
        with Writer(folder / name, ORIGIN) as writer:
            writer.add(RUNS[:1])
    return folder


@pytest.fixture
def here(crowded: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The crowded folder as the working folder, and as the home folder."""
    monkeypatch.chdir(crowded)
    monkeypatch.setenv("HOME", str(crowded))


@pytest.fixture(scope="module")
def answers() -> dict[tuple[str, ...], Called]:
    """What each verb answers about the ledger of the plain name."""
    return {}


def asked(call: Call, verb: tuple[str, ...], name: str) -> Called:
    found = call(*in_turn(verb, name))
    return Called(found.code, without(found.out, name), without(found.err, name))


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("name", "verbs"),
    [
        (ALL_IN_ONE, ASKED),
        *(pytest.param(name, verbs, marks=pytest.mark.slow) for name, verbs in zip(NAMES, cycle(IN_TURN))),
        *(pytest.param(name, ASKED, marks=pytest.mark.soak) for name in NAMES),
    ],
)
def test_a_ledger_of_any_name_is_read_and_no_other(
    call: Call, answers: dict[tuple[str, ...], Called], name: str, verbs: tuple[tuple[str, ...], ...]
) -> None:
    for verb in verbs:
        if verb not in answers:
            answers[verb] = asked(call, verb, PLAIN)
        assert answers[verb].code == 0, answers[verb].err
        assert asked(call, verb, name) == answers[verb]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("names", few((1, 3), (), (1,)))
@pytest.mark.parametrize("verb", few(ASKED_LESS, (), ASKED_LESS[::3]), ids=" ".join)
def test_every_verb_reads_a_ledger_of_any_name(call: Call, verb: tuple[str, ...], names: int) -> None:
    expected = asked(call, verb, PLAIN)
    assert expected.out
    for name in (ALL_IN_ONE, "~/led", "led*b")[:names]:
        assert asked(call, verb, name) == expected


@pytest.mark.parametrize(
    ("verb", "suffix", "names"),
    [
        *(pytest.param(*one, 1 if one[1] in LONG else 3, marks=pytest.mark.slow) for one in WRITTEN),
        *(pytest.param(*one, 3, marks=pytest.mark.soak) for one in WRITTEN if one[1] in LONG),
    ],
)
def test_a_file_of_any_name_is_written_there_and_nowhere_else(
    call: Call,
    crowded: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    verb: tuple[str, ...],
    suffix: str,
    names: int,
) -> None:
    monkeypatch.setenv("HOME", str(crowded))
    monkeypatch.chdir(tmp_path)
    places = [f"{place}{suffix}" for place in (ALL_IN_ONE, "~/led", "led?b/in")[:names]]
    for place in places:
        called = call(
            *(one.format(ledger=crowded / PLAIN, predictions=PREDICTIONS, out=path_of(place)) for one in verb)
        )
        assert called.code == 0, called.err
    assert set(tmp_path.rglob(f"*{suffix}")) == {tmp_path / place for place in places}
    assert {path.name.removesuffix(".pub") for path in tmp_path.iterdir()} == {
        place.partition("/")[0] for place in places
    }


@pytest.mark.slow
def test_a_ledger_or_folder_of_any_name_is_made_there_and_nowhere_else(
    call: Call, crowded: Path, older: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(crowded))
    monkeypatch.chdir(tmp_path)
    damaged = tmp_path / f"{ALL_IN_ONE}.damaged"
    assert call("maintain", "upgrade", older, "--into", damaged).code == 0  # a segment for each commit
    last = sorted((damaged / "segments").iterdir())[-1]
    last.write_bytes(last.read_bytes()[:-1])
    words = {"old": older, "ledger": crowded / PLAIN, "damaged": path_of(damaged.name)}
    for number, (verb, ledger) in enumerate(MADE.items()):
        out = Path(ALL_IN_ONE, f"made-{number}")
        called = call(*(one.format(**words, out=path_of(str(out))) for one in verb))
        assert called.code == 0, called.err
        assert any((tmp_path / out).iterdir())
        assert ledger is None or call("verify", tmp_path / out / ledger).code == 0
    assert {path.name for path in tmp_path.iterdir()} == {ALL_IN_ONE, damaged.name}


@pytest.mark.slow
@pytest.mark.usefixtures("here")
def test_a_printed_command_can_be_pasted(call: Call) -> None:
    for name in (*NAMES, ALL_IN_ONE):
        said = call("explain", path_of(name), "--request", "nosuch").err
        (pasted,) = said.split("`")[1::2]
        assert as_read_by_a_shell(pasted) == ["query", "requests", path_of(name)]


@pytest.mark.usefixtures("here")
def test_the_warning_of_rows_not_compared_can_be_pasted(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    said = call("query", "runs", path_of(ALL_IN_ONE), "--csv").err
    (pasted,) = said.split("`")[1::2]
    assert as_read_by_a_shell(pasted) == ["verify", path_of(ALL_IN_ONE)]
