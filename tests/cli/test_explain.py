"""`explain` lists requests, tells one of them, draws it, and answers a wrong name with the nearest."""

import json
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger import record
from tests.cli.conftest import Call, one_message
from tests.quick import few


@pytest.fixture(scope="session")
def workflows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of the paper's three workflows."""
    from fsar_ledger.runtime.experiment import run_experiment, workflow_experiment

    path = tmp_path_factory.mktemp("workflows") / "ledger"
    run_experiment(path, workflow_experiment(42), 1)
    return path


DOOR, RECOVERY, SUPERVISION = (
    f"fsar.full.workflow-{name}" for name in ("door-relay", "layered-recovery", "human-supervision")
)


@pytest.mark.slow
def test_without_a_request_the_requests_of_the_first_run_are_listed(call: Call, ledger: Path) -> None:
    said = call("explain", ledger)
    listed = json.loads(call("explain", ledger, "--json").out)
    first = json.loads(call("query", "runs", ledger, "--json").out)["rows"]
    assert (said.code, said.err) == (0, "")
    assert listed["run"] == next(row["run_id"] for row in first if row["number"] == 1)
    assert said.out.startswith(f"run 1, {listed['run']}\n")
    assert listed["requests"]
    for row in listed["requests"]:
        assert f"{row['action_id']} " in said.out


@pytest.mark.slow
def test_the_call_that_the_list_suggests_runs(call: Call, ledger: Path) -> None:
    hint = call("explain", ledger).out.splitlines()[-1].partition("`")[2].partition("`")[0]
    said = call(*hint.split()[1:]).good()
    assert "asked by" in said.out


@pytest.mark.slow
def test_an_action_of_several_runs_asks_for_the_run(call: Call, ledger: Path) -> None:
    listed = json.loads(call("query", "audit/requests", ledger, "--json").out)["rows"]
    numbers = {row["run_id"]: row["number"] for row in json.loads(call("query", "runs", ledger, "--json").out)["rows"]}
    runs = sorted({numbers[row["run_id"]] for row in listed if row["action_id"] == "A1-1/2.1"})
    assert len(runs) > 5
    for option in ("--request", "--failure"):
        asked = call("explain", ledger, option, "A1-1/2.1")
        one_message(
            asked, 2, f"A1-1/2.1: found this action in {len(runs)} runs", f"give --run one of {runs[0]}, {runs[1]},"
        )
        assert asked.out == ""
    assert call("explain", ledger, "--run", runs[1], "--request", "A1-1/2.1").code == 0


@pytest.mark.slow
def test_an_action_of_one_run_is_told_without_naming_the_run(call: Call, workflows: Path) -> None:
    listed = json.loads(call("query", "audit/requests", workflows, "--json").out)["rows"]
    runs_of: dict[str, list[str]] = {}
    for row in listed:
        runs_of.setdefault(row["action_id"], []).append(row["run_id"])
    first = json.loads(call("explain", workflows, "--json").out)["run"]
    action, (name,) = next((one, runs) for one, runs in runs_of.items() if len(runs) == 1 and runs != [first])
    said = call("explain", workflows, "--request", action, "--json")
    assert (said.code, json.loads(said.out)["run"]) == (0, name)


def test_the_door_relay_is_told_from_gap_to_result(call: Call, workflows: Path) -> None:
    said = call("explain", workflows, "--run", DOOR, "--request", "A1-1/2.1")
    lines = [line[22:] for line in said.out.splitlines() if line.startswith("    ")]
    assert [line.split("  ")[0] for line in lines] == [
        *("robot/A1", "robot/A1 -> service/registry", "service/registry -> robot/A1"),
        *("robot/A1 -> robot/B1", "robot/B1", "robot/B1 -> robot/A1", "robot/B1", "robot/B1"),
        *("robot/B1 -> robot/A1", "service/coordination -> robot/A1"),
    ]
    for party in (
        "asked by       robot/A1",
        "allowed by     robot/B1",
        "executed by    robot/B1",
        "supervised by  supervisor/B1",
        "result         success",
    ):
        assert party in said.out


