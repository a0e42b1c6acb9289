"""The page in a browser: it loads quietly and at once, and mouse, keys and readers of screens reach all of it."""

from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.view.spans import spans_of
from tests.sources import vda
from tests.sources.importing import filed, imported
from tests.view.browser import (
    DESK,
    EVIL,
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
    view,
)

__all__ = ["browser", "load", "one", "pages", "tabs", "two"]

pytestmark = pytest.mark.slow


# --- it loads ---


@pytest.mark.parametrize("name", ["one", "two", "same", "large", "evil"])
@pytest.mark.parametrize("size", [DESK, PHONE], ids=["1280", "400"])
def test_it_loads_without_a_message_or_a_request(load: Open, name: str, size: dict[str, int]) -> None:
    page = load(name, viewport=size)
    assert page.locator(SPAN).count() > 20
    assert page.evaluate("document.documentElement.scrollWidth") <= size["width"]


def test_a_page_of_ten_thousand_events_has_every_lane(load: Open) -> None:
    assert load("large").locator(".lane").count() >= 96


def test_a_recorded_run_tells_the_time_of_day(load: Open, pages: Path) -> None:
    imported(pages / "recorded", filed(pages, vda.honest_night()))
    fsar_ledger.open_ledger(pages / "recorded").view(pages / "recorded.html", "night")
    page = load("recorded")
    assert page.inner_text("#facts").endswith(" · 2026-03-01T10:00:00.100Z")
    press(page, "End")
    assert page.inner_text("#moment").count("2026-03-01T10:00:") == 1
    assert "2026-" not in load("one").inner_text("body")


def test_hostile_text_is_shown_as_text(load: Open) -> None:
    page = load("evil")
    press(page, "ArrowRight")
    assert EVIL in page.inner_text("#event")
    assert page.locator("img").count() == 0
    assert page.locator("script").count() == 2


def test_without_scripts_the_page_says_so(browser: Any, pages: Path) -> None:
    page = browser.new_page(java_script_enabled=False)
    page.goto((pages / "one.html").as_uri())
    assert "Allow scripts" in page.inner_text("body")
    page.close()


# --- the cursor ---


def test_a_click_puts_the_cursor_there_and_shows_the_state(one: Page) -> None:
    box = one.locator("#runs svg").bounding_box()
    one.mouse.click(box["x"] + 500, box["y"] + 3)
    settle(one)
    first = cursor(one)
    one.mouse.click(box["x"] + 700, box["y"] + 3)
    settle(one)
    assert cursor(one) > first > 0
    assert title(one) == "Event"
    assert "robot/A1" in one.inner_text("#moment")


def test_the_state_is_that_of_the_projections(one: Page, pages: Path) -> None:
    """At the time of an execution's start the panel says that its robot runs it."""
    record = fsar_ledger.open_ledger(pages / "ledger").record("fsar.full")
    seq = next(seq for seq, found in enumerate(record.events) if type(found).__name__ == "ExecutionStarted")
    started: Any = record.events[seq]
    press(one, "Home")
    while event(one) < seq:
        press(one, "ArrowRight")
    row = one.locator("#moment dl > div", has_text=started.robot)
    assert f"running {started.capability}" in row.inner_text()


def test_at_any_moment_as_many_facts_are_shown_as_hold(one: Page, pages: Path) -> None:
    record = fsar_ledger.open_ledger(pages / "ledger").record("fsar.full")
    spans = spans_of(record)
    press(one, "Home")
    shown = 0
    for _ in range(12):
        time_us = record.times_us[event(one)]
        last = max(seq for seq, at_us in enumerate(record.times_us) if at_us <= time_us)
        holding = [span for span in spans if span.seq <= last and (span.until is None or last < span.until)]
        assert one.locator("#moment .fact").count() == len(holding)
        shown += len(holding)
        press(one, *["Shift+ArrowRight"] * 9, "ArrowRight")
    assert shown > 12


def test_shift_and_an_arrow_move_the_cursor_by_a_second(one: Page) -> None:
    before = cursor(one)
    press(one, "Shift+ArrowRight", "Shift+ArrowRight", "Shift+ArrowLeft")
    assert cursor(one) == pytest.approx(before + 1, abs=1e-5)


