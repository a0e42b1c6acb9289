"""A later release opens ledgers of this one, and this one refuses what a later release wrote.

See `later_release.py`.
"""

import atexit
import re
import shutil
import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from fsar_ledger.base.errors import FormatVersionMismatch, UnknownEventTag
from fsar_ledger.cli import app
from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.rows.schema import FINGERPRINTS, RELEASE
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.v1 import upgrade
from fsar_ledger.ledger.verify import verify
from tests.ledger import later_release
from tests.ledger.forgery import changed, forge_segment, table_of
from tests.ledger.keep_release import LEDGERS, ORIGIN
from tests.ledger.later_release import LaterRelease
from tests.ledger.samples import append_all, made_up_batches

KEPT = "0.1.0"
OLD = Path(tempfile.mkdtemp(prefix="fsar-ledger-")) / "ledger"
atexit.register(shutil.rmtree, OLD.parent)
upgrade(LEDGERS / KEPT / "ledger", OLD)

DECODE = """
import json, sys
from pathlib import Path
import fsar_ledger
from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.opening import open_ledger
events = [event for run in open_ledger(Path(sys.argv[1])).runs() for event in run.events]
events = [event for event in events if type(event).__name__.startswith("StepBegan")]
found = [{**flat(event), "type": type(event).__struct_config__.tag} for event in events]
print(json.dumps({"package": fsar_ledger.__file__, "events": found}))
"""
APPEND = """
import json, sys
from pathlib import Path
from tests.ledger.samples import append_all, run_of_every_type
head = append_all(Path(sys.argv[1]), [[run_of_every_type("later", seed=5)]], origin=sys.argv[2])
print(json.dumps(head.root))
"""


@pytest.fixture(scope="module")
def later(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LaterRelease]:
    with LaterRelease(tmp_path_factory.mktemp("later")) as later:
        yield later


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory, later: LaterRelease) -> Path:
    """Return a ledger that the later release has continued."""
    path = shutil.copytree(OLD, tmp_path_factory.mktemp("mixed") / "ledger")
    later.run(APPEND, path, ORIGIN)
    return path


@cache
def stored(tag: str) -> int:
    """Return how many events of this type the ledger of this release holds."""
    return sum(table.column("type").to_pylist().count(tag) for table in open_ledger(OLD).tables(["type"]))


def test_a_later_release_verifies_a_ledger_of_this_one_to_the_same_root(later: LaterRelease) -> None:
    answer = later.answer("verify", OLD)
    assert answer["ok"]
    assert answer["root"] == verify(OLD).root


def test_a_later_release_decodes_retired_types_as_their_newest_version(later: LaterRelease) -> None:
    found = later.run(DECODE, OLD)
    assert not found["package"].startswith(str(later_release.ROOT))
    assert {event["type"] for event in found["events"]} == {"StepBegan.v3"}
    assert len(found["events"]) == stored("StepBegan.v1") > 0
    assert {event["is_delegated"] for event in found["events"]} == {False, True}
    assert all(event["is_delegated"] == (event["target_role"] is not None) for event in found["events"])


@pytest.mark.slow
def test_metrics_and_queries_over_retired_types_give_the_same_answers(
    later: LaterRelease, capsys: pytest.CaptureFixture[str]
) -> None:
    for question in (
        ("metrics", OLD),
        ("query", "facts/cross_robot_records", OLD),
        ("query", "facts/policy_decisions", OLD),
    ):
        assert app.run([*map(str, question), "--json"]) == 0
        assert later.call(*question, "--json").out == capsys.readouterr().out


COUNTED = """
SELECT
    type, count(*) AS n, count(is_delegated) AS told, count(is_own) AS retired, count(depot) AS depots,
    count(*) FILTER (is_delegated = (target_role IS NOT NULL)) AS agree
FROM events WHERE type LIKE 'StepBegan%' OR type LIKE 'RobotJoined%' GROUP BY type ORDER BY type
"""
CONNECT = """
import json, sys
from pathlib import Path
from fsar_ledger.metrics.database import connect
with connect(Path(sys.argv[1])) as database:
    print(json.dumps({"rows": database.rows(sys.argv[2])}))
"""


@pytest.mark.parametrize("is_locked", [True, False], ids=["locked", "own"])
def test_sql_meets_only_the_newest_version_and_null_in_columns_that_came_later(
    later: LaterRelease, is_locked: bool
) -> None:
    answer = later.answer("sql", OLD, COUNTED) if is_locked else later.run(CONNECT, OLD, COUNTED)
    assert answer["rows"] == [
        {"type": "RobotJoined.v1", "n": stored("RobotJoined.v1"), "told": 0, "retired": 0, "depots": 0, "agree": 0},
        {
            "type": "StepBegan.v3",
            "n": stored("StepBegan.v1"),
            "told": stored("StepBegan.v1"),
            "retired": 0,
            "depots": 0,
            "agree": stored("StepBegan.v1"),
        },
    ]


