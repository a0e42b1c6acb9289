"""An enemy simulates one architecture in a world of its own, under the others' seed, and commits and signs properly.

Every hash, note and decision in such a ledger is right. Only the world was never drawn.
"""

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from fsar_ledger.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.events.world import (
    ActuatorDegraded,
    ObstructionAppeared,
    ObstructionCleared,
    PolicyWindowClosed,
    PolicyWindowOpened,
)
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.keys import new_key, read_signer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.experiment import ORIGIN, Experiment
from fsar_ledger.runtime.kernel import Kernel
from fsar_ledger.runtime.ports import Fact
from fsar_ledger.runtime.simulation import (
    ARCHITECTURES,
    RunSpec,
    founding_of,
    handler_table_of,
    run_id,
    run_started,
    simulate_run,
)
from fsar_ledger.runtime.world.draws import Draws, SimulatedEnvironment, run_key
from fsar_ledger.runtime.world.schedule import schedule
from tests.attacks.conftest import Attack

CONSTANTS = Constants()
TROUBLE = (ObstructionAppeared, ObstructionCleared, PolicyWindowOpened, PolicyWindowClosed, ActuatorDegraded)
FAVOURED: Architecture = "fsar"
EXPERIMENT = Experiment(ARCHITECTURES, ("failure-recovery-chain", "fleet-contention"), runs=2, seed=46)


Invent = Callable[[RunSpec, Sequence[Fact]], Sequence[Fact]]


@dataclass(frozen=True)
class Invented:
    """A tampered ledger, and what an auditor holds of it.

    Of each tampered run: its name, the first seq that differs, and the fact missing there.
    """

    ledger: Path
    key: Path
    anchor: Path
    places: tuple[tuple[str, int, str], ...]


def in_its_own_world(spec: RunSpec, facts: Sequence[Fact]) -> LedgerRun:
    """Return the handlers' decisions where only these facts happen."""
    one = Kernel(
        handler_table_of(spec.architecture),
        SimulatedEnvironment(facts, Draws(run_key(spec.seed, spec.scenario, spec.run), CONSTANTS.world)),
        *founding_of(spec, CONSTANTS),
    )
    one.run()
    return LedgerRun(run_id(run_started(spec, CONSTANTS)), one.times_us, one.caused_by, one.events)


def committed(place: Path, runs: Sequence[LedgerRun]) -> tuple[Path, Path, Path]:
    """Return the ledger, the public key that signed it, and a checkpoint that an auditor keeps elsewhere."""
    ledger, secret, anchor = place / "ledger", place / "fleet.key", place / "anchor"
    new_key(secret, ORIGIN)
    signer: Signer = read_signer(secret)
    with Writer(ledger, ORIGIN, signer) as writer:
        writer.append(stage(ledger, runs))
    shutil.copy(ledger / "checkpoint", anchor)
    return ledger, secret.with_name("fleet.key.pub"), anchor


def place_of(honest: LedgerRun, record: LedgerRun) -> int:
    """Return the first seq at which the record differs from the honest one."""
    both = zip(
        zip(honest.times_us, honest.events, strict=True), zip(record.times_us, record.events, strict=True), strict=False
    )
    return next(
        (seq for seq, (left, right) in enumerate(both) if left != right), min(len(honest.events), len(record.events))
    )


def ledger_of(place: Path, invent: Invent) -> Invented:
    """Make the ledger of the experiment with the favoured architecture in what is left of its worlds."""
    runs: list[LedgerRun] = []
    places: list[tuple[str, int, str]] = []
    for spec in EXPERIMENT.specs():
        honest = record = simulate_run(spec, CONSTANTS)
        facts = schedule(CONSTANTS, spec.seed, spec.scenario, spec.run, spec.fleet_size)
        left = invent(spec, facts)
        if spec.architecture == FAVOURED and len(left) < len(facts):
            record = in_its_own_world(spec, left)
            at = place_of(honest, record)
            places.append(
                (record.run_id, at, f"{honest.events[at].__struct_config__.tag} at {honest.times_us[at]} microseconds")
            )
        runs.append(record)
    return Invented(*committed(place, runs), tuple(places))


def without(facts: Sequence[Fact], kinds: tuple[type[Event], ...]) -> list[Fact]:
    return [fact for fact in facts if not isinstance(fact[1], kinds)]


def spared(spec: RunSpec, facts: Sequence[Fact]) -> Sequence[Fact]:
    """Make a ledger in which each run is spared another kind of trouble and the last ends a fact too soon."""
    match spec.scenario, spec.run:
        case "failure-recovery-chain", 0:
            return without(facts, (ObstructionAppeared, ObstructionCleared))
        case "failure-recovery-chain", _:
            return without(facts, (PolicyWindowOpened, PolicyWindowClosed))
        case _, 0:
            return without(facts, (ActuatorDegraded,))
    return facts[:-1]


def is_found(command: Attack, evil: Invented) -> None:
    """Assert that a replay names each run with its place, what was found there and what was expected."""
    called = command(
        "verify", evil.ledger, "--trusted-key", evil.key, "--anchor", evil.anchor, "--replay", "--workers", "1"
    )
    assert (called.code, called.out) == (3, ""), called.out
    lines = called.err.splitlines()
    assert len(lines) == len(evil.places) + 1
    for line, (run, seq, missing) in zip(lines, evil.places, strict=False):
        for part in (f"commit 0, run {run}, seq {seq}, field ", f"expected {missing}"):
            assert part in line, line


@pytest.mark.slow
def test_a_world_without_trouble_for_one_architecture_is_not_taken_for_the_one_that_was_drawn(
    command: Attack, tmp_path: Path
) -> None:
    evil = ledger_of(tmp_path, lambda _, facts: without(facts, TROUBLE))
    assert command("verify", evil.ledger, "--trusted-key", evil.key, "--anchor", evil.anchor).code == 0
    of = {
        row["architecture"]: row
        for row in json.loads(command("metrics", evil.ledger, "--json").out)["rows"]
        if row["metric"] == "policy_violations"
    }
    assert of[FAVOURED]["mean"] == 0.0
    assert min(row["mean"] for name, row in of.items() if name != FAVOURED) > 0
    is_found(command, evil)


@pytest.mark.slow
def test_a_run_that_was_spared_one_kind_of_trouble_or_ends_too_soon_is_found(command: Attack, tmp_path: Path) -> None:
    evil = ledger_of(tmp_path, spared)
    assert len(evil.places) == 4
    is_found(command, evil)
