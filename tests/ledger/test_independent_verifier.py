"""Two verifiers that share no code agree, and the document from which the second was written is right."""

import ast
import hashlib
import json
import re
import sys
from pathlib import Path
from typing import Any

import pytest

from fsar_ledger.ledger.rows.schema import COLUMNS, FINGERPRINTS, STORED
from tests.ledger.agreement import KEY, ROOT, Case, event_types, independent, judged
from tests.ledger.samples import made_up_batches
from tests.running import ran

COMMITTED, SIGNED_BY = made_up_batches(3), KEY
VERIFIER = ROOT / "tests" / "independent_verifier.py"
PAGE = (ROOT / "docs" / "ledger-format.md").read_text("utf-8")
EXAMPLE = re.findall(r"```\n(.*?)```", PAGE.partition("<!-- example -->")[2], flags=re.DOTALL)


def imported(file: Path) -> set[str]:
    nodes = [
        node for node in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(node, ast.Import | ast.ImportFrom)
    ]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {f"{node.module}" for node in nodes if isinstance(node, ast.ImportFrom)}
    return {name for name in names if name.partition(".")[0] not in sys.stdlib_module_names}


def test_the_independent_verifier_imports_nothing_of_ours_and_reads_parquet_by_itself() -> None:
    assert {file.stem: imported(file) for file in VERIFIER.parent.glob("independent_*.py")} == {
        "independent_proof": {"independent_verifier"},
        "independent_verifier": {
            "independent_chain",
            "independent_ed25519",
            "independent_verifier",
            "cryptography.exceptions",
            "cryptography.hazmat.primitives.asymmetric.ed25519",
        },
        "independent_chain": {"independent_cuts", "independent_parquet", "independent_tree", "independent_verifier"},
        "independent_cuts": set(),
        "independent_tree": {"independent_verifier"},
        "independent_parquet": {"independent_pages", "independent_thrift", "pyarrow"},
        "independent_ed25519": set(),
        "independent_pages": {"independent_thrift"},
        "independent_thrift": set(),
    }
    used = [
        node
        for node in ast.walk(ast.parse((VERIFIER.parent / "independent_parquet.py").read_text("utf-8")))
        if isinstance(node, ast.Attribute)
    ]
    assert {node.attr for node in used if isinstance(node.value, ast.Name) and node.value.id == "pa"} == {
        "Codec",
        "ArrowException",
    }


