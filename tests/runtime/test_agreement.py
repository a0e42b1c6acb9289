"""Trust, policy, rights, candidates and robots' state: the handlers' projections and the SQL say the same after every
event.

Both exist on purpose: SQL judges what the handlers did, so it reads the record for itself. Random commands over random
fleets play a run; each event ends a run of its own, which holds all events up to it, and the questions are asked of all
of these runs at once.

`python -m tests.runtime.test_agreement 10000` compares after at least so many events and prints its counts.
"""

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from hypothesis import settings
from hypothesis.stateful import run_state_machine_as_test

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ExecutionPreempted
from fsar_ledger.events.request import RequestAdmitted, RequestCountered, RequestDenied, RequestIssued
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.metrics.database import Database
from fsar_ledger.projections import policy, trust, world
from fsar_ledger.projections.authority import right_of
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.projections.registry import surface
from fsar_ledger.runtime.handlers.candidates import hides
from tests.quick import few
from tests.recycled import from_table
from tests.runtime.bench import Bench
from tests.runtime.commanded import commanded
from tests.runtime.robot_states import execution_state
from tests.runtime.test_federation_model import SETTINGS, Federation

CAPABILITY, CONTEXT = "door.open.secure", "visit"
ROWS_AT_ONCE = 15_000
EVALUATIONS = (RequestAdmitted, RequestDenied, RequestCountered)
COUNTS: Counter[str] = Counter()

Said = dict[tuple[Any, ...], Any]
"""What one side says, by question and what it is about."""


def said_by_handlers(state: State) -> Said:
    """Return what the projections say after an event, by question, robot and what else it is about."""
    said: Said = {}
    robots = list(state.fleet.robots)
    for robot in robots:
        said["state", robot] = execution_state(state, robot)
        for scope, windows in (("local", state.world.local), ("fleet", state.world.fleet)):
            ruled = policy.ruled(state.policy, scope, robot, CAPABILITY, CONTEXT) or "allow"  # type: ignore[arg-type]
            said["policy", robot, scope] = world.stricter(world.in_force(windows, robot), ruled)
        for peer in robots:
            scope_of_peer = trust.scope_of(state.trust, robot, peer, CAPABILITY, CONTEXT)
            if peer != robot and scope_of_peer != "none":
                said["trust", robot, peer] = scope_of_peer
        for record in surface(state.registry, robot):
            may_ask = []
            for peer in robots:
                given = trust.scope_of(state.trust, robot, peer, record.capability)
                if peer != robot and given != "none" and trust.covers(given, record.trust_required):
                    is_away = peer in state.fleet.departed
                    may_ask += [] if is_away or hides(state, record, peer, peer, None) else [peer]
            said["candidates", robot, record.capability] = (
                record.version,
                record.availability,
                record.is_deprecated,
                tuple(sorted(may_ask)),
            )
    return said


def said_by_queries(database: Database) -> dict[str, Said]:
    """Return what the audit questions answer at the end of each run, by run."""
    said: dict[str, Said] = {}
    about = {"capability": CAPABILITY, "context": CONTEXT}
    for row in database.query("audit/robot_state_at").to_pylist():
        said.setdefault(row["run_id"], {})["state", row["robot"]] = row["state"]
    for row in database.query("audit/policy_at", about).to_pylist():
        said[row["run_id"]]["policy", row["robot"], row["scope"]] = row["outcome"]
    for row in database.query("audit/trust_at", about).to_pylist():
        if row["trust_scope"] != "none":
            said[row["run_id"]]["trust", row["robot"], row["peer"]] = row["trust_scope"]
    for row in database.query("audit/capability_surface").to_pylist():
        found = (row["version"], row["availability"], row["is_deprecated"], tuple(row["may_ask"]))
        said[row["run_id"]]["candidates", row["robot"], row["capability"]] = found
    return said


