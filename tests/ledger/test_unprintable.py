"""Writers refuse unprintable text; what an earlier release stored is read."""

from pathlib import Path

import pytest

from fsar_ledger.events.envelope import flat, with_columns
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.verify import verify
from tests.ledger.hostile import relabelled, stage_anything
from tests.ledger.samples import ORIGIN, contents, run_of_every_type

RUN = run_of_every_type("run-1", seed=3)
EVIL = ("\x1b[2J", "a\nb", "\x00", "\x7f", "\x9b", "\u202e", "\u2028", "\u200b", "\ufeff")


@pytest.mark.parametrize("evil", EVIL)
def test_a_name_that_is_not_printed_is_refused_before_anything_is_written(tmp_path: Path, evil: str) -> None:
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        before = contents(tmp_path)
        for runs in (
            [relabelled(RUN, lambda text: text + evil)],
            [RUN, LedgerRun(f"run{evil}", RUN.times_us, RUN.caused_by, RUN.events)],
        ):
            with pytest.raises(
                ValueError,
                match=r"run run.*, seq \d+, field \w+: found .*, expected characters that can be printed; give it "
                r"another name",
            ):
                stage(tmp_path / "ledger", runs)
        assert contents(tmp_path) == before
        assert writer.append(stage(tmp_path / "ledger", [RUN])).commits == 1


def test_the_field_is_named_and_not_an_earlier_one_that_is_printed(tmp_path: Path) -> None:
    for field, value in (("robot", "robot-0\x1b"), ("path", ("robot/A1\x1b",))):
        first, *_, at = (at for at, event in enumerate(RUN.events) if flat(event).get(field))
        assert first < at
        events = [*RUN.events[:at], with_columns(RUN.events[at], **{field: value}), *RUN.events[at + 1 :]]
        with pytest.raises(ValueError, match=f"seq {at}, field {field}: found 'robot.*x1b'"):
            stage(tmp_path / "ledger", [LedgerRun(RUN.run_id, RUN.times_us, RUN.caused_by, events)])


def test_letters_of_any_script_are_names(tmp_path: Path) -> None:
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        writer.append(stage(tmp_path / "ledger", [relabelled(RUN, lambda text: text + "Zürich 東京 אב")]))
    assert verify(tmp_path / "ledger").ok


def test_what_an_earlier_release_stored_verifies(tmp_path: Path) -> None:
    with Writer(tmp_path / "ledger", ORIGIN) as writer:
        writer.append(stage_anything(tmp_path / "ledger", [relabelled(RUN, lambda text: text + "\x1b[2J\n")]))
    assert verify(tmp_path / "ledger").ok
    assert open_ledger(tmp_path / "ledger").run_names.runs == ("run-1\x1b[2J\n",)
