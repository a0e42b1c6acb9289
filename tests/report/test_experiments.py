"""The parts beside the results: which runs they are of, what is judged, and what is a curve instead."""

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from fsar_ledger.designs.constants import Constants, Load
from fsar_ledger.designs.registered import PAPER_SCENARIOS
from fsar_ledger.events.configuration import FULL, PAPER_ARCHITECTURES, without
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.ledger.rows.codec import encode
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.results import DialledRow, dialled_rows
from fsar_ledger.metrics.verdicts import MARGINS
from fsar_ledger.report.build import Document
from fsar_ledger.report.findings import Part, arrow, experiments_of
from fsar_ledger.report.judge import OPEN, Number
from fsar_ledger.runtime.experiment import Experiment
from fsar_ledger.runtime.simulation import simulate_run
from tests.recycled import from_table
from tests.report.made import HEAD, column, made, names, number, part, said

MEANS = (30.0, 300.0)
COPIES, CLAIMS, UNNAMED = "synced-copies", "safe-stop-claims", "unnamed-requests"


def played(*experiments: Experiment) -> Iterator[Any]:
    for one in experiments:
        for spec in one.specs():
            yield simulate_run(spec, one.constants)


def meeting(mean: float, *configurations: str) -> Experiment:
    world = msgspec.structs.replace(Constants().world, encounter_mean_s=mean)
    return Experiment(("fsar",), PAPER_SCENARIOS, 2, 42, 4, configurations, Constants(world))


def loaded(size: int, teams: int | None, architectures: tuple[Architecture, ...] = PAPER_ARCHITECTURES) -> Experiment:
    load = None if teams is None else Load(teams_working=teams)
    return Experiment(architectures, PAPER_SCENARIOS, 1, 42, size, constants=Constants(load=load))


@pytest.fixture(scope="module")
def ablations() -> Iterator[Database]:
    """Two ablations at one rate of encounters, one of them at another rate, too."""
    both = meeting(30.0, FULL, "without-layered-recovery", "without-shared-registry")
    with from_table(encode(list(played(both, meeting(300.0, "without-shared-registry"))))) as database:
        yield database


@pytest.fixture(scope="module")
def ablation(ablations: Database) -> Part:
    return experiments_of(ablations)["ablation"]


@pytest.fixture(scope="module")
def fleets() -> Part:
    runs = played(loaded(4, None), loaded(8, None), loaded(8, 1), loaded(32, 1, ("fsar",)))
    with from_table(encode(list(runs))) as database:
        return experiments_of(database)["scaling"]


@pytest.fixture(scope="module")
def taken_out() -> Part:
    configurations = (FULL, *(without([name]) for name in (CLAIMS, COPIES, UNNAMED)))
    with from_table(encode(list(played(Experiment(("cfc",), PAPER_SCENARIOS, 3, 42, 4, configurations))))) as database:
        return experiments_of(database)["mechanisms"]


def test_the_table_is_of_the_rate_with_most_configurations_and_the_other_rate_is_on_the_curve(
    ablations: Database, ablation: Part
) -> None:
    ours = {
        (row.encounter_mean_s, row.configuration, row.scenario, row.metric): row.mean for row in dialled_rows(ablations)
    }
    assert [one.table for one in ablation.numbers] == ["ablation"] * 30 + ["ablation_text"] * 8
    for one in ablation.numbers:
        assert one.ours == ours.get((MEANS[0], one.configuration, one.scenario, one.metric))
    rates = {row["encounter_mean_s"] for row in ablation.relations["encounters"].to_pylist()}
    assert rates == set(MEANS)


def test_a_number_is_judged_unless_the_text_leaves_its_dial_open_or_there_are_no_runs(ablation: Part) -> None:
    for one in ablation.numbers:
        held = one.ours is not None
        assert (one.gives is not None) == (held and one.kind != "unspecified"), one
        by_text = "no" if held and one.kind == "cannot follow" else None
        assert one.could == by_text, "two runs are fewer than the paper's experiment"
        assert by_text in (None, one.gives), "what the text excludes is answered by it"
        assert (one.because is not None) == (one.kind in ("cannot follow", "unspecified"))


