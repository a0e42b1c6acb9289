"""`state`, `diff`, `whatif`, `cause` and `bisect` as people call them."""

import json
import re
import shutil
from pathlib import Path

import pytest

from fsar_ledger.ledger.v1 import upgrade
from tests.cli.conftest import Call, one_message
from tests.ledger.keep_release import LEDGERS

ROOT = Path(__file__).resolve().parents[2]
VIOLATED = "policy_violations > 0"
OF_NO_RUN = "SELECT DISTINCT 42 AS run_id FROM events"


def test_a_moment_shows_each_robot_and_what_is_open(call: Call, ledger: Path) -> None:
    answer = call("state", ledger, "--run", "1", "--at", "40s").good()
    for robot in ("robot/A1", "robot/B1", "robot/C1", "robot/D1"):
        assert f"\n{robot}  role " in answer.out
    assert "\nat 40.000 s of " in answer.out
    assert "recorded with commit 2" in answer.out
    assert max(map(len, answer.out.splitlines())) <= 120
    told = json.loads(call("state", ledger, "--run", "1", "--at", "40s", "--robot", "B1", "--json").out)
    assert [one["robot"] for one in told["standing"]["robots"]] == ["robot/B1"]
    assert told["head"]["size"]


@pytest.mark.parametrize(
    ("number", "decider", "what"),
    [
        ("2", "coordinator", "robot/B1, own policy: allow ("),
        ("1", "robot/B1", "robot/B1, own policy: "),
        ("1", "service/registry", "robot/B1, availability: "),
        ("3", "agent/B1/planning", "robot/B1, own policy: "),
    ],
)
def test_what_a_decider_had_been_told_has_an_age(
    call: Call, ledger: Path, number: str, decider: str, what: str
) -> None:
    answer = call("state", ledger, "--run", number, "--at", "40s", "--as-known-by", decider).good()
    assert what in answer.out.partition("what it had been told")[2]


@pytest.mark.slow
def test_the_same_run_has_no_differences_and_two_have_a_story(call: Call, ledger: Path) -> None:
    same = call("diff", ledger, "1", "1").good()
    assert "the same " in same.out
    other = call("diff", ledger, "1", "2", "--all").good()
    assert "architecture: fsar and cfc" in other.out
    assert "they diverge at " in other.out
    assert "because " in other.out
    told = json.loads(call("diff", ledger, "1", "2", "--json").out)
    assert len(told["differences"]) == sum(told["counts"].values())
    assert told["parting"]["first"]
    for words in (("1", "99"), ("none", "1")):
        assert call("diff", ledger, *words).code == 2
    assert call("diff", ledger, "1", "1", "--other", str(ledger / "none")).code == 2


@pytest.mark.slow
def test_a_fork_is_told_kept_and_replays(call: Call, ledger: Path, tmp_path: Path) -> None:
    place = tmp_path / "forks"
    answer = call("whatif", ledger, "--run", "1", "--change", "drop window:*", "--out", place).good()
    assert "they diverge at " in answer.out
    assert "kept in " in answer.out
    assert call("verify", place, "--replay").code == 0
    size = (place / "checkpoint").read_bytes()
    call("whatif", ledger, "--run", "1", "--change", "drop window:*", "--out", place).good()
    assert (place / "checkpoint").read_bytes() == size
    assert call("prove", place, "2:0").code == 0
    told = json.loads(call("compare", place, "--first", "fsar+fork", "--second", "fsar@A/4", "--json").out)
    assert told["pairs"] == 1
    info = call("info", place).out
    assert "2 runs; no plan is on record" in info
    assert "1 fork among them; the query `forks` shows of which runs" in info
    assert "drop window:*" in info
    groups = json.loads(call("info", place, "--json").out)["groups"]
    assert {(group["changes"], group["runs_to_rectangle"]) for group in groups} == {("drop window:*", None), (None, 0)}


@pytest.mark.slow
def test_a_task_that_ends_alike_and_is_due_at_another_time_is_shown_with_both(call: Call, ledger: Path) -> None:
    answer = call("whatif", ledger, "--run", "1", "--change", "set world.budget_base_s=1").good()
    columns, _, *rows = answer.out.partition("\ntask ")[2].splitlines()
    assert columns.split() == ["base_due_s", "base", "base_s", "fork_due_s", "fork", "fork_s"]
    for name, due_s, base, base_s, fork_due_s, fork, fork_s in (row.split() for row in rows[:2]):
        assert float(due_s) - float(fork_due_s) == pytest.approx(21.2), name
        assert (base, base_s) == (fork, fork_s)
    gone = call("whatif", ledger, "--run", "1", "--change", "drop task:A1-1").good().out.partition("\ntask ")[2]
    assert gone.split()[:5] == ["due_s", "base", "base_s", "fork", "fork_s"]


