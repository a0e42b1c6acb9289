import errno
import os
import shutil
import stat
from pathlib import Path
from threading import Thread

import pytest

from fsar_ledger.base.errors import LedgerCorrupted, UsageError, WriteFailed
from fsar_ledger.ledger.log.note import Note
from fsar_ledger.ledger.store import disk
from fsar_ledger.witness import Request, origin_hash, parse_vkey
from fsar_ledger.witness.server import Service
from fsar_ledger.witness.state import new_state, open_state
from tests.witness.conftest import NOW_S, ORIGIN, STRANGER, Log, Open, at_work

GROWING = Log(30)


def send(witness: Open, old: int, new: int, log: Log = GROWING) -> tuple[int, str]:
    """Send a request of the log and return the status and text of the answer."""
    answer = witness.service.add_checkpoint(str(log.request(old, new)).encode())
    return answer.status, answer.text


def size_of(witness: Open) -> int:
    newest = witness.state.newest(ORIGIN)
    return newest.checkpoint.size if newest is not None else 0


def test_a_new_witness_has_a_key_that_only_its_owner_reads_and_knows_nothing(tmp_path: Path) -> None:
    key = new_state(tmp_path / "new" / "w", "example.org/w")
    assert parse_vkey((tmp_path / "new" / "w" / "witness.key.pub").read_text().strip()) == key
    assert stat.S_IMODE((tmp_path / "new" / "w" / "witness.key").stat().st_mode) == 0o600
    with open_state(tmp_path / "new" / "w") as state:
        assert (state.cosigner.key, state.newest(ORIGIN)) == (key, None)


def test_a_witness_is_made_once_and_in_an_empty_folder(tmp_path: Path) -> None:
    new_state(tmp_path / "w", "w")
    before = (tmp_path / "w" / "witness.key").read_text()
    for folder in (tmp_path / "w", tmp_path):
        with pytest.raises(UsageError, match="never overwritten"):
            new_state(folder, "w")
    assert (tmp_path / "w" / "witness.key").read_text() == before
    for name in ("", "two words", "a+b", "a\nb"):
        with pytest.raises(UsageError, match="--name"):
            new_state(tmp_path / "other", name)
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteFailed, match="making a witness failed"):
        new_state(tmp_path / "file" / "w", "w")


def test_a_witness_whose_making_the_disk_refused_is_made_by_the_same_call_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as refusing:
        refusing.setattr(disk, "write_secret", full)
        with pytest.raises(WriteFailed, match="making a witness failed: No space left on device; no witness was made"):
            new_state(tmp_path / "w", "w")
    assert os.listdir(tmp_path / "w") != []
    key = new_state(tmp_path / "w", "w")
    with open_state(tmp_path / "w") as state:
        assert state.cosigner.key == key
    (tmp_path / "w" / "witness.key").unlink()
    (tmp_path / "w" / "logs" / origin_hash(ORIGIN)).write_text("what it cosigned")
    with pytest.raises(UsageError, match="never overwritten"):
        new_state(tmp_path / "w", "w")


def test_what_was_cosigned_is_known_after_a_restart(tmp_path: Path) -> None:
    with at_work(tmp_path / "w") as witness:
        assert [send(witness, old, new)[0] for old, new in ((0, 5), (5, 5), (5, 12))] == [200, 200, 200]
    with at_work(tmp_path / "w") as witness:
        assert size_of(witness) == 12
        assert send(witness, 0, 20) == (409, "12\n")
        assert send(witness, 12, 20)[0] == 200
        kept = witness.state.newest(ORIGIN)
        assert kept is not None
        assert (kept.signatures[0], witness.key.time_of(kept)) == (GROWING.note(20).signatures[0], NOW_S)
        assert (tmp_path / "w" / "logs" / origin_hash(ORIGIN)).read_text() == str(kept)


def test_two_of_one_folder_cannot_both_be_open(tmp_path: Path) -> None:
    with at_work(tmp_path / "w"), pytest.raises(UsageError, match="another process"), open_state(tmp_path / "w"):
        pass
    with at_work(tmp_path / "w"):
        pass


def test_a_checkpoint_that_cannot_be_stored_is_not_cosigned(witness: Open) -> None:
    assert send(witness, 0, 5)[0] == 200
    logs = witness.state.folder / "logs"
    logs.rename(logs.parent / "aside")
    assert send(witness, 5, 9) == (503, "the checkpoint could not be stored; nothing was cosigned\n")
    assert size_of(witness) == 5
    assert "No such file" in witness.told[-2]
    (logs.parent / "aside").rename(logs)
    assert send(witness, 5, 9)[0] == 200


def test_what_a_killed_process_left_is_cleared_away(tmp_path: Path) -> None:
    with at_work(tmp_path / "w") as witness:
        send(witness, 0, 5)
    (tmp_path / "w" / "logs" / f"{origin_hash(ORIGIN)}.0123456789abcdef.tmp").write_bytes(b"half")
    with at_work(tmp_path / "w") as witness:
        assert size_of(witness) == 5
    assert os.listdir(tmp_path / "w" / "logs") == [origin_hash(ORIGIN)]


