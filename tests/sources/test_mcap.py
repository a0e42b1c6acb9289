"""What becomes of an MCAP file, whole or damaged, and what can be judged then."""

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="needs the extra mcap")

from fsar_ledger.base.errors import UsageError
from fsar_ledger.sources import mcap
from fsar_ledger.sources.adapter import adapter_of, opened
from fsar_ledger.sources.importing import Imported, import_files
from tests.cli.conftest import Call
from tests.quick import few
from tests.sources import bags
from tests.sources.importing import filed, is_good, kinds, record_numbers, rows

NIGHT = [
    *("RequestAccepted", "ExecutionStarted", "ExecutionFinished"),
    *("RequestAccepted", "ExecutionStarted", "ExecutionFailed", "ExecutionWithdrawn"),
]


def imported(folder: Path, content: bytes) -> Imported:
    adapter, _ = adapter_of("mcap", None)
    with opened([str(filed(folder, content, "night.mcap"))]) as inputs:
        return import_files(folder / "ledger", inputs, adapter, run="night")


def seen(folder: Path) -> list[dict[str, Any]]:
    return [row for row in rows(folder / "ledger") if row["type"] == "Observed.v1"]


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4", "NONE"])
@pytest.mark.parametrize("chunks", [True, False])
def test_every_message_is_kept_and_goals_are_told_once(tmp_path: Path, compression: str, chunks: bool) -> None:
    made = imported(tmp_path, bags.written(bags.honest_night(), compression=compression, chunks=chunks))
    assert (made.records, kinds(tmp_path / "ledger")) == (8, NIGHT)
    assert is_good(tmp_path / "ledger")


def test_a_goal_that_was_canceled_is_no_longer_at_its_robot(tmp_path: Path) -> None:
    imported(tmp_path, bags.written([bags.statuses("r1", (1, status)) for status in (1, 2, 3, 5, 5)]))
    assert kinds(tmp_path / "ledger") == ["RequestAccepted", "ExecutionStarted", "ExecutionWithdrawn"]


def test_what_is_not_json_is_an_observation_with_kind_topic_time_and_hash(tmp_path: Path) -> None:
    made = imported(tmp_path, bags.written(bags.honest_night()))
    assert [(one.kind, one.count) for one in made.not_understood] == [("sensor_msgs/msg/LaserScan", 1)]
    scan = next(row for row in seen(tmp_path) if row["kind"] == "sensor_msgs/msg/LaserScan")
    assert (scan["names"], scan["texts"]) == (["topic", "encoding"], ["/r1/scan", "cdr"])
    assert (scan["time_us"], scan["source_time_us"]) == (4_000_000, 3_999_000)


def test_a_message_that_has_an_encoding_of_its_own_hides_neither(tmp_path: Path) -> None:
    image = bags.Said("/r1/camera", "sensor_msgs/msg/Image", {"encoding": "rgb8", "topic": "front", "height": 2})
    imported(tmp_path, bags.written([image]))
    (row,) = seen(tmp_path)
    told = dict(zip(row["names"], row["texts"], strict=True))
    assert told == {
        "topic": "/r1/camera",
        "encoding": "json",
        "height": "2",
        "message/topic": "front",
        "message/encoding": "rgb8",
    }


def test_logs_and_service_events_say_what_they_are(tmp_path: Path) -> None:
    imported(tmp_path, bags.written(bags.honest_night()))
    found = {row["kind"] for row in seen(tmp_path)}
    assert {"foxglove.Log/ERROR", "nav_msgs/action/Dock_SendGoal_Event/REQUEST_RECEIVED"} <= found


@pytest.mark.slow
def test_an_honest_night_has_no_offence_and_a_stranger_breaks_i1(call: Call, tmp_path: Path) -> None:
    night = filed(tmp_path, bags.written([*bags.honest_night(), bags.statuses("r2", (3, 1))]), "night.mcap")
    for run, robots in (("honest", 'r1 = "agv"\nr2 = "agv"'), ("stranger", 'r1 = "agv"')):
        (tmp_path / "fleet.toml").write_text(f"[robots]\n{robots}\n")
        fleet = ("--fleet", tmp_path / "fleet.toml")
        call("import", tmp_path / run, night, "--as", "mcap", *fleet).good()
        answer = json.loads(call("audit", tmp_path / run, "--json").out)
        holds = {row["invariant"][:2]: row["holds"] for row in answer["rows"] if row["holds"] is not None}
        stranger = {} if run == "honest" else {"i1": False}
        assert holds == {**stranger, "a2": True, "a4": True}


def test_a_status_that_comes_twice_or_late_doubles_nothing(tmp_path: Path) -> None:
    night = bags.honest_night()
    imported(tmp_path, bags.written([*night, *reversed(night), *night]))
    assert kinds(tmp_path / "ledger") == NIGHT


