"""What an import is given: its inputs, its adapter, and the fleet."""

import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any

from fsar_ledger.base.errors import UsageError
from fsar_ledger.base.printable import value

from .adapter import Adapter, Input, adapter_named

STDIN = "-"


@contextmanager
def opened(logs: Sequence[str]) -> Iterator[list[Input]]:
    """Open these files; `-` is standard input.

    Raises: UsageError for none, or one that cannot be read.
    """
    if not logs:
        raise UsageError("import: found no file, expected at least one, or - for standard input")
    with ExitStack() as stack:
        found: list[Input] = []
        for log in logs:
            path = Path(log)
            try:
                file = sys.stdin.buffer if log == STDIN else stack.enter_context(path.open("rb"))
            except OSError as error:
                raise UsageError(
                    f"{value(log)}: cannot be read ({error.strerror}); name a file, or - for standard input"
                ) from error
            is_file = log != STDIN and file.seekable()  # a pipe cannot be read twice
            found.append(Input("stdin" if log == STDIN else path.stem, path if is_file else None, file))
        yield found


def adapter_of(name: str | None, mapping: Path | None) -> tuple[Adapter, str | None]:
    """Return the adapter of this name, or that of a mapping, and the SHA-256 of the mapping.

    Raises: UsageError unless there is one of both; or as `adapter_named`.
    """
    if (name is None) == (mapping is None):
        raise UsageError("import: expected either the name of a format (--as) or a mapping (--with)")
    if name is not None:
        return adapter_named(name), None
    assert mapping is not None
    from .mapping import mapped

    data = read(mapping)
    return mapped(mapping, data), sha256(data).hexdigest()


def looked(adapter: Adapter, inputs: Sequence[Input]) -> Adapter:
    """Let the adapter look at its inputs before it declares anything, if what it declares depends on them.

    Such an adapter has a method `look`, which leaves every file at its beginning.
    """
    if (look := getattr(adapter, "look", None)) is not None:
        look(inputs)
    return adapter


def read(path: Path) -> bytes:
    """Return the bytes of a file that a user named. Raises: UsageError if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise UsageError(f"{value(str(path))}: cannot be read ({error.strerror})") from error


def named_robots(path: Path) -> dict[str, str]:
    """Return the role of each robot that a TOML file names under [robots].

    Raises: UsageError for a file that is no such table of texts.
    """
    try:
        found = tomllib.loads(read(path).decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UsageError(f"{value(str(path))}: {error}; expected TOML with a table [robots]") from error
    robots = dict(_flat(found["robots"])) if isinstance(found.get("robots"), dict) else None
    if robots is None or not all(isinstance(role, str) for role in robots.values()):
        raise UsageError(
            f'{value(str(path))}: expected a table [robots] with a role for each name, as in `KIT.0001 = "agv"`'
        )
    return robots


def _flat(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the values by name: TOML takes `KIT.0001 = "agv"` for a table KIT with a key 0001."""
    for name, found in table.items():
        if isinstance(found, dict):
            yield from ((f"{name}.{rest}", one) for rest, one in _flat(found))
        else:
            yield name, found
