"""Makes the records of the evaluation again, and renews the digests of their queries if the results are the same.

`python -m tests.records` does so for the records whose queries have changed, or for those that are named. The
predictions take minutes, their comparison seconds, and the fit, which comes last, most of an hour. It stops at the
first record whose results differ and keeps that record; the exit code is 1. A query then judges otherwise, and the
evaluation is to be registered and made anew. `python -m tests.records --stale` only names the changed queries of each
record.
"""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from fsar_ledger.metrics.study_results import CLAIMS, METRICS, rules
from fsar_ledger.studies.calibration import calibrate
from fsar_ledger.studies.comparison import judge
from fsar_ledger.studies.predictions import predict
from tests.history import ROOT, results_of

REPORTS = ROOT / "reports"
RELATIONS = {"predictions": (METRICS, CLAIMS), "comparison": (METRICS, CLAIMS), "calibration": (METRICS,)}
"""What each record is read from."""
MAKERS: Mapping[str, Callable[[Path], None]] = {
    "predictions": predict,
    "comparison": lambda out: judge(REPORTS / "predictions.json", out),
    "calibration": calibrate,
}


def stale(name: str) -> list[str]:
    """Return the queries that this record does not rest on as they are now: changed, new or gone."""
    kept = json.loads((REPORTS / f"{name}.json").read_text("utf-8"))["rules"]
    now = rules(*RELATIONS[name])
    return sorted(query for query in kept.keys() | now.keys() if kept.get(query) != now.get(query))


def renew(record: Path, make: Callable[[Path], None]) -> bool:
    """Make the record again; renew it and return True if all but the digests of its queries is the same."""
    with TemporaryDirectory() as folder:
        made = Path(folder) / record.name
        make(made)
        is_same = results_of(made.read_text("utf-8")) == results_of(record.read_text("utf-8"))
        if is_same:
            record.write_bytes(made.read_bytes())
    return is_same


def main(arguments: Sequence[str]) -> int:
    """Renew these records, or name the changed queries of each; return 1 if results are others now."""
    if arguments == ["--stale"]:
        for name in MAKERS:
            print(f"{name}.json: {', '.join(stale(name)) or 'rests on the queries as they are'}")
        return 0
    for name in arguments or [name for name in MAKERS if stale(name)]:
        record = REPORTS / f"{name}.json"
        if not renew(record, MAKERS[name]):
            print(f"{record.name}: other results; kept")
            return 1
        print(f"{record.name}: the same results")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