def test_the_cursor_stays_in_view(one: Page) -> None:
    press(one, "+", "+", "+", "+", "+", "+", "End")
    box, line = one.locator("#runs svg").bounding_box(), one.locator("#runs line.cursor").bounding_box()
    assert box["x"] <= line["x"] <= box["x"] + box["width"]


# --- events ---


def test_the_arrows_step_through_the_events(one: Page) -> None:
    press(one, "Home")
    assert event(one) == 0
    press(one, "ArrowRight", "ArrowRight", "ArrowRight", "ArrowLeft")
    assert event(one) == 2


def test_end_is_the_last_event(one: Page) -> None:
    press(one, "End")
    last = event(one)
    press(one, "ArrowRight")
    assert event(one) == last
    assert f"of {last + 1}" in one.inner_text("#live")


def test_a_click_on_a_bar_shows_the_event_that_began_it(one: Page) -> None:
    one.locator(f"{SPAN}.work.running").first.click()
    settle(one)
    assert "ExecutionStarted" in one.inner_text("#event .type")


def test_a_click_on_a_tick_shows_its_event(one: Page) -> None:
    press(one, "Home", *["ArrowRight"] * 60)
    ring = one.locator("circle.selected").bounding_box()
    wanted = cursor(one)
    press(one, "Escape")
    assert title(one) == "Event"
    one.mouse.click(ring["x"] + ring["width"] / 2, ring["y"] + ring["height"] / 2)
    settle(one)
    assert cursor(one) == pytest.approx(wanted, abs=1)
    assert event(one) > 0


def test_a_click_on_an_arrow_shows_the_message(one: Page) -> None:
    one.locator("path.head.request").first.dispatch_event("pointerdown", {"button": 0})
    one.locator("path.head.request").first.dispatch_event("pointerup", {"button": 0, "bubbles": True})
    settle(one)
    assert "request" in one.inner_text("#event .words")


def test_the_record_is_whole(one: Page, pages: Path) -> None:
    press(one, "End")
    record = fsar_ledger.open_ledger(pages / "ledger").record("fsar.full")
    text = one.inner_text("#event .record")
    assert f"{record.times_us[-1]}" in text
    assert f"{record.caused_by[-1]}" in text


def test_what_is_not_on_record_is_said_to_be_so(load: Open) -> None:
    page = load("two")
    press(page, "r", "Home", *["ArrowRight"] * 120)
    for _ in range(200):
        if "not on record" in page.inner_text("#event"):
            return
        press(page, "ArrowRight")
    raise AssertionError("no field of any event was not on record")


def test_why_is_a_chain_of_links_to_the_beginning(one: Page) -> None:
    press(one, "End", "ArrowLeft")
    while one.locator(".why li").count() < 3:
        press(one, "ArrowLeft")
    causes = [int(text) for text in one.locator(".why b").all_text_contents()]
    assert causes == sorted(causes, reverse=True)
    assert causes[-1] == 0
    one.locator(".why .link").first.click()
    settle(one)
    assert event(one) == causes[0]
    assert one.evaluate("document.activeElement.id") == "event-title"


def test_up_goes_to_the_cause_and_down_to_an_effect(one: Page) -> None:
    one.locator(f"{SPAN}.work.running").first.click()
    settle(one)
    here = event(one)
    press(one, "ArrowUp")
    cause = event(one)
    assert cause < here
    press(one, "ArrowDown")
    assert cause < event(one) <= here


def test_the_chain_is_drawn_through_the_lanes(one: Page) -> None:
    one.locator(f"{SPAN}.work.running").last.click()
    settle(one)
    assert one.locator("polyline.chain").count() == 1


def test_the_commands_name_the_event(one: Page, pages: Path) -> None:
    press(one, "Home", "ArrowRight")
    commands = one.locator(".command").all_text_contents()
    number = fsar_ledger.open_ledger(pages / "ledger").numbers()
    run = next(f"{place}" for name, place in number.items() if name.startswith("fsar"))
    assert commands == [f"fsar-ledger {verb} {pages / 'ledger'} {run}:1" for verb in ("why", "prove")]


