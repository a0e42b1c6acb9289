"""The entry of the command `fsar-ledger` and of `python -m fsar_ledger`."""

import atexit
import gc
import os
import sys
from types import TracebackType

from . import __version__, printable
from .cli.terminal import Enough, say, say_failure, show
from .errors import WriteFailed


def main() -> None:
    """The command has run and the process has ended with its exit code; `--version` answers before anything slow is imported."""
    sys.excepthook = _failed
    if sys.argv[1:] == ["--version"]:
        try:
            show(printable.line(f"fsar-ledger {__version__}"))
        except Enough:
            pass
        except WriteFailed as problem:
            say(str(problem))
            sys.exit(1)
        return
    if os.name != "posix":
        say(f"found an operating system that is not POSIX ({os.name}), expected Linux or macOS; on Windows use WSL")
        sys.exit(2)
    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", "1"
    )  # nothing here multiplies matrices that are worth a thread, and each takes its time to start
    gc.set_threshold(50_000, 20, 100)  # libraries make many objects as they are imported, and no garbage
    try:
        from .cli.app import run
    except KeyboardInterrupt:
        say("interrupted; nothing was changed")
        sys.exit(130)
    code = run(sys.argv[1:])
    atexit._run_exitfuncs()  # libraries clean up after themselves: matplotlib takes its folder away
    os._exit(
        code
    )  # all is written and closed; to take the libraries down again would take a tenth of a short command's time


def _failed(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """A mistake of ours ends the process with Python's own words; they may quote a ledger."""
    import traceback

    say_failure("".join(traceback.format_exception(kind, error, trace)))


if __name__ == "__main__":
    main()
