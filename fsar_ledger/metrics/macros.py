"""Table macros of DuckDB, for other programs: a packaged query that takes its parameters by name."""

import re

from .library import Query

_PARAMETER = re.compile(r"\$(\w+)")


def statements(query: Query) -> tuple[str, ...]:
    """Return the statements that make a macro of a query with parameters; it has their defaults.

    A parameter hides the column of its name, so that a macro of its own holds the SELECT, with other names. DuckDB
    compares the names when it makes a macro, not when one is called, so that the SELECT comes last.
    """
    defaults = {one.sql_name: one.sql_default for one in query.parameters.values()}
    taken = ", ".join(name if value is None else f"{name} := '{value}'" for name, value in defaults.items())
    inner = f"{query.relation}_given"
    whole = f"{inner}({', '.join(f'{name}_given' for name in defaults)})"
    sql = _PARAMETER.sub(r"\1_given", query.sql)
    return (
        f"CREATE MACRO {whole} AS TABLE SELECT NULL",
        f"CREATE MACRO {query.relation}({taken}) AS TABLE FROM {inner}({', '.join(defaults)})",
        f"CREATE OR REPLACE MACRO {whole} AS TABLE\n{sql}",
    )
