"""`maintain recover` as it is called: what it prints, its exit codes, and how a damaged ledger is continued."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from fsar_ledger.runtime import experiment, simulation
from tests.cli.conftest import SMALL, Call, one_message
from tests.ledger.samples import contents

MANY = (*SMALL[:2], "--architecture", "fsar", "--runs", "24", "--workers", "1")  # the plan, and three commits


@pytest.fixture(scope="module", autouse=True)
def small_commits() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for module in (simulation, experiment):
            patch.setattr(module, "COMMIT_EVENTS", 6_000)
        yield


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ledger of a plan and three commits that tests may read but not change."""
    from fsar_ledger.cli.app import run

    path = tmp_path_factory.mktemp("recover") / "ledger"
    assert run(["simulate", str(path), *MANY]) == 0
    return path


@pytest.fixture
def copy(many: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(many, tmp_path / "ledger"))


def segments_of(ledger: Path) -> list[str]:
    """Return the names within the ledger of its segments, in order."""
    return sorted(str(file.relative_to(ledger)) for file in (ledger / "segments").iterdir())


@pytest.mark.slow
def test_a_whole_ledger_is_said_to_be_whole(call: Call, many: Path, tmp_path: Path) -> None:
    said = call("maintain", "recover", many)
    assert (said.code, said.err) == (0, "")
    assert said.out.startswith(f"{many}: intact, nothing to repair\ntrusted\n  commits 0 to 3: ")
    assert "only --anchor" not in said.out
    assert "--anchor FILE" in said.out
    anchored = call("maintain", "recover", many, "--anchor", shutil.copy(many / "checkpoint", tmp_path / "monday"))
    assert "the anchor vouches for the first" in anchored.out
    assert "--anchor FILE" not in anchored.out
    own = call("maintain", "recover", many, "--anchor", many / "checkpoint")
    assert "the anchor vouches" not in own.out
    assert "  the anchor is this ledger's own checkpoint, which " in own.out


@pytest.mark.slow
def test_what_was_mended_is_named(call: Call, copy: Path) -> None:
    (copy / "checkpoint").unlink()
    (copy / "stray").write_bytes(b"?")
    said = call("maintain", "recover", copy)
    assert (said.code, said.err) == (0, "")
    assert f"set aside\n  stray -> {copy}.set-aside/000/stray\nmade again\n  checkpoint\n" in said.out
    assert call("verify", copy).code == 0


@pytest.mark.slow
def test_a_damaged_ledger_is_explained_and_continued(call: Call, copy: Path, many: Path, tmp_path: Path) -> None:
    lost = segments_of(copy)[2]
    (copy / lost).unlink()
    before = contents(copy)
    said = call("maintain", "recover", copy)
    assert (said.code, said.err) == (3, "")
    assert said.out.startswith(f"{copy}: damaged at commit 2; it was not changed\nfound\n  {lost}: commit 2")
    for line in (
        "  commits 0 to 1: ",
        "  commit 2: the segment is missing",
        "  commit 3: record and segment fit",
        "--into NEW copies",
        f"  {copy / lost} can be restored from a copy with SHA-256 ",
    ):
        assert f"\n{line}" in said.out or line in said.out
    new = tmp_path / "new"
    done = call("maintain", "recover", copy, "--into", new)
    assert (done.code, f"{new} holds what can be trusted" in done.out) == (0, True)
    assert call("verify", new).code == 0
    assert call("simulate", new, *MANY).code == 0
    assert contents(new) == contents(many)
    assert contents(copy) == before


@pytest.mark.slow
def test_programs_get_everything_as_json(call: Call, copy: Path) -> None:
    whole = json.loads(call("maintain", "recover", copy, "--json").out)
    assert (whole["outcome"], whole["head"]["commits"], whole["steps"], whole["into"]) == ("whole", 4, [], None)
    assert whole["report"]["root"] == whole["head"]["root"]
    last = segments_of(copy)[-1]
    (copy / last).unlink()
    said = call("maintain", "recover", copy, "--json")
    damaged = json.loads(said.out)
    assert (said.code, damaged["outcome"], damaged["head"]["commits"]) == (3, "damaged", 3)
    assert damaged["problems"][0]["where"] == last
    assert [(commit["number"], commit["file"]) for commit in damaged["later"]] == [(3, last)]


def test_long_lists_are_cut_for_people(call: Call, copy: Path) -> None:
    for number in range(13):
        (copy / f"stray-{number}").write_bytes(b"?")
    assert "  ... and 3 more; --json names all\n" in call("maintain", "recover", copy).out


@pytest.mark.slow
def test_with_a_key_the_answer_says_who_signed(call: Call, tmp_path: Path) -> None:
    key, path = tmp_path / "fleet.key", tmp_path / "ledger"
    public = call("key", "new", key).out.strip()
    assert call("simulate", path, *SMALL, "--key", key).code == 0
    signed = call("maintain", "recover", path, "--trusted-key", f"{key}.pub")
    assert (signed.code, f"  signed by {'+'.join(public.split('+')[:2])}\n" in signed.out) == (0, True)
    unchecked = call("maintain", "recover", path)
    assert "  signed, signer not checked" in unchecked.out
    assert call("key", "new", tmp_path / "other.key").code == 0
    other = call("maintain", "recover", path, "--trusted-key", f"{tmp_path / 'other.key'}.pub")
    assert (other.code, "trusted\n  no commit\n" in other.out) == (3, True)


def test_wrong_calls_are_one_message(call: Call, copy: Path, tmp_path: Path) -> None:
    one_message(call("maintain", "recover", tmp_path / "nowhere"), 2, "found no ledger there")
    one_message(call("maintain", "recover", copy, "--into", tmp_path), 2, "--into", "found a file or folder")
    one_message(call("maintain", "recover", copy, "--anchor", tmp_path / "nothing"), 2, "--anchor")
