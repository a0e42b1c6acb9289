"""The commands for who does not take a ledger on trust: `verify`, `prove`, `verify-proof` and `key new`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.errors import LedgerCorrupted, ReplayMismatch, UsageError
from fsar_ledger.printable import Shown

from .memory import readers_of
from .options import (
    CosignedOption,
    JsonOption,
    LedgerArgument,
    ReplayOption,
    TrustedKeyOption,
    VerifiedOption,
    WitnessPolicyOption,
    WorkersOption,
    examples,
)
from .progress import Progress
from .terminal import show

if TYPE_CHECKING:
    from fsar_ledger.ledger.log.note import Signer

VERIFY = examples(
    "fsar-ledger verify out/ledger",
    "fsar-ledger verify out/ledger --quick --json",
    "fsar-ledger verify out/ledger --replay",
    "cp out/ledger/checkpoint monday    # keep it elsewhere; later:",
    "fsar-ledger verify out/ledger --anchor monday --trusted-key out/fleet.key.pub",
    "fsar-ledger verify out/ledger --witness-policy witnesses.policy --cosigned out/cosigned",
)
PROVE = examples(
    "fsar-ledger prove out/ledger 1234 --out out/event-1234.tlog-proof",
    "fsar-ledger prove out/ledger fsar.full.door-relay.n4.s42.r0000:12",
)
VERIFY_PROOF = examples(
    "fsar-ledger verify-proof out/event.tlog-proof",
    "fsar-ledger verify-proof out/event.tlog-proof --trusted-key out/fleet.key.pub --json",
)

keys = typer.Typer()


@keys.callback()
def _keys() -> None:
    """Make keys that sign ledgers."""


@keys.command(
    "new", epilog=examples("fsar-ledger key new fleet.key", "fsar-ledger key new arm.key --name example.org/arm")
)
def key_new(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="Where the secret key goes; the public one goes to FILE.pub.", show_default=False
        ),
    ],
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="The origin of the ledgers it signs.", show_default="fsar-ledger/simulated"),
    ] = None,
) -> None:
    """Make a key that signs ledgers; prints the public half.

    FILE is for the one who signs and nobody else: who has it can rewrite every ledger that it signed. The public half is for all who verify.
    """
    from fsar_ledger.ledger.store.keys import new_key
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.runtime.experiment import ORIGIN

    require_outside(file, f"FILE {file}")
    show(printable.line(str(new_key(file, ORIGIN if name is None else short("--name", name)))))


@keys.command("public", epilog=examples('fsar-ledger key public out/fleet.key.pub --name "example.org/fleet/ablation"'))
def key_public(
    file: Annotated[
        str, typer.Argument(metavar="KEY", help="A public key: a .pub file, or the key itself.", show_default=False)
    ],
    name: Annotated[
        str, typer.Option(metavar="NAME", help="The origin of the ledger that it shall verify.", show_default=False)
    ],
) -> None:
    """Print a public key under another name, for `verify --trusted-key`: `reproduce` signs each ledger with one secret under a name of its own."""
    from fsar_ledger.ledger.log.note import VerifierKey
    from fsar_ledger.ledger.store.keys import read_verifier

    if (origin := origin_of(name, "--name")) is None:
        raise UsageError("--name: expected the origin of a ledger")
    show(printable.line(str(VerifierKey(origin, read_verifier(file).public))))


def signer_of(key: Path | None, *, adopts: bool = False) -> "Signer | None":
    """The key in this file, if one was given. Raises: UsageError if there is none in it, or if what others wrote shall be adopted without one."""
    if key is None:
        if adopts:
            raise UsageError("--adopt: found no --key, expected the key that signs on from here")
        return None
    from fsar_ledger.ledger.store.keys import read_signer

    return read_signer(key)


def origin_of(name: str | None, option: str = "--origin") -> str | None:
    """The origin that was asked for, if any. Raises: UsageError if no ledger can have it."""
    from fsar_ledger.ledger.log.note import is_name

    if name is not None and not is_name(name):
        raise UsageError(f"{option} {name!r}: expected a printable name without spaces and plus signs")
    return None if name is None else short(option, name)


def short(option: str, name: str) -> str:
    """The name, which people are shown whole. Raises: UsageError if it is too long for that."""
    if len(name) > printable.MAX_VALUE:
        raise UsageError(
            f"{option} {name:.40}...: found {len(name):,} characters, expected at most {printable.MAX_VALUE}"
        )
    return name


def signed_lines(ledger: Path, signer: "Signer | None") -> list[str]:
    """A line that says whether the newest commit of the ledger carries a signature of this key; nothing without a key."""
    from fsar_ledger.ledger.log.note import signers_of
    from fsar_ledger.ledger.store.read import open_ledger

    if signer is None:
        return []
    records = open_ledger(ledger).records
    signers = signers_of(records[-1].signed_note()) if records else None
    if signers == signer.verifier.key:
        return [f"signed by {printable.value(signers)}"]
    return [
        f"nothing was appended, so nothing was signed; the newest commit is {f'signed by {printable.value(signers)}' if signers else 'unsigned'}"
    ]


def verify(
    context: typer.Context,
    ledger: LedgerArgument,
    quick: Annotated[
        bool, typer.Option("--quick", help="Read no rows: only the chain of records, the files' hashes and the notes.")
    ] = False,
    anchor: Annotated[
        Path | None,
        typer.Option(
            "--anchor",
            metavar="FILE",
            help="Prove that the ledger only grew since this copy of LEDGER/checkpoint.",
            show_default=False,
        ),
    ] = None,
    trusted_key: TrustedKeyOption = None,
    witness_policy: WitnessPolicyOption = None,
    cosigned: CosignedOption = None,
    replay: ReplayOption = False,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Re-derive every hash, count and record of a ledger.

    Where anything does not hold, each place is named and the exit code is 3. What no ledger can show about itself, that all of it was
    rewritten or its newest commits taken away, shows with a trusted key and an anchor, a copy of LEDGER/checkpoint that was kept elsewhere,
    or with witnesses, who keep one.
    A look at all rows that finds nothing is remembered in the user's cache, never in the ledger; answers from this head are then `rows_verified`.
    """
    from fsar_ledger.ledger.store.keys import read_verifier
    from fsar_ledger.ledger.verify.notes import read_anchor
    from fsar_ledger.ledger.verify.verify import Asked
    from fsar_ledger.metrics.verified import whole_look

    from .replay import replayed, verdict_json, verdict_lines
    from .witness import seen_of

    if quick and replay:
        raise UsageError("--quick and --replay: expected one of them; a quick look reads no rows, a replay all of them")
    trusted = None if trusted_key is None else read_verifier(trusted_key)
    kept = None if anchor is None else read_anchor(anchor)
    seen = seen_of(context, ledger, witness_policy, cosigned, trusted)  # before the look: the ledger may grow meanwhile
    if trusted is None and seen is not None:
        trusted = seen.log
    asked = Asked(quick, trusted, kept, seen.evidence.checkpoints if seen is not None else ())
    with Progress("verified", "segments") as progress:
        report = whole_look(ledger, readers_of(workers, ledger), progress, asked)
    again = replayed(ledger, report, readers_of(workers, ledger)) if replay else None
    if as_json:
        show(verdict_json(report, again, seen.json() if seen is not None else None))
    if not report.ok:
        raise LedgerCorrupted(*verdict_lines(ledger, report, again))
    if again is not None and not again.ok:
        raise ReplayMismatch(*verdict_lines(ledger, report, again))
    if seen is not None and not seen.is_enough:
        raise LedgerCorrupted(seen.doubt(ledger))
    if not as_json:
        show(
            printable.lines(
                *verdict_lines(ledger, report, again), *(seen.lines(report.events) if seen is not None else ())
            )
        )


