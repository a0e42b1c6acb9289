"""Made-up runs for tests that need rows but no robots."""

import random
from collections.abc import Sequence
from pathlib import Path

from hypothesis import strategies as st

from fsar_ledger.events import CONCERNS, Event
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.schema import LAYOUTS, MAX_INTEGER, RECORDS, STANDS_ALONE, Field, StoredType
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.record import Head
from fsar_ledger.ledger.store.staging import stage

ORIGIN = "example.org/fsar-test"
IN_RUNS = {tag: layout for tag, layout in LAYOUTS.items() if tag not in STANDS_ALONE}
"""How events are stored that may be in a run with others."""


def _value(field: Field, draw: random.Random) -> object:
    if field.name == "observes":
        return CONCERNS
    if field.name == "records":
        return draw.choice([None, (), ("ExecutionStarted", "ExecutionStarted.requested_by")])
    if field.is_nullable and draw.random() < 0.2:
        return None
    if field.values is not None:
        return draw.choice(sorted(field.values))
    match field.kind:
        case "integer":
            return draw.randrange(60_000_000) if field.name.endswith("_us") else draw.randrange(5)
        case "boolean":
            return draw.random() < 0.5
        case "strings":
            return tuple(f"robot/{draw.choice('ABCD')}1" for _ in range(draw.randrange(3)))
        case "string":
            text = f"{field.name}-{draw.randrange(4)}"
            return f'{{"constant":"{text}"}}' if field.name == "parameters" else text


def made_up_run(run_id: str, size: int, seed: int) -> LedgerRun:
    """Return a run of this many events of all types, each caused by an earlier one."""
    draw = random.Random(seed)
    layouts = list(IN_RUNS.values())
    chosen = [layouts[0], *(draw.choice(layouts[1:]) for _ in range(size - 1))]
    events = [layout.event([_value(field, draw) for field in layout.fields]) for layout in chosen]
    times = sorted(draw.randrange(60_000_000) for _ in range(size))
    return LedgerRun(run_id, times, [None, *(max(0, seq - draw.randrange(1, 5)) for seq in range(1, size))], events)


def run_of_every_type(run_id: str, seed: int) -> LedgerRun:
    """Return a run with one start and two events of every other type."""
    draw = random.Random(seed)
    first, *others = IN_RUNS.values()
    layouts = [first, *(layout for layout in others for _ in range(2))]
    events = [layout.event([_value(field, draw) for field in layout.fields]) for layout in layouts]
    return LedgerRun(run_id, list(range(0, 1000 * len(events), 1000)), [None, *range(len(events) - 1)], events)


def made_up_batches(commits: int, runs: int = 2, size: int = 12) -> list[list[LedgerRun]]:
    """Return this many batches of runs; the same call gives the same batches."""
    numbers = [range(commit * runs, (commit + 1) * runs) for commit in range(commits)]
    return [[made_up_run(f"run-{number:04d}", size, seed=number) for number in batch] for batch in numbers]


def append_all(
    path: Path, batches: Sequence[Sequence[LedgerRun]], origin: str = ORIGIN, signer: Signer | None = None
) -> Head:
    """Append these batches to the ledger at the path, one per commit. New commits are signed if there is a signer,
    whoever signed the others."""
    with Writer(path, origin, signer, adopts=True) as writer:
        for batch in batches:
            writer.append(stage(path, batch))
        return writer.head


def contents(path: Path) -> dict[str, bytes]:
    """Return every file under the path by its name within it."""
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


# --- any event at all ---

_TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
_INTEGERS = st.integers(-MAX_INTEGER, MAX_INTEGER)


def _any_value(field: Field) -> st.SearchStrategy[object]:
    if field.name == "observes":
        return st.just(CONCERNS)
    if field.name == "records":
        return st.none() | st.lists(st.sampled_from(RECORDS), max_size=3).map(tuple)
    kinds: dict[str, st.SearchStrategy[object]] = {
        "string": st.sampled_from(sorted(field.values)) if field.values else _TEXT,
        "integer": _INTEGERS,
        "boolean": st.booleans(),
        "strings": st.lists(_TEXT, max_size=3).map(tuple),
    }
    return st.none() | kinds[field.kind] if field.is_nullable else kinds[field.kind]


def any_event_of(layout: StoredType) -> st.SearchStrategy[Event]:
    """Draw any event of this type."""
    return st.tuples(*map(_any_value, layout.fields)).map(layout.event)


any_event = st.one_of([any_event_of(layout) for layout in IN_RUNS.values()])
any_plan = st.one_of([any_event_of(LAYOUTS[tag]) for tag in sorted(STANDS_ALONE)]).map(lambda event: [event])


@st.composite
def any_runs(draw: st.DrawFn) -> list[LedgerRun]:
    """Draw up to three runs of any events."""
    ids = draw(st.lists(_TEXT, min_size=1, max_size=3, unique=True))
    runs = []
    for run_id in ids:
        events = draw(st.lists(any_event, min_size=1, max_size=6) | any_plan)
        times = [draw(_INTEGERS) for _ in events]
        runs.append(
            LedgerRun(run_id, times, [None, *(draw(st.integers(0, seq - 1)) for seq in range(1, len(events)))], events)
        )
    return runs
