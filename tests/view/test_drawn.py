"""Lanes, arrows, and the first difference between two runs."""

from msgspec.structs import replace

from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.view.drawn import Words, drawn, first_difference, type_name
from tests.view.conftest import a_run, plain_words


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


def test_a_run_differs_nowhere_from_itself(runs: dict[str, LedgerRun]) -> None:
    for run in runs.values():
        assert first_difference(run, replace(run, run_id="another")) is None


def test_the_first_difference_is_the_first_event_time_or_cause_that_is_not_the_same(runs: dict[str, LedgerRun]) -> None:
    run = runs["fsar"]
    last = len(run.events) - 1
    for seq in (1, 50, last):
        later = replace(run, times_us=[*run.times_us[:seq], run.times_us[seq] + 1, *run.times_us[seq + 1 :]])
        cause = 0 if run.caused_by[seq] else None
        moved = replace(run, caused_by=[*run.caused_by[:seq], cause, *run.caused_by[seq + 1 :]])
        other = replace(run, events=[*run.events[:seq], run.events[0], *run.events[seq + 1 :]])
        for changed in (later, moved, other):
            assert first_difference(run, changed) == first_difference(changed, run) == seq


def test_event_0_names_the_run_and_does_not_count(runs: dict[str, LedgerRun]) -> None:
    run = runs["fsar"]
    assert first_difference(run, replace(run, events=[replace(run.events[0], run=9), *run.events[1:]])) is None


def test_a_run_that_is_over_differs_from_the_event_that_it_lacks(runs: dict[str, LedgerRun]) -> None:
    run = runs["dhma"]
    count = len(run.events) - 3
    shorter = replace(run, events=run.events[:count], times_us=run.times_us[:count], caused_by=run.caused_by[:count])
    assert first_difference(run, shorter) == first_difference(shorter, run) == count


def test_worlds_of_other_numbers_part() -> None:
    assert first_difference(a_run("fsar"), a_run("fsar", number=1)) is not None
