"""Provide SQL with functions that it lacks.

They are tail probabilities and quantiles from scipy, a column at a time, and constants by name.

| function | value |
|---|---|
| `t_sf2(t, df)` | two-sided p of Student's t |
| `t_quantile(p, df)` | the t below which a share p lies |
| `norm_sf2(z)` | two-sided p of a standard normal z |
| `norm_quantile(p)` | the z below which a share p lies |
| `gamma_quantile(p, shape)` | the quantile of the gamma distribution of scale 1: exact bounds of a Poisson count |
| `binomial_half_sf2(k, n)` | exact two-sided p of k of n fair coin tosses, k <= n/2 |
| `constants_of(parameters)` | name and value of each constant of a run, sorted by name; NULL where unreadable |
| `default_of(name)` | the value of a constant in a run that does not record it; NULL where there is no such constant |

NULL in, NULL out.
"""

from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
from duckdb.func import FunctionNullHandling, PythonUDFType

from .constant_names import constants_of, default_of

_CONSTANTS = pa.list_(pa.struct([("name", pa.string()), ("value", pa.string())]))


def _scipy() -> Any:
    """Import scipy.special when a query first needs it, since that takes 0.3 s."""
    from scipy import special

    return special


# See docs/decisions/intervals-keep-their-coverage.md.
NUMERIC: dict[str, Callable[..., Any]] = {
    "t_sf2": lambda t, df: 2.0 * _scipy().stdtr(df, -np.abs(t)),
    "t_quantile": lambda p, df: _scipy().stdtrit(df, p),
    "norm_sf2": lambda z: 2.0 * _scipy().ndtr(-np.abs(z)),
    "norm_quantile": lambda p: _scipy().ndtri(p),
    "gamma_quantile": lambda p, shape: _scipy().gammaincinv(shape, p),
    "binomial_half_sf2": lambda k, n: np.minimum(1.0, 2.0 * _scipy().bdtr(k, n.astype(np.int64), 0.5)),
}
"""The functions of numbers, each of numpy vectors; what they give stands above."""

BY_NAME: dict[str, tuple[Callable[[Any], Any], str, pa.DataType]] = {
    "constants_of": (constants_of, "STRUCT(name VARCHAR, value VARCHAR)[]", _CONSTANTS),
    "default_of": (default_of, "VARCHAR", pa.string()),
}
"""The functions of texts, each of one Python value, and the type of the answer in SQL and in Arrow."""

NAMES = frozenset((*NUMERIC, *BY_NAME))
"""What SQL can call only over a connection that has them."""


def _of_numbers(function: Callable[..., Any]) -> Callable[..., pa.Array]:
    """Lift a function of vectors to Arrow columns; DuckDB counts the arguments of what is wrapped."""

    @wraps(function)
    def lifted(*columns: pa.Array) -> pa.Array:
        vectors = [np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64) for column in columns]
        return pa.array(np.asarray(function(*vectors), dtype=np.float64))

    return lifted


def _of_texts(function: Callable[[Any], Any], kind: pa.DataType) -> Callable[[pa.Array], pa.Array]:
    return lambda column: pa.array(map(function, column.to_pylist()), kind)


def register(connection: duckdb.DuckDBPyConnection) -> None:
    """Register all functions with the connection."""
    for name, function in NUMERIC.items():
        arguments: list[Any] = ["DOUBLE"] * len(signature(function).parameters)
        connection.create_function(name, _of_numbers(function), arguments, "DOUBLE", type=PythonUDFType.ARROW)
    for name, (of_text, sql_type, arrow_type) in BY_NAME.items():
        connection.create_function(
            name,
            _of_texts(of_text, arrow_type),
            ["VARCHAR"],
            sql_type,
            type=PythonUDFType.ARROW,
            null_handling=FunctionNullHandling.SPECIAL,
        )
