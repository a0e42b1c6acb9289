"""`why`: the reasons of an event as a tree, as JSON and as a figure, and what made each verdict."""

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from fsar_ledger import Ledger
from fsar_ledger.analysis import Line
from fsar_ledger.analysis.reads import Read
from fsar_ledger.analysis.why import DecisionTrace, decisions, first_of, reasons
from fsar_ledger.api.why import Tree, Why, why_of
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.envelope import Robot, Supervisor
from fsar_ledger.events.fleet import RobotJoined, RunStarted
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.locations import record_of
from fsar_ledger.metrics.invariants import JUDGES, verdict_kinds
from fsar_ledger.metrics.provenance import Provenance
from tests.analysis.conftest import OUTAGES, simulated
from tests.cli.conftest import Call, one_message
from tests.ledger.samples import append_all
from tests.recycled import asked

RUN = "fsar.full.door-relay.n4.s7.r0000"


@pytest.fixture(scope="module")
def request_seq(ledger: Path) -> int:
    """The first request of the run."""
    of_run = f"type LIKE 'RequestIssued.%' AND run_id LIKE '{RUN}%'"
    return int(asked(ledger, f"SELECT min(seq) AS seq FROM events WHERE {of_run}")[0]["seq"])


def test_an_event_is_told_with_its_triggers_reads_and_answers(call: Call, ledger: Path, request_seq: int) -> None:
    called = call("why", ledger, f"1:{request_seq}")
    assert called.code == 0, called.err
    lines = called.out.splitlines()
    assert lines[0].startswith(f"run 1, {RUN}")
    assert re.match(rf" +{request_seq} .* request: ", lines[2])
    assert "triggers, newest first" in lines
    assert "decided by architectures.fsar.discovery.issue_request on IssueRequest" in lines
    assert any(line.startswith("asked network: message:") for line in lines)
    assert any(re.match(r"read of \d+  \d", line) for line in lines)
    assert "read before anything had written it" in lines
    assert f"`fsar-ledger prove {ledger} 1:{request_seq}` proves event {request_seq} to others" in lines


@pytest.mark.slow
def test_how_an_event_came_about_is_told_once(call: Call, ledger: Path, request_seq: int) -> None:
    deep = call("why", ledger, f"1:{request_seq}", "--depth", "30").out
    told = Ledger(ledger).why(f"1:{request_seq}", depth=None)
    decided = [one for one in told.made if one.origin in ("decision", "command")]
    assert len(re.findall("decided by ", deep)) == len(decided) > 5
    assert len(re.findall(r"a fact of the world", deep)) == sum(one.origin == "world" for one in told.made)
    assert "(shown under " in deep
    middle = call("why", ledger, f"1:{request_seq}", "--depth", "2").out
    assert {len(indent) for indent in re.findall("^( *)decided by ", middle, re.MULTILINE)} <= {0, 4, 8}
    shallow = call("why", ledger, f"1:{request_seq}", "--depth", "1").out
    assert (shallow.count("decided by "), shallow.count("(shown under ")) == (1, 0)


def test_what_a_kept_command_waited_for_is_told() -> None:
    record = simulated("fsar", constants=OUTAGES)
    made = decisions(record, {first_of(record, seq) for seq in range(len(record.events))})
    seq, fact = next((seq, one.waited_for[0]) for seq, one in made.items() if one.waited_for)
    told = why_of(record, Provenance(), seq, 1)
    assert any(line.startswith(f"waited for {fact}  ") for line in Tree(told).lines())


def test_json_has_the_head_and_what_python_answers(call: Call, ledger: Path, request_seq: int) -> None:
    called = call("why", ledger, f"{RUN}:{request_seq}", "--json")
    answer = json.loads(called.out)
    told = Ledger(ledger).why((1, request_seq))
    assert (answer["head"]["size"], answer["rows_verified"]) == (Ledger(ledger).head.size, True)
    assert (answer["run"], answer["seq"], answer["triggers"]) == (told.run, request_seq, list(told.triggers))
    assert [one["seq"] for one in answer["made"]] == [one.seq for one in told.made]
    reads = answer["made"][0]["reads"]
    assert [one["place"] for one in reads] == [one.place for one in told.made[0].reads]
    named = {seq for one in told.made for seq in (one.seq, *one.rests_on)} | {request_seq, *told.triggers}
    assert {int(seq) for seq in answer["lines"]} == named


@pytest.mark.slow
def test_a_place_in_the_ledger_names_the_event_as_it_does_for_prove(ledger: Path, request_seq: int) -> None:
    asked = Ledger(ledger)
    place = asked.prove(f"1:{request_seq}").index
    assert (asked.why(f"{place}").run, asked.why(f"{place}").seq) == (asked.why((1, request_seq)).run, request_seq)


