"""Runs that continue each other, as docs/ledger-format.md has it (section 4); see `independent_verifier.py`."""

from collections.abc import Collection
from typing import Any

Row = dict[str, Any]


def goes_on_from(row: Row) -> Row:
    """Return the member of its block in the index that the row adds, if any (section 7)."""
    is_first = row["seq"] == 1 and "continues" in row
    return {"goes_on_from": [row["continues"], row["continues_seq"]]} if is_first else {}


class Cuts:
    """The runs of the rows so far: the last row of each, and by its name each that another continues, and the other."""

    def __init__(self) -> None:
        self.last: dict[str, Row] = {}
        self.continued: dict[str, str] = {}

    def flaw(self, row: Row, alone: Collection[str]) -> tuple[str, str] | None:
        """Return what is found, and expected, where the row breaks the rule; `alone` are events that stand alone."""
        run = row["run_id"]
        if run in self.continued:
            return f"an event of run {run}", f"none after run {self.continued[run]}, which continues it"
        if row["seq"] != 1 or "continues" not in row:
            return None
        before = row["continues"]
        if before == run or before in alone:
            return before, "another run"
        if before not in self.last:
            return None
        if before in self.continued:
            return before, f"a run that none continues, as {self.continued[before]} does"
        last, begun = self.last[before], self.last[run]
        if last["seq"] != row["continues_seq"]:
            return f"{row['continues_seq']}", f"{last['seq']}, the last of run {before}"
        if begun["time_us"] < last["time_us"]:
            return f"{begun['time_us']}", f"no less than {last['time_us']}"
        return None

    def add(self, row: Row) -> None:
        """Add the next row."""
        if row["seq"] == 1 and "continues" in row:
            self.continued[row["continues"]] = row["run_id"]
        self.last[row["run_id"]] = row
