"""What a writer refuses, before anything is in the ledger: what `verify` would condemn, and what breaks a run. Each is named with run, seq and field."""

import pickle
import re
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import pytest

from fsar_ledger.errors import InvalidRun, LedgerCorrupted, SequenceConflict, UsageError, WriteFailed
from fsar_ledger.events.concerns import CONCERNS
from fsar_ledger.events.envelope import Robot, with_columns
from fsar_ledger.events.experiment import ExperimentPlanned
from fsar_ledger.events.fleet import RobotJoined, RunStarted
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.ledger.rows.check import first_flaw
from fsar_ledger.ledger.rows.codec import RunRecord, encode
from fsar_ledger.ledger.rows.schema import CONCERNED, LAYOUTS, OPENINGS, STANDS_ALONE, STORED, StoredType
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.append import Writer, stage
from fsar_ledger.ledger.store.paths import segment_path, staged_path
from fsar_ledger.ledger.store.read import open_ledger
from fsar_ledger.ledger.verify.verify import verify
from tests.ledger.agreement import Case, judged
from tests.ledger.forgery import changed
from tests.ledger.hostile import append_again, stage_anything
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_batches, made_up_run, run_of_every_type
from tests.ledger.test_writer_property import Number, Pair, Posing, Stranger, Word, with_event

RUN = run_of_every_type("run-1", seed=3)
BATCHES = made_up_batches(4)


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("intact") / "ledger"
    append_all(path, BATCHES[:2])
    return path


@pytest.fixture
def path(intact: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(intact, tmp_path / "ledger"))


def seq_with(condition: Callable[[str, StoredType], bool]) -> tuple[int, str]:
    """The first event of RUN that has such a field, and the field's name."""
    layouts = [(seq, LAYOUTS[str(event.__struct_config__.tag)]) for seq, event in enumerate(RUN.events)]
    return next(
        (seq, name)
        for seq, layout in layouts
        if seq > 0
        for name in (field.name for field in layout.fields)
        if condition(name, layout)
    )


def of_kind(kind: str, *, closed: bool = False, is_nullable: bool = False) -> tuple[int, str]:
    def fits(name: str, layout: StoredType) -> bool:
        (field,) = (field for field in layout.fields if field.name == name)
        return (field.kind, field.values is not None, field.is_nullable) == (kind, closed, is_nullable)

    return seq_with(fits)


def refused(path: Path, runs: list[RunRecord], said: str) -> None:
    """Staging them is refused with these words, and nothing is left of it."""
    before = contents(path)
    with pytest.raises(InvalidRun, match=said):
        stage(path, runs)
    assert contents(path) == before


WRONG: dict[str, tuple[tuple[int, str], tuple[object, ...]]] = {
    "text": (of_kind("string"), (None, 1, True, b"robot/A1", ("robot/A1",), Word.FSAR, Posing("robot/A1"), "\ud800")),
    "of a closed list": (
        of_kind("string", closed=True),
        (None, 1, "perhaps", "", "Local", Word.FSAR, Posing("perhaps")),
    ),
    "an integer": (of_kind("integer"), (None, True, 1.0, "1", Number.ONE, 2**53, -(2**53), 2**63, 2**200)),
    "yes or no": (of_kind("boolean"), (None, 0, 1, "true")),
    "names": (
        of_kind("strings"),
        (None, "ab", ["a"], Pair(("a",)), {"a": 1}, (1,), (None,), (b"a",), (Posing("a"),), ("\ud800",)),
    ),
}
EACH = [(kind, value) for kind, (_, values) in WRONG.items() for value in values]


@pytest.mark.parametrize(("kind", "value"), EACH, ids=[f"{kind}: {value!a:.20}" for kind, value in EACH])
def test_a_value_that_its_field_cannot_hold_is_refused(path: Path, kind: str, value: object) -> None:
    (seq, field), _ = WRONG[kind]
    run = with_event(RUN, seq, with_columns(RUN.events[seq], **{field: value}))
    refused(
        path,
        [BATCHES[2][0], run],
        f"run run-1, seq {seq}, field {field}: found {re.escape(f'{value!r:.80}')}, expected .*; nothing was written",
    )


