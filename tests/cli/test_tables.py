"""Tables fit the terminal they are shown on, and are plain text, the same at any width, where there is none."""

import re
import sys
from pathlib import Path

import pytest

from fsar_ledger import Ledger
from fsar_ledger.api.tables import fitted, table_text
from fsar_ledger.base.printable import columns_of
from fsar_ledger.metrics.own_sql import GROUPS
from tests.cli.conftest import Call, one_message
from tests.cli.terminals import left_of, on_a_terminal, on_a_terminal_here, stream_of
from tests.running import ran
from tests.terminal import CLAIM, PAINT, painted

WIDTHS = (80, 120, 200)
VERBS = {
    "info": (),
    "metrics": (),
    "statistics": ("--memory", "2000"),
    "compare": ("--first", "fsar", "--second", "cfc"),
    "study run multiverse": ("--metric", "human_intervention"),
    "audit": ("--memory", "2000"),
    "explain": (),
    "sql": ("SELECT * FROM events LIMIT 9",),
}
"""Every verb that shows a table of a ledger, but for `query`, which names one first."""
QUERIES = (
    *("runs", "failures", "requests", "denials", "supervisor_of"),
    *("policy_windows", "metric_summary", "event_principals"),
)
RUNS = [f"fsar.full.{scenario}.n4.s42.r{number:04}-abc" for scenario in ("door", "relay") for number in (1, 2)]


STORIES = (("explain", "--run", "3", "--request", "A1-1/2.1"), ("log", "--run", "3"), ("verify",))
"""Verbs that tell a story, or say a sentence."""


def calls(ledger: Path) -> list[tuple[object, ...]]:
    listing: list[tuple[object, ...]] = [("query", "--list"), ("query", "--list", "--all")]
    return (
        listing
        + [(*verb.split(), ledger, *more) for verb, more in VERBS.items()]
        + [(verb, ledger, *more) for verb, *more in STORIES]
        + [("query", name, ledger) for name in QUERIES]
    )


def wide(line: str) -> int:
    return sum(map(columns_of, line))


@pytest.mark.slow
def test_no_line_of_any_verb_is_wider_than_the_terminal(ledger: Path) -> None:
    for number, arguments in enumerate([("--help",), *calls(ledger)]):
        for width in WIDTHS if number % 5 == 0 else WIDTHS[:1]:  # all go through one renderer
            text = on_a_terminal_here(width, *arguments)
            assert text.strip(), arguments
            assert [line for line in text.split("\n") if wide(line) > width] == [], arguments
            assert "\x1b" not in text, arguments


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [("metrics", "LEDGER"), ("log", "LEDGER", "--run", "3")], ids=" ".join)
def test_a_command_of_its_own_shows_the_same_on_a_terminal(ledger: Path, arguments: tuple[str, ...]) -> None:
    words = [str(ledger) if word == "LEDGER" else word for word in arguments]
    text, _ = on_a_terminal(100, "-m", "fsar_ledger", *words)
    assert text == on_a_terminal_here(100, *words)
    assert max(map(wide, text.split("\n"))) in range(60, 101)