def prove(
    ledger: LedgerArgument,
    event: Annotated[
        str,
        typer.Argument(
            metavar="EVENT",
            help="RUN:SEQ, a run (the beginning of its name, if no other begins so) and a seq in it; or the event's number in the ledger, from 0.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="FILE", help="A new file, by custom .tlog-proof; never replaced.", show_default="print it"
        ),
    ] = None,
    verified: VerifiedOption = False,
) -> None:
    """Prove that one event is in a ledger.

    The proof is one small text, a C2SP tlog-proof: the event, the hashes from it to the root, and the newest checkpoint. Whoever has it
    needs no ledger to check it with `verify-proof`.
    """
    from .proofs import proof_of, write_proof

    if out is None:
        show(Shown(str(proof_of(ledger, event, verified=verified))), raw=True)
    else:
        show(write_proof(ledger, event, out, verified=verified))


def verify_proof(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What `fsar-ledger prove` wrote.", show_default=False)],
    trusted_key: TrustedKeyOption = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Answer as JSON, with the head (size, root) of the proof's checkpoint.")
    ] = False,
) -> None:
    """Check a proof, without the ledger; shows the event.

    Exit code 3 if it proves nothing, or if the trusted key did not sign it. Without a trusted key it shows only that the event is in the
    tree whose root the proof itself names: compare that root, or give the key.
    """
    from fsar_ledger.ledger.store.keys import read_verifier
    from fsar_ledger.ledger.store.proof import check_proof, read_proof

    from .output import json_text
    from .proofs import proven_json, proven_text

    trusted = None if trusted_key is None else read_verifier(trusted_key)
    try:
        proven = check_proof(str(file), read_proof(file), trusted)
    except LedgerCorrupted as error:
        if as_json:
            show(json_text(None, {"ok": False, "file": str(file), "problem": str(error)}))
        raise
    show(proven_json(file, proven) if as_json else proven_text(file, proven))
