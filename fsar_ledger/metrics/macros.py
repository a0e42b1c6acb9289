"""Table macros of DuckDB, for SQL of anyone: a packaged query that takes its parameters by name."""

import re

from .library import Query

_PARAMETER = re.compile(r"\$(\w+)")
FOR_OLDER = 'CREATE MACRO "if"(is_so, so, otherwise) AS CASE WHEN is_so THEN so ELSE otherwise END'
"""Makes the function that our queries call and the DuckDB before ours lacks."""

_RUN_NAMED = """
CREATE MACRO IF NOT EXISTS run_named(asked) AS coalesce(
    (SELECT max(run_id) FROM run_numbers WHERE run_id = asked::VARCHAR),
    (SELECT max(run_id) FROM experiment_planned WHERE run_id = asked::VARCHAR),
    (SELECT max(run_id) FROM run_numbers WHERE number::VARCHAR = asked::VARCHAR),
    if(asked::VARCHAR = 'all', 'all', error(
        'run ' || coalesce(asked::VARCHAR, 'NULL') || ': there is no such run, expected a whole name or a number; '
        || '`SELECT number, run_id FROM run_numbers` lists them'
    ))
)
"""
"""The run of this name or number; any other text is an error, because an empty answer would say that nothing was."""


def statements(query: Query) -> tuple[str, ...]:
    """Return the statements that make a macro of a query with parameters; it has their defaults.

    It takes only runs on record. A parameter hides the column of its name, so that a macro of its own holds the SELECT,
    with other names. DuckDB compares the names when it makes a macro, not when one is called, so that the SELECT comes
    last.
    """
    defaults = {one.sql_name: one.sql_default for one in query.parameters.values()}
    understood = ", ".join(
        f"run_named({one.sql_name})" if one.kind == "run" else one.sql_name for one in query.parameters.values()
    )
    taken = ", ".join(name if value is None else f"{name} := '{value}'" for name, value in defaults.items())
    inner = f"{query.relation}_given"
    whole = f"{inner}({', '.join(f'{name}_given' for name in defaults)})"
    sql = _PARAMETER.sub(r"\1_given", query.sql)
    return (
        _RUN_NAMED,
        f"CREATE MACRO {whole} AS TABLE SELECT NULL",
        f"CREATE MACRO {query.relation}({taken}) AS TABLE FROM {inner}({understood})",
        f"CREATE OR REPLACE MACRO {whole} AS TABLE\n{sql}",
    )
