"""A token tells who speaks; the file tells nobody a token, and a line that is gone is a token that is void."""

import hmac
import os
from contextlib import nullcontext
from pathlib import Path

import msgspec
import pytest
import regex

from fsar_ledger.base.errors import UsageError, WriteFailed
from fsar_ledger.runtime.handlers.public import commands, own_fields
from fsar_ledger.runtime.live import command_given
from fsar_ledger.service import KINDS, Principals, add_principal
from fsar_ledger.service.client import Client, Refused
from fsar_ledger.service.pages import described, page


def test_a_token_is_that_of_its_principal_alone(tmp_path: Path) -> None:
    file = tmp_path / "principals"
    one, other = (add_principal(file, name) for name in ("robot/A1", "supervisor/maria"))
    known = Principals(file)
    found = [known.authenticate(f"Bearer {token}") for token in (one, other)]
    assert [principal.principal for principal in found if principal is not None] == ["robot/A1", "supervisor/maria"]
    assert known.authenticate(f"bearer {one}") == found[0]
    mixed = ".".join((*one.split(".")[:2], other.split(".")[2]))
    for wrong in (mixed, one[:-1], one + "x", f"x{one}", one.upper(), "", "fsar..", "fsar.\udcff.\udcff"):
        assert known.authenticate(f"Bearer {wrong}") is None
    assert known.authenticate(f"Basic {one}") is None
    assert known.authenticate(one) is None


def test_the_file_holds_no_secret_and_is_its_owners(tmp_path: Path) -> None:
    file = tmp_path / "principals"
    secret = add_principal(file, "robot/A1").rpartition(".")[2]
    assert secret not in file.read_text()
    assert file.stat().st_mode & 0o077 == 0


def test_a_line_that_is_taken_out_is_a_token_that_is_void_at_once(tmp_path: Path) -> None:
    file = tmp_path / "principals"
    old, new = (add_principal(file, "robot/A1") for _ in range(2))
    known = Principals(file)
    assert known.authenticate(f"Bearer {old}")
    before = file.stat()
    file.write_bytes(b"".join(file.read_bytes().splitlines(keepends=True)[1:]))
    os.utime(file, ns=(before.st_atime_ns, before.st_mtime_ns))  # as a copy that keeps the times does
    assert known.authenticate(f"Bearer {old}") is None
    assert known.authenticate(f"Bearer {new}")


def test_the_secret_is_compared_in_constant_time_for_unknown_tokens_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_principal(tmp_path / "principals", "robot/A1")
    known, compared = Principals(tmp_path / "principals"), []

    def compare(*pair: str) -> bool:
        compared.append(pair)
        return False

    monkeypatch.setattr(hmac, "compare_digest", compare)
    for token in ("fsar.unknown.x", "nothing", ""):
        known.authenticate(f"Bearer {token}")
    assert len(compared) == 3


def test_a_file_whose_last_line_is_open_or_empty_takes_another_principal(tmp_path: Path) -> None:
    file = tmp_path / "principals"
    for number, end in enumerate((b"", b"\n\n", b"\r\n"), start=1):
        add_principal(file, "robot/A1")
        file.write_bytes(file.read_bytes().rstrip() + end)
        token = add_principal(file, "robot/B1")
        known = Principals(file)
        assert len(known) == 2 * number
        assert known.authenticate(f"Bearer {token}")


def test_a_line_of_no_kind_and_a_second_line_of_one_token_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "principals"
    add_principal(file, "robot/A1")
    line = file.read_text()
    for added, found in (
        (line.replace("robot/A1", "robots/A1"), "found robots/A1, expected a kind and"),
        (line.replace("robot/A1", "robot/B1"), "found a token_id that an earlier line has"),
    ):
        file.write_text(line + added)
        with pytest.raises(UsageError, match=f"principals:2: {found}"):
            Principals(file)


@pytest.mark.parametrize(
    "name", ["A1", "robot/", "/A1", "person/anna", "robot/A 1", "robot/A\n1", "robot/" + "x" * 200]
)
def test_a_name_that_no_principal_has_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError, match="expected a kind and a name without spaces, such as robot/A1, of at"):
        add_principal(tmp_path / "principals", name)
    assert not (tmp_path / "principals").exists()


