"""Mappings that never change are as dicts, of any size."""

import random
import weakref

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsar_ledger import projections
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.projections import SharedMap, among, put, without
from fsar_ledger.runtime.simulation import RunSpec, simulate_run

CHANGES = st.lists(st.tuples(st.integers(0, 12), st.one_of(st.none(), st.integers())), max_size=60)


@settings(max_examples=300)
@given(st.dictionaries(st.integers(0, 12), st.integers()), CHANGES)
def test_a_large_mapping_is_the_dict_with_the_same_changes(
    begin: dict[int, int], changes: list[tuple[int, int | None]]
) -> None:
    expected, found = dict(begin), SharedMap.of(begin)
    for key, value in changes:
        before = list(found.items())
        if value is None:
            after = without(found, key)
            expected.pop(key, None)
        else:
            after = put(found, key, value)
            expected[key] = value
        assert list(found.items()) == before, "a change leaves the mapping that it changes"
        assert isinstance(after, SharedMap)
        found = after
        assert list(found.items()) == list(expected.items()), "entries come in the order of a dict's"
    assert found == expected
    assert expected == found
    assert len(found) == len(expected)
    assert {**found} == expected
    for key in range(13):
        assert (key in found) == (key in expected)
        assert found.get(key, -1) == expected.get(key, -1)
    keys = dict.fromkeys(range(13)).keys()
    assert among(found, keys) == among(expected, keys) == expected.keys()
    with pytest.raises(KeyError):
        found[99]


@settings(max_examples=300)
@given(st.dictionaries(st.integers(0, 12), st.integers()), CHANGES, st.randoms(use_true_random=False))
def test_every_version_stays_what_it_was_whichever_is_changed_or_read(
    begin: dict[int, int], changes: list[tuple[int, int | None]], chance: random.Random
) -> None:
    versions: list[tuple[SharedMap[int, int], dict[int, int]]] = [(SharedMap.of(begin), begin)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(projections, "_SHARED_FROM", 7)
        for key, value in changes:
            found, expected = versions[-1] if chance.random() < 0.8 else chance.choice(versions)
            if value is not None:
                versions.append((found.put(key, value), {**expected, key: value}))
            elif key in expected:
                versions.append((found.without(key), {one: expected[one] for one in expected if one != key}))
            if chance.random() < 0.3:
                found, expected = chance.choice(versions)
                assert list(found.items()) == list(expected.items())
    chance.shuffle(versions)
    for found, expected in versions:
        assert found.get(3) == expected.get(3)
        assert list(found.items()) == list(expected.items())
        assert len(found) == len(expected)


@pytest.mark.parametrize("ways", ["keys", "values", "items"])
def test_a_mapping_may_be_changed_while_another_version_is_gone_through(ways: str) -> None:
    first = found = SharedMap.of({number: number for number in range(10)})
    for one in getattr(found, ways)():
        key = one[0] if ways == "items" else one
        found = found.without(key) if key % 2 else found.put(-key, key)
    assert list(first) == list(range(10))
    assert list(found) == [0, 2, 4, 6, 8, -2, -4, -6, -8]


def test_what_an_old_version_holds_does_not_grow_with_the_changes_after_it() -> None:
    alive: weakref.WeakSet[Value] = weakref.WeakSet()
    first = found = SharedMap.of({number: Value() for number in range(300)})
    for number in range(20_000):
        value = Value()
        alive.add(value)
        found = found.put(number % 300, value)
    assert len(first) == len(found) == 300
    assert len(alive) < 4 * 300


class Value:
    """Something that a weak reference can be made to."""


def test_a_mapping_grows_and_shrinks_by_one_entry_at_a_time() -> None:
    found, expected = put({}, "first", 0), {"first": 0}
    for number in range(3_000):
        found, expected[f"robot/{number}"] = put(found, f"robot/{number}", number), number
    assert isinstance(found, SharedMap)
    assert list(found.items()) == list(expected.items())
    for number in range(0, 3_000, 2):
        found = without(found, f"robot/{number}")
        del expected[f"robot/{number}"]
    assert without(found, "nobody") is found
    assert list(found) == list(expected)


@pytest.mark.parametrize("architecture", PAPER_ARCHITECTURES)
def test_a_run_is_the_same_whatever_the_size_of_a_large_mapping(
    architecture: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = RunSpec(11, architecture, "full", "door-relay", 16, 0)
    expected = simulate_run(spec, Constants())
    monkeypatch.setattr(projections, "_SHARED_FROM", 2)
    assert simulate_run(spec, Constants()) == expected
