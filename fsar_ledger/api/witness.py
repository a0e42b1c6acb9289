"""The verbs `witness new`, `witness serve` and `witness ask`."""

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fsar_ledger.base import printable
from fsar_ledger.base.errors import NotCosigned
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Lines, Plain, Screen
from .key import short
from .names import Place
from .verbs import Gives, Option, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.witness.cosign import Cosigned
    from fsar_ledger.witness.protocol import WitnessKey

    from .ledger import Ledger


@verb("witness new out/witness --name example.org/w1", name="witness new", takes=())
def witness_new(
    state: Annotated[Place, argument("STATE", "The folder of the witness: a new one.")],
    name: Annotated[str, Option("--name", "NAME", "Its name, host/path by convention.")],
) -> "WitnessKey":
    """Make a witness, and print its public key.

    STATE holds its secret key and, later, what it has seen. A witness that forgets is worth nothing: never copy STATE
    or restore it from a backup; make a new witness instead.

    Raises:
        UsageError: The folder exists or lies inside a ledger, or the name is invalid.
    """
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.witness.state import new_state

    require_outside(Path(state), f"STATE {state}")
    return new_state(Path(state), short("name", name))


class Served(Answer):
    """A server of a witness; to show the answer is to serve until SIGTERM or Ctrl-C."""

    def __init__(self, state: Path, logs: Sequence[str], host: str, port: int, **given: "Callable[..., Any]") -> None:
        self._state, self._logs, self._host, self._port, self._given = state, logs, host, port, given

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Show the public key and the URL, then serve; nothing is left to yield."""
        from fsar_ledger.witness.protocol import read_log_key
        from fsar_ledger.witness.server import Service, WitnessServer
        from fsar_ledger.witness.state import open_state

        def tell(line: str) -> None:
            with suppress(OSError):  # stderr may no longer be read
                self._given["say"](line)

        def end(*_: object) -> None:
            raise KeyboardInterrupt

        logs = [read_log_key(key) for key in self._logs]
        with open_state(self._state) as state:
            service = Service(state, logs, self._given["clock"], tell)
            with WitnessServer(self._host, self._port, service, self._given["ticks"]) as server:
                before = signal.signal(signal.SIGTERM, end)
                try:
                    self._given["show"](printable.lines(str(state.cosigner.key), server.url))
                    server.serve_forever(poll_interval=0.1)
                except KeyboardInterrupt:
                    tell("ended")
                finally:
                    signal.signal(signal.SIGTERM, before)
        yield from ()


@verb(
    "witness serve out/witness --log out/fleet.key.pub --port 8001",
    "witness serve out/witness --log out/fleet.key.pub --log out/arm.key.pub",
    name="witness serve",
    takes=(),
)
def witness_serve(
    state: Annotated[Place, argument("STATE", "What `fsar-ledger witness new` made.")],
    log: Annotated[
        Sequence[str], Option("--log", "KEY", "Watch this log: its .pub file or public key; may be repeated.")
    ],
    *,
    host: str = declare("ADDRESS", "The address to listen at.", value="127.0.0.1"),
    port: int = declare("N", "The port to listen at; 0 takes a free one.", least=0, most=65535, value=0),
    clock: Annotated["Callable[[], int]", Gives("clock")],
    ticks: Annotated["Callable[[], float]", Gives("ticks")],
    say: Annotated["Callable[[str], None]", Gives("say")],
    show: Annotated["Callable[[SafeText], None]", Gives("show")],
) -> Served:
    """Cosign checkpoints over HTTP until interrupted.

    Prints its public key and URL. Speaks C2SP tlog-witness: a checkpoint is cosigned if the log's key signed it and a
    proof shows that the log only grew since the last one. The witness needs no ledger and sees no event.
    """
    return Served(Path(state), log, host, port, clock=clock, ticks=ticks, say=say, show=show)


def _ask(
    ledger: "Ledger",
    policy: Path,
    out: Place | None = declare("FILE", "Where the cosigned checkpoint goes; replaced.", "print it"),
    *,
    say: Annotated["Callable[..., None]", Gives("say")],
) -> Answer:
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.witness.answers import listed

    from .files import write_text

    if out is not None:
        require_outside(Path(out), f"--out {out}")
    found = witness_ask(ledger, policy)
    say(*(f"{name}: {reason}" for name, reason in found.silent.items()))
    if out is None:
        return Plain(str(found.note))
    write_text(Path(out), str(found.note))
    tree = found.note.checkpoint
    return Lines(f"{out}: {tree.size:,} events, cosigned by {listed(found.times)}", f"root {tree.root.hex()}")


@verb(
    "witness ask out/ledger --policy witnesses.policy",
    "witness ask out/ledger --policy witnesses.policy --out out/cosigned",
    name="witness ask",
    takes=(),
    call=_ask,
)
def witness_ask(
    ledger: "Ledger",
    policy: Annotated[Place, Option("--policy", "FILE", "A C2SP tlog-policy that names the witnesses.")],
) -> "Cosigned":
    """Have the newest checkpoint of a ledger cosigned.

    Each witness in FILE that has a URL gets the checkpoint and a proof that the ledger only grew, but no event. If
    fewer cosign than FILE demands, nothing is written and the exit code is 1.

    Raises:
        NotCosigned: Fewer cosigned than the policy demands.
    """
    from fsar_ledger.witness.answers import listed
    from fsar_ledger.witness.cosign import cosign
    from fsar_ledger.witness.policy import read_policy

    read = read_policy(Path(policy))
    found = cosign(ledger.path, read)
    if not read.is_met(set(found.times)):
        refusals = "; ".join(f"{name}: {reason}" for name, reason in found.silent.items())
        raise NotCosigned(
            f"{policy}: found {listed(found.times) or 'no cosignature'} ({refusals}), expected {read.rule()}; "
            "nothing was written, try again or look into it"
        )
    return found
