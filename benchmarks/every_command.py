"""Measures what each command costs on one ledger: wall time, CPU seconds and peak memory, each in its own process.

python benchmarks/every_command.py                          10 million events; the ledger is simulated once and kept
python benchmarks/every_command.py --events 200000          a small one
python benchmarks/every_command.py --ledger out/ledger      a ledger of yours, which is only read
python benchmarks/every_command.py --only audit --only log  some commands

Commands run one after the other, with the memory that they may have by default, or with what stands beside them, if
they need more. Each begins without the cache of what is known of runs; one that fills it is asked again. An exit code
of 0 or 1 is an answer; any other one is shown. Peak memory is that of the largest process of a command.
"""

import argparse
import os
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Collection
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.table import note
from fsar_ledger import api
from fsar_ledger.api.verbs import VERBS, Verb

for module in iter_modules(api.__path__):
    import_module(f"{api.__name__}.{module.name}")

EVENTS_A_RUN = 547
ONE_SEED = "42"
MODULE = [sys.executable, "-m", "fsar_ledger"]
ANSWERS = (0, 1)

LEFT_OUT = {
    "simulate": "it makes the ledger",
    "record": "it makes the ledger",
    "import": "it makes the ledger",
    "federate": "it makes the ledger",
    "serve": "it makes the ledger",
    "principal": "it takes no ledger",
    "demo": "it makes the ledger",
    "shards": "it makes the ledger",
    "hand-over": "it takes the ledger of a robot alone",
    "maintain upgrade": "it takes a ledger of format 1",
    "verify-proof": "it reads a proof, not a ledger",
    "reproduce": "it takes no ledger",
    "key": "it takes no ledger",
    "witness": "it asks other machines",
}
"""The commands that are not measured, and why."""


def example_of(verb: Verb) -> list[str]:
    """Return the words of the first example of a verb, after its name."""
    return shlex.split(verb.examples[0], comments=True)[1 + len(verb.name.split()) :]


def from_examples(others: Collection[str]) -> dict[str, str]:
    """Return the first example of each verb that reads a ledger, written like `COMMANDS`.

    It leaves out the verbs of `others` and of `maintain`. The first path of an example is taken for the ledger, every
    other path for a file that the verb writes.
    """
    covered = {"maintain", *(name.split()[0] for name in others)}
    found = {}
    for name, verb in VERBS.items():
        if name.split()[0] in covered or "ledger" not in verb.parameters:
            continue
        words = example_of(verb)
        ledger = next((word for word in words if word.startswith("out/")), None)
        given = (f"{{out}}{Path(word).suffix}" if word.startswith("out/") else word.replace(" ", "|") for word in words)
        found[name] = " ".join("{ledger}" if word == ledger else one for word, one in zip(words, given, strict=True))
    return found


COMMANDS: dict[str, str] = {
    "info": "{ledger}",
    "verify": "{ledger}",
    "verify --quick": "{ledger}",
    "maintain recover": "{copy}",
    "metrics": "{ledger}",
    "audit": "{ledger}",
    "statistics": "{ledger}",
    "compare": "{ledger} --first fsar --second cfc",
    "study run": "multiverse {ledger} --memory 10240",
    "query": "metrics/run_metrics {ledger} --limit 20",
    "query failures": "{ledger} --limit 20",
    "query coordination_cost": "{ledger}",
    "sql": "{ledger} SELECT|type,|count(*)|AS|rows|FROM|events|GROUP|BY|type|ORDER|BY|rows",
    "explain": "{ledger}",
    "explain --run": "1 {ledger}",
    "log": "{ledger}",
    "log --run": "1 {ledger} --to 30s",
    "state": "{ledger} --run 1 --at 46.6s",
    "step": "{ledger} --run 1 --script next",
    "why": "{ledger} 1:148",
    "diff": "{ledger} 1 2",
    "view": "{ledger} --run 1 --out {out}.html",
    "whatif": "{ledger} --run 1 --change drop|window:*",
    "cause": "{ledger} --run 1 --outcome policy_violations|>|0 --futures 0",
    "bisect": "{ledger} --first fsar --second cfc --outcome policy_violations|>|0",
    "prove": "{ledger} 1:12 --out {out}.tlog-proof",
    "export": "{ledger} --out {out}.parquet",
    "export --tiles": "{ledger} --out {out}",
    "export --as": "otlp {ledger} --out {out}.json",
    "open": "{ledger} --out {out}.duckdb",
    "report": "{ledger} --out {out}.pdf",
    "maintain compact": "{copy}",
}
COMMANDS |= from_examples(COMMANDS.keys() | LEFT_OUT.keys())
"""The commands by name with first option, and what follows; a space within an argument is written as |.

A verb that is not listed is called as in its first example.
"""