def test_closed_lists_are_the_same_for_writer_and_verifier() -> None:
    closed = [(layout, field) for layout in LAYOUTS.values() for field in layout.fields if field.values is not None]
    assert len(closed) > 20
    for layout, field in closed:
        event = next(event for event in RUN.events if type(event) is layout.cls)
        values = sorted(field.values or ())
        events = [with_columns(event, **{field.name: value}) for value in values]
        good = RunRecord("r", range(len(events)), [None, *range(len(events) - 1)], events)
        table = encode([good])
        assert first_flaw(table) is None
        with pytest.raises(
            InvalidRun,
            match=re.escape(expected := f"seq 0, field {field.name}: found 'perhaps', expected one of {values}"),
        ):
            encode([with_event(good, 0, with_columns(event, **{field.name: "perhaps"}))])
        assert expected in str(first_flaw(changed(table, field.name, 0, "perhaps")))


@pytest.mark.parametrize("event", [Stranger("robot/A1"), "RunStarted.v1", None, {}, Stranger])
def test_what_is_no_event_of_today_is_refused(path: Path, event: object) -> None:
    refused(
        path,
        [with_event(RUN, 4, event)],
        "run run-1, seq 4, field type: found .*, expected an event of a type that is written today",
    )


@pytest.mark.parametrize(
    ("time", "said"),
    [(True, "True"), (1.0, r"1\.0"), (None, "None"), (2**53, "9007199254740992, expected at most"), (2**64, "1844")],
)
def test_a_time_that_is_none_is_refused(path: Path, time: Any, said: str) -> None:
    times = [*RUN.times_us[:-1], time]
    refused(
        path,
        [msgspec.structs.replace(RUN, times_us=times)],
        f"run run-1, seq {len(times) - 1}, field time_us: found {said}",
    )


def test_time_that_runs_backwards_is_refused(path: Path) -> None:
    times = [*RUN.times_us[:5], RUN.times_us[4] - 1, *RUN.times_us[6:]]
    refused(
        path,
        [BATCHES[2][0], msgspec.structs.replace(RUN, times_us=times)],
        f"run run-1, seq 5, field time_us: found {times[5]}, expected no less",
    )
    same = [*RUN.times_us[:5], RUN.times_us[4], *RUN.times_us[6:]]
    assert stage(path, [BATCHES[2][0], msgspec.structs.replace(RUN, times_us=same)]).rows == len(
        BATCHES[2][0].events
    ) + len(RUN.events)


@pytest.mark.parametrize(
    ("seq", "cause"), [(0, 0), (0, -1), (3, 3), (3, 4), (3, -1), (3, None), (3, True), (3, 1.0), (3, "1"), (3, 2**64)]
)
def test_a_cause_that_is_no_earlier_event_is_refused(path: Path, seq: int, cause: Any) -> None:
    causes = [*RUN.caused_by[:seq], cause, *RUN.caused_by[seq + 1 :]]
    refused(
        path,
        [msgspec.structs.replace(RUN, caused_by=causes)],
        f"run run-1, seq {seq}, field caused_by: found {cause!r}, expected",
    )


def test_a_run_begins_with_its_start_and_has_no_other(path: Path) -> None:
    assert {tag for tag in STORED if tag.startswith("RunStarted.v")} | STANDS_ALONE == OPENINGS
    headless = RunRecord("run-1", RUN.times_us[1:], [None, *[0] * (len(RUN.events) - 2)], RUN.events[1:])
    refused(
        path,
        [BATCHES[2][0], headless],
        r"run run-1, seq 0, field type: found '\w+\.v\d+', expected one of \['ExperimentPlanned.*RunStarted",
    )
    refused(
        path,
        [with_event(RUN, 5, RUN.events[0])],
        "run run-1, seq 5, field type: found 'RunStarted.*, expected no second beginning of a run",
    )


def test_what_stands_alone_is_in_no_run(path: Path) -> None:
    plan = ExperimentPlanned(
        architectures=("fsar",),
        configurations=("full",),
        scenarios=("door-relay",),
        run_count=20,
        seed=42,
        fleet_size=4,
        model_version="2",
        parameters="{}",
    )
    assert stage(path, [RunRecord("plan", [0], [None], [plan])]).rows == 1
    refused(
        path,
        [with_event(RUN, 0, plan)],
        r"run run-1, seq 0, field type: found 'ExperimentPlanned.v1', expected the only event of its run",
    )
    refused(
        path,
        [with_event(RUN, 7, plan)],
        "run run-1, seq 7, field type: found 'ExperimentPlanned.v1', expected no second beginning",
    )