def test_a_disagreement_is_found(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = Case("as it is", path, True)
    assert judged(case).difference == ""
    assert "expected damage" in judged(case._replace(is_good=False)).difference
    monkeypatch.setattr(independent("independent_chain"), "root_of", lambda frontier: bytes(32))
    assert "the independent verifier (('chain.jsonl'" in judged(case).difference


def test_the_independent_verifier_works_from_a_shell(path: Path, tmp_path: Path) -> None:
    (tmp_path / "key.pub").write_text(f"{KEY.verifier}\n")
    (tmp_path / "anchor").write_bytes((path / "checkpoint").read_bytes())
    command = [
        sys.executable,
        str(VERIFIER),
        str(path),
        "--key",
        str(tmp_path / "key.pub"),
        "--anchor",
        str(tmp_path / "anchor"),
    ]
    command += ["--event-types", str(ROOT / "docs" / "event-types.json")]
    done = ran(command)
    assert (done.returncode, done.stdout.split()[:2], done.stderr) == (0, ["consistent:", "72"], "")
    (path / "nodes").write_bytes(b"")
    done = ran(command)
    assert (done.returncode, done.stdout.partition(":")[0], done.stderr) == (3, "nodes", "")


def test_the_list_of_event_types_is_that_of_the_package() -> None:
    types = event_types()["types"]
    assert event_types()["releases"] == FINGERPRINTS
    assert list(event_types()["columns"]) == list(COLUMNS)
    assert set(types) == set(STORED)
    for tag, layout in STORED.items():
        assert set(types[tag]["required"]) == {field.name for field in layout.fields if not field.is_nullable}
        assert set(types[tag]["optional"]) == {field.name for field in layout.fields if field.is_nullable}
        assert types[tag]["values"] == {
            field.name: sorted(field.values) for field in layout.fields if field.values is not None
        }


# --- the document ---


def sha256(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()


def rows_of_the_example() -> list[bytes]:
    return [line.encode() for line in EXAMPLE[2].removesuffix("\n").split("\n")]


def record_of_the_example() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(EXAMPLE[5].splitlines()[0])
    return found


def placement_of_the_example() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(EXAMPLE[5].splitlines()[1])
    return found


def test_the_strings_of_the_document_are_written_as_it_says() -> None:
    rows = re.findall(r"^\| (U\+[^|]*) \| [^|]* \| ([0-9a-f ]+) \|$", PAGE, flags=re.MULTILINE)
    assert len(rows) == 3
    for points, expected in rows:
        text = "".join(chr(int(point[2:], 16)) for point in points.split())
        assert independent().canonical(text).hex(" ") == expected


def test_the_example_of_a_fingerprint_is_right() -> None:
    columns = independent().ENVELOPE
    text = "".join(f"{name} {kind}\n" for name, kind in columns.items())
    assert text.startswith("run_id string not null\nseq int64 not null\n")
    assert sha256(text.encode()).hex() in PAGE


def test_the_leaves_and_roots_of_the_example_follow_from_its_rows() -> None:
    rows = rows_of_the_example()
    assert [independent().canonical(json.loads(row)) for row in rows] == rows
    leaves = [sha256(b"\x00" + row) for row in rows]
    first = sha256(b"\x01" + leaves[0] + leaves[1])
    assert EXAMPLE[3].split() == [leaf.hex() for leaf in leaves]
    assert EXAMPLE[4].split() == [first.hex(), sha256(b"\x01" + first + leaves[2]).hex()]
    assert placement_of_the_example()["frontier"] == [first.hex(), leaves[2].hex()]
    assert record_of_the_example()["tree_root"] == EXAMPLE[4].split()[1]


def test_the_notes_of_the_example_are_signed_by_its_key() -> None:
    module = independent()
    key, note = module.read_key(EXAMPLE[0]), module.read_note(EXAMPLE[6])
    assert (
        key[2].hex() == "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a"
    )  # RFC 8032, section 7.1, test 1
    assert (note.origin, note.size, note.root.hex()) == (key[0], 3, EXAMPLE[4].split()[1])
    assert note.has(key)
    signature = module.from_base64(record_of_the_example()["signature"])
    assert [key_id + data for _, key_id, data in note.signatures] == [signature]


def test_the_json_of_the_example_is_canonical() -> None:
    for text in (EXAMPLE[1].removesuffix("\n"), *EXAMPLE[5].splitlines()):
        assert independent().canonical(json.loads(text)).decode() == text


def test_the_proof_of_the_example_leads_to_its_root() -> None:
    module = independent()
    head, _, note = EXAMPLE[7].partition("\n\n")
    title, extra, index, *hashes = head.split("\n")
    assert (title, index) == ("c2sp.org/tlog-proof@v1", "index 1")
    event = module.from_base64(extra.removeprefix("extra "))
    first, last = map(module.from_base64, hashes)
    assert event == rows_of_the_example()[1]
    assert sha256(b"\x01" + sha256(b"\x01" + first + sha256(b"\x00" + event)) + last) == module.read_note(note).root
    assert note == EXAMPLE[6]


def test_the_document_names_every_member_of_a_record() -> None:
    chain = independent("independent_chain")
    named = set(re.findall(r"`(\w+)`", PAGE.partition("## 3.")[2].partition("## 4.")[0]))
    assert named >= set(chain.COMMIT | chain.OPTIONAL | chain.PLACEMENT | chain.ADDING)
