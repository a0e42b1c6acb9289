"""A ledger of three members: what was not observed is neither 0 nor does it hold, whichever command is asked."""

import json
from pathlib import Path

import pytest

from fsar_ledger import record
from fsar_ledger.events import CONCERN_OF, CONCERNS
from fsar_ledger.events.envelope import ActionId, Parties, Robot, Subject, Supervisor, TaskId
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.fleet import RobotJoined, RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.metrics.definitions import metrics
from tests.cli.conftest import Call, one_message
from tests.ledger.samples import append_all


@pytest.fixture(scope="module")
def members(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A live run that observes membership, and three robots that join."""
    path = tmp_path_factory.mktemp("members") / "ledger"
    joined = [
        RobotJoined(
            robot=Robot(f"robot/A{number}"), role="A", team=number, supervisor=Supervisor(f"supervisor/A{number}")
        )
        for number in (1, 2, 3)
    ]
    append_all(
        path,
        [[LedgerRun("night", [0, 1, 2, 3], [None, 0, 1, 2], [RunStarted(kind="live", observes=("fleet",)), *joined])]],
    )
    return path


def test_audit_says_of_each_of_the_ten_that_it_is_not_observable_and_passes_none(call: Call, members: Path) -> None:
    said = call("audit", members)
    rows = said.out.splitlines()[2:12]
    assert [line.split("_")[0] for line in rows] == ["i1", "i2", "i3", "i4", "i5", "a1", "a2", "a3", "a4", "a5"]
    assert all("not observable: " in line and "holds" not in line for line in rows)
    assert said.out.splitlines()[13] == "0 of 10 invariants hold"
    assert "that is not a pass" in said.out
    assert said.code == 1


@pytest.mark.slow
def test_an_invariant_without_a_case_is_no_pass_although_all_is_observed(call: Call, tmp_path: Path) -> None:
    joined = [
        RobotJoined(
            robot=Robot(f"robot/A{number}"), role="A", team=number, supervisor=Supervisor(f"supervisor/A{number}")
        )
        for number in (1, 2, 3)
    ]
    append_all(
        tmp_path / "ledger",
        [[LedgerRun("night", [0, 1, 2, 3], [None, 0, 1, 2], [RunStarted(kind="live", observes=CONCERNS), *joined])]],
    )
    said = call("audit", tmp_path / "ledger")
    assert said.code == 1
    assert said.out.splitlines()[13] == "1 of 10 hold, 9 had no case"
    found = said.out.splitlines()[14]
    assert found == "the record has nothing to judge for I2, I3, I4, I5, A1, A2, A3, A4, A5; that is not a pass"
    assert [("no case" in line, "holds" in line) for line in said.out.splitlines()[2:12]] == [(False, True)] + [
        (True, False)
    ] * 9
    answer = json.loads(call("audit", tmp_path / "ledger", "--json").out)
    assert [answer["holds"], *((row["holds"], row["cases"]) for row in answer["rows"])] == [None, (True, 3)] + [
        (None, 0)
    ] * 9
    assert call("audit", tmp_path / "ledger", "--invariant", "i1").code == 0


def test_audit_tells_programs_null_and_why(call: Call, members: Path) -> None:
    said = call("audit", members, "--json", "--invariant", "i4")
    answer = json.loads(said.out)
    [row] = answer["rows"]
    assert (said.code, answer["holds"], row["holds"], row["events"], row["cases"]) == (1, None, None, None, None)
    assert (row["not_observed"], row["runs_not_observed"]) == ("recovery, supervision", 1)


def test_metrics_shows_no_number_but_how_many_runs_are_not_observed(call: Call, members: Path) -> None:
    rows = json.loads(call("metrics", members, "--json").out)["rows"]
    assert len({row["metric"] for row in rows}) == len(rows) == len(metrics())
    for row in rows:
        assert {
            row[name] for name in ("mean", "sd", "ci_low", "ci_high", "denominator", "published_convention_mean")
        } == {None}
        assert (row["n"], row["runs_not_observed"]) == (0, 1)
    assert json.loads(call("statistics", members, "--json").out)["rows"] == []


@pytest.mark.slow
def test_runs_without_a_scenario_are_named_where_rows_are_by_scenario(call: Call, members: Path, ledger: Path) -> None:
    asked, left_out = ("metrics", members, "--by", "scenario"), "1 run without a scenario is in no row"
    assert call(*asked).out == f"(no rows)\n\n{left_out}\n"
    assert left_out in call(*asked, "--csv").err
    told = json.loads(call(*asked, "--json").out)
    assert (told["remarks"], told["rows"]) == ([left_out], [])
    assert "without a scenario" not in call("metrics", members).out
    assert "without a scenario" not in call("metrics", ledger, "--by", "scenario").out
    assert "remarks" not in json.loads(call("metrics", ledger, "--by", "scenario", "--json").out)


def test_a_question_with_an_empty_answer_says_what_was_not_observed(call: Call, members: Path) -> None:
    said = call("query", "skipped_levels", members, "--json")
    assert json.loads(said.out).get("not_observed") == [{"concern": "recovery", "runs": 1, "of_runs": 1}]
    assert "not observed, so the answer says nothing about it: recovery (1 of 1 runs)" in said.err
    joined = call("query", "robot_joined", members, "--json")
    assert "not_observed" not in json.loads(joined.out)
    assert "not observed" not in joined.err


def test_explain_does_not_say_that_there_were_no_requests(call: Call, members: Path) -> None:
    said = call("explain", members)
    unseen = "not everything that a request leaves on record was observed"
    assert said.out.splitlines()[-1] == f"no requests on record; {unseen}"
    assert "request (1 of 1 runs)" in said.err


def test_info_names_what_no_answer_is_about(call: Call, members: Path) -> None:
    assert (
        "not observed, so no answer is about it: authority (1 of 1 runs), command (1 of 1 runs), "
        "execution (1 of 1 runs)" in call("info", members).out
    )
    found = json.loads(call("info", members, "--json").out)["not_observed"]
    assert {one["concern"] for one in found} == set(CONCERNS) - {"fleet"}


@pytest.mark.slow
def test_where_everything_is_observed_nothing_is_said_of_it(call: Call, ledger: Path) -> None:
    said = call("query", "requests", ledger, "--json")
    assert "not_observed" not in json.loads(said.out)
    assert "not observed" not in said.err
    assert json.loads(call("info", ledger, "--json").out)["not_observed"] == []
    assert {row["runs_not_observed"] for row in json.loads(call("metrics", ledger, "--json").out)["rows"]} == {0}


def test_an_architecture_of_somebody_elses_can_be_asked_for_by_its_name(call: Call, tmp_path: Path) -> None:
    started = RunStarted(kind="foreign", observes=("fleet",), architecture="open-rmf", source="a log")
    append_all(tmp_path / "ledger", [[LedgerRun("ward", [0], [None], [started])]])
    assert {
        row["architecture"]
        for row in json.loads(call("audit", tmp_path / "ledger", "--architecture", "open-rmf", "--json").out)["rows"]
    } == {"open-rmf"}
    one_message(call("audit", tmp_path / "ledger", "--architecture", "open-rfm"), 2, "did you mean open-rmf")


def test_audit_says_how_many_actions_were_under_way_when_the_record_began(call: Call, tmp_path: Path) -> None:
    asks, works, supervisor = Robot("robot/A1"), Robot("robot/A2"), Supervisor("supervisor/x")
    joined = [RobotJoined(robot=robot, role="A", team=1, supervisor=supervisor) for robot in (asks, works)]
    went_on = ExecutionStarted(
        subject=Subject(task_id=TaskId("t"), action_id=ActionId("t/1")),
        principals=Parties(requested_by=asks, executed_by=works, supervised_by=supervisor),
        robot=works,
        on_behalf_of=asks,
        capability="carry",
    )
    started = RunStarted(kind="foreign", source="s", observes=CONCERNS)
    ledger = tmp_path / "ledger"
    append_all(ledger, [[LedgerRun("night", [0, 1, 2, 3], [None, 0, 1, 2], [started, *joined, went_on])]])
    said = call("audit", ledger, "--invariant", "i2", "--json")
    [row] = json.loads(said.out)["rows"]
    assert (row["holds"], row["cases"], row["events"]) == (None, 0, 0)
    assert json.loads(said.out)["actions_under_way"] == 1
    assert "1 action under way when the record began: requests and permissions before that are not judged" in said.err


ENDS = ("ExecutionFinished", "ExecutionWithdrawn")


WHOLE = tuple(name for name, concern in CONCERN_OF.items() if concern == "execution")


@pytest.mark.parametrize("types", [("ExecutionStarted", *ENDS), WHOLE], ids=["in part", "every type"])
def test_state_step_and_log_name_alike_what_is_recorded_in_part(
    call: Call, tmp_path: Path, types: tuple[str, ...]
) -> None:
    ledger, lacking = tmp_path / "ledger", set() if types == WHOLE else {"execution in part"}
    with record(ledger, run="day", observes=["fleet", *types]) as recorder:
        recorder.event("ExecutionStarted", task_id="t", action_id="t/1", robot="robot/a", capability="carry")
    asked = ("state", "--run", "day"), ("step", "--run", "day", "--script", "last"), ("log", "--run", "day")
    for verb, *words in asked:
        said = call(verb, ledger, *words)
        found = {one.partition(" (")[0] for one in said.err.partition("nothing about it: ")[2].split(", ")}
        assert {name for name in found if "execution" in name} == lacking, (verb, said.err)
        assert {one for one in found if one.startswith("fleet")} == set()
    shown = call("state", ledger, "--run", "day").out
    assert "running t/1 carry" in shown
    unseen = shown.partition("not observed, so not shown: ")[2].split(", ")
    assert {one for one in unseen if "execution" in one} == lacking