def test_a_story_says_when_the_action_begins_and_how_long_it_took(call: Call, workflows: Path) -> None:
    asked = ("explain", workflows, "--run", DOOR, "--request", "A1-1/2.1")
    parties = json.loads(call(*asked, "--json").out)["parties"]
    lines = call(*asked).out.splitlines()
    assert lines[1] == f"action A1-1/2.1, {parties['capability']}, begins at {parties['began_s']:.3f} s"
    assert f"{parties['ended_s'] - parties['began_s']:.3f} s after it began" in lines[-3]


def test_a_failure_is_told_level_by_level_with_the_time_at_each(call: Call, workflows: Path) -> None:
    said = call("explain", workflows, "--run", RECOVERY, "--failure", "A1-1/2.1")
    rows = json.loads(call("explain", workflows, "--run", RECOVERY, "--failure", "A1-1/2.1", "--json").out)["recovery"]
    assert list(dict.fromkeys(row["level"] for row in rows)) == ["local", "peer", "fleet", "human"]
    for row in rows:
        assert f"{row['level_number']} {row['level']:<6}{row['spent_s']:>9.3f} s" in said.out
        assert f"{row['time_s']:>10.3f} s {row['seq']:>6}   {row['what']}" in said.out
    assert "budget exhausted (2 attempts within 30 s)" in said.out


def test_the_supervisor_who_ordered_two_requests_is_named_in_both(call: Call, workflows: Path) -> None:
    for action in ("B1-1/1.1", "D1-2/1.1"):
        assert (
            "supervisor/fleet -> robot/A1" in call("explain", workflows, "--run", SUPERVISION, "--request", action).out
        )


@pytest.mark.parametrize("architecture", few(["fsar", "cfc", "dhma"], ["fsar"]))
def test_requests_of_every_architecture_can_be_told(call: Call, ledger: Path, architecture: str) -> None:
    listed = json.loads(
        call("explain", ledger, "--run", f"{architecture}.full.failure-recovery-chain.n4.s7.r0000", "--json").out
    )
    assert listed["run"].startswith(architecture)
    failed = [row for row in listed["requests"] if row["failures"]]
    for row in listed["requests"][:2] + failed[:1]:
        told = json.loads(call("explain", ledger, "--run", listed["run"], "--request", row["action_id"], "--json").out)
        assert told["parties"] == row
        assert [step["step"] for step in told["timeline"]] == list(range(1, len(told["timeline"]) + 1))
        assert (row["failures"] > 0) == bool(told["recovery"])


@pytest.mark.slow
def test_records_that_only_a_cause_ties_are_marked_and_unknown_parties_said(call: Call, ledger: Path) -> None:
    listed = json.loads(call("explain", ledger, "--run", "cfc.full.failure-recovery-chain.n4.s7.r0000", "--json").out)
    request = next(row["action_id"] for row in listed["requests"] if row["allowed_by"])
    said = call("explain", ledger, "--run", "cfc.full.failure-recovery-chain.n4.s7.r0000", "--request", request).out
    assert " * " in said
    assert "* the record names no action; its cause does" in said


