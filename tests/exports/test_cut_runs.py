"""A run that was cut is one run in every export and answer, as the same run that was not cut."""

import json
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.fleet import RunContinued
from fsar_ledger.ledger.opening import open_for_answers, open_ledger
from fsar_ledger.ledger.store.append import Writer
from tests.quick import few
from tests.runtime.test_cuts import Day, S, commands_of
from tests.runtime.test_wrong_cuts import with_fields

PARTS = ("hall", "hall.2", "hall.3")
OF_ANY = few([None, *PARTS], ["hall.2"], [None, "hall.3"])


@pytest.fixture(scope="module")
def halls(tmp_path_factory: pytest.TempPathFactory) -> tuple[fsar_ledger.Ledger, fsar_ledger.Ledger]:
    """The same commands given to a run that is not cut, and to one that is cut twice, with a segment for each part."""
    commands, ends_us = commands_of(2)
    folder = tmp_path_factory.mktemp("halls")
    whole = Day(folder / "whole").plays(commands, ends_us=ends_us)
    cut = Day(folder / "parts").plays(commands, (20, 50), ends_us)
    with Writer(folder / "cut", "tests/cut") as writer:
        for run in open_ledger(cut.ledger).runs():
            writer.commit([with_fields(run, goes_on=True)])
            writer.seal()
    return fsar_ledger.Ledger(whole.ledger), fsar_ledger.Ledger(folder / "cut")


def cuts(ledger: fsar_ledger.Ledger) -> list[int]:
    return [one.seq for one in ledger.events("hall") if isinstance(one.event, RunContinued)]


def document(ledger: fsar_ledger.Ledger, out: Path, format: str, run: str | None) -> Any:
    ledger.export(out, format=format, run=run)
    return json.loads(out.read_bytes())


@pytest.mark.parametrize("run", OF_ANY)
def test_a_log_of_ocel_has_the_objects_and_events_of_the_uncut_run(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger], tmp_path: Path, run: str | None
) -> None:
    whole = document(halls[0], tmp_path / "whole.json", "ocel", None)
    cut = document(halls[1], tmp_path / "cut.json", "ocel", run)

    def labels(found: Any, kind: str) -> list[str]:
        return sorted(one["id"].partition(":")[2] for one in found[kind])

    assert labels(cut, "objects") == labels(whole, "objects")
    assert Counter(one["type"] for one in cut["events"]) == Counter(one["type"] for one in whole["events"])
    seqs = [int(one["id"].partition(":")[2]) for one in cut["events"]]
    assert seqs == sorted(set(seqs)), "they count on"
    assert {one["id"].partition(":")[0] for one in cut["events"]} == {"3"}


@pytest.mark.parametrize("run", OF_ANY)
def test_a_trace_of_otlp_has_the_spans_of_the_uncut_run_and_ids_that_no_cut_changes(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger], tmp_path: Path, run: str | None
) -> None:
    def spans(found: Any) -> list[tuple[str, ...]]:
        [resource] = found["resourceSpans"]
        [scope] = resource["scopeSpans"]
        names = ("traceId", "spanId", "name", "startTimeUnixNano", "endTimeUnixNano")
        return sorted(tuple(str(one[name]) for name in names) for one in scope["spans"])

    whole = document(halls[0], tmp_path / "whole.json", "otlp", None)
    assert spans(document(halls[1], tmp_path / "cut.json", "otlp", run)) == spans(whole)


@pytest.mark.parametrize("run", OF_ANY)
def test_a_trace_of_perfetto_shows_the_whole_run(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger], tmp_path: Path, run: str | None
) -> None:
    answer = halls[1].export(tmp_path / "cut.json", format="perfetto", run=run)
    assert answer.row_count == len(list(halls[0].events())) + 2
    halls[1].export(tmp_path / "again.json", format="perfetto", run="hall.3")
    assert (tmp_path / "cut.json").read_bytes() == (tmp_path / "again.json").read_bytes()


def test_two_runs_of_which_one_was_cut_are_not_one_trace(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger], tmp_path: Path
) -> None:
    with Writer(tmp_path / "two", "tests/cut") as writer:
        for run in (
            *open_ledger(halls[1].path).runs(),
            with_fields(next(open_ledger(halls[0].path).runs()), run_id="b"),
        ):
            writer.commit([with_fields(run, goes_on=True)])
    with pytest.raises(UsageError, match="found 2 runs, expected one"):
        fsar_ledger.Ledger(tmp_path / "two").export(tmp_path / "two.json", format="perfetto")


