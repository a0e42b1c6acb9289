"""The verb `import`: a recording of another system goes into a ledger."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.base.progress import Progress

from .answers import Answer, Screen
from .names import Place
from .verbs import KeyOption, Shows, argument, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.sources.importing import Imported

    from .ledger import Ledger

CONTINUES = "what is committed stays, and the same command continues there"


class ImportResult(Answer, msgspec.Struct, frozen=True):
    """What became of the input, and what can be judged of the run now: `gaps` as `audit/record_gaps`.

    `unseen` are event types that the source is said to record, and of which the run has no event.
    """

    ledger: "Ledger"
    made: "Imported"
    unseen: tuple[str, ...]
    gaps: tuple[Mapping[str, Any], ...]

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return all of it."""
        return {
            "ledger": str(self.ledger.path),
            **msgspec.to_builtins(self.made),
            "unseen": list(self.unseen),
            "gaps": [dict(one) for one in self.gaps],
        }

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield what was read, what was made of it, what was not understood, and what is observable."""
        made, value = self.made, printable.value
        there = f", {made.before:,} of them before" if made.before else ""
        read = f"{counted(made.records, 'record')} of {value(made.format)}{there}"
        yield printable.lines(
            f"{self.ledger.path}: run {value(made.run)}, {read}",
            f"events made: {', '.join(f'{count:,} {kind}' for kind, count in made.events.items()) or 'none'}",
            *(
                f"not understood: {value(one.kind)}, {counted(one.count, 'record')}, the first of them {one.first:,}"
                for one in made.not_understood[: printable.NAMED]
            ),
            *([f"said to be recorded, and never seen: {', '.join(self.unseen)}"] if self.unseen else []),
            *self._judged(),
        )

    def _judged(self) -> Iterator[str]:
        can = [_short(one["judge"]) for one in self.gaps if one["is_observable"]]
        yield f"can be judged: {', '.join(can) or 'nothing'}"
        hidden = [one for one in self.gaps if not one["is_observable"]]
        for one in hidden[: printable.NAMED]:
            yield f"not observable: {_short(one['judge'])}, for want of {one['missing']}"
        if more := hidden[printable.NAMED :]:
            place = printable.word(self.ledger.path)
            yield f"and {len(more)} more, for want of more; `fsar-ledger query record_gaps {place}` lists all"


@verb(
    "import out/hall night.jsonl --as vda5050",
    "import out/yard night.jsonl --as vda5050 --run yard --fleet fleet.toml",
    name="import",
    takes=("json",),
    after_interruption=CONTINUES,
)
def import_records(
    out: Annotated[Place, argument("OUT", "A new folder, or that of a ledger to add to.")],
    logs: Annotated[Sequence[str], argument("LOG...", "Files of the recording, in their order; - is standard input.")],
    *,
    format: str | None = declare("NAME", "The format of the recording.", flag="--as"),
    mapping: Place | None = declare("FILE", "A mapping of your own format (docs/sources/mapping.md).", flag="--with"),
    run: str | None = declare("NAME", "The name of the run.", "that of the first file"),
    fleet: Place | None = declare("FILE", "A .toml file that names the robots of the fleet: [robots], NAME = ROLE."),
    bodies: bool = switch("Keep every record whole, beside what it says."),
    origin: str | None = declare("NAME", "Publish a new ledger under this name.", "the key's name, else a general one"),
    key: KeyOption = None,
    progress: Annotated[Progress | None, Shows("imported", "records")] = None,
) -> ImportResult:
    """Import a recording of another system as a run of a ledger.

    Every record is kept as an observation, with its hash, and typed events follow from those that the format's adapter
    understands. Nothing is invented: what the format does not say is unknown, and whatever would rest on it is not
    observable. Called again, an interrupted import goes on where it stopped, and one whose recording has grown takes
    what is new.

    Raises:
        UsageError: The recording is on file, is another one than that of this run, or is not of the format.
        WriteFailed: A write failed; what is committed stays.
    """
    from fsar_ledger.ledger.store.keys import read_signer
    from fsar_ledger.sources.adapter import adapter_of, looked, named_robots, opened
    from fsar_ledger.sources.importing import import_files

    from .ledger import Ledger

    adapter, mapping_sha256 = adapter_of(format, None if mapping is None else Path(mapping))
    with opened(logs) as inputs:
        made = import_files(
            Path(out),
            inputs,
            looked(adapter, inputs),
            run=run or inputs[0].name,
            fleet=None if fleet is None else named_robots(Path(fleet)),
            mapping_sha256=mapping_sha256,
            keeps_bodies=bodies,
            origin=origin,
            signer=None if key is None else read_signer(Path(key)),
            progress=progress,
        )
    ledger = Ledger(out)
    with ledger.about_run(made.run) as (database, _, _):
        seen = {str(row["type"]).partition(".v")[0] for row in database.rows("SELECT DISTINCT type FROM events")}
        gaps = database.rows("SELECT * FROM record_gaps ORDER BY missing_count, kind, judge")
    unseen = tuple(name for name in made.declared.records if "." not in name and name not in seen)
    return ImportResult(ledger, made, unseen, tuple(gaps))


def _short(judge: str) -> str:
    """Return the letter and number of an invariant, or the name of a metric."""
    return judge[:2].upper() if judge[1:3].rstrip("_").isdigit() else judge
