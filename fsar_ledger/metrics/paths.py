"""Write values and file paths in SQL for DuckDB, which reads many characters of file names as patterns or commands.

In a path as text it expands `*`, `?`, `[...]` and a leading `~`, and reads `file:` and its like as a scheme.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

_PATTERNS = str.maketrans({character: f"[{character}]" for character in "*?["})


def literal(path: str | Path) -> str:
    """Return the text by which DuckDB finds this path in `filename` columns, and in statements that know no patterns.

    It never begins with `~` or a scheme.
    """
    text = str(path)
    return text if text.startswith("/") else f"./{text}"


def quoted(text: str) -> str:
    """Write a text in SQL."""
    return "'" + text.replace("'", "''") + "'"


def written(value: Any) -> str:
    """Write a value in SQL."""
    match value:
        case None:
            return "NULL"
        case str():
            return quoted(value)
        case tuple():
            return f"[{', '.join(map(written, value))}]"
        case _:
            return str(value).upper()


def listed(values: Iterable[Any]) -> str:
    """Write values in SQL, with commas between them."""
    return ", ".join(map(written, values))


def parquet(paths: Iterable[str | Path], *options: str, is_for_others: bool = False) -> str:
    """Write just these files as a SQL relation.

    Older DuckDB does not know the form in which a path is none but itself. With `is_for_others` the characters of
    patterns are escaped instead: then DuckDB lists the folders above, and reads nothing where a name in one of these
    begins with a backslash.
    """
    names = map(literal, paths)
    files = (
        [quoted(name.translate(_PATTERNS)) for name in names]
        if is_for_others
        else [f"{{'filename': {quoted(name)}}}" for name in names]
    )
    return f"read_parquet([{', '.join(files)}], {', '.join(('hive_partitioning = false', *options))})"
