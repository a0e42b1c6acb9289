"""The command `verify-proof`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import TrustedKeyOption, examples
from fsar_ledger.cli.terminal import show
from fsar_ledger.errors import LedgerCorrupted
from fsar_ledger.printable import Shown

if TYPE_CHECKING:
    from fsar_ledger.ledger.chain.proof import Proven

EXAMPLES = examples(
    "fsar-ledger verify-proof out/event.tlog-proof",
    "fsar-ledger verify-proof out/event.tlog-proof --anchor out/ledger/checkpoint",
    "fsar-ledger verify-proof out/event.tlog-proof --trusted-key out/fleet.key.pub --json",
)
PRINCIPALS = ("decided_by", "requested_by", "executed_by", "supervised_by")
UNKNOWN = "not on record"


def verify_proof(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What `fsar-ledger prove` wrote.", show_default=False)],
    trusted_key: TrustedKeyOption = None,
    anchor: Annotated[
        Path | None,
        typer.Option(
            "--anchor",
            metavar="FILE",
            help="Compare the root with that of this checkpoint, kept elsewhere.",
            show_default=False,
        ),
    ] = None,
    root: Annotated[
        str | None,
        typer.Option("--root", metavar="HEX", help="Compare the root with this one.", show_default=False),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Answer as JSON, with the head (size, root) of the proof's checkpoint.")
    ] = False,
) -> None:
    """Check a proof without the ledger, and show the event. A `-` reads it from standard input.

    Exit code 3 if it proves nothing, if the trusted key did not sign it, or if its root is not the one expected.
    Without any of these three, a valid proof shows only that the event is in the tree whose root the proof itself
    names: give the key, a checkpoint that you kept (`--anchor`), or the root.
    """
    from fsar_ledger.api import functions as api
    from fsar_ledger.cli.output import json_text

    place = Path("/dev/stdin") if str(file) == "-" else file
    try:
        proven = api.verify_proof(place, trusted_key, anchor=anchor, root=root)
    except LedgerCorrupted as error:
        if as_json:
            show(json_text(None, {"ok": False, "file": str(file), "problem": str(error)}))
        raise
    compared = [name for name, given in (("--anchor", anchor), ("--root", root)) if given is not None]
    show(_json(file, proven, compared) if as_json else _text(file, proven, compared))


def _text(file: Path, proven: "Proven", compared: list[str]) -> Shown:
    """Return the event, its principals, its place and the signature, for people."""
    from fsar_ledger.cli.output import signature_text
    from fsar_ledger.ledger.rows.canonical import document

    event = {name: printable.value(found) if isinstance(found, str) else found for name, found in proven.event.items()}
    width = max(map(len, PRINCIPALS))
    signature = signature_text(proven.signature, proven.signer)
    place = f"event {proven.index:,} of {proven.size:,} in the ledger of {printable.value(proven.origin)}"
    hint = []
    if compared:
        hint = [f"the root is that of {' and '.join(compared)}"]
    elif proven.signature != "signed":
        hint = ["no signature was checked: compare the root with one that you trust, by --anchor or --root"]
    return printable.lines(
        f"{file}: proven: {place}, {signature}",
        f"root {proven.root}",
        *hint,
        "",
        f"run {event['run_id']}, seq {event['seq']}: {event['type']}",
        *(f"{name.replace('_', ' '):<{width}}  {event.get(name, UNKNOWN)}" for name in PRINCIPALS),
        printable.ascii_json(document(proven.event).decode()),
    )


def _json(file: Path, proven: "Proven", compared: list[str]) -> Shown:
    """Return the same as JSON; `head` is that of the proof's checkpoint, `compared` what the root was compared with."""
    from fsar_ledger.cli.output import json_text

    event = proven.event
    about = {name: event[name] for name in ("run_id", "seq", "type")} | {name: event.get(name) for name in PRINCIPALS}
    place = {"index": proven.index, "origin": proven.origin, "signature": proven.signature, "signer": proven.signer}
    return json_text(proven, {"ok": True, "file": str(file), **place, "compared": compared, **about, "event": event})
