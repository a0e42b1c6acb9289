"""Pins what each set-up installs: `python .ci/pin.py`, after a change of a `requirements*.in`. It needs `uv`.

Each `requirements*.txt` starts with the one before and holds only what it adds, so that a version stands in one place.
Versions that are pinned already stay while the `.in` files allow them.
"""

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SETS = ("requirements", "requirements-test", "requirements-all")
COMPILE = ("uv", "pip", "compile", "--quiet", "--universal", "--python-version", "3.11", "--generate-hashes")


def entries(text: str) -> dict[str, str]:
    """Return each pinned requirement with its hashes, by its first line."""
    found = re.findall(r"^(\S+==[^\\]+?) \\\n((?:    .*\n)+)", text, flags=re.MULTILINE)
    return {head: f"{head} \\\n{rest}" for head, rest in found}


def main() -> None:
    """Write the three files, smallest first."""
    kept = "".join(path.read_text("utf-8") for path in sorted(ROOT.glob("requirements*.txt")))
    known: dict[str, str] = {}
    for at, name in enumerate(SETS):
        pins = ROOT / f"{name}.pins"
        pins.write_text("".join(entries(kept).values()), "utf-8")  # uv prefers the versions that it finds here
        try:
            subprocess.run([*COMPILE, "--no-header", "--output-file", pins.name, f"{name}.in"], cwd=ROOT, check=True)
            found = entries(pins.read_text("utf-8"))
        finally:
            pins.unlink()
        before = f"-r {SETS[at - 1]}.txt\n" if at else ""
        added = "".join(text for head, text in found.items() if head not in known)
        (ROOT / f"{name}.txt").write_text(before + added, "utf-8")
        known |= found


if __name__ == "__main__":
    main()
