"""The verbs `prove` and `verify-proof`: prove an event to people without the ledger, and check such a proof."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import LedgerCorrupted, UsageError, option

from .answers import Answer, Lines, Plain, Screen
from .key import checkpoint_of, root_of, signature_text, signer_of, trusted_of
from .names import MAX_DIGITS, Place
from .verbs import TrustedKeyOption, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.ledger.log.note import Signer
    from fsar_ledger.ledger.store.proof import Proof, Proven
    from fsar_ledger.ledger.store.read import View

    from .ledger import Ledger

Form = Literal["tlog-proof", "cose"]
PRINCIPALS = ("decided_by", "requested_by", "executed_by", "supervised_by")
UNKNOWN = "not on record"


def _proved(ledger: "Ledger", event: str, out: Path | None, format: Form, key: Path | None) -> Answer:
    proof = prove(ledger, event, out, format=format, key=key)
    if out is None:
        return Plain(str(proof))
    lines = [
        f"{out}: event {proof.index:,} of {proof.note.checkpoint.size:,}",
        f"root {proof.note.checkpoint.root.hex()}",
    ]
    if (log := proof.log) is not None:
        checkpoint = log.note.checkpoint
        lines += [f"this root is head {log.index:,} of {checkpoint.size:,} of the log", f"root {checkpoint.root.hex()}"]
    return Lines(*lines)


@verb(
    "prove out/ledger 1234 --out out/event-1234.tlog-proof",
    "prove out/ledger 1:12",
    "prove out/ledger 1:12 --as cose --key out/fleet.key --out out/event-12.cose",
    takes=("verified",),
    call=_proved,
)
def prove(
    ledger: "Ledger",
    event: Annotated[
        str | int,
        argument(
            "EVENT",
            "RUN:SEQ, a run (its number, its name, or a part of it that no other run has) and a seq in it; a bare "
            "number is the event's place in the ledger, from 0.",
        ),
    ],
    out: Place | None = declare("FILE", "A new file, .tlog-proof or .cose by convention; never replaced.", "print it"),
    *,
    format: Form = declare(
        "FORM", "`tlog-proof`, or `cose`, which needs --key and --out.", flag="--as", value="tlog-proof"
    ),
    key: Place | None = declare(
        "FILE", "Sign a receipt with this key, which signed the ledger.", environment="FSAR_LEDGER_KEY"
    ),
) -> "Proof":
    """Prove that one event is in a ledger.

    The proof is one small text, a C2SP tlog-proof: the event, the hashes from it to the root, and the newest
    checkpoint. In a federation it has two steps: the event is in a shard, and the log has the head of that shard. With
    `--as cose` it is a COSE transparent statement in CBOR: the event and a receipt of RFC 9942 with the same hashes,
    both signed now with the key of the ledger. `verify-proof` checks both kinds without the ledger.

    Raises:
        UsageError: There is no such event, more than one such run, `out` exists or lies inside a ledger; for `cose`,
            `out` or the key is missing, the key did not sign the newest checkpoint, or there is no cbor2.
        NotALedger, FormatVersionMismatch, LedgerCorrupted: As `open_for_answers`, and where hashes do not agree.
    """
    from fsar_ledger.ledger.opening import open_for_answers
    from fsar_ledger.ledger.store import cose, proof
    from fsar_ledger.ledger.store.paths import require_outside

    from .files import write_bytes

    signer = _signer(format, out, key)
    if out is not None:
        if os.path.lexists(Path(out)):
            raise UsageError(f"{option('out', out)}: found a file, expected a free name; a proof is never overwritten")
        require_outside(Path(out), option("out", out))
    view = open_for_answers(ledger.path)
    run, seq = asked_event(view, str(event), ledger.demanded)
    event_proof = proof.prove(view, _index_of(view, run, seq, ledger.demanded))
    data = str(event_proof).encode()
    if signer is not None and event_proof.log is not None:
        raise UsageError(
            f"{option('format', format)}: found a federation, expected one ledger, as a receipt has one step; leave it "
            "out, or prove the event in its shard"
        )
    if signer is not None:
        data = cose.signed_statement(str(ledger.path), event_proof, signer.under(event_proof.note.checkpoint.origin))
    if out is not None:
        write_bytes(Path(out), data)
    return event_proof


def _signer(form: str, out: Place | None, key: Place | None) -> "Signer | None":
    """Return the key of a receipt; None for a form without one. Raises: UsageError for an unknown form or no key."""
    from fsar_ledger.ledger.store.cose import library

    if form not in get_args(Form):
        raise UsageError(f"{option('format', printable.value(form))}: expected tlog-proof or cose")
    if form != "cose":
        if key is not None and str(key) != os.environ.get("FSAR_LEDGER_KEY"):
            raise UsageError(
                f"{option('key', key)}: found a key for a {form}, which is not signed, expected none, or "
                f"{option('format', 'cose')}"
            )
        return None
    where = option("format", form)
    for name, value in (("out", out), ("key", key)):
        if value is None:
            expected = (
                "a new file, since CBOR is not text" if name == "out" else "the secret key that signed the ledger"
            )
            raise UsageError(f"{where}: found no {option(name)}, expected {expected}")
    library(where)
    return signer_of(key)


def asked_event(view: "View", event: str, demanded: str | None) -> tuple[str | None, str]:
    """Return the full name of the run and the digits of the seq, or None and the digits of an index in the ledger.

    Raises:
        UsageError: It does not name an event, or there is no such run, or more than one.
        SequenceConflict: As `is_verified`.
    """
    from fsar_ledger.metrics.verified import is_verified

    from .lookup import resolve_run

    run, _, seq = event.rpartition(":")
    if not (seq.isascii() and seq.isdecimal()) or event.startswith(":"):
        raise UsageError(
            f"EVENT {event}: found no number, expected RUN:SEQ, as a run and the seq of an event in it, or the "
            "event's place in the ledger"
        )
    is_verified(view, demanded)
    return resolve_run(view, run, demanded) if run else None, seq


def found_event(view: "View", run: str | None, seq: str, demanded: str | None) -> tuple[str, int]:
    """Return run and seq of the event that `asked_event` gave. Raises: UsageError if there is no such event."""
    from fsar_ledger.ledger.store.locations import event_at, seq_counted_on

    row = event_at(view, _index_of(view, run, seq, demanded))
    name = str(row["run_id"])
    return (name, seq_counted_on(view, name, int(str(row["seq"])))) if run is None else (run, int(seq))


def _index_of(view: "View", run: str | None, seq: str, demanded: str | None) -> int:
    """Return the index in the ledger, from 0, of this event of the run; without a run, `seq` is that index.

    Raises:
        UsageError: There is no such event.
    """
    from fsar_ledger.ledger.store.locations import place_counted_on
    from fsar_ledger.metrics.verified import is_verified

    from .lookup import resting_on_rows

    if run is None:
        if len(seq) > MAX_DIGITS or int(seq) >= view.head.events:
            raise UsageError(
                f"EVENT {seq}: found {view.head.events:,} events in {view.path}, expected a number below that, or "
                "RUN:SEQ"
            )
        return int(seq)
    with resting_on_rows(is_verified(view, demanded)):
        try:
            return place_counted_on(view, run, int(seq[: MAX_DIGITS + 1]))
        except KeyError as error:
            (events,) = error.args
            raise UsageError(
                f"EVENT {printable.value(run)}:{seq}: found {events:,} events in the run, expected a seq from 0 to "
                f"{events - 1}"
            ) from error


class RefusedProof(Answer, msgspec.Struct, frozen=True):
    """A file that proves nothing, and why."""

    file: Place
    failure: LedgerCorrupted

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the problem."""
        return {"head": None, "ok": False, "file": str(self.file), "problem": str(self.failure)}


