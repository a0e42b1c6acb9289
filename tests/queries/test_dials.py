"""The dials that the paper leaves open are read from what runs record, and runs that differ in anything else are not
alike."""

import json
from typing import Any

from fsar_ledger.designs.constants import Constants, Load
from fsar_ledger.metrics.results import dialled_rows
from tests.queries.histories import Row, answer, event, run
from tests.recycled import from_rows

COLUMNS = ("encounter_mean_s", "teams_working")


def made(run_id: str, world: dict[str, Any] | None = None, **more: Any) -> list[Row]:
    """A run that records these constants of the world and groups beside it."""
    size = more.pop("fleet_size", 4)
    return run(run_id=run_id, fleet_size=size, parameters=json.dumps({"world": world or {}, **more}))


def alike(*runs: list[Row]) -> int:
    """How many kinds of runs there are beside fleet size and dials."""
    return len(set(answer("staging/dials", *runs, columns=("made_alike_but",))))


def test_dials_are_those_that_runs_record() -> None:
    runs = [
        made("a", {"encounter_mean_s": 30.0}),
        made("b", fleet_size=16, load={"teams_working": 2}),
        made("c", fleet_size=16),
    ]
    default = Constants().world.encounter_mean_s
    assert sorted(answer("staging/dials", *runs, columns=COLUMNS)) == sorted([(30.0, 1), (default, 2), (default, 4)])


def test_the_teams_of_an_own_fleet_are_counted_by_its_own_robots() -> None:
    robots = [{"name": name, "capabilities": ["navigate.indoor"]} for name in ("porter", "door", "lift")]
    runs = [
        made("a", fleet_size=12, fleet={"name": "ward", "robots": robots}),
        made("b", fleet_size=12, fleet={"name": "ward", "robots": robots[:1]}),
        made("c", fleet_size=12, fleet={"name": "ward", "robots": robots}, load={"teams_working": 2}),
    ]
    assert sorted(answer("staging/dials", *runs, columns=("teams_working",))) == [(2,), (4,), (12,)]


def test_a_source_that_is_not_the_simulator_has_no_default_rate_of_encounters() -> None:
    assert answer("staging/dials", run(kind="live", parameters="{}"), columns=COLUMNS) == [(None, 1)]


def test_runs_that_differ_in_dials_and_fleet_size_are_alike_and_in_anything_else_not() -> None:
    base = made("a", {"motion_share": 0.5})
    loaded = {"teams_working": 2, "task_sets": Load().task_sets, "interval_s": Load().interval_s}
    same = [
        made("b", {"motion_share": 0.5, "encounter_mean_s": 30}),
        made("c", {"motion_share": 0.5}, fleet_size=16, load=loaded),
    ]
    assert alike(base, *same) == 1
    assert alike(base, made("d", {"motion_share": 0.6})) == 2
    assert alike(base, made("e", {"motion_share": 0.5}, load={"task_sets": 2})) == 2
    assert alike(base, run(run_id="f", parameters='{"world":{"motion_share":0.5}}', model_version="another")) == 2
    assert alike(run(run_id="g", parameters="{"), run(run_id="h", parameters="[")) == 2, (
        "what cannot be read may be anything"
    )


def test_each_summary_has_the_dials_of_its_runs() -> None:
    called = event("SupervisorCalled", 1, supervisor="supervisor/fleet")
    runs = [made(f"{mean}-{at}", {"encounter_mean_s": mean}) for mean in (30.0, 60.0) for at in range(2)]
    runs.append(run(called, run_id="called", run=2, parameters='{"world":{"encounter_mean_s":30.0}}'))
    with from_rows([row for rows in runs for row in rows]) as database:
        found = [row for row in dialled_rows(database) if row.metric == "human_intervention" and row.scenario is None]
    assert [(row.encounter_mean_s, row.mean, row.n) for row in found] == [(30.0, 1 / 3, 3), (60.0, 0.0, 2)]


def test_runs_of_a_workflow_and_forks_have_their_own_dials_beside_runs_of_a_scenario() -> None:
    """The three record the same constants and the same kind, `simulated`."""
    others = (run(run_id="w", scenario="workflow-door-relay"), run(run_id="f", changes=["drop w"]))
    with from_rows([row for rows in (made("a"), *others) for row in rows]) as database:
        found = [row for row in dialled_rows(database) if row.metric == "human_intervention" and row.scenario is None]
    assert sorted((row.kind, row.n) for row in found) == [("fork", 1), ("simulated", 1), ("workflow", 1)]
    assert alike(made("a"), *others) == len({row.setting for row in found}) == 3
