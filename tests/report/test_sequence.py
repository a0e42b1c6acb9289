"""What the drawn timeline and the drawn recovery show, that nothing is clipped, and that they are the same bytes each
time."""

from typing import Any

import pytest

from fsar_ledger.report import sequence
from tests.report.test_charts import words

A, B, REGISTRY = "robot/A1", "robot/B1", "service/registry"


def told(
    step: int,
    sender: str | None,
    receiver: str | None,
    message: str,
    kind: str = "message",
    note: str | None = None,
    **other: Any,
) -> dict[str, Any]:
    return {
        "step": step,
        "seq": 500 + step,
        "time_s": step / 2,
        "sender": sender,
        "receiver": receiver,
        "kind": kind,
        "message": message,
        "note": note,
        "is_tied": True,
        **other,
    }


TIMELINE = [
    told(1, A, REGISTRY, "query: lift"),
    told(2, REGISTRY, A, f"candidates: {B}"),
    told(3, A, B, "request: lift", note="carries policy allow"),
    told(4, B, B, "evaluate: policy allow", "evaluation", "trust task; authority (1, 1, 0, 1)"),
    told(5, B, A, "accept"),
    told(6, B, B, "executes: lift", "deed"),
    told(7, B, A, "result: success"),
]


def test_every_principal_has_one_life_line_in_order_of_appearance() -> None:
    assert sequence.lanes(TIMELINE) == [A, REGISTRY, B]
    found = sequence.lanes([told(1, None, None, "lacks: lift", "deed"), told(2, A, None, "request: lift")])
    assert found == [sequence.NOBODY, A]


def test_the_sequence_shows_principals_messages_times_and_the_evaluation() -> None:
    drawn = words(sequence.sequence(TIMELINE))
    for text in (
        *("robot", "A1", "service", "registry", "B1", "query: lift"),
        *("candidates: robot/B1", "request: lift (carries policy allow)", "accept"),
    ):
        assert text in drawn
    assert {"evaluate: policy allow", "trust task", "authority (1, 1, 0, 1)"} <= set(drawn)
    assert [text for text in drawn if text.endswith(" s")] == [f"{step / 2:.3f} s" for step in range(1, 8)]


def test_each_step_shows_its_position_in_the_run() -> None:
    assert {str(row["seq"]) for row in TIMELINE} <= set(words(sequence.sequence(TIMELINE)))
    assert {str(row["seq"]) for row in RECOVERY} <= set(words(sequence.ladder(RECOVERY)))


def test_an_instant_is_written_once() -> None:
    same = [{**row, "time_s": 1.25} for row in TIMELINE]
    assert words(sequence.sequence(same)).count("1.250 s") == 1


def test_a_record_that_only_its_cause_ties_is_dashed() -> None:
    assert b"stroke-dasharray" not in sequence.sequence(TIMELINE)
    assert b"stroke-dasharray" in sequence.sequence([*TIMELINE, told(8, A, B, "hands over", is_tied=False)])


