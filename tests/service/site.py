"""A service in this process, and ways to it."""

import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("uvicorn", reason="make test-all installs it")

import fsar_ledger
from fsar_ledger.events.command import CommandGiven
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.service import Principals, add_principal, server
from fsar_ledger.service.client import Client, FollowedEvent

NAMES = ("robot/A1", "robot/B1", "robot/C1", "supervisor/A1", "supervisor/fleet", "service/hub", "auditor/anna")
TASK: dict[str, Any] = {"robot": "robot/A1", "steps": ["A door.open.secure B"], "budget_us": 600_000_000}


class Site:
    """A service in a thread of this process, and the ways of five principals to it."""

    def __init__(self, folder: Path, rate: float = 10_000, certificate: Path | None = None) -> None:
        self.ledger = folder / "ledger"
        self.tokens = {name: add_principal(folder / "principals", name) for name in NAMES}
        self._certificate = certificate
        self.service = server.Service(
            self.ledger, "day", self.opened, Principals(folder / "principals"), rate, self.viewed
        )
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.port = self.listening.getsockname()[1]
        self.thread = threading.Thread(target=self.service.serve, args=(self.listening, certificate))

    def opened(self, on_commit: Callable[[int, bytes], None]) -> Any:
        return fsar_ledger.federate(self.ledger, run="day", on_commit=on_commit)

    def viewed(self) -> str:
        page = self.ledger.with_name("page.html")
        fsar_ledger.Ledger(self.ledger).view(page, run="day")
        return page.read_text()

    def __enter__(self) -> "Site":
        self.thread.start()
        context = ssl.create_default_context(cafile=self._certificate) if self._certificate else None
        scheme = "https" if self._certificate else "http"
        self.ways = {
            name: Client(f"{scheme}://localhost:{self.port}", token, patience_s=4, tls=context)
            for name, token in self.tokens.items()
        }
        return self

    def __exit__(self, *_: object) -> None:
        for way in self.ways.values():
            way.close()
        self.service.stop()
        self.thread.join(20)
        self.listening.close()
        assert not self.thread.is_alive()

    def raw(self, data: bytes, wait_s: float = 5) -> bytes:
        """Send these bytes, and return what comes until the server ends the line or this long."""
        with socket.create_connection(("127.0.0.1", self.port)) as line:
            line.settimeout(wait_s)
            line.sendall(data)
            found = b""
            try:
                while part := line.recv(1 << 16):
                    found += part
            except (TimeoutError, ConnectionResetError):
                pass
            return found

    def asked(self, method: str, path: str, body: bytes = b"", token: str | None = "robot/A1", *headers: str) -> bytes:
        """Send a request with this token, and return the answer with its status line."""
        lines = [f"{method} {path} HTTP/1.1", "Host: x", f"Content-Length: {len(body)}", "Connection: close", *headers]
        if token is not None:
            lines.append(f"Authorization: Bearer {self.tokens.get(token, token)}")
        return self.raw("\r\n".join((*lines, "", "")).encode() + body)

    @property
    def record(self) -> LedgerRun:
        [record] = open_ledger(self.ledger).runs()
        return record

    def commands(self) -> list[CommandGiven]:
        return [event for event in self.record.events if isinstance(event, CommandGiven)]


def is_good(ledger: Path) -> bool:
    return fsar_ledger.Ledger(ledger).verify(replay=True).ok


def take_back(site: Site, name: str) -> None:
    """Remove the line of the token of this principal."""
    file = site.ledger.with_name("principals")
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(line for line in lines if name.encode() not in line))


def until(holds: Callable[[], object], seconds: float = 10) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.02)


def read(events: Iterator[FollowedEvent], count: int) -> list[FollowedEvent]:
    return [next(events) for _ in range(count)]