@pytest.mark.slow
def test_a_request_is_drawn_beside_the_text(call: Call, workflows: Path, tmp_path: Path) -> None:
    svg, pdf = tmp_path / "new" / "door.svg", tmp_path / "door.pdf"
    said = call("explain", workflows, "--run", DOOR, "--request", "A1-1/2.1", "--svg", svg, "--pdf", pdf)
    assert said.out.endswith(f"{svg}\n{pdf}\n")
    assert b"<svg" in svg.read_bytes()
    assert b"query: door.open.secure" in svg.read_bytes()
    assert pdf.read_bytes().startswith(b"%PDF")
    ladder = tmp_path / "ladder.svg"
    assert call("explain", workflows, "--run", RECOVERY, "--failure", "A1-1/2.1", "--svg", ladder).code == 0
    assert b"level 4: human" in ladder.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--run", "fsra"), ("no such run", "did you mean fsar.full.")),
        (("--run", ""), ("no such run",)),
        (("--request", "A1-1/2"), ("no such request in any run", "did you mean A1-1/2.1?")),
        (("--request", "zzz"), ("no such request in any run", "`fsar-ledger query requests ")),
        (("--run", "1", "--request", "zzz"), ("no such request in run fsar.full.", "--run 1` lists them")),
        (("--run", "1", "--failure", "A1-1/1.1"), ("no failure", "--request A1-1/1.1")),
        (("--request", "A1-1/2.1", "--failure", "A1-1/2.1"), ("expected one of them",)),
        (("--run", "1", "--request", ""), ("--request: found an empty name", "explain without --request lists")),
        (("--failure", ""), ("--failure: found an empty name", "explain without --failure lists")),
        (("--svg", "x.svg"), ("found no request to draw", "--request")),
    ],
)
def test_a_wrong_call_is_one_message(
    call: Call, ledger: Path, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    one_message(call("explain", ledger, *arguments), 2, *parts)


def test_a_drawing_inside_the_ledger_is_refused_and_none_is_written_for_a_wrong_name(
    call: Call, ledger: Path, tmp_path: Path
) -> None:
    one_message(call("explain", ledger, "--request", "A1-1/2.1", "--svg", ledger / "x.svg"), 2, "inside the ledger")
    one_message(call("explain", ledger, "--request", "zzz", "--svg", tmp_path / "x.svg"), 2, "zzz")
    assert not (tmp_path / "x.svg").exists()
    assert not (ledger / "x.svg").exists()


def test_a_place_without_ledger_and_a_ledger_without_runs_are_named(call: Call, tmp_path: Path) -> None:
    from fsar_ledger.ledger.store.append import Writer

    one_message(call("explain", tmp_path / "nowhere"), 2, str(tmp_path / "nowhere"))
    with Writer(tmp_path / "empty", "test"):
        pass
    one_message(call("explain", tmp_path / "empty"), 2, "found no run")


@pytest.mark.slow  # a report of the results is made anyway
def test_the_report_takes_a_ledger_of_workflows(call: Call, ledger: Path, workflows: Path, tmp_path: Path) -> None:
    out = tmp_path / "report.pdf"
    assert call("report", ledger, "--workflows", workflows, "--out", out).out == f"{out}\n"
    assert out.read_bytes().startswith(b"%PDF")


def test_the_report_takes_no_other_ledger_for_one_of_workflows(
    call: Call, ledger: Path, workflows: Path, tmp_path: Path
) -> None:
    out = tmp_path / "report.pdf"
    one_message(call("report", ledger, "--workflows", ledger, "--out", out), 2, "found no run of workflow-door-relay")
    one_message(call("report", ledger, "--workflows", workflows, "--out", workflows / "x.pdf"), 2, "inside the ledger")
    assert not out.exists()


def test_a_failure_whose_recovery_nobody_recorded_is_not_denied(call: Call, tmp_path: Path) -> None:
    ledger = tmp_path / "ledger"
    at: dict[str, Any] = {"task_id": "t1", "robot": "robot/a"}
    with record(ledger, run="day", observes=["ExecutionStarted", "ExecutionFailed"]) as recorder:
        recorder.event("ExecutionStarted", **at, action_id="t1/1", capability="carry")
        recorder.event("ExecutionFailed", **at, action_id="t1/1", failure=1, cause="jam")
        recorder.event("ExecutionStarted", **at, action_id="t1/2", capability="carry")
    for action, found in (
        ("t1/1", "found that it failed, and no record of its recovery,"),
        ("t1/2", "found no failure"),
    ):
        one_message(call("explain", ledger, "--failure", action), 2, found, f"--request {action} shows what happened")


def test_a_failure_is_told_also_where_nobody_recorded_how_long_a_level_took(call: Call, tmp_path: Path) -> None:
    action: dict[str, Any] = {"task_id": "t1", "action_id": "t1/1"}
    attempt: dict[str, Any] = {"failed_action": "t1/1", "failure": 1, "number": 1, "level": "local", "deadline_us": 1}
    with record(tmp_path / "ledger", run="night", observes=["RequestIssued", "RecoveryAttempted"]) as recorder:
        recorder.event("RequestIssued", **action, request_id="r1", capability="x")
        recorder.event("RecoveryAttempted", **action, **attempt, robot="robot/B", decided_by="robot/B")
    said = call("explain", tmp_path / "ledger", "--failure", "t1/1")
    assert said.code == 0
    assert "1 local         ? s" in said.out
