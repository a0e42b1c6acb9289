import itertools
from pathlib import Path

import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.witness import Cosigner
from fsar_ledger.witness.policy import Policy, parse_policy, read_policy
from tests.witness.conftest import LOG, ORIGIN, STRANGER

KEYS = [Cosigner(f"example.org/w{number}", bytes([number] * 32)).key for number in range(6)]
W = [f"witness W{number} {key} http://127.0.0.1:{8000 + number}\n" for number, key in enumerate(KEYS)]
LOGS = f"log {LOG.verifier}\n"


def policy(*lines: str) -> Policy:
    return parse_policy("policy", "".join(lines).encode())


def test_the_example_of_c2sp_is_met_by_two_of_x_and_one_of_y() -> None:
    found = policy(
        LOGS,
        *(line.replace("witness W", "witness X") for line in W[:3]),
        "group X-witnesses 2 X0 X1 X2\n",
        *(line.replace("witness W", "witness Y") for line in W[3:]),
        "group Y-witnesses any Y3 Y4 Y5\n",
        "group X-and-Y all X-witnesses Y-witnesses\n",
        "quorum X-and-Y\n",
    )
    names = [witness.name for witness in found.witnesses]
    for count in range(len(names) + 1):
        for some in map(set, itertools.combinations(names, count)):
            x, y = (len([name for name in some if name[0] == kind]) for kind in "XY")
            assert found.is_met(some) == (x >= 2 and y >= 1), some
    assert found.rule() == "2 of X-witnesses, Y-witnesses"


def test_every_k_of_n_needs_k() -> None:
    for n in range(1, 6):
        for k in range(1, n + 1):
            names = [f"W{number}" for number in range(n)]
            found = policy(*W[:n], f"group g {k} {' '.join(names)}\nquorum g\n")
            for count in range(n + 1):
                assert all(found.is_met(set(some)) == (count >= k) for some in itertools.combinations(names, count))


def test_a_quorum_may_be_one_witness_and_others_do_not_count() -> None:
    found = policy(*W[:2], "quorum W0\n")
    assert (found.is_met({"W0"}), found.is_met({"W1"}), found.is_met({"W7", "none"}), found.is_met(set())) == (
        True,
        False,
        False,
        False,
    )
    assert found.rule() == "that of W0"


def test_white_space_comments_and_names_are_as_c2sp_says() -> None:
    text = (
        b"# a comment\n\n \t \n  # another\n\tlog\t" + str(LOG.verifier).encode() + b"  http://127.0.0.1/ \n"
        b"witness \xe2\x84\xaa "
        + str(KEYS[0]).encode()
        + b"\nwitness K "
        + str(KEYS[1]).encode()
        + b"\nwitness \xff "
        + str(KEYS[2]).encode()
        + b"\n"
        b"group all all \xe2\x84\xaa \xff\nquorum all\n"
    )
    found = parse_policy("policy", text)
    assert found.logs == (LOG.verifier,)
    assert [witness.name for witness in found.witnesses] == ["\N{KELVIN SIGN}", "K", "\udcff"]
    assert [witness.url for witness in found.witnesses] == [None, None, None]
    assert (found.is_met({"K", "\udcff"}), found.is_met({"\N{KELVIN SIGN}", "\udcff"})) == (False, True)


def test_a_quorum_of_none_is_read_as_such() -> None:
    assert policy("quorum none\n").quorum is None


def test_thirty_two_logs_witnesses_and_groups_are_not_too_many() -> None:
    keys = [Cosigner(f"w{number}", bytes([number, 1] * 16)).key for number in range(32)]
    lines = [f"witness w{number} {key}\n" for number, key in enumerate(keys)]
    chain = [
        "group g0 any w0\n",
        *(f"group g{number} all g{number - 1} w{number}\n" for number in range(1, 32)),
        "quorum g31\n",
    ]
    found = policy(*lines, *chain)
    everybody = {witness.name for witness in found.witnesses}
    assert found.is_met(everybody)
    assert not any(found.is_met(everybody - {name}) for name in everybody)


TWO = "".join(W[:2])


