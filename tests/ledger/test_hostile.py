import json
import os
import resource
import shutil
import socket
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fsar_ledger.base.errors import FsarLedgerError, LedgerCorrupted
from fsar_ledger.cli import app
from fsar_ledger.ledger.store import disk
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.paths import CHAIN, INDEX, NODES
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.forgery import forge_segment, segment_at, table_of
from tests.ledger.hostile import documents, lying_pages, parquets, records
from tests.ledger.samples import ORIGIN, append_all, made_up_batches, made_up_run
from tests.quick import few

COMMITTED = [[made_up_run(f"run-{number}", size, number)] for number, size in enumerate((130, 3))]
READERS = (("info",), ("metrics",), ("query", "failures"))


def refused(capsys: pytest.CaptureFixture[str], command: tuple[str, ...], path: Path) -> str:
    """Run the command here, and return its message; it must exit with 2 or 3 and show nothing else."""
    capsys.readouterr()
    code = app.run([*command, str(path)])
    captured = capsys.readouterr()
    assert code in ((3,) if command[0] == "verify" else (2, 3)), (command, code, captured)
    assert captured.err.startswith("fsar-ledger: ")
    assert captured.out == "" or "--json" in command
    assert len(captured.err) < 200_000
    assert all(character.isprintable() or character == "\n" for character in captured.err), captured.err
    return captured.err


# --- JSON and notes ---


