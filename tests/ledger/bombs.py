"""Thirty bombs: small things that an attacker hands over to make whoever reads them run out of memory or time.

Those in a ledger are committed as by a writer: every hash in the records matches, and only the leaves were never
computed.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.hashing import HASH_BYTES, sha256_hex
from fsar_ledger.ledger.log.merkle import Frontier
from fsar_ledger.ledger.log.note import Note, checkpoint_of
from fsar_ledger.ledger.rows import canonical, segment
from fsar_ledger.ledger.rows.schema import CODED_SCHEMA, MAX_INTEGER
from fsar_ledger.ledger.store.derived import line_of
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, NODES, segment_name
from tests.ledger.forgery import records_in
from tests.ledger.hostile import documents, written
from tests.ledger.samples import ORIGIN, append_all
from tests.metrics.conftest import record

MIB = 1 << 20
LEDGER = "LEDGER"
BESIDE = "../beside"
SOME = (
    ("info", LEDGER),
    ("metrics", LEDGER),
    ("explain", LEDGER),
    ("report", LEDGER, "--out", "out.pdf"),
    ("export", LEDGER, "--out", "out.csv"),
    ("verify", LEDGER, "--workers", "1"),
)
READERS = (
    *SOME,
    ("statistics", LEDGER),
    ("audit", LEDGER),
    ("query", "conflicts", LEDGER),
    ("query", "claims", LEDGER, "--json"),
    ("prove", LEDGER, "1"),
    ("maintain", "recover", LEDGER, "--workers", "1"),
    ("sql", LEDGER, "SELECT count(*), max(run_id), max(length(parameters)) FROM events"),
)
QUICK = (("info", LEDGER), ("verify", LEDGER, "--workers", "1"))
Values = dict[str, object]


STARTED = {
    "kind": "simulated",
    "architecture": "fsar",
    "configuration": "full",
    "scenario": "door-relay",
    "model_version": "x",
    "parameters": "{}",
}
"""What each run says of itself."""


class Bomb(NamedTuple):
    """What is put into or beside a ledger of one small commit, and the calls that touch it."""

    lay: Callable[[Path], None]
    calls: tuple[tuple[str, ...], ...] = READERS


def base_ledger(path: Path) -> None:
    """Write a ledger of one commit with two runs of three events. Bombs are put into copies of it."""
    append_all(path, [[record("fsar", 0), record("cfc", 0)]])


def rows(count: int, **values: object) -> pa.Table:
    """Return this many rows of one run that begins with RunStarted. A value goes into every row, an array is used as it
    is."""
    types = pa.DictionaryArray.from_arrays(
        pa.array(np.minimum(np.arange(count), 1).astype(np.int32)), pa.array(["RunStarted.v1", "TaskCompleted.v1"])
    )
    numbers = np.arange(count)
    given: Values = {
        "run_id": "r",
        "seq": numbers,
        "time_us": numbers,
        "type": types,
        "caused_by": pa.array(numbers - 1, mask=numbers == 0),
        **values,
    }
    given |= {name: _first(count, value) for name, value in STARTED.items() if name not in values}
    given |= {
        name: _first(count, value)
        for name, value in {"seed": 1, "fleet_size": 4, "run": 0}.items()
        if name not in values
    }
    return pa.Table.from_arrays(
        [_column(field, given.get(field.name), count) for field in CODED_SCHEMA], schema=CODED_SCHEMA
    )


def _first(count: int, value: object) -> pa.Array:
    """Return a column with the value in the first row and NULL in all others."""
    if isinstance(value, str):
        return pa.DictionaryArray.from_arrays(
            pa.array(np.zeros(count, np.int32), mask=np.arange(count) > 0), pa.array([value])
        )
    return pa.array(np.full(count, value), mask=np.arange(count) > 0)


def _column(field: pa.Field, value: object, count: int) -> pa.Array:
    if value is None:
        return pa.nulls(count, field.type)
    if isinstance(value, str):
        return pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, np.int32)), pa.array([value]))
    array = (
        value if isinstance(value, pa.Array) else pa.array(np.full(count, value) if isinstance(value, int) else value)
    )
    return (
        array.dictionary_encode()
        if pa.types.is_dictionary(field.type) and not pa.types.is_dictionary(array.type)
        else array
    )


def commit(path: Path, data: bytes | pa.Table, count: int, times: int = 1) -> None:
    """Commit this segment this many times after what is there, rows each time as a run of their own.

    Only hashing the rows would reveal it.
    """
    for _ in range(times):
        before, placed = records_in(path, "commit")[-1], records_in(path, "placement")[-1]
        number, first = before["number"] + 1, before["tree_size"]
        size = first + count
        tree = Frontier(size, bytes(32) * size.bit_count())
        last = (path / CHAIN).read_bytes().splitlines()[-1]
        if isinstance(data, pa.Table):
            data = data.set_column(0, CODED_SCHEMA.field(0), _column(CODED_SCHEMA.field(0), f"r{number}", count))
            parquet, line = bytes(segment.to_parquet(data)), line_of(first, data)
        else:
            block = {"run": f"r{number}", "first": 0, "rows": count, "first_us": 0, "last_us": count - 1}
            parquet, line = data, canonical.document({"first": first, "blocks": [block]}) + b"\n"
        own = before | {"number": number, "previous_sha256": sha256_hex(last), "rows": count}
        own |= {"tree_size": size, "tree_root": tree.root().hex()}
        there = placed | {"number": placed["number"] + 1, "previous_sha256": sha256_hex(canonical.document(own))}
        there |= {"first": first, "rows": count, "frontier": list(map(bytes.hex, tree.subtrees))}
        there |= {"segment_bytes": len(parquet), "segment_sha256": sha256_hex(parquet)}
        there |= {"index_bytes": len(line), "index_sha256": sha256_hex(line)}
        (path / segment_name(first, size)).write_bytes(parquet)
        for name, more in ((CHAIN, b"".join(canonical.document(one) + b"\n" for one in (own, there))), (INDEX, line)):
            with (path / name).open("ab") as file:
                file.write(more)
        (path / NODES).touch()
        os.truncate(path / NODES, pack.count(size) * HASH_BYTES)
        (path / "checkpoint").write_text(str(Note(checkpoint_of(ORIGIN, tree))))


def committed(make: Callable[[], pa.Table], times: int = 1) -> Callable[[Path], None]:
    """Return a function that commits what is made."""

    def lay(path: Path) -> None:
        table = make()
        commit(path, table, len(table), times)

    return lay


def claims(count: int, claimants: int) -> pa.Table:
    """Return this many claims of one dimension of one action, none of them released."""
    numbers = pa.array((np.arange(count) % claimants).astype(np.int32))
    types = pa.DictionaryArray.from_arrays(
        pa.array(np.minimum(np.arange(count), 1).astype(np.int32)), pa.array(["RunStarted.v2", "AuthorityClaimed.v1"])
    )
    holders = pa.DictionaryArray.from_arrays(numbers, pa.array([f"robot/{number}" for number in range(claimants)]))
    return rows(count, type=types, action_id="a", dimension="override", claimant=holders, reason="x")


def lists(count: int, each: int) -> pa.Table:
    """Return rows with a list that repeats one name."""
    values = pa.array(["robot/A1"]).take(pa.array(np.zeros(count * each, np.int32)))
    return rows(
        count, path=pa.ListArray.from_arrays(pa.array(np.arange(0, (count + 1) * each, each, dtype=np.int32)), values)
    )


def runs(count: int) -> pa.Table:
    """Return this many runs of one event."""
    names = pa.array([f"run-{number:07d}" for number in range(count)])
    numbers = np.arange(count)
    own = {
        "run_id": names,
        "seq": 0,
        "time_us": 0,
        "type": "RunStarted.v1",
        "caused_by": pa.nulls(count, pa.int64()),
        "seed": numbers,
        "run": numbers,
    }
    return rows(count, fleet_size=4, **own, **STARTED)


def instead(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    """Return a function that puts something else in place of this file of the ledger, or beside it."""

    def lay(path: Path) -> None:
        (path / name).unlink(missing_ok=True)
        make(path / name)

    return lay


def sparse(size: int) -> Callable[[Path], None]:
    """Return a function that makes a file of this many bytes that takes no space."""

    def make(file: Path) -> None:
        file.touch()
        os.truncate(file, size)

    return make


def document(what: str) -> Callable[[Path], object]:
    """Return a function that makes one of the malformed documents."""
    data = dict(documents(b'{"format":"fsar-ledger","origin":"example.org/x","version":2}'))[what]
    return lambda file: file.write_bytes(data)


def unpacking(size: int) -> bytes:
    """Return a segment of another layout whose one page unpacks to this many bytes."""
    return written(pa.table({"a": [" " * size]}), use_dictionary=False, write_statistics=False)


def asked(*selects: str) -> tuple[tuple[str, ...], ...]:
    """Return calls of `sql`."""
    return tuple(("sql", LEDGER, select, "--seconds", "8", "--memory", "1024", "--json") for select in selects)


PROOF = (("verify-proof", "beside"),)
ANCHORED = (
    ("verify", LEDGER, "--workers", "1", "--anchor", "beside"),
    ("maintain", "recover", LEDGER, "--workers", "1", "--anchor", "beside"),
)
KEYED = (
    ("verify", LEDGER, "--workers", "1", "--trusted-key", "beside"),
    ("verify-proof", "beside", "--trusted-key", "beside"),
)
NOTHING = sparse(0)

BOMBS: dict[str, Bomb] = {
    # segments
    "a million rows that differ in nothing": Bomb(committed(lambda: rows(1 << 20, task_id="t")), SOME),
    "a name of 1 MiB in 500 rows": Bomb(committed(lambda: rows(500, task_id="x" * MIB))),
    "a name of 64 MiB in 7 rows": Bomb(committed(lambda: rows(7, task_id="x" * (64 * MIB))), SOME),
    "eight million names in lists": Bomb(committed(lambda: lists(1 << 20, 8))),
    "a list of eight million names": Bomb(committed(lambda: lists(2, 1 << 22)), SOME),
    "fifty million rows": Bomb(committed(lambda: rows(1 << 20, task_id="t"), 50)),
    "200,000 open claims": Bomb(committed(lambda: claims(200_000, 200_000))),
    "a million open claims of two": Bomb(committed(lambda: claims(1_000_000, 2))),
    "a million runs": Bomb(committed(lambda: runs(1_000_000))),
    "numbers as large as there are": Bomb(
        committed(lambda: rows(9, **{name: _first(9, MAX_INTEGER) for name in ("run", "seed")})), SOME
    ),
    "parameters that nest": Bomb(
        committed(lambda: rows(9, parameters=_first(9, '{"a":' * 100_000 + "1" + "}" * 100_000)))
    ),
    "a parameter of 6,000 digits": Bomb(
        committed(lambda: rows(9, parameters=_first(9, '{"a":' + "9" * 6_000 + "}"))), SOME
    ),
    "parameters of 100 MB": Bomb(
        committed(lambda: rows(9, parameters=_first(9, '{"a":[' + "1," * 50_000_000 + "1]}")))
    ),
    "a page that unpacks to 600 MB": Bomb(lambda path: commit(path, unpacking(600 * MIB), 1), SOME),
    "a segment of 256 MB of nothing": Bomb(lambda path: commit(path, bytes((1 << 28) - 1), 1), SOME),
    # things that are not files
    "a pipe for a segment": Bomb(instead("segments/000000000000-000000000006.parquet", os.mkfifo), SOME),
    "a terabyte of nothing for a segment": Bomb(instead("segments/000000000000-000000000006.parquet", sparse(1 << 40))),
    "a link to itself for the chain": Bomb(instead(CHAIN, lambda file: file.symlink_to(file.name)), SOME),
    "a device for the description": Bomb(instead("ledger.json", lambda file: file.symlink_to("/dev/zero")), SOME),
    "a terabyte of nothing for the hashes": Bomb(
        instead(NODES, sparse(1 << 40)), (("verify", LEDGER, "--workers", "1"), ("prove", LEDGER, "1"))
    ),
    # documents
    "a record that nests": Bomb(instead(CHAIN, document("100,000 objects in each other")), QUICK),
    "a description of a million names": Bomb(instead("ledger.json", document("a million names")), QUICK),
    "a number of 100,000 digits for a record": Bomb(instead(CHAIN, document("a number of 100,000 digits")), QUICK),
    "a checkpoint of a megabyte of lines": Bomb(
        instead("checkpoint", lambda file: file.write_bytes(b"\n" * MIB)), QUICK
    ),
    # proofs, anchors and keys
    "a proof of a terabyte": Bomb(instead(BESIDE, sparse(1 << 40)), PROOF),
    "a proof with 20,000 hashes": Bomb(
        instead(
            BESIDE, lambda file: file.write_text("c2sp.org/tlog-proof@v1\nindex 1\n" + ("A" * 43 + "=\n") * 20_000)
        ),
        PROOF,
    ),
    "a device for an anchor": Bomb(instead(BESIDE, lambda file: file.symlink_to("/dev/zero")), ANCHORED),
    "a pipe for a key": Bomb(instead(BESIDE, os.mkfifo), KEYED),
    # SQL and parameters
    "SELECTs that grow": Bomb(
        instead(BESIDE, NOTHING),
        asked(
            "SELECT [x, x, x, x, x, x] AS l FROM range(1000000) AS t(x)",
            "SELECT len(list(i)) FROM range(100000000000) AS t(i)",
            "SELECT [[]::INTEGER[] FOR x IN range(3000000)] AS l",
            "SELECT * FROM range(999999) AS t(a), (SELECT "
            + ", ".join(f"NULL AS c{number}" for number in range(300))
            + ")",
        ),
    ),
    "a parameter of 100 kB": Bomb(
        instead(BESIDE, NOTHING),
        (
            ("query", "audit/policy_at", LEDGER, "--param", "run=" + "x" * 100_000),
            ("query", "audit/overlapping_claims", LEDGER, "--param", f"run={'9' * 6_000}"),
        ),
    ),
}

IN_TURN: dict[str, tuple[str, ...]] = {
    "a million rows that differ in nothing": ("verify", "report"),
    "a name of 1 MiB in 500 rows": ("verify", "explain", "sql"),
    "a name of 64 MiB in 7 rows": ("verify", "export"),
    "eight million names in lists": ("verify", "export", "prove", "query claims"),
    "a list of eight million names": ("verify", "explain"),
    "fifty million rows": (),
    "200,000 open claims": ("verify", "query conflicts", "audit"),
    "a million open claims of two": (),
    "a million runs": ("verify", "info", "statistics"),
    "numbers as large as there are": ("verify", "metrics"),
    "parameters that nest": ("verify", "maintain recover", "sql", "audit", "query conflicts"),
    "a parameter of 6,000 digits": ("verify", "report"),
    "parameters of 100 MB": ("verify", "info", "maintain recover"),
    "a page that unpacks to 600 MB": ("verify", "info"),
    "a segment of 256 MB of nothing": ("verify", "export"),
    "a pipe for a segment": ("verify", "explain"),
    "a terabyte of nothing for a segment": ("verify", "query claims", "statistics"),
    "a link to itself for the chain": ("verify", "metrics"),
    "a device for the description": ("verify", "report"),
    "SELECTs that grow": ("sql LEDGER SELECT len", "sql LEDGER SELECT *"),
}
"""By bomb, how those of its calls begin that `make test-all` makes; of a bomb that is not here it makes all. It makes
none of the bomb that takes longer to lay than all others together, nor of the claims of which fewer by more are tried.
The soak makes all calls of all bombs.
"""


def calls_in_turn(name: str) -> list[tuple[str, ...]]:
    """Return the calls of the bomb that `make test-all` makes."""
    asked = IN_TURN.get(name, ("",))
    return [call for call in BOMBS[name].calls if " ".join(call).startswith(asked)]
