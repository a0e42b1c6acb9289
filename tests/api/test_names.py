"""One way to name things: runs by name, number or part, robots by their short names, times with their unit."""

import re
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import fsar_ledger
from fsar_ledger.api.lookup import resolve_run
from fsar_ledger.api.names import MAX_SECONDS, known_name, microseconds, principal_named, run_named
from fsar_ledger.base.errors import InvalidQuery, UnknownQuery, UsageError
from fsar_ledger.base.printable import ranges
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.store.derived import RunNames
from fsar_ledger.metrics.library import library, parse
from fsar_ledger.metrics.sql_values import KINDS, Parameter, names_on_record
from fsar_ledger.runtime.federation import ORIGIN as LIVE
from tests.api.conftest import RUN
from tests.queries.histories import act, run
from tests.queries.test_every_query import HEADER
from tests.quick import few
from tests.recycled import from_rows
from tests.runtime.test_cut_digests import day_with_a_cut

NAMES = ("fsar.door.r0000-12ab", "cfc.door.r0000-34cd", "fsar.door.r0001-7", "7")
TYPING_ERRORS = {
    "run": ("fsar.full.dor-relay", "no such run; did you mean fsar.full.door-relay"),
    "robot": ("B9", "no such robot; did you mean robot/"),
    "supervisor": ("B9", "no such supervisor; did you mean supervisor/"),
    "action": ("A1-1/2.11", "no such action; did you mean A1-1/2.1"),
    "capability": ("door.opne", "no such capability; did you mean door.open"),
    "context": ("A1-11", "no such context; did you mean A1-1"),
    "reason": ("polcy", "no such reason; did you mean policy"),
    "record": ("handof", "no such kind of record; did you mean handoff"),
    "architecture": ("fsra", "no such architecture; did you mean fsar"),
    "claim": ("atempted", "no such claim; did you mean attempted"),
    "case": ("5", "no such case number; expected one of 1, 2, 3, 4"),
    "period": ("week", "no such period; expected one of day, part"),
    "seq": ("100000", "no such event of any run, expected a number from 0 to"),
    "time": ("46.6 minutes", "expected seconds of run time, 0 or more, as 46.6, 46.6s or 46600ms"),
}
PARAMETERS = [(query.name, one) for query in library().queries.values() for one in query.parameters.values()]


def test_a_run_is_named_in_full_by_its_number_or_by_a_part_that_no_other_has() -> None:
    assert run_named("cfc.door.r0000-34cd", NAMES) == "cfc.door.r0000-34cd"
    assert run_named("2", NAMES) == "cfc.door.r0000-34cd"
    assert run_named("r0001", NAMES) == "fsar.door.r0001-7"
    assert run_named("plan.n4", NAMES, ["plan.n4.s42"]) == "plan.n4.s42"


def test_digits_are_the_number_of_a_run_even_where_names_hold_them() -> None:
    assert run_named("1", NAMES[:3]) == NAMES[0]
    for asked in ("0", "4", "12", "9" * 40):
        with pytest.raises(UsageError, match="no run of this number, expected a number from 1 to 3"):
            run_named(asked, NAMES[:3])
    with pytest.raises(UsageError, match=r"there is no run$|there is no run;"):
        run_named("1", [])


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        *(
            (asked, "there is no run of this number, expected a number from 1 to 4")
            for asked in ("-1", "-12", "-34", "-0")
        ),
        *((asked, "there is no such run") for asked in ("-12ab", "-34c", "-")),
        *((asked, r"there is no such run; did you mean door\? ") for asked in ("dorr", "dooor")),
        ("r0000", r"found 2 runs .* cfc\.door\.r0000-34cd \(number 2\), fsar\..* \(number 1\)"),
    ],
)
def test_what_begins_with_a_hyphen_or_is_no_part_of_one_name_is_an_error(asked: str, message: str) -> None:
    with pytest.raises(UsageError, match=f"run {asked}: {message}"):
        run_named(asked, NAMES)


@pytest.mark.parametrize("asked", ["c1", "C1", "robot/c1", "Robot/C1"])
def test_capitals_do_not_matter_in_the_name_of_a_robot(asked: str) -> None:
    assert principal_named("robot", asked, ["robot/A1", "robot/C1"]) == "robot/C1"