@pytest.mark.slow
def test_every_event_is_there_once_in_the_views_and_in_sql(later: LaterRelease, mixed: Path) -> None:
    views = later.answer("query", "staging/step_began", mixed)["rows"]
    assert len(views) == stored("StepBegan.v1") + 2
    events = later.answer(
        "sql", mixed, "SELECT count(*) AS n, count(DISTINCT run_id || ' ' || seq) AS places FROM events"
    )
    assert events["rows"] == [{"n": events["head"]["size"], "places": events["head"]["size"]}]


def test_a_ledger_that_a_later_release_continued_holds_both_kinds_of_segments(later: LaterRelease, mixed: Path) -> None:
    answer = later.answer("verify", mixed)
    assert (answer["ok"], answer["commits"]) == (True, 4)
    depots = later.answer("sql", mixed, "SELECT count(depot) AS n, count(*) AS joined FROM robot_joined")
    assert depots["rows"] == [{"n": 1, "joined": stored("RobotJoined.v1") + 2}]


def test_a_ledger_of_this_release_is_exported_as_it_is_stored(later: LaterRelease, tmp_path: Path) -> None:
    done = later.call("export", OLD, "--out", tmp_path / "events.csv")
    assert done.code == 0, done.err
    text = (tmp_path / "events.csv").read_text("utf-8")
    assert text.count('"StepBegan.v1"') == stored("StepBegan.v1")
    assert "StepBegan.v3" not in text


def test_the_records_of_each_commit_name_its_release(later: LaterRelease, mixed: Path) -> None:
    code = "import json, sys; from pathlib import Path; from fsar_ledger.ledger.opening import open_ledger\n"
    records = later.run(
        code
        + "print(json.dumps([[r.release, r.schema_sha256] for r in open_ledger(Path(sys.argv[1])).chain.placements]))",
        mixed,
    )
    assert [release for release, _ in records] == [KEPT] * 3 + [later_release.RELEASE]
    assert {fingerprint for _, fingerprint in records[:3]} == {FINGERPRINTS[KEPT]} != {records[3][1]}


# --- this release, and what a later one wrote ---


def test_a_ledger_of_a_later_release_is_refused_by_its_name(mixed: Path) -> None:
    found = re.escape(later_release.RELEASE)
    message = (
        rf"chain\.jsonl: commit 3, field release: found '{found}', expected at most {RELEASE}; read it with "
        rf"fsar-ledger {found} or later"
    )
    with pytest.raises(FormatVersionMismatch, match=message):
        open_ledger(mixed)
    with pytest.raises(FormatVersionMismatch, match=message):
        Writer(mixed, ORIGIN)


def test_verify_names_the_release_that_it_cannot_judge_first(mixed: Path) -> None:
    problem = verify(mixed).problems[0]
    assert (problem.where, problem.field, problem.found) == ("chain.jsonl", "release", f"'{later_release.RELEASE}'")
    assert verify(mixed).commits == 3


@pytest.mark.parametrize(
    ("code", "call"),
    [
        (2, ("info", "LEDGER")),
        (2, ("metrics", "LEDGER")),
        (2, ("query", "staging/runs", "LEDGER")),
        (2, ("sql", "LEDGER", "SELECT 1")),
        (2, ("export", "LEDGER", "--out", "OUT")),
        (3, ("verify", "LEDGER")),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_each_command_says_which_version_is_needed(
    mixed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], code: int, call: tuple[str, ...]
) -> None:
    places = {"LEDGER": str(mixed), "OUT": str(tmp_path / "events.csv")}
    assert app.run([places.get(word, word) for word in call]) == code
    printed = "".join(capsys.readouterr())
    assert f"read it with fsar-ledger {later_release.RELEASE} or later" in printed
    assert "Traceback" not in printed


@pytest.mark.slow
def test_an_unknown_event_type_is_refused_with_its_place_and_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    append_all(tmp_path / "ledger", made_up_batches(2))
    forge_segment(tmp_path / "ledger", 1, changed(table_of(tmp_path / "ledger", 1), "type", 3, "RobotFlew.v1"))
    place = (
        r"run run-0002, seq 3, field type: found 'RobotFlew\.v1', expected an event type that this version of "
        r"fsar-ledger knows"
    )
    with pytest.raises(
        UnknownEventTag,
        match=rf"000000000048\.parquet: {place}; read it with the version that wrote it, or restore the "
        r"segment",
    ):
        list(open_ledger(tmp_path / "ledger").runs())
    assert app.run(["verify", str(tmp_path / "ledger")]) == 3
    printed = "".join(capsys.readouterr())
    assert "'RobotFlew.v1'" in printed
    assert "Traceback" not in printed
