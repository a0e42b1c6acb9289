"""Every verb over a ledger with hostile text in every field, in a terminal: nothing is painted, and no line begins with
what an attacker wrote."""

import json
import os
import pty
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.log.note import Signer
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from fsar_ledger.witness import Cosigner
from tests.cli.conftest import Call
from tests.ledger.hostile import relabelled, stage_anything
from tests.terminal import CLAIM, PAINT, POISON, painted, screen_of
from tests.test_documentation import COMMANDS

ORIGIN = f"example.org/\u05d0\u3164{'y' * 300}"
"""As bad as an origin may be, which is printable and without blanks."""
EVIL = "".join(text for text in PAINT.values() if "\0" not in text and len(text) < 1_000)
FOLDER = "led\x1b[2J\x1b[H\n" + CLAIM.replace("/", "") + "\u202e"
"""A folder's name may be anything but a NUL and a slash."""


def hostile(text: str) -> str:
    """The text with all that paints behind it."""
    return text + EVIL


@pytest.fixture(scope="module")
def ledger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger that verifies, with a run whose every free text is hostile."""
    path = tmp_path_factory.mktemp("evil") / FOLDER
    run = simulate_run(RunSpec(5, "fsar", "full", "failure-recovery-chain", 4, 0), Constants())
    with Writer(path, ORIGIN) as writer:
        writer.append(stage_anything(path, [relabelled(run, hostile)]))
    return path


def first_of(ledger: Path, call: Call, column: str) -> str:
    """The first value of a column of `audit/requests`, as it is."""
    rows = json.loads(call("explain", ledger, "--json").out)
    return str(rows["run"] if column == "run_id" else rows["requests"][0][column])


def live(place: Path) -> Iterator[tuple[object, ...]]:
    """Calls of what serves live fleets."""
    yield from (("serve", place / FOLDER, "--principals", place / EVIL), ("demo", place / EVIL, "--step", 0))
    yield "principal", "new", place / "principals", EVIL
    yield "hand-over", place / FOLDER, "--run", EVIL


def federations(ledger: Path, place: Path) -> Iterator[tuple[object, ...]]:
    """Calls that show text of a shard and of its log."""
    yield from (("shards", place / "log", ledger), ("shards", place / EVIL, ledger, ledger / EVIL))
    yield from (("verify", place / "log"), ("info", place / "log"), ("metrics", ledger, "--cluster", EVIL))


def calls(ledger: Path, call: Call, place: Path) -> Iterator[tuple[object, ...]]:
    """A call or two of every verb that show text of the ledger, or of their own arguments."""
    run, action = first_of(ledger, call, "run_id"), first_of(ledger, call, "action_id")
    out, key, proof = place / FOLDER, place / "evil\x1b[2J.key", place / "proof\x1b]0;x\x07.tlog-proof"
    yield from (
        ("info", ledger),
        ("verify", ledger, "--replay", "--workers", 1),
        ("explain", ledger, "--run", run, "--request", action),
    )
    yield from (("log", ledger), ("log", ledger, "--json"), ("log", ledger, "--about", EVIL, "--from", EVIL))
    yield from (("compare", ledger), ("compare", ledger, "--first", EVIL), ("compare", ledger, ledger))
    yield from (("metrics", ledger), ("statistics", ledger), ("audit", ledger), ("query", "failures", ledger))
    yield from (("import", out, place / EVIL[:9].replace("/", ""), "--as", EVIL), ("record", out, "--observes", EVIL))
    yield from (("federate", out, EVIL), ("federate", out, "day", "--fleet", EVIL))
    yield from (*live(place), *federations(ledger, place))
    yield (
        "sql",
        ledger,
        f"SELECT run_id, robot, path, 'e' || robot AS \"{EVIL}\" FROM events WHERE robot IS NOT NULL LIMIT 3",
    )
    yield "sql", ledger, "SELECT CAST(run_id AS INTEGER) FROM events"
    yield from (
        ("export", ledger, "--out", out / "events.csv"),
        *(("export", ledger, "--as", name, "--out", out / f"{name}.json") for name in ("ocel", "otlp", "perfetto")),
        ("export", ledger, "--as", EVIL, "--run", EVIL, "--out", out / "evil.json"),
        ("open", ledger, "--out", out / "events.duckdb"),
        ("prove", ledger, f"{run}:1", "--out", proof),
        ("verify-proof", proof),
        ("prove", ledger, EVIL),
    )
    yield from (
        ("maintain", "upgrade", ledger, "--into", out / "second\x1b[2J"),
        ("maintain", "upgrade", ledger, "--into", ledger / EVIL),
        ("maintain", "compact", out / "second\x1b[2J"),
        ("maintain", "compact", ledger),
    )
    yield from (
        ("view", ledger, "--run", run, "--out", out / "page.html", "--perfetto", out / "trace.json"),
        ("view", ledger, "--run", EVIL, "--out", out / "page.html"),
    )
    yield from calls_of_replays(ledger, run)
    yield from (
        ("key", "new", key, "--name", EVIL),
        ("key", "new", key, "--name", "x/\u05d0"),
        ("maintain", "recover", ledger, "--workers", 1),
    )
    yield from calls_of_witnesses(ledger, place)
    yield from (
        ("simulate", ledger, "--runs", 1),
        ("simulate", out, "--scenario", EVIL),
        ("simulate", out, "--origin", EVIL),
        ("reproduce", "--out", ledger),
        ("report", ledger, "--out", ledger / "x.pdf"),
        ("key", "public", EVIL, "--name", EVIL),
        (EVIL,),
        (f"--{EVIL}",),
    )
    yield from calls_of_studies(ledger, out)


def calls_of_studies(ledger: Path, out: Path) -> Iterator[tuple[object, ...]]:
    """Studies of names and numbers that they do not know, and what there is no result of."""
    yield from (
        *(
            ("study", "run", name, "--out", out, "--workers", EVIL)
            for name in ("ranking", "calibration", "ensemble", "placebo", "systems")
        ),
        ("study", "run", "predictions", "--out", out, "--workers", EVIL),
        ("study", "run", "comparison", EVIL, "--out", out),
        ("study", "run", "sensitivity", "--out", out, "--workers", EVIL),
        ("study", "show", EVIL),
        ("study", "show", "sensitivity", EVIL),
        ("study", "run", "multiverse", ledger, "--metric", "human_intervention"),
        ("study", "run", "multiverse", ledger, "--metric", EVIL),
    )


def calls_of_replays(ledger: Path, run: str) -> Iterator[tuple[object, ...]]:
    """Moments, differences and forks of a run, and names that they do not know."""
    yield from (
        ("state", ledger, "--run", run),
        ("state", ledger, "--run", run, "--at", EVIL),
        ("state", ledger, "--run", run, "--as-known-by", EVIL),
        ("step", ledger, "--run", run, "--script", "next; state; record; last"),
        ("step", ledger, "--run", run, "--script", EVIL),
        ("why", ledger, f"{run}:1"),
        ("why", ledger, EVIL),
        ("diff", ledger, run, run),
        ("diff", ledger, run, EVIL),
    )
    yield from (
        ("whatif", ledger, "--run", run, "--change", "drop window:*"),
        ("whatif", ledger, "--all-runs", "--change", EVIL),
        ("cause", ledger, "--run", run, "--outcome", EVIL),
        ("cause", ledger, "--run", run, "--outcome", "policy_violations > 0"),
        ("bisect", ledger, "--first", EVIL, "--second", "fsar", "--outcome", "policy_violations > 0"),
    )


def calls_of_witnesses(ledger: Path, place: Path) -> Iterator[tuple[object, ...]]:
    """Witnesses and policies that are named with hostile text."""
    policy, state = place / "policy\x1b[2J", place / "witness\x1b[2J"
    yield from (
        ("witness", "new", state, "--name", "x/\u05d0"),
        ("witness", "new", state, "--name", EVIL),
        ("witness", "new", state, "--name", ORIGIN),
    )
    yield "witness", "serve", state, "--log", EVIL
    cosigner = Cosigner(ORIGIN, bytes(32)).key
    policy.write_text(
        f"log {Signer(ORIGIN, bytes(32)).verifier}\nwitness {ORIGIN} {cosigner} "
        f"http://127.0.0.1:9/\u202e\nquorum {ORIGIN}\n"
    )
    yield from (
        ("verify", ledger, "--witness-policy", policy),
        ("witness", "ask", ledger, "--policy", policy),
        ("witness", "ask", ledger, "--policy", state / "none"),
    )


def more_calls(ledger: Path, call: Call, place: Path) -> Iterator[tuple[object, ...]]:
    """Other forms and other mistakes."""
    run, action = first_of(ledger, call, "run_id"), first_of(ledger, call, "action_id")
    out, proof, question = place / FOLDER, place / "proof\x1b]0;x\x07.tlog-proof", place / "question\n.sql"
    question.write_text(f'SELECT run_id AS "{EVIL}" FROM events LIMIT 1')
    for form in ("--json", "--csv"):
        yield from (("query", name, ledger, form) for name in ("runs", "failures", "audit/invariants"))
        yield from (("metrics", ledger, "--by", "scenario", form), ("statistics", ledger, form))
        yield (
            "sql",
            ledger,
            f"SELECT run_id, robot, path, 'e' || robot AS \"{EVIL}\" FROM events WHERE robot IS NOT NULL LIMIT 3",
            form,
        )
    yield from ((verb, ledger, "--json") for verb in ("info", "verify", "explain", "audit"))
    yield "maintain", "recover", ledger, "--json"
    yield from (
        ("verify-proof", proof, "--json"),
        ("explain", ledger, "--run", run, "--request", action, "--json"),
        ("explain", ledger),
    )
    yield from (
        ("metrics", out / "nowhere"),
        ("metrics", ledger, "--by", EVIL),
        ("audit", ledger, "--invariant", EVIL),
        ("verify", ledger, "--quick"),
    )
    yield from (
        ("verify", ledger, "--trusted-key", EVIL),
        ("verify", ledger, "--anchor", out),
        ("explain", ledger, "--run", EVIL),
    )
    yield from (("explain", ledger, "--run", run, "--request", EVIL), ("explain", ledger, "--failure", EVIL))
    yield "explain", ledger, "--run", run, "--failure", action, "--svg", out / "timeline.svg"
    yield from (
        ("query", EVIL, ledger),
        ("query", "runs", ledger, "--param", EVIL),
        ("query", "--file", question, ledger),
        ("query", "--list"),
    )
    yield "query", "audit/requests", ledger, "--param", f"run={EVIL}", "--param", "action=all"
    yield from (
        ("sql", ledger, f"SELECT {EVIL}"),
        ("export", ledger, "--out", out / EVIL[:40].replace("/", "")),
        ("open", ledger, "--out", out / EVIL[:40].replace("/", "")),
        ("verify-proof", out / "none"),
    )
    yield from (
        ("verify-proof", question),
        ("prove", ledger, f"{run}:99999"),
        ("key", EVIL),
        ("simulate", out, "--runs", EVIL),
    )
    yield from (
        ("reproduce", "--key", out / "no.key"),
        ("report", out / "nowhere", "--out", out / "x.pdf"),
        ("report", ledger, "--out", out),
    )
    yield "maintain", "recover", ledger, "--into", out / "copy", "--json", "--workers", 1


def drive(all_calls: Iterator[tuple[object, ...]], call: Call) -> tuple[set[str], set[int]]:
    """Make all calls; return the verbs called and the exit codes. Fails if any call paints the screen."""
    seen, codes = set[str](), set[int]()
    for arguments in all_calls:
        called = call(*arguments)
        assert (painted(called.out), painted(called.err)) == ([], []), arguments
        assert "Traceback" not in called.err
        words = [" ".join(map(str, arguments[:count])) for count in (1, 2, 3)]
        seen.update(name for name in words if name in COMMANDS)
        codes.add(called.code)
    return seen, codes


@pytest.mark.slow
def test_tables_and_mistakes_paint_nothing(ledger: Path, call: Call) -> None:
    """A few of the calls below."""
    named = f'SELECT run_id, robot AS "{EVIL}" FROM events WHERE robot IS NOT NULL LIMIT 3'
    few = (("info", ledger), ("query", "failures", ledger), ("sql", ledger, named), (EVIL,))
    assert drive(iter(few), call)[1] == {0, 2}


@pytest.mark.slow
def test_no_verb_paints_the_screen(ledger: Path, call: Call, tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir()
    (ledger / "staging" / "left\x1b[2J\u202e").write_bytes(b"x")
    seen, codes = drive(calls(ledger, call, tmp_path), call)
    assert seen >= COMMANDS.keys()
    assert codes == {0, 1, 2, 3}


@pytest.mark.slow
def test_no_other_form_or_mistake_paints_the_screen(ledger: Path, call: Call, tmp_path: Path) -> None:
    (tmp_path / FOLDER).mkdir()
    call("prove", ledger, 1, "--out", tmp_path / "proof\x1b]0;x\x07.tlog-proof")
    drive(more_calls(ledger, call, tmp_path), call)


def test_a_damaged_ledger_does_not_paint_either(ledger: Path, call: Call, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(ledger, tmp_path / FOLDER))
    (copy / "segments" / "evil\x1b[2J\x1b[H\n\u202e").write_bytes(b"x")
    segment = next((copy / "segments").iterdir())
    segment.write_bytes(segment.read_bytes()[:-100] + EVIL.encode())
    for arguments in (
        ("verify", copy),
        ("verify", copy, "--json"),
        ("maintain", "recover", copy),
        ("maintain", "recover", copy, "--json"),
        ("metrics", copy),
        ("sql", copy, "SELECT 1"),
    ):
        called = call(*arguments)
        assert (called.code, painted(called.out), painted(called.err)) == (called.code, [], []), arguments
        assert called.code


@pytest.mark.slow
def test_on_a_narrow_terminal_no_line_begins_with_a_claim(ledger: Path) -> None:
    here, there = pty.openpty()
    command = [sys.executable, "-m", "fsar_ledger", "explain", str(ledger)]
    stream = b""
    with subprocess.Popen(command, stdout=there, stderr=there) as child:
        os.close(there)
        with suppress(OSError):  # all is read
            while data := os.read(here, 1 << 16):
                stream += data
    os.close(here)
    assert child.returncode == 0
    screen = screen_of(stream.decode().replace("\r\n", "\n"), columns=80)
    lines = [line.rstrip() for line in screen.display]
    assert len([line for line in lines if line.startswith(("  | ", "| "))]) > 10
    assert [line for line in lines if CLAIM[:20] in line[:20]] == []


def test_json_holds_the_values_themselves(ledger: Path, call: Call) -> None:
    assert all(row["run_id"].endswith(EVIL) for row in json.loads(call("query", "runs", ledger, "--json").out)["rows"])
    assert POISON.startswith(EVIL[:10])
