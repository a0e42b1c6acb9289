"""`info` says what was planned and what of it is there, and never more than a ledger can know."""

import json
import shlex
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.api.report import beyond
from fsar_ledger.api.simulate import before
from fsar_ledger.designs.constants import Constants, Load, WorldConstants
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.keys import read_signer
from fsar_ledger.ledger.store.record import EMPTY_HEAD
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime import experiment as module
from fsar_ledger.runtime import experiment_arguments
from fsar_ledger.runtime.experiment import ORIGIN, Experiment, SimulationResult, run_experiment
from fsar_ledger.runtime.experiment_arguments import MAX_COUNTS, MAX_RUNS, PlanRow, reproducing
from fsar_ledger.runtime.paper import Name, PaperLedger, paper_ledger
from fsar_ledger.runtime.simulation import RunSpec, plan_id, plan_record, run_started, simulate_run
from tests.ledger.hostile import stage_anything
from tests.quick import few
from tests.runtime.test_plans import Stopped, stop_after

from .conftest import Call, one_message

VIOLATED = "policy_violations > 0"
OTHER = Constants(world=WorldConstants(window_mean_s=12.0))
OURS = f"world.window_mean_s={WorldConstants().window_mean_s}"


def small(*architectures: Architecture, **given: Any) -> Experiment:
    """Two runs of each, unless something else is given."""
    return Experiment(architectures or ("fsar",), **{"scenarios": ("door-relay",), "runs": 2, **given})


def planned_only(path: Path, experiment: Experiment, origin: str = ORIGIN) -> None:
    """Make an experiment that was interrupted right after its plan."""
    with pytest.raises(Stopped):
        run_experiment(path, experiment, 1, stop_after(0), origin=origin)


def info(call: Call, path: Path) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads(call("info", path, "--json").out)
    return answer


def said(call: Call, path: Path) -> str:
    return call("info", path).out


def live(name: str) -> LedgerRun:
    """A run that was not simulated, and has only just begun."""
    started = msgspec.structs.replace(
        run_started(RunSpec(1, "fsar", "full", "door-relay", 4, 0), Constants()), kind="live", scenario="live"
    )
    return LedgerRun(name, (0,), (None,), (started,))


def appended(path: Path, *runs: LedgerRun) -> None:
    with Writer(path, ORIGIN) as writer:
        writer.append(stage(path, runs))


def test_a_ledger_with_all_that_was_planned_is_complete(call: Call, ledger: Path) -> None:
    found = info(call, ledger)
    assert (found["is_complete"], found["runs"], found["runs_unplanned"]) == (True, 12, {})
    [plan] = found["plans"]
    names = ("planned_count", "there_count", "missing_count", "run_count", "continues_with")
    assert [plan[name] for name in names] == [12, 12, 0, 2, None]
    assert plan["scenarios"] == ["door-relay", "failure-recovery-chain"]
    assert "12 runs, complete: all planned runs are there" in said(call, ledger)


