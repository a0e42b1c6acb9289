"""Published test vectors: those of transparency-dev/merkle and wycheproof, and the examples that C2SP prints."""

import base64
import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.ledger.log.merkle import EMPTY_ROOT, is_consistent, root_of_inclusion
from fsar_ledger.ledger.log.note import VerifierKey, parse_note

VECTORS = Path(__file__).resolve().parents[1] / "vectors"

Vector = dict[str, Any]


@cache
def vectors(name: str) -> dict[str, Vector]:
    found: dict[str, Vector] = json.loads((VECTORS / name).read_text("utf-8"))
    return found


def hashes(vector: Vector, name: str) -> list[bytes]:
    return [base64.b64decode(one) for one in vector[name] or ()]


def is_included(vector: Vector) -> bool:
    (leaf,), (root,) = (hashes({"it": [vector[name] or ""]}, "it") for name in ("leafHash", "root"))
    return root_of_inclusion(leaf, vector["leafIdx"], vector["treeSize"], hashes(vector, "proof")) == root


def is_grown(vector: Vector) -> bool:
    (old,), (new,) = (hashes({"it": [vector[name] or ""]}, "it") for name in ("root1", "root2"))
    return is_consistent(vector["size1"], old, vector["size2"], new, hashes(vector, "proof"))


NO_HASHES = "additional/sizes-are-equal-one-and-proof-is-empty.json"
"""The one vector judged differently here: its two equal roots are the twelve bytes "don't care 2". They are not hashes,
so there is no such tree."""


def folders(kind: str) -> set[str]:
    return {name.rpartition("/")[0] for name in vectors(f"merkle/{kind}.json")}


@pytest.mark.parametrize("folder", sorted(folders("inclusion")))
def test_inclusion_is_judged_as_the_vectors_of_transparency_dev_say(folder: str) -> None:
    group = {
        name: vector for name, vector in vectors("merkle/inclusion.json").items() if name.rpartition("/")[0] == folder
    }
    assert [
        f"{name}: {vector['desc']}" for name, vector in group.items() if is_included(vector) is vector["wantErr"]
    ] == []


@pytest.mark.parametrize("folder", sorted(folders("consistency")))
def test_consistency_is_judged_as_the_vectors_of_transparency_dev_say(folder: str) -> None:
    group = {
        name: vector for name, vector in vectors("merkle/consistency.json").items() if name.rpartition("/")[0] == folder
    }
    otherwise = {name for name in group if name == NO_HASHES}
    assert {
        f"{name}: {vector['desc']}"
        for name, vector in group.items()
        if is_grown(vector) is vector["wantErr"] and name not in otherwise
    } == set()
    for name in otherwise:
        assert not is_grown(group[name])
        root = base64.b64encode(bytes(32)).decode()
        assert is_grown(group[name] | {"root1": root, "root2": root})


def test_all_196_vectors_are_there_and_some_are_good() -> None:
    found = [
        vector["wantErr"] for kind in ("inclusion", "consistency") for vector in vectors(f"merkle/{kind}.json").values()
    ]
    assert (len(found), found.count(False)) == (196, 12)


def test_what_is_no_hash_of_32_bytes_is_in_no_tree() -> None:
    """0.1.0 accepted an empty leaf as the root of a tree of one."""
    vector = vectors("merkle/inclusion.json")["single-entry/empty-root-and-leaf.json"]
    assert (vector["root"], vector["leafHash"], vector["treeSize"]) == ("", "", 1)
    assert root_of_inclusion(b"", 0, 1, ()) is None
    assert root_of_inclusion(bytes(31), 0, 1, ()) is None
    assert root_of_inclusion(bytes(32), 0, 2, (bytes(33),)) is None
    for roots in ((b"", b""), (bytes(31), bytes(31)), (bytes(33), bytes(33))):
        assert not is_consistent(5, roots[0], 5, roots[1], ())


def test_from_the_empty_tree_an_empty_proof_will_do_and_its_root_is_that_of_no_leaves() -> None:
    """0.1.0 accepted any bytes as the root of the newer tree.

    The library of these vectors has no proof from size 0 at all; C2SP tlog-witness begins there.
    """
    cases = {name: vector for name, vector in vectors("merkle/consistency.json").items() if vector["size1"] == 0}
    assert {(vector["size2"], vector["wantErr"]) for vector in cases.values()} >= {(0, True), (1, True)}
    assert is_consistent(0, EMPTY_ROOT, 1, bytes(32), ())
    assert not is_consistent(0, EMPTY_ROOT, 1, b"don't care 2", ())
    assert not is_consistent(0, bytes(32), 1, bytes(32), ())
    assert is_consistent(0, EMPTY_ROOT, 0, EMPTY_ROOT, ())
    assert not is_consistent(0, EMPTY_ROOT, 0, bytes(32), ())
    assert not is_consistent(0, bytes(32), 0, bytes(32), ())


def test_signatures_are_judged_as_the_vectors_of_wycheproof_say() -> None:
    groups = json.loads((VECTORS / "wycheproof" / "ed25519_test.json").read_text("utf-8"))["testGroups"]
    wrong, judged = [], []
    for group in groups:
        key = VerifierKey("wycheproof", bytes.fromhex(group["publicKey"]["pk"]))
        for test in group["tests"]:
            judged.append(key.verifies(bytes.fromhex(test["sig"]), bytes.fromhex(test["msg"])))
            if judged[-1] != (test["result"] == "valid"):
                wrong.append((test["tcId"], test["comment"], test["flags"]))
    assert wrong == []
    assert len(judged) == 151
    assert 0 < sum(judged) < 151


# --- what C2SP prints ---


def test_the_checkpoint_that_the_specification_prints_is_read() -> None:
    text = (VECTORS / "c2sp" / "checkpoint.txt").read_text("utf-8")
    note = parse_note("example", text)
    assert str(note) == text
    assert (note.checkpoint.origin, note.checkpoint.size, note.checkpoint.root.hex()[:8]) == (
        "example.com/behind-the-sofa",
        20852163,
        "0ac5186a",
    )
    assert [(one.name, one.key_id.hex(), len(one.data)) for one in note.signatures] == [
        ("example.com/behind-the-sofa", "033de0ae", 64)
    ]