KNOWN = "fsar-ledger/slices.sqlite"
"""What is known of the runs of large ledgers, in the folder of caches."""


class Cost(NamedTuple):
    """What a process cost: wall and CPU seconds, peak memory in MiB, and its exit code."""

    wall_s: float
    cpu_s: float
    memory_mib: float
    code: int


def cost_of(command: list[str], errors: Path, caches: Path | None = None) -> Cost:
    """Run a command to its end, without its output, with this folder of caches."""
    environment = {**os.environ} if caches is None else {**os.environ, "XDG_CACHE_HOME": str(caches)}
    began = time.perf_counter()
    to = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    actions = [(os.POSIX_SPAWN_OPEN, 1, os.devnull, to, 0o600), (os.POSIX_SPAWN_OPEN, 2, str(errors), to, 0o600)]
    process = os.posix_spawn(command[0], command, environment, file_actions=actions)
    _, status, used = os.wait4(process, 0)
    seconds = time.perf_counter() - began
    kib = used.ru_maxrss if sys.platform != "darwin" else used.ru_maxrss / 1024
    return Cost(seconds, used.ru_utime + used.ru_stime, kib / 1024, os.waitstatus_to_exitcode(status))


def arguments(name: str, ledger: Path, folder: Path) -> list[str]:
    """Return the whole command line, and copy the ledger for a command that changes it."""
    places = {"ledger": ledger, "copy": folder / "copy", "out": folder / "out"}
    words = [word.format(**places).replace("|", " ") for word in COMMANDS[name].split()]
    if "{copy}" in COMMANDS[name]:
        shutil.copytree(ledger, folder / "copy", dirs_exist_ok=True)
    return [*MODULE, *name.split(), *words]


def ledger_of(events: int, cache: Path) -> Path:
    """Return a ledger of about so many events; it is simulated once and kept."""
    runs = max(1, round(events / EVENTS_A_RUN / 15))
    ledger = cache / f"every-command-{runs}"
    if not ledger.exists():
        print(f"simulates {runs} runs per scenario and architecture: {ledger}", flush=True)
        made = ["simulate", str(ledger), "--runs", str(runs), "--seed", ONE_SEED]
        cost = cost_of([*MODULE, *made], Path(os.devnull))
        if cost.code:
            raise SystemExit(f"simulate: found exit code {cost.code}, expected 0")
    return ledger


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--events", type=int, default=10_000_000)
    parser.add_argument("--ledger", type=Path, help="instead of one that is made")
    parser.add_argument("--only", action="append", help="a command; may be repeated")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "fsar-ledger-benchmark")
    options = parser.parse_args()
    options.cache.mkdir(parents=True, exist_ok=True)
    ledger = options.ledger or ledger_of(options.events, options.cache)
    heads = f"{'command':26}{'wall s':>9}{'CPU s':>9}{'MiB':>8}{'warm s':>9}{'CPU s':>9}{'MiB':>8}"
    print(f"{heads}   load {os.getloadavg()[0]:.1f}, {os.cpu_count()} cores")
    failed = False
    for name in COMMANDS:
        if options.only and name.split()[0] not in options.only:
            continue
        with tempfile.TemporaryDirectory() as folder:
            errors, caches = Path(folder) / "errors", Path(folder) / "caches"
            caches.mkdir(mode=0o700)
            cost = cost_of(arguments(name, ledger, Path(folder)), errors, caches)
            is_known = (caches / KNOWN).exists() and "{copy}" not in COMMANDS[name]
            warm = shown(cost_of(arguments(name, ledger, Path(folder)), errors, caches)) if is_known else ""
            said = "" if cost.code in ANSWERS else f"   exit code {cost.code}: {errors.read_text()[-200:].strip()}"
        failed |= bool(said)
        if name == "audit":
            found = f"{cost.cpu_s:.1f} CPU s, {cost.memory_mib:.0f} MiB"
            note(f"audit, ten invariants, {ledger.name}", found, "each command on the same ledger", "20 CPU s, 0.6 GB")
        print(f"{name:26}{shown(cost)}{warm}{said}", flush=True)
    return int(failed)


def shown(cost: Cost) -> str:
    return f"{cost.wall_s:>9.1f}{cost.cpu_s:>9.1f}{cost.memory_mib:>8.0f}"


if __name__ == "__main__":
    sys.exit(main())
