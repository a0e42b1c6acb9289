"""Worker processes that leave Ctrl-C to the command that started them."""

import signal
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


class WorkerPool(ProcessPoolExecutor):
    """A pool of fresh processes (spawned: DuckDB and Polars do not survive a fork), deaf to Ctrl-C from their first moment.

    A process inherits the signals that are held back while it starts, and a submission is what starts it.
    Leaving the pool drops what has not begun and waits for what has.
    """

    def __init__(self, workers: int) -> None:
        super().__init__(workers, mp_context=get_context("spawn"))

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """The call is queued, as in any executor."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def __exit__(self, *_error: Any) -> None:
        self.shutdown(wait=True, cancel_futures=True)
