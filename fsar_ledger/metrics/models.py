"""List the models of a ledger: the constants under which its runs were made, as they record them."""

from collections.abc import Iterable, Iterator
from hashlib import sha256
from itertools import count, product
from string import ascii_uppercase
from typing import Any

import msgspec

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.metrics.database import Database
from fsar_ledger.parameters import BadParameters, read_parameters

MODELS = """
    SELECT
        started.kind,
        started.source,
        started.model_version,
        settings.parameter_set,
        any_value(settings.constants) AS constants,
        arg_min(started.parameters, started.run_id) AS parameters,
        count(*) AS runs,
        min(started.run_id) AS first
    FROM run_started AS started
    INNER JOIN run_settings AS settings ON started.run_id = settings.run_id
    GROUP BY started.kind, started.source, started.model_version, settings.parameter_set
    ORDER BY first
"""


class Model(msgspec.Struct, frozen=True):
    """The runs of one kind, source and model version under the same constants, by value.

    `text` is how the first of them records these. `constants` names those that differ between runs of the model, None
    if none do. Runs that were not simulated may have neither a model nor readable parameters: `parameters` is None
    then.
    """

    kind: str
    source: str | None
    model_version: str | None
    parameter_set: str | None
    constants: str | None
    text: str | None
    parameters: dict[str, Any] | None
    runs: int
    first: str

    @property
    def sha256(self) -> str | None:
        """Return the digest of the constants, as `runs.parameters_sha256` has it for the first of the runs."""
        return None if self.text is None else sha256(self.text.encode()).hexdigest()


def models(database: Database) -> tuple[Model, ...]:
    """Return all models, in the order of the names of their first runs.

    Raises: LedgerCorrupted if a simulated run records something else as its parameters.
    """
    return tuple(
        Model(
            kind=row["kind"],
            source=row["source"],
            model_version=row["model_version"],
            parameter_set=row["parameter_set"],
            constants=row["constants"],
            text=row["parameters"],
            parameters=_read(row["kind"], row["first"], row["parameters"]),
            runs=row["runs"],
            first=row["first"],
        )
        for row in database.rows(MODELS)
    )


def lettered(found: Iterable[Model]) -> list[tuple[Model, str | None]]:
    """Return the models, those with most runs first, with the letter by which commands call their constants.

    The letter is None where no constants are on record.
    """
    letters = _letters()
    return [
        (one, None if one.text is None else next(letters))
        for one in sorted(found, key=lambda one: (-one.runs, one.model_version or "", one.text or ""))
    ]


def _letters() -> Iterator[str]:
    """Yield A to Z, AA, AB and so on."""
    return ("".join(letters) for length in count(1) for letters in product(ascii_uppercase, repeat=length))


def _read(kind: str, run: str, parameters: str | None) -> dict[str, Any] | None:
    if parameters is None:
        return {}
    try:
        return read_parameters(parameters)
    except BadParameters as error:
        if kind != "simulated":  # 0.1.0 and 0.2.0 stored any text for other kinds
            return None
        raise LedgerCorrupted(
            f"run {run!r:.300}, seq 0, field parameters: {error}; do not rely on this ledger, run fsar-ledger verify "
            "--replay"
        ) from error
