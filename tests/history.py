"""Shows from the history of the repository that each stage of the evaluation came before what follows from it.

`python -m tests.history` walks the stages: the registration, the fit, the predictions, the comparison. Each is a file,
and its stage is the last commit that changed what it says, but for the digests of queries (`rules`), which are renewed
when the same results were made again (`python -m tests.records`), and for the verb that does so (`command`). The
commits must come in this order. Between the first and the last no file of the model may change, except for the values
of the constants that the fit was free to choose. Exit code 1 names what does not hold; a missing stage is reported.
"""

import json
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from fsar_ledger.metrics.registration import registration
from tests.running import ran

ROOT = Path(__file__).parent.parent
STAGES = (
    ("registration", "reports/registration.toml"),
    ("fit", "reports/calibration.json"),
    ("predictions", "reports/predictions.json"),
    ("comparison", "reports/comparison.json"),
)
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


def findings(root: Path = ROOT, stages: Sequence[tuple[str, str]] = STAGES) -> Iterator[str]:
    """Yield a sentence for each thing that does not hold."""
    commits = [(name, path, stage(root, path)) for name, path in stages]
    made = [(name, path, commit) for name, path, commit in commits if commit]
    for (first, _, earlier), (second, path, later) in pairwise(made):
        if earlier == later or not is_before(root, earlier, later):
            yield (
                f"{second} ({path}, {later[:12]}) does not come after the {first} ({earlier[:12]}); "
                "expected a later commit of its own"
            )
    if not made or made[0][0] != stages[0][0]:
        yield f"{stages[0][1]}: found no commit that adds it, expected the registration before anything else"
        return
    start = made[0][2]
    end = made[-1][2] if len(made) == len(stages) else git(root, "rev-parse", "HEAD")
    for changed in git(root, "diff", "--name-only", start, end, "--", *MODEL).splitlines():
        yield (
            f"{changed} changed between the registration ({start[:12]}) and the {made[-1][0]} ({end[:12]}); "
            "expected a new registration"
        )
    yield from constants_changed(git(root, "diff", "-U0", start, end, "--", CONSTANTS))


def stage(root: Path, path: str) -> str:
    """Return the last commit that changed what the file says, the digests of queries aside; empty if there is none."""
    found, said = "", None
    for commit in git(root, "log", "--format=%H", "--", path).split():
        says = results_of(git(root, "show", f"{commit}:{path}"))
        if said is not None and says != said:
            break
        found, said = commit, says
    return found


def results_of(text: str) -> object:
    """Return what a file says: a record without the digests of its queries and its verb, any other file its text."""
    try:
        record = json.loads(text)
    except ValueError:
        return text
    if not isinstance(record, dict):
        return record
    return {name: part for name, part in record.items() if name not in ("rules", "command")}


def is_before(root: Path, earlier: str, later: str) -> bool:
    """Return whether one commit is an ancestor of the other."""
    return (
        subprocess.run(["git", "-C", str(root), "merge-base", "--is-ancestor", earlier, later], check=False).returncode
        == 0
    )


def constants_changed(diff: str) -> Iterator[str]:
    """Yield each change of a constant that was not free, or of more than its value."""
    free = {one.name.partition(".")[2] for one in registration().free}
    lines = [line for line in diff.splitlines() if line[:1] in "+-" and line[:3] not in ("+++", "---")]
    before, after = ({nameless(line[1:]) for line in lines if line[0] == sign} for sign in "-+")
    for name, text in sorted(before ^ after, key=str):
        if name not in free or (name, text) not in before & after:
            yield f"{CONSTANTS}: {text.strip()} changed; expected no change but the values of the free constants"


def nameless(line: str) -> tuple[str, str]:
    """Return the name of the constant of a line and the line without the constant's value."""
    found = re.match(r"\s*(\w+): Fitted\[\w+\] = ([\d._]+)(.*)", line)
    return (found[1], f"{found[1]}: Fitted{found[3]}") if found else ("", line)


def main() -> None:
    """Print the stages and what does not hold; return 1 if anything does not."""
    for name, path in STAGES:
        commit = stage(ROOT, path)
        print(
            f"{name:13} {git(ROOT, 'log', '-1', '--format=%h %as %s', commit) if commit else f'not made yet ({path})'}"
        )
    found = list(findings())
    print(*found, sep="\n")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
