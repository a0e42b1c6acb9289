"""The console: a person sees what a call is about and answers it; and the demo goes on whichever process is killed."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

import fsar_ledger
from fsar_ledger.events.supervision import SupervisionDensitySet, SupervisorResponded
from fsar_ledger.service.demo import HUB, HUMAN, OWN, STORIES, TASKS, Demo, play
from fsar_ledger.service.pages import FILES, page_file
from tests.service.site import TASK, Site, is_good, take_back, until

pytestmark = pytest.mark.slow
EVIL = "<img src=x onerror=alert(1)>"


@pytest.fixture
def asked(site: Site) -> Site:
    """A site at which a request waits for a review by the fleet's supervisor."""
    site.ways[HUMAN].give("SetSupervisionDensity", issued_by=HUMAN, robot="robot/B1", review_every=1, reason="test")
    site.ways["service/hub"].give("SubmitTask", task_id="t", **TASK)
    site.ways["robot/B1"].give("JudgeRequest", robot="robot/B1", action_id="t/1.1", accepts=True)
    return site


def overview(site: Site, name: str) -> Any:
    return msgspec.json.decode(site.asked("GET", "/overview", b"", name).partition(b"\r\n\r\n")[2])


def test_a_call_says_what_it_is_about_under_which_rule_and_what_happens_if_nobody_answers(asked: Site) -> None:
    [call] = overview(asked, HUMAN)["calls"]
    assert call["title"] == "May robot/B1 do door.open.secure for robot/A1?"
    assert call["why"] == "One in 1 admissions by robot/B1 is reviewed"
    assert call["known"] == ["Task t of robot/A1, step 1 of 1.", "robot/B1 trusts robot/A1: task."]
    assert call["otherwise"].endswith("until task t is given up.")
    assert [one["label"] for one in call["replies"]] == ["Approve", "Refuse"]
    assert overview(asked, "supervisor/A1")["calls"] == []
    assert len(overview(asked, "auditor/anna")["calls"]) == 1
    assert asked.asked("GET", "/overview", b"", "robot/A1").startswith(b"HTTP/1.1 403 ")
    assert asked.asked("GET", "/overview", b"", None).startswith(b"HTTP/1.1 401 ")
    asked.ways[HUMAN].give("RespondToCall", supervisor=HUMAN, action_id="t/1.1", approves=True)
    assert overview(asked, HUMAN)["calls"] == []


def test_each_rule_that_asks_for_a_review_is_told(site: Site) -> None:
    rule = {"issued_by": HUMAN, "scope": "fleet", "robot": "robot/B1", "capability": None, "context": None}
    site.ways[HUMAN].give("SetPolicyRule", outcome="review", **rule)
    b = site.ways["robot/B1"]
    b.give("ReportWindow", robot="robot/B1", scope="local", window="night", outcome="review")
    site.ways["service/hub"].give("SubmitTask", task_id="t", **TASK)
    b.give("JudgeRequest", robot="robot/B1", action_id="t/1.1", accepts=True)
    [call] = overview(site, HUMAN)["calls"]
    assert call["why"] == (
        "A fleet rule asks for a review of everything at robot/B1; The local window night asks for a review at robot/B1"
    )


def test_a_robot_that_is_away_is_shown_as_such_with_how(asked: Site) -> None:
    asked.ways["robot/B1"].give("ReportPresence", robot="robot/B1", is_on=False)
    [call] = overview(asked, HUMAN)["calls"]
    assert call["known"][-1] == "robot/B1 is away: off."
    asked.ways["robot/C1"].give("LeaveFleet", robot="robot/C1")
    shown = {one["robot"]: (one["is_away"], one["does"]) for one in overview(asked, HUMAN)["robots"]}
    assert shown["robot/A1"] == (False, None)
    assert shown["robot/B1"] == (True, "off")
    assert shown["robot/C1"] == (True, "left the fleet (announced)")


def test_the_page_is_closed_to_what_comes_from_elsewhere(site: Site) -> None:
    for path, (name, _) in FILES.items():
        head, _, body = site.asked("GET", path, b"", None).partition(b"\r\n\r\n")
        assert b"default-src 'none'" in head
        assert body == page_file(name)
        assert b"innerHTML" not in body
        assert b"http://" not in body
        assert b"https://" not in body