def test_capitals_matter_where_they_tell_robots_apart() -> None:
    assert principal_named("robot", "c1", ["robot/C1", "robot/c1"]) == "robot/c1"
    with pytest.raises(UsageError, match="robot aB: there is no such robot; did you mean robot/AB"):
        principal_named("robot", "aB", ["robot/AB", "robot/ab"])


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        *((asked, "there is no such robot;") for asked in ("Z9", "E5", "robot/Z9", "flying")),
        ("coordinator", "found the coordinator,"),
        ("supervisor/C1", "found a supervisor,"),
        ("service/policy", "found a service,"),
        ("agent/C1/policy", "found an agent of a robot,"),
    ],
)
def test_what_is_like_no_name_of_a_robot_gets_no_suggestion(asked: str, message: str) -> None:
    with pytest.raises(UsageError, match=f"robot {asked}: {message} expected one of robot/A1, robot/D1$"):
        principal_named("robot", asked, ["robot/A1", "robot/D1"])


@pytest.mark.parametrize("asked", ["flying", "nosuch"])
def test_what_is_like_no_name_gets_no_suggestion(asked: str) -> None:
    with pytest.raises(UsageError, match="there is no such name; expected one of "):
        known_name("name", asked, ["navigate.indoor", "lift", "injected-1-1", "A1-1/2.1"])


def test_an_unknown_run_names_the_command_that_lists_the_runs(ledger: fsar_ledger.Ledger) -> None:
    way = re.escape(f"`fsar-ledger query runs {ledger.path}` lists them")
    for ask in (
        ledger.events,
        ledger.state,
        ledger.log,
        ledger.requests,
        lambda run: ledger.prove(f"{run}:1"),
        lambda run: ledger.query("audit/requests", run=run),
    ):
        for asked in ("dorr-relay", "99999"):
            with pytest.raises(UsageError, match=way):
                ask(asked)


def test_a_plan_has_a_name_and_no_number() -> None:
    with pytest.raises(UsageError, match="from 1 to 3"):
        run_named("4", NAMES[:3], ["plan.n4.s42"])


@pytest.mark.slow
def test_numbers_of_runs_are_their_places_in_the_ledger(ledger: fsar_ledger.Ledger) -> None:
    rows = ledger.runs().rows()
    known = {row["run_id"] for row in rows}
    placed = [run for run in open_for_answers(ledger.path).run_names.runs if run in known]
    numbered = sorted(rows, key=lambda row: row["number"])
    assert ledger.runs().columns[0] == "number"
    assert [row["run_id"] for row in numbered] == placed
    assert [row["number"] for row in numbered] == list(range(1, len(placed) + 1))
    asked = ledger.sql("SELECT number, run_id FROM runs ORDER BY number").rows()
    assert asked == [{"number": row["number"], "run_id": row["run_id"]} for row in numbered]


def test_each_number_that_is_told_names_its_run(ledger: fsar_ledger.Ledger) -> None:
    numbers = ledger.numbers()
    assert set(numbers) == {row["run_id"] for row in ledger.runs()}
    view = open_for_answers(ledger.path)
    assert all(resolve_run(view, str(number), None) == name for name, number in numbers.items())


def test_the_events_of_a_number_are_those_of_its_run_where_another_was_cut(tmp_path: Path) -> None:
    ledger = fsar_ledger.Ledger(day_with_a_cut(tmp_path / "ledger").ledger)
    fsar_ledger.simulate(ledger.path, architecture="fsar", scenario="door-relay", runs=1, origin=LIVE)
    day, simulated = "hall", ledger.runs().rows()[-1]["run_id"]
    names = ledger.numbers()
    assert names == {day: 1, f"{day}.2": 2, simulated: 3}
    assert [{one.run for one in ledger.events(number)} for number in names.values()] == [
        {f"{day}.2"},
        {f"{day}.2"},
        {simulated},
    ]


def test_a_number_that_is_itself_the_name_of_another_run_is_not_told() -> None:
    names = RunNames(("2", "x"))
    assert names.numbers() == {"2": 1}
    assert run_named("2", names.runs) == "2"


@pytest.mark.slow
def test_every_method_takes_the_number_of_a_run(ledger: fsar_ledger.Ledger) -> None:
    number, run = next((row["number"], row["run_id"]) for row in ledger.runs() if RUN in row["run_id"])
    action = ledger.requests(run).rows()[0]["action_id"]
    for asked in (number, str(number)):
        assert {one.run for one in ledger.events(asked)} == {run}
        assert ledger.state(asked) == ledger.state(run)
        assert ledger.log(asked).rows() == ledger.log(run).rows()
        assert ledger.query("audit/requests", run=asked).rows() == ledger.query("audit/requests", run=run).rows()
        assert ledger.requests(asked).rows() == ledger.requests(run).rows()
        assert ledger.explain(asked, action).timeline == ledger.explain(run, action).timeline
    assert str(ledger.prove(f"{number}:12")) == str(ledger.prove(f"{run}:12"))
    assert ledger.prove(str(number)).index == number, "a bare number is the place of an event"