@pytest.mark.parametrize("name", [None, 1, b"run", Word.LIVE, Posing("run"), ("run",), ["run"]])
def test_a_run_whose_name_is_no_string_is_refused(path: Path, name: Any) -> None:
    refused(path, [msgspec.structs.replace(RUN, run_id=name)], "field run_id: found .*, expected a string")


def test_a_name_that_no_file_can_hold_as_text_is_refused(path: Path) -> None:
    with pytest.raises(InvalidRun, match=r"field run_id: found '\\ud800', expected text without surrogates"):
        stage(path, [msgspec.structs.replace(RUN, run_id="\ud800")])


def test_a_name_that_no_record_could_carry_is_refused(path: Path) -> None:
    refused(
        path,
        [msgspec.structs.replace(RUN, run_id="é" * 2049)],
        "field run_id: found a name of 4098 bytes, expected at most 4096",
    )
    append_all(path, [[msgspec.structs.replace(RUN, run_id='"' * 4096)]])
    assert verify(path).ok
    with pytest.raises(ValueError, match="found an origin of 5000 characters, expected at most 4096 bytes"):
        Writer(path.parent / "other", "x" * 5000)
    assert not (path.parent / "other").exists()


@pytest.mark.parametrize("name", ["times_us", "caused_by", "events"])
def test_a_run_that_lacks_something_or_all_is_refused(path: Path, name: str) -> None:
    refused(
        path,
        [msgspec.structs.replace(RUN, **{name: getattr(RUN, name)[:-1]})],
        "run run-1: found .* expected as many of each",
    )
    refused(
        path,
        [RunRecord("run-1", [], [], [])],
        "run run-1: found 0 events, 0 times and 0 causes, expected .*, at least 1",
    )


def test_a_refusal_is_a_mistake_of_the_caller(path: Path) -> None:
    assert issubclass(InvalidRun, UsageError)
    assert issubclass(InvalidRun, ValueError)
    assert InvalidRun.exit_code == 2


# --- a run is in one commit ---


def test_a_run_twice_in_a_batch_is_refused(path: Path) -> None:
    other = msgspec.structs.replace(BATCHES[2][0], run_id="run-1")
    for runs in ([RUN, RUN], [RUN, other], [RUN, BATCHES[2][0], other]):
        refused(path, runs, "run run-1, seq 0, field run_id: found the run twice in one batch, expected each run once")


@pytest.mark.parametrize("again", [(0, 0), (0, 1), (1, 0)])
def test_a_run_of_an_earlier_commit_is_refused_and_the_writer_goes_on(path: Path, again: tuple[int, int]) -> None:
    number, at = again
    run = BATCHES[number][at]
    before = contents(path)
    with Writer(path, ORIGIN) as writer:
        for runs in ([run], [BATCHES[2][0], run], [made_up_run(run.run_id, 5, seed=77)]):
            with pytest.raises(
                InvalidRun,
                match=rf"run {run.run_id}, seq 0, field run_id: found a run that commit {number} holds, expected each run in one commit",
            ):
                writer.append(stage(path, runs))
            assert contents(path) == before
        assert writer.append(stage(path, BATCHES[2])).commits == 3
        with pytest.raises(InvalidRun, match=f"run {BATCHES[2][1].run_id}, .* commit 2 holds"):
            writer.append(stage(path, [RUN, BATCHES[2][1]]))
        with pytest.raises(InvalidRun, match=f"run {BATCHES[0][0].run_id}, .* commit 0 holds"):
            writer.append(stage(path, BATCHES[0]))  # an older batch whole; only the newest changes nothing
    assert verify(path).ok
    assert verify(path).runs == 6


