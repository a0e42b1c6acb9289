"""The verbs `record`, `import` and `shards`: record what other systems did, and the heads of other ledgers."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec

from fsar_ledger.base import printable, utc
from fsar_ledger.base.errors import InvalidRun, SequenceConflict, UsageError, checked, option
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.base.progress import Progress

from .answers import Answer, Screen, head_json
from .key import origin_of as named_origin
from .key import signer_of
from .names import Names, Place, run_to_write, separated
from .verbs import AdoptOption, Gives, KeyOption, OriginOption, Shows, argument, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.read import View
    from fsar_ledger.ledger.store.record import Head
    from fsar_ledger.ledger.store.shards import ShardHead
    from fsar_ledger.sources.importing import Imported
    from fsar_ledger.sources.recorder import Fleet, Recorder

    from .ledger import Ledger

FEDERATION = "fsar-ledger/federation"
TAKEN_STAYS = "every accepted event is on disk, and the same command continues the run"
COMMITTED_STAYS = "what is committed is kept, and the same command continues from there"


@checked
def record(
    out: Place,
    *,
    fleet: "Fleet" = (),
    observes: Names = None,
    run: str | None = None,
    source: str = "recorder",
    epoch: datetime | None = None,
    origin: str | None = None,
    key: Place | None = None,
    private_names: Place | None = None,
) -> "Recorder":
    """Return a recorder, which appends what happens to a run of the ledger OUT.

    Args:
        out: A new folder, or that of a ledger.
        fleet: The robots: role by name, or `RobotJoined` events.
        observes: What is recorded completely: concerns, event types and fields of them that may be unknown.
        run: The name of the run; an existing one is continued. None: the time at which it begins.
        source: Who records.
        epoch: The time of run time 0; None: now.
        origin: Publish a new ledger under this name.
        key: The file of the key that signs.
        private_names: A file outside the ledger that keeps the names of people; the ledger stores commitments instead.

    Raises: As `Recorder`.
    """
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.sources.names import PrivateNames
    from fsar_ledger.sources.recorder import Recorder

    if private_names is not None:
        require_outside(Path(private_names), option("private_names", private_names))
    return Recorder(
        Path(out),
        fleet=fleet,
        observes=separated(observes),
        run=run and run_to_write(run),
        source=source,
        epoch=epoch,
        origin=named_origin(origin),
        signer=signer_of(key),
        names=None if private_names is None else PrivateNames(Path(private_names)),
    )


class RecordResult(Answer, msgspec.Struct, frozen=True):
    """The result of `record`: how many events were recorded, and why lines were refused, by line number."""

    ledger: Path
    run: str
    events: int
    refused: dict[int, str]

    @property
    def exit_code(self) -> int:
        """Return 1 if a line was refused."""
        return 1 if self.refused else 0

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return all fields."""
        refused = {str(line): why for line, why in self.refused.items()}
        return {"ledger": str(self.ledger), "run": self.run, "events": self.events, "refused": refused}

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield what was recorded, the first lines that were not, and how many more."""
        more = len(self.refused) - printable.NAMED
        yield printable.lines(
            f"{self.ledger}: run {printable.value(self.run)}, {counted(self.events, 'event')} recorded, "
            f"{len(self.refused):,} refused",
            *(f"line {line}: {why}" for line, why in list(self.refused.items())[: printable.NAMED]),
            *([f"and {more:,} more"] if more > 0 else []),
        )


@verb(
    "record out/site --run night --observes ExecutionStarted    # reads standard input",
    name="record",
    takes=("json",),
    after_interruption=TAKEN_STAYS,
)
def record_lines(
    out: Annotated[Place, argument("OUT", "A new folder, or that of a ledger to add to.")],
    *,
    run: str | None = declare("NAME", "The name of the run; an existing one is continued.", "the present time"),
    source: str = declare("NAME", "The name of the recorder.", value="recorder"),
    observes: Names = declare(
        "NAME",
        "Concerns, event types or TYPE.FIELD that are recorded completely, as task,ExecutionStarted; may be repeated.",
        "nothing: only observations (`Observed`) are taken",
    ),
    fleet: Place | None = declare("FILE", "A .toml file that names the robots: [robots], NAME = ROLE."),
    epoch: str | None = declare("TIME", "When the run begins, as 2026-03-01T10:00Z.", "now"),
    origin: OriginOption = None,
    key: KeyOption = None,
    private_names: Place | None = declare(
        "FILE", "Store commitments in place of the names of people; this file outside the ledger keeps the names."
    ),
    say: Annotated[Callable[[str], None], Gives("say")],
) -> RecordResult:
    """Record events from standard input as they come, one JSON object per line, each stored before the next is read.

    A line has `type` (`ExecutionStarted`) and the columns of that type (`docs/event-types.json`), and optionally `time`
    (ISO 8601; UTC if it has no zone) and `caused_by`. An invalid line is refused at once, with the reason, and
    recording continues.

    Raises:
        UsageError: A name in --observes is none, or the run is there and was declared otherwise.
        WriteFailed: A write failed; what is committed stays.
    """
    from fsar_ledger.sources.adapter import named_robots
    from fsar_ledger.sources.columns import tell

    robots = named_robots(Path(fleet)) if fleet is not None else {}
    with record(
        out,
        fleet=robots,
        observes=observes,
        run=run,
        source=source,
        epoch=None if epoch is None else _time(epoch),
        origin=origin,
        key=key,
        private_names=private_names,
    ) as recorder:
        events, refused = tell(recorder, sys.stdin.buffer, say)
        return RecordResult(Path(out), recorder.run, events, refused)


def _time(text: str) -> datetime:
    try:
        return utc.parsed(text)
    except ValueError as error:
        value = printable.value(text)
        raise UsageError(f"{option('epoch')}: found {value}, expected a time such as 2026-03-01T10:00Z") from error


class ImportResult(Answer, msgspec.Struct, frozen=True):
    """The result of `import`, and what can be judged of the run now: `gaps` as `audit/record_gaps`.

    `unseen` are event types that the source is declared to record, and of which the run has no event; `also` are the
    other runs into which the same files were imported.
    """

    ledger: "Ledger"
    made: "Imported"
    unseen: tuple[str, ...]
    gaps: tuple[Mapping[str, Any], ...]
    also: tuple[str, ...] = ()

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return all fields."""
        return {
            "ledger": str(self.ledger.path),
            **msgspec.to_builtins(self.made),
            "unseen": list(self.unseen),
            "gaps": [dict(gap) for gap in self.gaps],
            "also": list(self.also),
        }

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield what was read, what was made of it, what was not understood, and what is observable."""
        result, value = self.made, printable.value
        earlier = f", {result.before:,} of them before" if result.before else ""
        source = f"{counted(result.records, 'record')} of {value(result.format)}{earlier}"
        yield printable.lines(
            f"{self.ledger.path}: run {value(result.run)}, {source}",
            *([f"recorded before, as run {', '.join(map(value, self.also))}: counts twice"] if self.also else []),
            f"events made: {', '.join(f'{count:,} {kind}' for kind, count in result.events.items()) or 'none'}",
            *(
                f"not understood: {value(item.kind)}, {counted(item.count, 'record')}, the first of them {item.first:,}"
                for item in result.not_understood[: printable.NAMED]
            ),
            *result.about_times(),
            *([f"declared as recorded, but never seen: {', '.join(self.unseen)}"] if self.unseen else []),
            *self._judged(),
        )

    def _judged(self) -> Iterator[str]:
        observable = [_short(gap["judge"]) for gap in self.gaps if gap["is_observable"]]
        yield f"can be judged: {', '.join(observable) or 'nothing'}"
        hidden = [gap for gap in self.gaps if not gap["is_observable"]]
        for gap in hidden[: printable.NAMED]:
            yield f"not observable: {_short(gap['judge'])} (missing: {gap['missing']})"
        if more := hidden[printable.NAMED :]:
            path = printable.word(self.ledger.path)
            yield f"and {len(more)} more; `fsar-ledger query record_gaps {path}` lists all"


@verb(
    "import out/hall night.jsonl --as vda5050",
    "import out/yard night.jsonl --as vda5050 --run yard --fleet fleet.toml",
    name="import",
    takes=("json",),
    after_interruption=COMMITTED_STAYS,
)
def import_records(
    out: Annotated[Place, argument("OUT", "A new folder, or that of a ledger to add to.")],
    logs: Annotated[Sequence[Place], argument("LOG...", "Files of the recording, in order; - is standard input.")],
    *,
    format: str | None = declare("NAME", "The format of the recording.", flag="--as"),
    mapping: Place | None = declare("FILE", "A mapping of your own format (docs/sources/mapping.md).", flag="--with"),
    run: str | None = declare("NAME", "The name of the run.", "that of the first file"),
    fleet: Place | None = declare("FILE", "A .toml file that names the robots of the fleet: [robots], NAME = ROLE."),
    bodies: bool = switch("Also keep every record as it was read."),
    origin: OriginOption = None,
    key: KeyOption = None,
    progress: Annotated[Progress | None, Shows("imported", "records")] = None,
) -> ImportResult:
    """Import a recording of another system as a run of a ledger.

    Every record is kept as an observation, with its hash, and typed events are derived from those that the format's
    adapter understands. Nothing is invented: what the format does not say is unknown, and what depends on it is not
    observable. Called again, an interrupted import continues where it stopped, and one whose recording has grown adds
    what is new.

    Raises:
        UsageError: The recording is on file, is another one than that of this run, or is not of the format.
        WriteFailed: A write failed; what is committed stays.
    """
    from fsar_ledger.sources.adapter import adapter_of, looked, named_robots, opened
    from fsar_ledger.sources.importing import import_files

    from .ledger import Ledger

    adapter, mapping_sha256 = adapter_of(format, None if mapping is None else Path(mapping))
    with opened(logs) as inputs:
        name = run_to_write(run or inputs[0].name)
        imported = import_files(
            Path(out),
            inputs,
            looked(adapter, inputs),
            run=name,
            fleet=None if fleet is None else named_robots(Path(fleet)),
            mapping_sha256=mapping_sha256,
            keeps_bodies=bodies,
            origin=named_origin(origin),
            signer=signer_of(key),
            progress=progress,
        )
    ledger = Ledger(out)
    with ledger.about_run(imported.run) as (database, _, _):
        seen = {str(row["type"]).partition(".v")[0] for row in database.rows("SELECT DISTINCT type FROM events")}
        gaps = database.rows("SELECT * FROM record_gaps ORDER BY missing_count, kind, judge")
    unseen = tuple(name for name in imported.declared.records if "." not in name and name not in seen)
    own = "SELECT input_sha256 FROM source_opened WHERE run_id = $run"
    same = f"SELECT DISTINCT run_id FROM source_opened WHERE run_id <> $run AND input_sha256 IN ({own}) ORDER BY run_id"
    with ledger.database() as database:
        also = tuple(row["run_id"] for row in database.rows(same, {"run": imported.run}))
    return ImportResult(ledger, imported, unseen, tuple(gaps), also)


class RecordedShards(Answer, msgspec.Struct, frozen=True):
    """The newest head of each shard, the origins recorded now, and the model versions of each shard by origin."""

    log: Path
    head: "Head"
    shards: "list[ShardHead]"
    recorded: tuple[str, ...]
    models: dict[str, list[str]]

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return a row for each shard."""
        rows = [
            {
                **{name: getattr(shard, name) for name in ("origin", "folder", "shard_events", "shard_root")},
                "model_versions": self.models.get(shard.origin),
                "is_new": shard.origin in self.recorded,
            }
            for shard in self.shards
        ]
        return {"head": head_json(self.head), "log": str(self.log), "shards": rows}

    def text(self, _: Screen) -> Iterator[SafeText]:
        """Yield the head of the log, and a line for each shard."""
        value = printable.value
        versions = sorted({version for names in self.models.values() for version in names})
        yield printable.lines(
            f"{self.log}: {counted(len(self.shards), 'shard')}, {len(self.recorded):,} recorded now",
            f"root {self.head.root}",
            *(
                f"{value(head.origin)}: {counted(head.shard_events, 'event')} in {value(head.folder)}, model version "
                f"{', '.join(map(value, self.models.get(head.origin, ()))) or 'unknown'}"
                for head in self.shards
            ),
            *([f"model versions {', '.join(map(value, versions))}: answers never pool them"] if versions[1:] else []),
        )


