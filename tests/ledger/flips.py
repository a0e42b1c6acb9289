"""A small ledger of real runs, single flipped bits in it, and the answers of each command to it."""

import io
import random
from collections.abc import Iterable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.cli import app
from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.configuration import PAPER_ARCHITECTURES
from fsar_ledger.events.envelope import Scenario
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from tests.ledger.damage import files_of, kind_of

VERBS: dict[str, tuple[str, ...]] = {
    "metrics": ("metrics", "LEDGER", "--json"),
    "metrics by scenario": ("metrics", "LEDGER", "--by", "scenario"),
    "statistics": ("statistics", "LEDGER", "--csv"),
    "audit": ("audit", "LEDGER", "--json"),
    "query": ("query", "decisions", "LEDGER", "--csv"),
    "sql": ("sql", "LEDGER", "SELECT * FROM events ORDER BY ALL", "--csv"),
    "explain": ("explain", "LEDGER"),
    "info": ("info", "LEDGER", "--json"),
    "prove": ("prove", "LEDGER", "700"),
    "prove by name": ("prove", "LEDGER", "cfc.full.door-relay:9"),
    "export": ("export", "LEDGER", "--out", "OUT/events.csv"),
    "export of a query": ("export", "LEDGER", "--query", "metrics/run_metrics", "--out", "OUT/metrics.parquet"),
    "replay": ("verify", "LEDGER", "--replay", "--workers", "1", "--json"),
    "report": ("report", "LEDGER", "--out", "OUT/report.pdf", "--workers", "1"),
}
"""Every command that answers from a ledger; one call of each."""

SCENARIOS: tuple[Scenario, ...] = ("door-relay", "failure-recovery-chain", "fleet-contention")

KINDS = {"segments": 50, "chain.jsonl": 15, "journal.jsonl": 20, "ledger.json": 4, "checkpoint": 4}
KINDS |= {"index.jsonl": 5, "nodes": 2}
"""Of a hundred flips, how many are in files of each kind. Most bytes that an answer depends on are in segments."""


class Flip(NamedTuple):
    """One bit of one file, which is named within the ledger."""

    name: str
    at: int
    bit: int


class Answer(NamedTuple):
    """The answer of a command: exit code, stdout, and the file that it wrote."""

    code: int
    out: str
    file: bytes | None


def write_runs(path: Path) -> None:
    """Write a ledger of three runs of each architecture: mostly data, as in a large one.

    Those of the last architecture are in the journal, and two segments were made one.
    """
    batches = [
        [simulate_run(RunSpec(7, architecture, "full", scenario, 4, 0), Constants()) for scenario in SCENARIOS]
        for architecture in PAPER_ARCHITECTURES
    ]
    with Writer(path, "example.org/flips") as writer:
        for batch in batches[:-1]:
            writer.append(stage(path, batch))
        writer.compact()
        for run in batches[-1]:
            writer.add([run])


def chosen(path: Path, count: int, seed: int, kinds: dict[str, int] = KINDS) -> Iterator[Flip]:
    """Yield this many randomly drawn bits of the ledger's files."""
    draw = random.Random(seed)
    files: dict[str, list[str]] = {}
    for name in files_of(path):
        files.setdefault(kind_of(name), []).append(name)
    present = [kind for kind in kinds if kind in files]
    for kind in draw.choices(present, [kinds[kind] for kind in present], k=count):
        name = draw.choice(files[kind])
        yield Flip(name, draw.randrange((path / name).stat().st_size), draw.randrange(8))


def answered(path: Path, out: Path, verb: str) -> Answer:
    """Return what this command answers from the ledger now."""
    text = io.StringIO()
    with redirect_stdout(text), redirect_stderr(io.StringIO()):
        code = app.run([word.replace("LEDGER", str(path)).replace("OUT", str(out)) for word in VERBS[verb]])
    written = sorted(out.iterdir())
    data = written[0].read_bytes() if written else None
    for file in written:
        file.unlink()
    return Answer(code, text.getvalue(), data)


def undamaged(path: Path, out: Path, verbs: Iterable[str] = VERBS) -> dict[str, Answer]:
    """Return what these commands answer from the intact ledger, once it has been verified."""
    with redirect_stdout(io.StringIO()):
        assert app.run(["verify", str(path), "--workers", "1"]) == 0
    good = {verb: answered(path, out, verb) for verb in verbs}
    assert all(answer.out and answer.code in (0, 1) for answer in good.values()), good
    return good


def outcome(good: Answer, now: Answer) -> str:
    """Return whether this is the same answer, a refusal without an answer, or a wrong answer.

    The newest record names its first and last run, which only a whole look compares with rows. With a changed letter
    there it is another head, and the answer is the same except for saying that nobody looked at the rows.
    """
    if now._replace(out=now.out.replace('"rows_verified": false', '"rows_verified": true')) == good:
        return "same"
    if now.code in (2, 3) and now.file is None and (not now.out or '"ok": false' in now.out):
        return "refused"
    return "wrong"


def outcomes(path: Path, out: Path, flip: Flip, good: dict[str, Answer]) -> dict[str, str]:
    """Return the outcome of each command while the bit is flipped."""
    file = path / flip.name
    data = file.read_bytes()
    file.write_bytes(data[: flip.at] + bytes([data[flip.at] ^ 1 << flip.bit]) + data[flip.at + 1 :])
    try:
        return {verb: outcome(answer, answered(path, out, verb)) for verb, answer in good.items()}
    finally:
        file.write_bytes(data)