def test_no_token_speaks_as_a_part_of_the_federation(tmp_path: Path) -> None:
    for name in ("registry", "coordination", "recovery", "policy", "trust"):
        with pytest.raises(UsageError, match=f"NAME service/{name}: found a part of the federation itself"):
            add_principal(tmp_path / "principals", f"service/{name}")


def test_a_file_that_holds_something_else_is_refused_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "principals"
    add_principal(file, "robot/A1")
    for damage in (b"no line\n", b'{"principal": "robot/A1"}\n', b"\xff\n"):
        file.write_bytes(file.read_bytes().splitlines(keepends=True)[0] + damage)
        with pytest.raises(UsageError, match="principals:2: "):
            Principals(file)
        with pytest.raises(UsageError, match="principals:2: "):
            add_principal(file, "robot/B1")
    with pytest.raises(UsageError, match="No such file"):
        Principals(tmp_path / "none")
    with pytest.raises(WriteFailed, match="the principal was not added"):
        add_principal(tmp_path / "none" / "principals", "robot/A1")


def test_the_description_has_every_command_with_its_fields_and_what_must_be_given() -> None:
    schemas = described()["components"]["schemas"]
    for name, kind in commands().items():
        operation = described()["paths"][f"/commands/{name}"]["post"]
        assert operation["requestBody"]["content"]["application/json"]["schema"]["$ref"].endswith(f"/{name}")
        assert set(schemas[name]["properties"]) == set(own_fields(kind))
        required = {field.name for field in msgspec.structs.fields(kind) if field.required}
        assert set(schemas[name].get("required", [])) == required
        for missing in required:
            given = {one: None for one in required if one != missing}
            with pytest.raises(UsageError, match=f"command {name}"):
                command_given(name, "robot/A1", given)
        assert f"id={name}>" in page("day")
    assert "Work" not in commands()
    assert all(f"<code>{kind}/" in page("day") for kind in KINDS)


def test_the_description_says_which_text_and_numbers_a_command_refuses() -> None:
    schemas = described()["components"]["schemas"]
    pattern = schemas["SetTrust"]["properties"]["robot"]["pattern"]
    assert pattern == schemas["SubmitTask"]["properties"]["steps"]["items"]["pattern"]
    allowed = regex.compile(pattern)
    for text in ("", "a b", "任务", "é", "a\u00a0b", "\u200b", "\ue000", "\n", "\U00037bca", "\x85"):
        assert bool(allowed.fullmatch(text)) is text.isprintable(), ascii(text)
    number = schemas["SubmitTask"]["properties"]["budget_us"]
    for budget_us in (number["maximum"], number["maximum"] + 1):
        fields = {"task_id": "t", "robot": "robot/A1", "steps": ["A inspect.visual"], "budget_us": budget_us}
        with nullcontext() if budget_us == number["maximum"] else pytest.raises(UsageError, match="2\\^50"):
            command_given("SubmitTask", "robot/A1", fields)


def test_the_page_shows_a_name_that_is_no_markup() -> None:
    assert "<script>" not in page("<script>alert(1)</script>")


def test_a_client_refuses_what_no_header_and_no_json_can_hold() -> None:
    for token in ("fsar.1.x\n", "fsar.1.✓"):  # of a file that was read whole, for one
        with pytest.raises(UsageError, match="token: found characters that no token has") as refused:
            Client("http://localhost:1", token)
        assert "fsar.1" not in str(refused.value)
    with Client("http://localhost:1", "fsar.1.x", patience_s=0) as way:
        for key in ("任务", "a\nb"):
            with pytest.raises(UsageError, match="expected characters of Latin-1"):
                way.give("ReportStart", key=key)
        for key in ("", " ", " k", "k "):
            with pytest.raises(UsageError, match="expected at least one character, and no blank at either end"):
                way.give("ReportStart", key=key)
        for name in ("t\ud800", object()):
            with pytest.raises(UsageError, match="expected fields that are JSON"):
                way.give("ReportStart", action_id=name)
        with pytest.raises(Refused, match="does not answer"):
            way.give("ReportStart", key="Tür")
