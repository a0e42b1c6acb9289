"""Ledgers of every released version are read for ever, those of format 1 once they are upgraded, and event types change
only as stored events allow. See `keep_release.py`."""

import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.base.errors import LedgerCorrupted
from fsar_ledger.cli.app import run
from fsar_ledger.events import ALONE, EVENT_TYPES
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.log.hashing import leaves_of
from fsar_ledger.ledger.opening import open_for_answers, open_ledger
from fsar_ledger.ledger.rows.codec import LedgerRun, decode, encode, encode_hashed
from fsar_ledger.ledger.rows.schema import LAYOUTS, RELEASE, RETIRED, SCHEMA, described, parse_columns
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.keys import read_verifier
from fsar_ledger.ledger.store.manifest import Manifest
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.ledger.v1 import upgrade
from fsar_ledger.ledger.verify import verify
from fsar_ledger.ledger.verify.report import VerifyOptions, read_anchor
from fsar_ledger.metrics.database import connect
from fsar_ledger.metrics.library import staging_sql, view_name
from tests.ledger.agreement import Case, judged
from tests.ledger.bomb_trial import cost_of
from tests.ledger.bombs import base_ledger, commit, runs
from tests.ledger.keep_release import COLUMNS, LEDGERS, Kept, keep, kept_of, stored_types
from tests.ledger.samples import made_up_batches
from tests.quick import few
from tests.untrusted import run_untrusted

Types = Mapping[str, Mapping[str, str]]

QUESTIONS = ("staging/runs", "metrics/run_metrics", "facts/decisions", "facts/executions", "audit/requests")
OR_NULL = " or NULL"


def number(release: str) -> tuple[int, ...]:
    return tuple(map(int, release.split(".")))


VERSIONS = sorted((folder.name for folder in LEDGERS.iterdir() if folder.is_dir()), key=number)


def version_of(path: Path) -> int:
    return msgspec.json.decode((path / "ledger.json").read_bytes(), type=Manifest).version


def kept_types(version: str) -> dict[str, dict[str, str]]:
    lines = (LEDGERS / version / "events.jsonl").read_bytes().splitlines()
    return {
        tag: fields
        for line in lines
        for tag, fields in msgspec.json.decode(line, type=dict[str, dict[str, str]]).items()
    }


