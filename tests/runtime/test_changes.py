"""Changes as data and as text: each is the other, and what is none is an error that says what would be."""

from pathlib import Path
from typing import get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsar_ledger.base.errors import UsageError
from fsar_ledger.events.envelope import PolicyOutcome, PolicyScope, RecoveryLevel, TrustScope
from fsar_ledger.events.world import Grade, ObstructionAppeared, ObstructionCleared, PeersMet, PolicyWindowClosed
from fsar_ledger.runtime.change_texts import FORMS, SHORT, fact_of, fact_text, parsed, read_changes, seconds_of
from fsar_ledger.runtime.changes import (
    Add,
    Answer,
    AnyChange,
    Architecture,
    Budget,
    Density,
    Drop,
    Move,
    Rule,
    Set,
    Trust,
    Without,
    seconds_text,
)

words = st.text("abcXYZ019./*-", min_size=1, max_size=12).filter(lambda text: not text.startswith("-"))
names = words.map(lambda text: f"window:{text}")
robots = words.map(lambda text: f"robot/{text}")
seconds = st.integers(0, 10**12).map(lambda us: us / 1e6)
some = st.none() | words
befores = st.none() | st.integers(-5, 5).map(str)

CHANGES: dict[type, st.SearchStrategy[AnyChange]] = {
    Drop: st.builds(Drop, names),
    Move: st.builds(Move, names, st.integers(-(10**9), 10**9).map(lambda us: us / 1e6)),
    Add: st.builds(
        lambda at, pair: Add(at, fact_text(PeersMet(*pair))),
        seconds,
        st.lists(robots, min_size=2, max_size=2, unique=True),
    ),
    Answer: st.builds(Answer, names, st.sampled_from(["deny", "never", "2.5s", "fail"])),
    Rule: st.builds(
        Rule,
        scope=st.sampled_from(get_args(PolicyScope)),
        outcome=st.sampled_from(get_args(PolicyOutcome)),
        robot=st.none() | robots,
        capability=some,
        task=some,
        from_s=seconds,
    ),
    Trust: st.builds(
        Trust,
        robot=robots,
        peer=robots,
        scope=st.sampled_from(get_args(TrustScope)),
        capability=some,
        task=some,
        from_s=seconds,
    ),
    Budget: st.builds(
        Budget,
        robot=robots,
        level=st.sampled_from(get_args(RecoveryLevel)),
        time_s=seconds,
        attempts=st.integers(0, 9),
        from_s=seconds,
    ),
    Density: st.builds(Density, robot=st.none() | robots, review_every=st.integers(0, 9), from_s=seconds),
    Set: st.builds(
        Set,
        constant=words,
        value=st.integers(-9, 9) | st.floats(-10, 10, allow_nan=False).map(lambda one: float(repr(one))),
        from_s=st.none() | seconds,
        before=befores,
    ),
    Architecture: st.builds(Architecture, words, st.none() | words),
    Without: st.builds(Without, words, st.none() | words),
}


def test_each_kind_of_change_is_tried() -> None:
    assert set(CHANGES) == set(get_args(AnyChange))


@given(st.one_of(*CHANGES.values()))
def test_the_text_of_a_change_reads_as_that_change(change: AnyChange) -> None:
    (read,) = parsed([str(change)])
    assert read == change
    assert str(read) == str(change)


@given(st.integers(0, 9 * 10**15))
def test_a_time_reads_as_it_is_written(time_us: int) -> None:
    assert round(seconds_of(seconds_text(time_us / 1e6)) * 1e6) == round(time_us / 1e6 * 1e6)


@pytest.mark.parametrize(
    ("text", "whole"),
    [
        ("rule fleet deny robot=B1", "rule fleet deny robot=robot/B1"),
        ("trust A1 B1 none from 20000ms", "trust robot/A1 robot/B1 none from 20s"),
        ("density B1 2", "density robot/B1 2"),
        ("  drop   window:*  ", "drop window:*"),
        ("answer response:2 2500ms", "answer response:2 2.5s"),
        ("set world.review_share=0.50", "set world.review_share=0.5"),
    ],
)
def test_a_short_text_stands_for_a_whole_one(text: str, whole: str) -> None:
    assert [str(one) for one in parsed([text])] == [whole]


def test_what_lasts_is_added_with_its_end() -> None:
    begins, ends = parsed(["add obstruction:B1 20s for 5s"])
    assert isinstance(begins, Add)
    assert isinstance(ends, Add)
    assert (begins.at_s, ends.at_s) == (20.0, 25.0)
    appeared, cleared = fact_of(begins.event), fact_of(ends.event)
    assert isinstance(appeared, ObstructionAppeared)
    assert isinstance(cleared, ObstructionCleared)
    assert appeared.obstruction == cleared.obstruction


@pytest.mark.parametrize("kind", SHORT)
def test_each_short_form_makes_facts(kind: str) -> None:
    is_spell, _ = SHORT[kind]
    who = {"window": "fleet/B1", "encounter": "A1/B1"}.get(kind, "B1")
    word = {"routine": " motion"}.get(kind, "")
    found = parsed([f"add {kind}:{who} 20s{' for 5s' if is_spell else ''}{word}"])
    assert len(found) == 1 + is_spell
    assert parsed(list(map(str, found))) == found


@pytest.mark.parametrize(
    "text", [*(f"add degradation:B1 5s {grade}" for grade in get_args(Grade)), "add degradation:B1 5s"]
)
def test_each_grade_of_degradation_reads_as_it_is_written(text: str) -> None:
    found = parsed([text])
    assert parsed(list(map(str, found))) == found


def test_an_encounter_is_of_the_robot_that_is_named_first_with_the_other() -> None:
    in_full = 'add 20s {"type":"PeersMet","robot":"robot/A1","peer":"robot/B1"}'
    assert parsed(["add encounter:A1/B1 20s"]) == parsed([in_full])


