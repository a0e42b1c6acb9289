"""`why`, `whatif`, `cause`, `bisect`, `step` and `diff` of a live run, as people call them."""

import json
from pathlib import Path

import pytest

from fsar_ledger.api.ledger import Ledger
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.architectures.fsar.reports import JudgeRequest, ReportStart, ReportWindow
from fsar_ledger.runtime.handlers.task import SubmitTask
from tests.cli.conftest import Call, one_message
from tests.recycled import asked
from tests.runtime.test_live import OPENING, STEPS, A, B, Play, S, done

RULE = "rule fleet deny robot=B1 capability=door.open.secure from 4.5s"
ACCEPTED = JudgeRequest(robot=B, action_id=OPENING, accepts=True)


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three live runs: the door opens; it is closed for the night, and opens when asked again; it opens at once."""
    path = tmp_path_factory.mktemp("live") / "hall"
    before = (
        SubmitTask(robot=A, task_id="t", steps=STEPS, budget_us=600 * S),
        ReportStart(robot=A, action_id="t/1.1"),
        done(A, "t/1.1"),
    )
    after = (
        ReportStart(robot=B, action_id=OPENING),
        done(B, OPENING),
        ReportStart(robot=A, action_id="t/3.1"),
        done(A, "t/3.1"),
    )
    day = Play().does(*before)
    assert day.give(ReportStart(robot=B, action_id=OPENING)) is not None
    day.does(ACCEPTED, *after)
    night = Play().does(*before, ReportWindow(robot=B, scope="local", window="night", outcome="deny"), ACCEPTED)
    night.does(ReportWindow(robot=B, scope="local", window="night", outcome=None)).wait(6)
    night.does(JudgeRequest(robot=B, action_id="t/2.2", accepts=True), ReportStart(robot=B, action_id="t/2.2"))
    night.does(done(B, "t/2.2"), ReportStart(robot=A, action_id="t/3.1"), done(A, "t/3.1"))
    quick = Play().does(*before, ACCEPTED, *after)
    records = [
        type(play.record)(name, play.record.times_us, play.record.caused_by, play.record.events)
        for name, play in (("day", day), ("night", night), ("quick", quick))
    ]
    with Writer(path, "example.org/hall") as writer:
        writer.append(stage(path, records))
    assert Ledger(path).verify(replay=True).ok
    return path


def seq_of(hall: Path, run: str, kind: str) -> int:
    rows = asked(hall, f"SELECT min(seq) AS seq FROM events WHERE run_id = '{run}' AND type LIKE '{kind}.%'")
    return int(rows[0]["seq"])


def test_why_tells_the_handler_and_what_it_read_for_a_command_that_was_rejected(call: Call, hall: Path) -> None:
    seq = seq_of(hall, "day", "CommandRejected")
    lines = call("why", hall, f"day:{seq}", "--depth", "2").good().out.splitlines()
    assert "decided by architectures.fsar.reports.report_start on ReportStart" in lines
    assert f"triggered by {seq - 1}  4.000 s  robot/B1: gives the command: ReportStart" in lines
    assert "    it came from outside; the record says no more about why" in lines
    assert "    execution.actions: [t/2.1] = absent" in lines[lines.index("read before anything had written it") :]


@pytest.mark.slow
def test_why_tells_which_rule_denied_and_which_events_let_a_request_be_admitted(call: Call, hall: Path) -> None:
    denied = call("why", hall, f"night:{seq_of(hall, 'night', 'RequestDenied')}", "--depth", "1").good().out
    opened = seq_of(hall, "night", "PolicyWindowOpened")
    assert "decided by architectures.fsar.reports.judge_request on JudgeRequest" in denied
    assert f"read of {opened}  4.000 s  robot/B1: policy window opens: night (local deny)" in denied
    admitted = call("why", hall, f"day:{seq_of(hall, 'day', 'RequestAdmitted')}", "--depth", "1").good().out
    assert "decided by architectures.fsar.reports.judge_request on JudgeRequest" in admitted
    assert "world.local: [robot/B1] = absent" in admitted, "the window would have changed it"
    given = json.loads(call("why", hall, f"day:{seq_of(hall, 'day', 'CommandGiven')}", "--json").good().out)
    assert [(one["origin"], one["handler"]) for one in given["made"]] == [("command", None)]


@pytest.mark.slow
def test_what_if_tells_where_the_fork_ends_and_compares_nothing_after_it(call: Call, hall: Path) -> None:
    told = call("whatif", hall, "--run", "day", "--change", RULE).good().out
    assert "the fork ends at 12.000 s: the record does not say whether robot/B1 takes t/2.2\n" in told
    assert '`--change "answer admission:t/2.2 ANSWER"` answers that; `--answers model:7` lets the model answer' in told
    assert "not given there, because nothing asks for it: 4 commands on record, ReportStart of robot/B1" in told
    assert "all tasks end alike" not in told
    assert "t     601.000001  completed  9.000003     -       -\n" in told
    answer = json.loads(call("whatif", hall, "--run", "day", "--change", RULE, "--json").good().out)
    [fork], [effects] = answer["forks"], answer["effects"]
    assert (fork["ends_s"], fork["question"]) == (pytest.approx(12, abs=0.001), "admission:t/2.2")
    assert {(row["fork_mean"], row["difference"], row["n"]) for row in effects["rows"]} == {(None, None, 0)}
    assert any(row["base_mean"] is not None for row in effects["rows"])
    consequences = answer["story"]["consequences"]
    assert {one["second"] for one in consequences["metrics"]} == {None}
    assert [(one["first"], one["second"]) for one in consequences["tasks"]] == [("completed", None)]


@pytest.mark.slow
def test_nothing_that_happens_after_the_end_of_the_fork_is_told_as_missing_in_it(call: Call, hall: Path) -> None:
    change = "drop command:ReportWindow/0"  # the door takes the first request, and nobody says when it begins
    answer = json.loads(call("whatif", hall, "--run", "night", "--change", change, "--json").good().out)
    ends_s = answer["forks"][0]["ends_s"]
    differences = answer["story"]["differences"]
    assert differences
    assert all(one["first_s"] is None or one["first_s"] <= ends_s for one in differences)
    assert ends_s < Ledger(hall).record("night").times_us[-1] / 1e6


@pytest.mark.slow
def test_with_a_model_the_fork_is_whole_and_compared(call: Call, hall: Path) -> None:
    change = "answer command:JudgeRequest/0 accepts=false"
    answer = json.loads(
        call("whatif", hall, "--run", "day", "--change", change, "--answers", "model:7", "--json").good().out
    )
    assert answer["changes"] == [change, "answer * model:7"]
    assert answer["forks"][0]["ends"] is None
    rows = {row["metric"]: row for row in answer["effects"][0]["rows"]}
    assert rows["coordination_success"]["difference"] == 0
    once_more = call("whatif", hall, "--run", "day", "--change", change, "--change", "answer * model:7", "--json")
    assert json.loads(once_more.good().out)["effects"] == answer["effects"]


def test_a_fork_without_a_change_has_the_same_events(hall: Path) -> None:
    for run in ("day", "night"):
        fork = Ledger(hall).fork(run, [])
        assert (fork.parts_at, fork.ends) == (None, None)
        assert list(fork.record.events[1:]) == list(fork.base.events[1:])
    assert Ledger(hall).fork("day", [RULE]).ends == "the record does not say whether robot/B1 takes t/2.2"


def test_what_a_change_can_name_is_listed(call: Call, hall: Path) -> None:
    rows = json.loads(call("whatif", hall, "--run", "day", "--list", "--json").good().out)["changeable"]
    by_name = {row["name"]: row["is_now"] for row in rows}
    line = json.loads(by_name["command:JudgeRequest/0"])
    assert (line["command"], line["by"], line["accepts"]) == ("JudgeRequest", "robot/B1", True)
    assert by_name["admission:t/2.1"] == "robot/B1 says so by a command"
    at_s = next(row["begins_s"] for row in rows if row["name"] == "command:JudgeRequest/0")
    refuses = json.dumps(line | {"accepts": False})
    fork = Ledger(hall).fork("day", ["drop command:JudgeRequest/0", f"add {at_s}s {refuses}"])
    altered = Ledger(hall).fork("day", ["answer command:JudgeRequest/0 accepts=false"])
    assert fork.record.events[1:] == altered.record.events[1:], "what is listed can be given again, with a change"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("whatif", "--run", "day", "--change", RULE, "--out", "forks"), "the fork of a live run, which rests on"),
        (("whatif", "--run", "day", "--change", RULE, "--answers", "paper"), "expected model: and a seed, as model:7"),
        (("whatif", "--all-runs", "--change", RULE, "--answers", "model:7"), "expected --run RUN of a live run"),
        (("whatif", "--all-runs", "--change", RULE), "found no simulated run that is not a fork itself"),
        (("whatif", "--run", "day", "--change", "architecture cfc"), "whose robots speak for themselves"),
        (("cause", "--run", "day", "--outcome", "i3 > 0", "--futures", "9"), "the futures of real robots"),
        (("cause", "--run", "day", "--outcome", "i3 > 0"), "the run does not have it"),
    ],
)
def test_what_cannot_be_asked_of_a_live_run_is_refused_in_words(
    call: Call, hall: Path, words: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    verb, *options = words
    called = call(verb, hall, *(str(tmp_path / one) if one == "forks" else one for one in options))
    one_message(called, 2, said)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_simulated_run_needs_no_model_and_takes_commands(call: Call, ledger: Path) -> None:
    asked = ("whatif", ledger, "--run", "1", "--change", "drop window:*", "--answers", "model:7")
    assert "found a simulated run, whose world answers everything" in call(*asked).err
    asked = ("cause", ledger, "--run", "1", "--outcome", "i3 > 0", "--answers", "model:7")
    assert "found a simulated run, whose world answers everything" in call(*asked).err
    change = 'add 20s {"command": "ReportContext", "by": "robot/B1", "robot": "robot/B1"}'
    told = call("whatif", ledger, "--run", "1", "--change", change).good().out
    assert "robot/B1: gives the command: ReportContext" in told


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ('"LeaveFleet", "by": "robot/X1", "robot": "robot/X1"', "LeaveFleet about robot/X1 is rejected: unknown robot"),
        ('"LeaveFleet", "by": "robot/C1", "robot": "robot/D1"', "robot/C1 speaks for robot/D1, expected its own word"),
        ('"LeaveFleet", "by": "maria", "robot": "robot/D1"', "by: found maria, expected who gives it, as robot/A1"),
        ('"LeaveFlete", "by": "robot/D1", "robot": "robot/D1"', "there is no such command; did you mean LeaveFleet"),
        (
            '"InstallCapability", "by": "robot/C1", "robot": "robot/C1", "capability": "sing", "version": "1.0.0"',
            "capability: found sing, expected one whose length is known",
        ),
    ],
)
def test_a_command_that_cannot_come_to_a_simulated_run_is_refused_in_words(
    call: Call, ledger: Path, words: str, said: str
) -> None:
    called = call("whatif", ledger, "--run", "1", "--change", f'add 20s {{"command": {words}}}')
    one_message(called, 2, said)


@pytest.mark.slow
def test_a_run_with_a_command_that_was_added_is_kept_and_replays(call: Call, ledger: Path, tmp_path: Path) -> None:
    change = 'add 20s {"command": "LeaveFleet", "by": "robot/D1", "robot": "robot/D1"}'
    call("whatif", ledger, "--run", "1", "--change", change, "--out", tmp_path / "forks").good()
    assert call("verify", tmp_path / "forks", "--replay").code == 0
    late = change.replace("20s", "1700s")
    one_message(call("whatif", ledger, "--run", "1", "--change", late), 2, "the run has ended by then")


DENIAL = "SELECT run_id FROM request_denied"


@pytest.mark.slow
def test_the_cause_of_a_denial_is_unknown_where_nobody_says_how_the_run_would_go_on(call: Call, hall: Path) -> None:
    told = json.loads(call("cause", hall, "--run", "night", "--outcome", DENIAL, "--json").good().out)
    assert [one["name"] for one in told["unknown"]] == ["command:ReportWindow/0"]
    assert "command:ReportWindow/0" not in {one["name"] for one in told["elements"]}
    text = call("cause", hall, "--run", "night", "--outcome", DENIAL).out
    assert "without any one of command:ReportWindow/0, the run asks something that the record does not answer" in text
    assert "`--answers model:7` lets the model answer" in text
    assert "futures that avoid" not in text


@pytest.mark.slow
def test_with_a_model_the_rule_is_the_cause_of_the_denial(call: Call, hall: Path) -> None:
    asked = ("cause", hall, "--run", "night", "--outcome", DENIAL, "--answers", "model:7")
    told = json.loads(call(*asked, "--json").good().out)
    assert told["unknown"] == []
    names = [one["name"] for one in told["elements"]]
    assert "command:ReportWindow/0" in names
    assert all(name.startswith("command:") for name in names)
    assert f"{len(names)} of 11 facts and answers suffice together" in call(*asked).out
    for name in names:
        fork = Ledger(hall).fork("night", [f"drop {name}", "answer * model:7"])
        assert "RequestDenied" not in {type(event).__name__ for event in fork.record.events}


def test_bisect_counts_a_fork_that_ends_early_on_neither_side(call: Call, hall: Path) -> None:
    success = "coordination_success > 0"
    told = json.loads(call("bisect", hall, "--change", RULE, "--outcome", success, "--json").good().out)
    assert (told["pairs"], told["undefined"], told["diff"]) == (0, 3, None)
    change = "drop command:SubmitTask/0"
    told = json.loads(call("bisect", hall, "--change", change, "--outcome", "a5 > 0", "--json").good().out)
    assert (told["pairs"], told["neither"]) == (3, 3)


@pytest.mark.slow
def test_step_and_diff_walk_through_live_runs(call: Call, hall: Path) -> None:
    walked = call("step", hall, "--run", "day", "--script", "next-refusal; cause; state").good().out.splitlines()
    assert "command rejected: ReportStart (about t/2.1; unknown or finished action t/2.1, expected " in walked[0]
    assert walked[1].endswith("robot/B1: gives the command: ReportStart")
    told = call("diff", hall, "day", "quick").good().out
    assert "they diverge at 4.000 s" in told
    assert "the same " in call("diff", hall, "day", "day").good().out