@pytest.mark.slow
def test_the_figure_is_drawn_beside_the_text(call: Call, ledger: Path, tmp_path: Path, request_seq: int) -> None:
    file = tmp_path / "why.svg"
    called = call("why", ledger, f"1:{request_seq}", "--svg", file)
    assert called.code == 0, called.err
    assert called.out.splitlines()[-1] == str(file)
    first = file.read_bytes()
    assert b"<svg" in first
    assert f"{request_seq}".encode() in first
    assert call("why", ledger, f"1:{request_seq}", "--svg", file).code == 0
    assert file.read_bytes() == first


def test_text_in_a_figure_is_escaped(tmp_path: Path) -> None:
    line = Line("r", 3, 1.0, "<script>$a$", "robot/A1", "robot/A1", "&\x1b[31m", None)
    cause = Line("r", 1, 0.5, None, "robot/A1", "robot/A1", "]]>", None)
    entry = Read("request[<b>]", "has x", None, True, 1, ())
    made = DecisionTrace(seq=3, count=1, origin="decision", handler="h", command="C", triggered_by=1, reads=(entry,))
    found = Why(run="r", seq=3, triggers=(1,), made=(made,), lines={1: cause, 3: line}, provenance=Provenance())
    found.draw(tmp_path / "why.svg")
    drawn = (tmp_path / "why.svg").read_text("utf-8")
    assert "<script>" not in drawn
    assert "<b>" not in drawn
    assert "\x1b" not in drawn
    assert "&lt;script" in drawn


class Judged(NamedTuple):
    """What SQL says of all runs: verdicts, denials, the values of metrics, and the type of each event."""

    verdicts: list[dict[str, Any]]
    denials: list[dict[str, Any]]
    metrics: list[dict[str, Any]]
    types: dict[tuple[str, int], str]


@pytest.fixture(scope="module")
def judged(ledger: Path) -> Judged:
    events = asked(ledger, "SELECT run_id, seq, split_part(type, '.', 1) AS type FROM events")
    return Judged(
        asked(ledger, "SELECT * FROM verdict_events ORDER BY run_id, seq, action_id, about"),
        asked(ledger, "SELECT run_id, seq, under_seqs FROM denied_actions WHERE len(under_seqs) > 0"),
        asked(ledger, "SELECT run_id, metric, numerator, denominator FROM run_metrics"),
        {(row["run_id"], row["seq"]): row["type"] for row in events},
    )


@pytest.mark.parametrize("kind", JUDGES)
def test_verdicts_are_as_many_as_the_metric_counts(judged: Judged, kind: str) -> None:
    counts = Counter(row["run_id"] for row in judged.verdicts if row["verdict"] == kind)
    of_metric = [row for row in judged.metrics if row["metric"] == JUDGES[kind]]
    assert len(of_metric) == 12
    for row in of_metric:
        left = row["denominator"] - row["numerator"]
        assert counts[row["run_id"]] == (left if kind in ("late", "unattributed") else row["numerator"]), row
    assert counts


def test_each_verdict_rests_on_events_of_its_run(judged: Judged) -> None:
    for row in judged.verdicts:
        assert row["made_by"] == sorted(set(row["made_by"]))
        assert row["seq"] in row["made_by"]
        assert all((row["run_id"], seq) in judged.types for seq in row["made_by"])


@pytest.mark.parametrize(
    ("kind", "begins", "ends"),
    [
        ("violation", {"PolicyWindowOpened"}, {"ExecutionStarted", "RoutinePerformed"}),
        ("conflict", {"AuthorityClaimed"}, {"AuthorityClaimed"}),
        ("late", {"TaskArrived"}, {"TaskCompleted", "TaskAbandoned", "TaskArrived"}),
    ],
)
def test_a_verdict_names_the_events_that_made_it(judged: Judged, kind: str, begins: set[str], ends: set[str]) -> None:
    rows = [row for row in judged.verdicts if row["verdict"] == kind]
    for row in rows:
        types = [judged.types[row["run_id"], seq] for seq in row["made_by"]]
        assert types[0] in begins, row
        assert types[-1] in ends, row
        assert len(types) > 1 or ends == {"TaskArrived"}, row
    assert rows


