"""Makes the records of the evaluation again, and renews the digests of their queries if the results are the same.

`python -m tests.records` does so for the fit, the predictions and their comparison; names of these do for some. The fit
takes most of an hour, the predictions minutes. A record whose results are others now stays as it is, and the exit code
is 1: then a query judges otherwise, and the evaluation is to be registered and made anew.
"""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from fsar_ledger.studies.calibration import calibrate
from fsar_ledger.studies.comparison import judge
from fsar_ledger.studies.predictions import predict
from tests.history import ROOT, results_of

REPORTS = ROOT / "reports"
MAKERS: Mapping[str, Callable[[Path], None]] = {
    "calibration": calibrate,
    "predictions": predict,
    "comparison": lambda out: judge(REPORTS / "predictions.json", out),
}


def renew(record: Path, make: Callable[[Path], None]) -> bool:
    """Make the record again; renew it and return True if all but the digests of its queries is the same."""
    with TemporaryDirectory() as folder:
        made = Path(folder) / record.name
        make(made)
        is_same = results_of(made.read_text("utf-8")) == results_of(record.read_text("utf-8"))
        if is_same:
            record.write_bytes(made.read_bytes())
    return is_same


def main(names: Sequence[str]) -> int:
    """Renew these records; return 1 if results are others now."""
    code = 0
    for name in names or tuple(MAKERS):
        record = REPORTS / f"{name}.json"
        is_same = renew(record, MAKERS[name])
        queries = len(json.loads(record.read_text("utf-8")).get("rules", ()))
        print(f"{record.name}: " + (f"the same results, of {queries} queries" if is_same else "other results; kept"))
        code = code if is_same else 1
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
