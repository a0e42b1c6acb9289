"""Builds the script and the style of the page that `fsar-ledger view` writes: `make page`. It needs Node and npm.

The sources are in `fsar_ledger/view/src`; what is built from them is committed beside them, so that only who changes
the sources needs Node. `--check` builds and compares, and changes nothing.
"""

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VIEW = ROOT / "fsar_ledger" / "view"
SOURCES = VIEW / "src"
TOOLS = ROOT / "build" / "page"
BUILT = {"page.js": "main.ts", "page.css": "page.css"}
OPTIONS = ("--bundle", "--minify", "--format=iife", "--target=es2020", "--charset=ascii", "--legal-comments=none")


def install() -> None:
    """Install the tools that package-lock.json pins, with their hashes, unless they are there."""
    lock = (SOURCES / "package-lock.json").read_bytes()
    stamp = TOOLS / "installed.json"
    if shutil.which("npm") is None:
        sys.exit(".ci/page.py: found no npm, expected Node and npm; install them (Debian: nodejs npm)")
    if stamp.exists() and stamp.read_bytes() == lock:
        return
    TOOLS.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "package-lock.json"):
        shutil.copy(SOURCES / name, TOOLS)
    subprocess.run(["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"], cwd=TOOLS, check=True)
    stamp.write_bytes(lock)


def build(out: Path) -> None:
    """Check the types and write what is built into this folder."""
    tools = TOOLS / "node_modules" / ".bin"
    subprocess.run([tools / "tsc", "--project", SOURCES], check=True)
    for name, source in BUILT.items():
        options = OPTIONS if source.endswith(".ts") else ("--minify", "--charset=ascii")
        command = [tools / "esbuild", source, *options, "--log-level=warning", f"--outfile={out / name}"]
        subprocess.run(command, cwd=SOURCES, check=True)


def stale(out: Path) -> list[str]:
    """Return the files in this folder that are not what is committed."""
    return [name for name in BUILT if (out / name).read_bytes() != (VIEW / name).read_bytes()]


def main(arguments: list[str]) -> int:
    """Build, and with `--check` only compare; return the exit code."""
    install()
    if arguments != ["--check"]:
        build(VIEW)
        return 0
    out = TOOLS / "built"
    build(out)
    for name in (found := stale(out)):
        print(f"fsar_ledger/view/{name}: not what its sources give; run `make page` and commit it", file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
