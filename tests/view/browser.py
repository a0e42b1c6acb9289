"""Pages in a browser: Debian's Chromium, driven by Playwright. Where one of them is lacking, tests are left out."""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import fsar_ledger
from fsar_ledger.view import page as page_of
from tests.ledger.hostile import relabelled
from tests.view.conftest import a_run, plain_words, shown

sync_api = pytest.importorskip("playwright.sync_api", reason="make test-all installs Playwright")
CHROMIUM = shutil.which("chromium")
if CHROMIUM is None:
    pytest.skip("make test-all installs Chromium", allow_module_level=True)

DESK, PHONE = {"width": 1280, "height": 900}, {"width": 400, "height": 800}
MANY = 10_000
EVIL = '<img src=x onerror="alert(1)"></script><script>alert(1)</script>'
SPAN = "svg rect[data-span]"

Page = Any
Open = Callable[..., Page]


@contextmanager
def chromium() -> Iterator[Any]:
    """Provide a browser; as root it can have no sandbox of its own."""
    options = ["--no-sandbox"] if os.geteuid() == 0 else []
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        try:
            yield browser
        finally:
            browser.close()


class Tab:
    """A page that one file after the other is opened in.

    `found` is what it has said or asked for: messages of the console, errors, and requests but for the file itself.
    """

    def __init__(self, browser: Any) -> None:
        self.page = page = browser.new_page()
        self.found: list[str] = []
        self._own = ""
        page.set_default_timeout(20_000)
        page.on("console", lambda message: self.found.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: self.found.append(f"error: {error}"))
        page.on("request", lambda asked: self.found.append(f"request: {asked.url}") if asked.url != self._own else None)

    def open(self, file: Path, viewport: dict[str, int] = DESK, color_scheme: str = "light") -> Page:
        """Open a file and wait until it is drawn."""
        self._own = file.as_uri()
        self.page.mouse.move(2, 2)
        self.page.set_viewport_size(viewport)
        self.page.emulate_media(media="screen", color_scheme=color_scheme)
        self.page.goto(self._own)
        self.page.wait_for_selector("body[data-ready]")
        return self.page


def settle(page: Page) -> None:
    """Wait until what was asked for is drawn."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(null))))")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One run; two, with the one and the other; a run beside its twin; a run of a large fleet; a hostile one."""
    folder = tmp_path_factory.mktemp("pages")
    scenario = "failure-recovery-chain"
    ledger, twin = (
        fsar_ledger.simulate(folder / name, scenario=scenario, runs=1, seed=7, workers=1).ledger
        for name in ("ledger", "twin")
    )
    ledger.view(folder / "one.html", "fsar.full")
    ledger.view(folder / "two.html", "fsar.full", "cfc.full")
    ledger.view(folder / "same.html", "fsar.full", other=twin)
    large = a_run("dhma", "fleet-contention", 48)
    assert len(large.events) >= MANY
    (folder / "large.html").write_bytes(page_of(shown(large)))
    evil = relabelled(a_run("fsar"), lambda text: text + EVIL)
    words = [one._replace(message=EVIL) for one in plain_words(evil)]
    (folder / "evil.html").write_bytes(page_of(shown(evil, words)))
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def tabs(browser: Any) -> list[Tab]:
    """The tabs that tests share."""
    return []


@pytest.fixture
def load(browser: Any, pages: Path, tabs: list[Tab]) -> Iterator[Open]:
    """Opens a page by its name, each of a test in a tab of its own; at the end none has said or asked for anything."""
    free = iter([*tabs])

    def call(name: str, **options: Any) -> Page:
        tab = next(free, None)
        if tab is None:
            tabs.append(tab := Tab(browser))
        return tab.open(pages / f"{name}.html", **options)

    yield call
    found = [one for tab in tabs for one in tab.found]
    for tab in tabs:
        tab.found.clear()
    assert found == []


@pytest.fixture
def one(load: Open) -> Page:
    return load("one")


@pytest.fixture
def two(load: Open) -> Page:
    return load("two")


def press(page: Page, *keys: str) -> None:
    for key in keys:
        page.keyboard.press(key)
    settle(page)


def title(page: Page) -> str:
    return str(page.inner_text("#event-title"))


def event(page: Page) -> int:
    """The number of the selected event."""
    found = re.match(r"Event (\d+)", title(page))
    assert found is not None, title(page)
    return int(found[1])


def cursor(page: Page) -> float:
    return float(page.inner_text("#moment-time").removesuffix(" s"))


def view(page: Page) -> list[str]:
    """The places of the marks on the axis, which change with what is in view."""
    places: list[str] = page.eval_on_selector_all(
        "#axis line.mark", "marks => marks.map(one => one.getAttribute('x1'))"
    )
    return places
