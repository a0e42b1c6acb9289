"""The library of MCAP reads back every row, in order, and the messages of each principal."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.ledger.opening import open_for_answers
from tests.exports.conftest import Asked

reader = pytest.importorskip("mcap.reader", reason="make test-all installs it")


def messages(path: Path, topic: str | None = None, *, by_time: bool = False) -> list[Any]:
    """Schema, channel and message of each message, in the order of the file or of time."""
    with path.open("rb") as file:
        topics = None if topic is None else [topic]
        return list(reader.make_reader(file).iter_messages(topics, log_time_order=by_time))


@pytest.fixture(scope="module")
def recording(growing: fsar_ledger.Ledger, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mcap") / "fleet.mcap"
    growing.export(out, format="mcap")
    return out


def test_the_rows_are_those_of_the_ledger_in_its_order(recording: Path, growing: fsar_ledger.Ledger) -> None:
    view = open_for_answers(growing.path)
    assert view.journal.frames
    found = messages(recording, "/fsar/events")
    assert [message.data for _, _, message in found] == view.rows(0, view.head.size)
    assert {schema.name for schema, _, _ in found} == {"fsar.Event"}


def test_a_run_is_in_order_of_time_too(growing: fsar_ledger.Ledger, tmp_path: Path) -> None:
    """The fifth is in the journal."""
    answer = growing.export(tmp_path / "run.mcap", format="mcap", run=5)
    found = messages(tmp_path / "run.mcap", "/fsar/events", by_time=True)
    rows = [json.loads(message.data) for _, _, message in found]
    assert [row["seq"] for row in rows] == list(range(answer.row_count))
    assert {row["run_id"] for row in rows} == {list(growing.numbers())[4]}
    assert [message.log_time for _, _, message in found] == [row["time_us"] * 1_000 for row in rows]


def test_a_principal_has_a_log_message_for_each_event_that_names_it(ledger: fsar_ledger.Ledger, asked: Asked) -> None:
    out = ledger.path.parent / "whole.mcap"
    ledger.export(out, format="mcap")
    with out.open("rb") as file:
        (about,) = reader.make_reader(file).iter_metadata()
    assert json.loads(about.metadata["runs"]) == list(ledger.numbers())  # and no plan
    found = messages(out, "/fsar/supervisor/fleet")
    rows = asked(
        "SELECT run_id, seq, type FROM events WHERE 'supervisor/fleet' IN (decided_by, requested_by, supervised_by, "
        "supervisor, claimant, issued_by, holder, written_by) OR list_contains(path, 'supervisor/fleet')"
    )
    assert rows
    logs = [json.loads(message.data) for _, _, message in found]
    assert {schema.name for schema, _, _ in found} == {"foxglove.Log"}
    assert Counter((log["file"], log["line"], log["message"].split()[0]) for log in logs) == Counter(
        (row["run_id"], row["seq"], row["type"].partition(".")[0]) for row in rows
    )
    assert {log["name"] for log in logs} == {"supervisor/fleet"}


def test_a_log_message_has_what_foxglove_shows(recording: Path) -> None:
    found = messages(recording, "/fsar/robot/A1")
    schema = json.loads(found[0][0].data)
    levels = set()
    for _, _, message in found:
        log = json.loads(message.data)
        assert log.keys() == schema["properties"].keys()
        assert log["timestamp"]["sec"] * 10**9 + log["timestamp"]["nsec"] == message.log_time
        levels.add((log["message"].split()[0], log["level"]))
    assert {("RequestDenied", 3), ("ExecutionStarted", 2)} <= levels


def test_the_checkpoint_and_what_the_ledger_is_go_along(recording: Path, growing: fsar_ledger.Ledger) -> None:
    with recording.open("rb") as file:
        made = reader.make_reader(file)
        (note,), (about,) = made.iter_attachments(), made.iter_metadata()
    assert note.data.decode() == str(open_for_answers(growing.path).note())
    head = growing.head
    assert (about.metadata["root"], about.metadata["size"]) == (head.root, str(head.size))
    assert json.loads(about.metadata["runs"]) == list(growing.numbers())
