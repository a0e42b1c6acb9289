import random
from collections.abc import Callable
from pathlib import Path

import pytest

from fsar_ledger.ledger.log.merkle import EMPTY_ROOT
from fsar_ledger.ledger.log.note import Checkpoint, Note, Signature, Signer
from fsar_ledger.witness import MAX_BODY_BYTES, Answer, Request, checkpoint_path, judge, parse_request
from tests.witness.conftest import LOG, ORIGIN, STRANGER, Log

GROWING = Log(20)
LOGS = [LOG.verifier]
EXAMPLE = (Path(__file__).parent.parent / "vectors" / "c2sp" / "add-checkpoint.txt").read_bytes()


def status_of(request: Request, known: Checkpoint | None, logs: list[Signer] | None = None) -> int:
    """Return the status of the answer, 200 if the checkpoint may be cosigned."""
    found = judge(request, [log.verifier for log in logs] if logs is not None else LOGS, known)
    return found.status if isinstance(found, Answer) else 200


def body_of(old: int = 3, new: int = 8) -> bytes:
    return str(GROWING.request(old, new)).encode()


def test_the_example_of_c2sp_is_read_and_written_again() -> None:
    request = parse_request(EXAMPLE)
    assert (request.old, len(request.proof), request.note.checkpoint.size, len(request.note.signatures)) == (
        20852014,
        4,
        20852163,
        2,
    )
    assert str(request).encode() == EXAMPLE


def test_a_log_is_published_under_the_hash_of_its_origin() -> None:
    sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-4, example B.1
    assert checkpoint_path("abc") == f"/{sha256}/checkpoint"


def test_every_growth_of_a_log_is_followed() -> None:
    for old in range(20):
        for new in range(old, 21):
            known = GROWING.checkpoint(old) if old else None
            found = judge(GROWING.request(old, new), LOGS, known)
            assert found == GROWING.note(new) or isinstance(found, Answer)
            assert not isinstance(found, Answer), (old, new, found)


def test_a_log_that_was_rewritten_anywhere_is_never_followed() -> None:
    for old in range(1, 12):
        for twist in range(old):
            other = Log(20, twist)
            for new in range(old, 14):
                assert status_of(other.request(old, new), GROWING.checkpoint(old)) == (409 if new == old else 422), (
                    old,
                    twist,
                    new,
                )


@pytest.mark.parametrize("known", [0, 2, 4, 7, 8, 9])
def test_an_old_size_that_the_witness_does_not_know_is_answered_with_the_one_it_does(known: int) -> None:
    answer = judge(GROWING.request(3, 8), LOGS, GROWING.checkpoint(known) if known else None)
    assert answer == Answer(409, f"{known}\n", "text/x.tlog.size")


def test_another_root_of_the_same_size_is_a_conflict_that_is_no_size() -> None:
    answer = judge(Log(8, 2).request(8, 8), LOGS, GROWING.checkpoint(8))
    assert isinstance(answer, Answer)
    assert (answer.status, answer.media) == (409, "text/plain; charset=utf-8")


@pytest.mark.parametrize(
    ("change", "status"),
    [
        (lambda request: request, 200),
        (lambda request: Request(9, request.proof, request.note), 400),
        (lambda request: Request(3, request.proof[:-1], request.note), 422),
        (lambda request: Request(3, (), request.note), 422),
        (lambda request: Request(3, (*request.proof, bytes(32)), request.note), 422),
        (lambda request: Request(3, request.proof[::-1], request.note), 422),
        (lambda request: Request(3, (bytes(32), *request.proof[1:]), request.note), 422),
        (lambda request: Request(3, request.proof, GROWING.note(8, STRANGER)), 403),
        (lambda request: Request(3, request.proof, Note(request.note.checkpoint)), 403),
        (lambda request: Request(3, request.proof, Note(GROWING.checkpoint(9), request.note.signatures)), 403),
        (
            lambda request: Request(
                3, request.proof, Note(Checkpoint("example.org/x", 8, bytes(32)), request.note.signatures)
            ),
            404,
        ),
    ],
)
def test_each_fault_has_the_status_that_c2sp_gives_it(change: Callable[[Request], Request], status: int) -> None:
    assert status_of(change(GROWING.request(3, 8)), GROWING.checkpoint(3)) == status


def test_faults_are_looked_for_in_the_order_of_c2sp() -> None:
    unknown = Request(99, (), Note(Checkpoint("example.org/x", 8, bytes(32))))
    unsigned = Request(99, (), Note(GROWING.checkpoint(8)))
    too_old = Request(99, (), GROWING.note(8))
    stale = Request(4, (), GROWING.note(8))
    unproven = Request(3, (), GROWING.note(8))
    assert [status_of(request, GROWING.checkpoint(3)) for request in (unknown, unsigned, too_old, stale, unproven)] == [
        404,
        403,
        400,
        409,
        422,
    ]


def test_the_empty_tree_has_one_root_and_every_log_begins_with_it() -> None:
    def request(root: bytes, proof: tuple[bytes, ...] = ()) -> Request:
        checkpoint = Checkpoint(ORIGIN, 0, root)
        return Request(0, proof, Note(checkpoint, (LOG.sign(checkpoint),)))

    empty = Checkpoint(ORIGIN, 0, EMPTY_ROOT)
    for known in (None, empty):
        assert status_of(request(EMPTY_ROOT), known) == 200
        assert status_of(request(bytes(32)), known) == 409
        assert status_of(request(EMPTY_ROOT, (bytes(32),)), known) == 422
        assert status_of(GROWING.request(0, 8), known) == 200
        assert status_of(Request(0, (bytes(32),), GROWING.note(8)), known) == 422


