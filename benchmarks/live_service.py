"""Measure the service of a live federation under clients that give commands as fast as they are answered.

    python benchmarks/live_service.py [--seconds 3] [--rounds 5] [--clients 1,10,100]

Beside it, in turn in the same rounds: the same server and route that only echo, and the same server and handlers whose
events go to SQLite (WAL, synchronous=FULL) in place of a ledger. Servers are processes of their own; their clients are
one process more on the same machine. Each figure is the median of the rounds.
"""

import argparse
import asyncio
import json
import multiprocessing
import os
import socket
import sqlite3
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from starlette.routing import Route

import fsar_ledger
from benchmarks.table import note
from fsar_ledger.ledger.store.staging import rows_of
from fsar_ledger.service import Principals, add_principal
from fsar_ledger.service.server import Service

BODY = b'{"robot":"robot/A1"}'
KINDS = ("echo", "sqlite", "ledger")


class Sqlite:
    """A writer that puts rows into a table of SQLite, each commit in a transaction that is on disk."""

    def __init__(self, path: Path) -> None:
        self._path, self._rows = path, b""
        self._connection: sqlite3.Connection | None = None

    def commit(self, runs: Any) -> None:
        if self._connection is None:  # in the thread that decides
            self._connection = sqlite3.connect(self._path)
            self._connection.executescript(
                "PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; CREATE TABLE events (row BLOB)"
            )
        self._rows, _ = rows_of(runs)
        with self._connection:
            self._connection.executemany("INSERT INTO events VALUES (?)", [(row,) for row in self._rows.splitlines()])

    def newest_rows(self) -> bytes:
        return self._rows

    def close(self) -> None:
        pass

    @property
    def head(self) -> Any:
        return None


def serve(kind: str, folder: Path, listening: socket.socket, ready: Any) -> None:
    """Serve until the process is told to end."""

    def opened(on_commit: Callable[[int, bytes], None]) -> Any:
        found = fsar_ledger.federate(folder / "ledger", run="day", on_commit=on_commit)
        if kind == "sqlite":
            found._writer = Sqlite(folder / "rows.sqlite")  # type: ignore[assignment]
            found._keep = lambda: None  # type: ignore[method-assign]
        return found

    service = Service(folder / "ledger", "day", opened, Principals(folder / "principals"), 1e9, str)
    if kind == "echo":

        async def echo(request: Any) -> Any:
            one = service._principal(request)
            return service._answer(
                {"seq": 1, "rejected": None, "events": [], "by": one.principal, "said": len(await request.body())}
            )

        service.app.router.routes[0] = Route("/commands/{name}", echo, methods=["POST"])
    ready.set()
    service.serve(listening)


async def _client(port: int, request: bytes, until: float, waits: list[float]) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    while (began := time.perf_counter()) < until:
        writer.write(request)
        head = await reader.readuntil(b"\r\n\r\n")
        length = int(head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0])
        await reader.readexactly(length)
        assert head.startswith(b"HTTP/1.1 200"), head
        waits.append(time.perf_counter() - began)
    writer.close()


async def _load(port: int, token: str, clients: int, seconds: float) -> list[float]:
    lines = ("POST /commands/ReportContext HTTP/1.1", "Host: x", f"Authorization: Bearer {token}",
             f"Content-Length: {len(BODY)}", "", "")  # fmt: skip
    request = "\r\n".join(lines).encode() + BODY
    waits: list[float] = []
    until = time.perf_counter() + seconds
    await asyncio.gather(*(_client(port, request, until, waits) for _ in range(clients)))
    return waits


class Figures(NamedTuple):
    """Commands a second, percentiles of the time to an answer (ms), and CPU of the server a command (ms)."""

    rate: float
    p50: float
    p99: float
    p999: float
    cpu: float


def measured(kind: str, clients: int, seconds: float) -> Figures:
    """Run a server of this kind under so many clients."""
    with tempfile.TemporaryDirectory() as name, socket.create_server(("127.0.0.1", 0), backlog=1024) as listening:
        folder, context = Path(name), multiprocessing.get_context("fork")
        token = add_principal(folder / "principals", "robot/A1")
        ready = context.Event()
        process = context.Process(target=serve, args=(kind, folder, listening, ready))
        process.start()
        ready.wait()
        port = listening.getsockname()[1]
        asyncio.run(_load(port, token, clients, 0.3))
        before = _cpu(process.pid or 0)
        waits = sorted(asyncio.run(_load(port, token, clients, seconds)))
        cpu = _cpu(process.pid or 0) - before
        process.terminate()
        process.join()
    p50, p99, p999 = (waits[min(len(waits) - 1, int(len(waits) * share))] * 1e3 for share in (0.5, 0.99, 0.999))
    return Figures(len(waits) / seconds, p50, p99, p999, cpu / len(waits) * 1e3)


def _cpu(process: int) -> float:
    """Return how much CPU the process has used. Units: seconds."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Print a line for each number of clients and kind of server."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=3)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--clients", default="1,10,100")
    given = parser.parse_args()
    print(f"{'clients':>7} {'server':8} {'commands/s':>10} {'p50 ms':>8} {'p99 ms':>8} {'p99.9 ms':>8} {'CPU ms':>7}")
    for clients in map(int, given.clients.split(",")):
        rounds = [{kind: measured(kind, clients, given.seconds) for kind in KINDS} for _ in range(given.rounds)]
        medians = {
            kind: Figures(*(statistics.median(values) for values in zip(*(one[kind] for one in rounds), strict=True)))
            for kind in KINDS
        }
        for kind, found in medians.items():
            figures = " ".join(f"{value:>{width}.2f}" for value, width in zip(found[1:], (8, 8, 8, 7), strict=True))
            print(f"{clients:>7} {kind:8} {found.rate:>10.0f} {figures}", flush=True)
        ledger, sqlite, echo = medians["ledger"], medians["sqlite"], medians["echo"]
        note(
            f"serve, {clients} clients",
            f"{ledger.rate:.0f} commands/s, {ledger.cpu:.2f} ms CPU each",
            f"SQLite WAL FULL {sqlite.rate:.0f}/s, {sqlite.cpu:.2f} ms; echo {echo.rate:.0f}/s, {echo.cpu:.2f} ms",
            "at most 0.30 ms CPU" if clients == 100 else "-",
        )
    print(json.dumps({"load": os.getloadavg()[0]}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
