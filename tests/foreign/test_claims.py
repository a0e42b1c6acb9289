"""Not observed is not "allow", not "idle" and not zero: whatever is asked of a run that lacks a concern."""

import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pyarrow as pa
import pytest
from msgspec.structs import asdict

from fsar_ledger.api.ledger import open_ledger
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import CONCERN_OF, CONCERNS
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.library import library
from fsar_ledger.metrics.provenance import types_read, unobserved
from fsar_ledger.report import build, layout
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.foreign.claims import BY_RUN, OF_GAPS, WHOLE, apart_from_gaps, recorded_without, vain_claims, without
from tests.foreign.histories import append
from tests.foreign.verbs import ask
from tests.queries.keys import required
from tests.quick import few
from tests.recycled import from_table


@pytest.fixture(scope="module")
def runs() -> list[LedgerRun]:
    """A run of each architecture in which robots fail, ask, are refused and are helped."""
    return [
        simulate_run(RunSpec(42, architecture, "full", "failure-recovery-chain", 4, 12), Constants())
        for architecture in PAPER_ARCHITECTURES
    ]


@pytest.fixture(scope="module")
def database(runs: list[LedgerRun]) -> Iterator[Database]:
    """Each run in full, and once without each concern."""
    variants = [without(runs, None, WHOLE), *(without(runs, concern, concern) for concern in CONCERNS)]
    with from_table(pa.concat_tables(variants)) as made:
        yield made


@pytest.mark.parametrize("name", few(BY_RUN, [one for one in BY_RUN if one.startswith("audit/")][::3]))
def test_a_query_says_null_of_what_is_not_observed_and_names_it(database: Database, name: str) -> None:
    assert list(vain_claims(database, library().find(name), WHOLE)) == []


ABOUT_ALL = {name: query for name, query in library().queries.items() if name not in {*BY_RUN, *OF_GAPS}}
DRAWN = [name for name, query in ABOUT_ALL.items() if query.relation.startswith(("drawn_", "cluster_"))]
"""Queries that draw millions of rows from few, and take as long as all others together."""


@pytest.fixture(scope="module")
def observed(runs: list[LedgerRun]) -> Iterator[Callable[[str], list[dict[str, object]]]]:
    """What a query that is not about one run answers where everything is observed, asked once."""
    with from_table(without(runs, None, WHOLE)) as made:
        yield cache(lambda name: answer_about_all_runs(made, name))


def answer_about_all_runs(database: Database, name: str) -> list[dict[str, object]]:
    """Return the rows of a query that is not about one run, without gaps."""
    return [apart_from_gaps(row) for row in database.query(name, required(ABOUT_ALL[name])).to_pylist()]


PLAIN = [name for name in ABOUT_ALL if name not in DRAWN]


@cache
def concerns_of(name: str) -> frozenset[str]:
    """Return the concerns of the events that a query may read: all, if it reads every event, or what runs observe."""
    every = library().needs([ABOUT_ALL[name].relation])
    if any(one.relation == "run_started" or (not one.tags and "events" in one.sources()) for one in every):
        return frozenset(CONCERNS)
    return frozenset(CONCERN_OF.get(tag.partition(".")[0], "") for one in every for tag in one.tags)


def in_turn(concern: str) -> list[str]:
    """Return the queries that the slow tests ask: those that may read of the concern, of those that may read of any
    every second one."""
    read = [name for name in PLAIN if concern in concerns_of(name)]
    of_any = [name for name in read if concerns_of(name) >= {*CONCERNS}]
    return [*(name for name in read if name not in of_any), *of_any[CONCERNS.index(concern) % 2 :: 2]]


@pytest.mark.parametrize(
    ("concern", "names"),
    [
        *(pytest.param(one, in_turn(one), marks=pytest.mark.slow) for one in CONCERNS),
        *(pytest.param(one, list(ABOUT_ALL), marks=pytest.mark.soak) for one in CONCERNS),
    ],
    ids=lambda value: value if isinstance(value, str) else str(len(value)),
)
def test_a_query_about_all_runs_names_what_is_not_observed(
    runs: list[LedgerRun], observed: Callable[[str], list[dict[str, object]]], concern: str, names: list[str]
) -> None:
    assert names
    with from_table(without(runs, concern, WHOLE)) as part:
        other = [name for name in names if answer_about_all_runs(part, name) != observed(name)]
        said = {name: {one.concern for one in unobserved(part, ABOUT_ALL[name])} for name in other}
    assert [name for name in other if concern not in said[name]] == []


# --- the verbs ---


@pytest.fixture(scope="module")
def ledgers(tmp_path_factory: pytest.TempPathFactory, runs: list[LedgerRun]) -> dict[str, Path]:
    """Ledgers of the run of CFC, whose deciders keep copies: one for each concern that its source does not record."""
    folder = tmp_path_factory.mktemp("ledgers")
    run = next(one for one in runs if "cfc" in one.run_id)
    for concern in CONCERNS:
        append(folder / concern, [recorded_without(run, concern)])
    return {concern: folder / concern for concern in CONCERNS}