def test_the_run_is_drawn_once_for_who_may_see_it(asked: Site) -> None:
    drawn = asked.asked("POST", "/view", b"", HUMAN)
    place = msgspec.json.decode(drawn.partition(b"\r\n\r\n")[2])["page"]
    assert b"SupervisorCalled" in asked.asked("GET", f"/{place}", b"", None)
    assert asked.asked("GET", f"/{place}", b"", None).startswith(b"HTTP/1.1 404 ")
    assert asked.asked("POST", "/view", b"", "robot/A1").startswith(b"HTTP/1.1 403 ")


@pytest.fixture
def browser() -> Iterator[Any]:
    from tests.view.browser import chromium  # which is not there without the extra

    with chromium() as found:
        yield found


def signed_in(browser: Any, site: Site, name: str = HUMAN, **viewport: int) -> tuple[Any, list[str]]:
    page = browser.new_page(viewport={"width": 1280, "height": 900} | viewport)
    found: list[str] = []
    page.set_default_timeout(20_000)
    page.on("console", lambda message: found.append(message.text))
    page.on("pageerror", lambda error: found.append(f"{error}"))
    page.goto(f"http://localhost:{site.port}/console")
    page.fill("#token", site.tokens[name])
    page.keyboard.press("Enter")
    page.wait_for_selector("#robots tr")
    return page, found


@pytest.mark.parametrize(("answer", "approves"), [("Approve", True), ("Refuse", False)])
def test_a_person_answers_by_the_keyboard(asked: Site, browser: Any, answer: str, approves: bool) -> None:
    page, found = signed_in(browser, asked)
    page.focus(f"text={answer}")
    page.keyboard.press("Enter")
    page.wait_for_selector("#none:visible")
    [responded] = [event for event in asked.record.events if isinstance(event, SupervisorResponded)]
    assert responded.approves is approves
    assert "on record as event" in page.inner_text("#said")
    page.wait_for_selector("#events >> text=supervisor responded")
    assert found == []


def test_a_person_governs_and_hostile_names_are_text(asked: Site, browser: Any) -> None:
    asked.ways["service/hub"].give("SubmitTask", task_id=f"{EVIL}", **TASK)
    page, found = signed_in(browser, asked)
    page.select_option("#command", "SetSupervisionDensity")
    page.fill("#field-robot", "robot/A1")
    page.fill("#field-review_every", "3")
    page.click("#govern button")
    page.wait_for_selector("#said >> text=on record as event")
    *_, density = [event for event in asked.record.events if isinstance(event, SupervisionDensitySet)]
    assert (density.robot, density.review_every, density.decided_by) == ("robot/A1", 3, HUMAN)
    page.fill("#field-robot", "robot/X9")
    page.click("#govern button")
    page.wait_for_selector("#said >> text=was rejected: unknown robot robot/X9")
    assert page.locator("img").count() == 0
    assert EVIL in page.inner_text("#events")
    assert found == []


def test_the_drawn_run_goes_on_as_the_run_does(asked: Site, browser: Any) -> None:
    page, found = signed_in(browser, asked)
    with page.expect_popup() as opened:
        page.click("#view")
    picture = opened.value
    picture.wait_for_selector("body[data-ready]")
    before = picture.inner_text("#facts")
    picture.keyboard.press("ArrowRight")
    chosen = picture.wait_for_selector("#event-title:text-matches('[0-9]')").inner_text()
    asked.ways[HUMAN].give("RespondToCall", supervisor=HUMAN, action_id="t/1.1", approves=True)
    count = len(asked.record.events)
    picture.wait_for_selector(f"#facts:has-text('{count} events')")
    assert f"{count} events" not in before
    assert picture.inner_text("#event-title") == chosen
    picture.evaluate("window.opener.postMessage('drawn', '*', [new MessageChannel().port2])")  # a second line is none
    asked.ways[HUMAN].give("SetSupervisionDensity", issued_by=HUMAN, robot="robot/B1", review_every=2, reason="test")
    picture.wait_for_selector(f"#facts:has-text('{len(asked.record.events)} events')")
    assert found == []


@pytest.mark.parametrize("width", [1280, 400])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everybody_can_use_it(asked: Site, browser: Any, width: int, scheme: str) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    page, _ = signed_in(browser, asked, width=width)
    page.emulate_media(color_scheme=scheme)
    page.wait_for_selector(".call")
    assert axe.Axe().run(page).response["violations"] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_a_token_of_nobody_is_told(site: Site, browser: Any) -> None:
    page = browser.new_page()
    page.goto(f"http://localhost:{site.port}/console")
    page.fill("#token", "fsar.0.0")
    page.click("#enter button")
    page.wait_for_selector("text=No principal has this token.")


