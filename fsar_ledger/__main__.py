"""The entry point of the command `fsar-ledger` and of `python -m fsar_ledger`."""

import atexit
import gc
import os
import signal
import sys
from types import TracebackType

from . import __version__
from .base import printable
from .base.errors import WriteFailed
from .cli.terminal import OutputClosed, say, say_failure, show


def main() -> None:
    """Run the command and exit with its code; answer `--version` before anything slow is imported."""
    sys.excepthook = _report_error
    _hold_streams()
    if sys.argv[1:] == ["--version"]:
        try:
            show(printable.line(f"fsar-ledger {__version__}"))
        except OutputClosed:
            pass
        except WriteFailed as problem:
            say(str(problem))
            sys.exit(1)
        return
    if os.name != "posix":
        say(f"found an operating system that is not POSIX ({os.name}), expected Linux or macOS; on Windows use WSL")
        sys.exit(2)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads take time to start; no matrix here is worth one
    gc.set_threshold(50_000, 20, 100)  # imports make many objects and little garbage
    try:
        from .base.memory import leave_out_pandas
        from .cli.app import run

        leave_out_pandas()
    except KeyboardInterrupt:
        say("interrupted; nothing was changed")
        sys.exit(130)
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _end)
    code = run(sys.argv[1:])
    atexit._run_exitfuncs()  # libraries clean up after themselves: matplotlib removes its folder
    os._exit(code)  # everything is written and closed; unloading libraries makes a short command a tenth slower


def _hold_streams() -> None:
    """Point standard streams that are closed at nothing, so that no file of ours takes their numbers."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number
    sys.stdin = sys.stdin or os.fdopen(0, closefd=False)  # Python has none where it was closed; it is empty


def _end(number: int, _: object) -> None:
    """End by this signal, as without a handler, but leave no temporary files."""
    from .base.memory import remove_unfinished

    remove_unfinished()
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


def _report_error(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print an unexpected error as Python words it, escaped because it may quote a ledger."""
    import traceback

    say_failure("".join(traceback.format_exception(kind, error, trace)))


if __name__ == "__main__":
    main()