class CheckedProof(Answer, msgspec.Struct, frozen=True):
    """A file, what it proves, and what its root was compared with."""

    file: Place
    proven: "Proven"
    compared: tuple[str, ...]

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the event and its index; `head` is that of the proof's checkpoint, for a shard that of the log."""
        proven, event, top = self.proven, self.proven.event, self.proven.log or self.proven
        return {
            "head": {"size": top.size, "root": top.root},
            "ok": True,
            "file": str(self.file),
            "index": proven.index,
            "origin": proven.origin,
            "signature": proven.signature,
            "signer": proven.signer,
            "compared": self.compared,
            **({} if proven.log is None else {"log": proven.log}),
            **{name: event[name] for name in ("run_id", "seq", "type")},
            **{name: event.get(name) for name in PRINCIPALS},
            "event": event,
        }

    def text(self, _: Screen) -> Iterator[printable.SafeText]:
        """Yield the event, its principals, its position and the signature."""
        from fsar_ledger.ledger.rows.canonical import document

        proven, top = self.proven, self.proven.log or self.proven
        event = {
            name: printable.value(value) if isinstance(value, str) else value for name, value in proven.event.items()
        }
        width = max(map(len, PRINCIPALS))
        signature = signature_text(top.signature, top.signer)
        position = f"event {proven.index:,} of {proven.size:,} in the ledger of {printable.value(proven.origin)}"
        hint = []
        if self.compared:
            hint = [f"the root is that of {' and '.join(self.compared)}"]
        elif top.signature != "signed":
            hint = ["no signature was checked: compare the root with one that you trust, with --anchor or --root"]
        if proven.log is None:
            steps = [f"{self.file}: proven: {position}, {signature}", f"root {proven.root}"]
        else:
            head = f"head {top.index:,} of {top.size:,} in the log of {printable.value(top.origin)}"
            steps = [
                f"{self.file}: proven in two steps",
                f"1: {position}, a shard",
                f"   root {proven.root}",
                f"2: this root is {head}, {signature}",
                f"   root {top.root}",
            ]
        yield printable.lines(
            *steps,
            *hint,
            "",
            f"run {event['run_id']}, seq {event['seq']}: {event['type']}",
            *(f"{name.replace('_', ' '):<{width}}  {event.get(name, UNKNOWN)}" for name in PRINCIPALS),
            printable.ascii_json(document(proven.event).decode()),
        )


