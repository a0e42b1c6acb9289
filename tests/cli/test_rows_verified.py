"""Every answer from rows says whether they were compared with the root: `rows_verified` in JSON, a line on stderr where
they were not."""

import json
import shutil
from pathlib import Path

import pytest

from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from tests.ledger.damage import flips
from tests.ledger.forgery import changed, forge_segment, segment_at, table_of
from tests.metrics.conftest import record
from tests.quick import few

from .conftest import Call, one_message

WITH_JSON = ("metrics", "statistics", "compare", "audit", "info", "explain", "query runs", "sql")
ANSWERS = (*WITH_JSON, "export")


pytestmark = pytest.mark.usefixtures("empty_cache")


def grow(path: Path, *numbers: int) -> None:
    """The ledger has a commit more for each of these runs."""
    with Writer(path, "test") as writer:
        for number in numbers:
            writer.append(stage(path, [record("fsar", number)]))


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A ledger of three runs of three events."""
    path = tmp_path / "small"
    with Writer(path, "test") as writer:
        writer.append(stage(path, [record(architecture, 0) for architecture in ("fsar", "cfc", "dhma")]))
    return path


def words(verb: str, ledger: Path, *options: str) -> list[object]:
    """The call of this verb."""
    if verb == "compare":
        return [verb, ledger, "--first", "fsar", "--second", "cfc", *options]
    own = (
        ["SELECT count(*) AS events FROM events"]
        if verb == "sql"
        else ["--out", str(ledger.parent / "events.csv")]
        if verb == "export"
        else []
    )
    return [*verb.split(), ledger, *own, *options]


@pytest.mark.parametrize("verb", few(ANSWERS, ["info", "explain", "sql", "export"], ["query runs", "audit", "metrics"]))
def test_an_answer_says_whether_its_rows_were_compared_with_the_root(call: Call, small: Path, verb: str) -> None:
    options = ("--json",) if verb in WITH_JSON else ()
    before = call(*words(verb, small, *options))
    assert before.code in (0, 1)
    assert before.err == (
        f"fsar-ledger: the rows of {small} were not compared with its root; `fsar-ledger verify {small}` "
        "compares them, as does --verified\n"
    )
    after = call(*words(verb, small, *options, "--verified"))
    assert (after.code, after.err) == (before.code, "")
    if options:
        assert [json.loads(answer.out).pop("rows_verified") for answer in (before, after)] == [False, True]
        assert before.out.replace('"rows_verified": false', '"rows_verified": true') == after.out
    else:
        assert before.out == after.out


@pytest.mark.parametrize("verb", [*ANSWERS, "prove"])
def test_rows_that_are_not_those_under_the_root_are_refused_where_that_is_demanded(
    call: Call, small: Path, verb: str
) -> None:
    forge_segment(small, 0, changed(table_of(small, 0), "time_us", 1, 4))
    own = ("7",) if verb == "prove" else ()
    one_message(
        call(*words(verb, small, *own, "--verified")),
        3,
        f"{small}: segments/000000000000-000000000009.parquet: commit 0, field tree_root: found Merkle root",
    )
    assert not (small.parent / "events.csv").exists()


def test_a_report_is_not_made_from_rows_that_are_not_those_under_the_root(
    call: Call, small: Path, tmp_path: Path
) -> None:
    forge_segment(small, 0, changed(table_of(small, 0), "time_us", 1, 4))
    one_message(
        call("report", small, "--out", tmp_path / "report.pdf"), 3, "found Merkle root", "run fsar-ledger verify"
    )
    assert not (tmp_path / "report.pdf").exists()


def test_a_report_whose_workflows_are_not_those_under_their_root_is_not_made(
    call: Call, small: Path, tmp_path: Path
) -> None:
    workflows = Path(shutil.copytree(small, tmp_path / "workflows"))
    forge_segment(workflows, 0, changed(table_of(workflows, 0), "time_us", 1, 4))
    one_message(
        call("report", small, "--workflows", workflows, "--out", tmp_path / "report.pdf"), 3, f"{workflows}: segments/"
    )


def test_verify_is_what_is_remembered_and_a_quick_look_is_not(call: Call, small: Path) -> None:
    assert call("verify", small, "--quick").code == 0
    assert json.loads(call("metrics", small, "--json").out)["rows_verified"] is False
    assert call("verify", small).code == 0
    assert json.loads(call("metrics", small, "--json").out)["rows_verified"] is True


def test_info_says_beside_the_root_that_the_rows_were_not_compared_with_it(call: Call, small: Path) -> None:
    root = next(line for line in call("info", small).out.splitlines() if line.startswith("root "))
    assert root.endswith(" (the rows were not compared with it)")
    call("verify", small)
    assert f"\n{root.removesuffix(' (the rows were not compared with it)')}\n" in call("info", small).out


def test_a_proof_needs_no_look_at_all_rows(call: Call, small: Path) -> None:
    proof = call("prove", small, "7")
    assert (proof.code, proof.err) == (0, "")
    assert call("prove", small, "7", "--verified") == proof


def test_a_proof_is_of_the_event_that_was_asked_for_or_is_not_made(call: Call, small: Path) -> None:
    forge_segment(
        small, 0, changed(table_of(small, 0), "run_id", 2, "run-0-cfc")
    )  # so that this run seems to begin with an event that it has later, too
    for event in ("run-0-cfc:1", "run-0-cfc:2"):
        one_message(call("prove", small, event), 3, "the chain contradicts the rows")


def test_rows_that_no_events_give_are_damage_and_no_traceback(call: Call, small: Path) -> None:
    forge_segment(small, 0, changed(table_of(small, 0), "kind", 0, None))
    one_message(call("metrics", small), 3, "found a row that no events can give", "run fsar-ledger verify")


@pytest.mark.parametrize("is_verified", [False, True])
def test_a_flipped_bit_is_refused_by_every_answer(call: Call, small: Path, is_verified: bool) -> None:
    if is_verified:  # what was right once excuses nothing
        assert call("verify", small).code == 0
    segment = segment_at(small, 0)
    segment.write_bytes(next(flips(segment.read_bytes(), 5000)))
    for verb in ANSWERS:
        one_message(call(*words(verb, small)), 3, str(segment), "found SHA-256", "expected", "restore the file")
    one_message(call("prove", small, "7"), 3, str(segment), "found SHA-256")


def test_a_ledger_whose_newest_commit_was_taken_away_answers_nothing(call: Call, small: Path) -> None:
    grow(small, 1, 2)
    lines = (small / "chain.jsonl").read_bytes().splitlines(keepends=True)
    (small / "chain.jsonl").write_bytes(b"".join(lines[:4]))
    for verb in ANSWERS:
        one_message(call(*words(verb, small)), 3, f"{small}/checkpoint", "commits were removed")


def test_a_checkpoint_one_commit_behind_is_no_damage(call: Call, small: Path) -> None:
    before = (small / "checkpoint").read_bytes()
    grow(small, 1)
    (small / "checkpoint").write_bytes(before)
    assert call("info", small).code == 0
