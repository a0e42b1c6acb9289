"""What a change does, over pairs of runs that share every draw."""

import json
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest
from scipy import stats

from fsar_ledger.analysis.fork_base import Base, base_of_record, rerun
from fsar_ledger.analysis.whatif import EFFECTS, VALUES, Effect, Pair, changes_of, commit_pairs, effects, forks_of
from fsar_ledger.analysis.whatif import RUNS as ROWS
from fsar_ledger.api.ledger import open_ledger as open_forks
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.world import PolicyWindowOpened, TaskArrived
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.ledger.verify import verify
from fsar_ledger.metrics.comparison_sides import beside
from fsar_ledger.metrics.database import connect, from_table
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.replay import replay
from tests.analysis.conftest import simulated

ROOT = "0b" * 32
FIRST, RUNS = 8, 12
"""Runs of FSAR of which the first has one violation under its window fleet/B1/5, and one other does."""
ASKS = 31
"""A run in which a supervisor is called."""
Values = np.ndarray[tuple[int], np.dtype[np.float64]]


@pytest.fixture(scope="module")
def bases() -> list[Base]:
    return [base_of_record(simulated("fsar", run), ROOT) for run in range(FIRST, FIRST + RUNS)]


@pytest.fixture(scope="module")
def asking() -> Base:
    return base_of_record(simulated("fsar", ASKS), ROOT)


@pytest.fixture(scope="module")
def pairs(bases: list[Base]) -> list[Pair]:
    return list(forks_of(bases, parsed(["drop window:fleet/B1/*"])))


def values(records: list[LedgerRun], metric: str) -> Values:
    with from_table(encode(records)) as database:
        rows = database.rows(f"SELECT run_id, value FROM {metric}")
    found = {row["run_id"]: row["value"] for row in rows}
    return np.array([found[record.run_id] for record in records], float)


def both_values(pairs: list[Pair], metric: str) -> tuple[Values, Values]:
    """The metric of each base, and of each fork."""
    return values([pair.base.record for pair in pairs], metric), values([pair.fork.record for pair in pairs], metric)


def effect(pairs: list[Pair], metric: str) -> Effect:
    _, (found,) = effects(pairs)
    return next(row for row in found.rows if row.metric == metric)


@pytest.mark.slow
def test_the_means_and_the_difference_are_those_of_the_runs(pairs: list[Pair]) -> None:
    for metric in ("policy_violations", "authority_conflicts", "coordination_success"):
        found = effect(pairs, metric)
        base, fork = both_values(pairs, metric)
        assert found.n == RUNS
        assert found.base_mean == pytest.approx(base.mean())
        assert found.fork_mean == pytest.approx(fork.mean())
        assert found.difference == pytest.approx((fork - base).mean())
        assert found.differing_pairs == (fork != base).sum()
        if (fork != base).any():
            assert found.gain == pytest.approx((fork.var(ddof=1) + base.var(ddof=1)) / (fork - base).var(ddof=1))


@pytest.mark.slow
def test_where_few_pairs_differ_the_test_is_the_exact_sign_test(pairs: list[Pair]) -> None:
    found = effect(pairs, "policy_violations")
    base, fork = both_values(pairs, "policy_violations")
    more, less = int((fork > base).sum()), int((fork < base).sum())
    assert 0 < more + less < RUNS / 2
    assert found.test == "sign"
    assert found.p == pytest.approx(stats.binomtest(min(more, less), more + less).pvalue)


@pytest.mark.slow
def test_the_intervals_are_those_of_compare(pairs: list[Pair], tmp_path: Path) -> None:
    commit_pairs(tmp_path / "forks", pairs)
    compared = open_forks(tmp_path / "forks").compare("fsar+fork", "fsar")
    expected = [(row.metric, row.ci_low, row.ci_high, row.test, row.p) for row in compared.rows]
    _, (found,) = effects(pairs)
    assert [(row.metric, row.low, row.high, row.test, row.p) for row in found.rows] == expected
    few = effect(pairs, "policy_violations")
    base, fork = both_values(pairs, "policy_violations")
    half = stats.t.ppf(0.975, few.differing_pairs - 1) * stats.sem(fork - base)
    assert few.test == "sign"
    assert (few.low, few.high) == pytest.approx(((fork - base).mean() - half, (fork - base).mean() + half))


