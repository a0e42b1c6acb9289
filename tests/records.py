"""Makes the records of the evaluation again, and renews the digests of their queries if the results are the same.

`python -m tests.records` does so for the records whose queries have changed, or for those that are named. The
predictions take minutes, their comparison seconds, and the others up to an hour each. It stops at the first record
whose results differ and keeps that record; the exit code is 1. A query then judges otherwise, and the evaluation is to
be registered and made anew; what was made is kept in `build/records`. An interrupted study goes on from there when the
same program calls it again. `python -m tests.records --stale` only names what each record does not rest on any more.
"""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from fsar_ledger.metrics.study_results import packaged, rules
from fsar_ledger.studies import result
from fsar_ledger.studies.calibration import calibrate
from fsar_ledger.studies.comparison import judge
from fsar_ledger.studies.placebo import placebo
from fsar_ledger.studies.predictions import predict
from fsar_ledger.studies.result import KINDS
from fsar_ledger.studies.robustness import ensemble, ranking
from fsar_ledger.studies.sensitivity import sensitivity
from fsar_ledger.studies.systems import systems
from tests.history import ROOT, results_of

REPORTS = ROOT / "reports"
MADE = ROOT / "build" / "records"
MAKERS: Mapping[str, Callable[[Path], object]] = {
    "predictions": predict,
    "comparison": lambda out: judge(REPORTS / "predictions.json", out),
    "placebo": placebo,
    "ranking": ranking,
    "ensemble": ensemble,
    "systems": systems,
    "sensitivity": sensitivity,
    "calibration": calibrate,
}
"""What makes each record, the quicker ones first."""
KEPT = tuple(name for name in MAKERS if (REPORTS / KINDS[name].FILE).is_file())
"""The records that there are."""


def stale(name: str) -> list[str]:
    """Return the queries that this record does not rest on as they are now: changed, new or gone."""
    kept = json.loads((REPORTS / f"{name}.json").read_text("utf-8"))["rules"]
    now = rules(*KINDS[name].RELATIONS)
    return sorted(query for query in kept.keys() | now.keys() if kept.get(query) != now.get(query))


def reasons(name: str) -> str:
    """Say what this record does not rest on any more; an empty text if it rests on all."""
    if queries := stale(name):
        return ", ".join(queries)
    record = packaged(KINDS[name])
    return (record and result.stale(record)) or ""


def renew(record: Path, make: Callable[[Path], object]) -> bool:
    """Make the record again; renew it and return True if all but the digests of its queries is the same."""
    MADE.mkdir(parents=True, exist_ok=True)
    made = MADE / record.name
    make(made)
    is_same = results_of(made.read_text("utf-8")) == results_of(record.read_text("utf-8"))
    if is_same:
        made.replace(record)
    return is_same


def main(arguments: Sequence[str]) -> int:
    """Renew these records, or name the changed queries of each; return 1 if results are others now."""
    if arguments == ["--stale"]:
        for name in KEPT:
            print(f"{name}.json: {reasons(name) or 'rests on what there is'}")
        return 0
    for name in arguments or [name for name in KEPT if stale(name)]:
        record = REPORTS / f"{name}.json"
        if not renew(record, MAKERS[name]):
            print(f"{record.name}: other results; kept, and these are in {MADE / record.name}")
            return 1
        print(f"{record.name}: the same results")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
