"""An adapter is found by its name: those of the package, and those that others publish."""

from collections.abc import Iterable, Iterator
from importlib.metadata import EntryPoint
from io import BytesIO
from pathlib import Path

import pytest

from fsar_ledger.api.ledger import open_ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.envelope import recorded_robot
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.sources import adapter
from fsar_ledger.sources.adapter import ENTRY_POINTS, OWN, Derived, Input, Record, adapter_named, named_robots
from fsar_ledger.sources.columns import declared
from fsar_ledger.sources.importing import import_files
from tests.recycled import asked


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
    with pytest.raises(UsageError, match=r"format=vda505: found no adapter of that name, .*did you mean vda5050"):
        adapter_named("vda505")


def test_an_adapter_that_needs_what_is_not_installed_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = EntryPoint("mcap", "no_such_library.mcap:Mcap", ENTRY_POINTS)
    monkeypatch.setattr(adapter, "OWN", (broken,))
    with pytest.raises(UsageError, match=r"No module named 'no_such_library'.*pip install 'fsar-ledger\[mcap\]'"):
        adapter_named("mcap")


@pytest.mark.parametrize(
    ("value", "found"),
    [
        (
            "no_such_package:Acme",
            r"No module named 'no_such_package', .* install the package that has no_such_package:Acme",
        ),
        (
            "fsar_ledger.sources.rmf:Acme",
            "has no attribute 'Acme', .* install the package that has fsar_ledger.sources",
        ),
        ("tests.sources.test_adapters:Silent", "lacks is_sampled, declares; correct the adapter"),
    ],
)
def test_an_adapter_of_others_that_is_not_there_or_not_whole_says_so(
    monkeypatch: pytest.MonkeyPatch, value: str, found: str
) -> None:
    theirs = EntryPoint("acme", value, ENTRY_POINTS)
    monkeypatch.setattr(adapter, "entry_points", lambda group: [theirs] if group == ENTRY_POINTS else [])
    with pytest.raises(UsageError, match=f"format=acme: .*{found}"):
        adapter_named("acme")


class Silent:
    """An adapter that does not say what it declares, nor whether it is sampled."""

    name, version, format, clock, read, derive = "silent", "1", "silent/1", "arrival", None, None


class Joining:
    """An adapter whose records say which robot has joined."""

    name, version, format, clock, is_sampled = "joining", "1", "joining/1", "arrival", False

    def declares(self) -> Iterable[str]:
        return ("RobotJoined", "RobotDeparted")

    def read(self, inputs: Iterable[Input]) -> Iterator[Record]:
        for one in inputs:
            yield from (Record("joined", line, line.decode().strip()) for line in one.file)

    def derive(self, record: Record) -> list[Derived]:
        return [Derived(RobotJoined(robot=recorded_robot(f"robot/{record.data}"), role="agv", supervisor=None))]


def joined(path: Path, lines: bytes, fleet: dict[str, str] | None) -> list[int]:
    """How often each robot joins in the run, and how many events break I1."""
    import_files(path, [Input("n", None, BytesIO(lines))], Joining(), run="n", fleet=fleet)  # type: ignore[arg-type]
    ledger = open_ledger(path)
    counted = asked(ledger.path, "SELECT count(*) AS n FROM robot_joined GROUP BY robot ORDER BY robot")
    [broken] = asked(ledger.path, "SELECT count(*) AS n FROM i1_local_agent_coherence")
    return [*(row["n"] for row in counted), broken["n"]]


def test_a_robot_that_the_fleet_s_file_and_the_recording_name_joins_once(tmp_path: Path) -> None:
    assert joined(tmp_path / "both", b"a\nb\n", {"a": "agv"}) == [1, 1, 0]
    assert joined(tmp_path / "neither", b"a\nb\n", None) == [1, 1, 0]
    assert joined(tmp_path / "again", b"a\na\n", {"a": "agv"}) == [2, 1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('[robots]\na = "agv"\n"robot/a" = "agv"\n', "found robot a twice"),
        ('[robots]\nKIT.1 = "agv"\n"KIT.1" = "lift"\n', "found robot KIT.1 twice"),
        ('[robots]\na = "agv"\n[supervisors]\na = "ann"\n', "found robots, supervisors, expected only a table"),
        ("[robots]\na = 1\n", "expected only a table"),
    ],
)
def test_a_fleet_s_file_that_says_something_twice_or_else_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "fleet.toml").write_text(text)
    with pytest.raises(UsageError, match=said):
        named_robots(tmp_path / "fleet.toml")