def edges_inches(figure: Any) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of all texts of the figure, as matplotlib measures them."""
    figure.canvas.draw()
    boxes = [text.get_window_extent(figure.canvas.get_renderer()) for text in figure.axes[0].texts if text.get_text()]
    dpi = figure.dpi
    return (
        min(b.x0 for b in boxes) / dpi,
        max(b.x1 for b in boxes) / dpi,
        min(b.y0 for b in boxes) / dpi,
        max(b.y1 for b in boxes) / dpi,
    )


def assert_nothing_is_clipped(figure: Any) -> None:
    left, right, bottom, top = edges_inches(figure)
    width, height = figure.get_size_inches()
    assert 0 <= left < right <= width
    assert 0 <= bottom < top <= height


def test_long_words_are_wrapped_and_nothing_leaves_the_figure() -> None:
    note = "a reason that goes on for much longer than the room between two life lines " * 2
    rows = [
        told(1, A, REGISTRY, "query: lift", note=note),
        told(2, B, B, "waits", "deed", note),
        told(3, B, A, "result: success"),
    ]
    with sequence.drawn_sequence(rows) as figure:
        assert_nothing_is_clipped(figure)
        assert max(text.get_text().count("\n") for text in figure.axes[0].texts) >= 4
    with sequence.drawn_sequence(TIMELINE) as figure:
        assert_nothing_is_clipped(figure)


def test_many_principals_make_a_wider_figure() -> None:
    rows = [told(number, f"agent/A1/{number}", f"agent/A1/{number + 1}", "hands over") for number in range(1, 10)]
    with sequence.drawn_sequence(rows) as wide, sequence.drawn_sequence(TIMELINE) as narrow:
        assert wide.get_size_inches()[0] > narrow.get_size_inches()[0]
        assert_nothing_is_clipped(wide)


def rung(
    number: int, level: str, time_s: float, what: str, result: str | None, to_level: str | None = None, **other: Any
) -> dict[str, Any]:
    row = {
        "failure": 1,
        "seq": 700 + number,
        "level_number": number,
        "level": level,
        "to_level": to_level,
        "time_s": time_s,
        "until_s": None,
        "what": what,
        "result": result,
    }
    return {**row, "spent_s": 4.5, "achieved": None, "budget_s": None, "decided_by": None, **other}


RECOVERY = [
    rung(1, "local", 1.0, "attempt 1", "partial", budget_s=30.0, achieved="load.gripped"),
    rung(1, "local", 2.0, "attempt 2", "failure", budget_s=30.0, decided_by=B),
    rung(1, "local", 3.0, "leaves local for peer", "budget exhausted", "peer"),
    rung(2, "peer", 4.0, "asks the registry for grasp.*", "no peer"),
    rung(2, "peer", 4.0, "leaves peer for fleet", None, "fleet"),
    rung(4, "human", 5.0, "asks supervisor/fleet", "resolved", until_s=30.25),
    rung(4, "human", 30.25, "resolved", None),
]


def test_the_ladder_shows_levels_steps_results_and_the_exhausted_budget() -> None:
    drawn = words(sequence.ladder(RECOVERY))
    for text in (
        *("attempt 1", "partial: load.gripped", "robot/B1: attempt 2", "failure"),
        *("budget exhausted (30 s, 2)", "asks the registry for grasp.*", "no peer"),
    ):
        assert text in drawn
    assert {
        *("level 1: local", "level 2: peer", "level 4: human", "4.500 s"),
        *("resolved at 30.250 s", "leaves peer for fleet"),
    } <= set(drawn)
    with sequence.drawn_ladder(RECOVERY) as figure:
        assert_nothing_is_clipped(figure)


def test_a_resolution_is_drawn_only_where_no_step_has_said_so() -> None:
    assert [row["what"] for row in sequence.rungs(RECOVERY)].count("resolved") == 0
    open_end = [*RECOVERY[:5], RECOVERY[6]]
    assert [row["what"] for row in sequence.rungs(open_end)].count("resolved") == 1


def test_a_second_failure_is_told_apart() -> None:
    second = [{**row, "failure": 2} for row in RECOVERY[:2]]
    assert "failure 2, level 1: local" in words(sequence.ladder([*RECOVERY, *second]))


@pytest.mark.parametrize("kind", ["svg", "pdf", "png"])
def test_drawings_are_the_same_bytes_twice_and_carry_no_date(kind: str) -> None:
    for draw, rows in ((sequence.sequence, TIMELINE), (sequence.ladder, RECOVERY)):
        once = draw(rows, kind)
        assert once == draw(rows, kind)
        assert b"CreationDate" not in once
        assert b"dc:date" not in once


def test_names_are_drawn_as_they_are_and_never_read_as_formulas() -> None:
    assert "query: $x_1$" in words(sequence.sequence([told(1, "robot/$A$", REGISTRY, "query: $x_1$")]))