def test_where_the_same_event_holds_something_else_its_fields_are_told(call: Call, ledger: Path) -> None:
    words = ("whatif", ledger, "--run", "1", "--change")
    out = call(*words, "answer execution:A1-1/1.1 9s").out
    assert re.search(r"^the same event with another ends: base [0-9.]+ s, fork [0-9.]+ s$", out, re.MULTILINE)
    assert "the same event with another" not in call(*words, "drop window:*").out


@pytest.mark.slow
def test_all_runs_of_an_architecture_are_compared_with_their_forks(call: Call, ledger: Path) -> None:
    words = ("whatif", ledger, "--all-runs", "--architecture", "fsar", "--change", "drop window:*")
    answer = call(*words).good()
    assert "fsar: 4 pairs, 4 of them diverge" in answer.out
    told = json.loads(call(*words, "--json").out)
    assert len(told["forks"]) == 4
    assert [one["architecture"] for one in told["effects"]] == ["fsar"]


def test_what_a_change_can_name_is_listed(call: Call, ledger: Path) -> None:
    told = json.loads(call("whatif", ledger, "--run", "1", "--list", "--json").out)
    names = {one["name"].partition(":")[0] for one in told["changeable"]}
    assert {"window", "task", "message", "execution"} <= names


@pytest.mark.parametrize(
    ("release", "run", "found"),
    [
        ("0.1.0", "1", "kind: found a live run, whose commands are not stored, expected a simulated run"),
        ("0.6.0", "1", "kind: found a foreign run, whose commands are not stored, expected a simulated run"),
        ("0.1.0", "2", "model_version: found '1', expected '3'; replay it with fsar-ledger 0.2.0"),
    ],
)
def test_a_run_that_cannot_be_made_again_is_not_forked_and_nothing_is_written(
    call: Call, tmp_path: Path, release: str, run: str, found: str
) -> None:
    kept = tmp_path / "kept"
    upgrade(LEDGERS / release / "ledger", kept)
    words = ("--change", "drop window:*", "--out", tmp_path / "forks")
    one_message(call("whatif", kept, "--run", run, *words), 2, found, "only such a run can be replayed with a change")
    one_message(call("cause", kept, "--run", run, "--outcome", "policy_violations > 0"), 2, found)
    assert list(tmp_path.iterdir()) == [kept]


def test_forks_are_not_stored_in_the_ledger_of_their_bases(call: Call, ledger: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(ledger, tmp_path / "copy"))
    before = (copy / "checkpoint").read_bytes()
    for place in (copy, copy / "segments" / "forks"):
        one_message(call("whatif", copy, "--run", "1", "--change", "drop window:*", "--out", place), 2)
    assert (copy / "checkpoint").read_bytes() == before


@pytest.mark.slow
def test_a_cause_is_told_with_the_call_that_takes_it_away(call: Call, ledger: Path) -> None:
    answer = call("cause", ledger, "--run", "2", "--outcome", VIOLATED, "--futures", "3").good()
    assert "suffice together" in answer.out
    assert "futures that avoid the outcome, of 3" in answer.out
    assert "whatif " in answer.out
    told = json.loads(call("cause", ledger, "--run", "2", "--outcome", VIOLATED, "--futures", "0", "--json").out)
    assert told["elements"]
    assert told["chances"] == []


@pytest.mark.slow
def test_where_nothing_is_a_cause_the_point_of_no_return_comes_first(call: Call, ledger: Path) -> None:
    always = "coordination_success >= 0"
    answer = call("cause", ledger, "--run", "1", "--outcome", always, "--futures", "2").good()
    _, outcome, first, left, *rest = answer.out.splitlines()
    assert (outcome, first) == (f"outcome: {always}", "no future avoids it, even from the beginning")
    assert "is a cause" in left
    assert any("receives task" in line for line in rest)
    told = json.loads(call("cause", ledger, "--run", "1", "--outcome", always, "--futures", "0", "--json").out)
    assert (told["elements"], len(told["presupposed"]), told["also_necessary"]) == ([], 1, [])


@pytest.mark.slow
def test_a_pair_without_a_value_does_not_disagree(call: Call, ledger: Path) -> None:
    changed = ("--change", "drop task:*", "--architecture", "fsar")
    answer = call("bisect", ledger, *changed, "--outcome", "coordination_success > 0").good()
    assert "\n0 pairs: " in answer.out
    assert "no pair disagrees" in answer.out
    told = json.loads(call("bisect", ledger, *changed, "--outcome", "coordination_success > 0", "--json").out)
    assert (told["pairs"], told["undefined"], told["first_only"]) == (0, 4, 0)
    always = "reassignment_latency_s >= 0"
    sides = json.loads(call("bisect", ledger, "--first", "fsar", "--second", "dhma", "--outcome", always, "--json").out)
    assert sides["pairs"] + sides["undefined"] == 4
    assert 0 < sides["undefined"] < 4
    assert (sides["pairs"], sides["diff"]) == (sides["both"], None)


