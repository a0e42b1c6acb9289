"""The agenda gives commands in the order of one heap of them all."""

from heapq import heappop, heappush

from hypothesis import given
from hypothesis import strategies as some

from fsar_ledger.runtime.agenda import Agenda, Pending
from fsar_ledger.runtime.handlers.commands import Command, Scheduled

NOTHING = Scheduled(Command())
steps = some.lists(some.one_of(some.none(), some.integers(0, 1 << 25)))
"""None takes the first out; a number puts one in, so many microseconds after the last that was taken out."""


@given(steps, some.sampled_from([1, 4, 4_096, 1 << 16]))
def test_commands_come_in_the_order_of_one_heap(taken: list[int | None], robots: int) -> None:
    agenda, heap, now_us = Agenda(robots), list[Pending](), 0
    for serial, after_us in enumerate(taken):
        if after_us is not None:
            one = (now_us + after_us, serial, 0, NOTHING)
            agenda.put(one)
            heappush(heap, one)
        elif heap:
            assert agenda.advance()
            first = heappop(agenda.soon)
            assert first == heappop(heap)
            now_us = first[0]
        assert sorted(one[:2] for one in agenda) == sorted(one[:2] for one in heap)
    while heap:
        assert agenda.pop_before(heap[0][0]) is None
        assert agenda.pop_before(heap[0][0] + 1) == heappop(heap)
    assert not agenda.advance()
    assert not agenda


@given(some.lists(some.integers(0, 1 << 25), min_size=1), some.integers(0, 1 << 25))
def test_what_is_due_in_a_later_span_waits_until_then(due: list[int], next_us: int) -> None:
    agenda = Agenda(4_096)
    for serial, due_us in enumerate(due):
        agenda.put((due_us, serial, 0, NOTHING))
    assert agenda.advance(next_us) or next_us < min(due), "all that is due by then is soon"
    assert agenda.until_us <= next_us + (1 << 23) // 4_096, "what comes up until then has spans of its own"
    assert len(list(agenda)) == len(due)
    assert agenda


@given(some.lists(some.integers(0, 1 << 25)), some.lists(some.integers(0, 1 << 25)))
def test_what_is_replaced_is_gone(before: list[int], after: list[int]) -> None:
    agenda = Agenda(4)
    for due_us in before:
        agenda.put((due_us, 0, 0, NOTHING))
    agenda.advance()
    agenda.replace([(due_us, serial, 0, NOTHING) for serial, due_us in enumerate(after)])
    found = []
    while agenda.advance():
        found.append(heappop(agenda.soon)[0])
    assert found == sorted(after)
