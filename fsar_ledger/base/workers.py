"""Worker processes that leave Ctrl-C to the command that started them, end with it, and cannot die unnoticed.

Each worker holds the only other end of its own pipe, so the pipe ends whenever it dies, even halfway through an answer.
(The standard library's pool shares one queue: a process killed while writing to it leaves every reader waiting.)
"""

import os
import pickle
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from multiprocessing import connection, get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

from fsar_ledger.base.errors import UsageError, WorkerDied, checked, option
from fsar_ledger.base.memory import leave_out_pandas

_P = ParamSpec("_P")
_T = TypeVar("_T")
_SPAWN = get_context("spawn")  # DuckDB and Polars do not survive a fork
_STARTING = threading.Lock()


class _Worker:
    """A process, our end of its pipe, and the call in progress."""

    def __init__(self) -> None:
        """Start the process. Raises: OSError if it cannot be started or dies at once."""
        self.pipe, theirs = _SPAWN.Pipe()
        self.process: BaseProcess = _SPAWN.Process(target=_work, args=(theirs,), daemon=True)
        self.running: Future[Any] | None = None
        try:
            with _without_main():
                self.process.start()
        except OSError:
            self.pipe.close()
            raise
        finally:
            theirs.close()


@contextmanager
def _without_main() -> Iterator[None]:
    """Keep processes that start in this context from importing the caller's main module.

    Calls name functions of installed modules, so a worker does not need it, and a script without
    `if __name__ == "__main__"` would run again in each worker.
    """
    with _STARTING:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = main


_CLUSTER: "ContextVar[Cluster | None]" = ContextVar("cluster", default=None)
CLUSTERS = "the address of a Dask scheduler (tcp://HOST:PORT), or local:N for N processes of this machine"
RETRIES = 3
"""How many times a call is retried after its worker died."""


