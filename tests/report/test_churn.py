"""Members that come and go: a scenario with constants of its own, whose counts no number of the paper stands beside."""

import json
from collections import Counter
from pathlib import Path

import pytest
from msgspec.structs import replace

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs import registered
from fsar_ledger.designs.constants import Constants, Membership
from fsar_ledger.events.execution import ExecutionFailed
from fsar_ledger.events.fleet import RobotCleared, RobotDeparted, RobotReturned
from fsar_ledger.events.recovery import AssistanceFailed, RecoveryEscalated
from fsar_ledger.events.request import RequestClosed
from fsar_ledger.events.task import TaskAbandoned, TaskCompleted
from fsar_ledger.events.world import RobotWentOff
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.report.audit import AuditDocument, gather_audit, kind_of
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import read_ledger
from fsar_ledger.report.read import gather
from fsar_ledger.runtime.experiment import run_experiment
from fsar_ledger.runtime.experiment_arguments import experiment_of
from fsar_ledger.runtime.own import with_own
from fsar_ledger.runtime.replay import replay

CHURN = Membership(away_rate_per_s=0.004, away_mean_s=90.0, heartbeat_us=5_000_000)


@pytest.fixture(scope="module")
def churn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six runs of eight robots under FSAR, and as many under CFC."""
    path = tmp_path_factory.mktemp("churn") / "ledger"
    run_experiment(path, experiment_of(["fsar", "cfc"], ["churn"], 6, 42, 8, None), 1)
    return path


def test_the_scenario_brings_its_constants_and_yours_go_before_them() -> None:
    assert experiment_of(["fsar"], ["churn"], 1, 42, None, None).constants == Constants(membership=CHURN)
    mine = experiment_of(["fsar"], ["churn"], 1, 42, None, None, settings=["membership.away_mean_s=10"]).constants
    assert mine.membership == replace(CHURN, away_mean_s=10.0)
    with pytest.raises(UsageError, match="--scenario churn: found 2 scenarios, expected this one alone, which has"):
        experiment_of(["fsar"], ["churn", "door-relay"], 1, 42, None, None)
    assert "churn" not in registered.PAPER_SCENARIOS
    assert experiment_of(None, None, 1, 42, None, None).scenarios == registered.PAPER_SCENARIOS


def test_a_scenario_of_ones_own_brings_constants_too_and_a_wrong_one_is_told_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "storm.toml"
    text = 'name = "storm"\nsettings = [\n    "outages.off_rate_per_s=0.01",\n    "world.review_share=0.5",\n]\n'
    task = '[[tasks]]\nowner = "A"\nsteps = ["A navigate.indoor"]\n'
    file.write_text(text + task)
    constants, _ = with_own(Constants(), [str(file)], settings=["world.review_share=0.25"])
    assert constants.outages is not None
    assert (constants.outages.off_rate_per_s, constants.world.review_share) == (0.01, 0.25)
    file.write_text(text.replace("off_rate", "of_rate") + task)
    with pytest.raises(UsageError, match=r"storm\.toml:3: settings\[0\]: --set outages\.of_rate_per_s=0\.01: unknown"):
        with_own(Constants(), [str(file)])


def test_its_runs_replay_from_the_ledger_alone(churn: Path) -> None:
    report = replay(churn)
    assert (report.ok, report.runs) == (True, 12)


@pytest.mark.slow
def test_the_report_counts_what_is_on_record_and_compares_it_with_nothing(churn: Path) -> None:
    parts = read_ledger(churn, None)
    assert list(parts) == ["churn"]
    assert parts["churn"].numbers == ()
    counted = {row["run_id"]: row for row in parts["churn"].relations["departures"].to_pylist()}
    totals: Counter[str] = Counter()
    outside = 0
    for record in open_ledger(churn).runs():
        if record.run_id.startswith("plan."):
            continue
        kinds = Counter(type(event) for event in record.events)
        row = counted[record.run_id]
        departed = [event.reason for event in record.events if isinstance(event, RobotDeparted)]
        assert (row["announced"], row["found_out"]) == (departed.count("announced"), departed.count("silent"))
        assert (row["away"], row["cleared"]) == (kinds[RobotWentOff], kinds[RobotCleared])
        assert row["returned"] == kinds[RobotReturned]
        failed = [one for one in record.events if isinstance(one, RequestClosed) and one.cause == "departed"]
        assert row["requests_failed"] == len(failed)
        cut_off = {
            event.subject.task_id
            for event in record.events
            if isinstance(event, RequestClosed | ExecutionFailed | AssistanceFailed | RecoveryEscalated)
            and "departed" in (getattr(event, "cause", None), getattr(event, "reason", None))
        }
        completed = {event.task_id for event in record.events if isinstance(event, TaskCompleted)}
        assert row["tasks_recovered"] == len(cut_off & completed)
        assert row["tasks_abandoned"] <= kinds[TaskAbandoned]
        totals.update({name: row[name] for name in ("tasks_recovered", "tasks_abandoned")})
        assert row["acts"] == 0
        outside += kinds[RobotDeparted]
    assert outside > 5
    assert min(totals.values()) > 0
    assert all(row["found_out"] == 0 for name, row in counted.items() if name.startswith("cfc"))


@pytest.mark.slow
def test_the_papers_report_has_the_section_beside_and_no_other_number(
    churn: Path, ledger: Path, document: Document
) -> None:
    beside = Document(gather(ledger, beside={churn: None}))
    with_churn, without = json.loads(beside.reproduction()), json.loads(document.reproduction())
    assert with_churn["ledgers"].keys() - without["ledgers"].keys() == {"churn"}
    assert {name for name in without if with_churn[name] != without[name]} <= {"ledgers", "queries"}
    titles = [[section["title"] for section in one.sections] for one in (document, beside)]
    assert [title for title in titles[1] if title not in titles[0]] == ["Members that come and go"]


@pytest.mark.slow
def test_the_audit_report_has_the_section_where_robots_left(churn: Path, ledger: Path) -> None:
    assert kind_of(churn) == "audit"
    rows = json.loads(AuditDocument(gather_audit(churn)).reproduction())["tables"]["departures"]
    assert [row["name"] for row in rows] == ["FSAR", "CFC"]
    assert rows[0]["away"] == rows[1]["away"] > 5
    assert rows[0]["announced"] > 0
    assert rows[0]["found_out"] > 0
    assert (rows[1]["announced"], rows[1]["found_out"], rows[0]["acts"], rows[1]["acts"]) == (0, 0, 0, 0)
    assert "departures" not in json.loads(AuditDocument(gather_audit(ledger)).reproduction())["tables"]
