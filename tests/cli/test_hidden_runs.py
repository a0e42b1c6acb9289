"""A chain made anew hides, renames or moves runs in its index, under a root that was signed: no verb passes that on.

Whatever is asked, the answer is that of the honest ledger, or exit code 3; never that there is no such run. Where the
rows were not compared with the root, what is said of a run that is not there says so.
"""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.runs import LedgerRun, piece
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.derived import line_doubt
from fsar_ledger.ledger.store.paths import INDEX, NODES
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.ledger.agreement_chain import records_of, relink, view_of
from tests.ledger.damage import SIGNER
from tests.ledger.samples import ORIGIN

from .conftest import Call, one_message

Line = dict[str, Any]
NOT_COMPARED = "were not compared with the root"


pytestmark = pytest.mark.usefixtures("empty_cache")


@pytest.fixture(scope="module")
def runs() -> list[LedgerRun]:
    """Four simulated runs."""
    kinds = ("fsar", "cfc", "dhma", "fsar")
    return [simulate_run(RunSpec(1, kind, "full", "door-relay", 4, at), Constants()) for at, kind in enumerate(kinds)]


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory, runs: list[LedgerRun]) -> Path:
    """A signed ledger of two segments, each with two runs, and a third with what is left of the first one."""
    path = tmp_path_factory.mktemp("hidden") / "ledger"
    first, *others = runs
    cut = len(first.events) - 20
    with Writer(path, ORIGIN, SIGNER) as writer:
        writer.append(stage(path, [piece(first, 0, cut), others[0]]))
        writer.append(stage(path, others[1:]))
        writer.append(stage(path, [piece(first, cut, cut + 20)]))
    return path


def doctor(path: Path, change: Callable[[list[Line]], None]) -> None:
    """Change the lines of the index, and chain the ledger anew so that all of it fits."""
    lines: list[Line] = [msgspec.json.decode(line) for line in (path / INDEX).read_bytes().splitlines()]
    change(lines)
    written = [canonical.document(line) + b"\n" for line in lines]
    (path / INDEX).write_bytes(b"".join(written))
    records, frames = records_of(path)
    for record, line in zip((one for one in records if one["kind"] == "placement"), written, strict=True):
        record |= {"index_bytes": len(line), "index_sha256": sha256_hex(line)}
    relink(path, records, frames)
    assert all(line_doubt(*one) is None for one in zip(view_of(path).chain.added, written, strict=True))


def hide_a_run(lines: list[Line]) -> None:
    del lines[1]["blocks"][1]


def hide_the_first_run(lines: list[Line]) -> None:
    del lines[0]["blocks"][0]
    lines[2]["blocks"] = []


def hide_the_end_of_a_run(lines: list[Line]) -> None:
    lines[2]["blocks"] = []


def give_the_end_of_a_run_to_another(lines: list[Line]) -> None:
    lines[2]["blocks"][0]["run"] = lines[1]["blocks"][1]["run"]


def shorten_a_run(lines: list[Line]) -> None:
    lines[1]["blocks"][0]["rows"] -= 9


def rename_a_run(lines: list[Line]) -> None:
    lines[0]["blocks"][1]["run"] = "another"


def make_a_run_a_plan(lines: list[Line]) -> None:
    lines[0]["blocks"][0]["is_alone"] = True


def exchange_two_runs_of_a_segment(lines: list[Line]) -> None:
    lines[1]["blocks"].reverse()


def exchange_two_lines(lines: list[Line]) -> None:
    lines[0]["blocks"], lines[1]["blocks"] = lines[1]["blocks"], lines[0]["blocks"]


CHANGES = (
    *(hide_a_run, hide_the_first_run, hide_the_end_of_a_run, give_the_end_of_a_run_to_another),
    *(shorten_a_run, rename_a_run, make_a_run_a_plan),
    *(exchange_two_runs_of_a_segment, exchange_two_lines),
)
QUESTIONS: dict[str, Callable[[Path, str | int], tuple[object, ...]]] = {
    "log": lambda ledger, run: ("log", ledger, "--run", run),
    "explain": lambda ledger, run: ("explain", ledger, "--run", run),
    "prove": lambda ledger, run: ("prove", ledger, f"{run}:50"),
    "state": lambda ledger, run: ("state", ledger, "--run", run),
    "why": lambda ledger, run: ("why", ledger, f"{run}:9"),
}