def test_an_added_window_can_ask_for_review() -> None:
    opened, closed = (
        fact_of(one.event) for one in parsed(["add window:fleet/B1 1s for 2s review"]) if isinstance(one, Add)
    )
    assert getattr(opened, "outcome", None) == "review"
    assert isinstance(closed, PolicyWindowClosed)


@pytest.mark.parametrize("time", ["nans", "-nan", "sNaNms", "infs"])
def test_a_time_that_is_no_number_is_an_error(time: str) -> None:
    for text in (f"move x +{time}", f"add window:fleet/B1 20s for {time}", f"rule fleet deny from {time}"):
        with pytest.raises((UsageError, ArithmeticError)) as raised:
            parsed([text])
        assert isinstance(raised.value, UsageError), text


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("drp window:x", "did you mean drop"),
        ("", "found nothing"),
        ("drop", "found 0 words after the verb"),
        ("drop a b", "found 2 words after the verb"),
        ("move x 5s", "without \\+ or -"),
        ("move x +5x", "where a time belongs"),
        ("move x +1m", "found 1m where a time belongs"),
        ("rule fleet deny from 2m", "found 2m where a time belongs"),
        ("move x +1e3s", "found 1e3s where a time in plain digits belongs, as 1000s"),
        ("answer approach:* 1E-3s", "found 1E-3s where a time in plain digits belongs"),
        ("move x +-5s", "found -5s where a time of 0 to 9,007,199,254 s belongs"),
        ("move x +10000000000s", "found 10000000000s where a time of 0 to 9,007,199,254 s belongs"),
        ("add foo:B1 3s", "known are window"),
        ("add obstruction:B1 3s", "obstruction takes a length"),
        ("add context:B1 3s for 5s", "context takes no length"),
        ("add 3s {}", "expected add"),
        ("add 3s []", "found JSON that is no object"),
        ('add 3s {"type":"TaskCompleted.v1","task_id":"x"}', "expected add"),
        ('add 3s {"type":"PeersMet","robot":"robot/A1"}', "missing required field `peer`"),
        ("answer call:1", "found 1 word after the verb"),
        ("rule flet deny", "Invalid enum value 'flet'"),
        ("rule fleet deny robt=B1", "found robt=B1"),
        ("rule fleet deny robot=B1 robot=C1", "an option twice"),
        ("rule fleet", "too few words"),
        ("budget A1 local soon 1", "found soon where a time belongs"),
        ("budget A1 local 5s many", "expected budget"),
        ("density all some", "expected density"),
        ("set a", "found no value where a number belongs"),
        ("set a=true", "found true where a number belongs"),
        ("trust A1 B1 much", "Invalid enum value 'much'"),
        ("add window:flet/B1 5s for 5s", "found flet/B1 where fleet/ROBOT or local/ROBOT belongs"),
        ("add routine:A1 5s dancing", "found dancing at the end; routine takes one of motion, sensing"),
        ("add routine:A1 5s", "found no word at the end; routine takes one of motion, sensing"),
        ("add context:A1 5s night", "found night at the end; context takes nothing more"),
        ("add off:A1 5s for 5s lost", "found lost at the end; off takes nothing more"),
        ("add window:fleet/B1 5s for 5s allow", "found allow at the end; window takes one of deny, review"),
        (
            'add 5s {"type":"PolicyWindowOpened","robot":"robot/B1","scope":"fleet","window":"w","outcome":"allow"}',
            r"found a window that allows, where one restricts \(review, deny\)",
        ),
        ("add encounter:A1/A1 5s", "found a meeting of robot/A1 with itself, where two robots belong"),
        ('add 5s {"type":"PeersMet","robot":"robot/A1","peer":"robot/A1"}', "found a meeting of robot/A1 with itself"),
        ("x" * 20_000, "expected one of drop"),
    ],
)
def test_a_text_that_is_no_change_is_an_error(text: str, found: str) -> None:
    with pytest.raises(UsageError, match=found) as raised:
        parsed([text])
    verb = text.partition(" ")[0]
    assert verb not in FORMS or FORMS[verb] in str(raised.value)
    assert len(str(raised.value)) < 1_500


def test_a_file_holds_changes_as_tables_or_as_texts(tmp_path: Path) -> None:
    file = tmp_path / "changes.toml"
    file.write_text('[[changes]]\nchange = "move"\nfact = "window:x"\nby_s = 2.0\n')
    assert read_changes(file) == (Move("window:x", 2.0),)
    file.write_text('changes = ["drop window:x", "add off:B1 3s for 4s"]\n')
    assert [str(one).partition(" ")[0] for one in read_changes(file)] == ["drop", "add", "add"]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ('[[changes]]\nchange = "drp"\nfact = "x"\n', "changes.toml:1: changes\\[0\\]: Invalid value 'drp'"),
        ('[[changes]]\nchange = "drop"\nfct = "x"\n', "fct"),
        ('[[changes]]\nchange = "move"\nfact = "x"\nby_s = nan\n', "found nan where a time belongs"),
        ('[[changes]]\nchange = "rule"\nscope = "fleet"\noutcome = "deny"\nfrom_s = inf\n', "found inf where a time"),
        ('change = "drop"\n', "change"),
        ('changes = ["drop"]\n', "found 0 words after the verb"),
        ("changes = [", "expected TOML"),
    ],
)
def test_a_file_with_something_else_is_an_error(tmp_path: Path, text: str, found: str) -> None:
    file = tmp_path / "changes.toml"
    file.write_text(text)
    with pytest.raises(UsageError, match=found):
        read_changes(file)


def test_a_file_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file"):
        read_changes(tmp_path / "none.toml")
