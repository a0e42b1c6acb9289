"""Principals cannot be mistaken for each other: what the types do not show, a run does, and the soak that says so finds
what it should."""

import ast
import inspect
from functools import cache
from itertools import islice
from pathlib import Path

import pytest

from fsar_ledger.events import EVENT_TYPES
from tests.swaps.histories import digest, histories
from tests.swaps.sites import MADE, PACKAGE, Swap, calls, swaps
from tests.swaps.soak import expected, shows, untyped

PINNED = "29c95b91561a8db6c0f5e0c34fdc3683e549c55d251e8bc3cc448f318dec1763"
"""Of everything that the runs of the soak record."""

KINDS = {"Robot", "Supervisor", "Service", "Agent", "Coordinator"}
MAKES_PRINCIPALS = {"events/envelope.py"}  # fleets and commands are decoded, which makes them, too
PARTS = {"subject", "principals", "task_id"}


def named(name: str) -> Swap:
    """The first swap with this name."""
    return next(swap for swap in swaps() if name in str(swap))


@cache
def calls_of_names(source: str) -> list[tuple[str, ast.Call]]:
    return [(call.func.id, call) for call in calls(ast.parse(source)) if isinstance(call.func, ast.Name)]


def splats(source: str) -> list[str]:
    """The events and parts that this source makes from a tuple or a dictionary."""
    return [
        name
        for name, call in calls_of_names(source)
        if name in MADE
        and (any(isinstance(one, ast.Starred) for one in call.args) or any(one.arg is None for one in call.keywords))
    ]


@cache
def sources() -> dict[str, str]:
    return {str(file.relative_to(PACKAGE)): file.read_text() for file in sorted(Path(PACKAGE).rglob("*.py"))}


def test_no_event_is_made_from_a_tuple_or_a_dictionary() -> None:
    assert {name: found for name, source in sources().items() if (found := splats(source))} == {}
    assert splats("GapDetected(*about)\nParties(**who)\nGapDetected(subject, principals, capability)") == [
        "GapDetected",
        "Parties",
    ]


def test_principals_are_made_in_one_place() -> None:
    makes = {
        name: KINDS & {one for one, _ in calls_of_names(source)}
        for name, source in sources().items()
        if "envelope import" in source or name in MAKES_PRINCIPALS
    }
    made = {name for name, kinds in makes.items() if kinds}
    assert made == MAKES_PRINCIPALS


def test_events_of_more_than_three_fields_beside_their_parts_take_keywords_only() -> None:
    for cls in EVENT_TYPES:
        fields = set(cls.__struct_fields__) - PARTS
        kinds = {parameter.kind for parameter in inspect.signature(cls).parameters.values()}
        assert (inspect.Parameter.POSITIONAL_OR_KEYWORD in kinds) <= (len(fields) <= 3), cls.__name__


@pytest.mark.slow
def test_a_swap_that_types_do_not_show_is_found_by_a_run() -> None:
    runs = expected(islice(histories(), 1))
    assert shows(named("handlers/request.py:"), runs)
    assert not shows(named("architectures/dhma/request.py:"), runs), (
        "which this run of another architecture never comes to"
    )


@pytest.mark.soak  # `make soak-swaps` asks it of every swap
def test_a_robot_in_the_place_of_a_supervisor_is_found_by_types() -> None:
    assert untyped([named("Parties: executed_by, supervised_by")]) == []


@pytest.mark.slow
def test_the_runs_of_the_soak_are_those_that_are_pinned() -> None:
    assert digest() == PINNED
