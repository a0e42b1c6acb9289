"""Versions are compared by number; contracts neither contradict themselves nor promise what the module does not
keep."""

import pytest
from hypothesis import given as forall
from hypothesis import strategies as st

from fsar_ledger.projections.registry import Contract
from fsar_ledger.runtime.handlers.candidates import (
    contradiction,
    is_in_range,
    is_range,
    is_suitable,
    version_of,
    weaker,
)
from tests.sure import known

NUMBERS = st.integers(0, 4)
VERSIONS = st.builds("{}.{}.{}".format, NUMBERS, NUMBERS, NUMBERS)
SHORT = st.one_of(VERSIONS, st.builds("{}.{}".format, NUMBERS, NUMBERS), NUMBERS.map(str))


@forall(VERSIONS, SHORT, SHORT)
def test_version_ranges_obey_their_laws(version: str, wanted: str, other: str) -> None:
    assert is_in_range(version, "")
    assert is_in_range(version, version)
    assert is_in_range(version, "^" + version)
    assert is_in_range(version, ">=" + version)
    is_exact = is_in_range(version, wanted)
    is_compatible = is_in_range(version, "^" + wanted)
    is_at_least = is_in_range(version, ">=" + wanted)
    assert not is_exact or is_compatible
    assert not is_compatible or is_at_least
    found, lowest = version_of(version), version_of(wanted)
    assert found is not None
    assert lowest is not None
    assert is_at_least == (found >= lowest)
    if is_compatible:
        assert found[0] == lowest[0]
        assert found[0] or found[1] == lowest[1] or wanted.count(".") == 0
    later = known(version_of(other))
    if is_at_least and lowest >= later:
        assert is_in_range(version, ">=" + other)


@pytest.mark.parametrize(
    ("version", "wanted", "is_in"),
    [
        *(("1.2.0", "1.2", True), ("1.2.1", "1.2", False), ("1.10.0", "^1.2", True)),
        *(("1.1.9", "^1.2", False), ("2.0.0", "^1.2", False), ("0.2.9", "^0.2", True)),
        *(("0.3.0", "^0.2", False), ("0.0.3", "^0.0.3", True), ("0.0.4", "^0.0.3", False)),
        *(("0.9.0", "^0", True), ("1.0.0", "^0", False), ("1.10.0", ">=1.9.9", True)),
        *(("beta", "", True), ("beta", ">=0", False)),
    ],
)
def test_versions_are_compared_by_number(version: str, wanted: str, is_in: bool) -> None:
    assert is_in_range(version, wanted) == is_in


@forall(st.text(alphabet="0123456789.^>=~ -x²", max_size=8))
def test_any_text_is_a_range_or_not_and_never_an_error(text: str) -> None:
    assert isinstance(is_in_range("1.2.3", text), bool)
    if not is_range(text):
        assert not is_in_range("1.2.3", text)


@pytest.mark.parametrize(
    "names",
    [
        *(("not not lit",), (" lit",), ("not ",), ("not",), ("lit", "not lit")),
        *(("not lit", "lit"), ("lit", "lit"), ("not lit", "not lit"), ("",)),
    ],
)
def test_names_that_contradict_each_other_or_name_nothing_are_found(names: tuple[str, ...]) -> None:
    assert contradiction(Contract(preconditions=names)) is not None
    assert contradiction(Contract(postconditions=names)) is not None


def test_before_and_after_may_be_opposites_for_that_is_what_execution_is_for() -> None:
    assert contradiction(Contract(("door.closed", "light"), ("not door.closed", "light"), ("arm",))) is None
    assert contradiction(Contract(resources=("not arm",))) is not None


NAMES = st.lists(st.sampled_from(("a", "b", "not a", "c")), max_size=3, unique=True).map(tuple)
CONTRACTS = st.builds(Contract, NAMES, NAMES, NAMES)


@forall(CONTRACTS, CONTRACTS, NAMES, NAMES, NAMES)
def test_who_is_served_by_a_weaker_contract_is_served_by_the_installed_one(
    offered: Contract,
    installed: Contract,
    needs: tuple[str, ...],
    provides: tuple[str, ...],
    resources: tuple[str, ...],
) -> None:
    """Substitution: what an advertisement that `weaker` lets through promises, the module keeps."""
    assert weaker(installed, installed) is None
    if weaker(offered, installed) is None and is_suitable(offered, needs, provides, resources):
        assert is_suitable(installed, needs, provides, resources)