@pytest.mark.slow
def test_piped_a_verb_gives_the_same_bytes_at_any_width(
    ledger: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    for arguments in calls(ledger)[::4]:
        monkeypatch.setenv("COLUMNS", "80")
        narrow = call(*arguments)
        monkeypatch.setenv("COLUMNS", "200")
        assert call(*arguments) == narrow, arguments


def test_a_table_fits_the_terminal_and_is_whole_with_wide(ledger: Path, call: Call) -> None:
    arguments = ("query", "failures", ledger)
    fitting = on_a_terminal_here(80, *arguments)
    whole = on_a_terminal_here(500, *arguments, "--wide")
    assert max(map(wide, fitting.split("\n"))) <= 80
    assert fitting.startswith("run_id ")
    assert "\nnot shown: " in fitting
    assert whole == call(*arguments).out == call(*arguments, "--wide").out


TEXTS: dict[str, tuple[list[dict[str, object]], str]] = {
    "what is the same in every row is said once above": (
        [{"architecture": "fsar", "seed": 42, "note": None, "robot": robot} for robot in ("A1", "B1")],
        "in every row: architecture fsar, seed 42\nNULL in every row: note\n\nrobot\n-----\nA1\nB1\n",
    ),
    "a value said once cannot look like two": (
        [{"robot": "A1, seed 43", "n": n} for n in (1, 2)],
        "in every row: robot 'A1, seed 43'\n\nn\n-\n1\n2\n",
    ),
    "rows that are all alike keep a column": ([{"a": 1, "b": 2}] * 2, "in every row: b 2\n\na\n-\n1\n1\n"),
    "numbers stand to the right": ([{"a": "x", "n": 1}, {"a": "yy", "n": 100}], "a     n\n--  ---\nx     1\nyy  100\n"),
    "a single row that does not fit is a list": (
        [{"run_id": "r" * 80, "robot": "robot/A1", "note": None}],
        f"run_id  {'r' * 80}\nrobot   robot/A1\nnote    -\n",
    ),
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_table_on_a_terminal(name: str) -> None:
    rows, text = TEXTS[name]
    assert fitted(rows, list(rows[0]), 80) == text


def test_runs_lose_the_parts_that_they_share() -> None:
    rows = [{"run_id": run, "seq": number} for number, run in enumerate(RUNS)]
    above, _, _, _, first, *_, last = fitted(rows, ["run_id", "seq"], 80).splitlines()
    assert above == "run_id fsar.full.*.n4.s42.*: rows show what stands for each *"
    assert (first.split(), last.split()) == (["door", "r0001-abc", "0"], ["relay", "r0002-abc", "3"])


def test_a_part_of_a_run_that_another_column_gives_is_not_repeated() -> None:
    rows = [{"run_id": run, "scenario": run.split(".")[2]} for run in RUNS]
    above, _, _, _, first, *_ = fitted(rows, ["run_id", "scenario"], 80).splitlines()
    assert above == "run_id fsar.full.<scenario>.n4.s42.*: rows show what stands for each *"
    assert first.split() == ["r0001-abc", "door"]


NUMBERS = {run: number for number, run in enumerate(RUNS, 5)}


def test_on_a_terminal_a_run_is_its_number_and_one_is_said_in_full() -> None:
    rows = [{"run_id": run, "seq": seq} for seq, run in enumerate(RUNS)]
    above, _, _, _, first, *_, last = fitted(rows, ["run_id", "seq"], 80, numbers=NUMBERS.copy).splitlines()
    assert above == f"run_id 5 is {RUNS[0]}; --wide shows the names"
    assert (first.split(), last.split()) == (["5", "0"], ["8", "3"])


def test_a_plan_among_runs_keeps_its_name() -> None:
    rows = [{"run_id": run} for run in ("plan.n4.s42.x2-abc", *RUNS)]
    assert fitted(rows, ["run_id"], 80, numbers=NUMBERS.copy).splitlines()[4:6] == ["plan.n4.s42.x2-abc", "5"]


def test_a_text_that_looks_like_the_number_of_a_run_keeps_all_names() -> None:
    rows = [{"run_id": run} for run in ("6", RUNS[0])]
    assert RUNS[0] in fitted(rows, ["run_id"], 80, numbers=NUMBERS.copy).splitlines()


def test_a_table_of_the_numbers_keeps_the_names() -> None:
    rows = [{"number": number, "run_id": run} for run, number in NUMBERS.items()]
    assert fitted(rows, ["number", "run_id"], 80, numbers=NUMBERS.copy) == fitted(rows, ["number", "run_id"], 80)


@pytest.mark.parametrize(
    "arguments",
    [
        ("query", "failures"),
        pytest.param(("sql", "SELECT run_id, seq FROM failures ORDER BY ALL"), marks=pytest.mark.slow),
    ],
)
def test_the_numbers_that_a_terminal_shows_are_those_that_questions_take(
    call: Call, ledger: Path, arguments: tuple[str, str]
) -> None:
    verb, question = arguments
    shown = on_a_terminal_here(80, verb, *((question, ledger) if verb == "query" else (ledger, question)))
    numbers = Ledger(ledger).numbers()
    rows = Ledger(ledger).query("failures").rows()
    listed = shown.split("---\n", 1)[1].splitlines()[: len(rows)]
    assert [line.lstrip("| ").split()[0] for line in listed] == [str(numbers[row["run_id"]]) for row in rows]
    found = Ledger(ledger).requests(str(numbers[rows[0]["run_id"]])).rows()
    assert found == Ledger(ledger).requests(rows[0]["run_id"]).rows()


def test_runs_that_could_not_be_told_apart_stay_whole() -> None:
    for runs in (["a.b c.d", "a.b.c d"], ["a", "b"], ["a.b", "a.b.c"]):
        text = fitted([{"run_id": run} for run in runs], ["run_id"], 80)
        assert all(f"\n{run}\n" in text for run in runs) or "*" in text
        assert len(set(text.splitlines()[-2:])) == 2


def test_a_long_list_is_shortened() -> None:
    rows = [{"robots": [f"robot/A{number}" for number in range(12)], "n": 1}, {"robots": [], "n": 2}]
    text = fitted(rows, ["robots", "n"], 80)
    assert "robot/A0, robot/A1, robot/A2 and 9 more  1" in text
    assert "\nnone " in text


def test_a_long_cell_goes_on_behind_a_mark_and_between_words() -> None:
    said = "a robot starts although the outcome that it knows is deny, and nobody was asked"
    rows = [{"n": n, "said": f"{said} {n}"} for n in (1, 2)]
    lines = fitted(rows, ["n", "said"], 60).splitlines()
    assert max(map(len, lines)) <= 60
    assert [line[:2] for line in lines] == ["  ", "  ", "  ", "| ", "  ", "| "]
    assert [word for line in lines[2:4] for word in line[2:].split()] == ["1", *said.split(), "1"]


def test_a_cell_that_would_be_tall_is_cut_and_the_cut_is_marked() -> None:
    rows = [{f"column_{place}": "0123456789 " * 12 + str(n) for place in range(5)} for n in (1, 2)]
    table = fitted(rows, list(rows[0]), 80).split("---\n")[1]
    assert [len(row.split("\n| ")) for row in table.split("\n  ")] == [8, 8]
    assert table.count("\n| ...  ") == 2


def test_a_short_name_stays_on_one_line_although_a_column_goes() -> None:
    said = "a sentence that goes on for some length"
    rows = [{"n": n, "capability": f"door.open.secur{n}", "said": said * n, "more": said * (3 - n)} for n in (1, 2)]
    text = fitted(rows, list(rows[0]), 46)
    assert "\n  1  door.open.secur1  a sentence" in text
    assert "\nnot shown: more" in text


def test_columns_without_room_are_named() -> None:
    rows = [{f"column_{place}": 10**11 + place + n for place in range(9)} for n in (1, 2)]
    text = fitted(rows, list(rows[0]), 80)
    assert text.endswith("not shown: column_5, column_6, column_7, column_8; --wide shows all\n")
    assert all(str(rows[0][f"column_{place}"]) in text for place in range(5))


@pytest.mark.parametrize("width", [20, 33, *WIDTHS])
@pytest.mark.parametrize("name", PAINT)
def test_hostile_cells_neither_paint_nor_leave_the_table(name: str, width: int) -> None:
    rows = [{"run_id": f"{number}{PAINT[name]}", "wide": "東" * 30, "n": number} for number in (1, 2)]
    text = fitted(rows, ["run_id", "wide", "n"], width)
    lines = text.split("\n")
    table = lines[next(place for place, line in enumerate(lines) if "---" in line) :]
    assert painted(text) == []
    assert [line for line in table if not line.startswith("not shown") and wide(line) > width] == []
    assert [line for line in lines if line.lstrip().startswith(CLAIM[:12])] == []


def test_rich_reads_no_cell_as_markup() -> None:
    rows = [{"robot": "[red]A1[/red] :smile:", "n": 1}, {"robot": "[link=x]B1", "n": 2}]
    text = fitted(rows, ["robot", "n"], 80)
    assert "[red]A1[/red] :smile:" in text
    assert "[link=x]B1" in text


def test_an_answer_without_rows_is_as_when_piped() -> None:
    assert fitted([], ["a", "b"], 80) == table_text([], ["a", "b"])


def test_queries_are_listed_by_group_and_event_views_only_with_all(call: Call) -> None:
    named, everything = call("query", "--list").out, call("query", "--list", "--all").out
    groups = [line.partition(":")[0] for line in named.splitlines() if line.partition(":")[0] in GROUPS]
    assert groups == list(GROUPS)
    assert "audit/requests" in named
    assert "run=all action=all" in named
    assert "staging/request_issued" not in named
    assert "views of events are not listed; --all lists them" in named
    assert "staging/request_issued" in everything
    assert "are not listed" not in everything
    one_message(call("query", "--all"), 2, "--all without --list")


@pytest.mark.slow
def test_on_a_terminal_names_leave_room_for_the_words_of_a_story(call: Call, ledger: Path) -> None:
    run = next(run for run in Ledger(ledger).numbers() if run.startswith("dhma"))
    for verb in (("log", ledger, "--run", run), ("explain", ledger, "--run", run, "--request", "A1-1/2.1")):
        narrow, broad = (on_a_terminal_here(width, *verb) for width in (80, 200))
        folded = sum(line.startswith("  | ") for line in narrow.splitlines())
        assert folded < len(broad.splitlines()) / 2, verb  # were the words of all aligned, nearly each would be
        assert broad == call(*verb).out, verb


@pytest.mark.slow
def test_on_a_terminal_an_audit_is_a_line_a_verdict_and_names_the_first_events_as_prove_takes_them(
    ledger: Path,
) -> None:
    shown = on_a_terminal_here(80, "audit", ledger)
    verdicts, _, first = shown.partition("the first offending events")
    assert f"{ledger} RUN:SEQ`" in " ".join(first.replace("\n  | ", " ").split())
    rows, numbers = Ledger(ledger).audit().rows, Ledger(ledger).numbers()
    lines = [line.split() for line in verdicts.split("---\n")[1].splitlines() if line]
    assert [(name, word, int(cases)) for name, _, word, cases, _ in lines] == [
        (row.invariant, "holds" if row.holds else "broken", row.cases) for row in rows
    ]
    named = re.findall(r"^  ([IA][1-5]) +(\w+) +(\d+:\d+) ", first, re.MULTILINE)
    assert named == [
        (row.invariant[:2].upper(), row.architecture, f"{numbers[row.first_run]}:{row.first_seq}")
        for row in rows
        if row.first_run is not None
    ]


def test_on_a_terminal_queries_are_listed_by_their_last_parts_with_the_names_of_parameters() -> None:
    shown = on_a_terminal_here(80, "query", "--list")
    assert re.search(r"^  robot_activity +What a robot was doing at a time \(run, robot, at\)$", shown, re.MULTILINE)
    assert "audit/" not in shown
    assert "run=all" not in shown


def test_every_group_of_queries_has_words() -> None:
    from fsar_ledger.metrics.own_sql import group_of, listed

    assert {group_of(query) for query in listed(events=True)} == GROUPS.keys()


def test_a_query_shows_its_sql_as_its_file_holds_it(call: Call) -> None:
    files = Path(__file__).parents[2] / "queries"
    for name in ("audit/requests", "facts/failures"):
        assert call("query", name, "--show").out == (files / f"{name}.sql").read_text("utf-8")
    assert call("query", "failures", "--show").out == call("query", "facts/failures", "--show").out
    generated = call("query", "request_issued", "--show").out
    assert generated.startswith("-- Title: ")
    assert "\nSELECT " in generated
    one_message(call("query", "failurs", "--show"), 2, "did you mean facts/failures")
    one_message(call("query", "--show"), 2, "expected NAME")
    one_message(call("query", "failures", "--show", "--json"), 2, "SQL is text")


WORK = """
import sys, time
from fsar_ledger.cli.render import Progress
with Progress("verified", "segments") as progress:
    for done in range(1, 6):
        time.sleep(0.11)
        progress(done, 10)
print("rich" in sys.modules)
"""


def test_long_work_says_what_is_done_of_what_how_fast_and_how_long_the_rest_takes() -> None:
    after, stream = on_a_terminal(100, "-c", WORK, surroundings={"NO_COLOR": "1", "TERM": "xterm"})
    assert after == "True\n"  # the line is erased
    assert "verified 5 of 10 segments" in stream
    assert " per second" in stream
    assert " left" in stream


@pytest.mark.parametrize(
    ("verb", "told"),
    [
        pytest.param("audit LEDGER", "judged 10 of 10 invariants", marks=pytest.mark.slow),
        pytest.param(
            "study run multiverse LEDGER --metric human_intervention",
            "read 4 of 4 combinations of readings",
            marks=pytest.mark.slow,
        ),
        ("export LEDGER --out OUT.csv", "exported 2 of 2 commits"),
        pytest.param("open LEDGER --out OUT.duckdb", " views and queries", marks=pytest.mark.soak),
    ],
)
def test_verbs_that_take_long_tell_how_far_they_are_and_erase_it(
    call: Call, ledger: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, verb: str, told: str
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("NO_COLOR", "1")
    arguments = verb.replace("LEDGER", str(ledger)).replace("OUT", str(tmp_path / "out")).split()
    stream = stream_of(120, *arguments)
    after = left_of(stream)
    assert told in stream
    assert told not in after
    assert after.strip()
    assert "\x1b" not in after
    assert call(*arguments).err == ""


@pytest.mark.slow
def test_a_report_tells_each_step_of_its_work(call: Call, tmp_path: Path) -> None:
    assert call("simulate", tmp_path / "ledger", "--runs", "1").code == 0
    arguments = ("-m", "fsar_ledger", "report", tmp_path / "ledger", "--out", tmp_path / "report.pdf")
    after, stream = on_a_terminal(120, *arguments, surroundings={"NO_COLOR": "1", "TERM": "xterm"})
    assert re.search(r"verified (\d+) of \1 segments", stream)
    assert re.search(r"read (\d+) of \1 combinations of readings", stream)
    assert after == f"{tmp_path / 'report.pdf'}\n"


@pytest.mark.slow
def test_progress_is_for_terminals_that_can_erase_it() -> None:
    assert on_a_terminal(100, "-c", WORK, surroundings={"TERM": "dumb"}) == ("False\n", "False\n")
    piped = ran([sys.executable, "-c", WORK], check=True)
    assert (piped.stdout, piped.stderr) == ("False\n", "")