@pytest.fixture(params=few(VERSIONS, [VERSIONS[0], VERSIONS[-1]]))
def version(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def upgraded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of ledgers of format 1 that were upgraded."""
    return tmp_path_factory.mktemp("upgraded")


@pytest.fixture
def path(version: str, upgraded: Path) -> Path:
    """Return the kept ledger, in today's format."""
    kept = LEDGERS / version / "ledger"
    if version_of(kept) != 1:
        return kept
    if not (upgraded / version).exists():
        upgrade(kept, upgraded / version)
    return upgraded / version


@pytest.fixture
def kept(version: str) -> Kept:
    return kept_of(version)


# --- ledgers of released versions ---


def test_a_ledger_of_each_release_is_kept() -> None:
    assert "0.1.0" in VERSIONS
    assert {path.stem for path in COLUMNS.iterdir()} <= set(VERSIONS)


def test_a_kept_ledger_verifies_to_the_root_and_the_signatures_that_it_had(path: Path, kept: Kept) -> None:
    report = verify(path, asked=VerifyOptions(trusted=read_verifier(kept.key)))
    assert report.problems == ()
    assert (report.root, report.events, report.commits, report.runs) == (
        kept.root,
        kept.events,
        kept.commits,
        len(kept.runs),
    )
    assert report.signed == kept.commits


@pytest.mark.parametrize("version", few(["0.1.0", "0.2.0"], ["0.1.0"]))  # all later writers refuse such a run
def test_constants_of_a_live_run_that_cannot_be_read_are_shown_as_such_and_stop_no_answer(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = None
    with suppress(LedgerCorrupted):
        found = fsar_ledger.open_ledger(path).info()
    assert found is not None, "a ledger that verifies is called damaged"
    [unread] = [model for model in found.models if model["parameters"] is None]
    assert (unread["kind"], unread["runs"], unread["differing"]) == (
        "live",
        1,
        f"unreadable, SHA-256 {unread['parameters_sha256'][:12]}",
    )
    assert any(
        f"parameters that cannot be read, SHA-256 {unread['parameters_sha256'][:12]}" in line
        for line in found.summary()
    )
    assert run(["audit", str(path), "--invariant", "i4"]) in (0, 1)
    assert (
        "1 run with unreadable parameters: their recovery budgets are unknown and are not judged"
        in capsys.readouterr().out
    )
    with connect(path) as database:
        budgets = {
            (row["t_max_us"], row["n_max"])
            for row in database.rows("SELECT * FROM recovery_allowances WHERE run_id = 'made-up' AND since_seq = 0")
        }
    assert budgets == {(None, None)}


def test_every_event_of_a_kept_ledger_becomes_one_of_today(path: Path, kept: Kept) -> None:
    runs = list(open_ledger(path).runs())
    assert tuple(run.run_id for run in runs if type(run.events[0]) not in ALONE) == kept.runs
    assert sum(len(run.events) for run in runs) == kept.events
    assert {type(event) for run in runs for event in run.events} <= set(EVENT_TYPES)


def test_a_kept_ledger_and_the_log_beside_it_hold_every_event_type_of_their_release(version: str, path: Path) -> None:
    both = [path, *LEDGERS.glob(f"{version}/log")]
    tables = [table for one in both for table in open_ledger(one).tables(["type"])]
    assert {tag for table in tables for tag in table.column("type").to_pylist()} == set(kept_types(version))


def test_the_runs_of_a_kept_ledger_have_the_leaves_that_they_had(path: Path) -> None:
    view, first = open_ledger(path), 0
    for table in view.tables():
        end = first + table.num_rows
        if not set(table.column("type").to_pylist()) & set(RETIRED):  # what is upcast has leaves as stored only
            parts = list(decode(table, is_whole=False))
            assert encode_hashed(parts)[1] == leaves_of(view.rows(first, end))
        first = end


# tests/queries/test_keys.py asks the same of all of them in one database
@pytest.mark.parametrize("version", few(VERSIONS, [VERSIONS[0]], ["0.9.0", VERSIONS[-1]]))
def test_sql_answers_about_a_kept_ledger(path: Path, kept: Kept) -> None:
    with connect(path) as database:
        answers = [database.query(name) for name in QUESTIONS]
        [counted] = database.rows(
            "SELECT count(*) AS events, count(DISTINCT run_id) FILTER (type <> 'ExperimentPlanned.v1') AS runs "
            "FROM events"
        )
    events, runs = kept.events - len(kept.continued), set(kept.runs) - set(kept.continued)  # each as one run
    assert counted == {"events": events, "runs": len(runs)}
    for answer in answers:
        assert answer.num_rows > 0
    assert [set(answer.column("run_id").to_pylist()) for answer in answers[:2]] == [runs, runs]
    assert run_untrusted(path, "SELECT count(*) AS events FROM events").rows == [{"events": events}]


@pytest.mark.parametrize(
    "version", few([version for version in VERSIONS if "RunStarted.v1" in kept_types(version)], ["0.1.0"])
)
def test_sql_has_rows_of_retired_types_as_their_events_are_decoded(path: Path) -> None:
    started = [record for record in open_ledger(path).runs() if isinstance(record.events[0], RunStarted)]
    [expected] = [
        encode([LedgerRun(record.run_id, record.times_us[:1], [None], record.events[:1]) for record in started])
    ]
    select = "SELECT * FROM events WHERE type = 'RunStarted.v2' ORDER BY run_id"
    with connect(path) as database:
        assert database.table(select).to_pylist() == expected.sort_by("run_id").to_pylist()
        assert database.rows(
            "SELECT count(*) AS n FROM events WHERE type = 'RunStarted.v1' OR observes IS NOT NULL AND seq > 0"
        ) == [{"n": 0}]
    assert run_untrusted(path, select).rows == expected.sort_by("run_id").to_pylist()


@pytest.mark.parametrize(
    "version", few([version for version in VERSIONS if kept_types(version).keys() & set(RETIRED)], ["0.1.0"])
)
def test_the_view_of_a_type_has_its_rows_as_events_has_them(path: Path) -> None:
    with connect(path) as database:
        for tag in {row["type"] for row in database.rows("SELECT DISTINCT type FROM events")}:
            found = database.table(f"SELECT * FROM {view_name(tag)} ORDER BY ALL")
            assert found.num_rows > 0, tag
            assert found.equals(database.table(f"{staging_sql(tag)} ORDER BY ALL")), tag


@pytest.mark.slow
def test_rows_of_a_retired_type_are_not_made_anew_for_an_answer(tmp_path: Path) -> None:
    base_ledger(tmp_path / "ledger")
    old = runs(200_000)
    commit(tmp_path / "ledger", old, len(old))
    cost = cost_of(["sql", "ledger", "SELECT count(observes), max(run_id) FROM events"], tmp_path)
    assert cost.code == 0, cost
    assert cost.memory_mib < 400, cost  # made anew they took 700 MiB


def test_an_upgraded_ledger_has_the_commits_segments_and_signatures_that_it_had(
    version: str, path: Path, kept: Kept
) -> None:
    old = LEDGERS / version / "ledger"
    if version_of(old) == 1:
        records = [msgspec.json.decode(file.read_bytes()) for file in sorted((old / "commits").iterdir())]
        view = open_ledger(path)
        assert [(one.rows, one.tree_root) for one in view.commits] == [
            (one["rows"], one["tree_root"]) for one in records
        ]
        assert [str(one.note(view.manifest.origin)) for one in view.commits] == [one["note"] for one in records]
        assert [one.segment_sha256 for one in view.chain.placed] == [one["segment_sha256"] for one in records]
        assert (path / "checkpoint").read_bytes() == (old / "checkpoint").read_bytes()
    assert judged(Case("kept", path, True, read_verifier(kept.key))).difference == ""


def continued(path: Path, kept: Kept, copy: Path) -> None:
    """Continue a copy of the ledger, and compact it."""
    shutil.copytree(path, copy)
    [runs] = made_up_batches(1)
    with Writer(copy, open_ledger(path).manifest.origin, adopts=True) as writer:
        writer.append(stage(copy, runs[:1]))
        root = writer.add(runs[1:]).root
    report = verify(copy, asked=VerifyOptions(anchor=read_anchor(path / "checkpoint")))
    assert (report.problems, report.events, report.anchored) == ((), kept.events + 24, kept.events)
    assert report.root == root
    fsar_ledger.open_ledger(copy).compact()
    assert judged(Case("compacted", copy, True, anchor=path / "checkpoint")).difference == ""


def test_a_kept_ledger_is_continued_and_compacted_and_both_verifiers_agree(
    path: Path, kept: Kept, tmp_path: Path
) -> None:
    continued(path, kept, tmp_path / "copy")


@pytest.mark.parametrize("version", ["0.8.0", "0.8.1"])
def test_a_kept_ledger_that_needs_no_upgrade_has_the_root_of_its_twin_and_is_continued(
    version: str, path: Path, kept: Kept, tmp_path: Path
) -> None:
    key, twin = read_verifier(kept.key), LEDGERS / version / "chain"
    assert judged(Case("kept", twin, True, key)).difference == ""
    report = verify(twin, asked=VerifyOptions(trusted=key))
    assert (report.problems, report.root, report.events) == ((), kept.root, kept.events)
    assert list(open_for_answers(twin).runs()) == list(open_ledger(path).runs())
    continued(twin, kept, tmp_path / "copy")


def test_of_each_release_since_0_8_0_a_ledger_is_kept_that_needs_no_upgrade() -> None:
    for version in VERSIONS:
        names = [name for name in ("ledger", "chain") if (LEDGERS / version / name).exists()]
        has_one = any(version_of(LEDGERS / version / name) == 2 for name in names)
        assert has_one == (number(version) >= (0, 8, 0)), version


def test_a_kept_release_is_never_written_again(tmp_path: Path) -> None:
    version = fsar_ledger.__version__
    (tmp_path / version).mkdir()
    with pytest.raises(SystemExit, match="a release is kept once"):
        keep(version, ledgers=tmp_path)
    with pytest.raises(SystemExit, match="set it first"):
        keep("0.0.9", ledgers=tmp_path)
    (tmp_path / f"{RELEASE}.txt").write_text("run_id string not null\n")
    with pytest.raises(SystemExit, match="found other columns than today's"):
        keep(version, ledgers=tmp_path / "none", columns=tmp_path)


# --- what may change ---


def is_widened(then: str, now: str | None) -> bool:
    """Whether the field can hold now whatever it could hold then; NULL is not stored, so no stored event changes."""
    if now is None or (then.endswith(OR_NULL) and not now.endswith(OR_NULL)):
        return False
    (was, _, few), (becomes, _, many) = (part.removesuffix(OR_NULL).partition(" of ") for part in (then, now))
    return was == becomes and (not many or (few != "" and set(few.split("|")) <= set(many.split("|"))))


def broken_rules(then: Types, now: Types, retired: Types) -> list[str]:
    """Return each change since a release that stored events do not allow, with what to do instead."""
    found = []
    for tag, fields in then.items():
        name, _, version = tag.rpartition(".v")
        if tag in retired:
            if retired[tag] != fields:
                found.append(f"{tag}: it is retired and not as it was stored; give it the fields {fields}")
        elif tag not in now:
            found.append(f"{tag}: it is gone; keep it in fsar_ledger/events/retired.py, with an upcaster")
        else:
            own = now[tag]
            changed = [field for field in fields if not is_widened(fields[field], own.get(field))]
            changed += [field for field in own if field not in fields and not own[field].endswith(OR_NULL)]
            if changed:
                found.append(
                    f"{tag}: {', '.join(sorted(changed))} changed; make it {name}.v{int(version) + 1} and keep "
                    f"{tag} in fsar_ledger/events/retired.py"
                )
    return found


def test_event_types_change_only_as_stored_events_allow(version: str) -> None:
    assert broken_rules(kept_types(version), stored_types(LAYOUTS.values()), stored_types(RETIRED.values())) == []


def test_other_event_types_have_another_release() -> None:
    newest = max((release for release in VERSIONS if number(release) <= number(RELEASE)), key=number)
    is_kept = RELEASE in VERSIONS
    is_same = kept_types(newest) == stored_types(LAYOUTS.values())
    assert is_same == is_kept, (
        f"event types differ from release {newest}: set RELEASE in fsar_ledger/ledger/rows/schema.py to the "
        "release to come"
    )


def test_the_columns_of_a_release_are_pinned() -> None:
    assert RELEASE not in VERSIONS or (COLUMNS / f"{RELEASE}.txt").read_text("utf-8") == described(SCHEMA)


THEN = {"Moved.v1": {"robot": "string", "speed": "integer or NULL"}}


@pytest.mark.parametrize(
    "fields",
    [
        {"robot": "string"},
        {"robot": "string", "velocity": "integer or NULL"},
        {"robot": "integer", "speed": "integer or NULL"},
        {"robot": "string", "speed": "integer"},
        {"robot": "string of A|B", "speed": "integer or NULL"},
        {"robot": "string", "speed": "integer or NULL", "place": "string"},
    ],
    ids=[
        *("gone", "renamed", "another kind", "no longer optional"),
        *("fewer values", "a new field that is not optional"),
    ],
)
def test_any_other_change_of_an_event_type_is_found(fields: dict[str, str]) -> None:
    [rule] = broken_rules(THEN, {"Moved.v1": fields}, {})
    assert rule.endswith("make it Moved.v2 and keep Moved.v1 in fsar_ledger/events/retired.py")


def test_a_field_may_become_optional_or_take_more_values() -> None:
    then = {"Moved.v1": {"robot": "string", "mode": "string of A|B", "gear": "string of A|B"}}
    now = {"robot": "string or NULL", "mode": "string of A|B|C or NULL", "gear": "string"}
    assert broken_rules(then, {"Moved.v1": now}, {}) == []
    assert broken_rules({"Moved.v1": now}, then, {}) != []


def test_a_new_optional_field_and_a_new_type_are_allowed() -> None:
    assert (
        broken_rules(
            THEN, {"Moved.v1": {**THEN["Moved.v1"], "place": "string or NULL"}, "Stopped.v1": {"robot": "string"}}, {}
        )
        == []
    )


def test_a_retired_type_stays_exactly_as_it_was_stored() -> None:
    assert broken_rules(THEN, {"Moved.v2": {"robot": "string"}}, THEN) == []
    assert broken_rules(THEN, {"Moved.v2": {"robot": "string"}}, {}) == [
        "Moved.v1: it is gone; keep it in fsar_ledger/events/retired.py, with an upcaster"
    ]
    [rule] = broken_rules(THEN, {}, {"Moved.v1": {"robot": "string"}})
    assert rule.startswith("Moved.v1: it is retired and not as it was stored")


def test_columns_of_a_release_that_changed_or_went_are_refused() -> None:
    text = described(SCHEMA)
    assert parse_columns("x.txt", text).equals(SCHEMA)
    assert parse_columns("x.txt", text.replace("robot string\n", "")).names == [
        name for name in SCHEMA.names if name != "robot"
    ]
    for other in (
        text.replace("robot string\n", "robot int64\n"),
        text + "zebra string\n",
        text.replace("seq int64 not null\n", "") + "seq int64 not null\n",
    ):
        with pytest.raises(TypeError, match=r"x\.txt: found .*keep each column as it was"):
            parse_columns("x.txt", other)