@pytest.mark.slow
def test_the_windows_that_sql_holds_a_denial_against_are_among_its_reasons(ledger: Path, judged: Judged) -> None:
    """Two accounts of the same: what the queries find in the record, and what the handlers read on replay."""
    view = open_for_answers(ledger)
    last = {row["run_id"]: row for row in judged.denials}
    for run, row in last.items():
        assert set(row["under_seqs"]) <= set(reasons(record_of(view, run), row["seq"], None).seqs), row
    assert {run.partition(".")[0] for run in last} == {"fsar", "cfc", "dhma"}


def test_the_verdicts_of_a_run_are_listed_with_the_call_that_goes_on(call: Call, ledger: Path, judged: Judged) -> None:
    first = next(row for row in judged.verdicts if row["verdict"] == "violation")
    called = call("why", ledger, "--run", first["run_id"], "--verdict", "violation")
    assert called.code == 0, called.err
    assert "made_by" in called.out
    assert f"says why event {first['seq']} happened" in called.out
    ((of, event),) = re.findall(r"`fsar-ledger why (\S+) (\S+)`", called.out)
    assert call("why", of, event).code == 0


def test_the_verdicts_of_an_invariant_are_those_of_its_query(call: Call, ledger: Path) -> None:
    rows = asked(ledger, "SELECT run_id, seq FROM i5_audit_attributability ORDER BY run_id, seq")
    run = rows[0]["run_id"]
    answer = json.loads(call("why", ledger, "--run", run, "--verdict", "i5", "--json").out)
    assert [row["seq"] for row in answer["rows"]] == [row["seq"] for row in rows if row["run_id"] == run]


def test_no_verdict_is_said_in_words(call: Call, ledger: Path) -> None:
    called = call("why", ledger, "--run", "1", "--verdict", "i4")
    assert (called.code, called.out.splitlines()[1]) == (0, "no i4")


def test_an_unknown_kind_of_verdict_is_answered_with_all_kinds(call: Call, ledger: Path) -> None:
    called = call("why", ledger, "--run", "1", "--verdict", "conflicts")
    one_message(
        called, 2, "--verdict conflicts: there is no such kind of verdict; did you mean conflict?", *verdict_kinds()
    )


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ((), ("expected an EVENT, as RUN:SEQ, or --run RUN and --verdict KIND",)),
        (("1:3", "--verdict", "late"), ("expected an EVENT, as RUN:SEQ, or --run RUN and --verdict KIND",)),
        (("--verdict", "late"), ("--verdict late: expected the run, too",)),
        (("1:3", "--run", "1"), ("--run 1: expected it with --verdict only",)),
        (("--run", "1", "--verdict", "late", "--svg", "x.svg"), ("--svg x.svg: found no event to draw",)),
        (("1:3", "--svg", "x.png"), ("--svg x.png: expected a name that ends in .svg",)),
        (("1:x",), ("EVENT 1:x: found no number",)),
        (("99:1",), ("there is no run of this number",)),
        (("1:100000",), ("expected a seq from 0 to",)),
        (("fsr.full:3",), ("there is no such run", "did you mean")),
    ],
)
def test_a_mistake_is_answered_with_what_would_work(
    call: Call, ledger: Path, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    one_message(call("why", ledger, *arguments), 2, *parts)


def test_a_depth_below_one_is_refused(ledger: Path) -> None:
    with pytest.raises(UsageError, match="depth=0: expected 1 or more"):
        Ledger(ledger).why((1, 3), depth=0)
    with pytest.raises(UsageError, match="expected a seq from 0 to"):
        Ledger(ledger).why((1, -1))


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A live run that observes membership alone."""
    path = tmp_path_factory.mktemp("live") / "ledger"
    joined = RobotJoined(robot=Robot("robot/A1"), role="A", team=1, supervisor=Supervisor("supervisor/A1"))
    append_all(path, [[LedgerRun("night", [0, 1], [None, 0], [RunStarted(kind="live", observes=("fleet",)), joined])]])
    return path


def test_a_live_run_is_refused_because_its_commands_are_not_stored(call: Call, live: Path) -> None:
    one_message(call("why", live, "night:1"), 2, "run night: kind: found a live run", "expected a simulated run")


def test_a_verdict_that_was_not_observed_is_not_said_to_be_absent(call: Call, live: Path) -> None:
    for kind in ("late", "conflict", "i4"):
        called = call("why", live, "--run", "night", "--verdict", kind).good()
        assert called.out.splitlines()[1] == f"no {kind} on record; not everything that it rests on was observed"


def test_a_plan_has_no_reasons(call: Call, ledger: Path) -> None:
    (plan,) = asked(ledger, "SELECT run_id FROM events WHERE type LIKE 'ExperimentPlanned.%'")
    one_message(call("why", ledger, f"{plan['run_id']}:0"), 2, "found the plan of an experiment, expected a run")