OF_FLEET = {
    "fleet": "robots",
    "request": "requests",
    "authority": "claims",
    "recovery": "recoveries",
    "supervision": "calls",
    "task": "tasks",
    "trust": "trust",
    "policy": "rules",
}
TIMES = ("0s", "20s", "40s")
OF_ROBOT = {
    "world": {"is_on", "is_linked", "grade", "obstructions"},
    "execution": {"is_idle", "queue"},
    "policy": {"windows"},
    "registry": {"offers"},
}


@pytest.mark.parametrize("concern", few(CONCERNS, ("execution",), CONCERNS[::2]))
def test_state_and_step_say_nothing_of_what_is_not_observed(ledgers: dict[str, Path], concern: str) -> None:
    ledger = ledgers[concern]
    for at in TIMES:
        moment = open_ledger(ledger).state(1, at, as_known_by="coordinator" if concern != "fleet" else None)
        assert [one.concern for one in moment.provenance.not_observed] == [concern]
        stands = asdict(moment.standing)
        assert {name for name, value in stands.items() if value is None} - {"off_shift"} == (
            {OF_FLEET[concern]} if concern in OF_FLEET else set()
        )
        for robot in stands["robots"] or ():
            assert all(getattr(robot, name) is None for name in OF_ROBOT.get(concern, ()))
            assert robot.is_idle is not True or concern not in ("execution", "recovery")
        for one in moment.beliefs or ():
            is_about_policy = one.what in ("own policy", "fleet's rule")
            assert (one.holds is None) == (is_about_policy and concern == "policy") or concern in NOT_POLICY
            assert one.believed is None or concern != "knowledge"
    said = [ask("state", ledger, "--run", "1", "--at", at) for at in TIMES]
    walked = ask("step", ledger, "--run", "1", "--script", ";".join(f"go {at};state" for at in TIMES))
    for called in (*said, walked):
        assert called.code == 0
        times = len(TIMES) if called is walked else 1
        assert called.out.count(f"not observed, so not shown: {concern}") == times
        assert "idle" not in called.out or concern not in ("execution", "recovery")


NOT_POLICY = ("execution", "recovery", "world")
"""Concerns on which something else than policy rests that a decider may be told."""


@pytest.mark.parametrize("concern", few(CONCERNS, ("request",), CONCERNS[::2]))
def test_log_explain_and_view_name_what_is_not_observed(ledgers: dict[str, Path], tmp_path: Path, concern: str) -> None:
    ledger = ledgers[concern]
    logged = ask("log", ledger, "--run", "1")
    assert (logged.code, f"says nothing about it: {concern} (1 of 1 runs)" in logged.err) == (0, True)
    page = tmp_path / "page.html"
    assert ask("view", ledger, "--out", page).code == 0
    assert f'"not_observed":["{concern}"]' in page.read_text("utf-8")
    rests = types_read(library(), library().find("audit/request_timeline"))
    assert rests is not None
    explained = ask("explain", ledger, "--run", "1", "--json")
    names = {one["concern"] for one in json.loads(explained.out).get("not_observed", ())}
    assert names == ({concern} if any(CONCERN_OF.get(tag.partition(".")[0]) == concern for tag in rests) else set())


@pytest.mark.slow
def test_a_request_of_which_nothing_tells_the_end_has_no_result(ledgers: dict[str, Path]) -> None:
    found = open_ledger(ledgers["execution"]).requests(1).rows()
    assert {row["result"] for row in found} >= {None}
    assert not {row["result"] for row in found} & {"not begun", "not finished"}
    assert {row["failures"] for row in open_ledger(ledgers["recovery"]).requests(1).rows()} == {None}
    assert {row["denials"] for row in open_ledger(ledgers["request"]).requests(1).rows()} == {None}


@pytest.mark.parametrize(
    ("concern", "is_typeset"),
    [
        *(pytest.param(one, at % 8 == 1, marks=pytest.mark.slow) for at, one in enumerate(CONCERNS) if at % 2),
        *(pytest.param(one, True, marks=pytest.mark.soak) for at, one in enumerate(CONCERNS) if at % 8 != 1),
    ],
)
def test_the_report_has_no_number_of_what_is_not_observed(
    ledgers: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, concern: str, *, is_typeset: bool
) -> None:
    if not is_typeset:
        monkeypatch.setattr(build, "pdf", lambda *_: b"%PDF-")
        monkeypatch.setattr(layout, "_figure_svg", lambda *_: b"<svg/>")
    told = ask(
        *("report", ledgers[concern], "--kind", "paper"),
        *("--out", tmp_path / "report.pdf", "--numbers", tmp_path / "numbers.json"),
    )
    assert told.code == 0
    with from_table(pa.table({})) as database:
        rows = database.rows("SELECT judge, concern FROM metric_concerns")
    rests = {row["judge"] for row in rows if row["concern"] == concern}
    numbers = json.loads((tmp_path / "numbers.json").read_text())
    found = {
        row["metric"]: row["ours"]
        for row in numbers["numbers"]
        if row["table"] == "results" and row["architecture"] == "cfc"
    }
    assert {metric for metric in rests & found.keys() if found[metric] is not None} == set()
    assert any(found[metric] is not None for metric in found.keys() - rests) or rests >= found.keys()
