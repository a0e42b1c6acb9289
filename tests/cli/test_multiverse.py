"""`study run multiverse` for people and for programs: ranges, rankings, readings, and the figure."""

import csv
import io
import json
from pathlib import Path

import pytest

from .conftest import SMALL, Call, one_message

MULTIVERSE = ("study", "run", "multiverse")
ONE = ("--metric", "human_intervention")


def test_people_see_ranges_rankings_and_what_the_readings_say(call: Call, ledger: Path) -> None:
    called = call(*MULTIVERSE, ledger, *ONE).good()
    ranges, rankings, verdicts, told = called.out.split("\n\n")
    assert ranges.splitlines()[0].split() == [
        *("metric", "architecture", "paper", "ours", "lowest", "highest"),
        *("combinations", "most_moving", "moved_by"),
    ]
    assert [line.split()[:2] for line in ranges.splitlines()[2:]] == [
        ["human_intervention", name] for name in ("fsar", "cfc", "dhma")
    ]
    assert rankings.splitlines()[0].split() == [
        *(
            *("metric", "better", "order", "combinations", "same_order"),
            *("changed_under", "fsar_best", "fsar_not_best_under"),
        )
    ]
    assert verdicts.startswith("FSAR is the best one under every combination in ")
    assert verdicts.splitlines()[1].startswith("the order of the architectures is ours under every combination in ")
    assert "reviews_are_no_interventions  R37         A review by the fleet supervisor is no intervention" in told


def test_programs_get_every_combination_and_the_same_bytes_again(call: Call, ledger: Path) -> None:
    called = call(*MULTIVERSE, ledger, *ONE, "--json")
    answer = json.loads(called.out)
    assert (answer["complete"], answer["missing_count"], len(answer["head"]["root"])) == (True, 0, 64)
    names = ["level_four_is_fleet", "reviews_are_no_interventions"]
    assert [one["name"] for one in answer["readings"]] == names
    assert [one["readings"] for one in answer["universes"]] == [
        chosen for chosen in ([], names[:1], names[1:], names) for _ in range(3)
    ]
    means = [one["mean"] for one in answer["universes"] if one["architecture"] == "cfc"]
    (cell,) = [one for one in answer["cells"] if one["architecture"] == "cfc"]
    assert (cell["ours"], cell["lowest"], cell["highest"]) == (means[0], min(means), max(means))
    assert cell["combinations"] == 4
    assert call(*MULTIVERSE, ledger, *ONE, "--json").out == called.out


@pytest.mark.slow
def test_our_reading_is_what_metrics_says(call: Call, ledger: Path) -> None:
    ours = {
        row["architecture"]: row["ours"]
        for row in csv.DictReader(io.StringIO(call(*MULTIVERSE, ledger, *ONE, "--csv").out))
    }
    found = csv.DictReader(io.StringIO(call("metrics", ledger, "--csv").out))
    assert ours == {row["architecture"]: row["mean"] for row in found if row["metric"] == "human_intervention"}


def test_the_figure_is_written_and_never_into_the_ledger(call: Call, ledger: Path, tmp_path: Path) -> None:
    assert call(*MULTIVERSE, ledger, *ONE, "--svg", tmp_path / "m.svg").code == 0
    assert (tmp_path / "m.svg").read_bytes().startswith(b"<?xml")
    one_message(call(*MULTIVERSE, ledger, *ONE, "--svg", ledger / "m.svg"), 2, "inside")
    assert not (ledger / "m.svg").exists()


def test_a_metric_that_is_none_is_an_error_that_names_the_nearest(call: Call, ledger: Path) -> None:
    called = call(*MULTIVERSE, ledger, "--metric", "human_interventions")
    assert (called.code, called.out) == (2, "")
    assert "unknown metric 'human_interventions'; did you mean human_intervention?" in called.err


def test_a_ledger_in_which_nothing_can_be_ranked_says_so(call: Call, tmp_path: Path) -> None:
    call("simulate", tmp_path / "one", *SMALL[:2], "--architecture", "fsar", "--runs", "1", "--workers", "1").good()
    verdicts = call(*MULTIVERSE, tmp_path / "one", *ONE).out.split("\n\n")[2]
    assert verdicts.splitlines() == [
        "whether FSAR is the best one: nothing to rank; this needs means of two architectures, one of them FSAR",
        "whether the order of the architectures is ours: nothing to rank; this needs means of two architectures",
    ]
