"""Documents made by hand for the tests of the report, and what they print."""

from collections.abc import Iterable, Mapping
from typing import Any

import msgspec
import pyarrow as pa

from fsar_ledger.events.configuration import ARCHITECTURES
from fsar_ledger.metrics.definitions import Table, metrics, printed
from fsar_ledger.metrics.registration import Sample, SampleAround
from fsar_ledger.metrics.results import StatisticRow
from fsar_ledger.metrics.robustness import (
    CellSpread,
    Ensemble,
    HeldRank,
    NamedShares,
    Placebo,
    RankCounts,
    Ranking,
    Rejections,
    SignCount,
    SystemGrade,
    SystemNumber,
    Systems,
)
from fsar_ledger.metrics.verdicts import MARGINS, ComparedEffect
from fsar_ledger.report.findings import Findings, Head, arrow
from fsar_ledger.report.judge import Number
from fsar_ledger.report.layout import Layout

CLAIMS = pa.Table.from_pylist([{"claim": "", "architecture": "", "numerator": 1, "denominator": 1, "runs": 1}])
DIFFERENCE: dict[str, Any] = dict.fromkeys(
    ("full_mean", "without_mean", "mean_difference", "ci_low", "ci_high", "p_holm"), 0.5
) | {"architecture": "fsar", "configuration": "", "metric": "", "position": 1, "n": 9, "differing_pairs": 9}
"""A row of what a mechanism adds."""
HEAD = Head(1, 1, "root", 1, "complete", "2")


def number(table: str = "results", **other: Any) -> Number:
    """A number of a table, of FSAR's locality unless told, that comes out."""
    found: dict[str, Any] = {"metric": "governance_locality", "architecture": "fsar", "configuration": "full"}
    found |= {"fleet_size": 4, "scenario": None, "kind": "informed", "because": None, "printed": "0.94", "paper": 0.94}
    found |= {"ours": 0.94, "n": 5, "interval": (0.93, 0.95), "difference": (-0.01, 0.01), "distance": 0.1}
    found |= {"reach": (-0.5, 0.5), "gives": "yes", "share": 0.2, "could": "yes", "outcome": "stands"}
    found |= {"denominator": 9, "without_routine": 0.8, "published_convention": None}
    found |= {"table": table} | other
    return Number(margin=MARGINS[found["metric"]], **found)


def results(**ours: float | None) -> list[Number]:
    """The 24 numbers of the results table as the paper prints them, but for those named METRIC__ARCHITECTURE."""
    numbers = []
    for place, paper in printed("results").items():
        mean = ours.get(f"{place.metric}__{place.architecture}", paper.value)
        distance = None if mean is None else (mean - paper.value) / MARGINS[place.metric]
        outcome = "undecided" if distance is None else "does not" if abs(distance) > 1 else "stands"
        found: dict[str, Any] = {"paper": paper.value, "printed": str(paper.value), "ours": mean, "distance": distance}
        found |= {"metric": place.metric, "architecture": place.architecture, "outcome": outcome, "kind": "fitted"}
        numbers.append(number(**found, reach=None, difference=None, interval=None))
    return numbers


def of_table(table: Table, **other: Any) -> list[Number]:
    """Every number of one table of the paper, exactly ours."""
    return [
        number(
            **{**place._asdict(), "paper": paper.value, "ours": paper.value, "printed": str(paper.value)},
            **{"interval": (paper.value - 0.01, paper.value + 0.01), **other},
        )
        for place, paper in printed(table).items()
    ]


def paired(metric: str, comparison: str, difference: float, p: float = 0.001) -> StatisticRow:
    """A pairwise test with this difference."""
    blank: dict[str, Any] = dict.fromkeys(StatisticRow.__struct_fields__)
    named = {"family": "architectures", "kind": "simulated", "metric": metric, "comparison": comparison, "n": 100}
    ours = {"mean_difference": difference, "t": 9.0 if difference > 0 else -9.0, "p": p, "p_holm": p, "wilcoxon_n": 100}
    return StatisticRow(**(blank | named | ours))


def pairs_of(numbers: Iterable[Number]) -> list[StatisticRow]:
    """A pairwise test for each pair of these numbers of the results table, significant where they differ."""
    means = {(one.metric, one.architecture): one.ours for one in numbers if one.ours is not None}
    pairs = (("fsar", "cfc"), ("fsar", "dhma"), ("cfc", "dhma"))
    return [
        paired(metric, f"{first}-{second}", means[metric, first] - means[metric, second])
        for metric in dict.fromkeys(metric for metric, _ in means)
        for first, second in pairs
        if (metric, first) in means and (metric, second) in means
    ]


def made(
    numbers: Iterable[Number] = (),
    tests: Iterable[StatisticRow] = (),
    *,
    heads: Mapping[str, Head] | None = None,
    **relations: Any,
) -> Findings:
    """Findings with these numbers and tests; relations given as rows become tables."""
    held = {
        name: rows if isinstance(rows, pa.Table) else pa.Table.from_pylist(rows) for name, rows in relations.items()
    }
    none = pa.table({"name": pa.array([], pa.string())})
    nothing = {
        "claims_of_cases": CLAIMS.slice(0, 0),
        "differences": pa.Table.from_pylist([DIFFERENCE]).slice(0, 0),
        "predictive": arrow((), ComparedEffect),
    }
    held = nothing | held
    return Findings(
        heads={"results": HEAD, **(heads or {})},
        numbers=tuple(numbers),
        relations={"paired": arrow(tests, StatisticRow), "not_judged": none} | held,
    )