@pytest.mark.parametrize(
    ("text", "line", "parts"),
    [
        ("", None, "found no quorum"),
        (TWO, None, "found no quorum"),
        ("quorum g\n", 1, "'g'"),
        ("quorum none\nquorum none\n", 2, "a second quorum"),
        ("quorum none", 1, "without its line feed"),
        (W[0] + "quorum W0 W1\n", 2, "quorum NAME"),
        (W[0] + "group g 1 W0\nquorum h\n", 3, "'h'"),
        ("group g 1 W0\n" + W[0] + "quorum g\n", 1, "'W0'"),
        ("group g 1 g\nquorum g\n", 1, "'g'"),
        ("group g any none\nquorum g\n", 1, "'none'"),
        ("group g any\nquorum g\n", 1, "group NAME K MEMBER"),
        (TWO + "group g 0 W0 W1\nquorum g\n", 3, "'0'"),
        (TWO + "group g 3 W0 W1\nquorum g\n", 3, "from 1 to 2"),
        (TWO + "group g -1 W0 W1\nquorum g\n", 3, "'-1'"),
        (TWO + "group g 01 W0 W1\nquorum g\n", 3, "'01'"),
        (TWO + "group g \u0661 W0 W1\nquorum g\n", 3, "from 1 to 2"),
        (TWO + "group g " + "9" * 5000 + " W0 W1\nquorum g\n", 3, "from 1 to 2"),
        (TWO + "group g ALL W0 W1\nquorum g\n", 3, "'ALL'"),
        (TWO + "group g 2 W0 W0\nquorum g\n", 3, "'W0' in a second place"),
        (TWO + "group g 1 W0\ngroup h all g W0\nquorum h\n", 4, "'W0' in a second place"),
        (TWO + "group g 1 W0\ngroup h 1 g\ngroup i 1 g\nquorum i\n", 5, "'g' in a second place"),
        (TWO + "group W0 1 W1\nquorum W0\n", 3, "a second 'W0'"),
        (W[0] + W[0].replace("W0", "W1", 1), 2, "was given before"),
        (W[0] + W[1].replace("W1", "W0", 1), 2, "a second 'W0'"),
        (W[0].replace("W0", "none", 1), 1, "a second 'none'"),
        (LOGS + LOGS, 2, "was given before"),
        (f"log {KEYS[0]}\n", 1, "the key of a witness"),
        (f"witness w {LOG.verifier}\n", 1, "the key of a log"),
        ("log x\n", 1, "found no public key"),
        (f"log {LOG.verifier}".replace("+", "+0", 1) + "\n", 1, "another key id"),
        (f"log {LOG.verifier} a b\n", 1, "expected log KEY"),
        (f"witness {KEYS[0]}\n", 1, "expected log KEY"),
        ("nonsense\n", 1, "'nonsense'"),
        ("LOG x\n", 1, "'LOG x'"),
        ("quorum none\r\n", 1, "byte 0x0d"),
        ("# \x1b[31m\n", 1, "byte 0x1b"),
        ("\n\x00quorum none\n", 2, "byte 0x00"),
        ("\n\n\x7f\n", 3, "byte 0x7f"),
        ("quorum\u00a0none\n", 1, "expected log KEY"),
    ],
)
def test_what_c2sp_forbids_is_refused_by_its_line(text: str, line: int | None, parts: str) -> None:
    with pytest.raises(UsageError) as error:
        policy(text)
    message = str(error.value)
    assert message.startswith("policy: " if line is None else f"policy: line {line}: ")
    assert parts in message
    assert message.isprintable()


def test_one_key_under_two_names_is_refused() -> None:
    twin = Cosigner("example.net/another", bytes(32)).key
    with pytest.raises(UsageError, match="count twice"):
        policy(W[0], f"witness Twin {twin}\n")


def test_two_keys_of_one_log_are_two_logs() -> None:
    assert [key.name for key in policy(LOGS, f"log {STRANGER.verifier}\n", "quorum none\n").logs] == [ORIGIN, ORIGIN]


def test_a_policy_that_cannot_be_read_is_a_usage_error(tmp_path: Path) -> None:
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(UsageError, match=r"^[^-].* the policy cannot be read .*expected a C2SP tlog-policy"):
            read_policy(path)
