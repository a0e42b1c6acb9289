"""The models of a ledger: with which constants its runs were played, as they record it."""

from collections.abc import Iterator, Mapping
from hashlib import sha256
from typing import Any

import msgspec

from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.metrics.database import Database
from fsar_ledger.parameters import BadParameters, read_parameters

MODELS = """
    SELECT kind, model_version, parameters, count(*) AS runs, min(run_id) AS first
    FROM run_started
    GROUP BY kind, model_version, parameters
    ORDER BY first
"""


class Model(msgspec.Struct, frozen=True):
    """The runs of one kind and model version under the same constants: their text as recorded and what it says, their number, the first one's name.

    Runs that were not simulated may have neither a model nor constants, and as parameters a text that is none: `parameters` is None then.
    """

    kind: str
    model_version: str | None
    text: str | None
    parameters: dict[str, Any] | None
    runs: int
    first: str

    @property
    def sha256(self) -> str | None:
        """The digest of the constants, as `runs.parameters_sha256` has it."""
        return None if self.text is None else sha256(self.text.encode()).hexdigest()


def models(database: Database) -> tuple[Model, ...]:
    """All models, in the order of the names of their first runs. Raises: LedgerCorrupted if a simulated run records something else as its parameters."""
    return tuple(
        Model(row["kind"], row["model_version"], row["parameters"], _read(row["kind"], row["first"], row["parameters"]), row["runs"], row["first"])
        for row in database.rows(MODELS)
    )


def differing(first: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """The names of the constants in which two sets of parameters differ, `group.constant`, one that only one of them has too."""
    return list(_differing("", first, other))


def _differing(above: str, first: Mapping[str, Any], other: Mapping[str, Any]) -> Iterator[str]:
    for name in dict.fromkeys((*first, *other)):
        one, two = first.get(name), other.get(name)
        if isinstance(one, Mapping) and isinstance(two, Mapping) and not above:
            yield from _differing(f"{name}.", one, two)
        elif one != two or (name in first) != (name in other):
            yield f"{above}{name}"


def _read(kind: str, run: str, parameters: str | None) -> dict[str, Any] | None:
    if parameters is None:
        return {}
    try:
        return read_parameters(parameters)
    except BadParameters as error:
        if kind != "simulated":  # 0.1.0 and 0.2.0 stored any text of others
            return None
        raise LedgerCorrupted(f"run {run!r:.300}, seq 0, field parameters: {error}; do not rely on this ledger, run fsar-ledger verify --replay") from error
