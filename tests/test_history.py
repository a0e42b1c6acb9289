"""The order of the stages of the evaluation is read from a history, and each violation is found."""

import json
import subprocess
from pathlib import Path

import pytest

from tests.history import CONSTANTS, STAGES, findings, git

HANDLER = "fsar_ledger/runtime/handlers/policy.py"
FILES = {
    HANDLER: "RULE = 1\n",
    CONSTANTS: "    review_share: Fitted[float] = 0.06  # share\n    horizon_s: AfterFits[float] = 240.0  # end\n",
}


def commit(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    git(root, "add", "-A")
    git(root, "-c", "user.name=a", "-c", "user.email=a@b", "commit", "-q", "-m", "a change")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    subprocess.run(["git", "init", "-q", str(tmp_path)], check=True)
    commit(tmp_path, FILES)
    return tmp_path


PATHS = {stage.name: stage.path for stage in STAGES}
ORDER = tuple(PATHS)


def staged(root: Path, *between: dict[str, str], order: tuple[str, ...] = ORDER) -> list[str]:
    """Return what does not hold after these stages in this order, with other changes after the first of them."""
    for number, stage in enumerate(order):
        commit(root, {PATHS[stage]: f"{stage}\n"})
        if number == 0:
            for files in between:
                commit(root, files)
    return list(findings(root))


def test_stages_in_order_over_an_unchanged_model_are_fine(root: Path) -> None:
    assert staged(root) == []


def test_the_value_of_a_free_constant_may_change(root: Path) -> None:
    assert staged(root, {CONSTANTS: FILES[CONSTANTS].replace("0.06", "0.071")}) == []


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({HANDLER: "RULE = 2\n"}, "handlers/policy.py changed between the registration"),
        ({"fsar_ledger/runtime/world/new.py": ""}, "world/new.py changed between the registration"),
        ({CONSTANTS: FILES[CONSTANTS].replace("240.0", "241.0")}, "horizon_s: AfterFits"),
        ({CONSTANTS: FILES[CONSTANTS].replace("Fitted[float] = 0.06", "Chosen[float] = 0.06")}, "review_share: Chosen"),
        ({CONSTANTS: FILES[CONSTANTS] + "MORE = 1\n"}, "MORE = 1 changed"),
    ],
)
def test_a_change_of_the_model_after_the_registration_is_found(root: Path, changed: dict[str, str], said: str) -> None:
    assert any(said in one for one in staged(root, changed))


def moved(stage: str, before: str) -> tuple[str, ...]:
    """Return the order with one stage moved before another."""
    others = [name for name in ORDER if name != stage]
    return (*others[: (at := others.index(before))], stage, *others[at:])


@pytest.mark.parametrize(
    ("late", "early"),
    [(stage.name, earlier) for stage in STAGES for earlier in stage.after],
)
def test_stages_in_another_order_are_found(root: Path, late: str, early: str) -> None:
    found = staged(root, order=moved(late, early))
    assert any(one.startswith(late) and f"does not come after the {early}" in one for one in found)


@pytest.mark.parametrize("order", [moved("ensemble", "predictions"), moved("sensitivity", "predictions")])
def test_what_needs_the_fit_alone_may_come_at_any_time_after_it(root: Path, order: tuple[str, ...]) -> None:
    assert staged(root, order=order) == []


def test_the_fit_is_not_held_up_by_a_ranking_that_is_not_made(root: Path) -> None:
    assert staged(root, order=tuple(name for name in ORDER if name != "ranking")) == []


def test_digests_of_queries_can_be_renewed_in_any_order_and_results_cannot(root: Path) -> None:
    def record(number: int, rules: str) -> str:
        return json.dumps({"numbers": [number], "rules": {"facts/conflicts": rules}, "cpu_minutes": len(rules)})

    paths = list(PATHS.values())
    for number, path in enumerate(paths):
        commit(root, {path: record(number, "before")})
    commit(root, {HANDLER: "RULE = 2\n"})
    commit(root, {path: record(number, "after") for number, path in enumerate(paths) if number})
    assert list(findings(root)) == []
    commit(root, {PATHS["fit"]: record(9, "after")})
    assert any("predictions" in one and "does not come after the fit" in one for one in findings(root))


def test_stages_in_one_commit_have_no_order(root: Path) -> None:
    commit(root, dict.fromkeys(PATHS.values(), "all at once\n"))
    pairs = sum(len(stage.after) for stage in STAGES)
    assert len([one for one in findings(root) if "does not come after" in one]) == pairs


def test_a_registration_that_is_changed_afterwards_is_found(root: Path) -> None:
    staged(root)
    commit(root, {PATHS["registration"]: "other margins\n"})
    assert any("fit" in one and "does not come after the registration" in one for one in findings(root))


def test_nothing_counts_without_a_registration(root: Path) -> None:
    commit(root, {PATHS["fit"]: "a fit\n"})
    assert any("expected the registration before anything else" in one for one in findings(root))
