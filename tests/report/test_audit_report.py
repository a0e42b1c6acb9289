"""The audit report: which ledgers get one, what its first page says, and that its numbers are those of the queries."""

import io
import json
import random
import re
from collections import Counter
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsar_ledger.api.ledger import open_ledger
from fsar_ledger.api.record import record
from fsar_ledger.api.report import report
from fsar_ledger.api.simulate import simulate
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events import CONCERNS
from fsar_ledger.metrics.library import library
from fsar_ledger.report import specs
from fsar_ledger.report.audit import AuditDocument, gather_audit, kind_of
from tests.foreign.histories import append, foreign_run
from tests.report.made import column, names, part, said
from tests.report.test_layout import typeset, widest_gap

Make = Callable[..., Path]

FLEET = """
name = "gate"

[[robots]]
name = "cart"
capabilities = ["navigate.indoor"]

[[robots]]
name = "door"
capabilities = ["door.open.secure"]

[[capabilities]]
name = "navigate.indoor"

[[capabilities]]
name = "door.open.secure"

[[trust]]
role = "cart"
peer_role = "door"
scope = "session"
is_mutual = true
"""
RULE = """
[[policies]]
role = "door"
capability = "door.open.secure"
scope = "fleet"
outcome = "deny"
"""
SCENARIO = """
name = "through-the-gate"

[[tasks]]
owner = "cart"
steps = ["cart navigate.indoor", "cart door.open.secure door"]
"""


