import json
import os
import shutil
import stat
from pathlib import Path

import pytest

from fsar_ledger import Ledger
from fsar_ledger.cli import app
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.store.keys import read_verifier
from tests.cli.conftest import SMALL, Call, Called, in_a_process, one_message
from tests.ledger.samples import contents

RUN = "fsar.full.door-relay.n4.s7.r0000"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a key, a ledger that it signed, and a proof."""
    path = tmp_path_factory.mktemp("trust")
    for command in (
        ("key", "new", path / "fleet.key"),
        ("simulate", path / "ledger", *SMALL, "--key", path / "fleet.key"),
        ("prove", path / "ledger", f"{RUN}:12", "--out", path / "event.tlog-proof"),
    ):
        assert app.run([*map(str, command)]) == 0
    return path


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    """A ledger that a test may damage."""
    return Path(shutil.copytree(folder / "ledger", tmp_path / "ledger"))


def size_of(ledger: Path) -> int:
    """How many events the ledger has."""
    return int((ledger / "checkpoint").read_text().splitlines()[1])


def key_of(folder: Path) -> str:
    return read_verifier(str(folder / "fleet.key.pub")).key


# --- keys ---


def test_a_new_key_prints_its_public_half(call: Call, tmp_path: Path) -> None:
    called = call("key", "new", tmp_path / "new" / "a.key")
    assert (called.code, called.err) == (0, "")
    assert called.out == (tmp_path / "new" / "a.key.pub").read_text()
    assert called.out.startswith("fsar-ledger/simulated+")
    assert stat.S_IMODE((tmp_path / "new" / "a.key").stat().st_mode) == 0o600
    assert call("key", "new", tmp_path / "b.key", "--name", "example.org/arm").out.startswith("example.org/arm+")


def test_a_key_is_made_once(call: Call, folder: Path) -> None:
    one_message(call("key", "new", folder / "fleet.key"), 2, "fleet.key", "never overwritten")
    one_message(call("key", "new", folder / "x.key", "--name", "two words"), 2, "--name 'two words'")


def test_key_alone_says_what_is_missing(call: Call) -> None:
    one_message(call("key"), 2, "Missing command", "fsar-ledger key --help")
    one_message(call("key", "new"), 2, "FILE", "fsar-ledger key new --help")
    one_message(call("key", "old"), 2, "'old'")


def test_a_key_in_the_environment_signs_as_well(folder: Path, tmp_path: Path) -> None:
    called = in_a_process(
        "simulate",
        tmp_path / "ledger",
        *(*SMALL[:2], "--runs", "1"),
        surroundings={"FSAR_LEDGER_KEY": str(folder / "fleet.key")},
    )
    assert (called.code, called.err) == (0, "")
    assert f"signed by {key_of(folder)}\n" in called.out
    assert (tmp_path / "ledger" / "checkpoint").read_text().count("\N{EM DASH} fsar-ledger/simulated ") == 1


def test_a_key_that_cannot_sign_is_refused_before_anything_is_written(call: Call, folder: Path, tmp_path: Path) -> None:
    assert call("key", "new", tmp_path / "arm.key", "--name", "example.org/arm").code == 0
    named = ("--origin", "example.org/leg", "--key", tmp_path / "arm.key")
    one_message(
        call("simulate", tmp_path / "ledger", *SMALL, *named),
        2,
        "found a key named example.org/arm, expected example.org/leg",
    )
    shutil.copy(folder / "fleet.key", tmp_path / "open.key")
    (tmp_path / "open.key").chmod(0o644)
    for key, part in (
        (tmp_path / "none.key", "none.key"),
        (folder / "fleet.key.pub", "no secret key"),
        (tmp_path / "open.key", "mode 644"),
    ):
        one_message(call("simulate", tmp_path / "ledger", *SMALL, "--key", key), 2, part)
        one_message(call("reproduce", "--out", tmp_path / "out", "--key", key), 2, part)
    assert not (tmp_path / "ledger").exists()
    assert not (tmp_path / "out" / "results" / "ledger.json").exists()


def test_a_ledger_has_the_origin_that_was_asked_for_or_the_name_of_its_key(call: Call, tmp_path: Path) -> None:
    assert call("key", "new", tmp_path / "arm.key", "--name", "example.org/arm").code == 0
    small = ("--scenario", "door-relay", "--architecture", "fsar", "--runs", "1", "--workers", "1")
    for name, options, origin in (
        ("asked", ("--origin", "example.org/leg"), "example.org/leg"),
        ("key", ("--key", tmp_path / "arm.key"), "example.org/arm"),
        ("both", ("--origin", "example.org/arm", "--key", tmp_path / "arm.key"), "example.org/arm"),
        ("none", (), "fsar-ledger/simulated"),
    ):
        assert call("simulate", tmp_path / name, *small, *options).code == 0
        assert (tmp_path / name / "checkpoint").read_text().split("\n")[0] == origin
        assert call("simulate", tmp_path / name, *small, *options).code == 0
    assert (
        "consistent, signed by example.org/arm+"
        in call("verify", tmp_path / "key", "--trusted-key", tmp_path / "arm.key.pub").out
    )
    one_message(call("simulate", tmp_path / "asked", *small), 2, "found a ledger of origin 'example.org/leg'")
    for name in ("", "two words", "a+b"):
        one_message(call("simulate", tmp_path / "new", *small, "--origin", name), 2, "--origin", "without spaces")
    assert not (tmp_path / "new").exists()


def test_who_signs_changes_the_notes_and_nothing_else(folder: Path, ledger: Path) -> None:
    def rest(path: Path) -> dict[str, bytes]:
        same = ("segments", "tile", "ledger.json")
        return {name: data for name, data in contents(path).items() if name.startswith(same)}

    assert rest(folder / "ledger") == rest(ledger)


def test_a_ledger_that_is_complete_is_not_signed_afterwards_and_that_is_said(
    call: Call, folder: Path, tmp_path: Path
) -> None:
    small = ("simulate", tmp_path / "ledger", *SMALL[:2], "--runs", "1")
    assert "signed" not in call(*small).out
    assert (
        "nothing was signed; the newest commit is unsigned"
        in call(*small, "--key", folder / "fleet.key", "--adopt").out
    )
    assert "consistent, unsigned" in call("verify", tmp_path / "ledger").out


def test_a_key_goes_on_after_what_it_did_not_sign_only_if_told_to(call: Call, folder: Path, tmp_path: Path) -> None:
    def simulate(seed: int, *options: str | Path) -> Called:
        return call("simulate", tmp_path / "ledger", *SMALL[:2], "--runs", "1", "--seed", seed, *options)

    key = ("--key", folder / "fleet.key")
    simulate(1)
    one_message(
        simulate(2, *key),
        2,
        "found a newest checkpoint with no signature",
        "verify the ledger, and give --adopt to sign from here on",
    )
    recorded = call("record", tmp_path / "ledger", "--run", "r", *key)  # which has no --adopt
    one_message(recorded, 2, "with `record`, `import`, `federate` and `serve`, continue in a new ledger")
    assert open_ledger(tmp_path / "ledger").head.commits == 2
    assert "signed by" in simulate(2, *key, "--adopt").out
    assert "signed by" in simulate(3, *key).out
    one_message(simulate(4, "--adopt"), 2, "--adopt: found no --key")
    one_message(simulate(4), 2, "found a newest commit signed by ", "give it with --key, or continue in a new ledger")


def test_the_secret_is_in_no_output_and_in_no_file_of_the_ledger(call: Call, folder: Path) -> None:
    secret = (folder / "fleet.key").read_text().strip().split("+", 4)[-1][-40:]  # Base64 has `+`, too
    for arguments in (("verify", "--trusted-key"), ("verify-proof", "--trusted-key")):
        target = folder / ("ledger" if arguments[0] == "verify" else "event.tlog-proof")
        for key in (str(folder / "fleet.key"), (folder / "fleet.key").read_text().strip()):
            called = call(arguments[0], target, arguments[1], key)
            assert called.code == 2
            assert secret not in called.out + called.err
    file, seed = folder / "fleet.key", (folder / "fleet.key").read_text().split("+", 4)[-1][:8]
    for wrong in (
        ("verify", folder / "ledger", "--anchor", file),
        ("verify", folder / "ledger", "--witness-policy", file),
        ("verify-proof", file),
        ("verify-proof", file, "--json"),
        ("verify-proof", folder / "event.tlog-proof", "--anchor", file),
    ):
        called = call(*wrong)
        assert called.code in (2, 3)
        assert "PRIVATE+KEY+(not shown)" in called.err
        assert seed not in called.out + called.err
    assert not [one for one in (folder / "ledger").rglob("*") if one.is_file() and secret.encode() in one.read_bytes()]


# --- verify ---


def test_verify_says_how_it_looked_who_signed_and_since_when_it_only_grew(call: Call, folder: Path) -> None:
    key, ledger, anchor = key_of(folder), folder / "ledger", ("--anchor", folder / "ledger" / "checkpoint")
    assert f"consistent, signed, signer not checked (it names {key}): " in call("verify", ledger).out
    for trusted in (folder / "fleet.key.pub", (folder / "fleet.key.pub").read_text().strip()):
        out = call("verify", ledger, "--trusted-key", trusted, *anchor).out
        assert f"consistent, signed by {key}: " in out
        assert "signed commits: 2 of 2\n" in out
        assert f"only grew since the anchor's {size_of(ledger):,} events\n" in out
    quick = call("verify", ledger, "--quick").out
    assert "consistent at a quick look, which reads no rows, signed" in quick
    assert quick.endswith("rows were not compared with the recorded roots\n")
    assert "runs" not in quick
    quick = call("verify", ledger, "--quick", *anchor).out
    assert quick.endswith(
        f"\nthe recorded roots only grew since the anchor's {size_of(ledger):,} events; rows were not compared "
        "with them\n"
    )


def test_verify_says_the_same_as_json(call: Call, folder: Path) -> None:
    ledger, size = folder / "ledger", size_of(folder / "ledger")
    trusted = ("--trusted-key", folder / "fleet.key.pub", "--anchor", ledger / "checkpoint")
    answer = json.loads(call("verify", ledger, "--quick", "--json", *trusted).out)
    assert (answer["ok"], answer["is_quick"], answer["signature"]) == (True, True, "signed")
    assert answer["signer"] == key_of(folder)
    assert (answer["signed"], answer["commits"], answer["anchored"], answer["head"]["size"]) == (2, 2, size, size)


def test_verify_ends_with_3_where_the_key_or_the_anchor_does_not_agree(
    call: Call, folder: Path, ledger: Path, tmp_path: Path
) -> None:
    assert call("key", "new", tmp_path / "other.key").code == 0
    for arguments, part in (
        ((ledger, "--trusted-key", folder / "fleet.key.pub"), "found no signature"),
        ((folder / "ledger", "--trusted-key", tmp_path / "other.key.pub"), f"found a signature of {key_of(folder)}"),
    ):
        for quick in ((), ("--quick",)):
            called = call("verify", *arguments, *quick)
            assert (called.code, called.out, "Traceback" in called.err) == (3, "", False)
            assert part in called.err
    anchored = ("verify", folder / "ledger", "--anchor", folder / "ledger" / "checkpoint")
    for called in (  # of two that contradict each other neither says anything of the ledger
        call(*anchored, "--trusted-key", tmp_path / "other.key.pub"),
        call("maintain", "recover", *anchored[1:], "--trusted-key", tmp_path / "other.key.pub"),
    ):
        one_message(called, 2, f"--anchor {anchored[-1]}: found a checkpoint with a signature of {key_of(folder)}")
    one_message(call("verify", ledger, "--anchor", tmp_path / "none"), 2, "none", "found no file")
    one_message(call("verify", ledger, "--anchor", folder / "event.tlog-proof"), 2, "found no checkpoint")
    typed = tmp_path / "typed"
    typed.write_text("\n".join((ledger / "checkpoint").read_text().splitlines()[:3]))
    one_message(call("verify", ledger, "--anchor", typed), 2, "found no checkpoint", "three lines, an empty one, and")
    one_message(call("verify", ledger, "--trusted-key", "nonsense"), 2, "nonsense")


def test_a_quick_look_finds_a_flipped_byte_and_says_that_it_was_quick(call: Call, copy: Path) -> None:
    segment = max((copy / "segments").iterdir())
    data = bytearray(segment.read_bytes())
    data[5000] ^= 1
    segment.write_bytes(data)
    called = call("verify", copy, "--quick")
    assert called.code == 3
    assert "1 problem at a quick look" in called.err
    answer = json.loads(call("verify", copy, "--quick", "--json").out)
    assert (answer["ok"], answer["is_quick"]) == (False, True)


# --- prove and verify-proof ---


def test_a_proof_says_which_event_who_and_what_the_signature_is_worth(
    call: Call, folder: Path, ledger: Path, tmp_path: Path
) -> None:
    file = folder / "event.tlog-proof"
    called = call("verify-proof", file, "--trusted-key", folder / "fleet.key.pub")
    assert (called.code, called.err) == (0, "")
    assert (
        f"of {size_of(folder / 'ledger'):,} in the ledger of fsar-ledger/simulated, signed by {key_of(folder)}\n"
        in called.out
    )
    assert f"run {RUN}-" in called.out
    assert ", seq 12: " in called.out
    assert "decided by " in called.out
    assert '"seq":12,' in called.out
    assert "compare the root" in call("verify-proof", file).out
    (tmp_path / "unsigned").write_text(call("prove", ledger, f"{RUN}:12").out)
    assert "fsar-ledger/simulated, unsigned\n" in call("verify-proof", tmp_path / "unsigned").out
    one_message(
        call("verify-proof", tmp_path / "unsigned", "--trusted-key", folder / "fleet.key.pub"), 3, "found no signature"
    )


def test_a_proof_says_the_same_as_json(call: Call, folder: Path, tmp_path: Path) -> None:
    answer = json.loads(call("verify-proof", folder / "event.tlog-proof", "--json").out)
    assert (answer["ok"], answer["seq"], answer["signature"]) == (True, 12, "signer not checked")
    assert answer["signer"] == key_of(folder)
    assert answer["event"]["run_id"] == answer["run_id"]
    assert answer["head"]["root"] == json.loads(call("info", folder / "ledger", "--json").out)["head"]["root"]
    (tmp_path / "cut").write_bytes((folder / "event.tlog-proof").read_bytes()[:-1])
    called = call("verify-proof", tmp_path / "cut", "--json")
    assert (called.code, json.loads(called.out)["ok"]) == (3, False)
    assert json.loads(called.out)["problem"] in called.err


def test_a_proof_needs_no_ledger(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "event.tlog-proof", tmp_path)
    called = in_a_process(
        "verify-proof",
        "event.tlog-proof",
        "--trusted-key",
        (folder / "fleet.key.pub").read_text().strip(),
        cwd=tmp_path,
    )
    assert (called.code, called.err) == (0, "")
    assert os.listdir(tmp_path) == ["event.tlog-proof"]


def test_every_name_of_an_event_gives_the_same_proof(call: Call, folder: Path) -> None:
    proof = (folder / "event.tlog-proof").read_text()
    index = proof.split("index ")[1].split("\n")[0]
    answer = json.loads(call("verify-proof", folder / "event.tlog-proof", "--json").out)
    for name in (index, f"{RUN}:12", f"{answer['run_id']}:12", f"{RUN}-:12", f"{RUN[2:]}:12", "1:12"):
        assert call("prove", folder / "ledger", name).out == proof


@pytest.fixture(scope="module")
def numbers(ledger: Path) -> tuple[int, int, int]:
    """How many events the ledger has, how many the run, and the seq of its last one."""
    sql = f"SELECT count(*) AS events FROM events INNER JOIN runs USING (run_id) WHERE run_id LIKE '{RUN}%'"
    (found,) = Ledger(ledger).sql(sql)
    return size_of(ledger), found["events"], found["events"] - 1


@pytest.mark.parametrize(
    ("event", "parts"),
    [
        ("{0}", ("{0}", "found {0:,} events", "RUN:SEQ")),
        ("9" * 40, ("found {0:,} events",)),
        ("nonsense", ("nonsense", "expected RUN:SEQ")),
        (":12", ("expected RUN:SEQ",)),
        ("fsar:", ("expected RUN:SEQ",)),
        ("fsar:x", ("expected RUN:SEQ",)),
        ("fsar:٣", ("expected RUN:SEQ",)),
        ("", ("expected RUN:SEQ",)),
        ("fsar.full:12", ("found 4 runs whose names contain this", "(number 1)")),
        ("fsra.full.door:12", ("no such run", "did you mean fsar.full.door-relay", "`fsar-ledger query runs /")),
        (f"{RUN}:{{1}}", ("found {1} events in the run", "a seq from 0 to {2}")),
        (f"{RUN}:{'9' * 40}", ("found {1} events",)),
    ],
)
def test_an_event_that_is_not_there_is_explained(
    call: Call, ledger: Path, numbers: tuple[int, int, int], event: str, parts: tuple[str, ...]
) -> None:
    one_message(call("prove", ledger, event.format(*numbers)), 2, *(part.format(*numbers) for part in parts))


def test_a_proof_goes_to_a_new_file_outside_the_ledger(call: Call, copy: Path, tmp_path: Path) -> None:
    called = call("prove", copy, "7", "--out", tmp_path / "new" / "7.tlog-proof")
    assert (called.code, called.err) == (0, "")
    assert called.out.startswith(f"{tmp_path / 'new' / '7.tlog-proof'}: event 7 of {size_of(copy):,}\nroot ")
    before = (tmp_path / "new" / "7.tlog-proof").read_text()
    one_message(call("prove", copy, "8", "--out", tmp_path / "new" / "7.tlog-proof"), 2, "never overwritten")
    one_message(call("prove", copy, "8", "--out", copy / "8.tlog-proof"), 2, "inside the ledger")
    one_message(call("prove", copy, "8", "--out", tmp_path / "new" / "7.tlog-proof" / "x"), 1, "cannot be written")
    assert (tmp_path / "new" / "7.tlog-proof").read_text() == before
    assert sorted(os.listdir(tmp_path)) == ["ledger", "new"]
    assert sorted(os.listdir(tmp_path / "new")) == ["7.tlog-proof"]


def test_a_damaged_ledger_gives_no_proof(call: Call, copy: Path, tmp_path: Path) -> None:
    nodes = bytearray((copy / "nodes").read_bytes())
    nodes[::32] = bytes(len(nodes[::32]))  # the first byte of each hash
    (copy / "nodes").write_bytes(nodes)
    refused = call("prove", copy, "1000", "--out", tmp_path / "x.tlog-proof")
    one_message(refused, 3, "fsar-ledger verify", "fsar-ledger maintain recover")
    assert not (tmp_path / "x.tlog-proof").exists()


@pytest.mark.parametrize(
    "data", [b"", b"\xff", b"monday\n", b"c2sp.org/tlog-proof@v1\nextra e30=\nindex 0\n\nx\n1\n" + b"A" * 43 + b"=\n\n"]
)
def test_a_file_that_proves_nothing_ends_with_3(call: Call, tmp_path: Path, data: bytes) -> None:
    (tmp_path / "file").write_bytes(data)
    one_message(call("verify-proof", tmp_path / "file"), 3, str(tmp_path / "file"))
    one_message(call("verify-proof", tmp_path / "none"), 2, str(tmp_path / "none"))


def test_a_public_key_under_another_name_verifies_what_the_same_secret_signed_under_it(
    call: Call, tmp_path: Path
) -> None:
    from fsar_ledger.ledger.store.keys import read_signer
    from fsar_ledger.runtime.experiment import Experiment, run_experiment

    assert call("key", "new", tmp_path / "arm.key", "--name", "example.org/arm").code == 0
    signer = read_signer(tmp_path / "arm.key").under("example.org/arm/ablation")
    run_experiment(tmp_path / "ledger", Experiment(("fsar",), ("door-relay",), 1), 1, signer=signer)
    said = call("key", "public", tmp_path / "arm.key.pub", "--name", "example.org/arm/ablation")
    assert said.out.strip() == str(signer.verifier)
    assert (
        "signed by example.org/arm/ablation+"
        in call("verify", tmp_path / "ledger", "--trusted-key", said.out.strip()).out
    )
    assert call("verify", tmp_path / "ledger", "--trusted-key", tmp_path / "arm.key.pub").code == 3
    one_message(call("key", "public", tmp_path / "arm.key.pub", "--name", "two words"), 2, "without spaces")
