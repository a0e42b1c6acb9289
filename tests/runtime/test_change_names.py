"""Several changes of one fork: each names a fact as the base has it, whatever the others do."""

import pytest

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events.envelope import Robot
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.world import RoutineDue
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.changes import TO_0_15, Add, Drop, Move
from fsar_ledger.runtime.forks import edited_facts
from fsar_ledger.runtime.run_replay import replay_run
from fsar_ledger.runtime.simulation import environment_of
from tests.runtime.test_fork_worlds import forked_under
from tests.runtime.test_forks import S, base, forked

A1 = Robot("robot/A1")
TWO = ("drop routine:A1/0", "drop routine:A1/1")


@pytest.mark.parametrize(
    "texts",
    [
        TWO,
        TWO[::-1],
        ("move routine:A1/0 +60s", "drop routine:A1/1"),
        ("drop routine:A1/1", "move routine:A1/2 -1s", "drop routine:A1/0"),
        ("add routine:A1 1s motion", "drop routine:A1/1"),
    ],
    ids=", ".join,
)
def test_a_change_names_a_fact_of_the_base_whatever_the_others_do(texts: tuple[str, ...]) -> None:
    facts = list(environment_of(base()[0].spec, Constants()).facts)
    own = [one for one in facts if isinstance(one[1], RoutineDue) and one[1].robot == A1]
    expected = dict(enumerate(own))
    for text in texts:
        word, name, *by = text.split()
        number = int(name[-1])
        if word == "add":
            expected[-1] = S, RoutineDue(robot=A1, operation="motion")
        elif word == "drop":
            del expected[number]
        else:
            expected[number] = expected[number][0] + S * int(by[0].removesuffix("s")), expected[number][1]
    others = [one for one in facts if one not in own]
    changes = [one for one in parsed(texts) if isinstance(one, Drop | Move | Add)]
    assert edited_facts(facts, changes) == tuple(sorted([*others, *expected.values()], key=lambda one: one[0]))


def test_a_fork_of_an_earlier_release_whose_changes_name_what_others_left_is_no_forgery() -> None:
    old = forked_under(TO_0_15, *TWO)
    assert old.events != forked(*TWO).record.events
    assert replay_run(old) is None
    at = next(seq for seq, event in enumerate(old.events) if isinstance(event, ExecutionStarted))
    forged = LedgerRun(old.run_id, old.times_us, old.caused_by, (*old.events[:at], *old.events[at + 1 :]))
    assert replay_run(forged) is not None
