"""The verb `whatif`: forks of the runs of a ledger, and the effect of their changes."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import UsageError, option
from fsar_ledger.base.printable import SafeText, counted
from fsar_ledger.base.progress import Progress

from .answers import Answer, Screen, head_json
from .diff import Diff, diff_text, difference_of
from .names import Names, Place, Run, names_of
from .verbs import WIDE, AnswersOption, ArchitectureOption, Option, Shows, declare, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.analysis.whatif import Divergence, Effects, Pair, RefusedChange
    from fsar_ledger.ledger.rows.codec import LedgerRun
    from fsar_ledger.ledger.store.read import View
    from fsar_ledger.ledger.store.record import Head
    from fsar_ledger.metrics.provenance import Provenance
    from fsar_ledger.runtime.changes import Changes

    from .ledger import Ledger
    from .table import Table

NAMES = {"base_mean": "base", "fork_mean": "fork"}
COLUMNS = (
    *("metric", "n", "differing_pairs", "base_mean", "fork_mean", "difference"),
    *("low", "high", "test", "p", "gain"),
)

Texts = str | Sequence[str]
"""Changes as texts (`docs/replay.md`); one that ends in `.toml` is a file of them."""


class Fork(msgspec.Struct, frozen=True):
    """A fork of a recorded run.

    `record` is what happens in it, as `Ledger.record` returns it; `base` the run as recorded. `parts_at` is the first
    seq at which they differ; None: they do not. Event 0 of the fork, which records its base and changes, does not
    count. `ends`: the question that the record of a live run does not answer, so that the fork ends there; None: it
    does not end early.
    """

    base: "LedgerRun"
    record: "LedgerRun"
    changes: tuple[str, ...]
    parts_at: int | None
    ends: str | None = None

    @property
    def parted_s(self) -> float | None:
        """Return when they diverge, in seconds of run time."""
        if self.parts_at is None:
            return None
        times = [run.times_us[self.parts_at] for run in (self.base, self.record) if self.parts_at < len(run.times_us)]
        return min(times) / 1_000_000


class WhatIf(Answer, msgspec.Struct, frozen=True):
    """Forks with the same changes, and the effects on every metric.

    `story` says where base and fork of a single run diverge, and why; None: there are several. `kept` is the head of
    the ledger in which they were stored, each beside its base; None: they were not stored.
    """

    changes: tuple[str, ...]
    forks: tuple["Divergence", ...]
    effects: list["Effects"]
    story: Diff | None
    provenance: "Provenance"
    kept: "Head | None"
    out: Path | None = None

    @property
    def diverging(self) -> int:
        """Return how many forks differ from their base."""
        return sum(divergence.parts_at is not None for divergence in self.forks)

    def document(self, screen: Screen) -> Mapping[str, object]:
        """Return the forks, their effects, and where they are stored."""
        return {
            "changes": self.changes,
            "story": None if self.story is None else self.story.document(screen),
            "forks": self.forks,
            "effects": self.effects,
            "kept": self.kept and head_json(self.kept),
        }

    def text(self, screen: Screen) -> Iterator[SafeText]:
        """Yield what the changes do, in one run or in pairs."""
        yield printable.lines(*(f"change: {change}" for change in self.changes))
        if self.story is not None:
            yield printable.lines(screen.run_text(self.story.first), "", *_end(self.forks[0]))
            yield from diff_text(self.story, ("base", "fork"), screen)
            yield printable.lines("")
        else:
            for effects in self.effects:
                yield from _effects(
                    effects, screen, is_alone=len(self.effects) == len({*map(_configuration_text, self.effects)})
                )
        if self.kept is not None and self.out is not None:
            count = counted(len(self.forks), "fork")
            ledger = printable.word(self.out)
            yield printable.lines(f"kept in {ledger}: {count}, each beside its base, root {self.kept.root}")


def _fork_or_list(
    ledger: "Ledger",
    changes: Names = declare("TEXT", "A change to make, as above; may be repeated.", flag="--change"),
    file: Place | None = declare("FILE", "A .toml file of changes.", flag="--changes"),
    run: Run | None = None,
    answers: str | None = None,
    all_runs: bool = switch("Fork every simulated run."),
    lists: bool = switch("List what a change of the run can name.", flag="--list"),
    architecture: Names = None,
    out: Place | None = None,
    progress: Progress | None = None,
) -> Answer:
    if lists:
        if run is None:
            raise UsageError("--list: found no run, expected --run RUN")
        return changeable(ledger, run)
    if (run is None) == (not all_runs):
        combination = "--run and --all-runs" if all_runs else "neither --run nor --all-runs"
        raise UsageError(f"found {combination}, expected one of them")
    if file is not None and Path(file).suffix != ".toml":
        raise UsageError(f"--changes {file}: expected a .toml file")
    texts = [*(names_of(changes) or ()), *([] if file is None else [str(file)])]
    if not texts:
        raise UsageError("found no change, expected --change TEXT or --changes FILE; --list says what can be named")
    return whatif(ledger, texts, run, answers=answers, architecture=architecture, out=out, progress=progress)


@verb(
    'whatif out/ledger --run 1 --change "drop window:*"',
    'whatif out/ledger --run 1 --change "add window:fleet/B1 20s for 5s" --out out/forks',
    'whatif out/ledger --all-runs --architecture fsar --change "rule fleet deny robot=B1 from 20s"',
    "whatif out/ledger --run 1 --list",
    call=_fork_or_list,
    takes=("cluster", *WIDE),
    after_interruption="what is committed is kept, and the same command makes what is missing",
)
def whatif(
    ledger: "Ledger",
    changes: Annotated[Texts, Option("--change", "TEXT", "A change to make, as above; may be repeated.")],
    run: Run | None = declare("RUN", "Fork this run: its number, its name, or a unique part of it."),
    *,
    answers: AnswersOption = None,
    architecture: ArchitectureOption = None,
    out: Place | None = declare("LEDGER", "Store each fork beside its base in this ledger.", "nowhere"),
    progress: Annotated[Progress | None, Shows("simulated", "forks")] = None,
) -> WhatIf:
    """Fork runs with a change, and show what it does: in one run, or over all in pairs.

    A fork repeats its run up to the change and continues with the same draws, so that nothing differs but what the
    change does. Changes are `drop FACT`, `move FACT +5s`, `add KIND:WHO TIME for TIME`, `answer QUESTION ANSWER`,
    `rule`, `trust`, `budget`, `density`, `set NAME=VALUE`, `architecture NAME`, `without MECHANISM`; docs/replay.md has
    each. The table has every metric in base and fork; over all runs, the difference with a 95 % interval, how many
    pairs differ, p, and how many times as many independent runs would be as precise (gain).

    The fork of a live run repeats its commands. It ends where it asks something that none of them answers, unless a
    change or the model of --answers does.

    Raises:
        UsageError: A change is none, or means nothing; a run cannot be made again; no run does anything else; `out` is
            the ledger itself, or lies inside one, or the run is live.
        WriteFailed: `out` cannot be written.
    """
    from fsar_ledger.analysis import whatif as forks
    from fsar_ledger.ledger.store.paths import require_outside
    from fsar_ledger.metrics.comparison_sides import sides
    from fsar_ledger.metrics.provenance import of_judgement

    from .lookup import present, recorded

    if run is not None and architecture:
        name = option("architecture")
        raise UsageError(f"{option('run', run)} and {name}: found one run, expected {name} with all runs")
    view, provenance = present(ledger)
    record = None if run is None else recorded(ledger, view, run)
    path = None if out is None else Path(out)
    parsed = forks.changes_of([*([changes] if isinstance(changes, str) else changes), *forks.answers_of(answers)])
    if answers is not None and (record is None or getattr(record.events[0], "kind", None) != "live"):
        what = "no run" if record is None else "a simulated run, whose world answers everything"
        raise UsageError(f"{option('answers', answers)}: found {what}, expected --run RUN of a live run")
    if path is not None:
        if path.resolve() == view.path.resolve():
            raise UsageError(f"{option('out', path)}: found the ledger of the bases, expected another place")
        require_outside(path.parent, option("out", path))
    if not parsed:
        raise UsageError("changes: found no change, expected one at least")
    texts = tuple(map(str, parsed))
    if record is not None:
        return _of_one(forks.fork_of(view, record, parsed), texts, provenance, path)
    runs = forks.runs_of(view, names_of(architecture) or ())
    report = None if progress is None else lambda done: progress(done, len(runs))
    with ledger.database() as database:
        names = {side.side: side.name for side in sides(database)}
        provenance = of_judgement(database)
    divergences, effects = forks.effects_over(view, runs, parsed, names, report)
    if len(
        refused := [
            (divergence.base, divergence.refused) for divergence in divergences if divergence.refused is not None
        ]
    ) == len(divergences):
        raise forks.refused_in_all(refused)
    if not any(divergence.parts_at for divergence in divergences):
        raise without_effect(view, runs, parsed)
    head = None if path is None else forks.commit_pairs(path, forks.fork_pairs(view, runs, parsed))
    return WhatIf(texts, tuple(divergences), effects, None, provenance, head, path)


def without_effect(view: "View", runs: Sequence[str], changes: "Changes") -> UsageError:
    """Return the error for changes without effect on any of these runs; it says why the first is not affected."""
    from fsar_ledger.analysis import whatif as forks
    from fsar_ledger.ledger.store.locations import record_of

    others = f"they have no effect in any of {len(runs):,} runs" if len(runs) > 1 else ""
    try:
        forks.fork_of(view, record_of(view, runs[0]), changes)
    except UsageError as why:
        return UsageError(f"{why}{forks.of_run(runs[0], others)}")
    return UsageError(f"the changes have no effect in any of {len(runs):,} runs; expected some effect")


def _of_one(pair: "Pair", texts: tuple[str, ...], provenance: "Provenance", path: Path | None) -> WhatIf:
    """Return what the changes do in one run. Raises: UsageError if its fork cannot be stored."""
    from fsar_ledger.analysis import whatif as forks

    if path is not None and pair.base.recipe.live is not None:
        raise UsageError(
            f"{option('out', path)}: found the fork of a live run, which rests on commands that are not its own; "
            "expected a simulated run"
        )
    (base, fork), end = pair.records, pair.fork.end
    divergences, effects = forks.effects([pair])
    story = difference_of(base, fork, (provenance,), None if end is None else end.time_us)
    head = None if path is None else forks.commit_pairs(path, [pair])
    return WhatIf(texts, tuple(divergences), effects, story, provenance, head, path)


def fork(ledger: "Ledger", run: Run, changes: Texts) -> Fork:
    """Fork a run: repeat it up to the first change, and continue with the same draws. Nothing is stored.

    The run is a simulated one of this model version, or a live one. Changes are texts such as `drop window:fleet/B1/0`,
    or the names of `.toml` files; none gives a null fork.

    Raises:
        UsageError: There is no such run, it cannot be made again, or a change is invalid or has no effect.
    """
    from fsar_ledger.analysis.whatif import changes_of, fork_of
    from fsar_ledger.events.fleet import RunStarted

    from .lookup import present, recorded

    view, _ = present(ledger)
    record = recorded(ledger, view, run)
    pair = fork_of(view, record, changes_of(changes))
    started = pair.fork.record.events[0]
    assert isinstance(started, RunStarted)
    end = pair.fork.end
    return Fork(record, pair.fork.record, started.changes or (), pair.fork.parts_at, None if end is None else end.words)


def changeable(ledger: "Ledger", run: Run) -> "Table":
    """Return what the changes of a run can name: the facts of its world, and what it asks at its ports.

    The answer has a row for each: its name, a shorter one, when it begins and ends, and what happens or is the
    answer.

    Raises:
        UsageError: There is no such run, or it cannot be made again.
    """
    from fsar_ledger.analysis.fork_base import Changeable, base_of_record, rerun

    from .lookup import present, recorded
    from .table import Table, of_structs

    view, provenance = present(ledger)
    elements = rerun(base_of_record(recorded(ledger, view, run), view.head.root)).changeable()
    return Table(of_structs(elements, Changeable), provenance, name="changeable")


def _end(divergence: "Divergence") -> Iterator[str]:
    """Yield which commands the fork of a live run leaves out, and where and why it ends early."""
    if divergence.left_out:
        count, names = (
            counted(len(divergence.left_out), "command"),
            map(printable.value, dict.fromkeys(divergence.left_out)),
        )
        yield f"not given there, because nothing asks for it: {count} on record, {printable.list_few(names)}"
    if divergence.ends is not None:
        yield f"the fork ends at {divergence.ends_s:.3f} s: {printable.value(divergence.ends, 1_000)}"
        if divergence.question is not None:
            question = printable.value(divergence.question)
            yield f'`--change "answer {question} ANSWER"` answers that; `--answers model:7` lets the model answer'
    if divergence.left_out or divergence.ends is not None:
        yield ""


def refusals(found: "Sequence[RefusedChange]", pairs: int) -> Iterator[str]:
    """Yield in how many pairs a change is refused, and why."""
    reasons: dict[str, int] = {}
    for refused in found:
        reason = refused.reason.partition(";")[0]  # the rest is what else the run has
        reasons[reason] = reasons.get(reason, 0) + refused.pairs
    counts = list(reasons.items())
    for reason, count in counts[: printable.NAMED]:
        yield f"in {count:,} of {pairs:,} a change has no effect: {printable.value(reason, 1_000)}"
    if more := counts[printable.NAMED :]:
        yield f"in {sum(count for _, count in more):,} of {pairs:,} for other reasons, which --json has"


def _configuration_text(effects: "Effects") -> str:
    """Return the architecture and configuration of the runs, as text."""
    who = effects.architecture or "-"
    return who if effects.configuration in (None, "full") else f"{who} {effects.configuration}"


def _effects(effects: "Effects", screen: Screen, *, is_alone: bool) -> Iterator[SafeText]:
    """Yield the effects on one side; its whole name unless it is alone in its architecture and configuration."""
    from .table import plain

    rows = [{NAMES.get(name, name): row[name] for name in COLUMNS} for row in plain(effects.rows)]
    who = _configuration_text(effects) if is_alone or effects.side is None else printable.value(effects.side)
    yield printable.lines("", f"{who}: {counted(effects.pairs, 'pair')}, {effects.diverging:,} of them diverge")
    yield printable.lines(*refusals(effects.refused, effects.pairs))
    yield screen.table(rows)
    yield printable.lines("")