@pytest.mark.slow
def test_the_first_pair_that_disagrees_is_told(call: Call, ledger: Path) -> None:
    answer = call(
        "bisect", ledger, "--first", "fsar", "--second", "dhma", "--outcome", "authority_conflicts > 3"
    ).good()
    assert "4 pairs: " in answer.out
    assert "the first pair that disagrees: " in answer.out
    agree = call("bisect", ledger, "--first", "fsar", "--second", "dhma", "--outcome", "authority_conflicts >= 0")
    assert "no pair disagrees" in agree.out
    changed = call(
        "bisect", ledger, "--change", "drop window:*", "--architecture", "fsar", "--outcome", VIOLATED
    ).good()
    assert "as recorded" in changed.out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("state", "--run", "99"), "there is no run of this number"),
        (("state", "--run", "1", "--at", "9000s"), "expected at most"),
        (("state", "--run", "1", "--at", "soon"), "expected seconds"),
        (("state", "--run", "1", "--robot", "Z9"), "there is no such robot"),
        (("state", "--run", "1", "--as-known-by", "cordinator"), "did you mean coordinator"),
        (("state", "--run", "1", "--as-known-by", "supervisor/fleet"), "keeps no copies"),
        (("state", "--run", "1", "--by-commit", "1"), "came with commit 2"),
        (("state", "--run", "1", "--by-commit", "99"), "expected 0 to"),
        (("whatif",), "found neither --run nor --all-runs"),
        (("whatif", "--run", "1", "--all-runs", "--change", "drop window:*"), "expected one of them"),
        (("whatif", "--run", "1"), "found no change"),
        (("whatif", "--list"), "expected --run"),
        (("whatif", "--run", "1", "--change", "jump"), "expected one of drop"),
        (("whatif", "--run", "99", "--change", "drop window:*"), "there is no run of this number"),
        (("whatif", "--all-runs", "--architecture", "fsr", "--change", "drop window:*"), "did you mean fsar"),
        (("whatif", "--all-runs", "--change", "rule fleet deny"), "decides no such command"),
        (("whatif", "--all-runs", "--change", "drop window:none/*"), "the run has no fact"),
        (("whatif", "--run", "1", "--changes", "none.toml"), "No such file"),
        (("whatif", "--run", "1", "--changes", "none.txt"), "expected a .toml file"),
        (
            ("whatif", "--run", "1", "--architecture", "fsar", "--change", "drop window:*"),
            "expected --architecture with",
        ),
        (("cause", "--run", "1", "--outcome", "policy_violatons > 0"), "did you mean policy_violations"),
        (("cause", "--run", "1", "--outcome", "policy_violations > 99"), "the run does not have it"),
        (("cause", "--run", "1", "--outcome", VIOLATED, "--futures", "-1"), "expected 0"),
        (("cause", "--run", "1", "--outcome", "SELECT 1 AS one"), "expected run_id"),
        (("cause", "--run", "1", "--outcome", OF_NO_RUN), "found the run_id 42, which no run has"),
        (
            ("bisect", "--first", "fsar", "--second", "cfc", "--outcome", OF_NO_RUN),
            "found the run_id 42, which no run has",
        ),
        (("bisect", "--first", "fsar", "--second", "dhma"), "--outcome: found none"),
        (("bisect", "--first", "fsr", "--second", "dhma", "--outcome", VIOLATED), "found no such runs"),
        (
            ("bisect", "--first", "fsar", "--change", "drop window:*", "--outcome", VIOLATED),
            "expected one or the other",
        ),
        (("bisect", "--architecture", "fsar", "--outcome", VIOLATED), "found an architecture without changes"),
        (("bisect", "--change", "drop window:none/*", "--outcome", VIOLATED), "the run has no fact"),
        (("diff", "1", "plan."), "found the plan of an experiment, expected a run"),
        (("diff", "plan.", "plan."), "found the plan of an experiment, expected a run"),
    ],
)
def test_a_call_that_makes_no_sense_is_an_error_and_writes_nothing(
    call: Call, ledger: Path, tmp_path: Path, words: tuple[str, ...], message: str
) -> None:
    out = ("--out", tmp_path / "forks") if words[0] == "whatif" else ()
    one_message(call(words[0], ledger, *words[1:], *out), 2, message)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_what_is_said_of_a_fork_stays_when_forks_of_other_constants_come(
    call: Call, ledger: Path, tmp_path: Path
) -> None:
    other, place = tmp_path / "other", tmp_path / "forks"
    made = ("--architecture", "fsar", "--scenario", "door-relay", "--runs", "1", "--workers", "1")
    call("simulate", other, *made, "--set", "world.review_share=0.5").good()
    told = []
    for bases in (ledger, other):
        call("whatif", bases, "--run", "1", "--change", "drop window:*", "--out", place).good()
        groups = json.loads(call("info", place, "--json").good().out)["groups"]
        told.append({(group["constants"], group["changes"]) for group in groups})
    changes = ("drop window:*", None)
    assert told == [{("A", one) for one in changes}, {(letter, one) for letter in "AB" for one in changes}]
