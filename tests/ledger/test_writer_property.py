"""Whatever a writer accepts, `verify` accepts and readers read back; whatever it refuses leaves the bytes of the ledger
unchanged.

Batches are mostly good; a few values of any field, cause, time, name or order in them are not.
"""

import enum
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsar_ledger.base.errors import InvalidRun
from fsar_ledger.events import CONCERNS, Event
from fsar_ledger.events.envelope import flat, with_columns
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.schema import LAYOUTS, MAX_INTEGER
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions
from tests.ledger.samples import ORIGIN, contents, made_up_run


class Word(enum.StrEnum):
    FSAR = "fsar"
    LIVE = "live"


class Number(enum.IntEnum):
    ONE = 1


class Posing(str):
    """A string that claims to equal every string."""

    def __eq__(self, other: object) -> bool:
        return True

    def __hash__(self) -> int:
        return hash("fsar")


class Pair(tuple[str, ...]):
    pass


class Stranger(Event, frozen=True):
    robot: str


STARTED = next(iter(LAYOUTS.values())).cls
ODD: tuple[object, ...] = (
    *(
        None,
        True,
        False,
        0,
        1,
        -1,
        1.0,
        0.5,
        float("nan"),
        MAX_INTEGER,
        -MAX_INTEGER,
        MAX_INTEGER + 1,
        -MAX_INTEGER - 1,
        2**63,
        -(2**63) - 1,
        2**70,
    ),
    *("", "fsar", "live", "peer", "Local", "x" * 5_000, "\ud800", "\x1b[2J", "a\nb", "\u202e", "Zürich", '"\\'),
    *(b"fsar", Word.FSAR, Word.LIVE, Number.ONE, Posing("other"), Posing("live")),
    *(
        (),
        ("a",),
        ("a", "a"),
        (1,),
        (None,),
        (b"a",),
        (("a",),),
        (Word.FSAR,),
        (Posing("b"),),
        ("\ud800",),
        ("\x00",),
        Pair(("a",)),
        ["a"],
        {"a"},
        {"a": 1},
    ),
)
IDS: tuple[object, ...] = (
    "run-0",
    "run-1",
    "run-2",
    "run-3",
    "",
    "x" * 5_000,
    "\ud800",
    "a\nb",
    "東京",
    None,
    3,
    b"run-0",
    Word.LIVE,
    Posing("run-9"),
    ["run-0"],
)

Change = Callable[[LedgerRun, st.DrawFn], LedgerRun]


def another_value(run: LedgerRun, draw: st.DrawFn) -> LedgerRun:
    seq = draw(st.integers(0, len(run.events) - 1))
    names = tuple(flat(run.events[seq]))
    if not names:
        return run
    event = with_columns(run.events[seq], **{draw(st.sampled_from(names)): draw(st.sampled_from(ODD))})
    return with_event(run, seq, event)


def other_concerns(run: LedgerRun, draw: st.DrawFn) -> LedgerRun:
    concerns = tuple(draw(st.lists(st.sampled_from([*CONCERNS, *CONCERNS, "typo"]), max_size=14)))
    return with_event(run, 0, msgspec.structs.replace(run.events[0], observes=concerns))


def another_event(run: LedgerRun, draw: st.DrawFn) -> LedgerRun:
    seq = draw(st.integers(0, len(run.events) - 1))
    strange: tuple[object, ...] = (*run.events, run.events[0], Stranger("robot/A1"), "event", None, STARTED)
    return with_event(run, seq, draw(st.sampled_from(strange)))


def another_time(run: LedgerRun, draw: st.DrawFn) -> LedgerRun:
    times: list[object] = list(run.times_us)
    times[draw(st.integers(0, len(times) - 1))] = draw(st.sampled_from(ODD) | st.sampled_from(run.times_us))
    return msgspec.structs.replace(run, times_us=times)


