"""Upcasters are checked when the package starts: gaps, cycles and wrong versions never reach a ledger."""

from collections.abc import Sequence
from typing import Any, Literal

import pytest

from fsar_ledger.events import EVENT_TYPES, Event
from fsar_ledger.events.retired import (
    RETIRED_TYPES,
    UPCASTS,
    Addition,
    Upcaster,
    Value,
    adding,
    additions,
    upcasters_of,
)


class MovedV1(Event, frozen=True, tag="Moved.v1"):
    metres: int


class MovedV2(Event, frozen=True, tag="Moved.v2"):
    millimetres: int


class MovedV3(Event, frozen=True, tag="Moved.v3"):
    millimetres: int
    is_fast: bool


class MovedV4(Event, frozen=True, tag="Moved.v4"):
    millimetres: int


class MovedV5(Event, frozen=True, tag="Moved.v5"):
    millimetres: int
    by: tuple[str, ...]
    place: str | None = None


class MovedV6(Event, frozen=True, tag="Moved.v6"):
    millimetres: int
    is_fast: bool
    place: str | None


class MovedV7(Event, frozen=True, tag="Moved.v7"):
    millimetres: int | None
    pace: Literal["slow", "fast"]
    place: str = "floor/1"
    is_fast: bool = False
    by: str | None = None


class MovedV8(Event, frozen=True, tag="Moved.v8"):
    millimetres: str


class MovedV9(Event, frozen=True, tag="Moved.v9"):
    millimetres: int | None
    pace: Literal["slow", "fast", "still"] | None
    place: str
    is_fast: bool
    by: str | None


class MovedV10(Event, frozen=True, tag="Moved.v10"):
    millimetres: int
    pace: Literal["slow"]
    place: str
    is_fast: bool
    by: str | None


class Stopped(Event, frozen=True):
    pass


class Untagged(Event, frozen=True, tag="Untagged"):
    pass


class Zeroth(Event, frozen=True, tag="Zeroth.v0"):
    pass


def in_millimetres(event: MovedV1) -> MovedV2:
    return MovedV2(event.metres * 1000)


def with_pace(event: MovedV2) -> MovedV3:
    return MovedV3(event.millimetres, event.millimetres > 5000)