def test_a_number_that_hangs_on_an_open_dial_has_no_verdict_but_the_range_that_the_dial_gives(ablation: Part) -> None:
    [one] = [one for one in ablation.numbers if (one.table, one.outcome) == ("ablation", OPEN)]
    means = [
        row["mean"]
        for row in ablation.relations["encounters"].to_pylist()
        if (row["metric"], row["scenario"]) == (one.metric, None)
    ]
    margin = MARGINS[one.metric]
    assert len(set(means)) == 2
    assert one.reach == pytest.approx(((min(means) - one.paper) / margin, (max(means) - one.paper) / margin))
    assert (one.gives, one.distance, one.difference) == (None, None, None)


@pytest.mark.slow
def test_larger_fleets_stand_at_both_ends_of_the_load_and_have_no_verdict(fleets: Part) -> None:
    assert len(fleets.numbers) == 45
    larger = [one for one in fleets.numbers if one.fleet_size == 8]
    assert {(one.gives, one.outcome, one.kind) for one in larger} == {(None, OPEN, "unspecified")}
    [conflicts] = [one for one in larger if (one.architecture, one.metric) == ("dhma", "authority_conflicts")]
    assert conflicts.ours is not None
    assert conflicts.one is not None
    assert conflicts.ours > conflicts.one, "two teams have more to contend for"
    low, high = sorted((conflicts.ours, conflicts.one))
    where = (
        "below both" if conflicts.paper < low - 0.25 else "above both" if conflicts.paper > high + 0.25 else "between"
    )
    assert conflicts.lies == where
    assert {one.lies for one in fleets.numbers if one.fleet_size == 4} == {None}


def test_runs_of_one_scenario_are_not_judged_by_a_number_over_five_and_by_one_of_theirs_they_are() -> None:
    one = Experiment(("fsar",), ("mixed-trust-inspection",), 2, configurations=(FULL, "without-trust-evaluation"))
    with from_table(encode(list(played(one)))) as database:
        found = experiments_of(database)["ablation"].numbers
    judged = [(number.table, number.scenario) for number in found if number.gives is not None]
    assert judged == [("ablation_text", "mixed-trust-inspection")] * 2


def test_runs_without_a_mechanism_or_another_size_make_no_part() -> None:
    with from_table(encode(list(played(Experiment(("fsar",), ("door-relay",), 1))))) as database:
        assert experiments_of(database) == {}


def test_sections_print_our_means_beside_the_papers(ablation: Part, fleets: Part) -> None:
    relations = {**ablation.relations, **fleets.relations}
    heads = {"ablation": ablation.head, "scaling": fleets.head}
    document = Document(made([*ablation.numbers, *fleets.numbers], heads=heads, **relations))
    printed = [one.ours for one in ablation.numbers if one.table == "ablation" and one.ours is not None]
    assert sorted(filter(None, column(document, "ablation", "ours"))) == sorted(filter(None, printed))
    assert len(part(document, "scaling")["rows"]) == 45
    assert {"ablation", "encounters", "scaling", "coordination-cost"} <= set(names(document, "figure"))
    assert said(document).count("(printed:") == 2, "what cannot follow, with its proof"


def curve(*points: tuple[float, float]) -> list[dict[str, Any]]:
    named = {"metric": "coordination_success", "scenario": None, "ci_low": None, "ci_high": None}
    return [{**named, "encounter_mean_s": at, "mean": mean} for at, mean in points]


@pytest.mark.parametrize(
    ("points", "place"),
    [
        (((1.0, 0.0), (100.0, 0.92)), "lies at 10 s"),
        (((1.0, 0.0), (100.0, 0.1)), "is not reached"),
        (((10.0, 0.92), (1000.0, 0.0), (100_000.0, 0.92)), "lies at 100 and 10000 s"),
    ],
)
def test_a_curve_has_a_value_where_it_crosses_it_on_the_logarithm_of_the_dial(points: Any, place: str) -> None:
    dialled: dict[str, Any] = {"metric": "coordination_success", "configuration": "without-shared-registry"}
    one = number("ablation", outcome=OPEN, paper=0.46, printed="46", kind="unspecified", distance=None, **dialled)
    assert f"The paper's 46 % (all scenarios) {place}." in said(Document(made([one], encounters=curve(*points))))


