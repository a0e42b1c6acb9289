"""Bind results to the rules that made them: the queries behind a relation, each by a digest of its SQL.

A record of results keeps these digests. Whoever reads it later finds which query judges otherwise now, before a number
that no query gives any more is taken for a result.
"""

from collections.abc import Mapping
from hashlib import sha256

from .definitions import concerns_sql, definitions_sql, measured_sql, published_metrics
from .library import Library, Query, library, plain_sql

METRICS, CLAIMS = "metric_summary", "case_claims"
"""The relations that the recorded numbers, and the claims of the cases, are read from."""


# See docs/decisions/results-name-their-queries.md.
def rules(*relations: str, of: Library | None = None) -> dict[str, str]:
    """Return a SHA-256 of the SQL of each query that these relations rest on, by name; comments and layout aside.

    Left out are the views of event types and concerns, which judge nothing: they have the fields of the events. Of the
    registry of metrics it has what concerns the paper's, since another metric changes no number of theirs.
    """
    every = (of or library()).needs(relations)
    return {one.name: _digest(one) for one in sorted(every, key=lambda one: one.name) if not one.tags}


def changed(recorded: Mapping[str, str], of: Library | None = None) -> list[str]:
    """Return the names of the recorded queries that judge otherwise now, or are gone."""
    every = (of or library()).queries
    return [name for name, digest in recorded.items() if name not in every or _digest(every[name]) != digest]


def _digest(query: Query) -> str:
    made = {
        "metrics/metric_definitions": definitions_sql,
        "metrics/metric_concerns": concerns_sql,
        "metrics/metric_measurements": measured_sql,
    }.get(query.name)
    sql = query.sql if made is None else made(published_metrics())
    return sha256(plain_sql(sql).encode()).hexdigest()