def _checked(file: Path, trusted_key: str | None, anchor: Path | None, root: str | None) -> CheckedProof | RefusedProof:
    path = Path("/dev/stdin") if str(file) == "-" else file
    try:
        proven = verify_proof(path, trusted_key, anchor=anchor, root=root)
    except LedgerCorrupted as error:
        return RefusedProof(file, error)
    compared = tuple(option(name) for name, value in (("anchor", anchor), ("root", root)) if value is not None)
    return CheckedProof(file, proven, compared)


@verb(
    "verify-proof out/event.tlog-proof",
    "verify-proof out/event.tlog-proof --anchor out/ledger/checkpoint",
    "verify-proof out/event.tlog-proof --trusted-key out/fleet.key.pub --json",
    takes=("json",),
    call=_checked,
)
def verify_proof(
    file: Annotated[Place, argument("FILE", "The file that `fsar-ledger prove` wrote.")],
    trusted_key: TrustedKeyOption = None,
    *,
    anchor: Place | None = declare("FILE", "Compare the root with that of this checkpoint, kept elsewhere."),
    root: str | None = declare("HEX", "Compare the root with this one."),
) -> "Proven":
    """Check a proof without the ledger, and show the event. A `-` reads it from standard input.

    Exit code 3 if it proves nothing, if the trusted key did not sign it, or if its root is not the one expected.
    Without any of these three, a valid proof shows only that the event is in the tree whose root the proof itself
    names: give the key, a checkpoint that you kept (`--anchor`), or the root.

    Raises:
        LedgerCorrupted: It proves nothing, the trusted key did not sign it, or it leads to another root.
        UsageError: There is no such file, the anchor is none or is of another size, the root is no hash, or the file
            is COSE and there is no cbor2.
    """
    from fsar_ledger.ledger.store.cose import check_statement, is_statement
    from fsar_ledger.ledger.store.proof import check_proof, proof_of, read_given, require_root, require_tree

    checkpoint, expected = checkpoint_of(anchor), root_of(root)
    trusted, where, data = trusted_of(trusted_key), str(file), read_given(Path(file))
    if is_statement(data):
        proven = check_statement(where, data, trusted)
    else:
        proven = check_proof(where, proof_of(where, data), trusted)
    top = proven.log or proven
    if checkpoint is not None:
        require_tree(where, top, checkpoint, str(anchor))
    if expected is not None:
        require_root(where, top, expected, option("root"))
    return proven
