"""Runs that a writer refuses for what the ledger already holds, or for what they claim to observe."""

import pickle
import re
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.base.errors import InvalidRun, LedgerCorrupted, WriteFailed
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.envelope import Robot, with_columns
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.schema import CONCERNED, OPENINGS, STORED
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests import past
from tests.ledger.agreement import Case, judged
from tests.ledger.hostile import stage_anything
from tests.ledger.samples import ORIGIN, append_all, contents, made_up_run
from tests.ledger.test_refused_runs import BATCHES, RUN, refused
from tests.ledger.test_writer_property import with_event

COMMITTED = BATCHES[:2]


def too_large() -> dict[str, LedgerRun]:
    run = made_up_run("run-9", 4, 3)
    long = with_columns(run.events[0], parameters=f'{{"a":"{"x" * 2**23}"}}')
    times, causes, events = [0] * 20_000, [None, *[0] * 19_999], [run.events[0], *[run.events[1]] * 19_999]
    return {
        "found a name of 4097 bytes, expected at most 4096": msgspec.structs.replace(run, run_id="x" * 4097),
        "found 20000 events of": LedgerRun("run-9", times, causes, events),
        "expected at most 16384 events and 8388608 bytes in one commit of a journal": with_event(run, 0, long),
    }


@pytest.mark.parametrize("found", too_large())
def test_what_no_segment_could_hold_is_not_put_into_a_journal(tmp_path: Path, found: str) -> None:
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        writer.add([RUN])
        before = contents(tmp_path / "ledger")
        with pytest.raises(InvalidRun, match=re.escape(found)):
            writer.add([too_large()[found]])
        assert contents(tmp_path / "ledger") == before


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
                match=rf"run {run.run_id}, seq 0, field run_id: found run {run.run_id} once more, expected its seq 12",
            ):
                writer.append(stage(path, runs))
            assert contents(path) == before
        assert writer.append(stage(path, BATCHES[2])).commits == 3
        with pytest.raises(InvalidRun, match=f"run {BATCHES[2][1].run_id}, .* once more"):
            writer.append(stage(path, [RUN, BATCHES[2][1]]))
        assert writer.append(stage(path, BATCHES[0])).commits == 3  # a whole batch may come again
    assert verify(path).ok
    assert verify(path).runs == 6


def test_of_two_writers_with_the_same_run_in_other_batches_one_commits_it(path: Path) -> None:
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as two:
        staged = stage(path, [RUN, *BATCHES[2]])
        one.append(stage(path, [*BATCHES[3], RUN]))
        with pytest.raises(InvalidRun, match=r"run run-1, .* found run run-1 once more"):
            two.append(staged)
        assert two.append(stage(path, BATCHES[2])).commits == 4
    assert verify(path).ok


def test_a_commit_that_another_writer_made_alike_is_known_to_hold_its_runs(path: Path) -> None:
    with Writer(path, ORIGIN) as one, Writer(path, ORIGIN) as two:
        two.append(stage(path, BATCHES[3]))  # from now on it knows what is there without reading it
        staged = stage(path, BATCHES[2])
        assert one.append(staged) == two.append(staged)  # the second finds it committed and no longer staged
        with pytest.raises(InvalidRun, match="once more"):
            two.append(stage(path, [RUN, BATCHES[2][0]]))
        with pytest.raises(InvalidRun, match="once more"):
            one.append(stage(path, [RUN, BATCHES[2][0]]))
    assert verify(path).ok


def test_of_writers_at_once_with_the_same_runs_each_run_is_committed_once(path: Path) -> None:
    runs = [made_up_run(f"crowd-{number}", 5, seed=number) for number in range(4)]
    offered = [[one, other] for one, other in product(runs, runs) if one is not other]

    def offer(batch: list[LedgerRun]) -> str:
        try:
            with Writer(path, ORIGIN) as writer:
                writer.append(stage(path, batch))
        except (InvalidRun, WriteFailed) as error:
            return type(error).__name__
        return "committed"

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
            with pytest.raises(InvalidRun, match="once more"):
                writer.append(stage(path, [RUN, run]))
    assert verify(path).ok


# --- between staging and the commit ---


def test_a_staged_file_of_the_same_size_but_other_bytes_is_not_committed(path: Path) -> None:
    before = contents(path)
    with Writer(path, ORIGIN) as writer:
        staged = pickle.loads(pickle.dumps(stage(path, [RUN])))
        file = path / "staging" / f"{staged.segment_sha256}.parquet"
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
    headless = LedgerRun("run-1", [5, 4], [None, 0], RUN.events[1:3])
    with Writer(path, ORIGIN) as writer:
        writer.append(stage_anything(path, [headless]))
    assert verify(path).ok
    assert list(open_ledger(path).runs())[-1] == headless


# --- what a run claims to observe ---


def observing(*concerns: str) -> LedgerRun:
    """Return a run whose start says so, with two robots that join and a task that is done."""
    events = [
        RunStarted(kind="foreign", observes=concerns),
        past.joined(Robot("robot/A1"), "carrier"),
        past.joined(Robot("robot/A2"), "carrier"),
        TaskCompleted("T1"),
    ]
    return LedgerRun("seen", [0, 0, 0, 5], [None, 0, 0, 0], events)


def test_every_event_type_has_a_concern_but_beginnings() -> None:
    of_no_deed = {"SourceOpened.v1", "Observed.v1", "SourceClosed.v1", "RunContinued.v1"}
    assert set(CONCERNED) == set(STORED) - OPENINGS - of_no_deed
    assert set(CONCERNED.values()) == set(CONCERNS)
    assert (CONCERNED["RobotJoined.v1"], CONCERNED["TaskCompleted.v1"]) == ("fleet", "task")


@pytest.mark.parametrize(
    ("concerns", "seq", "field", "expected"),
    [
        (("fleet",), 3, "type", "an event of a concern that its run observes"),
        pytest.param(("task",), 1, "type", "an event of a concern that its run observes", marks=pytest.mark.slow),
        pytest.param((), 1, "type", "an event of a concern that its run observes", marks=pytest.mark.slow),
        (("fleet", "task", "tasks"), 0, "observes", "some of "),
        pytest.param(("Fleet",), 0, "observes", "some of ", marks=pytest.mark.slow),
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
    with pytest.raises(LedgerCorrupted, match=f"run seen, seq {seq}, field {field}"):
        list(open_ledger(path).runs())


def test_what_a_run_observes_it_may_hold_and_other_runs_may_hold_more(path: Path) -> None:
    append_all(path, [[RUN, observing("fleet", "task"), BATCHES[2][0]]])
    quiet = LedgerRun("quiet", [0], [None], [RunStarted(kind="foreign", observes=())])
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
    run = LedgerRun("night", [0], [None], [RunStarted(kind="live", observes=("fleet",), parameters=text)])
    refused(
        path,
        [run],
        "run night, seq 0, field parameters: found .*, expected constants as a JSON object, or None; nothing "
        "was written",
    )


@pytest.mark.parametrize("text", [None, "{}", '{"speed":{"limit_m_per_s":3.0},"modes":["slow"]}'])
def test_parameters_of_somebody_elses_are_any_json_object(path: Path, text: str | None) -> None:
    started = RunStarted(kind="foreign", observes=("fleet",), source="example.org", parameters=text)
    append_all(path, [[LedgerRun("night", [0], [None], [started])]])
    assert verify(path).ok
