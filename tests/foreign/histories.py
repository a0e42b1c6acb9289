"""Draws runs as other systems may record them: every type of event, in no order that our handlers would keep."""

import random
from collections.abc import Sequence
from pathlib import Path

from fsar_ledger.events import CONCERN_OF, CONCERNS, Event
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.schema import LAYOUTS, OPENINGS, RECORDS, STANDS_ALONE, Field
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from tests.ledger.samples import ORIGIN

RUN_US = 60_000_000

# Small pools, so that events refer to each other, and now and then to what nothing else names.
_ROBOTS = ("robot/A1", "robot/B1", "robot/C1", "amr-7", "robot/gone")
_OTHERS = ("supervisor/A1", "supervisor/fleet", "coordinator", "service/policy", "agent/A1/planning", "someone")
_POOLS = {
    **dict.fromkeys(
        ("robot", "peer", "helper", "executed_by", "on_behalf_of", "target", "relay", "candidates", "busy"), _ROBOTS
    ),
    **dict.fromkeys(("rejected", "degraded", "local_deny", "local_review", "fleet_deny", "fleet_review"), _ROBOTS),
    **dict.fromkeys(("claimant", "decided_by", "requested_by", "sender", "receiver", "path"), (*_ROBOTS, *_OTHERS)),
    **dict.fromkeys(("holder", "issued_by", "visible_to"), (*_ROBOTS, *_OTHERS)),
    **dict.fromkeys(("supervisor", "supervised_by"), ("supervisor/A1", "supervisor/fleet", "supervisor/gone")),
    **dict.fromkeys(("task_id", "context"), ("t1", "t2", "t3")),
    **dict.fromkeys(
        ("action_id", "failed_action", "preempted_by", "preferred", "competing", "parent", "request_id"),
        ("t1/1", "t1/2", "t2/1", "t2/1.2", "t3/1"),
    ),
    **dict.fromkeys(("capability", "successor", "steps"), ("lift", "open-door", "carry")),
    **dict.fromkeys(("role", "peer_role", "target_role"), ("A", "B")),
    "domain": ("", "ward", "ward/east"),
    "window": ("w1", "w2"),
    "obstruction": ("crate", "cart"),
    "reason": ("no answer", "fleet-rule", "trust", "because"),
    "checkpoints": ("0", "1", "2"),
    "architecture": ("open-rmf", "fsar"),
    "configuration": ("full", "as deployed"),
}


def foreign_run(run_id: str, size: int, draw: random.Random, observes: Sequence[str] | None = None) -> LedgerRun:
    """Return a run of this many events, of the types of the concerns that it observes (by default, of some).

    Some runs also say which other types and fields they record, and some say when they began.
    """
    if observes is None:
        observes = [one for one in CONCERNS if draw.random() < draw.choice((0.3, 0.8, 1))]
    records = draw.choice((None, None, tuple(draw.sample(RECORDS, draw.randrange(40)))))
    layouts = [
        layout
        for tag, layout in LAYOUTS.items()
        if tag not in STANDS_ALONE | OPENINGS
        and ((kind := tag.partition(".")[0]) in (records or ()) or CONCERN_OF.get(kind) in (None, *observes))
    ]
    events: list[Event] = [_started(draw, observes, records)]
    # A few types come often, so that some runs have long stories of one kind.
    often = draw.sample(layouts, min(len(layouts), 12))
    while layouts and len(events) < size:
        layout = draw.choice(often if draw.random() < 0.5 else layouts)
        events.append(layout.event([_value(field, draw) for field in layout.fields]))
    times, now_us = [], 0
    for _ in events:
        times.append(now_us)
        now_us += draw.choice((0, 0, 1, draw.randrange(2 * RUN_US // size + 1)))
    return LedgerRun(run_id, times, [None, *(_cause(seq, draw) for seq in range(1, len(events)))], events)


def append(ledger: Path, runs: Sequence[LedgerRun]) -> None:
    """Append the runs to a new ledger of this format, as every writer does."""
    with Writer(ledger, ORIGIN) as writer:
        writer.append(stage(ledger, runs))


def _started(draw: random.Random, observes: Sequence[str], records: tuple[str, ...] | None) -> RunStarted:
    return RunStarted(
        kind=draw.choice(("live", "foreign")),
        observes=tuple(observes),
        architecture=draw.choice((None, *_POOLS["architecture"])),
        configuration=draw.choice((None, *_POOLS["configuration"])),
        scenario=draw.choice((None, "night shift", "door-relay")),
        seed=draw.choice((None, 42)),
        fleet_size=draw.choice((None, 3)),
        run=draw.choice((None, 1)),
        source="example.org/site",
        records=records,
        epoch=draw.choice((None, "2026-03-01T10:00:00Z")),
    )


def _cause(seq: int, draw: random.Random) -> int | None:
    return draw.choice((None, 0, seq - 1, draw.randrange(seq)))


def _value(field: Field, draw: random.Random) -> object:
    if field.is_nullable and draw.random() < 0.2:
        return None
    if field.values is not None:
        return draw.choice(sorted(field.values))
    pool = _POOLS.get(field.name, (f"{field.name} 1", f"{field.name} 2"))
    match field.kind:
        case "integer":
            return draw.randrange(RUN_US) if field.name.endswith("_us") else draw.randrange(-1, 5)
        case "boolean":
            return draw.random() < 0.5
        case "strings":
            return tuple(draw.sample(pool, draw.randrange(3)))
        case "string":
            return draw.choice(pool)
