"""The page as a text: closed, small, the same each time, and safe whatever the ledger holds."""

import base64
import hashlib
import json
import re
from typing import Any

import pytest
from msgspec.structs import replace

from fsar_ledger.designs.constants import Constants
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.simulation import RunSpec, simulate_run
from fsar_ledger.view import Words, page, type_name
from tests.ledger.hostile import relabelled
from tests.view.conftest import ARCHITECTURES, a_run, plain_words, shown

MOST = 300_000
EVIL = "</script><script>alert(1)</script><!--<img src=x onerror=alert(1)>&amp;\u2028\u202e\x1b[2J"


def parts(text: str) -> tuple[str, str, str, str]:
    """Return policy, style, data and script of a page, which hold each other apart."""
    found = re.fullmatch(
        r'.*<meta http-equiv="Content-Security-Policy" content="([^"]*)">.*<style>([^<]*)</style>.*'
        r'<script type="application/json" id="data">([^<]*)</script>\n<script>(.*)</script>\n</body>\n</html>\n',
        text,
        flags=re.DOTALL,
    )
    assert found is not None
    return found[1], found[2], found[3], found[4]


def data_of(content: bytes) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(parts(content.decode())[2])
    return found


def test_the_page_admits_its_own_script_and_style_and_nothing_else(runs: dict[str, LedgerRun]) -> None:
    policy, style, _, script = parts(page(shown(runs["fsar"])).decode())
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules.keys() == {"default-src", "script-src", "style-src", "base-uri", "form-action"}
    assert {rules["default-src"], rules["base-uri"], rules["form-action"]} == {"'none'"}
    for rule, text in (("script-src", script), ("style-src", style)):
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules[rule] == f"'sha256-{digest}'"


def test_the_page_names_no_address(runs: dict[str, LedgerRun]) -> None:
    text = page(shown(runs["fsar"])).decode()
    assert set(re.findall(r"\w+://[^\"'` ]*", text)) == {"http://www.w3.org/2000/svg"}
    assert not re.search(
        r"\b(?:src|href)=|url\(\s*['\"]?(?!#)|@import|fetch\(|XMLHttp|WebSocket|innerHTML|eval\(", text
    )


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_hostile_text_stays_data(architecture: str, runs: dict[str, LedgerRun]) -> None:
    run = relabelled(runs[architecture], lambda text: text + EVIL)
    words = [Words(EVIL, EVIL, EVIL, EVIL, EVIL)] * len(run.events)
    found = data_of(page(shown(run, words)))
    assert found["runs"][0]["words"] == [[EVIL] * 5]
    assert found["runs"][0]["run"] == run.run_id


def test_the_same_run_gives_the_same_bytes(runs: dict[str, LedgerRun]) -> None:
    assert page(shown(runs["cfc"])) == page(shown(a_run("cfc")))


def test_the_data_is_the_whole_record(runs: dict[str, LedgerRun]) -> None:
    """Times, causes, types and lanes of every event can be read back."""
    for run in runs.values():
        (found,) = data_of(page(shown(run)))["runs"]
        time_us, times_us = 0, []
        for event in found["events"]:
            time_us += event[0]
            times_us.append(time_us)
        assert times_us == list(run.times_us)
        assert [event[1] for event in found["events"]] == list(run.caused_by)
        kinds = [found["types"][found["payloads"][event[2]][0]][0] for event in found["events"]]
        assert kinds == [type_name(event) for event in run.events]


def test_two_runs_carry_their_first_difference(runs: dict[str, LedgerRun]) -> None:
    one, same = shown(runs["fsar"]), shown(replace(runs["fsar"], run_id="another"))
    assert data_of(page(one))["first_difference"] is None
    assert data_of(page(one, same))["is_same"] is True
    apart = data_of(page(one, shown(runs["cfc"])))
    assert (apart["is_same"], apart["first_difference"] is None) == (False, False)


def test_no_run_of_the_default_experiment_takes_more_than_300_kb() -> None:
    """Each scenario under each architecture, as `simulate` plays them; words take the room that they take in `log`."""
    scenarios = ("door-relay", "collaborative-delivery", "failure-recovery-chain", "mixed-trust-inspection")
    for scenario in (*scenarios, "fleet-contention"):
        for architecture in ARCHITECTURES:
            run = simulate_run(RunSpec(42, architecture, "full", scenario, 4, 0), Constants())
            words = [one._replace(message="m" * 60, note=f"{seq}" * 10) for seq, one in enumerate(plain_words(run))]
            assert len(page(shown(run, words))) < MOST