@pytest.mark.parametrize("asked", [1.0, True, [1], 0, -1, 10**20])
def test_what_is_neither_text_nor_the_number_of_a_run_is_an_error(ledger: fsar_ledger.Ledger, asked: Any) -> None:
    for ask in (
        ledger.events,
        ledger.state,
        ledger.log,
        ledger.requests,
        lambda run: ledger.explain(run, "A1-1/2.1"),
        lambda run: ledger.query("audit/requests", run=run),
    ):
        with pytest.raises(
            UsageError, match=r"^run: found .*, expected the name of a run|no run of this number"
        ) as caught:
            ask(asked)
        assert caught.value.exit_code == 2


@given(st.integers(0, MAX_SECONDS * 1_000_000))
def test_a_time_as_text_is_the_time_to_the_microsecond(time_us: int) -> None:
    seconds, millis = Decimal(time_us) / 1_000_000, Decimal(time_us) / 1_000
    for text in (f"{seconds:f}", f"{seconds:f}s", f"{seconds:f} s", f"{millis:f}ms", f" {millis:f} ms"):
        assert microseconds("at", text) == time_us


@given(st.floats(0, 1_000_000))
def test_a_time_as_a_number_is_the_nearest_microsecond(seconds: float) -> None:
    found = microseconds("at", seconds)
    assert found is not None
    assert abs(found - seconds * 1_000_000) <= 0.501
    assert microseconds("at", f"{seconds:.6f}") in (found - 1, found, found + 1)


@pytest.mark.parametrize(
    "asked", ["", "s", "-1", "1e3", "46,6", "46.6us", "1 min", "nan", "inf", "٣", "9" * 17, True, -0.1, float("inf")]
)
def test_what_is_no_time_is_an_error(asked: float | str) -> None:
    with pytest.raises(UsageError, match=r"at: found .*, expected seconds of run time, 0 or more, as 46\.6, 46\.6s or"):
        microseconds("at", asked)


def test_no_time_stays_none() -> None:
    assert microseconds("at", None) is None


@pytest.mark.parametrize(
    ("name", "one"),
    [
        pytest.param(name, one, id=f"{name}:{one.name}", marks=[pytest.mark.slow] if at % 4 else [])
        for at, (name, one) in enumerate(PARAMETERS)
    ],
)
def test_a_typing_error_in_a_parameter_is_an_error_with_the_nearest(
    ledger: fsar_ledger.Ledger, name: str, one: Parameter
) -> None:
    wrong, message = TYPING_ERRORS[one.kind]
    with pytest.raises(UsageError, match=message) as caught:
        ledger.query(name, **{one.name: wrong})
    assert caught.value.exit_code == 2


def test_every_kind_of_parameter_is_used_and_has_its_typing_error() -> None:
    assert set(KINDS) == {one.kind for _, one in PARAMETERS} == set(TYPING_ERRORS)


def test_a_robot_that_only_moves_helps_or_is_found_in_a_record_is_a_name_on_record() -> None:
    moves = act("ExecutionStarted", 1, "t/1", robot="robot/A", on_behalf_of="robot/B", capability="lift")
    helps = act("AssistanceAdmitted", 2, "t/1", helper="robot/C")
    found = act("RegistryQueried", 3, "t/1", candidates=["robot/D"], rejected=["robot/E"], rejected_by=["trust"])
    with from_rows(run(moves, helps, found, kind="foreign")) as database:
        assert names_on_record(database, "robot", "r1") == [f"robot/{name}" for name in "ABCDE"]
        assert names_on_record(database, "robot", "another") == []


def test_an_action_that_a_record_names_only_as_competing_is_a_name_on_record() -> None:
    called = act("SupervisorCalled", 1, "t/1", purpose="order", competing="t/2")
    with from_rows(run(called, kind="foreign")) as database:
        assert names_on_record(database, "action", "r1") == ["t/1", "t/2"]


def test_what_is_no_period_is_so_whatever_the_rows_of_a_ledger_are(ledger: fsar_ledger.Ledger) -> None:
    with pytest.raises(UsageError, match=r"no such period; expected one of day, part$"):
        ledger.query("metrics_by_period", per="week")


def test_a_record_that_names_no_robot_says_so() -> None:
    with pytest.raises(UsageError, match=r"^robot B1: there is no such robot; expected none: no robot is on record$"):
        principal_named("robot", "B1", [])


