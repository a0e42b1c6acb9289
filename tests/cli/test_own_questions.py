"""A SELECT of one's own: on the command line or in a file, with limits, and the same answer."""

import io
import json
import sys
from pathlib import Path

import pytest

from .conftest import Call, one_message

SELECT = "SELECT type, count(*) AS events\nFROM events\nGROUP BY type\nORDER BY ALL\n"


@pytest.fixture
def question(tmp_path: Path) -> Path:
    """A file with a SELECT, saved with the mark that some editors put first."""
    file = tmp_path / "question.sql"
    file.write_text(SELECT, encoding="utf-8-sig")
    return file


@pytest.mark.slow
def test_a_file_is_answered_like_its_text(
    call: Call, ledger: Path, question: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = call("sql", ledger, SELECT, "--json").good()
    assert json.loads(answer.out)["rows"]
    assert call("query", "--file", question, ledger, "--json") == answer
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(SELECT.encode())))
    assert call("query", "--file", "-", ledger, "--json", "--seconds", "30", "--memory", "1024") == answer


@pytest.mark.parametrize(
    ("content", "part"),
    [
        pytest.param(b"", "found no statement", marks=pytest.mark.slow),
        (b"-- only a comment", "found no statement"),
        pytest.param(b"SELECT '\xff'", "not UTF-8 at 8", marks=pytest.mark.slow),
        (b"SELECT '\0'", "NUL at character 9"),
        pytest.param(b"SELECT 1" + b" " * (1 << 20), "more than 1,048,576 bytes", marks=pytest.mark.slow),
        (b"COPY (SELECT 1) TO 'out'", "found COPY"),
        (b"SELECT * FROM read_text('/etc/passwd')", "disabled by configuration"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_with_its_name(
    call: Call, ledger: Path, question: Path, content: bytes, part: str
) -> None:
    question.write_bytes(content)
    one_message(call("query", "--file", question, ledger), 2, f"{question}: SQL: ", part)


def test_a_file_that_cannot_be_read_is_named(call: Call, ledger: Path, tmp_path: Path) -> None:
    one_message(call("query", "--file", tmp_path / "nothing.sql", ledger), 2, "nothing.sql", "No such file")
    one_message(call("query", "--file", tmp_path, ledger), 2, str(tmp_path), "Is a directory")


@pytest.mark.slow
def test_limits_are_kept_and_belong_to_questions_of_ones_own(call: Call, ledger: Path) -> None:
    one_message(
        call("sql", ledger, "SELECT sum(x % 7) FROM range(1000000000000) AS t(x)", "--seconds", "1"),
        2,
        "after 1 s, the limit",
    )
    one_message(call("sql", ledger, "SELECT len(range(1000000000))", "--memory", "1024"), 2, "the limit is 1,024 MiB")
    one_message(call("sql", ledger, "SELECT 1", "--seconds", "0"), 2, "at least 1")
    one_message(call("sql", ledger, "SELECT 1", "--memory", "1023"), 2, "at least 1024")
    one_message(call("sql", ledger, "SELECT 1", "--memory", "9" * 20), 2, "at most 16777216")
    one_message(call("sql", ledger, "SELECT 1", "--seconds", "9" * 20), 2, "at most 31536000")
    one_message(call("query", "failures", ledger, "--seconds", "9"), 2, "--seconds 9", "only with --file")


def test_a_file_stands_instead_of_a_name_and_has_no_parameters(call: Call, ledger: Path, question: Path) -> None:
    one_message(call("query", "--file", question), 2, "one argument, LEDGER")
    one_message(call("query", "--file", question, "failures", ledger), 2, "one argument, LEDGER")
    one_message(
        call("query", "--file", question, ledger, "--param", "robot=r"), 2, "only a packaged query has parameters"
    )