FIRST = Upcaster(MovedV1, MovedV2, in_millimetres)
SECOND = Upcaster(MovedV2, MovedV3, with_pace)
BACK: Upcaster[Any, Any] = Upcaster(MovedV2, MovedV1, lambda event: MovedV1(event.millimetres // 1000))
LEAP: Upcaster[Any, Any] = Upcaster(MovedV1, MovedV3, lambda event: MovedV3(event.metres * 1000, False))

Table = tuple[Sequence[type[Event]], Sequence[type[Event]], Sequence[Upcaster[Any, Any]]]
GOOD: Table = ((MovedV3, Stopped), (MovedV1, MovedV2), (SECOND, FIRST))


def test_an_event_of_any_retired_version_becomes_one_of_the_current_version() -> None:
    ways = upcasters_of(*GOOD)
    assert ways == {MovedV1: (FIRST, SECOND), MovedV2: (SECOND,)}
    assert SECOND.change(FIRST.change(MovedV1(7))) == MovedV3(7000, True)


def test_what_is_retired_today_has_its_way_to_a_current_type() -> None:
    assert set(UPCASTS) == set(RETIRED_TYPES)
    assert not set(RETIRED_TYPES) & set(EVENT_TYPES)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            ((MovedV3,), (MovedV1, MovedV2), (FIRST,)),
            r"expected exactly one of each retired type: Moved\.v1, Moved\.v2",
        ),
        (((MovedV3,), (MovedV1, MovedV2), (FIRST, SECOND, SECOND)), "expected exactly one of each retired type"),
        (((MovedV2,), (MovedV1,), (FIRST, SECOND)), "expected exactly one of each retired type"),
        (((MovedV3,), (MovedV1, MovedV2), (FIRST, BACK)), r"leads to Moved\.v1, expected Moved\.v3"),
        (((MovedV3,), (MovedV1, MovedV2), (LEAP, SECOND)), r"leads to Moved\.v3, expected Moved\.v2"),
        (((MovedV2,), (MovedV1,), (LEAP,)), r"leads to Moved\.v3, expected Moved\.v2"),
        (((Stopped,), (MovedV1, MovedV2), (FIRST, SECOND)), r"leads to Moved\.v3, expected Moved\.v3"),
        (((MovedV3,), (MovedV2,), (SECOND,)), r"Moved\.v2: found no version 1"),
        (((MovedV4,), (MovedV1, MovedV2), (FIRST, SECOND)), r"Moved\.v4: found no version 3"),
        (((MovedV3,), (), ()), r"Moved\.v3: found no version 2"),
        (((MovedV1, MovedV2), (), ()), r"Moved\.v1: found it current|Moved\.v2: found no version 1"),
        (((MovedV1, MovedV1), (), ()), "found two with one tag"),
        (((Untagged,), (), ()), r"Untagged: found a tag without version, expected NAME\.vN"),
        (((Zeroth,), (), ()), r"Zeroth\.v0: found a tag without version"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_each_fault_of_a_table_is_named(table: Table, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        upcasters_of(*table)


# --- steps that only add ---


def test_a_step_that_adds_keeps_every_field_of_the_version_before() -> None:
    step = adding(MovedV4, MovedV5, by=("robot/A1",))
    assert step.change(MovedV4(7)) == MovedV5(7, ("robot/A1",))
    assert additions({MovedV4: (step,)}) == {MovedV4: Addition(MovedV5, {"by": ("robot/A1",)})}


def test_what_is_added_on_the_way_adds_up_and_a_way_with_another_change_adds_nothing() -> None:
    second, third = adding(MovedV2, MovedV3, is_fast=False), adding(MovedV3, MovedV6, place=None)
    both = Addition(MovedV6, {"is_fast": False, "place": None})
    ways: dict[type[Event], tuple[Upcaster[Any, Any], ...]] = {
        MovedV1: (FIRST, second, third),
        MovedV2: (second, third),
        MovedV3: (third,),
    }
    assert additions(ways) == {MovedV2: both, MovedV3: Addition(MovedV6, {"place": None})}


def test_what_a_new_field_holds_by_default_is_added_in_sql_as_in_python() -> None:
    step = adding(MovedV4, MovedV7, pace="slow", place="floor/2")
    event = step.change(MovedV4(7))
    assert event == MovedV7(7, "slow", "floor/2", False, None)
    assert additions({MovedV4: (step,)})[MovedV4].added == {"pace": "slow", "place": "floor/2", "is_fast": False}
    assert adding(MovedV4, MovedV7, pace="slow").added == {"pace": "slow", "place": "floor/1", "is_fast": False}


def test_a_field_may_come_to_take_more() -> None:
    assert adding(MovedV7, MovedV9).change(MovedV7(7, "slow")) == MovedV9(7, "slow", "floor/1", False, None)


@pytest.mark.parametrize(
    ("versions", "added", "message"),
    [
        ((MovedV4, MovedV5), {}, r"adds \[\] and lacks \['by'\], expected of \['by', 'place'\]"),
        ((MovedV4, MovedV5), {"by": (), "pace": 1}, r"adds \['by', 'pace'\]"),
        ((MovedV4, MovedV5), {"by": (), "millimetres": 1}, r"adds \['by', 'millimetres'\]"),
        ((MovedV3, MovedV5), {"by": ()}, r"upcaster of Moved\.v3: found that it adds \['by'\] and lacks \[\]"),
        ((MovedV4, MovedV5), {"by": ("a", 1)}, r"upcaster of Moved\.v4: field by: Expected `str`, got `int`"),
        (
            (MovedV4, MovedV8),
            {},
            r"field millimetres: found <class 'int'> turned into <class 'str'>, expected a type that takes every value",
        ),
        ((MovedV7, MovedV10), {}, r"field millimetres: found int \| None turned into <class 'int'>"),
        ((MovedV9, MovedV7), {}, r"field pace: found .* turned into typing.Literal\['slow', 'fast'\]"),
    ],
    ids=[
        *("too little", "an unknown field", "a field that was there"),
        *("a field that goes", "another kind", "a field of another type"),
        *("a field that may be None no more", "a field that takes fewer words"),
    ],
)
def test_a_step_that_does_not_only_add_is_refused(
    versions: tuple[type[Event], type[Event]], added: dict[str, Value], message: str
) -> None:
    with pytest.raises(TypeError, match=message):
        adding(versions[0], versions[1], **added)
