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
from typing import Any

import duckdb
import numpy as np
import pyarrow as pa
from duckdb.func import FunctionNullHandling, PythonUDFType
from numpy.typing import NDArray

from .constant_names import constants_of, default_of

Vector = NDArray[np.float64]

_CONSTANTS = pa.list_(pa.struct([("name", pa.string()), ("value", pa.string())]))


def _scipy() -> Any:
    """Import scipy.special when a query first needs it, since that takes 0.3 s."""
    from scipy import special

    return special


def t_sf2(t: Vector, df: Vector) -> Vector:
    """Return the two-sided tail probability of Student's t."""
    return np.asarray(2.0 * _scipy().stdtr(df, -np.abs(t)))


# See docs/decisions/intervals-keep-their-coverage.md.
def t_quantile(p: Vector, df: Vector) -> Vector:
    """Return the quantile of Student's t."""
    return np.asarray(_scipy().stdtrit(df, p))


def norm_sf2(z: Vector) -> Vector:
    """Return the two-sided tail probability of the standard normal."""
    return np.asarray(2.0 * _scipy().ndtr(-np.abs(z)))


def norm_quantile(p: Vector) -> Vector:
    """Return the quantile of the standard normal."""
    return np.asarray(_scipy().ndtri(p))


def gamma_quantile(p: Vector, shape: Vector) -> Vector:
    """Return the quantile of the gamma distribution of scale 1: half that of chi-square with twice the df."""
    return np.asarray(_scipy().gammaincinv(shape, p))


def binomial_half_sf2(k: Vector, n: Vector) -> Vector:
    """Return the two-sided probability that a fair coin deviates as much as k of n; 1 without tosses."""
    return np.asarray(np.minimum(1.0, 2.0 * _scipy().bdtr(k, n.astype(np.int64), 0.5)))


def _floats(column: pa.Array) -> Vector:
    """Return the column as a numpy vector."""
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _unary(function: Callable[[Vector], Vector]) -> Callable[[pa.Array], pa.Array]:
    """Lift a function of one vector to Arrow columns; DuckDB counts the arguments of what it is given."""
    return lambda x: pa.array(function(_floats(x)))


def _binary(function: Callable[[Vector, Vector], Vector]) -> Callable[[pa.Array, pa.Array], pa.Array]:
    """Lift a function of two vectors to Arrow columns."""
    return lambda x, y: pa.array(function(_floats(x), _floats(y)))


UNARY = {"norm_sf2": norm_sf2, "norm_quantile": norm_quantile}
BINARY = {
    "t_sf2": t_sf2,
    "t_quantile": t_quantile,
    "gamma_quantile": gamma_quantile,
    "binomial_half_sf2": binomial_half_sf2,
}


NAMES = frozenset((*UNARY, *BINARY, "constants_of", "default_of"))
"""What SQL can call only over a connection that has them."""


def _read(column: pa.Array) -> pa.Array:
    """Return the constants of each text of an Arrow column."""
    return pa.array([constants_of(text) for text in column.to_pylist()], _CONSTANTS)


def _defaults(column: pa.Array) -> pa.Array:
    """Return the default of each name of an Arrow column."""
    return pa.array(map(default_of, column.to_pylist()), pa.string())


def register(connection: duckdb.DuckDBPyConnection) -> None:
    """Register all functions with the connection."""
    for name, unary in UNARY.items():
        connection.create_function(name, _unary(unary), ["DOUBLE"], "DOUBLE", type=PythonUDFType.ARROW)
    for name, binary in BINARY.items():
        connection.create_function(name, _binary(binary), ["DOUBLE", "DOUBLE"], "DOUBLE", type=PythonUDFType.ARROW)
    kind = "STRUCT(name VARCHAR, value VARCHAR)[]"
    connection.create_function(
        "constants_of", _read, ["VARCHAR"], kind, type=PythonUDFType.ARROW, null_handling=FunctionNullHandling.SPECIAL
    )
    connection.create_function(
        "default_of",
        _defaults,
        ["VARCHAR"],
        "VARCHAR",
        type=PythonUDFType.ARROW,
        null_handling=FunctionNullHandling.SPECIAL,
    )
