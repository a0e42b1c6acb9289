"""Report what became of the predictions that were registered before they were run.

They are read from `reports/comparison.json`, if that is of the report's model.
"""

from collections.abc import Sequence
from importlib.resources.abc import Traversable

from fsar_ledger import printable
from fsar_ledger.metrics.study_results import Comparison, changed, packaged
from fsar_ledger.parameters import read_parameters
from fsar_ledger.report.findings import Findings, Row
from fsar_ledger.report.printing import flat, words


# See docs/decisions/fit-is-registered-first.md.
def judged(findings: Findings, folder: Traversable | None = None) -> Comparison | None:
    """Return the result in this folder (default: the packaged one), None if absent, or of another model or constants.

    Raises: FsarLedgerError if the file is not such a result.
    """
    if (found := packaged(Comparison, folder)) is None:
        return None
    constants = dict(flat("", read_parameters(found.parameters)))
    return found if (found.model_version, constants) == (findings.model_version, findings.parameters) else None


def outcomes(found: Comparison | None) -> list[Row]:
    """Return a row for each prediction."""
    return [
        {"name": one.name, "implies": one.implies, "checks": f"{one.held} of {one.of}", "holds": one.holds}
        for one in (found.predictions if found else ())
    ]


def said(found: Comparison | None) -> Row | None:
    """Say which predictions hold, which do not, and which cannot be decided; None without predictions.

    Where a query has changed since they were judged, the sentence names it.
    """
    rows = outcomes(found)
    if found is None or not rows:
        return None
    kept, failed, open_ones = (
        [row["name"] for row in rows if row["holds"] is answer] for answer in (True, False, None)
    )
    holds = f"{len(kept)} {'holds' if len(kept) == 1 else 'hold'}{_listed(kept)}"
    fails = f"{len(failed)} {'does' if len(failed) == 1 else 'do'} not{_listed(failed)}"
    undecided = f"; {len(open_ones)} cannot be decided{_listed(open_ones)}" if open_ones else ""
    later = changed(found.rules)
    since = f"; they were judged before {printable.some(map(words, later))} changed, and not again" if later else ""
    of = f"Of {len(rows)} predictions registered before they were run"
    return {"sentence": f"{of}, {holds} and {fails}{undecided}{since}."}


def _listed(names: Sequence[str]) -> str:
    return f" ({', '.join(names)})" if names else ""
