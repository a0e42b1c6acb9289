"""Witnesses as separate processes: honest ones, started by the command line, and a liar.

`python -m tests.witness.processes` starts the liar. It tells the lie that its URL ends in: `/forgets` cosigns whatever
it is sent and publishes that; `/stale` publishes the first that it was sent, with the time of then; `/future` is an
hour ahead; `/other-key` cosigns with a key of its own; `/other-root` publishes a tree that nobody signed; `/other-log`
a note of another log; `/garbage` no note; `/silent` never answers; `/drips` answers a byte at a time.
"""

import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.ledger.log.note import Checkpoint, Note
from fsar_ledger.witness import Cosigner, parse_request

LIAR = Cosigner("example.org/liar", bytes([7] * 32))
STRANGER = Cosigner("example.org/liar", bytes([8] * 32))


class Running(NamedTuple):
    """A process that serves a witness."""

    process: subprocess.Popen[str]
    key: str
    url: str

    def line(self, name: str, lie: str = "") -> str:
        """Return its line in a policy."""
        return f"witness {name} {self.key} {self.url}{lie}\n"


@contextmanager
def running(*command: object) -> Iterator[Running]:
    """Run this module or program as a serving process until the block ends."""
    process = subprocess.Popen(
        [sys.executable, "-m", *map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        key, url = (process.stdout.readline().strip() for _ in range(2))
        yield Running(process, key, url)
    finally:
        process.kill()
        process.communicate()


@contextmanager
def honest(state: Path, logs: Sequence[object], *options: object) -> Iterator[Running]:
    """Run the witness in this folder."""
    with running(
        "fsar_ledger", "witness", "serve", state, *(part for log in logs for part in ("--log", log)), *options
    ) as found:
        yield found


class _Liar(BaseHTTPRequestHandler):
    shown: list[Note] = []  # noqa: RUF012

    def do_POST(self) -> None:
        note = parse_request(self.rfile.read(int(self.headers["Content-Length"]))).note
        self.shown.append(note)
        lie = self.path.split("/")[1]
        self._say(self._cosigned(lie, note).signatures[-1].line(), lie)

    def do_GET(self) -> None:
        lie = self.path.split("/")[1]
        if not self.shown:
            self.send_error(404)
            return
        self._say(
            "nonsense" if lie == "garbage" else str(self._cosigned(lie, self.shown[0 if lie == "stale" else -1])), lie
        )

    def _cosigned(self, lie: str, note: Note) -> Note:
        now_s = int(time.time()) + {"future": 3600, "stale": -3600}.get(lie, 0)
        checkpoint = note.checkpoint
        if lie == "other-root":
            checkpoint = Checkpoint(checkpoint.origin, checkpoint.size, bytes(32))
        if lie == "other-log":
            checkpoint = Checkpoint("example.org/another", checkpoint.size, checkpoint.root)
        signature = (STRANGER if lie == "other-key" else LIAR).cosign(checkpoint, now_s)
        if lie == "other-key":  # signed with another key, under the name and id of the right one
            signature = type(signature)(LIAR.key.name, LIAR.key.key_id, signature.data)
        return Note(checkpoint, (*note.signatures, signature))

    def _say(self, text: str, lie: str) -> None:
        if lie == "silent":
            time.sleep(60)
        self.send_response(200)
        self.send_header("Content-Length", str(len(text.encode())))
        self.end_headers()
        for byte in text.encode() if lie == "drips" else ():
            self.wfile.write(bytes([byte]))
            time.sleep(0.2)
        if lie != "drips":
            self.wfile.write(text.encode())

    def log_message(self, format: str, *args: object) -> None:
        pass


@contextmanager
def lying() -> Iterator[Running]:
    """Run the lying witness."""
    with running("tests.witness.processes") as found:
        yield found


if __name__ == "__main__":
    with ThreadingHTTPServer(("127.0.0.1", 0), _Liar) as server:
        print(LIAR.key, f"http://127.0.0.1:{server.server_address[1]}", sep="\n", flush=True)
        server.serve_forever()
