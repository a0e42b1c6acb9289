"""Two runs in the browser, filters, tables, colours, and what readers of screens get."""

from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from tests.view.browser import (
    PHONE,
    SPAN,
    Open,
    Page,
    browser,
    cursor,
    event,
    load,
    one,
    pages,
    press,
    settle,
    tabs,
    title,
    two,
)

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="make test-all installs axe")

__all__ = ["browser", "load", "one", "pages", "tabs", "two"]

pytestmark = pytest.mark.slow


def chip(page: Page, group: str, name: str) -> Any:
    return page.get_by_role("group", name=group).get_by_role("button", name=name, exact=True)


def lanes(page: Page) -> int:
    return int(page.locator("#runs .lane").count())


# --- two runs ---


def test_two_runs_stand_one_above_the_other(two: Page) -> None:
    upper, lower = (picture.bounding_box() for picture in two.locator("#runs .run").all())
    assert upper["y"] + upper["height"] <= lower["y"] + 1
    assert upper["x"] == lower["x"]
    assert two.locator("#runs h2").count() == 2


def test_the_first_difference_is_marked_in_both_and_named(two: Page, pages: Path) -> None:
    assert two.locator("#runs line.difference").count() == 2
    assert two.locator("#axis text.flag").text_content() == "first difference"
    first = two.evaluate("JSON.parse(document.getElementById('data').textContent).first_difference")
    assert f"event {first}." in two.inner_text("#facts")


def test_d_goes_to_the_first_difference_and_shows_both_sides(two: Page) -> None:
    first = two.evaluate("JSON.parse(document.getElementById('data').textContent).first_difference")
    press(two, "End", "d")
    assert event(two) == first
    assert "in its place run" in two.inner_text("#event")


def test_r_goes_to_the_other_run_at_the_same_time(two: Page) -> None:
    press(two, "d")
    before, at = title(two), cursor(two)
    press(two, "r")
    assert title(two) != before
    assert cursor(two) <= at
    press(two, "r")
    assert title(two).split(" of ")[1] == before.split(" of ")[1]


def test_the_state_of_both_is_shown_at_one_time(two: Page) -> None:
    assert two.locator("#moment h3").count() == 2
    assert two.locator("#runs line.cursor").count() == 2


def test_a_click_in_the_lower_run_selects_there(two: Page) -> None:
    lower = two.locator("#runs .run").nth(1)
    name = lower.locator("h2").inner_text().removeprefix("Run ")
    lower.locator(f"{SPAN.removeprefix('svg ')}.work.running").first.click()
    settle(two)
    assert title(two).endswith(f"of run {name}")


def test_the_same_run_twice_has_no_difference(load: Open) -> None:
    page = load("same")
    assert page.inner_text("#facts").startswith("No difference")
    assert page.locator("line.difference").count() == 0


# --- filters ---


def test_f_opens_the_filters_and_escape_closes_them(one: Page) -> None:
    press(one, "f")
    assert one.locator("#filters").is_visible()
    assert one.get_attribute("#filter", "aria-expanded") == "true"
    press(one, "Escape")
    assert one.locator("#filters").is_hidden()
    assert one.evaluate("document.activeElement.id") == "filter"


def test_a_robot_can_be_hidden_and_shown_again(one: Page) -> None:
    one.click("#filter")
    before = lanes(one)
    chip(one, "Robots", "B1").click()
    settle(one)
    assert lanes(one) == before - 1
    assert "robot/B1" not in one.inner_text("#moment dl")
    chip(one, "Robots", "B1").click()
    settle(one)
    assert lanes(one) == before


def test_one_robot_alone_can_be_shown(one: Page) -> None:
    one.click("#filter")
    chip(one, "Robots", "None").click()
    chip(one, "Robots", "C1").click()
    settle(one)
    assert [name for name in one.locator("#moment dt").all_text_contents() if name.startswith("robot/")] == ["robot/C1"]


def test_a_hidden_concern_has_no_bars_and_no_steps(one: Page) -> None:
    one.click("#filter")
    for name in ("policy", "world", "registry", "trust", "run"):
        chip(one, "Concerns", name).click()
    settle(one)
    assert one.locator(f"{SPAN}.policy").count() == 0
    one.locator("#timeline").focus()
    press(one, "Escape", "Home", *["ArrowRight"] * 12)
    for _ in range(8):
        assert one.inner_text("#event .concern") not in ("policy", "world", "registry", "trust", "run")
        press(one, "ArrowRight")


def test_one_task_alone_can_be_shown(one: Page, pages: Path) -> None:
    one.click("#filter")
    tasks = one.locator("#task option").all_text_contents()[1:]
    one.select_option("#task", tasks[0])
    settle(one)
    assert one.locator(f"{SPAN}.task").count() == 1
    assert one.locator("svg text.in.task").all_text_contents() == [tasks[0]]


