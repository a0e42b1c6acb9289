"""Arguments that only Python can give, of another type, are refused with an error that names them."""

import shutil
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.api.ledger import Ledger
from fsar_ledger.base.errors import UsageError, checked

Question = Callable[[Ledger], object]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (lambda one: one.query(5), "name: found 5, expected text"),
        (lambda one: one.query_text(None), "name: found None, expected text"),
        (lambda one: one.sql(b"SELECT 1"), "select: found b'SELECT 1', expected text"),
        (lambda one: one.sql("SELECT 1", seconds="5"), "seconds: found '5', expected a whole number"),
        (lambda one: one.events(run=1, robot=["A1"]), r"robot: found \['A1'\], expected text"),
        (lambda one: one.stream_log(about=7), "about: found 7, expected text or a list of texts"),
        (lambda one: one.explain(1, request=["A1-1/2.1"]), "request: found .*, expected text"),
        (lambda one: one.state(1, at=5, by_commit="1"), "by_commit: found '1', expected a whole number"),
        (lambda one: one.why(100), "event: found 100, expected text or a pair"),
        (lambda one: one.verdicts(1, ["denials"]), "kind: found .*, expected text"),
        (lambda one: one.audit(invariant=1), "invariant: found 1, expected text or a list of texts"),
        (lambda one: one.audit(architecture=["fsar", 5]), "architecture: found .*, expected text or a list of texts"),
        (lambda one: one.verify(quick="no"), "quick: found 'no', expected True or False"),
        (lambda one: one.verify(cosigned="note"), "cosigned: found 'note', expected a list of paths"),
        (lambda one: one.prove("1:5", format=5), "format: found 5, expected text"),
        (
            lambda one: one.prove("1:5", out=""),
            "out=: found a file, expected a free name; a proof is never overwritten",
        ),
        (lambda one: one.export(7), "out: found 7, expected a path"),
        (lambda one: one.export("e.csv", "denials", "run=1"), "parameters: found 'run=1', expected a mapping of names"),
        (lambda one: one.open(7), "out: found 7, expected a path"),
        (lambda one: one.diff(1, 2, other=3), "other: found 3, expected a ledger, or its path"),
        (lambda one: one.view("v.html", 1, other=3), "other: found 3, expected a ledger, or its path"),
        (lambda _: fsar_ledger.open_ledger(None), "path: found None, expected a path"),  # type: ignore[arg-type]
        (lambda _: Ledger(5), "path: found 5, expected a path"),  # type: ignore[arg-type]
        (lambda _: fsar_ledger.Client(5, "token"), "url: found 5, expected text"),  # type: ignore[arg-type]
        (lambda _: fsar_ledger.cluster(5), "address: found 5, expected text"),  # type: ignore[arg-type]
    ],
)
def test_an_argument_of_another_type_is_refused_by_its_name(ledger: Ledger, asked: Question, said: str) -> None:
    with pytest.raises(UsageError, match=f"^{said}$"):
        asked(ledger)


@pytest.mark.slow
def test_a_ledger_beside_another_is_given_as_it_is_or_by_its_path(ledger: Ledger, tmp_path: Path) -> None:
    path = Path(shutil.copytree(ledger.path, tmp_path / "copy"))
    pages = [ledger.view(tmp_path / "two.html", 1, 2, other).file.read_bytes() for other in (Ledger(path), path)]
    assert pages[0] == pages[1]


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ({"logs": "night.jsonl", "format": "vda5050"}, "logs: found 'night.jsonl', expected a list of paths"),
        ({"logs": ["a"], "format": ["vda5050"]}, r"format: found \['vda5050'\], expected text"),
        ({"logs": ["a"], "format": "vda5050", "fleet": {"A": "agv"}}, "fleet: found {'A': 'agv'}, expected a path"),
        ({"logs": ["a"]}, "import: found neither of format and mapping, expected mcap, .*"),
    ],
)
def test_an_import_from_python_names_its_arguments_as_python_does(
    tmp_path: Path, named: dict[str, Any], said: str
) -> None:
    with pytest.raises(UsageError, match=f"^{said}$"):
        fsar_ledger.import_records(tmp_path / "out", **named)
    assert not (tmp_path / "out").exists()


def test_what_was_observed_is_told_by_texts(tmp_path: Path) -> None:
    with fsar_ledger.record(tmp_path / "out", observes=["task"], epoch=datetime(2026, 3, 1, tzinfo=UTC)) as one:
        for named, said in (
            ({"kind": 5}, "kind: found 5, expected text"),
            ({"kind": "k", "values": ["a"]}, r"values: found \['a'\], expected a mapping of names"),
            ({"kind": "k", "objects": {"a": None}}, "objects: found {'a': None}, expected a mapping of names"),
            ({"kind": "k", "body": b"x"}, "body: found b'x', expected text"),
        ):
            with pytest.raises(UsageError, match=f"^{said}$"):
                one.observed(**named)
        with pytest.raises(UsageError, match=r"^caused_by: found '1', expected a whole number$"):
            one.event("TaskArrived", task_id="t", caused_by="1")  # type: ignore[arg-type]
        with pytest.raises(UsageError, match=r"^when: found '10:00', expected a datetime$"):
            one.run_time_us("10:00")  # type: ignore[arg-type]
        assert one.observed("k", {"a": 1}, objects={"robot/A": "robot"}) == 2


def test_the_present_time_is_as_a_clock_tells_it(ledger: Ledger) -> None:
    assert ledger.verify(now_s=1_772_359_200.5).ok


def test_a_time_of_day_is_a_time_of_the_run_in_every_question(tmp_path: Path) -> None:
    began = datetime(2026, 3, 1, 10, tzinfo=UTC)
    with fsar_ledger.record(tmp_path / "out", epoch=began, run="night") as one:
        for second in range(5):
            one.observed(f"{second}", at=began + timedelta(seconds=second))
    asked, times = Ledger(tmp_path / "out"), ("2026-03-01T10:00:01Z", "2026-03-01T12:00:03+02:00")
    assert [logged.time_s for logged in asked.events("night", *times)] == [1, 2]
    assert [line["time_s"] for line in asked.log("night", *times)] == [1, 2]
    with pytest.raises(UsageError, match=r"^until: found the time of day 2026-.* for every run; expected seconds"):
        asked.events(until=times[1])


def test_what_is_no_question_of_types_is_left_to_the_function() -> None:
    @checked
    def function(count: int, share: float = 0.5, *more: str, when: float | str | None = None, **others: int) -> object:
        return (count, share, more, when, others)

    assert function(1, 2, "a", when=object, x="y") == (1, 2, ("a",), object, {"x": "y"})  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="missing 1 required positional argument: 'count'"):
        function()  # type: ignore[call-arg]
    for wrong in (True, 1.5, None, "1"):
        with pytest.raises(UsageError, match=r"^count: found .*, expected a whole number$"):
            function(wrong)  # type: ignore[arg-type]