def test_a_damaged_memory_is_never_used(tmp_path: Path) -> None:
    with at_work(tmp_path / "w") as witness:
        send(witness, 0, 5)
    file = tmp_path / "w" / "logs" / origin_hash(ORIGIN)
    data = file.read_bytes()
    for at in range(len(data)):
        file.write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        with pytest.raises(LedgerCorrupted, match=origin_hash(ORIGIN)), at_work(tmp_path / "w"):
            pass
    for damage in (
        b"".join(line for line in data.splitlines(keepends=True) if not line.startswith(f"— {ORIGIN} ".encode())),
        b"",
        data[:-1],
        str(GROWING.note(5)).encode(),
        data.replace(ORIGIN.encode(), b"example.org/lig"),
        b"\xff",
    ):
        file.write_bytes(damage)
        with pytest.raises(LedgerCorrupted, match=r"retire this witness|expected a C2SP"), at_work(tmp_path / "w"):
            pass
    file.unlink()
    file.mkdir()
    with pytest.raises(LedgerCorrupted, match="it cannot be read"), open_state(tmp_path / "w"):
        pass
    shutil.rmtree(tmp_path / "w" / "logs")
    with pytest.raises(LedgerCorrupted, match="retire this witness"), open_state(tmp_path / "w"):
        pass


def test_a_log_that_changed_its_key_is_still_known(tmp_path: Path) -> None:
    with at_work(tmp_path / "w") as witness:
        send(witness, 0, 5)
    with open_state(tmp_path / "w") as state:
        service = Service(state, [STRANGER.verifier], lambda: NOW_S, print)
        request = Request(5, GROWING.proof(5, 9), GROWING.note(9, STRANGER))
        assert service.add_checkpoint(str(request).encode()).status == 200
    with at_work(tmp_path / "w") as witness:
        assert size_of(witness) == 9


def test_the_memory_of_another_witness_is_not_taken(tmp_path: Path) -> None:
    for name in ("w1", "w2"):
        with at_work(tmp_path / name) as witness:
            send(witness, 0, 5)
    shutil.copy(tmp_path / "w2" / "logs" / origin_hash(ORIGIN), tmp_path / "w1" / "logs" / origin_hash(ORIGIN))
    with pytest.raises(LedgerCorrupted, match="did not cosign"), open_state(tmp_path / "w1"):
        pass


def test_a_folder_that_is_no_witness_is_not_served(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(UsageError, match="found no witness there"), open_state(folder):
            pass
    new_state(tmp_path / "w", "w")
    secret = tmp_path / "w" / "witness.key"
    secret.chmod(0o640)
    with pytest.raises(UsageError, match="mode 640"), open_state(tmp_path / "w"):
        pass
    text = secret.read_text()
    for wrong in ("", "nonsense", text[:-2], text.replace("w+", "v+", 1), "\udcff"):
        secret.write_bytes(wrong.encode("utf-8", "surrogateescape"))
        secret.chmod(0o600)
        with pytest.raises(UsageError, match=r"witness\.key") as error, open_state(tmp_path / "w"):
            pass
        assert text.split("+", 4)[4].strip() not in str(error.value)


def test_of_requests_at_once_one_wins_and_the_log_never_shrinks(witness: Open) -> None:
    answers: list[tuple[int, int]] = []

    def grow(step: int) -> None:
        for size in range(step, 31, step):
            newest = size_of(witness)
            if newest <= size:
                answers.append((size, send(witness, newest, size)[0]))

    threads = [Thread(target=grow, args=(step,)) for step in (1, 1, 2, 3, 5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    cosigned = [size for size, status in answers if status == 200]
    told = [int(line.split()[1]) for line in witness.told if line.endswith("cosigned")]
    assert sorted(told) == sorted(cosigned)
    assert told == sorted(told)  # the order in which they were cosigned
    assert size_of(witness) == max(cosigned) == 30
    assert {status for _, status in answers} <= {200, 409}


def test_the_newest_checkpoint_is_cosigned_again_when_it_is_asked_for(tmp_path: Path) -> None:
    with at_work(tmp_path / "w") as witness:
        assert witness.service.newest(origin_hash(ORIGIN)).status == 404
        send(witness, 0, 5)
    with at_work(tmp_path / "w", NOW_S + 86_400) as witness:
        answer = witness.service.newest(origin_hash(ORIGIN))
        kept = witness.state.newest(ORIGIN)
        assert kept is not None
        assert answer.text == str(
            Note(kept.checkpoint, (kept.signatures[0], witness.state.cosigner.cosign(kept.checkpoint, NOW_S + 86_400)))
        )
        assert witness.service.newest(origin_hash("example.org/other")).status == 404


def test_the_operator_is_told_what_the_log_did_and_nothing_of_strangers(witness: Open) -> None:
    send(witness, 0, 5)
    send(witness, 0, 9)
    send(witness, 5, 9)
    send(witness, 3, 5)
    send(witness, 9, 9, Log(9, 2))
    witness.service.add_checkpoint(str(GROWING.request(5, 9)).encode().replace(b"\n9\n", b"\n8\n"))
    witness.service.add_checkpoint(b"nonsense")
    assert witness.told == [
        f"{ORIGIN}: 5 events: cosigned",
        f"{ORIGIN}: 9 events: cosigned",
        f"{ORIGIN}: 5 events: refused (9 were cosigned before)",
        f"{ORIGIN}: 9 events: refused (another root of the same size was cosigned before)",
    ]
