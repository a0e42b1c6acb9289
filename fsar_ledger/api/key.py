"""The verbs `key` and `witness`: keys that sign ledgers, and witnesses that check that they only grow."""

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fsar_ledger.base import printable
from fsar_ledger.base.errors import NotCosigned, UsageError, option
from fsar_ledger.base.printable import SafeText

from .answers import Answer, Lines, Plain, Screen, interrupted_by_sigterm
from .names import Place
from .verbs import Gives, Option, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.ledger.log.note import Checkpoint, Signer, VerifierKey
    from fsar_ledger.ledger.verify.report import Anchor
    from fsar_ledger.witness import WitnessKey
    from fsar_ledger.witness.cosign import Cosigned

    from .ledger import Ledger


@verb(
    "key new fleet.key",
    "key new arm.key --name example.org/arm",
    name="key new",
    takes=(),
)
def key_new(
    file: Annotated[Place, argument("FILE", "Where the secret key goes; the public one goes to FILE.pub.")],
    name: str | None = declare("NAME", "The origin of the ledgers it signs.", "fsar-ledger/simulated"),
) -> "VerifierKey":
    """Make a key that signs ledgers, and print its public half.

    Keep FILE secret: anyone who has it can rewrite every ledger that it signed. The public half is for everyone who
    verifies.

    Raises:
        UsageError: The name cannot be an origin, or the file exists or would lie inside a ledger.
        WriteFailed: The file cannot be written.
    """
    from fsar_ledger.ledger.store.keys import new_key
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.runtime.experiment import ORIGIN

    require_outside(Path(file), f"FILE {file}")
    return new_key(Path(file), ORIGIN if name is None else short("name", name))


@verb(
    'key public out/fleet.key.pub --name "example.org/fleet/ablation"',
    name="key public",
    takes=(),
)
def key_public(
    key: Annotated[str, argument("KEY", "A public key: a .pub file, or the key itself.")],
    name: Annotated[str, Option("--name", "NAME", "The origin of the ledger to verify.")],
) -> "VerifierKey":
    """Print a public key under another name, for `verify --trusted-key`.

    `reproduce` signs each ledger with one secret under a name of its own.

    Raises:
        UsageError: There is no such key, or no ledger can have this origin.
    """
    from fsar_ledger.ledger.log.note import VerifierKey
    from fsar_ledger.ledger.store.keys import read_verifier

    if (origin := origin_of(name, "name")) is None:
        raise UsageError(f"{option('name')}: expected the origin of a ledger")
    return VerifierKey(origin, read_verifier(key).public)


def signer_of(key: str | PathLike[str] | None, *, adopts: bool = False) -> "Signer | None":
    """Read the key in this file, if one was given.

    Raises:
        UsageError: The file holds no key, or a ledger is to be adopted without one.
    """
    if key is None:
        if adopts:
            raise UsageError(f"{option('adopt')}: found no {option('key')}, expected the key that signs from here on")
        return None
    from fsar_ledger.ledger.store.keys import read_signer

    return read_signer(Path(key))


def origin_of(name: str | None, parameter: str = "origin") -> str | None:
    """Check and return the origin, if one was given. Raises: UsageError if no ledger can have it."""
    from fsar_ledger.ledger.log.note import is_name

    if name is not None and not is_name(name):
        raise UsageError(f"{option(parameter, repr(name))}: expected a printable name without spaces and plus signs")
    return None if name is None else short(parameter, name)


def short(parameter: str, name: str) -> str:
    """Return the name. Raises: UsageError if it is too long to be shown whole."""
    if len(name) > printable.MAX_VALUE:
        raise UsageError(
            f"{option(parameter, name[:40])}...: found {len(name):,} characters, expected at most {printable.MAX_VALUE}"
        )
    return name


