"""The command `state`: a fleet at a moment of a run."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from fsar_ledger import printable
from fsar_ledger.cli.options import JsonOption, LedgerArgument, OneRunOption, VerifiedOption, examples
from fsar_ledger.cli.terminal import show
from fsar_ledger.printable import Shown

if TYPE_CHECKING:
    from fsar_ledger.analysis.beliefs import Belief
    from fsar_ledger.analysis.standing import RobotNow, Standing
    from fsar_ledger.api.ledger import Ledger
    from fsar_ledger.api.state import Moment

EXAMPLES = examples(
    "fsar-ledger state out/ledger --run 1 --at 46.6s",
    "fsar-ledger state out/ledger --run 2 --at 72s --as-known-by coordinator",
    "fsar-ledger state out/ledger --run 1 --at 72s --robot B1 --json",
)
BESIDE = "    "


def state(
    ledger: LedgerArgument,
    run: OneRunOption,
    at: Annotated[
        str | None,
        typer.Option("--at", metavar="TIME", help="Within the run: 46.6, 46.6s or 46600ms.", show_default="its end"),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option("--robot", metavar="ROBOT", help="Only what this robot has a part in.", show_default="all"),
    ] = None,
    as_known_by: Annotated[
        str | None,
        typer.Option(
            "--as-known-by",
            metavar="DECIDER",
            help="Also what it had been told: coordinator, robot/A1, service/registry, agent/A1/planning.",
            show_default=False,
        ),
    ] = None,
    by_commit: Annotated[
        int | None,
        typer.Option(
            "--by-commit", metavar="N", help="From what the ledger had recorded after N commits.", show_default="all"
        ),
    ] = None,
    verified: VerifiedOption = False,
    as_json: JsonOption = False,
) -> None:
    """Show a fleet at a moment of a run: who does what, what waits, what is in force, and what is open.

    There are two times: --at is when it held in the run, and --by-commit what the ledger had recorded. With
    --as-known-by also what a decider had been told by then, how old that is, and what held: its decisions rest on the
    former.
    """
    from fsar_ledger.cli.answering import opened, warn

    asked = opened(ledger, verified=verified)
    found = asked.state(run, at, robot=robot, as_known_by=as_known_by, by_commit=by_commit)
    warn(ledger, found.provenance)
    show(_json(found) if as_json else printable.lines(*_lines(asked, found)))


def _json(found: "Moment") -> Shown:
    from msgspec import structs

    from fsar_ledger.cli.output import answer_json

    answer = {name: value for name, value in structs.asdict(found).items() if name not in ("provenance", "state")}
    return answer_json(found.provenance, answer)


def _lines(asked: "Ledger", found: "Moment") -> Iterator[str]:
    from fsar_ledger.cli.output import run_text

    yield run_text(found.run, asked.numbers().get(found.run))
    yield f"at {found.at_s:.3f} s of {found.ends_s:.3f} s, after event {found.seq} at {found.event_s:.3f} s"
    yield f"recorded with commit {found.commit}"
    yield from standing_lines(found.standing)
    if found.beliefs is not None:
        yield ""
        yield "what it had been told, and what held"
        yield from (f"{BESIDE}{line}" for line in map(_belief, found.beliefs))


def standing_lines(found: "Standing") -> Iterator[str]:
    """Yield how things stand: a paragraph for each robot, and one for each kind of what is open."""
    for robot in found.robots or ():
        yield ""
        yield from _robot(robot)
    for name, lines in _lists(found):
        if lines:
            yield ""
            yield name
            yield from (f"{BESIDE}{line}" for line in lines)
    if found.not_observed:
        yield ""
        yield f"not observed, so that nothing is said of it: {', '.join(found.not_observed)}"


def _robot(one: "RobotNow") -> Iterator[str]:
    signs = [f"supervisor {printable.value(one.supervisor)}"] if one.supervisor else ["no supervisor"]
    signs += ["OFF"] if one.is_on is False else []
    signs += ["NOT LINKED"] if one.is_linked is False else []
    signs += [f"actuator {one.grade}"] if one.grade else []
    yield f"{printable.value(one.robot)}  role {printable.value(one.role)}, team {one.team}; {', '.join(signs)}"
    work = one.work
    if work is None:
        yield f"{BESIDE}{'idle' if one.is_idle else 'what it does is not observed'}"
    else:
        what = f" {printable.value(work.capability)}" if work.capability else ""
        whose = f" for {printable.value(work.on_behalf_of)}" if work.on_behalf_of else ""
        until = "" if work.ends_s is None else f", until {work.ends_s:.3f} s"
        yield f"{BESIDE}{work.stage} {printable.value(work.action_id)}{what}{whose}{until}"
    if one.queue:
        yield f"{BESIDE}waiting: {printable.some(map(printable.value, one.queue))}"
    if one.obstructions:
        yield f"{BESIDE}in its way: {printable.some(map(printable.value, one.obstructions))}"
    for window in one.windows or ():
        yield (
            f"{BESIDE}{window.scope} policy: {window.outcome}, window {printable.value(window.window)} since "
            f"{window.since_s:.3f} s (event {window.seq})"
        )
    for availability, names in (one.offers or {}).items():
        if availability != "ready":
            yield f"{BESIDE}offers as {availability}: {printable.some(map(printable.value, names))}"


def _lists(found: "Standing") -> Iterator[tuple[str, list[str]]]:
    text = printable.value
    yield (
        "tasks",
        [
            f"{text(one.task_id)} of {text(one.robot)}: {one.steps_done}"
            + (" steps done" if one.steps is None else f" of {one.steps} steps done")
            + (f", now {text(one.step)}" if one.step else "")
            + (f", attempt {one.attempt}" if one.attempt > 1 else "")
            + ("; its arrival is not on record" if one.due_s is None else f"; due {one.due_s:.3f} s")
            for one in found.tasks or ()
        ],
    )
    yield (
        "requests",
        [
            f"{text(one.action_id)} {text(one.capability)}: {text(one.requester)} -> {text(one.target or '?')}, "
            f"{one.phase}"
            for one in found.requests or ()
            if one.target != one.requester
        ],
    )
    yield "claims", [f"{text(one.action_id)} {one.dimension}: {text(one.claimant)}" for one in found.claims or ()]
    yield (
        "recoveries",
        [
            f"{text(one.action_id)} at {text(one.robot)}: {one.cause or 'cause not on record'}, level {one.level}, "
            f"{one.attempts} attempts" + ("" if one.since_s is None else f", since {one.since_s:.3f} s")
            for one in found.recoveries or ()
        ],
    )
    yield (
        "calls",
        [
            f"{one.number}: {text(one.supervisor)} about {text(one.action_id)}, {one.purpose}"
            for one in found.calls or ()
        ],
    )
    yield "supervisors off shift", [text(one) for one in found.off_shift or ()]
    yield (
        "rules",
        [
            f"{one.scope} {one.outcome} for {text(one.robot or 'every robot')}"
            + (f", {text(one.capability)}" if one.capability else "")
            + (f", task {text(one.task)}" if one.task else "")
            for one in found.rules or ()
        ],
    )
    yield (
        "trust",
        [
            f"{text(one.robot)} -> {text(one.peer)}: {one.scope}"
            + (f", {text(one.capability)}" if one.capability else "")
            + (f", task {text(one.task)}" if one.task else "")
            for one in found.trust or ()
        ],
    )


def _belief(one: "Belief") -> str:
    about = f"{printable.value(one.about)}, {one.what}"
    holds = "what holds is not observed" if one.holds is None else f"is {one.holds}"
    if one.believed is None:
        return f"{about}: {'never told' if one.was_told is False else 'what it was told is not observed'}; {holds}"
    age = "" if one.age_s is None else f" ({one.age_s:.3f} s old)"
    return f"{about}: {one.believed}{age}" + (f", {holds}" if one.is_stale is not False else "")
