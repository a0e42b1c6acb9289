"""Lay the paper's four cases beside what `queries/cases/` counts. Paper: sec:evaluation:qualitative. Reading: R46."""

from collections.abc import Iterable, Mapping

from fsar_ledger.report import printing, specs
from fsar_ledger.report.findings import Row

Counts = Mapping[tuple[str, str], tuple[int, int]]
"""Numerator and denominator of each claim and architecture."""


def beside(claims: Iterable[Row]) -> tuple[Row, ...]:
    """Return a row for each number of the paper: its words, ours in both readings, what was counted, and its class.

    `claims` are the rows of `case_claims` for the runs of the report; those of several seeds are added up. Empty if
    none of these runs is of the scenario of a case.
    """
    counts: dict[tuple[str, str], tuple[int, int]] = {}
    for claim in claims:
        if claim["runs"]:
            key = (claim["claim"], claim["architecture"])
            counted, of_how_many = counts.get(key, (0, 0))
            counts[key] = (counted + claim["numerator"], of_how_many + claim["denominator"])
    return tuple(_row(cell, counts) for cell in specs.cases()) if counts else ()


def _row(cell: specs.CaseCell, counts: Counts) -> Row:
    printed = {(int(row["case"]), row["architecture"].lower()): row["value"] for row in specs.paper_table("cases")}
    counted, of_how_many = counts.get((cell.claim, cell.architecture), (0, 0))
    other, of_others = counts.get((cell.other or "", cell.architecture), (0, 0))
    total = "" if cell.of is None else f" of {printing.integer(counts.get((cell.of, cell.architecture), (0, 0))[0])}"
    return {
        "case": cell.case,
        "architecture": cell.architecture,
        "said": cell.said,
        "paper": printed[cell.case, cell.architecture],
        "value": counted / of_how_many if of_how_many else None,
        "counted": f"{printing.integer(counted)}{total} in {printing.integer(of_how_many)} {cell.unit}"
        if of_how_many
        else None,
        "other": f"{printing.number(other / of_others, 2)} ({printing.integer(other)} in {printing.integer(of_others)})"
        if of_others
        else None,
        "class": cell.kind,
    }
