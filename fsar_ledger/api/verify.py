"""The verb `verify`: check the rows of a ledger, replay its runs, and ask witnesses."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import FsarLedgerError, LedgerCorrupted, ReplayMismatch, UsageError, option
from fsar_ledger.base.printable import counted
from fsar_ledger.base.progress import Progress

from .answers import Answer, Screen
from .key import OWN_CHECKPOINT, anchor_of, is_own_checkpoint, signature_text, trusted_of
from .names import Place
from .verbs import Gives, Shows, TrustedKeyOption, WorkersOption, declare, readers_of, switch, verb

if TYPE_CHECKING:
    from fsar_ledger.ledger.store.problem import Problem
    from fsar_ledger.ledger.verify.report import VerifyReport
    from fsar_ledger.runtime.isolation import FleetComparison
    from fsar_ledger.runtime.replay import ReplayReport
    from fsar_ledger.witness.answers import WitnessAnswer

    from .ledger import Ledger


class Verification(Answer, msgspec.Struct, frozen=True):
    """The findings of `verify`.

    `report` comes from deriving everything again, `replay` from playing the runs again, `witnessed` from witnesses,
    `fleet` from the ledger of a lone robot's fleet. None means not requested. `path` is the ledger; `is_recorded`: the
    runs were played in the world on record.
    """

    report: "VerifyReport"
    replay: "ReplayReport | None" = None
    witnessed: "WitnessAnswer | None" = None
    path: Path = Path()
    is_recorded: bool = False
    fleet: "FleetComparison | None" = None

    @property
    def ok(self) -> bool:
        """Return whether no check found a problem, and enough witnesses saw the ledger."""
        return (
            self.report.ok
            and (self.replay is None or self.replay.ok)
            and (self.fleet is None or self.fleet.ok)
            and (self.witnessed is None or self.witnessed.is_enough)
        )

    @property
    def problems(self) -> "tuple[Problem, ...]":
        """Return where the ledger contradicts itself; differences found by a replay are in `replay.differences`."""
        return self.report.problems

    @property
    def root(self) -> str | None:
        """Return the Merkle root derived from the rows, in hex; None where there is any doubt."""
        return self.report.root

    @property
    def failure(self) -> FsarLedgerError | None:
        """The error that names each place in doubt."""
        if not self.report.ok:
            return LedgerCorrupted(*self._lines())
        if (self.replay is not None and not self.replay.ok) or (self.fleet is not None and not self.fleet.ok):
            return ReplayMismatch(*self._lines())
        if self.witnessed is not None and not self.witnessed.is_enough:
            return LedgerCorrupted(self.witnessed.doubt(self.path))
        return None

    def document(self, _: Screen) -> Mapping[str, object]:
        """Return the findings; the root in the head is null where some rows cannot be read."""
        more: dict[str, object] = {} if self.replay is None else {"replay": self.replay}
        if self.witnessed is not None:
            more["witnessed"] = self.witnessed.json()
        if self.fleet is not None:
            more["fleet"] = self.fleet
        head = {"size": self.report.events, "root": self.report.root}
        report = msgspec.to_builtins(self.report)
        if not self.report.shards:
            del report["shards"]
        return {"head": head, **report, "ok": self.ok, **more}

    def text(self, _: Screen) -> Iterator[printable.SafeText]:
        """Yield what was found consistent."""
        witnessed = self.witnessed.lines(self.report.events) if self.witnessed is not None else ()
        yield printable.lines(*self._lines(), *witnessed)

    def _lines(self) -> list[str]:
        report = _of_report(self.path, self.report)
        sections = [self._replay_lines(), self._fleet_lines()]
        doubts = [line for part in (self.replay, self.fleet) if part is not None for line in map(str, part.differences)]
        return [*(doubts or report), *(line for lines in sections for line in lines)]

    def _replay_lines(self) -> list[str]:
        """Return the lines on the replay, apart from its differences."""
        ledger, report, replay = self.path, self.report, self.replay
        if replay is None:
            return []
        if not report.ok:
            return [f"{ledger}: not replayed, as its rows are in doubt"]
        recorded = (
            [f"not replayed: {counted(replay.recordings, 'recording')} of what other systems did and decided"]
            if replay.recordings
            else []
        )
        if replay.ok and not replay.runs:
            return [
                *recorded,
                f"replayed: nothing; the ledger holds no {'other ' if recorded else ''}run",
                *replay.remarks,
            ]
        if replay.ok:
            makers = (
                "the handlers make them in the recorded world; this does not show whether that was the world of the "
                "seed"
                if self.is_recorded
                else "the world and the handlers make them"
            )
            return [
                f"replayed: all {replay.events:,} events of {counted(replay.runs, 'run')} are as {makers}",
                *recorded,
                *replay.remarks,
            ]
        doubted = report.runs - replay.recordings - replay.runs
        count = f"{doubted:,} of {report.runs:,} runs" if doubted else "what was planned"
        return [
            f"{ledger}: consistent, but replay doubts {count}; do not rely on what they say happened and was decided"
        ]

    def _fleet_lines(self) -> list[str]:
        """Return the lines on the comparison with the fleet's ledger, apart from its differences."""
        if (fleet := self.fleet) is None:
            return []
        if not self.report.ok:
            return [f"{self.path}: not compared with its fleet, as its rows are in doubt"]
        if not fleet.ok:
            return [f"{self.path}: its fleet's ledger disagrees; do not rely on what it says about a robot alone"]
        agreed = f"{counted(fleet.runs, 'founding')} and {counted(fleet.handed_over, 'hand-over')}"
        return [f"compared with its fleet: {agreed} are as both ledgers have them"]