def test_of_two_writers_with_the_same_run_in_other_batches_one_commits_it(path: Path) -> None:
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as two:
        staged = stage(path, [RUN, *BATCHES[2]])
        one.append(stage(path, [*BATCHES[3], RUN]))
        with pytest.raises(SequenceConflict):
            two.append(staged)
    with (
        Writer(path, ORIGIN) as again,
        pytest.raises(InvalidRun, match=r"run run-1, .* found a run that commit 2 holds"),
    ):
        again.append(stage(path, [RUN, *BATCHES[2]]))
    assert verify(path).ok


def test_a_commit_that_another_writer_made_alike_is_known_to_hold_its_runs(path: Path) -> None:
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as two:
        staged = stage(path, BATCHES[2])
        assert one.append(staged) == two.append(staged)  # which finds it committed, and staged no more
        with pytest.raises(InvalidRun, match="commit 2 holds"):
            two.append(stage(path, [RUN, BATCHES[2][0]]))
        with pytest.raises(InvalidRun, match="commit 2 holds"):
            one.append(stage(path, [RUN, BATCHES[2][0]]))
    assert verify(path).ok


def test_of_writers_at_once_with_the_same_runs_each_run_is_committed_once(path: Path) -> None:
    runs = [made_up_run(f"crowd-{number}", 5, seed=number) for number in range(4)]
    offered = [[one, other] for one, other in product(runs, runs) if one is not other]

    def offer(batch: list[RunRecord]) -> str:
        for _ in range(50):
            try:
                with Writer(path, ORIGIN) as writer:
                    writer.append(stage(path, batch))
                return "committed"
            except SequenceConflict:
                continue
            except (InvalidRun, WriteFailed) as error:
                return type(error).__name__
        return "tired"

    with ThreadPoolExecutor(4) as pool:
        fates = list(pool.map(offer, offered))
    assert verify(path).ok, fates
    assert 1 <= fates.count("committed") <= 2, fates
    found = [run.run_id for run in open_ledger(path).runs()]
    assert len(set(found)) == len(found) == 4 + 2 * fates.count("committed")


def test_runs_are_known_where_they_stand_in_no_dictionary_or_in_one_that_holds_more(path: Path) -> None:
    many = [
        msgspec.structs.replace(made_up_run("", 1, seed=1), run_id=f"{number:04d}" + "x" * 2000)
        for number in range(700)
    ]  # 1.4 MB of names
    append_all(path, [many])
    with Writer(path, ORIGIN) as writer:
        for run in (many[0], many[699]):
            with pytest.raises(InvalidRun, match="found a run that commit 2 holds"):
                writer.append(stage(path, [RUN, run]))
    assert verify(path).ok


def test_a_ledger_that_holds_a_run_twice_already_is_written_on(path: Path) -> None:
    append_again(path, [BATCHES[0][0]])
    append_all(path, [BATCHES[2]])
    with Writer(path, ORIGIN) as writer, pytest.raises(InvalidRun, match="commit 0 holds"):
        writer.append(stage(path, [BATCHES[0][0], RUN]))


def test_a_segment_whose_runs_cannot_be_read_is_named(path: Path) -> None:
    data = bytearray(segment_path(path, 0).read_bytes())
    data[40] ^= 1
    segment_path(path, 0).write_bytes(data)
    before = contents(path)
    with (
        Writer(path, ORIGIN) as writer,
        pytest.raises(LedgerCorrupted, match=r"000000000000\.parquet: .*restore the file"),
    ):
        writer.append(stage(path, [RUN]))
    assert {name: data for name, data in contents(path).items() if not name.startswith("staging")} == before


# --- what lies between staging and the commit ---


def test_a_staged_file_of_the_same_size_but_other_bytes_is_not_committed(path: Path) -> None:
    before = contents(path)
    with Writer(path, ORIGIN) as writer:
        staged = pickle.loads(pickle.dumps(stage(path, [RUN])))
        file = staged_path(path, staged.segment_sha256)
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        file.write_bytes(data)
        with pytest.raises(WriteFailed, match="found another file than was staged"):
            writer.append(staged)
        file.unlink()
        assert contents(path) == before
        assert writer.append(stage(path, [RUN])).commits == 3
    assert verify(path).ok


def test_what_0_1_0_stored_is_read_and_verified(path: Path) -> None:
    headless = RunRecord("run-1", [5, 4], [None, 0], RUN.events[1:3])
    with Writer(path, ORIGIN) as writer:
        writer.append(stage_anything(path, [headless]))
    assert verify(path).ok
    assert list(open_ledger(path).runs())[-1] == headless