@pytest.mark.slow
def test_an_interrupted_experiment_is_not_complete_and_the_call_that_goes_on_is_told(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, experiment = tmp_path / "a ledger", small("fsar", "cfc", runs=3, seed=5)
    monkeypatch.setattr(module, "COMMIT_EVENTS", 1_300)  # two runs, of some 600 each
    with pytest.raises(Stopped):
        run_experiment(path, experiment, 1, stop_after(1))
    monkeypatch.undo()
    found = info(call, path)
    [plan] = found["plans"]
    assert (found["is_complete"], found["runs"], plan["there_count"], plan["planned_count"]) == (False, 2, 2, 6)
    assert plan["continues_with"] == (
        f"fsar-ledger simulate '{path}' --architecture cfc --architecture fsar --scenario door-relay --runs 3 --seed 5"
    )
    assert (
        f"2 of 6 runs of door-relay x 3 runs x cfc, fsar, seed 5, 4 robots; continue with: {plan['continues_with']}\n"
        in said(call, path)
    )
    made = call(*shlex.split(plan["continues_with"])[1:], "--json")
    assert [json.loads(made.out)[f"runs_{name}"] for name in ("asked", "made", "held")] == [6, 4, 6]
    assert info(call, path)["is_complete"] is True


@pytest.mark.parametrize(
    "experiment",
    [
        small("fsar", configurations=("without-policy-composition", "without-trust-evaluation")),
        small("fsar", scenarios=("workflow-layered-recovery", "workflow-door-relay"), seed=6),
        small("fsar", "cfc", fleet_size=8, runs=1, constants=Constants(load=Load(teams_working=1, task_sets=2))),
    ],
)
def test_the_call_that_goes_on_plans_nothing_new(call: Call, tmp_path: Path, experiment: Experiment) -> None:
    planned_only(tmp_path / "ledger", experiment, "example.org/other")
    [plan] = info(call, tmp_path / "ledger")["plans"]
    assert plan["continues_with"] is not None
    assert plan["continues_with"].endswith("--origin example.org/other")
    assert call(*shlex.split(plan["continues_with"])[1:], "--workers", "1").code == 0
    found = info(call, tmp_path / "ledger")
    assert (found["is_complete"], found["runs"], len(found["plans"])) == (True, experiment.size, 1)


def test_a_signed_ledger_goes_on_with_a_key(call: Call, tmp_path: Path) -> None:
    call("key", "new", tmp_path / "key", "--name", "example.org/fleet")
    signer = read_signer(tmp_path / "key")
    with pytest.raises(Stopped):
        run_experiment(tmp_path / "ledger", small(), 1, stop_after(0), signer)
    [plan] = info(call, tmp_path / "ledger")["plans"]
    assert plan["continues_with"].endswith("--architecture fsar --scenario door-relay --runs 2 --key KEY")


@pytest.mark.parametrize(("folder", "is_reproduced"), [("ablation", True), ("elsewhere", False)])
def test_a_ledger_that_reproduce_signed_under_a_name_of_its_own_goes_on_with_reproduce(
    call: Call, tmp_path: Path, folder: str, is_reproduced: bool
) -> None:
    call("key", "new", tmp_path / "key", "--name", "example.org/fleet")
    experiment, path = paper_ledger("ablation", 1), tmp_path / "paper" / folder
    with pytest.raises(Stopped):
        run_experiment(path, experiment.parts[1], 1, stop_after(0), experiment.signer(read_signer(tmp_path / "key")))
    [plan] = info(call, path)["plans"]
    wanted = (
        f"fsar-ledger reproduce --out {shlex.quote(str(path.parent))} --only ablation --runs 1 --key KEY"
        if is_reproduced
        else None
    )
    assert plan["continues_with"] == wanted


def test_however_many_counts_of_runs_the_plans_of_a_ledger_name_only_the_largest_are_tried_and_each_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ablation = tmp_path / "ablation"
    planned_only(ablation, paper_ledger("ablation", 1).parts[1], paper_ledger("ablation", 1).origin)
    tried: list[int | None] = []

    def made(name: Name, runs: int | None) -> PaperLedger:
        tried.append(runs)
        return paper_ledger(name, 1)

    monkeypatch.setattr(experiment_arguments, "paper_ledger", made)
    reproducing({str(count): count for count in range(10_001)}, PlanRow(ablation, open_ledger(ablation)))
    assert tried == [None, *range(MAX_RUNS - MAX_COUNTS + 1, MAX_RUNS + 1)]


@pytest.mark.parametrize(("runs", "said"), [(6, "--runs 6"), (40, "ablation")])
def test_a_ledger_is_continued_with_as_many_runs_as_all_of_its_plans_add_up_to(
    tmp_path: Path, runs: int, said: str
) -> None:
    ablation, whole = tmp_path / "ablation", paper_ledger("ablation", runs)
    planned_only(ablation, whole.parts[0], whole.origin)
    calls = reproducing(
        {plan_id(part.plan()): part.runs for part in whole.parts}, PlanRow(ablation, open_ledger(ablation))
    )
    assert len(calls) == len(whole.parts)
    assert {call.endswith(said) for call in calls.values()} == {True}


def test_two_shapes_in_one_ledger_are_two_plans_and_both_are_complete(call: Call, tmp_path: Path) -> None:
    run_experiment(tmp_path / "ledger", small("fsar", runs=3), 1)
    run_experiment(tmp_path / "ledger", small("cfc", scenarios=("fleet-contention",), runs=1), 1)
    found = info(call, tmp_path / "ledger")
    assert (found["is_complete"], found["runs"]) == (True, 4)
    assert [plan["planned_count"] for plan in found["plans"]] == [3, 1]
    assert {group["architecture"]: group["runs_to_rectangle"] for group in found["groups"]} == {"fsar": 3, "cfc": 5}
    text = said(call, tmp_path / "ledger")
    assert "4 runs, complete: all planned runs are there" in text
    assert "not a rectangle: 8 runs fewer" in text
    assert "enlarged: " not in text


def test_what_two_interrupted_experiments_have_in_common_is_missing_once(call: Call, tmp_path: Path) -> None:
    planned_only(tmp_path / "ledger", small("fsar", "cfc", runs=3))
    planned_only(tmp_path / "ledger", small("fsar", scenarios=("door-relay", "fleet-contention")))
    found = info(call, tmp_path / "ledger")
    assert ([plan["missing_count"] for plan in found["plans"]], found["missing_count"]) == ([6, 4], 8)
    assert "0 runs, not complete: 8 planned runs are missing\n" in said(call, tmp_path / "ledger")


def test_two_parameter_sets_are_told_apart_and_the_constants_named(call: Call, tmp_path: Path) -> None:
    run_experiment(tmp_path / "ledger", small(runs=3), 1)
    planned_only(tmp_path / "ledger", small(constants=OTHER))
    run_experiment(tmp_path / "ledger", small(runs=1, constants=OTHER), 1)
    found = info(call, tmp_path / "ledger")
    told = sorted((group["constants"], group["runs"], group["runs_to_rectangle"]) for group in found["groups"])
    assert told == [("A", 3, 0), ("B", 1, 0)]
    assert [model["differing"] for model in found["models"]] == [OURS, "world.window_mean_s=12"]
    result = [(plan["planned_count"], plan["missing_count"], plan["continues_with"]) for plan in found["plans"]]
    assert result == [(3, 0, None), (2, 1, None), (1, 0, None)]
    assert found["is_complete"] is False
    text = said(call, tmp_path / "ledger")
    assert (
        "1 of 2 runs of door-relay x 2 runs x fsar, seed 42, 4 robots; continue with the version and the "
        "constants that began it" in text
    )
    assert f"constants A: simulated, model version 3, 3 runs: {OURS}\n" in text
    assert "constants B: simulated, model version 3, 1 run: world.window_mean_s=12\n" in text


def test_a_constant_of_a_group_that_is_absent_is_named_with_its_default(call: Call, tmp_path: Path) -> None:
    run_experiment(tmp_path / "ledger", small(), 1)
    run_experiment(
        tmp_path / "ledger",
        small(runs=1, fleet_size=8, constants=Constants(load=Load(teams_working=1, task_sets=2))),
        1,
    )
    text = said(call, tmp_path / "ledger")
    assert "constants A: simulated, model version 3, 2 runs: load.task_sets=1, load.teams_working=default\n" in text
    assert "constants B: simulated, model version 3, 1 run: load.task_sets=2, load.teams_working=1\n" in text


def test_runs_of_two_models_are_told_by_their_versions(call: Call, tmp_path: Path) -> None:
    run_experiment(tmp_path / "ledger", small(), 1)
    foreign = RunStarted(kind="foreign", observes=(), source="example.org")
    appended(tmp_path / "ledger", LedgerRun("night", (0,), (None,), (foreign,)), live("shift"))
    text = said(call, tmp_path / "ledger")
    assert "constants A: simulated, model version 3, 2 runs\n" in text
    assert "constants B: live, model version 3, 1 run\n" in text
    assert "no constants on record: foreign, example.org, no model, 1 run\n" in text


def test_runs_that_were_not_simulated_are_in_no_plan_and_nothing_is_said_of_what_is_missing(
    call: Call, tmp_path: Path
) -> None:
    run_experiment(tmp_path / "ledger", small(), 1)
    appended(tmp_path / "ledger", live("shift-1"), live("shift-2"))
    found = info(call, tmp_path / "ledger")
    assert (found["is_complete"], found["runs"], found["runs_unplanned"]) == (None, 4, {"live": 2})
    text = said(call, tmp_path / "ledger")
    assert "planned runs: complete" in text
    assert "other runs: 2 live; no plan names them, so nothing shows whether any are missing" in text


def test_runs_of_another_system_have_no_model_and_no_rectangle(call: Call, tmp_path: Path) -> None:
    appended(
        tmp_path / "ledger",
        LedgerRun("night", (0,), (None,), (RunStarted(kind="foreign", observes=(), source="example.org"),)),
    )
    found = info(call, tmp_path / "ledger")
    assert (found["is_complete"], found["runs"], found["runs_unplanned"]) == (None, 1, {"foreign": 1})
    assert [
        (group["scenarios"], group["seed"], group["runs_to_rectangle"], group["events"]) for group in found["groups"]
    ] == [(0, None, None, 1)]
    text = said(call, tmp_path / "ledger")
    assert "1 run; no plan is on record" in text
    assert "foreign, example.org, no model\n" in text
    assert "rectangle:" not in text


def test_runs_say_when_they_begin_where_they_know_it(call: Call, tmp_path: Path) -> None:
    started = RunStarted(kind="foreign", observes=(), source="example.org")
    dated = [msgspec.structs.replace(started, epoch=f"2026-03-0{day}T22:00:00Z") for day in (2, 1)]
    said_of = {}
    for count, runs in enumerate(([started], dated[:1], [started, *dated])):
        path = tmp_path / f"{count}"
        appended(path, *(LedgerRun(f"{number}", (0,), (None,), (one,)) for number, one in enumerate(runs)))
        said_of[count] = info(call, path)["begins"], [line for line in said(call, path).splitlines() if "day" in line]
    first, second = "2026-03-01T22:00:00Z", "2026-03-02T22:00:00Z"
    assert said_of == {
        0: (None, []),
        1: ({"runs": 1, "first": second, "last": second}, [f"the run with a time of day begins {second}"]),
        2: ({"runs": 2, "first": first, "last": second}, [f"2 runs with a time of day begin from {first} to {second}"]),
    }


@pytest.mark.parametrize(("numbers", "shape"), [((0, 1), "a rectangle"), ((0, 2), "not a rectangle: 1 run fewer")])
def test_a_ledger_without_a_plan_is_never_complete(
    call: Call, tmp_path: Path, numbers: tuple[int, ...], shape: str
) -> None:
    appended(
        tmp_path / "ledger",
        *(simulate_run(RunSpec(42, "fsar", "full", "door-relay", 4, number), Constants()) for number in numbers),
    )
    found = info(call, tmp_path / "ledger")
    assert (found["is_complete"], found["plans"], found["runs_unplanned"]) == (None, [], {"simulated": 2})
    text = said(call, tmp_path / "ledger")
    assert "2 runs; no plan is on record, so nothing shows whether any are missing" in text
    assert shape in text
    assert "complete" not in text


def test_a_plan_of_strange_names_is_shown_and_never_continued(call: Call, tmp_path: Path) -> None:
    planned = msgspec.structs.replace(small().plan(), scenarios=("door\x1b[31m", "$(reboot)"), run_count=2**53 - 1)
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        writer.append(stage_anything(tmp_path / "ledger", [plan_record(planned)]))
    [plan] = info(call, tmp_path / "ledger")["plans"]
    assert (plan["planned_count"], plan["continues_with"]) == (2 * (2**53 - 1), None)
    text = said(call, tmp_path / "ledger")
    assert "$(reboot), door\\x1b[31m x 9,007,199,254,740,991 runs x fsar" in text
    assert "\x1b" not in text


def test_a_ledger_without_anything_says_so(call: Call, tmp_path: Path) -> None:
    with Writer(tmp_path / "ledger", ORIGIN):
        pass
    assert info(call, tmp_path / "ledger")["is_complete"] is None
    assert "no runs yet, and no plan on record" in said(call, tmp_path / "ledger")


def test_an_enlarged_ledger_says_so_and_fewer_runs_are_nothing_to_do(call: Call, tmp_path: Path) -> None:
    options = ("--architecture", "fsar", "--scenario", "door-relay", "--workers", "1", "--runs")
    call("simulate", tmp_path / "ledger", *options, 2)
    assert "enlarged: " not in said(call, tmp_path / "ledger")
    assert (
        "made 1 run; 2 of the 3 requested were already there" in call("simulate", tmp_path / "ledger", *options, 3).out
    )
    assert "enlarged: 1 of 2 plans is part of a larger one; runs, run ids and metrics are as if" in said(
        call, tmp_path / "ledger"
    )
    before = info(call, tmp_path / "ledger")
    assert before["is_complete"] is True
    again = call("simulate", tmp_path / "ledger", *options, 1)
    said_last = again.out.splitlines()[-1]
    assert (again.code, said_last) == (0, "nothing to do: the 1 requested run is already there, and 2 more")
    assert info(call, tmp_path / "ledger") == before


def test_runs_beyond_the_papers_experiment_are_told() -> None:
    made = SimulationResult(EMPTY_HEAD, runs_asked=300, runs_made=0, runs_held=301)
    assert before(made) == ["nothing to do: the 300 requested runs are already there, and 1 more"]
    assert beyond(made) == [
        "the ledger holds 1 run beyond the 300 of the paper's experiment, and they are also judged here"
    ]
    assert before(SimulationResult(EMPTY_HEAD, 20, 20, 30)) == ["made 20 runs, beside 10 of other experiments"]
    assert before(fresh := SimulationResult(EMPTY_HEAD, 20, 20, 20)) == beyond(fresh) == []


@pytest.mark.slow
def test_what_is_judged_before_all_planned_runs_are_there_says_so(call: Call, tmp_path: Path, ledger: Path) -> None:
    planned_only(tmp_path / "ledger", small("fsar", "cfc", runs=3))
    run_experiment(tmp_path / "ledger", small("fsar", "cfc", runs=1), 1)
    call("verify", tmp_path / "ledger")
    for command in ("metrics", "statistics"):
        warned = call(command, tmp_path / "ledger")
        one_message(
            warned,
            0,
            "not complete: 4 of the 6 runs of a plan are missing",
            f"`fsar-ledger info {tmp_path / 'ledger'}`",
        )
    call("verify", ledger)
    assert call("metrics", ledger).err == ""


def test_a_plan_without_runs_is_not_said_to_have_been_replayed(call: Call, tmp_path: Path) -> None:
    planned_only(tmp_path / "ledger", small())
    said = call("verify", tmp_path / "ledger", "--replay").good()
    assert "1 event of 0 runs in 1 commit\n" in said.out
    assert said.out.endswith("\nreplayed: nothing; the ledger holds no run\n")


CHANGED = ("--change", "drop window:*")
JUDGED = [
    *(("metrics",), ("statistics",), ("audit",), ("whatif", "--all-runs", *CHANGED)),
    *(("bisect", *sides, "--outcome", VIOLATED) for sides in (CHANGED, ("--first", "fsar", "--second", "cfc"))),
]


@pytest.mark.parametrize("asked", few(JUDGED, JUDGED[:1] + JUDGED[-1:]))
def test_programs_are_told_that_planned_runs_are_missing(call: Call, tmp_path: Path, asked: tuple[str, ...]) -> None:
    planned_only(tmp_path / "ledger", small("fsar", "cfc", runs=2))
    run_experiment(tmp_path / "ledger", small("fsar", "cfc", runs=1), 1)
    said = call(asked[0], tmp_path / "ledger", *asked[1:], "--json")
    answer = json.loads(said.out)
    assert (answer["complete"], answer["missing_count"]) == (False, 2)
    assert "not complete: 2 of the 4 runs of a plan are missing" in said.err