@verb(
    "verify out/ledger",
    "verify out/ledger --quick --json",
    "verify out/ledger --replay",
    "verify out/a1 --of out/hall",
    "cp out/ledger/checkpoint monday    # keep it elsewhere; later:",
    "verify out/ledger --anchor monday --trusted-key out/fleet.key.pub",
    "verify out/ledger --witness-policy witnesses.policy --cosigned out/cosigned",
    takes=("cluster", "json"),
)
def verify(
    ledger: "Ledger",
    *,
    quick: bool = switch("Read no rows: only the chain of records, the files' hashes and the notes."),
    anchor: Place | None = declare("FILE", "Prove that the ledger only grew since this copy of LEDGER/checkpoint."),
    trusted_key: TrustedKeyOption = None,
    witness_policy: Place | None = declare(
        "FILE",
        "Ask the witnesses in this C2SP tlog-policy what they saw of the ledger; enough of them must have seen it, "
        "as it is or before it grew.",
    ),
    cosigned: Sequence[Place] = declare(
        "FILE", "With --witness-policy: use this note instead of asking; may be repeated.", value=()
    ),
    replay: bool = switch("Also replay every run: its world and its decisions must come out as recorded."),
    recorded: bool = switch("With --replay: take what the world did and answered from the ledger, not from the seed."),
    of: Place | None = declare(
        "LEDGER", "Also compare where a robot alone began, and what it handed over, with this ledger of its fleet."
    ),
    workers: WorkersOption = None,
    progress: Annotated[Progress | None, Shows("verified", "segments", {"replay": "verified and replayed"})] = None,
    now_s: Annotated[float | None, Gives("now")] = None,
) -> Verification:
    """Check a ledger: derive every hash, count and record again from its rows.

    Every fault is named with its place, and the exit code is then 3. No ledger can show by itself that all of it was
    rewritten, or that its newest commits were removed. For that, give a trusted key and an anchor (a copy of
    LEDGER/checkpoint that was kept elsewhere), or ask witnesses, who keep one. A check of all rows that finds no fault
    is remembered in the user's cache, never in the ledger; answers from this head are then `rows_verified`.

    Raises:
        NotALedger: There is none. Damage does not raise, but is in `ok` and `problems` of the answer.
        UsageError: The arguments contradict each other, or a policy is given without `now_s`, the present time in
            seconds since 1970.
    """
    from fsar_ledger.ledger.verify.report import VerifyOptions
    from fsar_ledger.metrics.verified import full_verify
    from fsar_ledger.witness.answers import answers_of

    if recorded and not replay:
        raise UsageError(
            f"{option('recorded')}: expected it with {option('replay')}, since it chooses the world of the replay"
        )
    if quick and of is not None:
        raise UsageError(f"{option('quick')} and {option('of')}: expected one of them; a quick look reads no rows")
    if quick and replay:
        raise UsageError(
            f"{option('quick')} and {option('replay')}: expected one of them; a quick look reads no rows, a replay "
            "all of them"
        )
    path, trusted = ledger.path, trusted_of(trusted_key)
    anchored = anchor_of(anchor, trusted)
    policy = None if witness_policy is None else Path(witness_policy)
    # Before the check, during which the ledger may grow.
    present_s = None if now_s is None else int(now_s)
    witnessed = answers_of(path, policy, list(map(Path, cosigned or ())), trusted, present_s)
    if trusted is None and witnessed is not None:
        trusted = witnessed.log
    options = VerifyOptions(quick, trusted, anchored, witnessed.evidence.checkpoints if witnessed is not None else ())
    report = full_verify(path, readers_of(workers, path), progress, options)
    if report.anchored is not None and is_own_checkpoint(anchored, path):
        report = msgspec.structs.replace(report, remarks=(OWN_CHECKPOINT, *report.remarks))
    replay_report = replayed(path, report, workers, progress, recorded) if replay else None
    fleet_comparison = None if of is None else _compared(path, Path(of), report, workers)
    return Verification(report, replay_report, witnessed, path, recorded, fleet_comparison)