def test_a_number_without_a_curve_is_not_said_to_be_out_of_its_reach() -> None:
    dialled: dict[str, Any] = {"metric": "coordination_success", "configuration": "without-shared-registry"}
    one = number("ablation", outcome=OPEN, paper=0.46, printed="46", kind="unspecified", distance=None, **dialled)
    for encounters in (arrow((), DialledRow), curve((90.0, 0.34))):
        assert "The paper's 46 %" not in said(Document(made([one], encounters=encounters)))


def cost(architecture: str, robots: int, completed: float) -> dict[str, Any]:
    counts = ("messages", "decisions", "hops", "look_ups", "robots_named", "checks")
    return {
        "architecture": architecture,
        "fleet_size": robots,
        "completed": completed,
        **dict.fromkeys(counts, robots / 1),
        "runs": 1,
        "requests": 9,
    }


@pytest.mark.slow
def test_the_cost_of_coordination_says_where_an_architecture_breaks() -> None:
    rows = [cost(name, size, 0.4 if name == "cfc" else 1.0) for size in (4, 64) for name in ("fsar", "cfc", "dhma")]
    document = Document(made(costs=rows))
    found = said(document)
    assert "FSAR does not break up to 64 robots (100 % in time), CFC breaks at 4 robots (40 % in time)" in found
    whole = Document(made(costs=[row | {"completed": 1.0} for row in rows]))
    assert whole.drawings["coordination-cost.svg"] != document.drawings["coordination-cost.svg"]


def carried(rows: list[dict[str, Any]]) -> dict[tuple[str, str], dict[str, Any]]:
    document = Document(made(heads={"mechanisms": HEAD}, differences=rows))
    keys = ("most", "n", "full_mean", "others", "mean_difference")
    columns = zip(*(column(document, "carried", key) for key in ("metric", "architecture", *keys)), strict=True)
    return {(metric, name): dict(zip(keys, rest, strict=True)) for metric, name, *rest in columns}


@pytest.mark.slow
def test_a_cell_is_carried_by_the_mechanism_that_moves_it_furthest_of_those_that_stand(taken_out: Part) -> None:
    rows = taken_out.relations["differences"].to_pylist()
    cell = "audit_attributability", "cfc"
    cells = carried(rows)
    assert len(cells) == 8, "nothing of FSAR or DHMA was taken out"
    assert cells[cell]["most"] == "unnamed requests"
    assert cells["governance_locality", "cfc"]["most"] == "none of these"
    louder = [
        {**row, "mean_difference": -1.0, "p_holm": 0.01, "n": 1200, "full_mean": 0.25} if _is(row, COPIES) else row
        for row in rows
    ]
    found = carried(louder)[cell]
    assert (found["most"], found["others"], found["n"], found["full_mean"]) == (
        "synced copies",
        "unnamed requests",
        1200,
        0.25,
    )
    by_chance = carried([row | {"p_holm": 0.9} if _is(row, COPIES) else row for row in louder])[cell]
    assert by_chance["most"] == "unnamed requests", "the larger difference does not stand"
    none = carried([row | {"p_holm": 0.9} for row in louder])[cell]
    assert (none["most"], none["n"], none["mean_difference"]) == ("none of these", 1200, None)


def _is(row: dict[str, Any], mechanism: str) -> bool:
    return (row["configuration"], row["metric"]) == (without([mechanism]), "audit_attributability")


def test_the_section_counts_its_tests_and_says_if_the_runs_are_of_other_constants(taken_out: Part) -> None:
    rows = taken_out.relations["differences"].to_pylist()
    findings = made(heads={"mechanisms": taken_out.head}, **taken_out.relations)
    found = said(Document(msgspec.structs.replace(findings, parameters_sha256="another")))
    assert f"Of 24 differences {sum(row['differing_pairs'] == 0 for row in rows)} are exactly 0" in found
    assert "These runs are of other constants than those of the results" in found
    assert "Without unnamed requests the same happens at the same times" in found
    [digest] = taken_out.relations["digests"].to_pylist()[0]["digests"]
    same = msgspec.structs.replace(findings, parameters_sha256=digest)
    assert "of other constants" not in said(Document(same))


def test_numbers_have_every_field_of_the_registered_judgement(ablation: Part) -> None:
    assert {type(one) for one in ablation.numbers} == {Number}
    assert {one.table for one in ablation.numbers if one.margin == MARGINS[one.metric]} == {"ablation", "ablation_text"}