class Cluster(Executor):
    """The workers of a Dask cluster, used like a `WorkerPool`. A call whose worker dies is retried on another.

    They run this version, and see the ledgers under the same paths.
    """

    def __init__(self, client: Any, address: str) -> None:
        self._client, self._address = client, address
        self._executor = client.get_executor(pure=False, retries=RETRIES)
        programs = client.run(_program)
        if mismatches := sorted({*programs.values()} - {_program()}):
            raise UsageError(
                f"{option('cluster', address)}: found workers with {', '.join(mismatches)}, expected {_program()} as "
                "here; install the same there"
            )
        self.workers = max(1, sum(client.nthreads().values()))

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Queue the call, as in any executor; its result raises WorkerDied if the cluster cannot finish it."""
        future: Future[_T] = Future()
        dask_future = self._executor.submit(fn, *args, **kwargs)
        dask_future.add_done_callback(lambda done: _pass_on(done, future, self._address))
        return future


def _pass_on(done: Future[_T], to: Future[_T], address: str) -> None:
    """Pass on the result or exception of a call; exceptions of Dask itself become WorkerDied."""
    try:
        to.set_result(done.result())
    except BaseException as error:
        if type(error).__module__.startswith(("distributed", "concurrent", "asyncio", "tornado")):
            dead = WorkerDied(f"cluster {address}: found {type(error).__name__} ({error}), {_EXPECTED}")
            dead.__cause__ = error
            error = dead
        to.set_exception(error)


def _program() -> str:
    """Return the name and version of this program."""
    from fsar_ledger import __version__

    return f"fsar-ledger {__version__}"


@checked
@contextmanager
def cluster(address: str | None) -> Iterator[None]:
    """Run all parallel work on this cluster, or with None in processes of this machine.

    `address` is that of a Dask scheduler, or local:N for N processes.

    Raises:
        UsageError: Dask is not installed, the address is malformed, no scheduler answers there, or versions differ.
    """
    if address is None:
        yield
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise UsageError(
            f"{option('cluster', address)}: needs Dask; install it with `pip install 'fsar-ledger[cluster]'`"
        ) from error
    count = local_processes(address)
    if (count is not None and not 0 < count <= MOST_LOCAL) or not address.partition(":")[2]:
        raise UsageError(f"{option('cluster', address)}: expected {CLUSTERS}")
    with ExitStack() as stack:
        try:
            if count is not None:
                with _without_main():
                    local_cluster = LocalCluster(
                        n_workers=count,
                        threads_per_worker=1,
                        dashboard_address=":0",
                        silence_logs=50,
                    )
                client = stack.enter_context(Client(stack.enter_context(local_cluster)))
            else:
                client = stack.enter_context(Client(address, timeout=TIMEOUT))
        except (OSError, ValueError) as error:
            raise UsageError(
                f"{option('cluster', address)}: found no scheduler there ({error}), expected {CLUSTERS}"
            ) from error
        token = _CLUSTER.set(Cluster(client, address))
        try:
            yield
        finally:
            _CLUSTER.reset(token)


def local_processes(address: str) -> int | None:
    """Return the number of processes in a local:N address, 0 if N is not a number; None for another cluster."""
    kind, _, number = address.partition(":")
    return None if kind != "local" else int(number) if number.isdecimal() else 0


MOST_LOCAL = 256
TIMEOUT = "10s"


def workers_of_cluster() -> int | None:
    """Return the number of workers of the current cluster; None if there is none."""
    current = _CLUSTER.get()
    return None if current is None else current.workers


@contextmanager
def pool_of(workers: "int | WorkerPool", parts: int = sys.maxsize) -> "Iterator[Cluster | WorkerPool | None]":
    """Yield the executor for this many parts of work: the cluster, this pool, or a new pool of this many processes.

    It is None if one process does it all.
    """
    most = min(workers.workers if isinstance(workers, WorkerPool) else workers, parts)
    if (current := _CLUSTER.get()) is not None:
        yield current
    elif most <= 1:
        yield None
    elif isinstance(workers, WorkerPool):
        yield workers
    else:
        with WorkerPool(most) as pool:
            yield pool


class WorkerPool(Executor):
    """A pool of fresh processes that ignore Ctrl-C from the start and end with this process, however it ends.

    A process inherits the signals that are blocked when it starts, which is on a submission. When one dies, every open
    call raises `WorkerDied`. Leaving the pool drops calls that have not started and waits for the others.
    """

    def __init__(self, workers: int) -> None:
        resource_tracker.ensure_running()  # otherwise the first process would start it, which unblocks signals
        self.workers = workers
        self._workers: list[_Worker] = []
        self._waiting: deque[tuple[Future[Any], bytes]] = deque()
        self._lock = threading.Lock()  # guards the fields above and below
        self._is_closing = False
        self._death: str | None = None
        self._wakes, self._wake = _SPAWN.Pipe(duplex=False)
        self._dispatcher = threading.Thread(target=self._dispatch, daemon=True)

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Queue the call, as in any executor. Raises: WorkerDied if a worker has died or none can be started."""
        call = bytes(ForkingPickler.dumps((fn, args, kwargs)))
        future: Future[_T] = Future()
        previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            if self._death is None and len(self._workers) < self.workers:
                self._start()
            with self._lock:
                if self._death is not None:
                    raise WorkerDied(self._death)
                self._waiting.append((future, call))
            self._wake.send_bytes(b".")
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: ARG002
        """Wait for all processes to end, after their running calls and, without `cancel_futures`, the queued ones.

        It always waits, regardless of `wait`.
        """
        with self._lock:
            if self._is_closing:
                return
            self._is_closing = True
            for future, _ in self._waiting if cancel_futures else ():
                future.cancel()
        if self._dispatcher.ident is not None:
            self._wake.send_bytes(b".")
            self._dispatcher.join()
        for worker in self._workers:
            worker.pipe.close()  # an idle worker then ends
            if self._death is not None:
                worker.process.terminate()
        for worker in self._workers:
            worker.process.join()
        self._wake.close()
        self._wakes.close()

    def __exit__(self, *_error: Any) -> None:
        self.shutdown(cancel_futures=True)

    def _start(self) -> None:
        """Start one more process. Raises: WorkerDied if that fails."""
        try:
            worker = _Worker()
        except OSError as error:  # no room for a process, or it was killed as it started
            raise WorkerDied(_death_message(None, str(error))) from error
        with self._lock:
            self._workers.append(worker)
        if self._dispatcher.ident is None:
            self._dispatcher.start()

    def _dispatch(self) -> None:
        """Pass calls to idle workers and answers to their futures, until the pool is left or a worker dies."""
        while True:
            with self._lock:
                started = [
                    (worker, call)
                    for worker in self._workers
                    if worker.running is None and (call := self._take_call(worker)) is not None
                ]
                pipes = {worker.pipe: worker for worker in self._workers}
                if self._is_closing and not any(worker.running for worker in self._workers):
                    return
            for worker, call in started:
                with suppress(OSError):  # it is dead, and so is its pipe, which is detected below
                    worker.pipe.send_bytes(call)
            for ready in connection.wait([*pipes, self._wakes]):
                if ready is self._wakes:
                    self._wakes.recv_bytes()
                elif not self._receive_answer(pipes[ready]):  # type: ignore[index]
                    self._fail(pipes[ready])  # type: ignore[index]
                    return

    def _take_call(self, worker: _Worker) -> bytes | None:
        """Take the first queued call for this worker."""
        while self._waiting:
            future, call = self._waiting.popleft()
            if future.set_running_or_notify_cancel():
                worker.running = future
                return call
        return None

    def _receive_answer(self, worker: _Worker) -> bool:
        """Pass on the worker's answer; return False if there is none because the worker is dead."""
        try:
            answer = worker.pipe.recv_bytes()
        except (EOFError, OSError):
            return False
        future, worker.running = worker.running, None
        assert future is not None  # a worker sends nothing but answers
        try:
            is_result, value = pickle.loads(answer)
        except Exception as error:  # its class may run any code while unpickling
            is_result, value = False, error
        (future.set_result if is_result else future.set_exception)(value)
        return True

    def _fail(self, worker: _Worker) -> None:
        """Fail every open and queued call."""
        worker.process.join(5)  # its pipe has ended, so it is ending
        code = worker.process.exitcode
        with self._lock:
            self._death = _death_message(
                worker.process.pid,
                "it still runs" if code is None else f"ended by signal {-code}" if code < 0 else f"ended with {code}",
            )
            open_calls = [each.running for each in self._workers if each.running is not None]
            open_calls += [future for future, _ in self._waiting if future.set_running_or_notify_cancel()]
            self._waiting.clear()
        for future in open_calls:
            future.set_exception(WorkerDied(self._death))