def disagreements(record: LedgerRun) -> Iterator[str]:
    """Yield every event after which the handlers and the SQL say different things, with what each says."""
    state, expected = State(), {}
    between: dict[str, tuple[str, str]] = {}
    rights: Said = {}
    asked: dict[str, RequestIssued] = {}
    for seq, event in enumerate(record.events):
        rights.update(_rights_at(state, seq, event, asked))
        apply(state, event)
        expected[f"{seq:06}"] = said_by_handlers(state)
        if isinstance(event, ExecutionPreempted):
            # One reaction records what gives way and what takes the robot; between the two it has nothing in hand.
            between[f"{seq:06}"] = ("state", event.robot)
        if isinstance(event, RequestIssued) and event.subject.action_id is not None:
            asked[event.subject.action_id] = event
    for prefixes in _prefixes(record):
        with from_table(encode(prefixes)) as database:
            found = said_by_queries(database)
        for prefix in prefixes:
            COUNTS["events"] += 1
            for said in (expected[prefix.run_id], found.get(prefix.run_id, {})):
                said.pop(between.get(prefix.run_id, ()), None)
            yield from _compared(prefix.run_id, expected[prefix.run_id], found.get(prefix.run_id, {}))
    with from_table(encode([record])) as database:
        revoked = {
            ("right", row["seq"], row["asker"]): row["is_revoked"]
            for row in database.query("facts/rights_at_evaluations").to_pylist()
        }
    yield from _compared(record.run_id, rights, revoked)


def _rights_at(state: State, seq: int, event: Event, asked: dict[str, RequestIssued]) -> Said:
    """Return whether the last word on each who asks is a revocation, where the event judges a request."""
    if not isinstance(event, EVALUATIONS) or (issued := asked.get(event.subject.action_id or "")) is None:
        return {}
    asked_by = issued.principals.requested_by
    judge = event.principals.executed_by or issued.principals.executed_by
    executor = issued.relay if issued.relay is not None and event.principals.decided_by == issued.relay else judge
    said: Said = {}
    for asker in {asked_by, issued.relay or asked_by}:
        right = right_of(
            state.authority, Robot(str(asker)), Robot(str(executor)), issued.capability, issued.subject.task_id or ""
        )
        if right is not None:
            said["right", seq, asker] = type(right).__name__ == "AuthorityRevoked"
    return said


def _prefixes(record: LedgerRun) -> Iterator[Sequence[LedgerRun]]:
    """Yield a run for each event, which holds all events up to it, some runs at a time."""
    several: list[LedgerRun] = []
    rows = 0
    for end in range(1, len(record.events) + 1):
        several.append(LedgerRun(f"{end - 1:06}", record.times_us[:end], record.caused_by[:end], record.events[:end]))
        rows += end
        if rows > ROWS_AT_ONCE or end == len(record.events):
            yield several
            several, rows = [], 0


def _compared(run: str, expected: Said, found: Said) -> Iterator[str]:
    for about in sorted(expected.keys() | found.keys(), key=str):
        COUNTS[str(about[0])] += 1
        if expected.get(about) != found.get(about):
            yield f"seq {run}: {about}: handlers {expected.get(about)}, queries {found.get(about)}"


class Agreement(Federation):
    """A federation whose run is compared in the end."""

    def teardown(self) -> None:
        """Compare the run that was played after each of its events."""
        bench = self.bench
        assert isinstance(bench, Bench)
        wrong = list(disagreements(bench.record("live")))
        assert wrong == [], "\n".join(wrong[:5])


def test_handlers_and_queries_agree_after_every_event_of_the_commanded_run() -> None:
    kernel = commanded()
    wrong = list(disagreements(LedgerRun("live", kernel.times_us, kernel.caused_by, kernel.events)))
    assert wrong == [], "\n".join(wrong[:5])


def test_handlers_and_queries_agree_after_every_event_of_random_runs() -> None:
    once = settings(SETTINGS, derandomize=True, max_examples=1, stateful_step_count=10)
    run_state_machine_as_test(Agreement, settings=once)


@pytest.mark.parametrize("runs", few([8, 20], [], [8]))
def test_handlers_and_queries_agree_after_every_event_of_many_random_runs(runs: int) -> None:
    run_state_machine_as_test(Agreement, settings=settings(SETTINGS, derandomize=True, max_examples=runs))


def soak(events: int) -> None:
    """Compare after at least so many events; raise on the first that the two sides take otherwise."""
    while COUNTS["events"] < events:
        run_state_machine_as_test(Agreement, settings=settings(SETTINGS, max_examples=10))
        print(", ".join(f"{count:,} {name}" for name, count in sorted(COUNTS.items())), flush=True)


if __name__ == "__main__":
    soak(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