def _compared(ledger: Path, fleet: Path, report: "VerifyReport", workers: int | None) -> "FleetComparison":
    """Compare with the fleet's ledger, once both are verified. Raises: LedgerCorrupted for the fleet's."""
    from fsar_ledger.metrics.verified import full_verify
    from fsar_ledger.runtime.isolation import FleetComparison, compared_with_fleet

    if not report.ok:
        return FleetComparison(0, 0, ())
    fleet_report = full_verify(fleet, readers_of(workers, fleet), None)
    if not fleet_report.ok:
        raise LedgerCorrupted(*_of_report(fleet, fleet_report))
    return compared_with_fleet(ledger, fleet)


def replayed(
    ledger: Path, report: "VerifyReport", workers: int | None, progress: Progress | None, is_recorded: bool = False
) -> "ReplayReport":
    """Play every verified run again; return `NOT_REPLAYED` where `verify` found a problem.

    Raises: LedgerCorrupted if the ledger was damaged in between.
    """
    from fsar_ledger.ledger.opening import open_for_answers
    from fsar_ledger.ledger.store.shards import views_of
    from fsar_ledger.runtime.replay import NOT_REPLAYED, ReplayReport, replay

    if not report.ok:
        return NOT_REPLAYED
    if not report.shards:
        return replay(ledger, readers_of(workers, ledger), progress, report.commits, is_recorded)
    reports = [
        replay(shard.path, readers_of(workers, shard.path), progress, len(shard.commits), is_recorded)
        for shard in views_of(open_for_answers(ledger))
    ]
    return ReplayReport(
        all(part.ok for part in reports),
        tuple(difference for part in reports for difference in part.differences),
        sum(part.commits for part in reports),
        sum(part.runs for part in reports),
        sum(part.events for part in reports),
        tuple(dict.fromkeys(remark for part in reports for remark in part.remarks)),
        sum(part.recordings for part in reports),
    )


def _of_report(ledger: Path, report: "VerifyReport") -> list[str]:
    """Return a line for each problem, or lines on what was found consistent."""
    if not report.ok:
        count = f"{counted(len(report.problems), 'problem')}{' at a quick look' if report.is_quick else ''}"
        return [
            *map(str, report.problems),
            f"{ledger}: {count}; do not rely on this ledger until that is explained; `fsar-ledger maintain recover` "
            "says how much of a damaged one can be trusted",
        ]
    of_runs = "" if report.is_quick else f" of {counted(report.runs, 'run')}"
    counts = f"{counted(report.events, 'event')}{of_runs} in {counted(report.commits, 'commit')}"
    if report.shards:
        counts = f"{counted(report.events, 'head')} of {counted(report.shards, 'shard')}" + (
            "" if report.is_quick else f", which have {counted(report.runs, 'run')}"
        )
    verdict = "consistent at a quick look, which reads no rows" if report.is_quick else "consistent"
    lines = [f"{ledger}: {verdict}, {signature_text(report.signature, report.signer)}: {counts}", f"root {report.root}"]
    lines += [f"signed commits: {report.signed:,} of {report.commits:,}"] if report.signed else []
    lines += (
        [f"only grew since the anchor's {report.anchored:,} events"]
        if report.anchored is not None and not report.is_quick
        else []
    )  # a quick check says it in a remark
    lines += [f"not looked at: {', '.join(report.not_looked_at)}"] if report.not_looked_at else []
    return [*lines, *report.remarks]
