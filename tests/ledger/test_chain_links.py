"""A chain is followed line by line, or, where all of it is as usual, in columns: with the same outcome."""

from collections.abc import Iterator
from typing import Any
from unittest.mock import patch

import msgspec
import pytest

from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.rows.runs import piece
from fsar_ledger.ledger.store import links
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.links import Chain, Followed, follow
from fsar_ledger.ledger.store.paths import CHAIN
from fsar_ledger.ledger.store.staging import stage
from tests.ledger.samples import ORIGIN, made_up_run

START = "0" * 64
Line = dict[str, Any]


@pytest.fixture(scope="module", params=["segments", "journals"])
def lines(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> list[Line]:
    """The records of five commits, of which the middle ones continue runs; none says what comes before.

    Each has a segment of its own, or two segments hold those of two journals.
    """
    runs = [made_up_run(f"run-{number}", 12, number) for number in range(3)]
    path = tmp_path_factory.mktemp("chain") / "ledger"
    with Writer(path, ORIGIN) as writer:
        for parts in (
            [runs[0]],
            [piece(runs[1], 0, 5)],
            [piece(runs[1], 5, 8), piece(runs[2], 0, 3)],
            [piece(runs[1], 8, 12)],
            [piece(runs[2], 3, 12)],
        ):
            if request.param == "segments":
                writer.append(stage(path, parts))
                continue
            writer.add(parts)
            if len(parts) == 2:
                writer.seal()
        writer.seal()
    return [msgspec.json.decode(line, type=Line) for line in (path / CHAIN).read_bytes().splitlines()]


def linked(lines: list[Line]) -> bytes:
    """The bytes of these records, each with the hash of the one before."""
    found, previous = b"", START
    for line in lines:
        data = canonical.document(line | {"previous_sha256": previous})
        found, previous = found + data + b"\n", sha256_hex(data)
    return found


def followed(data: bytes, *, in_columns: bool) -> tuple[Followed, dict[str, Any], int]:
    """How far the bytes are followed, the chain then, and how often it was followed in columns."""
    added = [0]
    adds = Chain.adds

    def counted(chain: Chain, *given: Any) -> bool:
        is_added = in_columns and adds(chain, *given)
        added[0] += is_added
        return is_added

    chain = Chain(START, trusts_frontiers=True)
    with patch.object(Chain, "adds", counted):
        found = follow(data, chain)
    return found, vars(chain) | {"commits": [*chain.commits]}, added[0]


@pytest.fixture(params=[1 << 20, 700], autouse=True)
def at_once(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """How many bytes of a chain are followed at once: all, or two lines or so."""
    monkeypatch.setattr(links, "_MANY_BYTES", request.param)
    return int(request.param)


def changes(lines: list[Line]) -> Iterator[list[Line]]:
    """Yield these records with another value in one field, one missing, or two exchanged."""
    for at, line in enumerate(lines):
        for name, value in line.items():
            for other in others(value):
                yield [*lines[:at], line | {name: other}, *lines[at + 1 :]]
        yield lines[:at] + lines[at + 1 :]
        yield [*lines[: at + 1], line, *lines[at + 1 :]]
        yield [*lines[:at], *lines[at + 1 : at + 2], line, *lines[at + 2 :]]


def others(value: Any) -> list[Any]:
    """Other values of this type."""
    match value:
        case int():
            return [value - 1, value + 1, 0]
        case str():
            return [value[:-1] + ("0" if value[-1:] != "0" else "1"), "0.1.0", ""]
        case [str(), *_]:
            return [[], [*value, "run-9"], value[::-1] + value[:1]]
        case _:
            return [[], [["run-9", 1]], [[name, seq + 1] for name, seq in value], [*value, *value]]


def test_a_usual_chain_is_followed_in_columns_as_line_by_line(lines: list[Line], at_once: int) -> None:
    for end in range(len(lines) + 1):
        data = linked(lines[:end])
        *found, added = followed(data, in_columns=True)
        assert 1 <= added <= 2 if at_once > len(data) else added
        assert [*found, 0] == [*followed(data, in_columns=False)]


def test_whatever_is_changed_in_a_chain_it_is_followed_as_line_by_line(lines: list[Line], at_once: int) -> None:
    found = set()
    for changed in changes(lines):
        data = linked(changed)
        for cut in (data, data[:-1], data + b"{"):
            one, other = (followed(cut, in_columns=in_columns) for in_columns in (True, False))
            assert one[:2] == other[:2]
        found.add((one[2], one[0].problem is None))
    assert {is_whole for _, is_whole in found} == {False, True}
    assert at_once == 700 or found >= {(0, False), (0, True)}


def test_a_chain_that_does_not_trust_its_frontiers_is_followed_line_by_line(lines: list[Line]) -> None:
    with patch.object(Chain, "doubt", return_value=("number", 1, 0)) as doubt:
        assert follow(linked(lines), Chain(START)).problem is not None
    assert doubt.call_count == 1
