"""The verb `verify-proof`: what a proof shows, without the ledger."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import LedgerCorrupted, option

from .answers import Answer, Screen
from .key import checkpoint_of, root_of, signature_text, trusted_of
from .names import Place
from .verbs import TrustedKeyOption, argument, declare, verb

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.proof import Proven

PRINCIPALS = ("decided_by", "requested_by", "executed_by", "supervised_by")
UNKNOWN = "not on record"


class Refused(Answer, msgspec.Struct, frozen=True):
    """A file that proves nothing, and why."""

    file: Place
    failure: LedgerCorrupted

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the problem."""
        return {"head": None, "ok": False, "file": str(self.file), "problem": str(self.failure)}


class Checked(Answer, msgspec.Struct, frozen=True):
    """A file, what it proves, and what its root was compared with."""

    file: Place
    proven: "Proven"
    compared: tuple[str, ...]

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the event and its place; `head` is that of the proof's checkpoint."""
        proven, event = self.proven, self.proven.event
        return {
            "head": {"size": proven.size, "root": proven.root},
            "ok": True,
            "file": str(self.file),
            "index": proven.index,
            "origin": proven.origin,
            "signature": proven.signature,
            "signer": proven.signer,
            "compared": self.compared,
            **{name: event[name] for name in ("run_id", "seq", "type")},
            **{name: event.get(name) for name in PRINCIPALS},
            "event": event,
        }

    def text(self, _: Screen) -> Iterator[printable.SafeText]:
        """Yield the event, its principals, its place and the signature."""
        from fsar_ledger.ledger.rows.canonical import document

        proven = self.proven
        event = {
            name: printable.value(found) if isinstance(found, str) else found for name, found in proven.event.items()
        }
        width = max(map(len, PRINCIPALS))
        signature = signature_text(proven.signature, proven.signer)
        place = f"event {proven.index:,} of {proven.size:,} in the ledger of {printable.value(proven.origin)}"
        hint = []
        if self.compared:
            hint = [f"the root is that of {' and '.join(self.compared)}"]
        elif proven.signature != "signed":
            hint = ["no signature was checked: compare the root with one that you trust, by --anchor or --root"]
        yield printable.lines(
            f"{self.file}: proven: {place}, {signature}",
            f"root {proven.root}",
            *hint,
            "",
            f"run {event['run_id']}, seq {event['seq']}: {event['type']}",
            *(f"{name.replace('_', ' '):<{width}}  {event.get(name, UNKNOWN)}" for name in PRINCIPALS),
            printable.ascii_json(document(proven.event).decode()),
        )


def _checked(file: Path, trusted_key: str | None, anchor: Path | None, root: str | None) -> Checked | Refused:
    place = Path("/dev/stdin") if str(file) == "-" else file
    try:
        proven = verify_proof(place, trusted_key, anchor=anchor, root=root)
    except LedgerCorrupted as error:
        return Refused(file, error)
    compared = tuple(option(name) for name, given in (("anchor", anchor), ("root", root)) if given is not None)
    return Checked(file, proven, compared)


@verb(
    "verify-proof out/event.tlog-proof",
    "verify-proof out/event.tlog-proof --anchor out/ledger/checkpoint",
    "verify-proof out/event.tlog-proof --trusted-key out/fleet.key.pub --json",
    takes=("json",),
    call=_checked,
)
def verify_proof(
    file: Annotated[Place, argument("FILE", "What `fsar-ledger prove` wrote.")],
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

    kept, expected = checkpoint_of(anchor), root_of(root)
    trusted, where, data = trusted_of(trusted_key), str(file), read_given(Path(file))
    if is_statement(data):
        proven = check_statement(where, data, trusted)
    else:
        proven = check_proof(where, proof_of(where, data), trusted)
    if kept is not None:
        require_tree(where, proven, kept, str(anchor))
    if expected is not None:
        require_root(where, proven, expected, option("root"))
    return proven