def test_a_fork_without_a_change_has_no_effect(bases: list[Base]) -> None:
    parted, (found,) = effects(list(forks_of(bases, ())))
    assert [one.parts_at for one in parted] == [None] * RUNS
    assert found.diverging == 0
    for row in found.rows:
        assert row.difference in (0.0, None)
        assert (row.differing_pairs, row.test, row.p) == (0, None, None)
        assert (row.low is None) == (row.metric != "human_intervention"), "a share of runs has an interval also at 0"


def test_one_pair_has_values_and_no_intervals(bases: list[Base]) -> None:
    _, (found,) = effects(list(forks_of(bases[:1], parsed(["drop window:fleet/B1/5"]))))
    (row,) = [row for row in found.rows if row.metric == "policy_violations"]
    assert (row.base_mean, row.fork_mean, row.difference, row.n) == (1.0, 0.0, -1.0, 1)
    assert (row.low, row.high, row.p, row.gain) == (None, None, None, None)


@pytest.mark.parametrize("change", ["drop window:*", "drop task:*", "architecture cfc"])
def test_one_pair_is_counted_as_one_of_many_is(bases: list[Base], change: str) -> None:
    ((pair,), counts) = list(forks_of(bases[:1], parsed([change]))), ("metric", "n", "differing_pairs", "difference")
    with from_table(encode(list(pair.records))) as database:
        rows = database.table(ROWS)
    base, fork = (rows.filter(pc.equal(rows["run_id"], one.run_id)) for one in pair.records)
    with beside(fork, base) as database:
        alone, many = database.rows(VALUES), database.rows(EFFECTS)
    assert [[row[name] for name in counts] for row in alone] == [[row[name] for name in counts] for row in many]
    for one, each in zip(alone, many, strict=True):
        assert not each["n"] or [one["base_mean"], one["fork_mean"]] == [each["base_mean"], each["fork_mean"]]
    assert {row["n"] for row in alone} >= ({0, 1} if change == "drop task:*" else {1})


def test_architectures_are_judged_apart(bases: list[Base]) -> None:
    both = [*bases[:3], *(base_of_record(simulated("cfc", run), ROOT) for run in range(2))]
    _, found = effects(list(forks_of(both, parsed(["drop window:*"]))))
    assert [(one.architecture, one.pairs) for one in found] == [("fsar", 3), ("cfc", 2)]