@pytest.fixture(scope="module")
def gates(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Ledgers of a fleet of a cart and a door: one whose rules deny, and one without rules, under three designs."""
    folder = tmp_path_factory.mktemp("gates")
    (folder / "shut.toml").write_text(FLEET + RULE)
    (folder / "free.toml").write_text(FLEET)
    (folder / "scenario.toml").write_text(SCENARIO)
    for name, designs in (("shut", ["fsar"]), ("free", ["fsar", "cfc", "dhma"])):
        simulate(
            folder / name,
            architecture=designs,
            scenario=str(folder / "scenario.toml"),
            fleet=folder / f"{name}.toml",
            runs=3,
            workers=1,
        )
    return {name: folder / name for name in ("shut", "free")}


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of five runs of another system, each of which observes some concerns."""
    ledger = tmp_path_factory.mktemp("foreign") / "ledger"
    append(ledger, [foreign_run(f"{number}-{'long' * 20}", 500, random.Random(number)) for number in range(5)])
    return ledger


@pytest.fixture(scope="module")
def blind(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of a run of another system that observes its members and their messages, and nothing else."""
    ledger = tmp_path_factory.mktemp("blind") / "ledger"
    append(ledger, [foreign_run("run", 200, random.Random(1), ("fleet", "message"))])
    return ledger


@pytest.mark.slow
def test_denials_of_own_steps_are_no_denials_of_requests(tmp_path: Path) -> None:
    simulate(tmp_path / "own", architecture=["jade"], scenario="collaborative-delivery", runs=2, workers=1)
    document = audit_of(tmp_path / "own")
    assert "own step" in column(document, "denials", "reason")
    assert "as one request may meet several, and own steps are denied too" in said(document, "answer")


@cache
def audit_of(ledger: Path) -> AuditDocument:
    """What the report says of a ledger that no test changes, made once."""
    return AuditDocument(gather_audit(ledger))


def words(document: AuditDocument) -> str:
    return said(document, "answer")


def test_a_ledger_of_the_papers_experiment_gets_the_papers_report(ledger: Path, make_ledger: Make) -> None:
    assert kind_of(ledger) == "paper"
    assert kind_of(make_ledger(architectures=("fsar",), configuration="without-shared-registry")) == "paper"
    assert kind_of(make_ledger(fleet_size=8, scenarios=("door-relay",))) == "paper"


def test_any_other_ledger_gets_an_audit_report(
    gates: dict[str, Path], foreign: Path, workflows: Path, make_ledger: Make
) -> None:
    for ledger in (*gates.values(), foreign, workflows, make_ledger(architectures=())):
        assert kind_of(ledger) == "audit"


def test_a_foreign_run_beside_the_papers_makes_it_an_audit_report() -> None:
    mixed = Path(__file__).parents[1] / "ledgers" / "0.9.0" / "ledger"
    kinds = {row["kind"] for row in open_ledger(mixed).query("staging/runs").rows()}
    assert kinds == {"simulated", "foreign"}
    assert kind_of(mixed) == "audit"


def test_a_constant_that_is_not_the_papers_leaves_it_the_papers_report(tmp_path: Path) -> None:
    simulate(
        *(tmp_path / "ledger",),
        architecture="fsar",
        scenario="door-relay",
        settings="world.review_share=0.5",
        runs=1,
    )
    assert kind_of(tmp_path / "ledger") == "paper"


@pytest.mark.slow
def test_the_kind_can_be_chosen(gates: dict[str, Path], ledger: Path, tmp_path: Path) -> None:
    report(open_ledger(ledger), tmp_path / "audit.pdf", kind="audit", numbers=tmp_path / "audit.json")
    assert json.loads((tmp_path / "audit.json").read_text()).keys() >= {"ledger", "invariants", "tables", "queries"}
    report(open_ledger(gates["shut"]), tmp_path / "paper.pdf", kind="paper", numbers=tmp_path / "paper.json")
    assert "claims" in json.loads((tmp_path / "paper.json").read_text())


@pytest.mark.slow
def test_an_option_of_the_papers_report_asks_for_that_report(
    gates: dict[str, Path], workflows: Path, tmp_path: Path
) -> None:
    shut, out = open_ledger(gates["shut"]), tmp_path / "report.pdf"
    report(shut, out, beside=[workflows], numbers=tmp_path / "numbers.json")
    assert "claims" in json.loads((tmp_path / "numbers.json").read_text())
    with pytest.raises(UsageError, match=re.escape("audit report is of one ledger")):
        report(shut, out, beside=[workflows], kind="audit")


def test_an_unknown_kind_is_refused(ledger: Path, tmp_path: Path) -> None:
    unknown: Any = "summary"
    with pytest.raises(UsageError, match="expected paper or audit"):
        report(open_ledger(ledger), tmp_path / "report.pdf", kind=unknown)


@pytest.mark.slow
def test_the_first_page_says_which_rule_denied(gates: dict[str, Path]) -> None:
    told = words(audit_of(gates["shut"]))
    assert "The ledger records 3 runs (simulated), of the scenario through-the-gate, under FSAR." in told
    assert "The fleet is gate. A run has 2 robots" in told
    assert "nobody is on record who allowed one, none succeeded" in told
    assert re.search(r"most frequent ground is `rule \d+`", told)
    assert "No execution or motion began against policy" in told


@pytest.mark.slow
def test_the_words_change_with_the_data(gates: dict[str, Path]) -> None:
    told = words(audit_of(gates["free"]))
    assert "under FSAR, CFC, DHMA" in told
    assert "none succeeded" not in told
    assert "`rule" not in told
    assert re.search(r"Of the ten invariants \d+ are broken: .*CFC", told)
    assert "No event breaks one on the runs of FSAR." in told
    assert "no call of the fleet's supervisor is on record" in told


def test_a_ledger_without_runs_says_so_and_that_nothing_holds(make_ledger: Make) -> None:
    document = audit_of(make_ledger(architectures=()))
    assert words(document).startswith("The ledger holds no run, so there is nothing to judge")
    assert names(document, "table") == ["integrity"]


def test_what_is_not_observed_is_never_0_and_never_holds(blind: Path) -> None:
    document = audit_of(blind)
    told = words(document)
    assert "What was asked, allowed and denied was not observed." in told
    assert "Supervision was not observed" in told
    assert "Whether anything began against policy cannot be judged" in told
    assert "Whether authority was held twice cannot be judged." in told
    for hidden in ("No request", "No execution", "No action", "No decision", "none", "hold on"):
        assert hidden not in told
    assert column(document, "judged", "violations") == ["not observed"]
    assert column(document, "judged", "conflicts") == ["not observed"]
    assert {"requests", "denials", "interventions"}.isdisjoint(names(document, "table"))
    assert column(document, "departures", "found_out") > [0]
    assert column(document, "departures", "away") == column(document, "departures", "tasks_abandoned") == [None]
    for concern in set(CONCERNS) - {"fleet", "message"}:
        assert concern in told.rpartition("Not observed, so that no number here is about it: ")[2]


@pytest.mark.slow
def test_a_sum_over_runs_of_which_one_does_not_record_it_is_blank(tmp_path: Path) -> None:
    for name, observes in (("few", ["RobotDeparted"]), ("more", ["RobotDeparted", "RobotWentOff"])):
        with record(tmp_path / "ledger", run=name, observes=observes) as recorder:
            recorder.event("RobotDeparted", robot="robot/B1", reason="silent", fence=1)
            if "RobotWentOff" in observes:
                recorder.event("RobotWentOff", robot="robot/B1")
    document = AuditDocument(gather_audit(tmp_path / "ledger"))
    assert column(document, "departures", "found_out") == [2]
    assert column(document, "departures", "away") == column(document, "departures", "cleared") == [None]


@pytest.mark.slow
def test_what_some_runs_observe_is_said_of_those_runs(foreign: Path) -> None:
    document = audit_of(foreign)
    watching = sum(document.findings.relations["runs"]["observes_requests"].to_pylist())
    assert 0 < watching < 5
    assert f"in the {watching} of 5 runs that observe requests" in words(document)


def test_every_verdict_is_that_of_audit(foreign: Path, gates: dict[str, Path]) -> None:
    for ledger in (foreign, *gates.values()):
        document, answer = audit_of(ledger), open_ledger(ledger).audit()
        assert document.findings.relations["invariants"].num_rows == len(answer.rows)
        shown = dict(zip(column(document, "invariants", "short"), part(document, "invariants")["rows"], strict=True))
        for row in answer.rows:
            _, _, holds, broken, open_ = shown[row.invariant.partition("_")[0].upper()]
            assert (holds.value is not None) >= (row.holds is True)
            assert (broken.value is not None) >= (row.holds is False)
            assert (open_.value is not None) >= (row.holds is None)
        verdicts = {row.invariant.partition("_")[0].upper() for row in answer.rows if row.holds is False}
        assert {short for short, row in shown.items() if row[3].value is not None} == verdicts


@pytest.mark.slow
def test_one_day_stands_beside_another_and_what_is_not_recorded_is_a_dash(tmp_path: Path) -> None:
    for day, types in ((1, ["TaskArrived", "TaskCompleted"]), (2, ["TaskArrived"])):
        begins = datetime(2026, 3, day, 10, tzinfo=UTC)
        with record(tmp_path / "ledger", run=f"day {day}", observes=types, epoch=begins) as recorder:
            recorder.event("TaskArrived", task_id="t", robot="robot/A1", at=begins + timedelta(minutes=30 * day))
        if day == 1:
            assert "periods" not in names(AuditDocument(gather_audit(tmp_path / "ledger")), "table")
    document = AuditDocument(gather_audit(tmp_path / "ledger"))
    named = ("number", "day", "minutes", "tasks", "completed", "denials")
    assert list(zip(*(column(document, "periods", name) for name in named), strict=True)) == [
        (1, "2026-03-01", 30, 1, 0, None),
        (2, "2026-03-02", 60, 1, None, None),
    ]


@pytest.mark.slow
def test_every_number_is_that_of_its_query(gates: dict[str, Path]) -> None:
    for ledger in gates.values():
        document, asked = audit_of(ledger), open_ledger(ledger)
        requests = [row for row in asked.query("audit/requests").rows() if row["is_request"]]
        pairs = Counter((row["asked_by"], row["executed_by"]) for row in requests)
        shown = zip(
            *(column(document, "requests", key) for key in ("asked_by", "executed_by", "requests")), strict=True
        )
        assert {(asked_by, by): count for asked_by, by, count in shown} == dict(pairs)
        results = Counter(row["result"] for row in requests)
        assert sum(column(document, "requests", "succeeded")) == results["success"]
        denials = asked.query("audit/denials").rows()
        grounds = Counter((row["reason"], one) for row in denials for one in row["denied_under"] or [None])
        if denials:
            rules = zip(*(column(document, "denials", key) for key in ("reason", "rule", "denials")), strict=True)
            assert {(reason, rule): count for reason, rule, count in rules} == dict(grounds)
        events = asked.query("facts/verdict_events").rows()
        for verdict, key in (("violation", "violations"), ("conflict", "conflicts")):
            counted = sum(row["verdict"] == verdict for row in events)
            assert sum(int(one) for one in column(document, "judged", key)) == counted


def test_the_events_of_the_annex_are_those_of_the_query(gates: dict[str, Path]) -> None:
    document, asked = audit_of(gates["free"]), open_ledger(gates["free"])
    number = {row["run_id"]: row["number"] for row in asked.query("staging/runs").rows()}
    for name in ("i5_audit_attributability", "a4_thin_federation_interface"):
        there = {f"{number[row['run_id']]}:{row['seq']}" for row in asked.query(f"invariants/{name}").rows()}
        rows = part(document, "offences")["rows"]
        shorts = [row[0].value for row in rows]
        mine = {row[2].value for row, short in zip(rows, shorts, strict=True) if short == name[:2].upper()}
        assert mine
        assert mine <= there


@pytest.mark.slow
def test_a_ledger_of_many_findings_stays_short_and_says_what_lists_the_rest(ledger: Path) -> None:
    document = audit_of(ledger)
    assert len(part(document, "violations")["rows"]) == 25
    assert "violations are not shown; `fsar-ledger sql LEDGER" in said(document)
    for name in names(document, "table"):
        assert len(part(document, name)["rows"]) <= 50


@pytest.mark.slow
def test_it_has_two_pages_and_an_annex_and_no_page_is_a_quarter_empty(
    ledger: Path, foreign: Path, gates: dict[str, Path], tmp_path: Path
) -> None:
    from matplotlib.image import imread

    for place, at in ((ledger, "paper"), (foreign, "foreign"), (gates["shut"], "shut"), (gates["free"], "free")):
        document = audit_of(place)
        pages = typeset(document, tmp_path / at, "png")
        pages = pages if isinstance(pages, list) else [pages]
        assert 2 <= len(pages) <= 5
        gaps = [widest_gap(np.asarray(imread(io.BytesIO(page)))[..., :3].min(axis=2)) for page in pages]
        assert max(gaps[:-1]) < 0.25, at
        where = {one["name"]: one["page"] for one in typeset(document, tmp_path / f"{at}-places", "places")["parts"]}
        assert where["tab-integrity"] == where.get("tab-members", 1) == 1
        assert where["tab-invariants"] <= 2 + ("tab-departures" in where)


@pytest.mark.slow
def test_the_same_head_gives_the_same_bytes(foreign: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        report(open_ledger(foreign), tmp_path / f"{name}.pdf", numbers=tmp_path / f"{name}.json")
    for ending in ("pdf", "json"):
        assert (tmp_path / f"one.{ending}").read_bytes() == (tmp_path / f"two.{ending}").read_bytes()
    assert b"/StructTreeRoot" in (tmp_path / "one.pdf").read_bytes()


def test_every_part_reads_what_is_there_and_every_query_is_packaged(ledger: Path) -> None:
    """A SELECT over a relation that nothing gives would be left out in silence."""
    document = audit_of(ledger)
    parts = [one for section in specs.sections("audit").values() for one in section.part]
    for sql in (*specs.relations("audit_relations.toml").values(), *(one.rows for one in parts if one.rows)):
        assert document.missing(sql) == set(), sql
    tables = [one for one in parts if isinstance(one, specs.Table)]
    assert {one.query for one in tables if one.query} <= library().queries.keys()
    assert all(one.caption for one in tables)


@pytest.mark.slow
def test_names_from_a_ledger_are_text(tmp_path: Path) -> None:
    """What a foreign system calls its ledger, runs and robots is neither markup nor code."""
    evil = tmp_path / '#panic("evaluated") *bold* {x}'
    append(evil, [foreign_run('$x^{2$ #panic("run") `raw', 300, random.Random(3))])
    document = audit_of(evil)
    typeset(document, tmp_path / "report", "png")
    assert "panic" in json.loads(document.encoded())["heading"]
