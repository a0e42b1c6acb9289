"""An import keeps every record once, in order, whatever the input holds and however often it was interrupted."""

import gzip
import json
import sys
from io import BytesIO
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.source import Observed
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import LinkWentDown
from fsar_ledger.sources.adapter import Input, adapter_of
from fsar_ledger.sources.columns import storable
from fsar_ledger.sources.importing import import_files
from fsar_ledger.sources.recorder import Recorder
from tests.cli.conftest import Call, one_message
from tests.sources import vda
from tests.sources.importing import filed, imported, is_good, kinds, record_numbers, recorded, rows
from tests.sources.vda import message, order, state

COMMAND = (sys.executable, "-m", "fsar_ledger")
ONE = message(0, "0001", "connection", connectionState="ONLINE")

KEYED = """
format = "own/1"
observes = ["TaskArrived", "TaskCompleted"]
[[event]]
match = { "/what" = "arrived" }
type = "TaskArrived"
key = "{/task}"
fields = { task_id = "/task" }
[[event]]
match = { "/what" = "done" }
type = "TaskCompleted"
cause = "{/task}"
fields = { task_id = "/task" }
"""


def without_input(found: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in found if row["type"] != "SourceOpened.v1"]


def test_the_same_input_is_refused_and_nothing_is_added(tmp_path: Path) -> None:
    night, ledger = filed(tmp_path, vda.long_night(2)), tmp_path / "ledger"
    imported(ledger, night)
    before = rows(ledger)
    with pytest.raises(UsageError, match=r"found the same input .* 16 records"):
        imported(ledger, night)
    assert rows(ledger) == before


def test_nobody_goes_on_unsigned_where_a_key_signed(tmp_path: Path, call: Call) -> None:
    key, ledger = tmp_path / "fleet.key", tmp_path / "ledger"
    call("key", "new", key).good()
    fsar_ledger.record(ledger, run="r", key=key).close()
    before = rows(ledger)
    night = ("import", ledger, filed(tmp_path, vda.long_night(2)), "--as", "vda5050")
    for words in (night, ("record", ledger, "--run", "r"), ("record", ledger, "--run", "s")):
        one_message(
            call(*words), 2, "found a newest commit signed by ", "give it with --key, or continue in a new ledger"
        )
    assert rows(ledger) == before
    call(*night, "--key", key).good()


@pytest.mark.parametrize("format", ["vda5050", "otlp", "ocel", "rmf"])
def test_a_compressed_file_is_said_to_be_one(tmp_path: Path, call: Call, format: str) -> None:
    night = filed(tmp_path, gzip.compress(vda.written(vda.long_night(2))), "night.jsonl.gz")
    refused = call("import", tmp_path / "ledger", night, "--as", format)
    assert (refused.code, "found a compressed file, expected one that is not" in refused.err) == (2, True)
    assert f"`zcat {night}`" in refused.err
    assert not (tmp_path / "ledger").exists()


def test_standard_input_that_is_compressed_is_said_to_be(tmp_path: Path) -> None:
    for packed, writer in ((gzip.compress(b"{}"), "zcat"), (b"\x28\xb5\x2f\xfd", "zstdcat")):
        stdin = Input("stdin", None, BytesIO(packed))
        with pytest.raises(UsageError, match=f"nothing was recorded: pipe it through `{writer}`"):
            next(iter(adapter_of("vda5050", None)[0].read([stdin])))


def test_a_compressed_file_beside_another_is_said_to_be_one_before_anything_is_recorded(
    tmp_path: Path, call: Call
) -> None:
    night, packed = filed(tmp_path, vda.long_night(2)), tmp_path / "second.jsonl.gz"
    packed.write_bytes(gzip.compress(vda.written(vda.long_night(3))))
    one_message(call("import", tmp_path / "ledger", night, packed, "--as", "vda5050"), 2, f"`zcat {packed}`")
    assert not (tmp_path / "ledger").exists()


def test_a_file_that_is_named_twice_is_refused_since_all_of_it_would_count_twice(tmp_path: Path, call: Call) -> None:
    night, link = filed(tmp_path, vda.long_night(2)), tmp_path / "link.jsonl"
    link.symlink_to(night)
    refused = f"{link}: found the file {night} again, expected each file once"
    one_message(call("import", tmp_path / "ledger", night, link, "--as", "vda5050"), 2, refused)
    assert not (tmp_path / "ledger").exists()


def test_a_run_says_which_adapter_read_what_and_how_much_of_it_until_when(tmp_path: Path) -> None:
    imported(tmp_path / "ledger", filed(tmp_path, vda.long_night(2)))
    started, begun, *_, closed = rows(tmp_path / "ledger")
    assert started["source"] == "vda5050"
    assert [begun[name] for name in ("source", "format", "adapter")] == ["vda5050", "vda5050/2.1.0", "vda5050/1"]
    assert (closed["until_us"], closed["record_count"]) == (16_000_000, 16)


