"""The command `simulate`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import (
    AdoptOption,
    ArchitectureOption,
    FleetOption,
    FleetSizeOption,
    JsonOption,
    KeyOption,
    NewLedgerArgument,
    OriginOption,
    RunsOption,
    ScenarioOption,
    SetOption,
    TaskSetsOption,
    TeamsWorkingOption,
    WithoutOption,
    WorkersOption,
    WorkflowOption,
    examples,
)
from fsar_ledger.cli.progress import Progress
from fsar_ledger.cli.terminal import show
from fsar_ledger.printable import Shown, counted

if TYPE_CHECKING:
    from fsar_ledger.runtime.experiment import Made

EXAMPLES = examples(
    "fsar-ledger simulate out/ledger",
    "fsar-ledger simulate out/doors --architecture fsar --scenario door-relay --runs 3 --seed 7",
    "fsar-ledger simulate out/doors --architecture fsar --scenario door-relay --runs 5 --seed 7    # enlarges it",
    "fsar-ledger simulate out/untrusting --without trust-evaluation --runs 2",
    "fsar-ledger simulate out/workflows --workflow door-relay --workflow layered-recovery --workflow human-supervision",
    "fsar-ledger simulate out/signed --scenario door-relay --runs 1 --key out/fleet.key",
    "fsar-ledger simulate out/named --scenario door-relay --runs 1 --origin example.org/fleet",
    (
        "fsar-ledger simulate out/large --architecture cfc --scenario fleet-contention --fleet-size 16 "
        "--teams-working 2 --runs 2"
    ),
    "fsar-ledger simulate out/reviewed --scenario door-relay --set world.review_share=0.5 --runs 2",
)
AFTER_INTERRUPTION = "what is committed stays, and the same command continues there"


def simulate(
    out: NewLedgerArgument,
    architecture: ArchitectureOption = None,
    scenario: ScenarioOption = None,
    workflow: WorkflowOption = None,
    runs: RunsOption = None,
    seed: Annotated[int, typer.Option(metavar="N", help="Decides every draw of the world.")] = 42,
    fleet: FleetOption = None,
    settings: SetOption = None,
    fleet_size: FleetSizeOption = None,
    teams_working: TeamsWorkingOption = None,
    task_sets: TaskSetsOption = 1,
    without: WithoutOption = None,
    origin: OriginOption = None,
    key: KeyOption = None,
    adopt: AdoptOption = False,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Simulate fleets, and append every event to the ledger OUT.

    Called again, an interrupted simulation continues where it stopped. With more --runs, or other scenarios, it adds
    what is missing.
    """
    from fsar_ledger.api.functions import simulate as make

    with Progress("simulated", "batches") as progress:
        made = make(
            out,
            architecture=architecture,
            scenario=scenario,
            workflow=workflow,
            runs=runs,
            seed=seed,
            fleet=fleet,
            settings=settings,
            fleet_size=fleet_size,
            teams_working=teams_working,
            task_sets=task_sets,
            without=without,
            origin=origin,
            key=key,
            adopt=adopt,
            workers=workers,
            progress=progress,
        ).made
    show(_text(out, made, [] if key is None else _signed(out, key), as_json=as_json))


def _text(out: Path, made: "Made", signed: list[str], *, as_json: bool) -> Shown:
    """Return the head of the ledger, what was there before, and its signature."""
    from fsar_ledger.cli.output import json_text

    head = made.head
    if as_json:
        counts = {"runs_asked": made.asked, "runs_made": made.made, "runs_held": made.held}
        return json_text(head, {"ledger": str(out), "commits": head.commits, **counts})
    return printable.lines(
        f"{out}: {printable.counted(head.size, 'event')} in {printable.counted(head.commits, 'commit')}",
        f"root {head.root}",
        *before(made),
        *signed,
    )


def before(made: "Made") -> list[str]:
    """Return a line on the runs that were there already, if there were any."""
    more = made.held - made.asked
    others = f", and {more:,} more" if more else ""
    if not made.made:
        return [
            (
                f"nothing to do: the {counted(made.asked, 'run')} asked for {'is' if made.asked == 1 else 'are'} "
                f"there{others}"
            )
        ]
    if made.made < made.asked:
        there = made.asked - made.made
        return [
            f"made {counted(made.made, 'run')}; of the {made.asked:,} asked for {there:,} were there already{others}"
        ]
    return [f"made {counted(made.made, 'run')}, beside {more:,} of other experiments"] if more else []


def _signed(ledger: Path, key: Path) -> list[str]:
    """Return a line on whether this key signed the newest commit."""
    from fsar_ledger.ledger.log.note import signers_of
    from fsar_ledger.ledger.opening import open_ledger
    from fsar_ledger.ledger.store.keys import read_signer

    note = open_ledger(ledger).note()
    signers = None if note is None else signers_of(note)
    if signers == read_signer(key).verifier.key:
        return [f"signed by {printable.value(signers)}"]
    return [
        (
            "nothing was appended, so nothing was signed; the newest commit is "
            f"{f'signed by {printable.value(signers)}' if signers else 'unsigned'}"
        )
    ]