def test_signatures_of_strangers_are_left_out_and_a_wrong_one_of_a_known_key_spoils_the_note() -> None:
    checkpoint = GROWING.checkpoint(8)
    own, strange = LOG.sign(checkpoint), STRANGER.sign(checkpoint)
    wrong = Signature(own.name, own.key_id, bytes(64))
    fellow = Signature("example.org/w9", bytes(4), bytes(72))
    request = GROWING.request(3, 8)
    for signatures, expected in (
        ((strange, own, fellow), (own,)),
        ((own, own), (own,)),
        ((own, wrong), 403),
        ((wrong, own), 403),
        ((strange, fellow), 403),
    ):
        found = judge(Request(3, request.proof, Note(checkpoint, signatures)), LOGS, GROWING.checkpoint(3))
        assert (found.status if isinstance(found, Answer) else found.signatures) == expected


def test_a_log_may_have_two_keys() -> None:
    checkpoint = GROWING.checkpoint(8)
    both = Note(checkpoint, (STRANGER.sign(checkpoint), LOG.sign(checkpoint)))
    spoilt = Note(checkpoint, (LOG.sign(checkpoint), Signature(ORIGIN, STRANGER.verifier.key_id, bytes(64))))
    proof, known = GROWING.proof(3, 8), GROWING.checkpoint(3)
    for note, status in ((both, 200), (GROWING.note(8), 200), (GROWING.note(8, STRANGER), 200), (spoilt, 403)):
        assert status_of(Request(3, proof, note), known, [LOG, STRANGER]) == status


GOOD = body_of()


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"\n",
        b"\n\n",
        b"old 3",
        b"old 3\n",
        b"old 3\n\n",
        GOOD.removeprefix(b"old 3\n"),
        GOOD.replace(b"old 3", b"old 03"),
        GOOD.replace(b"old 3", b"old -3"),
        GOOD.replace(b"old 3", b"old +3"),
        GOOD.replace(b"old 3", b"old  3"),
        GOOD.replace(b"old 3", b"old 3 "),
        GOOD.replace(b"old 3", b"OLD 3"),
        GOOD.replace(b"old 3", b"old"),
        GOOD.replace(b"old 3", b"old \xd9\xa3"),
        GOOD.replace(b"old 3", b"old " + b"9" * 5000),
        GOOD.replace(b"old 3\n", b"old 3\r\n"),
        GOOD.replace(b"old 3\n", b"old 3\nAAAA\n"),
        GOOD.replace(b"old 3\n", b"old 3\n" + b"A" * 44 + b"\n"),
        GOOD.replace(b"old 3\n", b"old 3\n" + b"A" * 42 + b"B=\n"),
        GOOD.replace(b"old 3\n", b"old 3\n" + b"A" * 43 + b"= \n"),
        GOOD.replace(b"old 3\n", b"old 3\n" + (b"A" * 43 + b"=\n") * 64),
        GOOD.replace(b"old 3\n", b"old 3\n\n"),
        GOOD.replace(b"\n\n", b"\n", 1),
        GOOD.replace(b"\n8\n", b"\n08\n"),
        GOOD.replace(b"\n8\n", b"\n-8\n"),
        GOOD.replace(b"\n8\n", b"\n" + b"9" * 17 + b"\n"),
        GOOD.replace(b"\n8\n", b"\n8\nextension\n"),
        GOOD.replace(ORIGIN.encode(), b"two words", 1),
        GOOD.replace(ORIGIN.encode(), b"", 1),
        GOOD.replace(ORIGIN.encode(), b"a\x1b[31m", 1),
        GOOD.replace(ORIGIN.encode(), b"\xff", 1),
        GOOD[:-1],
        GOOD + b"\n",
        GOOD + b"x",
        GOOD + "— a b\n".encode(),
        GOOD + "— a AAAA\n".encode(),
        GOOD + b"- a AAAAAAAA\n",
        GOOD + "— a AAAAAAAA\n".encode() * 64,
        b"\x00" * 100,
        b"\xff" * 100,
    ],
)
def test_what_is_no_request_is_refused_in_clean_words(body: bytes) -> None:
    with pytest.raises(ValueError, match=r"^[a-zA-Z0-9 `,.]+$"):
        parse_request(body)


def test_63_lines_of_proof_and_64_signatures_are_a_request() -> None:
    note = Note(GROWING.checkpoint(8), tuple(Signature(f"w{number}", bytes(4), bytes(72)) for number in range(64)))
    request = Request(3, (bytes(32),) * 63, note)
    data = str(request).encode()
    assert parse_request(data) == request
    assert len(data) < MAX_BODY_BYTES


def test_a_thousand_random_changes_of_a_request_are_refused_or_say_the_same() -> None:
    draw = random.Random(9)
    known, counts = GROWING.checkpoint(3), {"refused": 0, "cosigned": 0, "no request": 0}
    for _ in range(1_000):
        data = bytearray(GOOD)
        for _ in range(draw.randrange(1, 4)):
            at = draw.randrange(len(data))
            match draw.randrange(4):
                case 0:
                    data[at] ^= 1 << draw.randrange(8)
                case 1:
                    del data[at : at + draw.randrange(1, 20)]
                case 2:
                    data[at:at] = data[(start := draw.randrange(len(data))) : start + draw.randrange(1, 60)]
                case _:
                    data[at] = draw.choice(b"\n\r\t =+/0A\x00\xff")
        try:
            request = parse_request(bytes(data))
        except ValueError:
            counts["no request"] += 1
            continue
        found = judge(request, LOGS, known)
        if isinstance(found, Answer):
            counts["refused"] += 1
            continue
        counts["cosigned"] += 1
        assert found == GROWING.note(8)  # what is cosigned is what the log signed, and its proof was right
    assert counts["no request"] > 300
    assert counts["refused"] > 30
