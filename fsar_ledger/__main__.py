"""The entry of the command `fsar-ledger` and of `python -m fsar_ledger`."""

import os
import sys

from . import __version__


def main() -> None:
    """The command has run and the process has ended with its exit code; `--version` answers before anything slow is imported."""
    if sys.argv[1:] == ["--version"]:
        print(f"fsar-ledger {__version__}")
        return
    if os.name != "posix":
        sys.stderr.write(f"fsar-ledger: found an operating system that is not POSIX ({os.name}), expected Linux or macOS; on Windows use WSL\n")
        sys.exit(2)
    try:
        from .cli import run
    except KeyboardInterrupt:
        sys.stderr.write("fsar-ledger: interrupted; nothing was changed\n")
        sys.exit(130)
    sys.exit(run(sys.argv[1:]))


if __name__ == "__main__":
    main()
