"""Shows from the history of the repository that each stage of the evaluation came before what follows from it.

`python -m tests.history` walks the stages. Each is a file, and its stage is the last commit that changed what it says,
but for what is renewed when the same results were made again (`python -m tests.records`): the digests of queries
(`rules`), the verb that does so (`command`) and the time that it took (`cpu_minutes`). A stage must come after those
that it follows from. Between the registration and any of them no file of the model may change, except for the values of
the constants that the fit was free to choose. Exit code 1 names what does not hold; a missing stage is reported.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from fsar_ledger.metrics.registration import registration
from tests.running import ran

ROOT = Path(__file__).parent.parent


class Stage(NamedTuple):
    """A file, and the stages after which it is made.

    `is_of_fit`: no file of the model may change between the registration and it.
    """

    name: str
    path: str
    after: tuple[str, ...]
    is_of_fit: bool = True


STAGES = (
    Stage("registration", "reports/registration.toml", ()),
    Stage("ranking", "reports/ranking.json", ("registration",)),
    Stage("fit", "reports/calibration.json", ("registration", "ranking")),
    Stage("predictions", "reports/predictions.json", ("fit",)),
    Stage("comparison", "reports/comparison.json", ("predictions",)),
    Stage("ensemble", "reports/ensemble.json", ("fit",)),
    Stage("sensitivity", "reports/sensitivity.json", ("fit",)),
    Stage("placebo", "reports/placebo.json", ("fit",)),
    Stage("dials", "fsar_ledger/designs/dials.py", ("fit",), is_of_fit=False),
    Stage("systems", "reports/systems.json", ("dials",), is_of_fit=False),
)
REGISTRATION = STAGES[0]
LAST = "comparison"
"""Until this is made, no file of the model may change at all."""
RENEWED = ("rules", "command", "cpu_minutes")
MODEL = (
    "fsar_ledger/runtime/architectures",
    "fsar_ledger/runtime/handlers",
    "fsar_ledger/runtime/world",
    "fsar_ledger/runtime/kernel.py",
)
CONSTANTS = "fsar_ledger/designs/constants.py"


def git(root: Path, *arguments: str) -> str:
    """Return what git prints in this repository. Raises: subprocess.CalledProcessError."""
    return ran(["git", "-C", str(root), *arguments], check=True).stdout.strip()


def findings(root: Path = ROOT, stages: Sequence[Stage] = STAGES) -> Iterator[str]:
    """Yield a sentence for each thing that does not hold."""
    made = {one.name: commit for one in stages if (commit := stage(root, one.path))}
    if (start := made.get(REGISTRATION.name)) is None:
        yield f"{REGISTRATION.path}: found no commit that adds it, expected the registration before anything else"
        return
    for one in stages:
        for earlier in one.after:
            if {one.name, earlier} <= made.keys() and not is_before(root, made[earlier], made[one.name]):
                yield (
                    f"{one.name} ({one.path}, {made[one.name][:12]}) does not come after the {earlier} "
                    f"({made[earlier][:12]}); expected a later commit of its own"
                )
    of_fit = [made[one.name] for one in stages if one.is_of_fit and one.name in made]
    ends = dict.fromkeys([*of_fit, *([] if LAST in made else [git(root, "rev-parse", "HEAD")])])
    changed = dict.fromkeys(change for end in ends for change in model_changed(root, start, end))
    yield from (f"{change} between the registration ({start[:12]}) and what follows from it" for change in changed)


def model_changed(root: Path, start: str, end: str) -> Iterator[str]:
    """Yield what changed of the model between two commits, the values of the free constants aside."""
    for path in git(root, "diff", "--name-only", start, end, "--", *MODEL).splitlines():
        yield f"{path} changed"
    yield from constants_changed(git(root, "diff", "-U0", start, end, "--", CONSTANTS))


def stage(root: Path, path: str) -> str:
    """Return the last commit that changed what the file says, what is renewed aside; empty if there is none."""
    found, said = "", None
    for commit in git(root, "log", "--format=%H", "--", path).split():
        says = results_of(git(root, "show", f"{commit}:{path}"))
        if said is not None and says != said:
            break
        found, said = commit, says
    return found


def results_of(text: str) -> object:
    """Return what a file says: a record without what is renewed with the same results, any other file its text."""
    try:
        record = json.loads(text)
    except ValueError:
        return text
    if not isinstance(record, dict):
        return record
    return {name: part for name, part in record.items() if name not in RENEWED}


def is_before(root: Path, earlier: str, later: str) -> bool:
    """Return whether one commit is an ancestor of the other, and not the same."""
    return (
        earlier != later
        and subprocess.run(
            ["git", "-C", str(root), "merge-base", "--is-ancestor", earlier, later], check=False
        ).returncode
        == 0
    )


def constants_changed(diff: str) -> Iterator[str]:
    """Yield each change of a constant that was not free, or of more than its value."""
    free = {one.name.partition(".")[2] for one in registration().free}
    lines = [line for line in diff.splitlines() if line[:1] in "+-" and line[:3] not in ("+++", "---")]
    before, after = ({nameless(line[1:]) for line in lines if line[0] == sign} for sign in "-+")
    for name, text in sorted(before ^ after, key=str):
        if name not in free or (name, text) not in before & after:
            yield f"{CONSTANTS}: {text.strip()} changed, which is not the value of a free constant,"


def nameless(line: str) -> tuple[str, str]:
    """Return the name of the constant of a line and the line without the constant's value."""
    found = re.match(r"\s*(\w+): Fitted\[\w+\] = ([\d._]+)(.*)", line)
    return (found[1], f"{found[1]}: Fitted{found[3]}") if found else ("", line)


def main() -> None:
    """Print the stages and what does not hold; return 1 if anything does not."""
    for name, path, *_ in STAGES:
        commit = stage(ROOT, path)
        print(
            f"{name:13} {git(ROOT, 'log', '-1', '--format=%h %as %s', commit) if commit else f'not made yet ({path})'}"
        )
    found = list(findings())
    print(*found, sep="\n")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