def test_a_click_on_a_fact_shows_the_event_that_made_it(one: Page) -> None:
    one.locator("#moment .fact").first.click()
    settle(one)
    assert event(one) > 0


def test_escape_selects_nothing(one: Page) -> None:
    press(one, "End", "Escape")
    assert title(one) == "Event"
    assert one.locator("circle.selected").count() == 0


# --- what is in view ---


@pytest.mark.parametrize("keys", [("+",), ("=",), ("+", "]"), ("+", "+", "[")], ids=" ".join)
def test_keys_zoom_and_pan_and_0_shows_all_again(one: Page, keys: tuple[str, ...]) -> None:
    before = view(one)
    press(one, *keys)
    assert view(one) != before
    press(one, "0")
    assert view(one) == before


@pytest.mark.parametrize("key", ["+", "-"])
def test_zooming_ends_somewhere(one: Page, key: str) -> None:
    press(one, *[key] * 40)
    assert len(view(one)) > 1
    assert one.locator("#runs line.cursor").count() == 1


def test_buttons_zoom(one: Page) -> None:
    before = view(one)
    one.click("#zoom-in")
    settle(one)
    zoomed = view(one)
    one.click("#zoom-out")
    settle(one)
    one.click("#zoom-in")
    settle(one)
    assert view(one) == zoomed != before
    one.click("#whole")
    settle(one)
    assert view(one) == before


def test_ctrl_and_the_wheel_zoom_and_the_wheel_alone_does_not(one: Page) -> None:
    press(one, "+", "+")
    before = view(one)
    box = one.locator("#runs").bounding_box()
    one.mouse.move(box["x"] + 500, box["y"] + 100)
    one.mouse.wheel(0, 200)
    settle(one)
    assert view(one) == before
    one.keyboard.down("Control")
    one.mouse.wheel(0, -300)
    one.keyboard.up("Control")
    settle(one)
    assert view(one) != before


def drag(page: Page, place: str, begin: int, end: int, height: int) -> None:
    """Drag the mouse there from one x to another. Units: pixels from the corner of the place."""
    box = page.locator(place).bounding_box()
    page.mouse.move(box["x"] + begin, box["y"] + height)
    page.mouse.down()
    page.mouse.move(box["x"] + end, box["y"] + height, steps=4)
    page.mouse.up()
    settle(page)


def test_a_drag_moves_what_is_in_view_and_selects_nothing(one: Page) -> None:
    press(one, "+", "+", "+")
    before = view(one)
    drag(one, "#runs", 600, 300, 100)
    assert view(one) != before
    assert title(one) == "Event"


def test_a_drag_over_the_strip_chooses_what_is_in_view(one: Page) -> None:
    before = view(one)
    drag(one, "#overview", 300, 400, 20)
    assert view(one) != before
    assert one.locator("#overview .window").count() == 1


def test_a_double_click_zooms_though_its_first_click_is_drawn_during_its_second(one: Page) -> None:
    before = view(one)
    box = one.locator("#runs").bounding_box()
    one.mouse.move(box["x"] + 500, box["y"] + 3)
    one.mouse.down(click_count=1)
    one.mouse.up(click_count=1)
    one.mouse.down(click_count=2)
    settle(one)
    one.mouse.up(click_count=2)
    settle(one)
    assert view(one) != before


def test_words_follow_the_mouse_over_a_bar(one: Page) -> None:
    one.locator(f"{SPAN}.work.running").first.hover()
    assert "running" in one.inner_text("#tip")
    one.mouse.move(2, 2)
    assert one.locator("#tip").is_hidden()


def test_a_wider_window_is_drawn_wider(one: Page) -> None:
    before = one.locator("#runs svg").bounding_box()["width"]
    one.set_viewport_size({"width": 1600, "height": 900})
    settle(one)
    assert one.locator("#runs svg").bounding_box()["width"] > before + 100


def test_it_prints_without_its_tools(one: Page) -> None:
    one.emulate_media(media="print")
    assert one.locator(".tools").is_hidden()
    assert one.locator("#runs svg").is_visible()
