"""A ledger of format 1 is only upgraded: every other verb says so, and one that does not verify is not copied."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import fsar_ledger
from fsar_ledger.base import printable
from fsar_ledger.base.errors import FormatVersionMismatch, FsarLedgerError, LedgerCorrupted, UsageError
from fsar_ledger.cli.app import run
from fsar_ledger.ledger.log.hashing import sha256_hex
from fsar_ledger.ledger.opening import open_for_answers
from fsar_ledger.ledger.rows import canonical
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.v1 import upgrade
from fsar_ledger.ledger.verify import recover, verify
from tests.ledger.keep_release import LEDGERS
from tests.ledger.samples import ORIGIN, contents
from tests.quick import few

KEPT = LEDGERS / "0.8.1" / "ledger"
NEWEST = "000000000003"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A ledger of format 1 to be changed, at a path that has to be quoted."""
    return Path(shutil.copytree(KEPT, tmp_path / "an old ledger"))


# --- every other verb ---

VERBS = (
    *("verify", "verify --quick", "verify --replay", "info", "audit", "metrics", "statistics", "query runs"),
    *("sql SELECT", "log", "prove 3", "maintain recover", "maintain compact", "simulate --runs 1"),
    *("export --out OUT.csv", "export --tiles --out OUT", "report --out OUT.pdf", "view --out OUT.html"),
)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_names_the_command_that_upgrades(old: Path, capsys: pytest.CaptureFixture[str], verb: str) -> None:
    before, words = contents(old), verb.replace("OUT", str(old.parent / "out").replace(" ", "\0")).split()
    words.insert(2 if words[0] in ("query", "maintain") else 1, str(old))
    assert run([word.replace("\0", " ") for word in words]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert f"fsar-ledger maintain upgrade '{old}' --into NEW" in told.err
    assert "of format 1" in told.err
    assert contents(old) == before
    assert [path.name for path in old.parent.iterdir()] == [old.name]


@pytest.mark.parametrize(
    "call",
    [
        fsar_ledger.open_ledger,
        open_for_answers,
        verify,
        recover,
        lambda path: Writer(path, "example.org/kept"),
        lambda path: fsar_ledger.Ledger(path).audit(),
    ],
)
def test_so_does_every_function(old: Path, call: Callable[[Path], object]) -> None:
    with pytest.raises(FormatVersionMismatch, match="run fsar-ledger maintain upgrade") as refused:
        call(old)
    assert f"{printable.word(old)} --into NEW" in str(refused.value)


# --- what is upgraded ---


def test_an_interrupted_upgrade_goes_on_and_other_events_are_left_alone(tmp_path: Path) -> None:
    told: list[int] = []

    def stop(now: int, _: int) -> None:
        told.append(now)
        if told == [1, 2, 3, 4, 1, 2]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        upgrade(KEPT, tmp_path / "new", stop)
    assert open_for_answers(tmp_path / "new").head.commits == 2
    assert upgrade(KEPT, tmp_path / "new") == open_for_answers(tmp_path / "new").head
    assert open_for_answers(tmp_path / "new").head.commits == 4
    before = contents(tmp_path / "new")
    with pytest.raises(UsageError, match="found a ledger of other events, expected a free path"):
        upgrade(LEDGERS / "0.6.0" / "ledger", tmp_path / "new")
    with pytest.raises(UsageError, match="found no ledger of format 1"):
        upgrade(tmp_path / "new", tmp_path / "newer")
    assert contents(tmp_path / "new") == before
    assert not (tmp_path / "newer").exists()


def test_an_empty_ledger_is_upgraded(tmp_path: Path) -> None:
    for folder in ("commits", "segments", "staging"):
        (tmp_path / "old" / folder).mkdir(parents=True)
    manifest = {"format": "fsar-ledger", "origin": ORIGIN, "version": 1}
    (tmp_path / "old" / "ledger.json").write_bytes(canonical.document(manifest))
    assert upgrade(tmp_path / "old", tmp_path / "new").size == 0
    assert verify(tmp_path / "new").ok


# --- what is not ---


def refused(old: Path, kind: type[FsarLedgerError], message: str) -> None:
    """The upgrade is refused with this message, and nothing is written."""
    before = contents(old)
    with pytest.raises(kind, match=message):
        upgrade(old, old.parent / "new")
    assert contents(old) == before
    assert not (old.parent / "new").exists()


def leave_in_staging(old: Path) -> None:
    (old / "staging").mkdir(exist_ok=True)
    (old / "staging" / "x.tmp").write_bytes(b"x")


def leave_a_segment_in_staging(old: Path) -> None:
    (old / "staging").mkdir(exist_ok=True)
    segment = old / "segments" / f"{NEWEST}.parquet"
    segment.rename(old / "staging" / f"{sha256_hex(segment.read_bytes())}.parquet")


def leave_the_checkpoint_behind(old: Path) -> None:
    note = json.loads((old / "commits" / "000000000002.json").read_bytes())["note"]
    (old / "checkpoint").write_text(note, "utf-8")


def leave_outgrown_tiles(old: Path) -> None:
    sizes = [json.loads(file.read_bytes())["tree_size"] for file in sorted((old / "commits").iterdir())]
    first = sizes[0]
    (old / "tile" / "0" / "000.p").mkdir()
    (old / "tile" / "0" / "000.p" / f"{first}").write_bytes((old / "tile" / "0" / "000").read_bytes()[: 32 * first])


@pytest.mark.parametrize(
    "leave", [leave_in_staging, leave_a_segment_in_staging, leave_the_checkpoint_behind, leave_outgrown_tiles]
)
def test_what_an_interrupted_writer_left_is_for_an_older_release(old: Path, leave: Callable[[Path], None]) -> None:
    leave(old)
    refused(old, UsageError, "recover it with fsar-ledger 0.8 first")


def files() -> list[str]:
    return list(contents(KEPT))


@pytest.mark.parametrize("name", few(files(), files()[::6]))
def test_a_file_that_is_missing_cut_changed_or_a_link_is_named_and_nothing_is_written(old: Path, name: str) -> None:
    data = (old / name).read_bytes()
    for other in (None, b"", data[:-1], data + b"x", data[: len(data) // 2] + b"x" + data[len(data) // 2 + 1 :]):
        (old / name).unlink() if other is None else (old / name).write_bytes(other)
        refused(old, LedgerCorrupted, "found ")
        (old / name).write_bytes(data)
    (old.parent / "beside").write_bytes(data)
    (old / name).unlink()
    (old / name).symlink_to(old.parent / "beside")
    refused(old, LedgerCorrupted, "found ")


@pytest.mark.parametrize("name", ["stray", "commits/stray", "segments/stray", "tile/stray", "tile/0/x001/000"])
def test_a_stray_file_is_named(old: Path, name: str) -> None:
    (old / name).parent.mkdir(exist_ok=True)
    (old / name).write_bytes(b"x")
    refused(old, LedgerCorrupted, f"{name}: found ")


@pytest.mark.parametrize("folder", ["commits", "segments", "tile"])
def test_a_folder_that_is_missing_or_a_link_is_named(old: Path, folder: str) -> None:
    (old / folder).rename(old.parent / "aside")
    refused(old, LedgerCorrupted, folder)
    (old / folder).symlink_to(old.parent / "aside")
    refused(old, LedgerCorrupted, f"{folder}: found a link")


def forge(old: Path, number: int, /, **changes: object) -> None:
    """Change one record, and chain all later ones and the checkpoint to it again."""
    previous = sha256_hex((old / "ledger.json").read_bytes())
    for at, file in enumerate(sorted((old / "commits").iterdir())):
        record = json.loads(file.read_bytes()) | {"previous_sha256": previous} | (changes if at == number else {})
        file.write_bytes(canonical.document(record))
        previous = sha256_hex(file.read_bytes())
        (old / "checkpoint").write_text(record["note"], "utf-8")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("number", 9),
        ("release", "0.0.1"),
        ("schema_sha256", "0" * 64),
        ("segment_sha256", "0" * 64),
        ("segment_bytes", 77),
        ("rows", 5),
        ("first_run", "another"),
        ("last_run", "another"),
        ("tree_size", 7),
        ("tree_root", "0" * 64),
        ("frontier", []),
        ("note", "example.org/kept\n1\nAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA=\n\n"),
    ],
)
@pytest.mark.parametrize("number", [0, 3])
def test_each_field_of_a_record_is_compared(old: Path, number: int, field: str, value: object) -> None:
    forge(old, number, **{field: value})
    refused(old, LedgerCorrupted, f"commit {number}|{number:012d}")


def test_a_run_in_two_commits_is_found(old: Path) -> None:
    first, last = (json.loads((old / "commits" / f"{number:012d}.json").read_bytes()) for number in (2, 3))
    shutil.copyfile(old / "segments" / "000000000002.parquet", old / "segments" / f"{NEWEST}.parquet")
    same = {name: first[name] for name in ("segment_sha256", "segment_bytes", "first_run", "last_run")}
    forge(old, 3, **same, rows=first["rows"], tree_size=last["tree_size"] - last["rows"] + first["rows"])
    refused(old, LedgerCorrupted, "commit 3")