def _death_message(process: int | None, found: str) -> str:
    named = "a worker process" if process is None else f"worker process {process}"
    return f"{named}: found {found}, {_EXPECTED}"


_EXPECTED = (
    "expected it to finish its work; something outside the command ended it, perhaps the system for lack of memory; "
    "what is committed is kept, and there is no verdict on what was not checked: run the same command again, with "
    "fewer --workers if memory is short"
)


# --- in the worker ---


def _work(pipe: Connection) -> None:
    """Answer calls until the pipe ends."""
    leave_out_pandas()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):  # the pool is gone
        while True:
            call = pipe.recv_bytes()
            pipe.send_bytes(_answer(call))


def _answer(call: bytes) -> bytes:
    """Make the call and return its result or exception, pickled."""
    try:
        function, args, kwargs = pickle.loads(call)
        return pickle.dumps((True, function(*args, **kwargs)))
    except BaseException as error:
        error.add_note(f"in worker process {os.getpid()}:\n{''.join(traceback.format_exception(error))}")
        try:
            answer = pickle.dumps((False, error))
            pickle.loads(answer)
        except Exception:  # it cannot be pickled or unpickled
            return pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}")))
        return answer


def _end_with_parent() -> None:
    """End the process at once when its parent has ended; a file that it was writing is in staging, and harmless."""
    parent = parent_process()
    assert parent is not None
    connection.wait([parent.sentinel])
    os._exit(1)