@pytest.mark.slow
def test_many_pairs_judged_in_parts_are_judged_alike(pairs: list[Pair], monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = effects(pairs)
    monkeypatch.setattr("fsar_ledger.analysis.whatif.EVENTS_AT_ONCE", 1_000)
    assert effects(pairs) == at_once


def test_forks_are_kept_beside_their_bases_and_replay(pairs: list[Pair], tmp_path: Path) -> None:
    place = tmp_path / "forks"
    head = commit_pairs(place, pairs)
    assert verify(place).ok
    assert replay(place).ok
    with connect(place) as database:
        rows = database.rows("SELECT * FROM forks ORDER BY run_id")
    assert {row["run_id"] for row in rows} == {pair.fork.record.run_id for pair in pairs}
    assert all(row["base_run_id"] == row["forked_from_run"] for row in rows)
    parts = {pair.fork.record.run_id: pair.fork.parts_at for pair in pairs}
    assert {row["run_id"]: row["diverges"] for row in rows} == {run: at is not None for run, at in parts.items()}
    assert commit_pairs(place, pairs) == head, "what is there is not written again"
    assert len(list(open_ledger(place).runs())) == 2 * RUNS


def test_forks_are_no_planned_runs_and_have_a_setting_of_their_own(pairs: list[Pair], tmp_path: Path) -> None:
    place = tmp_path / "forks"
    commit_pairs(place, pairs[:2])
    with connect(place) as database:
        kinds = database.rows("SELECT DISTINCT kind, constants FROM run_settings ORDER BY kind")
        assert kinds == [
            {"kind": "fork", "constants": "drop window:fleet/B1/*"},
            {"kind": "simulated", "constants": None},
        ]
        assert database.rows("SELECT * FROM planned_runs") == []
        settings = database.rows("SELECT count(DISTINCT setting) AS settings FROM run_settings")
        assert settings == [{"settings": 2}]


BAD = [
    ("drop window:fleet/B1/9", "did you mean window:fleet/D1/9"),
    ("drop windw:fleet/B1/1", "did you mean window:fleet/B1/1"),
    ("answer call:7 deny", "the run has no question call:7; did you mean call:1"),
    ("answer cll:1 deny", "did you mean call:"),
    ("answer call:1 maybe", "expected approve, deny or other"),
    ("answer call:1 approve", "it has no effect, the answer is approve already"),
    ("answer attempt:A1-1/1.1/1 soon", "expected hold or fail"),
    ("answer response:1 soon", "expected a length"),
    ("add off:Z9 3s for 5s", "robot: found robot/Z9, expected one of the fleet"),
    ("add absence:Z9 3s for 5s", "supervisor: found supervisor/Z9, expected one of the fleet"),
    ("add off:B1 3000s for 5s", "the run has ended by then"),
    ("rule fleet deny from 900s", "the run has ended by then"),
    ("set world.review_share=0.5 from 900s", "the run has ended by then"),
    ("rule fleet deny robot=Z9", "is rejected: unknown robot robot/Z9"),
    ("rule fleet deny capability=fly", "is rejected: unknown capability fly"),
    ("trust A1 Z9 none", "is rejected: unknown robot robot/Z9"),
    ("rule fleet deny task=A1-11", "the run has no task A1-11; did you mean A1-1"),
    ("trust A1 B1 none task=Z9-9", "the run has no task Z9-9; expected one of A1-1"),
    ("move task:A1-1 -900s", "after the beginning of the run"),
    ("set structure.poll_us=999999", "it has no effect on the run"),
]


def task(**fields: object) -> str:
    """An added task of A1 with these fields, which is possible without them."""
    whole = {"task_id": "A1-9", "robot": "robot/A1", "team": 1, "steps": ["A navigate.indoor"], "budget_us": 50_000_000}
    return f"add 20s {json.dumps({'type': 'TaskArrived', **whole, **fields})}"


def end(at: str, window: str) -> str:
    fields = {"type": "PolicyWindowClosed", "robot": "robot/B1", "scope": "fleet", "window": window}
    return f"add {at} {json.dumps(fields)}"


ASKED = {"type": "OutsiderRequestInjected", "task_id": "q", "robot": "robot/A1", "peer": "robot/C1"}
SUBMITTED = {"command": "SubmitTask", "by": "service/desk", "robot": "robot/A1", "budget_us": 50_000_000}
BAD += [
    ("drop off:B1/0", "the run has no fact off:B1/0; it has none of this kind; `whatif"),
    ("answer response:A1-1/1.1 never", "the run has no question response:A1-1/1.1; did you mean response:"),
    (f"{end('20s', 'fleet/B1/at-20s-for-0s')}", "window: found fleet/B1/at-20s-for-0s, which is not there then"),
    (task(steps=["A navigate.indoor", "A door.open.basic Z"]), "found Z, expected one of the robots of fleet paper"),
    (task(steps=["A carry.heavy"]), "found carry.heavy, which A cannot do, expected a capability of A's own"),
    (task(steps=[]), "steps: found none, expected at least one step"),
    (task(team=2), "team: found 2, expected 1, that of robot/A1"),
    (task(robot=None), "robot: found none, expected a robot of the fleet"),
    (task(budget_us=None), "budget_us: found none, expected its budget"),
    (task(task_id="A1/9"), "task_id: found A1/9, expected a name without a slash"),
    (task(checkpoints=["2"]), r"checkpoints\[0\]: found 2, expected one of the numbers of its steps"),
    (task(task_id="A1-1"), "task_id: found A1-1, which is taken, expected a new name"),
    (f"add 1s {json.dumps({**SUBMITTED, 'task_id': 'A1-1', 'steps': ['A navigate.indoor']})}", "A1-1, which is taken"),
    (f"add 20s {json.dumps({**ASKED, 'capability': 'carry.hevy'})}", "found carry.hevy, .*did you mean carry.heavy"),
    (end("20s", "fleet/B1/77"), "window: found fleet/B1/77, which is not there then"),
    (end("200s", "fleet/B1/0"), "window: found fleet/B1/0, which is not there then"),
]


@pytest.mark.parametrize(("text", "message"), BAD)
def test_a_change_that_does_nothing_in_the_run_is_an_error(asking: Base, text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        rerun(asking).fork_with_effect(parsed([text]))


def test_two_facts_of_one_name_are_an_error_in_every_call(asking: Base) -> None:
    texts = ["add window:fleet/B1 20s for 5s", "add window:fleet/B1 20s for 5s review"]
    with pytest.raises(UsageError, match="found fleet/B1/at-20s-for-5s, which is taken"):
        rerun(asking).fork_with_effect(parsed(texts))
    with pytest.raises(UsageError, match=f"which is taken, .* that is run {asking.record.run_id}"):
        list(forks_of([asking], parsed(texts)))


def test_a_window_of_no_length_has_begun_when_it_ends(asking: Base) -> None:
    added = parsed(["add window:fleet/B1 20s for 0s"])
    assert rerun(asking).fork_with_effect(added).parts_at is not None


def test_a_task_takes_the_name_of_one_that_does_not_arrive(asking: Base) -> None:
    found = rerun(asking).fork_with_effect(parsed(["drop task:A1-1", task(task_id="A1-1")]))
    arrived = [event for event in found.record.events if isinstance(event, TaskArrived) and event.task_id == "A1-1"]
    assert [event.steps for event in arrived] == [("A navigate.indoor",)]


def test_an_end_that_is_added_where_nothing_has_begun_is_refused_and_no_effect(asking: Base) -> None:
    window = next(event for event in asking.record.events if isinstance(event, PolicyWindowOpened))
    opened_s = asking.record.times_us[asking.record.events.index(window)] / 1e6
    fields = {"type": "PolicyWindowClosed", "robot": window.robot, "scope": window.scope, "window": window.window}
    ((early,), (then,)) = (
        list(forks_of([asking], parsed([f"add {at_s}s {json.dumps(fields)}"])))
        for at_s in (opened_s - 1, opened_s + 0.01)
    )
    assert early.refused is not None
    assert early.refused.is_same
    assert then.refused is None


@pytest.mark.parametrize(
    "texts", [["answer call:1 deny", "drop task:*"], ["answer call:* deny", "answer call:1 approve"]], ids="; ".join
)
def test_an_answer_that_another_change_takes_away_is_not_said_to_be_so_already(asking: Base, texts: list[str]) -> None:
    with pytest.raises(UsageError, match="with the other changes nobody asks that, or another of them answers it"):
        rerun(asking).fork_with_effect(parsed(texts))


def test_a_run_that_is_not_as_it_is_made_is_not_forked_and_its_event_is_named(bases: list[Base]) -> None:
    record = bases[0].record
    times = [*record.times_us]
    times[250] += 1
    tampered = LedgerRun(record.run_id, times, record.caused_by, record.events)
    with pytest.raises(UsageError, match="event 250: the record is not what its world and its handlers make"):
        rerun(base_of_record(tampered, ROOT))


def test_a_fork_is_not_forked_again(bases: list[Base]) -> None:
    fork = rerun(bases[0]).fork(parsed(["drop window:*"])).record
    with pytest.raises(
        UsageError, match=f"found a fork, expected the run that it forks from, {bases[0].record.run_id}"
    ):
        base_of_record(fork, ROOT)


@pytest.mark.parametrize("architecture", ["cfc", "dhma"])
def test_a_density_is_on_record_where_nobody_goes_by_it_and_other_commands_are_refused(architecture: str) -> None:
    base = rerun(base_of_record(simulated(architecture, 0), ROOT))
    fork = base.fork_with_effect(parsed(["density all 1"])).record
    assert [type(one).__name__ for one in fork.events if one not in base.base.record.events][1:] == [
        "SupervisionDensitySet"
    ]
    assert len(fork.events) == len(base.base.record.events) + 1
    for text in ("rule fleet deny", "trust A1 B1 none", "budget B1 local 5s 1"):
        with pytest.raises(UsageError, match=f"{architecture} decides no such command, expected a run of fsar"):
            base.fork_with_effect(parsed([text]))


def test_the_base_and_nobody_who_asks_says_what_held_before(tmp_path: Path) -> None:
    file = tmp_path / "changes.toml"
    file.write_text('[[changes]]\nchange = "architecture"\narchitecture = "cfc"\nbefore = "jade"\n')
    asked = changes_of(["set world.review_share=0.7 instead of 0.5", "without shared-registry instead of nothing"])
    assert [*map(str, asked)] == ["set world.review_share=0.7", "without shared-registry"]
    assert [*map(str, changes_of(str(file)))] == ["architecture cfc"]