@pytest.mark.parametrize(("name", "governs"), [("auditor/anna", False), ("service/hub", True)])
def test_who_cannot_answer_is_shown_who_is_asked_and_no_button(
    asked: Site, browser: Any, name: str, governs: bool
) -> None:
    page, found = signed_in(browser, asked, name)
    page.wait_for_selector(f".replies:has-text('Asked of {HUMAN}, who alone can answer.')")
    assert page.locator(".replies button").count() == 0
    assert page.is_visible("#govern button") is governs
    assert found == []


def test_a_token_that_is_taken_back_is_told_and_not_tried_again(asked: Site, browser: Any) -> None:
    page, _ = signed_in(browser, asked)
    page.wait_for_selector("#line:text-is('connected')")
    take_back(asked, HUMAN)
    page.wait_for_selector("#line:text-is('not connected: no principal has this token any more')")


def test_it_connects_again_after_the_service_was_away(tmp_path: Path, browser: Any) -> None:
    with Demo(tmp_path / "ledger", by_hand=True, step_s=0.1) as demo:
        page = browser.new_page()
        page.goto(f"{demo.url}/console")
        page.fill("#token", demo.tokens[HUMAN])
        page.keyboard.press("Enter")
        page.wait_for_selector("#line:has-text('connected')")
        demo.processes["service"].send_signal(signal.SIGKILL)
        page.wait_for_selector("#line:has-text('trying again')", timeout=20_000)
        page.wait_for_selector("#line:text-is('connected')", timeout=30_000)


def test_the_demo_goes_on_as_each_process_is_killed_in_turn(tmp_path: Path) -> None:
    names, ended = ("service", *STORIES, HUMAN, OWN), list[str]()
    with Demo(tmp_path / "ledger", by_hand=False, step_s=0.1) as demo, demo.client(HUB) as hub:
        ended += play(hub, 0, 60)
        for number in range(1, len(TASKS)):
            for name in names[number - 1 :: len(TASKS) - 1]:  # it is away as the story begins
                demo.processes[name].send_signal(signal.SIGKILL)
            ended += play(hub, number, 60)
    assert set(ended) == {"completed"}
    assert is_good(tmp_path / "ledger")
    assert not [row for row in fsar_ledger.Ledger(tmp_path / "ledger").audit().rows if row.holds is False]


def test_the_command_plays_its_stories(tmp_path: Path) -> None:
    command = (sys.executable, "-m", "fsar_ledger", "demo", f"{tmp_path}/ledger", "--step", "0.05")
    began = time.monotonic()
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert said[0].startswith("console: http://127.0.0.1:")
    assert [line.partition(": ")[2] for line in said[2:-1]] == [
        "completed",
        "completed",
        "completed, completed",
        "completed",
        "completed",
        "completed",
    ]
    assert time.monotonic() - began < 60
    assert is_good(tmp_path / "ledger")
    again = subprocess.run(command, capture_output=True, text=True)
    assert (again.returncode, "expected a new folder" in again.stderr) == (2, True)


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("words", [0, 1])
def test_a_demo_that_is_ended_leaves_no_process_behind(tmp_path: Path, how: signal.Signals, words: int) -> None:
    """Ended as it starts, or once it has told its address."""
    ledger = tmp_path / "ledger"
    demo = subprocess.Popen(
        (sys.executable, "-m", "fsar_ledger", "demo", f"{ledger}"), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert demo.stdout is not None
    if words:
        assert demo.stdout.readline().startswith(b"console: ")
    else:
        until((ledger / "ledger.json").exists)
    demo.send_signal(how)
    told = demo.communicate(timeout=30)[1]
    assert (demo.returncode, told.count(b"\n")) == (130, 1)
    assert b"a new demo needs a new folder" in told
    with fsar_ledger.federate(ledger, run="live"):  # which refuses while a service governs the run
        pass


def test_a_robot_that_died_in_the_middle_of_an_execution_ends_it(tmp_path: Path) -> None:
    with Demo(tmp_path / "ledger", by_hand=False, step_s=1) as demo, demo.client(HUB) as hub:
        ended: list[str] = []
        story = threading.Thread(target=lambda: ended.extend(play(hub, 0, 60)), daemon=True)
        story.start()
        with demo.client(HUB) as other:
            next(event for event in other.events(after=-1) if event.type == "ExecutionStarted")
        demo.processes["robot/A1"].send_signal(signal.SIGKILL)
        story.join(40)
        assert ended == ["completed"]
