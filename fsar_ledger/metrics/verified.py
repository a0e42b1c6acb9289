"""Heads whose rows a full verification has compared with their root: its second reader, and a cache.

A full verification trusts neither of our Parquet readers alone: answers come from DuckDB's, proofs and replay from
pyarrow. `layout` leaves no known way for a file to read differently in them; comparing the rows of both reveals unknown
ones. For a file that is byte for byte what its rows are written as, a digest of each column suffices (the number of its
values, and its integers combined). In any other file every value is compared, since an attacker who chooses the content
of a file can make it fit a digest.

The cache lies beside the user's other caches, never in a ledger. An entry is only a file name: a SHA-256 over the hash
of the newest commit record, which covers the hash of every segment, and over the versions of everything that reads the
rows. A process that opens a ledger with that record, and compares its segments with their hashes, has exactly the bytes
that were checked.

Only exactly that head counts: after another commit the checked rows are only a part, and no answer tells which part it
came from. The cache belongs to this user on this machine, who could as well change the program. No other cache is
trusted, and losing it costs one more verification.
"""

import hashlib
import os
import secrets
import stat
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa

from fsar_ledger import __version__
from fsar_ledger.base.errors import LedgerCorrupted, QueryFailed, SequenceConflict, UsageError
from fsar_ledger.base.progress import Progress
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.opening import open_checked
from fsar_ledger.ledger.rows import as_one_array, canonical, numbers, validity
from fsar_ledger.ledger.rows.schema import COLUMNS
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.locations import compare_index
from fsar_ledger.ledger.store.paths import require_outside
from fsar_ledger.ledger.store.read import View
from fsar_ledger.ledger.store.shards import is_log, views_of
from fsar_ledger.ledger.verify import Reading, verify, verify_shards
from fsar_ledger.ledger.verify.report import VerifyOptions, VerifyReport
from fsar_ledger.ledger.verify.segment import Digest

from .connection import Database
from .sql_values import literal, parquet

_DECODED = "decoded_rows"
_EXPECTED = "the same as by pyarrow: rows that both of our readers read alike"


# See docs/decisions/verify-rereads-every-byte.md.
class ReadAgain:
    """The implementation of `VerifyOptions.second_reader`; it keeps one connection per process."""

    def by_value(self, path: str, decoded: pa.Table) -> tuple[str, str] | None:
        """Return what DuckDB found in this segment and what was expected, by value; None if they are equal."""
        try:
            return _by_value(_database(), path, decoded)
        except QueryFailed as error:
            return _unreadable(error)

    def digest(self, decoded: pa.Table) -> Digest:
        """Return the number of rows, the number of values in each column, and the XOR of each column's integers."""
        columns = {name: as_one_array(decoded.column(name)) for name in decoded.column_names}
        counts = [len(column) - column.null_count for column in columns.values()]
        sums = [
            int(np.bitwise_xor.reduce(numbers(columns[name])[validity(columns[name])], initial=0))
            for name in _integers(columns)
        ]
        return Digest(tuple(columns), (len(decoded), *counts, *sums))

    def by_digest(self, digests: Mapping[str, Digest]) -> Mapping[str, tuple[str, str]]:
        """Return what DuckDB found in these segments and what was expected, by path; nothing where they are equal."""
        differences: dict[str, tuple[str, str]] = {}
        groups: dict[tuple[str, ...], list[str]] = {}
        for path, digest in digests.items():
            groups.setdefault(digest.columns, []).append(path)
        for columns, paths in groups.items():
            try:
                numbers_of = _digests(_database(), columns, paths)
            except QueryFailed as error:
                if len(paths) == 1:
                    differences[paths[0]] = _unreadable(error)
                for path in paths if len(paths) > 1 else ():
                    differences |= self.by_digest({path: digests[path]})
                continue
            for path in paths:
                if (difference := _other(digests[path], numbers_of.get(literal(path), ()))) is not None:
                    differences[path] = difference
        return differences


def _unreadable(error: QueryFailed) -> tuple[str, str]:
    return f"a segment that DuckDB cannot read ({error})", _EXPECTED


def _integers(columns: Iterable[str]) -> list[str]:
    return [name for name in columns if COLUMNS[name] == "integer"]


