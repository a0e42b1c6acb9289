"""Report what became of the predictions that were registered before they were run.

They are read from `reports/comparison.json`, if that is of the report's model.
"""

from collections.abc import Sequence
from importlib.resources import files
from importlib.resources.abc import Traversable

import msgspec

from fsar_ledger import printable
from fsar_ledger.errors import FsarLedgerError
from fsar_ledger.metrics.registration import Outcome
from fsar_ledger.metrics.rules import changed
from fsar_ledger.report.findings import Findings, Row
from fsar_ledger.report.printing import flat, words


class Record(msgspec.Struct, frozen=True):
    """The model, constants and queries that the predictions were judged with, and the outcomes in registered order."""

    model_version: str
    parameters: str
    rules: dict[str, str]
    predictions: list[Outcome]


def judged(findings: Findings, folder: Traversable | None = None) -> Record | None:
    """Return the record in this folder (default: the packaged one), None if absent, or of another model or constants.

    Raises: FsarLedgerError if the file is not such a record.
    """
    path = (folder or files("fsar_ledger.reports")).joinpath("comparison.json")
    if not path.is_file():
        return None
    try:
        record = msgspec.json.decode(path.read_bytes(), type=Record)
        constants = dict(flat("", msgspec.json.decode(record.parameters)))
    except msgspec.DecodeError as error:
        raise FsarLedgerError(
            f"reports/comparison.json: {error}; expected what `fsar-ledger judge PREDICTIONS --out FILE` writes; write "
            "it again"
        ) from error
    return record if (record.model_version, constants) == (findings.model_version, findings.parameters) else None


def outcomes(record: Record | None) -> list[Row]:
    """Return a row for each prediction."""
    return [
        {"name": one.name, "implies": one.implies, "checks": f"{one.held} of {one.of}", "holds": one.holds}
        for one in (record.predictions if record else ())
    ]


def said(record: Record | None) -> Row | None:
    """Say which predictions hold, which do not, and which cannot be decided; None without predictions.

    Where a query has changed since they were judged, the sentence names it.
    """
    rows = outcomes(record)
    if record is None or not rows:
        return None
    kept, failed, open_ones = (
        [row["name"] for row in rows if row["holds"] is answer] for answer in (True, False, None)
    )
    holds = f"{len(kept)} {'holds' if len(kept) == 1 else 'hold'}{_listed(kept)}"
    fails = f"{len(failed)} {'does' if len(failed) == 1 else 'do'} not{_listed(failed)}"
    undecided = f"; {len(open_ones)} cannot be decided{_listed(open_ones)}" if open_ones else ""
    found = changed(record.rules)
    since = f"; they were judged before {printable.some(map(words, found))} changed, and not again" if found else ""
    of = f"Of {len(rows)} predictions registered before they were run"
    return {"sentence": f"{of}, {holds} and {fails}{undecided}{since}."}


def _listed(names: Sequence[str]) -> str:
    return f" ({', '.join(names)})" if names else ""