@pytest.mark.parametrize(
    "name", few(sorted({name for name, one in PARAMETERS if one.kind == "time"}), ["audit/robot_state_at"])
)
def test_a_time_after_the_run_is_an_error_that_says_when_it_ends(ledger: fsar_ledger.Ledger, name: str) -> None:
    last = max(one.time_us for one in ledger.events(RUN)) / 1_000_000
    assert ledger.query(name, run=RUN, at=last).rows() == ledger.query(name, run=RUN, at="end").rows()
    with pytest.raises(UsageError, match=rf"expected at most {last:.6f} s, the last event of run fsar"):
        ledger.query(name, run=RUN, at=last + 0.000001)
    with pytest.raises(UsageError, match="the last event of the longest run"):
        ledger.query(name, at=100_000)


def test_a_time_after_the_run_is_an_error_for_events_and_states(ledger: fsar_ledger.Ledger) -> None:
    for ask in (lambda: ledger.events(RUN, since="100000s"), lambda: ledger.state(RUN, "100000000ms")):
        with pytest.raises(UsageError, match="the last event of run fsar"):
            ask()
    assert list(ledger.events(RUN, since="10s", until="20000ms")) == list(ledger.events(RUN, since=10, until=20))


def test_an_action_of_another_run_is_not_one_of_this(ledger: fsar_ledger.Ledger) -> None:
    action = next(str(row["action_id"]) for row in ledger.requests(RUN))
    assert ledger.query("audit/requests", run=RUN, action=action).rows()
    with pytest.raises(UsageError, match="no such action; did you mean"):
        ledger.query("audit/requests", run=RUN, action=f"{action}9")


def test_a_name_that_is_known_and_has_no_row_answers_an_empty_table(ledger: fsar_ledger.Ledger) -> None:
    assert ledger.query("audit/refusals", run=RUN, reason="override").rows() == []
    assert ledger.query("cases/case_events", architecture="dhma", claim="attempted").rows() == []


def test_a_parameter_of_none_has_its_default(ledger: fsar_ledger.Ledger) -> None:
    assert ledger.query("audit/refusals", run=None).rows() == ledger.query("audit/refusals").rows()


def test_the_old_name_of_a_time_is_an_error_that_says_the_new_one(ledger: fsar_ledger.Ledger) -> None:
    with pytest.raises(UnknownQuery, match=r"found parameter at_us; .*; at is the time, as in at=46\.6, at=46\.6s or"):
        ledger.query("audit/policy_at", at_us=46.6)
    with pytest.raises(UnknownQuery, match=r"found parameter robt; .*; did you mean robot"):
        ledger.query("audit/policy_at", robt="B1")


def test_a_parameter_without_default_must_be_given(ledger: fsar_ledger.Ledger) -> None:
    with pytest.raises(UnknownQuery, match=r"^query audit/decision_owner: found no value of seq, .* as in seq=VALUE$"):
        ledger.query("decision_owner", run="1")
    with pytest.raises(UnknownQuery, match="found no value of seq"):
        ledger.query("decision_owner", run="1", seq=None)


def test_parameters_in_a_header_have_a_kind_and_a_default() -> None:
    query = parse("audit/x", HEADER + "-- Parameters: run: run = all, at: time = end, seq: seq\nSELECT 1")
    assert query.parameters == {
        "run": Parameter("run", "run", "all"),
        "at": Parameter("at", "time", "end"),
        "seq": Parameter("seq", "seq"),
    }
    assert " ".join(map(str, query.parameters.values())) == "run=all at=end seq="
    assert (query.parameters["at"].sql_name, query.parameters["at"].sql_default) == ("at_us", str(2**53 - 1))


@pytest.mark.parametrize(
    ("text", "hint"), [("robot: robt = all", "did you mean robot"), ("robot = all", "a kind is one of run, robot")]
)
def test_a_parameter_of_an_unknown_kind_is_refused_with_the_nearest(text: str, hint: str) -> None:
    with pytest.raises(InvalidQuery, match=hint):
        parse("audit/x", f"{HEADER}-- Parameters: {text}\nSELECT 1")


@pytest.mark.parametrize(
    ("numbers", "shown"),
    [
        ([], ""),
        ([3], "3"),
        ([1, 2], "1-2"),
        ([201, 202, 203], "201-203"),
        ([2, 5, 8], "2-8 by 3"),
        ([1, 4], "1, 4"),
        ([1, 5, 6, 7], "1, 5-7"),
        ([1, 3, 5, 6, 7], "1-5 by 2, 6-7"),
    ],
)
def test_numbers_of_runs_are_shown_as_ranges(numbers: list[int], shown: str) -> None:
    assert ranges(numbers) == shown