def _digests(database: Database, columns: Sequence[str], paths: Sequence[str]) -> dict[str, tuple[int, ...]]:
    """Return the numbers of `ReadAgain.digest` for each `literal` path, computed by DuckDB. Raises: QueryFailed."""
    counts = [f'count("{name}")' for name in columns] + [f'bit_xor("{name}")' for name in _integers(columns)]
    rows = database.direct(
        f"SELECT filename, count(*), {', '.join(counts)} FROM {parquet(paths, 'filename = true')} GROUP BY filename"
    )
    return {path: tuple(number or 0 for number in numbers) for path, *numbers in rows}  # NULL where all values are NULL


def _other(expected: Digest, numbers: Sequence[int]) -> tuple[str, str] | None:
    """Return the first number that differs, as found and expected; None if none does."""
    if not numbers:
        return "no rows by DuckDB", _EXPECTED
    names = ("run_id", *expected.columns, *_integers(expected.columns))
    for name, by_pyarrow, by_duckdb in zip(names, expected.numbers, numbers, strict=True):
        if by_duckdb != by_pyarrow:
            return f"{by_duckdb} as the digest of column {name} by DuckDB, {by_pyarrow} by pyarrow", _EXPECTED
    return None


def _by_value(database: Database, path: str, decoded: pa.Table) -> tuple[str, str] | None:
    """Compare a segment's rows by DuckDB with the decoded ones, value by value."""
    source = f"FROM {parquet([path])} AS a POSITIONAL JOIN {_DECODED} AS b"
    differences = {name: f'a."{name}" IS DISTINCT FROM b."{name}"' for name in decoded.column_names}
    database.hold(_DECODED, decoded)
    try:
        if database.direct(f"SELECT count(*) {source} WHERE {' OR '.join(differences.values())}") == [(0,)]:
            return None
        [counts] = database.direct(
            f"SELECT {', '.join(f'count(*) FILTER ({difference})' for difference in differences.values())} {source}"
        )
    finally:
        database.drop(_DECODED)
    name, count = next(((name, count) for name, count in zip(differences, counts, strict=True) if count), ("run_id", 0))
    return f"{count} values of column {name} that DuckDB reads otherwise", _EXPECTED


def _database() -> Database:
    """Return the connection of this process: one opened before a fork cannot be used after it."""
    return _database_of(os.getpid())


@cache
def _database_of(_process: int) -> Database:
    return Database(None, (), threads=1, caches_files=False)


_MOST_SOUGHT = 64
"""Maximum number of placements to search back for a cached comparison of the index."""
_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


def full_verify(
    ledger: Path,
    workers: int = 1,
    progress: Progress | None = None,
    asked: VerifyOptions | None = None,
) -> VerifyReport:
    """Return the report of `verify`; cache the head if the rows were read and no problem was found.

    For the log of a federation every shard is verified, too, and compared with its recorded head.

    Raises: as `verify`.
    """
    asked = asked or VerifyOptions()
    if not asked.is_quick:
        asked = msgspec.structs.replace(asked, second_reader=ReadAgain())
    report = verify(ledger, workers, progress, asked)
    records = [report.record_sha256]
    if report.ok and is_log(view := open_checked(ledger)):
        report, records = verify_shards(report, view, Reading(open_checked, models_of), workers, progress, asked)
    for record in records if not report.is_quick else ():
        if record is not None:
            _remember(record)
    return report


def models_of(view: View) -> list[str]:
    """Return the model versions of the runs of a ledger. Raises: QueryFailed, LedgerCorrupted."""
    segments = [path for ledger in views_of(view) for path in ledger.segments()]
    if not segments:
        return []
    rows = _database().direct(f"SELECT DISTINCT model_version FROM {parquet(segments)} WHERE model_version IS NOT NULL")
    return sorted(f"{model}" for (model,) in rows)


def ensure_verified(ledger: Path, workers: int = 1, progress: Progress | None = None) -> str:
    """Verify the ledger; return the SHA-256 of its newest record, for `is_verified`.

    Raises:
        LedgerCorrupted: There is a problem; the message names the first one.
        NotALedger: As `verify`.
    """
    report = full_verify(ledger, workers, progress)
    if report.record_sha256 is None:
        first, *others = report.problems
        more = f" ({len(others)} more of these)" if others else ""
        raise LedgerCorrupted(
            f"{ledger}: {first}{more}; no answer is given from rows that do not match the root, run fsar-ledger verify"
        )
    return report.record_sha256