@pytest.mark.slow
def test_a_file_that_is_on_file_under_another_name_is_said_to_be(call: Call, tmp_path: Path) -> None:
    out = str(tmp_path / "out")

    def said(name: str, lines: list[vda.Line]) -> list[str]:
        code, told, _ = call("import", out, str(filed(tmp_path, lines, name)), "--as", "vda5050")
        assert code == 0
        return [line for line in told.splitlines() if "recorded before" in line]

    night, other = vda.long_night(2), vda.long_night(3)
    assert said("night.jsonl", night) == said("second.jsonl", other) == []
    assert said("copy.jsonl", night) == ["recorded before, as run night: counts twice"]
    code, told, _ = call("import", out, str(tmp_path / "night.jsonl"), "--as", "vda5050", "--run", "again", "--json")
    assert (code, json.loads(told)["also"]) == (0, ["copy", "night"])


def test_an_input_that_grows_twice_is_as_one_that_was_whole(tmp_path: Path) -> None:
    whole = vda.long_night(9)
    for end in (11, 40, len(whole)):
        made = imported(tmp_path / "ledger", filed(tmp_path, whole[:end]))
        assert made.records == end
    assert made.before == 40
    imported(tmp_path / "once", filed(tmp_path, whole))
    assert recorded(tmp_path / "ledger") == recorded(tmp_path / "once")
    assert is_good(tmp_path / "ledger")


def test_causes_are_the_same_when_an_input_grew_twice(tmp_path: Path) -> None:
    """A key that was given before the first interruption names its event after the second."""
    mapping, night = tmp_path / "own.toml", tmp_path / "own.jsonl"
    mapping.write_text(KEYED)
    lines = [msgspec.json.encode({"what": "arrived", "task": "a"})]
    lines += [msgspec.json.encode({"what": "tick"})] * 3 + [msgspec.json.encode({"what": "done", "task": "a"})]
    for name, ends in (("ledger", (1, 2, 3, 5)), ("once", (5,))):
        for end in ends:
            night.write_bytes(b"\n".join(lines[:end]) + b"\n")
            importing_by(tmp_path / name, night, mapping)
    assert recorded(tmp_path / "ledger") == recorded(tmp_path / "once")
    last = recorded(tmp_path / "ledger")[-1]
    assert (last["type"], recorded(tmp_path / "ledger")[last["caused_by"]]["type"]) == (
        "TaskCompleted.v1",
        "TaskArrived.v1",
    )


def test_a_last_line_that_was_not_whole_yet_is_kept_and_read_again_when_it_is(tmp_path: Path) -> None:
    whole = vda.written(vda.long_night(3))
    for end in (4000, 4100, 9000, len(whole)):
        imported(tmp_path / "ledger", filed(tmp_path, whole[:end]))
    good = [row for row in recorded(tmp_path / "ledger") if row.get("kind") != "unreadable"]
    imported(tmp_path / "once", filed(tmp_path, whole))
    once = recorded(tmp_path / "once")
    different = ("seq", "caused_by")
    assert [{name: row[name] for name in row if name not in different} for row in good] == [
        {name: row[name] for name in row if name not in different} for row in once
    ]
    assert any(row.get("kind") == "unreadable" for row in rows(tmp_path / "ledger"))


def test_a_line_that_was_not_whole_moves_no_cause(tmp_path: Path) -> None:
    mapping, night = tmp_path / "own.toml", tmp_path / "own.jsonl"
    mapping.write_text(KEYED)
    whole = b'{"what": "arrived", "task": "a"}\n{"what": "tick"}\n{"what": "tick"}\n{"what": "done", "task": "a"}\n'
    for end in (40, 55, 70, len(whole)):
        night.write_bytes(whole[:end])
        importing_by(tmp_path / "ledger", night, mapping)
    run = rows(tmp_path / "ledger")
    assert [row["type"] for row in run if row.get("kind") == "unreadable"] == ["Observed.v1"] * 3
    done = next(row for row in run if row["type"] == "TaskCompleted.v1")
    assert run[done["caused_by"]]["type"] == "TaskArrived.v1"


def test_another_input_under_the_same_name_is_refused(tmp_path: Path) -> None:
    imported(tmp_path / "ledger", filed(tmp_path, vda.long_night(2)))
    before = rows(tmp_path / "ledger")
    with pytest.raises(UsageError, match="found another record 1 in the input"):
        imported(tmp_path / "ledger", filed(tmp_path, list(reversed(vda.long_night(2)))))
    altered = [{**line, "topic": line["topic"] + "s"} if at == 6 else line for at, line in enumerate(vda.long_night(2))]
    for end in ([], vda.long_night(3)[16:]):
        with pytest.raises(UsageError, match="found another record 7 in the input"):
            imported(tmp_path / "ledger", filed(tmp_path, [*altered, *end]))
    assert rows(tmp_path / "ledger") == before