def trusted_of(key: str | None) -> "VerifierKey | None":
    """Read the public key that must have signed, if one was given. Raises: UsageError if it is not a key."""
    from fsar_ledger.ledger.store.keys import read_verifier

    return None if key is None else read_verifier(key)


def anchor_of(file: str | PathLike[str] | None, trusted: "VerifierKey | None" = None) -> "Anchor | None":
    """Read the kept checkpoint in this file, if one was given.

    Raises: UsageError if it is not a checkpoint, or not signed by the trusted key, if there is one.
    """
    from fsar_ledger.ledger.log.note import doubt
    from fsar_ledger.ledger.verify.report import read_anchor

    anchor = None if file is None else read_anchor(Path(file))
    if anchor is not None and anchor.note is None:
        raise UsageError(
            f"{option('anchor', anchor.file)}: found no checkpoint ({anchor.reason}), expected one of this ledger that "
            "was kept elsewhere, byte for byte: three lines, an empty one, and its signatures if it has any"
        )
    note = None if anchor is None else anchor.note
    if note is not None and trusted is not None and (why := doubt(note, trusted)) is not None:
        raise UsageError(
            f"{option('anchor', str(file))}: found a checkpoint with {why}, expected one signed by {trusted.key}, the "
            f"trusted key; to compare one from before the key changed, leave out {option('trusted_key')}"
        )
    return anchor


OWN_CHECKPOINT = (
    "the anchor is this ledger's own checkpoint, which the ledger's writer writes: it proves nothing about the past; "
    "keep a copy elsewhere"
)


def is_own_checkpoint(anchor: "Anchor | None", ledger: Path) -> bool:
    """Return whether the anchor is the file `checkpoint` of this ledger itself, by any path."""
    from fsar_ledger.ledger.store.paths import CHECKPOINT

    with suppress(OSError):
        return anchor is not None and os.path.samefile(anchor.file, ledger / CHECKPOINT)
    return False


def checkpoint_of(file: str | PathLike[str] | None) -> "Checkpoint | None":
    """Read the kept checkpoint in this file, if one was given. Raises: UsageError if it holds none."""
    anchor = anchor_of(file)
    return None if anchor is None or anchor.note is None else anchor.note.checkpoint


def root_of(text: str | None) -> str | None:
    """Return the root in hex, if one was given. Raises: UsageError if it is not a hash."""
    if text is not None and not re.fullmatch("[0-9a-fA-F]{64}", text):
        raise UsageError(f"{option('root', f'{text:.80}')}: found no hash, expected 64 hexadecimal digits")
    return None if text is None else text.lower()


def signature_text(state: str, signer: str | None) -> str:
    """Describe the signature of a note.

    `signer` is the trusted key that made it, or the one that the note names.
    """
    if signer is None:
        return "unsigned"
    return (
        f"signed by {printable.value(signer)}"
        if state == "signed"
        else f"signed, signer not checked (it names {printable.value(signer)})"
    )


