"""Names of people stand outside the ledger: with their table they can be told, and without it they cannot."""

import stat
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.api.ledger import open_ledger
from fsar_ledger.api.record import record
from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.events.envelope import Parties, RequestSubject, flat
from fsar_ledger.events.fleet import RobotJoined
from fsar_ledger.events.request import RequestAccepted
from fsar_ledger.events.source import Observed
from fsar_ledger.sources.names import NamedPerson, PrivateNames, committed
from fsar_ledger.sources.recorder import FORMAT, WITH_COMMITMENTS, Recorder
from tests.recycled import asked
from tests.running import files_of_at_most

ANN = "supervisor/ann-lee"


def joined(supervisor: str) -> RobotJoined:
    return RobotJoined(robot="robot/A1", role="A", supervisor=supervisor)  # type: ignore[arg-type]


def test_a_supervisor_has_one_commitment_wherever_it_is_named(tmp_path: Path) -> None:
    names = PrivateNames(tmp_path / "names")
    who = Parties(requested_by=None, executed_by=None, supervised_by=ANN)  # type: ignore[arg-type]
    told = names.event(RequestAccepted(RequestSubject("t", "t/1", None), who.decided(ANN)))  # type: ignore[arg-type]
    hidden = names.event(joined(ANN)).supervisor  # type: ignore[attr-defined]
    assert flat(told)["supervised_by"] == flat(told)["decided_by"] == hidden != ANN
    assert flat(told)["path"] == (hidden,)
    assert "ann-lee" not in str(told)


def test_a_run_with_names_as_they_are_does_not_go_on_with_commitments(tmp_path: Path) -> None:
    record(tmp_path / "out", fleet=[joined(ANN)], run="n").close()
    for fleet in ([joined(ANN)], []):
        with pytest.raises(UsageError, match="found a run with the names of people as they are"):
            record(tmp_path / "out", fleet=fleet, run="n", private_names=tmp_path / "names")
    record(tmp_path / "out", fleet=[joined(ANN)], run="n").close()


def test_a_run_with_commitments_goes_on_only_with_the_table_of_names(tmp_path: Path) -> None:
    for _ in range(2):
        record(tmp_path / "out", fleet=[joined(ANN)], run="n", private_names=tmp_path / "names").close()
    with pytest.raises(UsageError, match="commitments in place of the names of people, expected their table"):
        record(tmp_path / "out", run="n")


def test_a_run_says_who_recorded_it_in_which_format_and_that_people_are_commitments(tmp_path: Path) -> None:
    Recorder(tmp_path / "out", run="n", source="plc", names=PrivateNames(tmp_path / "names")).close()
    [opened] = asked(tmp_path / "out", "SELECT source, format, adapter FROM source_opened")
    assert opened == {"source": "plc", "format": FORMAT, "adapter": WITH_COMMITMENTS}


def test_a_person_that_is_observed_is_hidden_and_other_objects_are_not(tmp_path: Path) -> None:
    seen = Observed(
        source="s", kind="k", objects=("ann", "robot/A1", "bob"), qualifiers=("person", "robot", "owner, person")
    )
    told = PrivateNames(tmp_path / "names").event(seen)
    assert isinstance(told, Observed)
    assert told.objects[0].startswith("~")
    assert told.objects[1] == "robot/A1"
    assert told.objects[2].startswith("~")


def test_robots_and_the_supervisor_of_the_fleet_keep_their_names(tmp_path: Path) -> None:
    names = PrivateNames(tmp_path / "names")
    event = joined("supervisor/fleet")
    assert names.event(event) is event
    assert (tmp_path / "names").read_bytes() == b""


def test_the_table_is_read_again_and_only_its_owner_may_read_it(tmp_path: Path) -> None:
    first = PrivateNames(tmp_path / "names").hidden("ann")
    assert PrivateNames(tmp_path / "names").hidden("ann") == first
    assert stat.S_IMODE((tmp_path / "names").stat().st_mode) == 0o600
    assert first == committed("ann", bytes.fromhex(line(tmp_path).key))


def line(folder: Path) -> NamedPerson:
    return decoded((folder / "names").read_bytes().splitlines()[0])


def decoded(text: bytes) -> NamedPerson:
    return msgspec.json.decode(text, type=NamedPerson)


def test_after_its_line_is_erased_the_same_name_is_somebody_else(tmp_path: Path) -> None:
    first = PrivateNames(tmp_path / "names").hidden("ann")
    (tmp_path / "names").write_bytes(b"")
    assert PrivateNames(tmp_path / "names").hidden("ann") != first


def test_a_commitment_cannot_be_hidden_twice(tmp_path: Path) -> None:
    names = PrivateNames(tmp_path / "names")
    once = names.event(joined(ANN))
    assert names.event(once) is once


@pytest.mark.parametrize("text", [b"no line\n", b'{"name":"ann","key":"00","commitment":"~x"}\n', b'{"name":"ann"}\n'])
def test_a_file_that_is_no_table_of_names_is_refused_with_its_line(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "names").write_bytes(text)
    with pytest.raises(UsageError, match=r"names:1: "):
        PrivateNames(tmp_path / "names")


def test_a_table_that_cannot_be_opened_is_an_error_of_the_disk(tmp_path: Path) -> None:
    with pytest.raises(WriteFailed, match="cannot be opened"):
        PrivateNames(tmp_path / "no" / "names")