def is_verified(view: View, demanded: str | None = None) -> bool:
    """Return whether the rows of this head, if its segments are as committed, are known to be those under its root.

    Args:
        view: The opened ledger.
        demanded: The newest record that `ensure_verified` has just checked, if no other head will do.

    Raises:
        SequenceConflict: The view has a head other than the demanded one.
    """
    if demanded is not None and view.record_sha256 != demanded:
        raise SequenceConflict(
            f"{view.path}: found another newest commit than a moment ago, when its rows were compared with its root; "
            "run it again"
        )
    is_known = demanded is not None or not view.head.size or is_remembered(view.record_sha256)
    if is_known:
        view.believe_index()
    return is_known


def is_verified_for_runs(view: View, demanded: str | None) -> bool:
    """Return as `is_verified`; call it before using which runs a ledger has and where they are.

    If the rows are not known to be those under the root, the index of runs in the chain is at least compared with them.
    As far as it is right, that is cached, too, by the line of the last placement, which covers those before.

    Raises:
        SequenceConflict: As `is_verified`.
        LedgerCorrupted: The chain contradicts the rows of a segment.
    """
    is_known = is_verified(view, demanded)
    if is_known:
        return True
    for ledger in views_of(view):
        _compare_index(ledger)
    return False


def _compare_index(view: View) -> None:
    """Compare the chain's index of runs with the rows, unless a comparison is cached. Raises: LedgerCorrupted."""
    lines = (
        f"index {sha256_hex(canonical.document(placement))}"
        for placement in reversed(view.chain.placed[-_MOST_SOUGHT:])
    )
    cached = next((back for back, line in enumerate(lines) if is_remembered(line)), None)
    if cached is not None:
        view.believe_index(view.chain.placed[-1 - cached].number)
    if cached != 0 and compare_index(view) and view.chain.placed:
        _remember(f"index {sha256_hex(canonical.document(view.chain.placed[-1]))}")


def require_runs(view: View) -> None:
    """Require, before a run is reported missing, that the chain's index covers all rows.

    Raises: LedgerCorrupted if it does not, or some rows cannot be read.
    """
    for ledger in views_of(view):
        ledger.require_index(*range(len(ledger.chain.placed)))


def is_remembered(record_sha256: str) -> bool:
    """Return whether this user's `verify`, with these versions, found no fault in a ledger with this newest record."""
    file = _cache_file(record_sha256)
    try:
        return file is not None and is_own_file(file) and disk.read_document(file) == _line(record_sha256)
    except OSError:
        return False


def _remember(record_sha256: str) -> None:
    """Cache the head if possible; otherwise the next answer only claims less."""
    if cache_folder() is None or (file := _cache_file(record_sha256)) is None:
        return
    temporary = file.parent / f"{secrets.token_hex(8)}.part"
    with suppress(OSError):
        try:
            with open(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600), "wb") as written:
                written.write(_line(record_sha256))
            os.replace(temporary, file)
        finally:
            temporary.unlink(missing_ok=True)


def _folder() -> Path | None:
    """Return the user's cache folder of this program: `$XDG_CACHE_HOME/fsar-ledger`, else `~/.cache/fsar-ledger`.

    None if there is no home.
    """
    configured = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(configured):  # the specification ignores relative paths
        return Path(configured) / "fsar-ledger"
    try:
        return Path.home() / ".cache" / "fsar-ledger"
    except RuntimeError:
        return None


def cache_folder() -> Path | None:
    """Return the user's cache folder, created if needed; None if there is none that only this user can write."""
    folder = _folder()
    with suppress(OSError, UsageError):
        if folder is not None:
            require_outside(folder / "cache", "the cache")
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            return folder if _is_own(folder) else None
    return None


def is_own_file(file: Path) -> bool:
    """Return whether only this user can write or replace this file of the cache."""
    try:
        return _is_own(file.parent) and _is_safe(file.lstat())
    except OSError:
        return False


def _is_own(folder: Path) -> bool:
    """Return whether this is a folder, not a link to one, in which only this user can write."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and _is_safe(status)


def _is_safe(status: os.stat_result) -> bool:
    return status.st_uid == os.geteuid() and not status.st_mode & _BY_OTHERS


def _cache_file(record_sha256: str) -> Path | None:
    """Return the cache file of a head.

    None if there is no cache, or the versions that read the rows are unknown.
    """
    folder = _folder()
    try:
        readers = (f"fsar-ledger {__version__}", *(f"{name} {version(name)}" for name in ("pyarrow", "duckdb")))
    except PackageNotFoundError:
        return None
    return folder and folder / hashlib.sha256("\n".join([record_sha256, *readers]).encode()).hexdigest()


def _line(record_sha256: str) -> bytes:
    """Return the whole content of the file of a head: a partial one, after a full disk, does not count."""
    return f"{record_sha256}\n".encode()
