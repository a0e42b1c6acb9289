"""Calls of every verb that reads a ledger, in this process."""

import contextlib
import io
import random
import traceback
from pathlib import Path
from typing import NamedTuple

from benchmarks.every_command import LEFT_OUT, from_examples
from fsar_ledger.cli import app
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.metrics.library import library
from tests.queries.keys import required

ANSWERED = {0}
REFUSED = {0, 2}
"""The exit codes of verbs that may have to say why they do not answer, as about runs that nobody can make again."""
FOUND = {0, 1}
"""The exit codes of verbs that judge."""

VERBS: dict[str, tuple[set[int], tuple[str, ...]]] = {
    "info": (ANSWERED, ("{ledger}",)),
    "metrics": (ANSWERED, ("{ledger}", "{ledger} --by scenario --json")),
    "statistics": (ANSWERED, ("{ledger}",)),
    "compare": (REFUSED, ("{ledger}", "{ledger} --first open-rmf --second fsar")),
    "query": (ANSWERED, ()),  # every packaged query, below
    "sql": (ANSWERED, ("{ledger} SELECT|type,|count(*)|AS|n|FROM|events|GROUP|BY|type",)),
    "export": (
        ANSWERED,
        (
            *(f"{{ledger}} --out {{out}}.{suffix}" for suffix in ("parquet", "csv", "ndjson")),
            *(f"{{ledger}} --as {format} --out {{out}}.json" for format in ("ocel", "otlp")),
            "{ledger} --as perfetto --run {run} --out {out}.json",
        ),
    ),
    "explain": (ANSWERED, ("{ledger} --run {run}", "{ledger} --run {run} --request {action}")),
    "log": (ANSWERED, ("{ledger}", "{ledger} --run {run} --json")),
    "state": (
        ANSWERED,
        (
            "{ledger} --run {run}",
            "{ledger} --run {run} --at {time} --json",
            "{ledger} --run {run} --at {time} --as-known-by coordinator",
            "{ledger} --run {run} --as-known-by service/registry",
        ),
    ),
    "step": (
        ANSWERED,
        (
            "{ledger} --run {run} --script state;next;record;next-decision;next-refusal;cause;state",
            "{ledger} --run {run} --script go|{time};state;previous;last;state;find|door",
        ),
    ),
    "why": (REFUSED, ("{ledger} {run}:{seq}", "{ledger} --run {run} --verdict late-task")),
    "diff": (REFUSED, ("{ledger} {run} {other}",)),
    "view": (ANSWERED, ("{ledger} --run {run} --with {other} --out {out}.html", "{ledger} --perfetto {out}.json")),
    "whatif": (REFUSED, ("{ledger} --run {run} --change drop|window:*",)),
    "cause": (REFUSED, ("{ledger} --run {run} --outcome policy_violations|>|0 --futures 0",)),
    "bisect": (REFUSED, ("{ledger} --first open-rmf --second fsar --outcome policy_violations|>|0",)),
    "audit": (FOUND, ("{ledger}", "{ledger} --json")),
    "verify": (ANSWERED, ("{ledger}", "{ledger} --quick")),
    "prove": (ANSWERED, ("{ledger} {run}:{seq} --out {out}.tlog-proof",)),
    "maintain recover": (ANSWERED, ("{ledger}",)),
    "open": (ANSWERED, ("{ledger} --out {out}.duckdb",)),
    "study": (ANSWERED, ("run multiverse {ledger}",)),
    "report": (REFUSED, ("{ledger} --out {out}.pdf",)),
    "maintain compact": (REFUSED, ("{ledger}",)),
}
VERBS |= {name: (REFUSED, (call,)) for name, call in from_examples(VERBS.keys() | LEFT_OUT.keys()).items()}
"""Each verb, its exit codes on a sound ledger, and its calls; a space within a word is written as |.

A verb that is not listed is called as in its first example.
"""

QUERIES = 12
"""Packaged queries that are asked of each ledger, drawn anew for each."""

SLOW = ("open", "study", "report", "view", "compare", "bisect", "statistics")
"""Verbs that take seconds."""


class Asked(NamedTuple):
    """A call, its exit code, what it printed, and the traceback where it did not end as calls do."""

    words: tuple[str, ...]
    code: int
    out: str
    err: str
    trace: str | None = None

    def good(self) -> "Asked":
        """The same, which ended without a failure."""
        assert self.code == 0, self.trace or self.err
        return self


def ask(*words: object) -> Asked:
    """Call the command in this process."""
    called = tuple(map(str, words))
    printed, warned = io.BytesIO(), io.BytesIO()
    out, err = (io.TextIOWrapper(stream, "utf-8", write_through=True) for stream in (printed, warned))
    code, trace = -1, None
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = app.run(called)
        except Exception:
            trace = traceback.format_exc()
    return Asked(called, code, printed.getvalue().decode(), warned.getvalue().decode(), trace)


def calls(verb: str, ledger: Path, runs: list[LedgerRun], out: Path, draw: random.Random) -> list[tuple[str, ...]]:
    """Return the calls of a verb about this ledger: about one of its runs, a time, an event and an action there."""
    if verb == "query":
        return [
            (
                verb,
                name,
                str(ledger),
                *(word for item in required(query).items() for word in ("--param", "=".join(item))),
            )
            for name, query in draw.sample([*library().queries.items()], QUERIES)
        ]
    place = draw.randrange(len(runs))
    run = runs[place]
    actions = [action for event in run.events if (action := flat(event).get("action_id")) is not None]
    out.mkdir(exist_ok=True)
    about = {
        "ledger": ledger,
        "out": out / f"{ledger.name}-{draw.randrange(10**9)}",
        "run": place + 1,
        "other": (place + 1) % len(runs) + 1,
        "time": f"{draw.choice(run.times_us) / 1e6}s",
        "seq": draw.randrange(len(run.events)),
        "action": draw.choice(actions) if actions else "",
    }
    listed = [call for call in VERBS[verb][1] if actions or "{action}" not in call]
    return [(*verb.split(), *(word.format(**about).replace("|", " ") for word in call.split())) for call in listed]