@pytest.mark.parametrize("imported_before", [0, 9])
def test_a_run_into_which_something_was_recorded_takes_no_imports(tmp_path: Path, imported_before: int) -> None:
    whole = vda.long_night(2)
    if imported_before:
        imported(tmp_path / "ledger", filed(tmp_path, whole[:imported_before]))
    with Recorder(tmp_path / "ledger", run="night", observes=() if imported_before else ["TaskArrived"]) as recorder:
        recorder.event("TaskArrived", task_id="by hand")
    before = rows(tmp_path / "ledger")
    found = "run night: found a run into which events were recorded as they happened, expected one that holds only"
    with pytest.raises(UsageError, match=f"{found} imports; what is on record is kept: give the import another name"):
        imported(tmp_path / "ledger", filed(tmp_path, whole))
    assert rows(tmp_path / "ledger") == before


def test_an_input_that_was_cut_short_is_refused(tmp_path: Path) -> None:
    imported(tmp_path / "ledger", filed(tmp_path, vda.long_night(2)))
    with pytest.raises(UsageError, match=r"found 5 records in the input, expected at least the 16 on record"):
        imported(tmp_path / "ledger", filed(tmp_path, vda.long_night(2)[:5]))


def test_a_run_goes_on_only_with_the_fleet_that_it_began_with(tmp_path: Path) -> None:
    whole = vda.long_night(2)
    imported(tmp_path / "ledger", filed(tmp_path, whole[:9]), fleet={"KIT.0001": "agv"})
    with pytest.raises(UsageError, match="expected the fleet with which it began"):
        imported(tmp_path / "ledger", filed(tmp_path, whole), fleet={"KIT.0001": "agv", "KIT.0002": "agv"})
    imported(tmp_path / "ledger", filed(tmp_path, whole), fleet={"KIT.0001": "agv"})
    assert [row["type"] for row in rows(tmp_path / "ledger")].count("RobotJoined.v1") == 1


def test_a_run_goes_on_only_with_the_mapping_that_it_began_with(tmp_path: Path) -> None:
    mapping, night = tmp_path / "own.toml", tmp_path / "own.jsonl"
    mapping.write_text(KEYED)
    night.write_text('{"what": "tick"}\n')
    importing_by(tmp_path / "ledger", night, mapping)
    mapping.write_text(KEYED + "\n")
    night.write_text('{"what": "tick"}\n' * 2)
    with pytest.raises(UsageError, match="found a run that was imported with another mapping"):
        importing_by(tmp_path / "ledger", night, mapping)


def test_blank_lines_other_line_ends_and_a_byte_order_mark_make_no_difference(tmp_path: Path) -> None:
    lines = vda.written(vda.long_night(2)).splitlines()
    imported(tmp_path / "plain", filed(tmp_path, b"\n".join(lines)))
    imported(tmp_path / "odd", filed(tmp_path, b"\xef\xbb\xbf" + b"\r\n\r\n  \n".join(lines) + b"\r\n\n"))
    assert without_input(rows(tmp_path / "plain")) == without_input(rows(tmp_path / "odd"))


@pytest.mark.parametrize(
    "line",
    [
        *(
            b"\xff\xfe{}",
            b'{"orderId": "\xc3"}',
            b"[1, 2]",
            b"{",
            b"[" * 100_000,
            b'{"orderId": "\\ud800"}',
            b"\x00\x01",
        ),
        b'{"orderId": "o1", "nodes": [], "orderId": "o2"}',
    ],
    ids=["utf-16", "latin-1", "an array", "cut", "deep", "half a character", "binary", "a key twice"],
)
def test_what_cannot_be_read_is_kept_with_its_place(tmp_path: Path, line: bytes) -> None:
    filed(tmp_path, vda.written([ONE]) + line + b"\n" + vda.written([ONE]))
    made = imported(tmp_path / "ledger", tmp_path / "night.jsonl", keeps_bodies=True)
    assert made.records == 3
    kept = [row for row in rows(tmp_path / "ledger") if row.get("record_number") == 2]
    assert [row["kind"] for row in kept] == ["unreadable"]
    assert made.not_understood[0].first == 2
    assert is_good(tmp_path / "ledger")