@verb(
    "shards out/federation out/named out/large",
    "shards out/signed-federation out/named --key out/fleet.key",
    takes=("json",),
    after_interruption="either all heads were recorded, or none",
)
def shards(
    log: Annotated[Place, argument("LOG", "A new folder, or that of the log of a federation.")],
    ledgers: Annotated[Sequence[Place], argument("LEDGER...", "The ledgers to record.", "all that it has")] = (),
    *,
    origin: str | None = declare("NAME", "Publish a new log under this name.", "the key's name, else a general one"),
    key: KeyOption = None,
    adopt: AdoptOption = False,
) -> RecordedShards:
    """Record the present heads of several ledgers in a log, so that they can be queried and proven as one ledger.

    The log is a ledger like any other, of the heads of its shards. Everything that is asked of it is answered from the
    shards, at these heads. A shard that has grown is recorded again; it must continue from its recorded head.

    Raises:
        UsageError: A shard has the origin of another, or a run that another has, or is a federation itself; or LOG is a
            ledger of runs.
        LedgerCorrupted: A shard does not go on from its recorded head.
        NotALedger: There is no ledger in a folder.
        SequenceConflict: Another process has recorded heads meanwhile.
        WriteFailed: A write failed; what is committed stays.
    """
    from fsar_ledger.ledger.opening import open_checked, present
    from fsar_ledger.ledger.store.append import Writer
    from fsar_ledger.ledger.store.shards import newest, record_of_head
    from fsar_ledger.metrics.verified import models_of
    from fsar_ledger.sources.stored import kept_origin, origin_of

    path, signer = Path(log), signer_of(key)
    heads = [] if kept_origin(path) is None else _heads(open_checked(path))
    folders = [Path(shard) for shard in ledgers or ()] or [shard.place(path) for shard in newest(heads)]
    if not folders:
        raise UsageError(f"{path}: found no shard, expected at least one LEDGER; name the ledgers to record")
    current = present(path, heads, folders)
    name = origin_of(path, named_origin(origin), signer, FEDERATION)
    if name in current.views:
        raise UsageError(f"{option('origin', name)}: found the origin of a shard, expected an origin of the log's own")
    with Writer(path, name, signer, adopts=adopt) as writer:
        if current.heads:
            try:
                writer.commit(list(map(record_of_head, current.heads)))
            except InvalidRun as error:
                if writer.head.size == len(heads):
                    raise
                raise SequenceConflict(
                    f"{path}: found that the log has meanwhile grown, expected the {len(heads):,} heads that it had; "
                    "nothing was recorded: run it again"
                ) from error
        head = writer.head
    models = {origin: models_of(view) for origin, view in current.views.items()}
    return RecordedShards(
        path, head, newest([*heads, *current.heads]), tuple(shard.origin for shard in current.heads), models
    )


def _heads(log: "View") -> "list[ShardHead]":
    """Return the heads of a log. Raises: UsageError if it is another ledger, LedgerCorrupted as `heads_of`."""
    from fsar_ledger.ledger.store.shards import heads_of, is_log

    if log.head.size and not is_log(log):
        raise UsageError(f"{log.path}: found a ledger of runs, expected a new folder, or a log of heads of shards")
    return heads_of(log)


def _short(judge: str) -> str:
    """Return the letter and number of an invariant, or the name of a metric."""
    return judge[:2].upper() if judge[1:3].rstrip("_").isdigit() else judge