def test_a_recorder_stores_commitments_and_the_ledger_proves_without_the_table(tmp_path: Path) -> None:
    table = tmp_path / "names"
    with record(tmp_path / "out", fleet=[joined(ANN)], run="n", private_names=table) as recorder:
        recorder.observed("call", objects={"bob-lee": "person"})
    stored = b"".join(path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file())
    assert b"ann-lee" not in stored
    assert b"bob-lee" not in stored
    assert {one.name for one in map(decoded, table.read_bytes().splitlines())} == {"ann-lee", "bob-lee"}
    table.unlink()
    ledger = open_ledger(tmp_path / "out")
    assert ledger.verify().ok
    [told] = asked(ledger.path, "SELECT supervisor FROM robot_joined")
    assert told["supervisor"].startswith("supervisor/~")


def test_the_table_is_never_within_the_ledger(tmp_path: Path) -> None:
    record(tmp_path / "out", run="n").close()
    with pytest.raises(UsageError, match="private_names"):
        record(tmp_path / "out", run="n", private_names=tmp_path / "out" / "names")


def test_a_robot_with_another_supervisor_does_not_go_on_in_the_run(tmp_path: Path) -> None:
    def fleet(supervisor: str | None) -> list[RobotJoined]:
        columns = {"robot": "robot/a", "role": "agv", "supervisor": supervisor}
        return [msgspec.convert({"type": "RobotJoined.v1", **columns}, RobotJoined)]

    for _ in range(2):
        record(tmp_path / "ledger", run="r", fleet=iter(fleet(ANN))).close()
    with pytest.raises(UsageError, match="found supervisor/ann-lee as the supervisor of robot/a when it began"):
        record(tmp_path / "ledger", run="r", fleet=fleet("supervisor/ben"))
    table = tmp_path / "names"
    for run, supervisor in (("r", ANN), ("s", "supervisor/ben"), ("f", "supervisor/fleet"), ("n", None)):
        for _ in range(2):
            record(tmp_path / "hidden", run=run, fleet=fleet(supervisor), private_names=table).close()
    lines = table.read_bytes()
    for run, found, others in (
        ("r", "supervisor/~", ("supervisor/ben", "supervisor/cy", "supervisor/fleet", None)),
        ("n", "nobody", (ANN, "supervisor/cy", "supervisor/fleet")),
    ):
        for supervisor in others:
            with pytest.raises(UsageError, match=f"found {found}.* as the supervisor of robot/a when it began"):
                record(tmp_path / "hidden", run=run, fleet=fleet(supervisor), private_names=table)
    assert table.read_bytes() == lines


def test_whose_line_is_erased_is_in_no_run_that_goes_on_as_somebody_else(tmp_path: Path) -> None:
    fleet, table = [joined(ANN)], tmp_path / "names"
    record(tmp_path / "out", run="r", fleet=fleet, private_names=table).close()
    table.write_bytes(b"")
    with pytest.raises(UsageError, match="the line that the table of names had of them then; give the run another"):
        record(tmp_path / "out", run="r", fleet=fleet, private_names=table)
    assert table.read_bytes() == b""
    record(tmp_path / "out", run="next", fleet=fleet, private_names=table).close()


def test_a_name_for_which_the_disk_has_no_room_leaves_no_part_of_a_line(tmp_path: Path) -> None:
    names = PrivateNames(tmp_path / "names")
    known = names.hidden("ann")
    room = (tmp_path / "names").stat().st_size + 20
    with files_of_at_most(room), pytest.raises(WriteFailed, match="the name was not written"):
        names.hidden("bob")
    later = names.hidden("bob")
    again = PrivateNames(tmp_path / "names")
    assert (again.hidden("ann"), again.hidden("bob")) == (known, later)


def test_recorders_that_share_a_table_have_one_commitment_for_a_name(tmp_path: Path) -> None:
    first, second = PrivateNames(tmp_path / "names"), PrivateNames(tmp_path / "names")
    assert first.hidden("ann") == second.hidden("ann") == PrivateNames(tmp_path / "names").hidden("ann")
    assert second.hidden("bob") == first.hidden("bob")
    assert len((tmp_path / "names").read_bytes().splitlines()) == 2


def test_a_table_with_two_commitments_to_a_name_is_refused_with_the_second_line(tmp_path: Path) -> None:
    lines = b""
    for table in ("one", "two"):
        PrivateNames(tmp_path / table).hidden("ann")
        lines += (tmp_path / table).read_bytes()
    (tmp_path / "names").write_bytes(lines)
    with pytest.raises(UsageError, match=r"names:2: found a second commitment to a name, expected one"):
        PrivateNames(tmp_path / "names")


def test_a_name_is_added_on_a_line_of_its_own_wherever_an_editor_left_the_table(tmp_path: Path) -> None:
    table = tmp_path / "names"
    names = PrivateNames(table)
    ann = names.hidden("ann")
    table.write_bytes(table.read_bytes().rstrip())
    bob = names.hidden("bob")
    table.rename(tmp_path / "moved")
    carl = names.hidden("carl")
    assert [decoded(line).commitment for line in (tmp_path / "moved").read_bytes().splitlines()] == [ann, bob]
    assert [decoded(line).commitment for line in table.read_bytes().splitlines()] == [carl]