@pytest.mark.parametrize("keeps_bodies", [False, True])
def test_a_line_of_twenty_megabytes_is_kept_in_parts(tmp_path: Path, keeps_bodies: bool) -> None:
    long = b'{"orderId": "' + b"x" * 20_000_000 + b'"}\n'
    filed(tmp_path, vda.written([ONE]) + long + vda.written([ONE]))
    made = imported(tmp_path / "ledger", tmp_path / "night.jsonl", keeps_bodies=keeps_bodies)
    assert (made.records, record_numbers(tmp_path / "ledger")) == (4, [1, 2, 3, 4])


@pytest.mark.slow
def test_bodies_of_any_number_are_kept_whole(tmp_path: Path) -> None:
    """More than a commit of a journal takes."""
    lines = [message(at, "0001", "visualization", agvPosition={"map": "m" * 5_000}) for at in range(4_200)]
    made = imported(tmp_path / "ledger", filed(tmp_path, lines), keeps_bodies=True)
    assert made.records == 4_200
    last = rows(tmp_path / "ledger")[-2]
    assert json.loads(last["body"]) == lines[-1]


def test_a_record_of_which_more_follows_than_a_journal_takes_is_committed_whole(tmp_path: Path) -> None:
    many: dict[str, Any] = {f"p{number}": "RUNNING" for number in range(17_000)}
    imported(tmp_path / "ledger", filed(tmp_path, [order(0, "0001", "a"), state(1, "0001", "a", **many)]))
    assert kinds(tmp_path / "ledger").count("ExecutionStarted") == 17_000


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "found no record"),
        (b"\n\n", "found no record"),
        (b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 99, "found b'\\x89PNG'"),
        (b"hello\n" * 3, "night: found b'hello' (JSON is malformed: invalid character (byte 0)) and no such record"),
        (b'{"orderId": "1", "orderId": "2"}', "(field orderId: found it more than once, expected it once) and no such"),
    ],
    ids=["empty", "blank", "binary", "text", "a key twice"],
)
def test_what_is_no_recording_is_refused_and_no_ledger_is_made(
    call: Call, tmp_path: Path, content: bytes, said: str
) -> None:
    file = filed(tmp_path, content)
    one_message(call("import", tmp_path / "ledger", file, "--as", "vda5050"), 2, said)
    assert not (tmp_path / "ledger").exists()


def test_a_missing_file_and_a_folder_are_refused(call: Call, tmp_path: Path) -> None:
    one_message(call("import", tmp_path / "l", tmp_path / "none", "--as", "vda5050"), 2, "No such file")
    one_message(call("import", tmp_path / "l", tmp_path, "--as", "vda5050"), 2, "Is a directory")
    assert not (tmp_path / "l").exists()


def test_the_beginning_of_a_run_says_the_first_time_though_the_first_line_has_none(tmp_path: Path) -> None:
    timeless = {"topic": "a/b/c/0001/connection", "payload": {"connectionState": "ONLINE"}}
    imported(tmp_path / "ledger", filed(tmp_path, [timeless, message(5, "0001", "connection", connectionState="x")]))
    assert rows(tmp_path / "ledger")[0]["epoch"] == "2026-03-01T10:00:05.100000Z"


@pytest.mark.parametrize("text", ["2026-03-01", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-12:00", "x", ""])
def test_a_time_of_any_form_is_no_failure(tmp_path: Path, text: str) -> None:
    odd = ONE | {"received": text, "payload": ONE["payload"] | {"timestamp": text}}
    imported(tmp_path / "ledger", filed(tmp_path, [odd, ONE, odd]))
    assert record_numbers(tmp_path / "ledger") == [1, 2, 3]


def test_text_that_cannot_be_printed_is_escaped_also_in_what_follows(tmp_path: Path) -> None:
    imported(tmp_path / "ledger", filed(tmp_path, [order(0, "0001", "a\x1b[2J\n"), state(1, "0001", "a\x1b[2J\n")]))
    arrived = next(row for row in rows(tmp_path / "ledger") if row["type"] == "TaskArrived.v1")
    assert arrived["task_id"] == "a\\x1b[2J\\n"
    assert "task/a\\x1b[2J\\n" in next(row for row in rows(tmp_path / "ledger") if row.get("objects"))["objects"]
    assert is_good(tmp_path / "ledger")


def test_text_that_can_be_printed_stays_as_it_is() -> None:
    event = TaskCompleted("משימה Ω")
    assert storable(event) is event
    assert storable(LinkWentDown(Robot("robot/a\tb"))) == LinkWentDown(Robot("robot/a\\tb"))
    assert storable(Observed(source="s", kind="k", names=("a\n",), texts=("b",))).names == ("a\\n",)  # type: ignore[attr-defined]


def importing_by(ledger: Path, night: Path, mapping: Path) -> None:
    adapter, digest = adapter_of(None, mapping)
    with night.open("rb") as file:
        import_files(ledger, [Input("own", night, file)], adapter, run="night", mapping_sha256=digest)