@verb("witness new out/witness --name example.org/w1", name="witness new", takes=())
def witness_new(
    state: Annotated[Place, argument("STATE", "A new folder for the witness.")],
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


class ServedWitness(Answer):
    """A witness server; showing the answer serves until SIGTERM or Ctrl-C."""

    def __init__(self, state: Path, logs: Sequence[str], host: str, port: int, **given: "Callable[..., Any]") -> None:
        self._state, self._logs, self._host, self._port, self._given = state, logs, host, port, given

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Show the public key and the URL, then serve; yields nothing."""
        from fsar_ledger.witness import read_log_key
        from fsar_ledger.witness.server import Service, WitnessServer
        from fsar_ledger.witness.state import open_state

        def tell(line: str) -> None:
            with suppress(OSError):  # stderr may no longer be read
                self._given["say"](line)

        logs = [read_log_key(key) for key in self._logs]
        with open_state(self._state) as state:
            service = Service(state, logs, self._given["clock"], tell)
            server = WitnessServer(self._host, self._port, service, self._given["ticks"])
            with server, interrupted_by_sigterm():
                try:
                    self._given["show"](printable.lines(str(state.cosigner.key), server.url))
                    server.serve_forever(poll_interval=0.1)
                except KeyboardInterrupt:
                    tell("ended")
        yield from ()


@verb(
    "witness serve out/witness --log out/fleet.key.pub --port 8001",
    "witness serve out/witness --log out/fleet.key.pub --log out/arm.key.pub",
    name="witness serve",
    takes=(),
)
def witness_serve(
    state: Annotated[Place, argument("STATE", "The folder that `fsar-ledger witness new` made.")],
    log: Annotated[
        Sequence[str], Option("--log", "KEY", "Watch this log: its .pub file or public key; may be repeated.")
    ],
    *,
    host: str = declare("ADDRESS", "The address to listen on.", value="127.0.0.1"),
    port: int = declare("N", "The port to listen on; 0 takes a free one.", least=0, most=65535, value=0),
    clock: Annotated["Callable[[], int]", Gives("clock")],
    ticks: Annotated["Callable[[], float]", Gives("ticks")],
    say: Annotated["Callable[[str], None]", Gives("say")],
    show: Annotated["Callable[[SafeText], None]", Gives("show")],
) -> ServedWitness:
    """Cosign checkpoints over HTTP until interrupted.

    Prints its public key and URL. Speaks C2SP tlog-witness: a checkpoint is cosigned if the log's key signed it and a
    proof shows that the log only grew since the last one. The witness needs no ledger and sees no event.
    """
    return ServedWitness(Path(state), log, host, port, clock=clock, ticks=ticks, say=say, show=show)


def _ask_witnesses(
    ledger: "Ledger",
    policy: Path,
    out: Place | None = declare("FILE", "Where the cosigned checkpoint goes; replaced if it exists.", "print it"),
    *,
    say: Annotated["Callable[..., None]", Gives("say")],
) -> Answer:
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.witness.answers import listed

    from .files import write_bytes

    if out is not None:
        require_outside(Path(out), f"--out {out}")
    cosigned = witness_ask(ledger, policy)
    say(*(f"{name}: {reason}" for name, reason in cosigned.silent.items()))
    if out is None:
        return Plain(str(cosigned.note))
    write_bytes(Path(out), str(cosigned.note).encode())
    checkpoint = cosigned.note.checkpoint
    return Lines(
        f"{out}: {checkpoint.size:,} events, cosigned by {listed(cosigned.times)}", f"root {checkpoint.root.hex()}"
    )


@verb(
    "witness ask out/ledger --policy witnesses.policy",
    "witness ask out/ledger --policy witnesses.policy --out out/cosigned",
    name="witness ask",
    takes=(),
    call=_ask_witnesses,
)
def witness_ask(
    ledger: "Ledger",
    policy: Annotated[Place, Option("--policy", "FILE", "A C2SP tlog-policy that names the witnesses.")],
) -> "Cosigned":
    """Have the newest checkpoint of a ledger cosigned.

    Each witness in FILE that has a URL gets the checkpoint and a proof that the ledger only grew, but no event. If
    fewer cosign than FILE requires, nothing is written and the exit code is 1.

    Raises:
        NotCosigned: Fewer cosigned than the policy demands.
    """
    from fsar_ledger.witness.answers import listed
    from fsar_ledger.witness.cosign import cosign
    from fsar_ledger.witness.policy import read_policy

    rules = read_policy(Path(policy))
    cosigned = cosign(ledger.path, rules)
    if not rules.is_met(set(cosigned.times)):
        refusals = "; ".join(f"{name}: {reason}" for name, reason in cosigned.silent.items())
        raise NotCosigned(
            f"{policy}: found {listed(cosigned.times) or 'no cosignature'} ({refusals}), expected {rules.rule()}; "
            "nothing was written; try again, or find out why"
        )
    return cosigned