def test_a_ledger_takes_no_more_commits_than_a_folder_holds_names(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "MAX_NAMES", 2)
    before = contents(path)
    with Writer(path, ORIGIN) as writer, pytest.raises(WriteFailed, match="found 2 commits, expected at most 2"):
        writer.append(stage(path, [RUN]))
    assert {name: data for name, data in contents(path).items() if not name.startswith("staging")} == before


# --- what a run says that it observes ---


def observing(*concerns: str) -> RunRecord:
    """A start that says so, two robots that join, and a task that is done."""
    events = [
        RunStarted(kind="foreign", observes=concerns),
        RobotJoined(robot=Robot("robot/A1"), role="carrier", team=1, supervisor=None),
        RobotJoined(robot=Robot("robot/A2"), role="carrier", team=1, supervisor=None),
        TaskCompleted("T1"),
    ]
    return RunRecord("seen", [0, 0, 0, 5], [None, 0, 0, 0], events)


def test_every_event_type_has_a_concern_but_beginnings() -> None:
    assert set(CONCERNED) == set(STORED) - OPENINGS
    assert set(CONCERNED.values()) == set(CONCERNS)
    assert (CONCERNED["RobotJoined.v1"], CONCERNED["TaskCompleted.v1"]) == ("fleet", "task")


@pytest.mark.parametrize(
    ("concerns", "seq", "field", "expected"),
    [
        (("fleet",), 3, "type", "an event of a concern that its run observes"),
        (("task",), 1, "type", "an event of a concern that its run observes"),
        ((), 1, "type", "an event of a concern that its run observes"),
        (("fleet", "task", "tasks"), 0, "observes", "some of "),
        (("Fleet",), 0, "observes", "some of "),
    ],
)
def test_an_event_of_a_concern_that_its_run_does_not_observe_is_refused_and_condemned(
    path: Path, concerns: tuple[str, ...], seq: int, field: str, expected: str
) -> None:
    run = observing(*concerns)
    refused(path, [BATCHES[2][0], run, RUN], f"run seen, seq {seq}, field {field}: found .*, expected {expected}")
    with Writer(path, ORIGIN) as writer:
        writer.append(stage_anything(path, [BATCHES[2][0], run, RUN]))
    assert judged(Case("unobserved", path, False)).difference == ""  # the independent verifier names the same place
    [problem, *_] = verify(path).problems
    assert (problem.commit, problem.run, problem.seq, problem.field) == (2, "seen", seq, field)
    with pytest.raises(LedgerCorrupted, match=f"commit 2: run seen, seq {seq}, field {field}"):
        list(open_ledger(path).runs())


def test_what_a_run_observes_it_may_hold_and_other_runs_may_hold_more(path: Path) -> None:
    append_all(path, [[RUN, observing("fleet", "task"), BATCHES[2][0]]])
    quiet = RunRecord("quiet", [0], [None], [RunStarted(kind="foreign", observes=())])
    append_all(path, [[quiet]])
    assert verify(path).ok


@pytest.mark.parametrize(
    "text",
    [
        "speed=3",
        "[1]",
        "",
        "{",
        '{"a":1e999999}' + "}",
        '{"a":' * 100_000 + "1" + "}" * 100_000,
        '{"seed":' + "9" * 6_000 + "}",
    ],
)
def test_parameters_that_nobody_can_read_are_refused(path: Path, text: str) -> None:
    run = RunRecord("night", [0], [None], [RunStarted(kind="live", observes=("fleet",), parameters=text)])
    refused(
        path,
        [run],
        "run night, seq 0, field parameters: found .*, expected constants as a JSON object, or None; nothing was written",
    )


@pytest.mark.parametrize("text", [None, "{}", '{"speed":{"limit_m_per_s":3.0},"modes":["slow"]}'])
def test_parameters_of_somebody_elses_are_any_json_object(path: Path, text: str | None) -> None:
    append_all(
        path,
        [
            [
                RunRecord(
                    "night",
                    [0],
                    [None],
                    [RunStarted(kind="foreign", observes=("fleet",), source="example.org", parameters=text)],
                )
            ]
        ],
    )
    assert verify(path).ok
