"""Judge good and damaged ledgers by the hundred with `verify` and the independent verifier, and compare them."""

import importlib
import json
import random
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from fsar_ledger.base.errors import NotALedger
from fsar_ledger.events import CONCERNS
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Note, Signer, VerifierKey, checkpoint_of
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.rows.schema import Field
from fsar_ledger.ledger.store.problem import Problem
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions, read_anchor
from tests.ledger.samples import IN_RUNS, ORIGIN

ROOT = Path(__file__).resolve().parents[2]
KEY, STRANGER = Signer(ORIGIN, b"\1" * 32), Signer(ORIGIN, b"\2" * 32)
VERSION = pa.__version__.encode()
OTHER_VERSION = b"9" * len(VERSION)
ODD = [
    *("", "A", '"', "\\", "/", "\n", "\x00", "\x1f", "\x7f", "\u0085", "é", "e\u0301"),
    *("\u2028", "\ufeff", "\uffff", "\U0001f916", "\U0010ffff", "0", " "),
]


@cache
def independent(module: str = "independent_verifier") -> Any:
    """Load the independent verifier from its file, as a module outside any package."""
    sys.path.insert(0, str(ROOT / "tests"))
    try:
        return importlib.import_module(module)
    finally:
        sys.path.pop(0)


@cache
def event_types() -> Any:
    return json.loads((ROOT / "docs" / "event-types.json").read_text("utf-8"))


# --- ledgers to begin with ---


def odd_run(run_id: str, size: int, draw: random.Random) -> LedgerRun:
    """Return a run of events of any type, with strings, integers and times that are hard to write."""

    def text() -> str:
        return "".join(draw.choice(ODD) for _ in range(draw.randrange(4)))

    def value(field: Field) -> object:
        if field.name == "observes":
            return CONCERNS
        if field.name == "records":
            return draw.choice([None, (), ("ExecutionStarted", "RequestIssued.requested_by")])
        if field.is_nullable and draw.random() < 0.3:
            return None
        if field.values is not None:
            return draw.choice(sorted(field.values))
        kinds: dict[str, Callable[[], object]] = {
            "integer": lambda: draw.choice([0, -1, 1 - 2**53, 2**53 - 1, draw.randrange(10**9)]),
            "boolean": lambda: draw.random() < 0.5,
            "strings": lambda: tuple(text() for _ in range(draw.randrange(3))),
            "string": text,
        }
        return kinds[field.kind]()

    layouts = [draw.choice(list(IN_RUNS.values())) for _ in range(size)]
    events = [layout.event(map(value, layout.fields)) for layout in layouts]
    causes = [None, *(draw.randrange(seq) for seq in range(1, size))]
    return LedgerRun(run_id, [draw.choice([0, -5, 2**53 - 1, 77]) for _ in events], causes, events)


def files_of(path: Path) -> list[Path]:
    return sorted(file for file in path.rglob("*") if file.is_file())


def note_of(tree: Frontier, signer: Signer | None) -> str:
    checkpoint = checkpoint_of(ORIGIN, tree)
    return str(Note(checkpoint, (signer.sign(checkpoint),) if signer else ()))


# --- both verdicts ---


class Case(NamedTuple):
    """A ledger to judge. `is_good` is the expected verdict, None if that depends on what was drawn."""

    name: str
    path: Path
    is_good: bool | None
    trusted: VerifierKey | None = None
    anchor: Path | None = None


Make = Callable[[Path, random.Random, Path], Case | None]


class Outcome(NamedTuple):
    """The verdict of `verify`, and the difference between the two verifiers, or between both and the expected verdict.

    `is_stricter`: `verify` only doubts that its own version of the library wrote these bytes for right rows, or that a
    footer and its columns agree, which is more than the format asks.
    """

    is_good: bool
    difference: str
    is_stricter: bool = False


Place = tuple[str, int | None, str | None, int | None]


def judged(case: Case) -> Outcome:
    """Judge the case by both verifiers."""
    ours, theirs = by_package(case), by_independent(case)
    is_about_bytes = ours is not None and ("found other bytes" in ours[1] or "found no segment (" in ours[1])
    if is_about_bytes and theirs is None and case.is_good is None:
        return Outcome(False, "", is_stricter=True)
    if (ours is None) != (theirs is None):
        return Outcome(
            ours is None, f"{case.name}: verify says {ours or 'good'}, the independent verifier {theirs or 'good'}"
        )
    if ours is not None and theirs is not None and not is_same_place(ours[0], theirs[0]):
        return Outcome(False, f"{case.name}: verify names {ours}, the independent verifier {theirs}")
    if case.is_good is not None and case.is_good != (ours is None):
        return Outcome(
            ours is None, f"{case.name}: expected {'good' if case.is_good else 'damage'}, both say {ours or 'good'}"
        )
    return Outcome(ours is None, "")


def is_same_place(one: Place, other: Place) -> bool:
    """Return whether both name the same file, and the same commit, run and seq where both name them."""
    return one[0] == other[0] and all(a == b or a is None or b is None for a, b in zip(one[1:], other[1:], strict=True))


def by_package(case: Case) -> tuple[Place, str] | None:
    asked = VerifyOptions(trusted=case.trusted, anchor=read_anchor(case.anchor) if case.anchor else None)
    try:
        report = verify(case.path, asked=asked)
    except NotALedger as error:
        return ("", None, None, None), str(error)
    if report.ok:
        return None
    first = report.problems[0]
    return (first.where, first.commit, first.run, first.seq), str(first)


def by_independent(case: Case) -> tuple[Place, str] | None:
    module = independent()
    key = module.read_key(str(case.trusted)) if case.trusted else None
    try:
        independent("independent_chain").Verifier(case.path, key, case.anchor, event_types()).verify()
    except module.ProblemError as error:
        named = Problem(error.where, "", "", run=error.run)  # a report names both in printable characters
        return (named.where, error.commit, named.run, error.seq), str(error)
    return None