def part(document: Layout, name: str, shape: str = "table") -> dict[str, Any]:
    """The table, or the figure, of this name."""
    parts = [one for section in document.sections for one in section["parts"]]
    [found] = [one for one in parts if (one["shape"], one.get("name")) == (shape, name)]
    return dict(found)


def names(document: Layout, shape: str) -> list[str]:
    """The names of all tables, or figures, in order."""
    return [one["name"] for section in document.sections for one in section["parts"] if one["shape"] == shape]


def column(document: Layout, table: str, key: str, what: str = "value") -> list[Any]:
    """One column of a table: its values, or what is printed."""
    found = part(document, table)
    at = found["keys"].index(key)
    return [getattr(row[at], what) for row in found["rows"]]


def said(document: Layout, id: str | None = None) -> str:
    """The texts of the document, or those of this id, as a reader sees their words."""
    texts = [
        one["text"]
        for section in document.sections
        for one in section["parts"]
        if one["shape"] == "text" and id in (None, one["id"])
    ]
    return "\n".join(texts).replace("\\", "")


def replaced(findings: Findings, **relations: Any) -> Findings:
    """The same with other relations."""
    held = {
        name: rows if isinstance(rows, pa.Table) else pa.Table.from_pylist(rows) for name, rows in relations.items()
    }
    return msgspec.structs.replace(findings, relations={**findings.relations, **held})


METRICS_OF_PAPER = tuple(dict.fromkeys(one.metric for one in results()))
SAMPLE = Sample(seed=1, size=100, runs=1)
GROUNDS: dict[str, Any] = {"model_version": "1", "parameters": "{}", "rules": {}, "cpu_minutes": 1.0}


def ranks(metric: str, best: int = 100, ordered: int = 100) -> RankCounts:
    """FSAR is best at so many of 100 points, all three in the paper's order at so many."""
    none: dict[str, Any] = dict.fromkeys(("clearly_best", "tied", "undefined", "close"), 0)
    none |= dict.fromkeys(("best_share", "best_low", "best_high", "ordered_share", "ordered_low", "ordered_high"))
    return RankCounts(
        **none,
        metric=metric,
        is_best_in_paper=metric != "coordination_success",
        best=best,
        beaten=100 - best,
        ordered=ordered,
        disordered=100 - ordered,
    )


def prior(**best: int) -> Ranking:
    """A study of rankings; FSAR is best at so many of 100 points, at all where nothing is told."""
    return Ranking(
        **GROUNDS, sample=SAMPLE, ranges={}, ranks=[ranks(name, best.get(name, 100), 60) for name in METRICS_OF_PAPER]
    )


def ensemble(plausible: int, *cells: CellSpread) -> Ensemble:
    """Points around a fit, of which so many are plausible."""
    near = [ranks(name, ordered=99) for name in METRICS_OF_PAPER]
    return Ensemble(
        **GROUNDS,
        sample=SampleAround(seed=1, size=100, runs=1, spread=0.5),
        clipped=0.0,
        plausible=plausible,
        cells=list(cells),
        signs=[
            SignCount(metric="policy_violations", comparison="fsar-cfc", paper_t=-9.0, same=9, other=1, neither=0),
            SignCount(metric="policy_violations", comparison="fsar-dhma", paper_t=-9.0, same=10, other=0, neither=0),
        ],
        ranks=near,
    )


def placebo(*tests: tuple[str, str]) -> Placebo:
    """Each of these tests of these metrics rejects 5 times in 100."""
    share: dict[str, Any] = {"rejected": 5, "kept": 95, "undefined": 0, "share": 0.05, "low": 0.02, "high": 0.11}
    made = [Rejections(metric=metric, test=test, **share) for metric, test in tests]
    return Placebo(**GROUNDS, sample=SAMPLE, alpha=0.05, pairs=9, largest_difference=0.0, tests=made)


def systems(*others: SystemNumber) -> Systems:
    """Six architectures at three sizes, alike but for the violations of FSAR; under JADE no human is ever called."""
    numbers = [
        system_number(architecture, metric.name, fleet_size=size)
        for architecture in ARCHITECTURES
        for size in (4, 8, 16)
        for metric in metrics()
    ]
    return Systems(
        **GROUNDS,
        seeds=(1,),
        runs={"4": 1, "8": 1, "16": 1},
        numbers=[*numbers, *others],
        grades=[
            SystemGrade(architecture=name, feature="single_agent_robot", grade="full") for name in ARCHITECTURES[3:]
        ],
        named=[NamedShares(architecture=name, origin=1.0, executor=1.0, supervisor=None) for name in ARCHITECTURES],
        moved_runs=1,
        held=[
            HeldRank(
                architecture=name, metric=metric.name, settings=9, higher=1, lower=6, against=("load.task_sets=2",)
            )
            for name in ARCHITECTURES[1:]
            for metric in metrics()
        ],
    )


def system_number(architecture: str, metric: str, **given: Any) -> SystemNumber:
    """Return a number of an architecture at four robots, in the middle of a wide interval."""
    is_silent = (architecture, metric) == ("jade", "human_intervention")
    mean = 0.1 if (architecture, metric) == ("fsar", "policy_violations") else 0.0 if is_silent else 0.5
    low, high = (mean - 0.05, mean + 0.05) if metric == "policy_violations" else (0.0, 1.0)
    sd = 0.0 if is_silent else 0.2
    row: dict[str, Any] = {"fleet_size": 4, "dial": None, "value": None, "n": 9, "mean": mean, "low": low, "high": high}
    return SystemNumber(**row | {"architecture": architecture, "metric": metric, "sd": sd} | given)
