"""An adapter is found by its name: those of the package, and those that others publish."""

from importlib.metadata import EntryPoint

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.sources import adapter
from fsar_ledger.sources.adapter import ENTRY_POINTS, OWN, adapter_named
from fsar_ledger.sources.declared import declared


@pytest.mark.parametrize("name", [one.name for one in OWN if one.name != "mcap"])
def test_an_adapter_of_the_package_has_its_name_and_declares_what_there_is(name: str) -> None:
    one = adapter_named(name)
    assert one.name == name
    assert one.format.partition("/")[0].startswith(name)
    declared(one.declares())


def test_an_adapter_that_others_publish_is_found_by_its_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    theirs = EntryPoint("acme", "fsar_ledger.sources.vda5050:Vda5050", ENTRY_POINTS)
    monkeypatch.setattr(adapter, "entry_points", lambda group: [theirs] if group == ENTRY_POINTS else [])
    assert adapter_named("acme").name == "vda5050"


def test_an_adapter_that_nobody_publishes_is_an_error_with_the_nearest_name() -> None:
    with pytest.raises(UsageError, match="--as vda505: found no adapter of that name, .*did you mean vda5050"):
        adapter_named("vda505")


def test_an_adapter_that_needs_what_is_not_installed_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = EntryPoint("mcap", "no_such_library.mcap:Mcap", ENTRY_POINTS)
    monkeypatch.setattr(adapter, "OWN", (broken,))
    with pytest.raises(UsageError, match=r"no module no_such_library.*pip install 'fsar-ledger\[mcap\]'"):
        adapter_named("mcap")
