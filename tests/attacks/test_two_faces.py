"""One segment with two contents: some readers start a column at its data, others at its dictionary."""

from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pytest

from fsar_ledger.ledger.rows import segment
from fsar_ledger.ledger.rows.schema import SCHEMA
from tests.attacks.conftest import Attack
from tests.ledger.forgery import forge_segment, segment_at, table_of
from tests.ledger.parts import two_faced


def without_policy(table: pa.Table) -> pa.Table:
    """Return the same rows, with every policy window and rule on a robot that does not exist."""
    is_policy = pc.is_in(table["type"], pa.array(["PolicyWindowOpened.v1", "PolicyRuleSet.v1"]))
    at = SCHEMA.get_field_index("robot")
    return table.set_column(at, SCHEMA.field(at), pc.if_else(is_policy, "nobody", table["robot"]))


@pytest.fixture
def ledger(command: Attack, tmp_path: Path) -> Path:
    """Make a signed ledger of one run with violations of policy."""
    small = ("--runs", "1", "--architecture", "dhma", "--scenario", "mixed-trust-inspection")
    assert command("key", "new", "key", "--name", "example.org/fleet").code == 0
    assert command("simulate", "ledger", *small, "--key", "key", "--origin", "example.org/fleet").code == 0
    return tmp_path / "ledger"


def newest(ledger: Path) -> int:
    """Return the number of the commit with the run; the commit of a plan may precede it."""
    return len(list((ledger / "segments").glob("*.parquet"))) - 1


@pytest.fixture
def forged(ledger: Path) -> Path:
    """Make a ledger with the same records, notes and root, and a segment with two contents."""
    number = newest(ledger)
    table = table_of(ledger, number)
    honest, other = (bytes(segment.to_parquet(rows)) for rows in (table, without_policy(table)))
    forge_segment(ledger, number, two_faced(honest, other, "robot"))
    return ledger


@pytest.mark.parametrize(
    "verb",
    [
        ("verify",),
        *(
            pytest.param(verb, marks=mark)
            for mark, verbs in (
                (pytest.mark.slow, (("query", "metrics/policy_violations"), ("sql",))),
                (pytest.mark.soak, (("metrics",), ("audit",))),
            )
            for verb in verbs
        ),
    ],
    ids=lambda verb: verb[0],
)
def test_a_segment_with_two_contents_is_refused_by_every_answer(
    command: Attack, forged: Path, verb: tuple[str, ...]
) -> None:
    more = ("SELECT count(*) FROM policy_windows",) if verb == ("sql",) else ()
    called = command(*verb, forged, *more)
    assert called.code in (2, 3), called.out[:500]
    assert f"segments/{segment_at(forged, newest(forged)).name}" in called.err
