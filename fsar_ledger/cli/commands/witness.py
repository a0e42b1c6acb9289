"""The commands `witness new`, `witness serve` and `witness ask`."""

import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import LedgerArgument, examples
from fsar_ledger.cli.terminal import say, show
from fsar_ledger.printable import Shown

if TYPE_CHECKING:
    from fsar_ledger.witness.server import WitnessServer

_LAST_SECOND = 253_402_300_799  # of the year 9999

group = typer.Typer()


@group.callback()
def _witnesses() -> None:
    """Check that ledgers only grow, or have your own checked."""


@group.command("new", epilog=examples("fsar-ledger witness new out/witness --name example.org/w1"))
def witness_new(
    state: Annotated[
        Path, typer.Argument(metavar="STATE", help="The folder of the witness: a new one.", show_default=False)
    ],
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Its name, host/path by convention.", show_default=False)
    ],
) -> None:
    """Make a witness, and print its public key.

    STATE holds its secret key and, later, what it has seen. A witness that forgets is worth nothing: never copy STATE
    or restore it from a backup; make a new witness instead.
    """
    from fsar_ledger.api.witness import witness_new as make

    show(printable.line(str(make(state, name))))


@group.command(
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
    """Cosign checkpoints over HTTP until interrupted.

    Prints its public key and URL. Speaks C2SP tlog-witness: a checkpoint is cosigned if the log's key signed it and a
    proof shows that the log only grew since the last one. The witness needs no ledger and sees no event.
    """
    from fsar_ledger.witness.cosignature import read_log_key
    from fsar_ledger.witness.server import Service, WitnessServer
    from fsar_ledger.witness.state import open_state

    logs = [read_log_key(key) for key in log]
    with (
        open_state(state) as found,
        WitnessServer(host, port, Service(found, logs, _clock(context), _tell), time.monotonic) as server,
    ):
        _serve(server, printable.lines(str(found.cosigner.key), server.url))


def _serve(server: "WitnessServer", greeting: Shown) -> None:
    """Serve until SIGTERM or Ctrl-C."""

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
    """Tell the operator, if stderr is still read."""
    with suppress(OSError):
        say(line)


@group.command(
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

    Each witness in FILE that has a URL gets the checkpoint and a proof that the ledger only grew, but no event. If
    fewer cosign than FILE demands, nothing is written and the exit code is 1.
    """
    from fsar_ledger.api.files import write_text
    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.api.witness import listed
    from fsar_ledger.ledger.store.paths import require_outside

    if out is not None:
        require_outside(out, f"--out {out}")
    found = Ledger(ledger).witness_ask(policy)
    say(*(f"{name}: {reason}" for name, reason in found.silent.items()))
    if out is None:
        show(Shown(str(found.note)), raw=True)
        return
    write_text(out, str(found.note))
    tree = found.note.checkpoint
    show(printable.lines(f"{out}: {tree.size:,} events, cosigned by {listed(found.times)}", f"root {tree.root.hex()}"))


def _clock(context: typer.Context) -> Callable[[], int]:
    """Return the clock that `app.run` passes."""
    clock: Callable[[], int] = context.obj
    return clock