@pytest.mark.parametrize("run", OF_ANY)
def test_a_recording_of_mcap_has_rows_as_stored_and_log_messages_that_count_on(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger], tmp_path: Path, run: str | None
) -> None:
    reader = pytest.importorskip("mcap.reader", reason="make test-all installs it")
    halls[1].export(tmp_path / "cut.mcap", format="mcap", run=run)
    with (tmp_path / "cut.mcap").open("rb") as file:
        found = [(channel.topic, message) for _, channel, message in reader.make_reader(file).iter_messages()]
    view = open_for_answers(halls[1].path)
    assert [message.data for topic, message in found if topic == "/fsar/events"] == view.rows(0, view.head.size)
    told = [json.loads(message.data) for topic, message in found if topic != "/fsar/events"]
    kinds = {one.seq: type(one.event).__name__ for one in halls[1].events("hall")}
    assert {one["file"] for one in told} == {"hall.3"}
    assert all(one["message"].partition(" ")[0] == kinds[one["line"]] for one in told)
    assert max(one["line"] for one in told) > len(kinds) // 2


def test_a_table_of_delta_and_a_file_of_events_have_rows_as_stored(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger], tmp_path: Path
) -> None:
    halls[1].export(tmp_path / "events.ndjson")
    rows = [json.loads(line) for line in (tmp_path / "events.ndjson").read_bytes().splitlines()]
    sizes = {run.run_id: len(run.events) for run in open_ledger(halls[1].path).runs()}
    assert Counter(row["run_id"] for row in rows) == sizes
    pytest.importorskip("deltalake", reason="make test-all installs it")
    assert halls[1].export(tmp_path / "table", format="delta").row_count == len(rows)


@pytest.mark.slow
def test_all_events_and_all_lines_are_those_of_one_run(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger],
) -> None:
    every = list(halls[1].events())
    assert [(one.run, one.seq) for one in every] == [("hall.3", seq) for seq in range(len(every))]
    assert [one.event for one in every if not isinstance(one.event, RunContinued)] == [
        one.event for one in halls[0].events()
    ]
    streamed = [row for table in halls[1].stream_log() for row in table.rows()]
    assert streamed == halls[1].log("all").rows() == halls[1].log().rows()
    assert [row["seq"] for row in streamed] == list(range(len(every)))


@pytest.mark.slow
def test_who_follows_a_log_over_a_cut_is_told_each_line_once(tmp_path: Path) -> None:
    day = Day(tmp_path / "ledger")
    day.brings("t1")
    steps = iter(("cut", "task", "seal", "cut", "task"))

    def pause() -> None:
        match next(steps, None):
            case "cut":
                day.at(day.now_us + S).one.cut()
            case "task":
                day.at(day.now_us + S).brings(f"t{day.now_us}")
            case "seal":
                day.one.close()
                with Writer(day.ledger, "fsar-ledger/live") as writer:
                    writer.seal()
                day.one = day.opened()
            case None:
                raise KeyboardInterrupt

    told: list[tuple[int, str]] = []

    def follow() -> None:
        for table in fsar_ledger.Ledger(day.ledger).stream_log(pause=pause):
            told.extend((row["seq"], row["message"]) for row in table.rows())

    with pytest.raises(KeyboardInterrupt):
        follow()
    day.one.close()
    assert told == [(row["seq"], row["message"]) for row in fsar_ledger.Ledger(day.ledger).log("all").rows()]
    assert [message for _, message in told if message.startswith("goes on from")] == [
        "goes on from: hall",
        "goes on from: hall.2",
    ]


@pytest.mark.parametrize("run", few(PARTS, [], ["hall.2", "hall.3"]))
def test_what_is_asked_about_work_is_answered_of_the_whole_run(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger], tmp_path: Path, run: str
) -> None:
    whole, cut = halls

    def requests(rows: list[dict[str, Any]]) -> list[tuple[Any, ...]]:
        names = ("action_id", "asked_by", "allowed_by", "denied_by", "executed_by", "result")
        return [tuple(row[name] for name in names) for row in rows]

    from fsar_ledger.api.explain import requests as requests_of

    expected = requests(requests_of(whole).rows())
    assert requests(requests_of(cut, run).rows()) == requests(requests_of(cut).rows()) == expected
    action = expected[0][0]
    account = cut.explain(run, action)
    assert (account.run, len(account.timeline)) == ("hall.3", len(whole.explain("hall", action).timeline))
    assert cut.view(tmp_path / "cut.html", run).runs == ("hall.3",)
    found = cut.diff(run, "hall", other=whole)
    assert (found.first, found.counts.get("only second", 0)) == ("hall.3", 0)
    assert found.counts["only first"] == 2, "where it was cut"


@pytest.mark.parametrize("run", few(PARTS, ["hall.2"]))
def test_a_moment_and_a_log_of_a_part_are_of_that_part(
    halls: tuple[fsar_ledger.Ledger, fsar_ledger.Ledger], run: str
) -> None:
    ends = dict(zip(PARTS, (*cuts(halls[1]), len(list(halls[1].events()))), strict=True))
    assert halls[1].state(run).seq == halls[1].log(run).rows()[-1]["seq"] == ends[run] - 1