@pytest.mark.parametrize("name", few(["ledger.json", "checkpoint"], ["checkpoint"]))
def test_a_malformed_document_is_refused_by_every_command(
    path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    good = (path / name).read_bytes()
    for what, data in documents(good):
        if data == good:
            continue
        (path / name).write_bytes(data)
        report = verify(path)
        assert not report.ok, what
        assert any(name in str(problem) for problem in report.problems), (what, report.problems)
        refused(capsys, ("verify", "--workers", "1"), path)
        if name != "checkpoint":  # readers do not look at it
            for command in READERS:
                refused(capsys, command, path)
        with pytest.raises(FsarLedgerError):
            Writer(path, ORIGIN)


@pytest.mark.slow
def test_a_record_of_what_cannot_be_is_refused_by_every_command(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = (path / CHAIN).read_bytes().splitlines(keepends=True)
    for at, line in enumerate(lines[:2]):  # a commit and a placement, with more behind them
        for what, data in records(json.loads(line)):
            (path / CHAIN).write_bytes(b"".join([*lines[:at], data + b"\n", *lines[at + 1 :]]))
            report = verify(path)
            assert not report.ok, what
            assert at or CHAIN in str(report.problems[0]), (what, report.problems)
            refused(capsys, ("verify", "--workers", "1", "--json"), path)
            refused(capsys, ("metrics",), path)


@pytest.mark.slow
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(["ledger.json", "checkpoint"]),
    at=st.floats(0, 1),
    length=st.integers(0, 40),
    piece=st.sampled_from(
        [
            b"",
            b"\0",
            b'"',
            b"\\",
            b"{",
            b"[",
            b"}",
            b",",
            b":",
            b"\xff",
            b"\n",
            b"\n\n",
            b"-",
            b"e9",
            b"9" * 30,
            b"null",
            b"\\u0000",
        ]
    ),
)
def test_any_json_with_a_piece_replaced_is_found_and_never_raises(
    path: Path, name: str, at: float, length: int, piece: bytes
) -> None:
    good = (path / name).read_bytes()
    start = int(at * len(good))
    data = good[:start] + piece + good[start + length :]
    (path / name).write_bytes(data)
    report = verify(path)
    assert report.ok == (data == good)
    assert report.ok or any(name in str(problem) for problem in report.problems)
    (path / name).write_bytes(good)


# --- Parquet ---


@pytest.mark.slow
def test_a_hostile_segment_is_never_passed_and_never_unpacked(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, good = table_of(path, 0), segment_at(path, 0).read_bytes()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for what, data in [*parquets(table, good), *lying_pages(table)]:
        assert len(data) < 1 << 22, what
        forge_segment(path, 0, data)
        report = verify(path)
        assert not report.ok, what
        assert (report.problems[0].commit, report.problems[0].run) == (0, None), (what, report.problems)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1 << 20, (
        "KiB more than before: something was unpacked"
    )


# --- tiles, and things that are not files ---


def in_place_of(file: Path) -> dict[str, Callable[[], object]]:
    """Return what may be where a file should be."""
    data = file.read_bytes()
    aside = next(parent for parent in file.parents if parent.name == "ledger").parent / "aside"

    def link_to(target: str) -> Callable[[], object]:
        return lambda: file.symlink_to(target)

    def bind() -> None:
        folder = os.open(file.parent, os.O_RDONLY)
        with socket.socket(socket.AF_UNIX) as one:
            one.bind(f"/proc/self/fd/{folder}/{file.name}")
        os.close(folder)

    def sparse() -> None:
        file.write_bytes(data)
        os.truncate(file, 1 << 40)

    aside.write_bytes(data)
    return {
        "nothing": lambda: None,
        "a folder": file.mkdir,
        "a pipe": lambda: os.mkfifo(file),
        "a socket": bind,
        "a link to the same": link_to(str(aside)),
        "a link to nowhere": link_to("/nowhere"),
        "a link to itself": link_to(file.name),
        "a link to a device": link_to("/dev/zero"),
        "a terabyte of nothing": sparse,
    }


@pytest.mark.parametrize(
    "name",
    few(["ledger.json", "checkpoint", CHAIN, "segments/000000000130-000000000133.parquet", NODES, INDEX], [CHAIN]),
)
def test_what_is_no_file_is_refused_by_every_command(
    path: Path, intact: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    is_derived = name in ("checkpoint", NODES, INDEX)
    for what, make in in_place_of(path / name).items():
        (path / name).unlink()
        try:
            make()
        except OSError as error:
            pytest.skip(f"this file system has no {what}: {error}")
        report = verify(path)
        assert not report.ok, what
        is_gone = what == "nothing" and name == CHAIN  # only the other files show that there was one
        assert is_gone or any(name in str(problem) for problem in report.problems), (what, report.problems)
        refused(capsys, ("verify", "--workers", "1"), path)
        if not is_derived:
            for command in READERS:
                refused(capsys, command, path)
        shutil.rmtree(path)
        shutil.copytree(intact, path)


@pytest.mark.parametrize("folder", ["", "segments"])
@pytest.mark.parametrize("name", [b"\xff\xfe", b"a\nb", b"\x1b[2J", b"..." + b"x" * 200, "\u202e".encode()])
def test_a_stray_file_of_any_name_is_named_in_printable_text(
    path: Path, capsys: pytest.CaptureFixture[str], folder: str, name: bytes
) -> None:
    (Path(os.fsdecode(os.path.join(os.fsencode(path / folder), name)))).write_bytes(b"")
    (problem,) = verify(path).problems
    assert problem.where.startswith(folder)
    refused(capsys, ("verify", "--workers", "1"), path)
    refused(capsys, ("verify", "--workers", "1", "--json"), path)


def test_a_folder_with_more_names_than_any_ledger_has_is_refused(
    path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk, "MAX_NAMES", 20)
    assert verify(path).ok
    for folder in ("", "segments"):
        for number in range(30):
            (path / folder / f"stray-{number}").write_bytes(b"")
        assert "more than 20 names" in refused(capsys, ("verify", "--workers", "1"), path)
        for number in range(30):
            (path / folder / f"stray-{number}").unlink()
    assert verify(path).ok


# --- links that lead out of the ledger ---


@pytest.mark.parametrize("folder", ["segments", "staging"])
def test_a_folder_that_is_a_link_is_refused_and_what_it_leads_to_stays(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], folder: str
) -> None:
    elsewhere = tmp_path / "elsewhere"
    (path / folder).rename(elsewhere)
    (path / folder).symlink_to(elsewhere)
    (elsewhere / "letter.txt").write_text("dear")
    assert folder in {problem.where for problem in verify(path).problems}
    for command in READERS:
        refused(capsys, command, path)
    with pytest.raises(LedgerCorrupted, match="link"):
        Writer(path, ORIGIN)
    assert (elsewhere / "letter.txt").read_text() == "dear"


# --- what a writer refuses to make ---


@pytest.mark.slow
def test_a_commit_that_readers_would_refuse_is_not_made(tmp_path: Path) -> None:
    long = msgspec.structs.replace(made_up_run("x", 520, 1), run_id="x" * (1 << 20))
    (batch,) = made_up_batches(1)
    append_all(tmp_path / "ledger", [batch])
    with pytest.raises(ValueError, match="bytes of text"):
        stage(tmp_path / "ledger", [long])
    assert verify(tmp_path / "ledger").ok
