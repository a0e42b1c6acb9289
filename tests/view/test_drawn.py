"""Lanes, arrows, and the first difference between two runs."""

from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.view.drawn import Words, drawn, type_name
from tests.view.conftest import plain_words


def test_robots_come_first_then_supervisors_then_services(runs: dict[str, LedgerRun]) -> None:
    for run in runs.values():
        kinds = [lane.name.partition("/")[0] for lane in drawn(run, "1", plain_words(run)).lanes]
        assert kinds[:8] == ["robot"] * 4 + ["supervisor"] * 4
        assert kinds == sorted(kinds, key=("robot", "supervisor", "coordinator", "service").index)


def test_a_request_is_an_arrow_that_arrives_with_its_answer(runs: dict[str, LedgerRun]) -> None:
    run = runs["fsar"]
    sent = next(seq for seq, event in enumerate(run.events) if type_name(event) == "RequestIssued")
    answer = run.caused_by.index(sent)
    words = list(plain_words(run))
    asker, asked = run.events[sent].principals.requested_by, run.events[answer].principals.decided_by  # type: ignore[attr-defined]
    words[sent] = Words(asker, asked, "request", None, "A1-1/1.1")
    (arrow,) = drawn(run, "1", words).arrows
    assert (arrow.sender, arrow.receiver, arrow.kind) == (asker, asked, "request")
    assert (arrow.sent_us, arrow.arrived_us) == (run.times_us[sent], run.times_us[answer])
    assert arrow.arrived_us > arrow.sent_us