def test_routine_can_be_hidden(one: Page) -> None:
    assert one.locator(".tick.routine").count() > 2
    one.click("#filter")
    one.get_by_role("button", name="routine").click()
    settle(one)
    assert one.locator("#runs .tick.routine").count() == 0


def test_everything_can_be_shown_again(one: Page) -> None:
    one.click("#filter")
    before = one.locator(SPAN).count()
    chip(one, "Robots", "A1").click()
    chip(one, "Concerns", "policy").click()
    settle(one)
    assert one.locator(SPAN).count() < before
    one.click("#everything")
    settle(one)
    assert one.locator(SPAN).count() == before


def test_keys_within_the_choice_of_a_task_are_its_own(one: Page) -> None:
    one.click("#filter")
    one.focus("#task")
    press(one, "t")
    assert one.locator("#tables").is_hidden()


# --- tables, help, colours ---


def test_t_shows_every_event_and_bar_as_text(one: Page, pages: Path) -> None:
    press(one, "t")
    assert one.locator("#timeline").is_hidden()
    record = fsar_ledger.open_ledger(pages / "ledger").record("fsar.full")
    captions = one.locator("#tables caption").all_text_contents()
    assert captions[0].endswith(f": {len(record.events)} events")
    for more in one.locator("#tables > div > button").all():
        while more.is_visible():
            more.click()
    assert one.locator("#tables table").first.locator("tbody tr").count() == len(record.events)
    press(one, "t")
    assert one.locator("#timeline").is_visible()


def test_a_number_in_the_table_selects_its_event(one: Page) -> None:
    one.click("#table")
    one.locator("#tables tbody .link").nth(5).click()
    settle(one)
    assert event(one) == 5


def test_the_table_holds_what_the_filters_leave(one: Page) -> None:
    press(one, "t", "f")
    before = one.locator("#tables caption").first.inner_text()
    chip(one, "Concerns", "policy").click()
    assert one.locator("#tables caption").first.inner_text() != before


def test_the_question_mark_opens_help_and_escape_closes_it(one: Page) -> None:
    press(one, "?")
    assert one.get_by_role("dialog", name="Keys").is_visible()
    press(one, "t", "Escape")
    assert one.locator("#help").is_hidden()
    assert one.locator("#tables").is_hidden()


def test_the_help_names_every_key(one: Page) -> None:
    one.click("#open-help")
    named = set(one.locator("#help kbd").all_text_contents())
    assert named >= {"←", "→", "↑", "↓", "Home", "End", "+", "−", "0", "[", "]", "d", "r", "f", "t", "l", "Esc"}


def background(page: Page) -> str:
    return str(page.evaluate("getComputedStyle(document.documentElement).backgroundColor"))


def test_colours_follow_the_system_and_l_changes_them(load: Open) -> None:
    light, dark = load("one"), load("one", color_scheme="dark")
    assert background(light) != background(dark)
    press(light, "l", "l")
    assert background(light) == background(dark)
    assert light.inner_text("#theme") == "Theme: dark"
    press(light, "l")
    press(dark, "l")
    assert background(dark) == background(light)


# --- readers of screens, keyboards alone ---


def test_each_step_is_said(one: Page) -> None:
    press(one, "Home", "ArrowRight")
    assert one.inner_text("#live").startswith("Event 1 of ")
    assert one.get_attribute("#live", "aria-live") == "polite"


def test_tab_reaches_the_tools_then_the_timeline_then_the_panels(one: Page) -> None:
    reached = []
    for _ in range(12):
        one.keyboard.press("Tab")
        reached.append(one.evaluate("document.activeElement.id || document.activeElement.className"))
    tools = ["zoom-out", "zoom-in", "whole", "filter", "table", "theme", "open-help"]
    assert reached[:8] == [*tools, "timeline"]
    assert reached[8] == "link"


def test_enter_on_a_button_presses_it_and_nothing_else(one: Page) -> None:
    one.focus("#table")
    press(one, "Enter")
    assert one.locator("#tables").is_visible()
    press(one, " ")
    assert one.locator("#tables").is_hidden()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(
    "keys", [(), ("f",), ("t",), ("ArrowRight",), ("?",)], ids=lambda keys: " ".join(keys) or "start"
)
def test_axe_finds_nothing_serious(load: Open, scheme: str, keys: tuple[str, ...]) -> None:
    pages_of: tuple[tuple[str, dict[str, Any]], ...] = (("one", {}), ("one", {"viewport": PHONE}), ("two", {}))
    for name, options in pages_of[:1] if keys == ("t",) else pages_of:  # axe takes seconds for a table
        page = load(name, color_scheme=scheme, **options)
        press(page, *keys)
        found = axe.Axe().run(page).response["violations"]
        serious = [each for each in found if each["impact"] in ("serious", "critical")]
        assert [(each["id"], [node["html"] for node in each["nodes"][:3]]) for each in serious] == []
