"""The commands of witnesses, and of those who ask them: `witness new`, `witness serve`, `witness ask`, and `verify --witness-policy`."""

import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from fsar_ledger import printable
from fsar_ledger.errors import LedgerCorrupted, NotCosigned, UsageError
from fsar_ledger.printable import Shown

from .options import LedgerArgument, examples
from .terminal import say, show

if TYPE_CHECKING:
    from fsar_ledger.ledger.log.note import VerifierKey
    from fsar_ledger.witness.evidence import Evidence
    from fsar_ledger.witness.policy import Policy
    from fsar_ledger.witness.server import WitnessServer

_LAST_SECOND = 253_402_300_799  # of the year 9999

witnesses = typer.Typer()


@witnesses.callback()
def _witnesses() -> None:
    """Watch that ledgers only grow, and have one's own watched."""


@witnesses.command("new", epilog=examples("fsar-ledger witness new out/witness --name example.org/w1"))
def witness_new(
    state: Annotated[
        Path, typer.Argument(metavar="STATE", help="The folder of the witness: a new one.", show_default=False)
    ],
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Its name, by custom host/path.", show_default=False)
    ],
) -> None:
    """Make a witness; prints its public key.

    STATE holds its secret key and, later, what it has seen. A witness that forgets is worth nothing: never copy STATE, never restore it
    from a backup; make a new witness instead.
    """
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.witness.state import new_state

    from .trust import short

    require_outside(state, f"STATE {state}")
    show(printable.line(str(new_state(state, short("--name", name)))))


@witnesses.command(
    "serve",
    epilog=examples(
        "fsar-ledger witness serve out/witness --log out/fleet.key.pub --port 8001",
        "fsar-ledger witness serve out/witness --log out/fleet.key.pub --log out/arm.key.pub",
    ),
)
def witness_serve(
    context: typer.Context,
    state: Annotated[
        Path, typer.Argument(metavar="STATE", help="What `fsar-ledger witness new` made.", show_default=False)
    ],
    log: Annotated[
        list[str],
        typer.Option(
            "--log",
            metavar="KEY",
            help="Watch this log: its .pub file or public key; may be repeated.",
            show_default=False,
        ),
    ],
    host: Annotated[str, typer.Option("--host", metavar="ADDRESS", help="The address to listen at.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", metavar="N", help="The port to listen at; 0 takes a free one.", min=0, max=65535)
    ] = 0,
) -> None:
    """Cosign checkpoints, over HTTP, until interrupted.

    Speaks C2SP tlog-witness: a checkpoint is cosigned if the log's key signed it and a proof shows that the log only grew since the last
    one. It needs no ledger and sees no event. Prints its public key and URL.
    """
    from fsar_ledger.witness.cosignature import read_log_key
    from fsar_ledger.witness.server import WitnessServer
    from fsar_ledger.witness.service import Service
    from fsar_ledger.witness.state import open_state

    logs = [read_log_key(key) for key in log]
    with (
        open_state(state) as found,
        WitnessServer(host, port, Service(found, logs, _clock(context), _tell), time.monotonic) as server,
    ):
        _serve(server, printable.lines(str(found.cosigner.key), server.url))


def _serve(server: "WitnessServer", greeting: Shown) -> None:
    """The server has served until SIGTERM or Ctrl-C."""

    def end(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, end)
    try:
        show(greeting)
        server.serve_forever(poll_interval=0.1)
    except KeyboardInterrupt:
        _tell("ended")
    finally:
        signal.signal(signal.SIGTERM, before)


def _tell(line: str) -> None:
    """The operator is told, if anybody still reads that."""
    with suppress(OSError):
        say(line)


@witnesses.command(
    "ask",
    epilog=examples(
        "fsar-ledger witness ask out/ledger --policy witnesses.policy",
        "fsar-ledger witness ask out/ledger --policy witnesses.policy --out out/cosigned",
    ),
)
def witness_ask(
    ledger: LedgerArgument,
    policy: Annotated[
        Path,
        typer.Option(
            "--policy", metavar="FILE", help="A C2SP tlog-policy that names the witnesses.", show_default=False
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="Where the cosigned checkpoint goes; replaced.", show_default="print it"
        ),
    ] = None,
) -> None:
    """Have the newest checkpoint of a ledger cosigned.

    Each witness in FILE that has a URL is sent the checkpoint and a proof that the ledger only grew; no event leaves. Exit code 1, and
    nothing written, if fewer cosigned than FILE demands.
    """
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.witness.cosign import cosign
    from fsar_ledger.witness.policy import read_policy

    from .files import write_text

    read = read_policy(policy)
    if out is not None:
        require_outside(out, f"--out {out}")
    found = cosign(ledger, read)
    refusals = [f"{name}: {reason}" for name, reason in found.silent.items()]
    if not read.is_met(set(found.times)):
        cosigned = _listed(found.times) or "no cosignature"
        raise NotCosigned(
            f"{policy}: found {cosigned} ({'; '.join(refusals)}), expected {read.rule()}; nothing was written, try again or look into it"
        )
    say(*refusals)
    if out is None:
        show(Shown(str(found.note)), raw=True)
        return
    write_text(out, str(found.note))
    tree = found.note.checkpoint
    show(printable.lines(f"{out}: {tree.size:,} events, cosigned by {_listed(found.times)}", f"root {tree.root.hex()}"))


