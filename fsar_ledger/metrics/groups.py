"""The packaged queries by group, for lists, and as text."""

from .library import Query, library

GROUPS = {
    "audit": "what an auditor asks: who asked, who decided, under which authority and policy",
    "invariants": "every event that offends a rule, I1 to I5 and A1 to A5",
    "metrics": "what the metrics measure, and of which runs",
    "cases": "the paper's four cases, claim by claim, and the events behind each number",
    "facts": "what the events mean: failures, decisions, conflicts, policies in force",
    "statistics": "architectures compared over paired runs",
    "tables": "the paper's two tables of grades, and what each grade rests on",
    "readings": "relations as they are when the paper is read otherwise",
    "staging": "the runs, their settings and plans",
}
"""The folders of queries, in the order of a list for people, and what each answers."""


def group_of(query: Query) -> str:
    """Return the folder that the query is in: the first part of its name."""
    return query.name.partition("/")[0]


def is_event_view(query: Query) -> bool:
    """Tell whether the query shows the events of one type or concern as they are on record; it has no file."""
    return bool(query.tags)


def listed(*, events: bool) -> list[Query]:
    """Return the queries in the order of their groups; the event views, last in theirs, only with `events`."""
    order = {group: place for place, group in enumerate(GROUPS)}
    chosen = [query for query in library().queries.values() if events or not is_event_view(query)]
    return sorted(chosen, key=lambda query: (order.get(group_of(query), len(order)), is_event_view(query), query.name))


def text_of(name: str) -> str:
    """Return the header and the SQL of a query, as its file holds them; of one without a file, as a file would.

    Raises:
        UnknownQuery: There is no query of this name.
    """
    query = library().find(name)
    if query.sql.startswith("-- "):
        return query.sql
    return "".join(f"-- {key}: {said}\n" for key, said in query.header.items()) + query.sql
