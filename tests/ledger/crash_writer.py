"""A process that forks others, which append to ledgers and are killed: `python -m tests.ledger.crash_writer` answers
each line with one.

It has imported everything and started no threads, so a fork costs milliseconds.
"""

import json
import os
import select
import signal
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import TracebackType

import msgspec

from tests.ledger import crowd
from tests.ledger.crash_trials import STEPS, write_with
from tests.ledger.faults import Fault, FaultyOs

STUCK_AFTER_S = 120


class Order(msgspec.Struct, frozen=True):
    """What the nursery does at a path: these writers append this many batches each, while this many readers watch.

    `kill_after_us` has a moment for each writer that is killed, counted from its start. With a fault, one process
    takes the steps of the trials and is killed at that call. A batch is a step of `crowd`. The disk refuses each writer
    something so many times.
    """

    path: str
    writers: tuple[str, ...] = ()
    batches: int = 0
    readers: int = 0
    kill_after_us: tuple[int, ...] = ()
    fault_at: int | None = None
    fault_kind: str = "killed"
    refusals: int = 0


class Outcome(msgspec.Struct, frozen=True):
    """The result: batches acknowledged by writer, processes killed, heads that readers saw, and what was wrong.

    Also how often something was refused, and each head that a reader saw, as its size and root.
    """

    acknowledged: dict[str, int]
    killed: int
    heads: int
    wrong: tuple[str, ...]
    refused: int = 0
    seen: tuple[str, ...] = ()


def _child(work: Callable[[Callable[[str, object], None]], None], name: str, pipe: int) -> int:
    """Fork a process that does the work and reports through the pipe. Returns its process id."""
    number = os.fork()
    if number:
        return number
    signal.alarm(STUCK_AFTER_S)

    def say(what: str, value: object) -> None:
        short = value if isinstance(value, int) else str(value)[-1500:]
        os.write(pipe, json.dumps([name, what, short]).encode() + b"\n")

    try:
        work(say)
    except BaseException:
        say("wrong", traceback.format_exc())
    finally:
        os._exit(0)


def obey(order: Order) -> Outcome:
    """Carry out the order; leave no child running."""
    path = Path(order.path)
    listen, pipe = os.pipe()
    stop, stopper = os.pipe()
    readers = [
        _child(partial(_watch_until, stopper, path, stop), f"reader {number}", pipe) for number in range(order.readers)
    ]
    start = time.monotonic_ns()
    if order.fault_at is not None:
        fault = Fault(order.fault_at, order.fault_kind)
        writers = [_child(partial(_fail, path, fault), "trial", pipe)]
    else:
        write = partial(crowd.write_refused, order.refusals) if order.refusals else crowd.write
        writers = [_child(partial(write, path, name, order.batches), name, pipe) for name in order.writers]
    os.close(pipe)
    os.close(stop)
    for moment, number in sorted(zip(order.kill_after_us, writers, strict=False)):
        time.sleep(max(0, start + moment * 1000 - time.monotonic_ns()) / 1e9)
        os.kill(number, signal.SIGKILL)
    lines, ends = _gather(listen, writers, stopper, readers)
    said = [json.loads(line) for line in lines.splitlines()]
    acknowledged = Counter[str]()
    for name, what, value in said:
        if what == "acknowledged":
            acknowledged[name] = max(acknowledged[name], value)
    wrong = [f"{name}: {value}" for name, what, value in said if what == "wrong"]
    wrong += [f"a process ended by signal {end}" for end in ends if end not in (0, signal.SIGKILL)]
    return Outcome(
        dict(acknowledged),
        ends.count(signal.SIGKILL),
        sum(what == "head" for _, what, _ in said),
        tuple(wrong),
        sum(what == "refused" for _, what, _ in said),
        tuple(dict.fromkeys(value for _, what, value in said if what == "seen")),
    )


def _watch_until(stopper: int, path: Path, stop: int, say: Callable[[str, object], None]) -> None:
    os.close(stopper)
    crowd.watch(path, stop, say)


def _fail(path: Path, fault: Fault, say: Callable[[str, object], None]) -> None:
    faulty = FaultyOs(path.parent.parent, fault, really_kills=True)
    write_with(faulty, path, len(STEPS), lambda count: say("acknowledged", count))


def _gather(listen: int, writers: list[int], stopper: int, readers: list[int]) -> tuple[bytes, list[int]]:
    """Return everything that the children wrote, and the signal that ended each (0: none). Readers are told to stop
    when the writers have ended."""
    said = b""
    waiting = list(writers)
    ends = []
    while True:
        if select.select([listen], [], [], 0.002)[0]:
            part = os.read(listen, 1 << 16)
            if not part:
                break
            said += part
        for number in list(waiting):
            done, status = os.waitpid(number, os.WNOHANG)
            if done:
                waiting.remove(number)
                ends.append(os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0)
        if not waiting and stopper >= 0:
            os.close(stopper)
            stopper = -1
    for number in [*waiting, *readers]:
        status = os.waitpid(number, 0)[1]
        ends.append(os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0)
    if stopper >= 0:
        os.close(stopper)
    os.close(listen)
    return said, ends


class Nursery:
    """A nursery in a process of its own, for tests that have threads and may not fork. Use as a context manager."""

    def __enter__(self) -> "Nursery":
        command = [sys.executable, "-m", "tests.ledger.crash_writer"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()

    def __call__(self, order: Order) -> Outcome:
        """Carry out the order and return its outcome."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(msgspec.json.encode(order) + b"\n")
        self._process.stdin.flush()
        return msgspec.json.decode(self._process.stdout.readline(), type=Outcome)


if __name__ == "__main__":
    for line in sys.stdin.buffer:
        sys.stdout.buffer.write(msgspec.json.encode(obey(msgspec.json.decode(line, type=Order))) + b"\n")
        sys.stdout.buffer.flush()