def another_cause(run: LedgerRun, draw: st.DrawFn) -> LedgerRun:
    causes: list[object] = list(run.caused_by)
    causes[draw(st.integers(0, len(causes) - 1))] = draw(st.sampled_from(ODD) | st.integers(-1, len(causes)))
    return msgspec.structs.replace(run, caused_by=causes)


def another_name(run: LedgerRun, draw: st.DrawFn) -> LedgerRun:
    return msgspec.structs.replace(run, run_id=draw(st.sampled_from(IDS)))


def another_length(run: LedgerRun, draw: st.DrawFn) -> LedgerRun:
    name = draw(st.sampled_from(["times_us", "caused_by", "events"]))
    size = draw(st.integers(0, len(run.events) - 1))
    return msgspec.structs.replace(run, **{name: list(getattr(run, name))[:size]})


def cut(run: LedgerRun, draw: st.DrawFn) -> LedgerRun:
    """Return the end of the run, as if it went on in another commit."""
    at = draw(st.integers(0, len(run.events) - 1))
    return LedgerRun(run.run_id, run.times_us[at:], [None, *range(len(run.events) - at - 1)], run.events[at:])


def with_event(run: LedgerRun, seq: int, event: object) -> LedgerRun:
    return msgspec.structs.replace(run, events=[*run.events[:seq], event, *run.events[seq + 1 :]])


CHANGES: tuple[Change, ...] = (
    *(another_value, another_value, another_value, other_concerns, another_event),
    *(another_time, another_cause, another_name, another_length, cut),
)


@st.composite
def batches(draw: st.DrawFn) -> list[LedgerRun]:
    """Draw up to three runs, each good or with one thing changed. There are few names, so that they repeat."""
    runs = [
        made_up_run(f"run-{draw(st.integers(0, 9))}", draw(st.integers(1, 7)), draw(st.integers(0, 99)))
        for _ in range(draw(st.integers(0, 3)))
    ]
    return [draw(st.sampled_from(CHANGES))(run, draw) if draw(st.integers(0, 3)) == 0 else run for run in runs]


def check(path: Path, offered: list[list[LedgerRun]], fates: Counter[str]) -> None:
    """Append each batch, with a new writer or the one before; then check everything that is there."""
    kept: list[LedgerRun] = []
    writer = Writer(path, ORIGIN)
    accepted: list[list[LedgerRun]] = []
    said: list[str] = []
    for number, batch in enumerate(offered):
        if number % 3 == 2:
            writer.close()
            writer = Writer(path, ORIGIN)
        before = contents(path)
        try:
            writer.append(stage(path, batch))
        except InvalidRun as refused:
            assert contents(path) == before, "refused, and yet something is there"
            said.append(str(refused))
        else:
            kept += [] if batch in accepted else batch  # a segment that is there already changes nothing
            accepted.append(batch)
            fates["accepted"] += 1
    writer.close()
    fates["refused"] += len(said)
    assert all("found" in line and "expected" in line for line in said), said
    for asked in (VerifyOptions(), VerifyOptions(is_quick=True)):
        report = verify(path, asked=asked)
        assert report.ok, report.problems
    assert list(open_ledger(path).runs()) == kept


FATES: Counter[str] = Counter()


def look(offered: list[list[LedgerRun]]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        check(Path(folder) / "ledger", offered, FATES)


def at_all(examples: int, *, is_the_same: bool) -> None:
    """Try this many ledgers, the same each time or others."""
    FATES.clear()
    limits = settings(
        max_examples=examples,
        deadline=None,
        suppress_health_check=list(HealthCheck),
        derandomize=is_the_same,
        database=None,
    )
    limits(given(offered=st.lists(batches(), min_size=1, max_size=5))(look))()
    assert min(FATES["refused"], FATES["accepted"]) > examples // 2, FATES


@pytest.mark.slow
def test_more_of_what_is_accepted_verifies_and_of_what_is_refused_leaves_no_trace() -> None:
    at_all(30, is_the_same=True)


@pytest.mark.soak
def test_whatever_is_accepted_verifies_at_length() -> None:
    at_all(2_000, is_the_same=False)