@pytest.mark.parametrize("compression", few(["ZSTD", "LZ4", "NONE", "no chunks"], ["ZSTD"]))
def test_a_file_that_was_cut_anywhere_keeps_what_can_be_read_and_says_so(tmp_path: Path, compression: str) -> None:
    is_chunked = compression != "no chunks"
    whole = bags.written(bags.honest_night(), compression=compression if is_chunked else "NONE", chunks=is_chunked)
    imported(tmp_path, whole)
    hashes = [row["record_sha256"] for row in seen(tmp_path)]
    for end in range(len(bags.written([])) // 2, len(whole), 97):
        folder = tmp_path / f"{end}"
        folder.mkdir()
        imported(folder, whole[:end])
        found = seen(folder)
        good = [row["record_sha256"] for row in found if row["kind"] != "unreadable"]
        assert good == hashes[: len(good)]
        assert len(good) == len(hashes) or found[-1]["kind"] == "unreadable"
        assert record_numbers(folder / "ledger") == list(range(1, len(found) + 1))


def test_flipped_bytes_are_never_a_traceback(tmp_path: Path) -> None:
    whole = bags.written(bags.honest_night(), compression="NONE")
    for at in range(8, len(whole), 131):
        folder = tmp_path / f"{at}"
        folder.mkdir()
        flipped = whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :]
        imported(folder, flipped)
        assert record_numbers(folder / "ledger")


@pytest.mark.parametrize("compression", ["ZSTD", "LZ4"])
def test_of_a_chunk_that_unpacks_to_more_than_memory_can_hold_only_the_beginning_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: str
) -> None:
    monkeypatch.setattr(mcap, "MAX_RECORD", 1 << 16)
    messages = bags.honest_night()
    bomb = bags.Said("/r1/scan", "sensor_msgs/msg/LaserScan", bytes(1 << 22))
    whole = bags.written([*messages, bomb], compression=compression, chunk_size=1 << 23)
    assert len(whole) < 1 << 16
    imported(tmp_path, whole)
    assert kinds(tmp_path / "ledger") == NIGHT
    told = [row["texts"][0] for row in seen(tmp_path) if row["kind"] == "unreadable"]
    assert told[-1] == "a chunk that unpacks to more than 65536 bytes"


def test_a_damaged_chunk_does_not_hide_the_next(tmp_path: Path) -> None:
    whole = bytearray(bags.written(bags.honest_night()))
    place = whole.index(b"\x28\xb5\x2f\xfd")  # the first frame of Zstandard
    whole[place : place + 4] = b"\x00\x00\x00\x00"
    made = imported(tmp_path, bytes(whole))
    assert seen(tmp_path)[0]["kind"] == "unreadable"
    assert 1 < made.records < 9


@pytest.mark.parametrize("behind", [b"garbage", bags.written(bags.honest_night()), b""])
def test_what_is_behind_the_end_of_a_file_is_a_record_that_cannot_be_read(tmp_path: Path, behind: bytes) -> None:
    whole = bags.written(bags.honest_night())
    made = imported(tmp_path, whole + behind)
    messages = len(bags.honest_night())
    assert made.records == messages + bool(behind)
    assert [row["kind"] for row in seen(tmp_path)[messages:]] == ["unreadable"] * bool(behind)


def test_another_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="expected a file of MCAP"):
        imported(tmp_path, b"#ROSBAG V2.0\n")


@pytest.mark.parametrize("other", [b"", b"{}\n"])
def test_another_file_behind_a_bag_is_refused_before_anything_is_recorded(
    call: Call, tmp_path: Path, other: bytes
) -> None:
    bag, wrong = tmp_path / "night.mcap", tmp_path / "wrong.mcap"
    bag.write_bytes(bags.written(bags.honest_night()))
    wrong.write_bytes(other)
    refused = call("import", tmp_path / "ledger", bag, wrong, "--as", "mcap")
    assert (refused.code, f"{wrong}: found" in refused.err) == (2, True)
    assert not (tmp_path / "ledger").exists()


@pytest.mark.parametrize(
    ("messages", "judged"),
    [
        ([bags.statuses("r1")], "A2, A4"),
        ([bags.logged("up"), bags.statuses("r1")], "A2, A4"),
        ([bags.statuses("r1")._replace(data=b"\x00\x01\x00\x00")], "nothing"),
        ([bags.statuses("r1")._replace(topic="/dock/_action/status")], "nothing"),
        ([bags.logged("up")], "nothing"),
    ],
)
def test_without_a_status_that_can_be_read_nothing_of_what_robots_do_is_observable(
    call: Call, tmp_path: Path, messages: list[bags.Said], judged: str
) -> None:
    file = filed(tmp_path, bags.written(messages), "night.mcap")
    said = call("import", tmp_path / "out", file, "--as", "mcap").good().out
    assert f"can be judged: {judged}\n" in said
    assert ("declared as recorded, but never seen: " in said) == (judged != "nothing")


def test_the_command_of_the_page_does_what_it_says(call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs" / "sources" / "mcap.md").read_text("utf-8")
    command = next(line for line in page.splitlines() if line.startswith("fsar-ledger import"))
    monkeypatch.chdir(tmp_path)
    filed(tmp_path, bags.written(bags.honest_night()), "night.mcap")
    assert "can be judged: A2, A4\n" in call(*command.split()[1:]).good().out