@pytest.mark.parametrize(
    ("verb", "step"),
    [
        ("prove", 1),
        *(pytest.param(verb, 3, marks=pytest.mark.slow) for verb in QUESTIONS if verb != "prove"),
        *(pytest.param(verb, 1, marks=pytest.mark.soak) for verb in QUESTIONS if verb != "prove"),
    ],
)
def test_no_verb_passes_on_what_a_chain_made_anew_says_of_runs(
    call: Call, honest: Path, runs: list[LedgerRun], tmp_path: Path, verb: str, step: int
) -> None:
    told: dict[str | int, str] = {}
    every: list[str | int] = [*(run.run_id for run in runs), 1, 2, 3, 4]
    asked = every[::step]
    shutil.copytree(honest, tmp_path / "ledger")
    for run in asked:
        answer = call(*QUESTIONS[verb](tmp_path / "ledger", run))
        assert answer.code == 0, answer.err
        told[run] = answer.out
    refused = 0
    for change in CHANGES:
        shutil.rmtree(tmp_path / "ledger")
        shutil.copytree(honest, tmp_path / "ledger")
        doctor(tmp_path / "ledger", change)
        quick = call("verify", tmp_path / "ledger", "--quick", "--trusted-key", SIGNER.verifier)
        assert quick.code == 0, quick.err
        for run in asked:
            answer = call(*QUESTIONS[verb](tmp_path / "ledger", run))
            assert answer.code == 3 or (answer.code, answer.out) == (0, told[run]), (change.__name__, run, answer)
            refused += answer.code == 3
    assert refused == len(CHANGES) * len(asked)


def test_a_run_that_is_not_there_is_said_with_what_was_not_compared(call: Call, honest: Path, tmp_path: Path) -> None:
    ledger = tmp_path / "ledger"
    shutil.copytree(honest, ledger)
    for run in ("another", 5):
        for words in QUESTIONS.values():
            one_message(call(*words(ledger, run)), 2, "there is no", NOT_COMPARED)
        one_message(call("query", "requests", ledger, "--param", f"run={run}"), 2, "there is no", NOT_COMPARED)
    one_message(call("prove", ledger, "1:99999"), 2, "expected a seq from 0 to", NOT_COMPARED)
    one_message(call("explain", ledger, "--run", 1, "--request", "x"), 2, "there is no such request", NOT_COMPARED)
    assert call("verify", ledger).code == 0
    for verb, words in QUESTIONS.items():
        called = call(*words(ledger, "another"))
        assert (called.code, NOT_COMPARED in called.err) == (2, False), verb


def test_the_index_is_compared_once_for_what_was_placed(
    call: Call, honest: Path, runs: list[LedgerRun], tmp_path: Path
) -> None:
    ledger = tmp_path / "ledger"
    shutil.copytree(honest, ledger)
    assert call("log", ledger, "--run", 1).code == 0
    more = msgspec.structs.replace(runs[1], run_id="more")
    with Writer(ledger, ORIGIN, SIGNER) as writer:
        writer.append(stage(ledger, [more]))
    doctor(ledger, lambda lines: lines[3]["blocks"].clear())
    assert call("log", ledger, "--run", "more").code == 3


def test_a_quick_look_names_what_it_did_not_look_at(call: Call, honest: Path) -> None:
    quick = call("verify", honest, "--quick")
    said = next(line for line in quick.out.splitlines() if line.startswith("not looked at: "))
    names = json.loads(call("verify", honest, "--quick", "--json").out)["not_looked_at"]
    assert {INDEX, NODES, "rows of segments"} < set(names)
    assert said == f"not looked at: {', '.join(names)}"
    assert json.loads(call("verify", honest, "--json").out)["not_looked_at"] == []
    assert "not looked at" not in call("verify", honest).out