class Seen(NamedTuple):
    """What the witnesses of a policy saw of a ledger; one of the keys must have signed what they cosigned."""

    policy: "Policy"
    logs: tuple["VerifierKey", ...]
    evidence: "Evidence"

    @property
    def log(self) -> "VerifierKey | None":
        """The key that must have signed the ledger, where there is no choice."""
        return self.logs[0] if len(self.logs) == 1 else None

    @property
    def is_enough(self) -> bool:
        """Whether enough of them saw anything."""
        return self.evidence.size > 0

    def lines(self, events: int) -> list[str]:
        """What they saw, for people; `events` is the ledger's number."""
        size, statements = self.evidence.size, self.evidence.statements
        rest = "" if size >= events else f"; fewer saw the newest {events - size:,}"
        return [
            f"witnessed: {min(size, events):,} of {events:,} events, by {self._heard()} (enough: {self.policy.rule()}){rest}",
            *(
                f"witness {one.witness}: its word does not count: {one.reason}"
                for one in statements
                if one.reason is not None
            ),
        ]

    def doubt(self, ledger: Path) -> str:
        """That too few of them saw anything."""
        reasons = "; ".join(
            f"{one.witness}: {one.reason}" for one in self.evidence.statements if one.reason is not None
        )
        return (
            f"{self.policy.file}: found {self._heard() or 'no cosignature that counts'} ({reasons}), expected {self.policy.rule()}; {ledger} may be "
            "consistent, but whether it is what they saw nobody knows: ask again, or find out why they are silent"
        )

    def _heard(self) -> str:
        return _listed({one.witness: one.time_s for one in self.evidence.statements if one.time_s is not None})

    def json(self) -> dict[str, object]:
        """What they saw, for programs."""
        return {
            "policy": self.policy.file,
            "ok": self.is_enough,
            "size": self.evidence.size,
            "witnesses": self.evidence.statements,
        }


def seen_of(
    context: typer.Context,
    ledger: Path,
    policy: Path | None,
    cosigned: Sequence[Path] | None,
    trusted: "VerifierKey | None",
) -> Seen | None:
    """What the witnesses of the policy say of the ledger, asked now or as these files show; None where nobody wants to know.

    Raises:
        UsageError: The policy, or what was asked for with it, makes no sense.
        NotALedger, FormatVersionMismatch: There is no ledger.
        LedgerCorrupted: The ledger is of a log that the policy does not name.
    """
    if policy is None:
        if cosigned:
            raise UsageError("--cosigned: found no --witness-policy, expected the policy that names the witnesses")
        return None
    from fsar_ledger.ledger.store.read import read_manifest
    from fsar_ledger.ledger.store.record import MANIFEST, parse_manifest
    from fsar_ledger.witness.evidence import ask_witnesses, read_cosigned
    from fsar_ledger.witness.policy import read_policy

    read = read_policy(policy)
    logs = _logs_of(read, trusted)
    try:
        origin = parse_manifest(ledger / MANIFEST, read_manifest(ledger)).origin
    except LedgerCorrupted:
        return None  # verify says so, and all else that is wrong
    logs = tuple(key for key in logs if key.name == origin)
    if not logs:
        raise LedgerCorrupted(
            f"{ledger}: found a ledger of {origin}, expected one of a log that {policy} or --trusted-key names"
        )
    now_s = _clock(context)()
    if cosigned:
        return Seen(read, logs, read_cosigned(read, logs, origin, now_s, cosigned))
    return Seen(read, logs, ask_witnesses(read, logs, origin, now_s))


def _logs_of(policy: "Policy", trusted: "VerifierKey | None") -> tuple["VerifierKey", ...]:
    """The keys of which one must have signed what the witnesses cosigned."""
    if policy.quorum is None:
        raise UsageError(
            f"{policy.file}: found `quorum none`, expected a witness or a group; without one nothing is shown"
        )
    if trusted is None and not policy.logs:
        raise UsageError(f"{policy.file}: found no log, expected a line `log KEY`, or --trusted-key KEY")
    if trusted is not None and policy.logs and trusted not in policy.logs:
        raise UsageError(f"--trusted-key: found {trusted.key}, expected a log of {policy.file}")
    return policy.logs if trusted is None else (trusted,)


def _clock(context: typer.Context) -> Callable[[], int]:
    """The clock that `app.py` gave."""
    clock: Callable[[], int] = context.obj
    return clock


def _listed(times: "dict[str, int]") -> str:
    return ", ".join(f"{name} ({_time(time_s)})" for name, time_s in times.items())


def _time(time_s: int) -> str:
    return (
        datetime.fromtimestamp(time_s, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
        if time_s <= _LAST_SECOND
        else f"second {time_s:,}"
    )
