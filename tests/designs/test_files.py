"""Designs in files: those of the package, and every error with its line and field."""

import re
from pathlib import Path

import msgspec
import pytest

from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs import Fleet, Scenario, registered
from fsar_ledger.designs.constants import Constants
from fsar_ledger.designs.registered import MAX_BYTES, decoded, line_of, read_design
from fsar_ledger.runtime.own import with_own
from fsar_ledger.runtime.world.checks import problems_of_design, problems_of_fleet, problems_of_scenario

FLEET = """\
name = "ward"
bodies = ["porter"]

[[robots]]
name = "porter"
capabilities = ["navigate.indoor"]

[[robots]]
name = "door"
capabilities = [
    "door.open",  # a comment, with a ] and a "
    "door.lock",
]

[[capabilities]]
name = "navigate.indoor"

[[capabilities]]
name = "door.open"
lasts_s = [1, 2.5]

[[capabilities]]
name = "door.lock"
lasts_s = [1.0, 2.0]

[[off_shift]]
from_s = 5
to_s = 9.5
"""
SCENARIO = """\
name = "night"

[[tasks]]
owner = "porter"
steps = ["porter navigate.indoor", "porter door.open door"]
"""


def test_every_registered_fleet_scenario_and_workflow_is_well_made_and_named_as_its_file() -> None:
    for name in registered.fleets():
        assert registered.fleet(name).name == name
        assert [str(problem) for problem in problems_of_fleet(registered.fleet(name))] == []
    for name in registered.scenarios():
        assert [str(problem) for problem in problems_of_design(registered.scenario(name), registered.fleet())] == []
    for name in registered.workflows():
        assert [str(problem) for problem in problems_of_design(registered.workflow(name), registered.fleet())] == []
    assert [registered.scenario(name).name for name in registered.scenarios()] == list(registered.scenarios())
    assert [registered.workflow(name).name for name in registered.workflows()] == list(registered.workflows())
    assert registered.scenarios()[:5] == registered.PAPER_SCENARIOS
    assert registered.workflows()[:3] == registered.PAPER_WORKFLOWS


@pytest.mark.parametrize(
    ("field", "line"),
    [
        (("name",), 1),
        (("bodies", 0), 2),
        (("robots", 0, "name"), 5),
        (("robots", 1), 8),
        (("robots", 1, "capabilities"), 10),
        (("robots", 1, "capabilities", 0), 11),
        (("robots", 1, "capabilities", 1), 12),
        (("robots", 1, "role"), 8),  # it is not written: its table
        (("capabilities", 1, "lasts_s", 1), 20),
        (("off_shift", 0, "to_s"), 28),
    ],
)
def test_the_line_of_a_field_is_found_in_the_text(field: tuple[str | int, ...], line: int) -> None:
    assert line_of(FLEET, field) == line


def test_the_line_of_a_field_is_found_in_tables_inside_a_list_and_under_dotted_keys() -> None:
    text = 'robots = [\n    { name = "a", capabilities = [] },\n    { name = "b", role = "c" },\n]\n'
    assert line_of(text, ("robots", 1, "role")) == 3
    assert line_of('[a]\nb.c = 1\nb.d = 2\n"e" = 3\n', ("a", "b", "d")) == 3
    assert line_of('[a]\nb.c = 1\nb.d = 2\n"e" = 3\n', ("a", "e")) == 4


@pytest.mark.parametrize(
    ("now", "then", "message"),
    [
        ('name = "ward"', 'name = "ward', "my.toml:1: "),
        (
            'bodies = ["porter"]',
            'boddies = ["porter"]',
            "my.toml:2: boddies: found an unknown field, expected one of name, robots, capabilities, bodies, "
            "substitutes, trust, trust_by_record, policies, density, budgets, off_shift; did you mean bodies?",
        ),
        ('bodies = ["porter"]', 'bodies = "porter"', 'my.toml:2: bodies: found "porter", expected a list in [ ]'),
        ('"door.lock",\n]', "7,\n]", "my.toml:12: robots[1].capabilities[1]: found 7, expected text in quotes"),
        ('name = "door"\n', "", "my.toml:8: robots[1].name: found nothing, expected a value"),
        (
            "to_s = 9.5",
            'to_s = 9.5\n[[budgets]]\nlevel = "locl"\ntime_s = 5\nattempts = 1',
            "my.toml:30: budgets[0].level: found locl, expected one of local, peer, fleet, human; did you mean local?",
        ),
        (
            "to_s = 9.5",
            "to_s = 9.5\n[[density]]\nreview_evry = 2",
            "my.toml:30: density[0].review_evry: found an unknown field, expected one of review_every, role; did you",
        ),
        (
            "lasts_s = [1, 2.5]",
            'lasts_s = [1, 2.5]\nvisibility = "domains"',
            "my.toml:21: capabilities[1].visibility: found domains, expected one of global, domain, trust-gated; did",
        ),
        (
            "[[off_shift]]",
            "[off_shift]",
            "my.toml:26: off_shift: found one table [off_shift], expected [[off_shift]] be",
        ),
        ("to_s = 9.5", "[off_shift]", "my.toml:28: found [off_shift] again, expected [[off_shift]] before each of its"),
        ("to_s = 9.5", "[trust_by_record]\n" * 2, "my.toml:29: found [trust_by_record] again, expected it once"),
        (
            "to_s = 9.5",
            '[[trust]]\nscope = ""',
            'my.toml:29: trust[0].scope: found "", expected one of none, capability',
        ),
        ("from_s = 5", "[of_shift]", "my.toml:27: of_shift: found an unknown field"),
        ("from_s = 5", "from_s = true", "my.toml:27: off_shift[0].from_s: found true, expected a number"),
        ("from_s = 5", 'from_s = "5"', 'my.toml:27: off_shift[0].from_s: found "5", expected a number'),
        (
            "lasts_s = [1, 2.5]",
            "lasts_s = [1]",
            "my.toml:20: capabilities[1].lasts_s: found [1], expected a list of length 2",
        ),
        (
            "lasts_s = [1, 2.5]",
            "lasts_s = [1, 2.5]\nvisible_to = []",
            "my.toml:21: capabilities[1].visible_to: found an empty list, expected some roles, or no such",
        ),
        (
            "to_s = 9.5",
            "to_s = 9.5\nrobots = []",
            "my.toml:29: off_shift[0].robots: found an empty list, expected some robots, or no such field, for all",
        ),
    ],
)
def test_a_file_that_is_no_fleet_is_refused_with_its_line_and_field(now: str, then: str, message: str) -> None:
    assert FLEET.count(now) == 1
    with pytest.raises(UsageError) as refused:
        decoded(FLEET.replace(now, then), Fleet, "my.toml")
    assert str(refused.value).startswith(message), str(refused.value)


@pytest.mark.parametrize("sign", ["", "-"])
@pytest.mark.parametrize("digits", ["1" * 5_000, "1_" * 5_000 + "1", "0x" + "f" * 5_000], ids=lambda one: one[:3])
def test_a_number_of_thousands_of_digits_is_refused_with_its_line(digits: str, sign: str) -> None:
    number = digits if digits.startswith("0x") else f"{sign}{digits}"  # TOML has no sign before other bases
    for now, line in (("from_s = 5", 27), ('"door.lock",\n]', 12), ("lasts_s = [1, 2.5]", 20)):
        then = f"{now.partition('=')[0]}= {number}" if "=" in now else f"{number},\n]"
        with pytest.raises((UsageError, ValueError), match="digits") as refused:
            decoded(FLEET.replace(now, then), Fleet, "my.toml")
        assert isinstance(refused.value, UsageError)
        assert re.match(rf"my\.toml:{line}: .*thousands of digits, expected", str(refused.value))


@pytest.mark.parametrize(
    ("now", "then", "found"),
    [
        ('"ward"', '"The Ward"', "name: found The Ward, expected a name of lowercase letters"),
        (
            'bodies = ["porter"]',
            'bodies = ["porters"]',
            "bodies[0]: found porters, expected one of the roles of the fleet (porter, door); did you mean porter?",
        ),
        ('name = "porter"', 'name = "porter "', 'robots[0].name: found "porter ", expected letters, digits, - and _,'),
        (
            'bodies = ["porter"]',
            'bodies = [""]',
            'bodies[0]: found "", expected one of the roles of the fleet (porter,',
        ),
        ('name = "porter"', 'name = "porter1"', "robots[0].name: found porter1, expected letters, digits, - and _,"),
        (
            'name = "door"\n',
            'name = "porter"\n',
            "robots[1].name: found another robot of this name: porter, expected each once",
        ),
        ('"door.lock",\n]', '"door.look",\n]', "robots[1].capabilities[1]: found door.look, expected one of the"),
        ("lasts_s = [1, 2.5]", "lasts_s = [3, 2.5]", "capabilities[1].lasts_s: found 3 to 2.5, expected two"),
        ("lasts_s = [1, 2.5]\n", "", "capabilities[1].lasts_s: found nothing, expected how long it takes"),
        ("to_s = 9.5", "to_s = 5", "off_shift[0].to_s: found 5, expected more than from_s"),
        ("from_s = 5", "from_s = -5", "off_shift[0].from_s: found -5, expected seconds from 0"),
        ("to_s = 9.5", 'robots = ["lift"]', "off_shift[0].robots[0]: found lift, expected one of the robots that"),
        (
            "to_s = 9.5",
            'to_s = 9.5\n[[trust]]\nrole = "door"\npeer_role = "porter"\nscope = "task"\n'
            '[[trust]]\nrole = "porter"\npeer_role = "door"\nscope = "task"\nis_mutual = true',
            "trust[1].role: found trust of door in porter a second time, expected one entry for each pair",
        ),
        (
            "to_s = 9.5",
            '[[policies]]\nrole = "doors"\noutcome = "deny"',
            "policies[0].role: found doors, expected one of the roles",
        ),
        (
            "to_s = 9.5",
            '[[policies]]\nrole = "door"\noutcome = "deny"\n[[policies]]\nrole = "door"\noutcome = "allow"',
            "policies[1]: found a second local rule of door for every capability, expected each once in a domain",
        ),
        ('name = "door"\n', 'name = "door"\ndomain = "/a"\n', "robots[1].domain: found /a, expected a path of names"),
        (
            "to_s = 9.5",
            '[[policies]]\nrole = "door"\noutcome = "deny"\ndomain = "ward"',
            "policies[0].domain: found ward, expected one of the domains of the fleet's robots, or one around them (",
        ),
        (
            "to_s = 9.5",
            '[[trust]]\nrole = "door"\npeer_role = "porter"\nscope = "task"\ndomain = "ward"',
            "trust[0].domain: found ward, expected one of the domains",
        ),
        (
            "to_s = 9.5",
            '[[density]]\nrole = "dor"\nreview_every = 1',
            "density[0].role: found dor, expected one of the",
        ),
        (
            "to_s = 9.5",
            "[[density]]\nreview_every = -1",
            "density[0].review_every: found -1, expected one admission in",
        ),
        (
            "to_s = 9.5",
            "[[density]]\nreview_every = 1\n[[density]]\nreview_every = 2",
            "density[1]: found a second density of every role, expected each once",
        ),
        (
            "to_s = 9.5",
            '[[budgets]]\nlevel = "human"\ntime_s = 0.5\nattempts = 1',
            "budgets[0].time_s: found 0.5, expected seconds from 1 to 1800 at level human",
        ),
        (
            "to_s = 9.5",
            '[[budgets]]\nlevel = "peer"\ntime_s = inf\nattempts = 1',
            "budgets[0].time_s: found inf, expected seconds from 0 to 1800 at level peer",
        ),
        (
            "to_s = 9.5",
            '[[budgets]]\nlevel = "human"\ntime_s = 5\nattempts = 0',
            "budgets[0].attempts: found 0, expected at least 1 at level human",
        ),
        (
            "to_s = 9.5",
            '[[budgets]]\nlevel = "peer"\ntime_s = 5\nattempts = 0\nrole = "lift"',
            "budgets[0].role: found lift, expected one of the roles",
        ),
        (
            "to_s = 9.5",
            '[[budgets]]\nlevel = "peer"\ntime_s = 5\nattempts = 0\n' * 2,
            "budgets[1]: found a second budget of every role at level peer, expected each once",
        ),
        (
            "to_s = 9.5",
            '[[substitutes]]\nof = "door.lok"\nby = "door.open"',
            "substitutes[0].of: found door.lok, expected one of the capabilities",
        ),
    ],
)
def test_a_fleet_that_cannot_be_is_said_to_be_wrong_in_the_field_that_is(now: str, then: str, found: str) -> None:
    assert FLEET.count(now) == 1
    problems = list(problems_of_fleet(decoded(FLEET.replace(now, then), Fleet, "my.toml")))
    assert problems
    assert str(problems[0]).startswith(found), str(problems[0])


@pytest.mark.parametrize(
    ("now", "then", "found"),
    [
        ('"night"', '"workflow-night"', "name: found workflow-night, expected a name that does not begin"),
        (
            'owner = "porter"',
            'owner = "portr"',
            "tasks[0].owner: found portr, expected one of the robots of fleet ward (porter, door); did you mean",
        ),
        ("porter navigate.indoor", "porter", "tasks[0].steps[0]: found porter, expected ROBOT CAPABILITY"),
        (
            "porter navigate.indoor",
            "porter navigate.outdoor",
            "tasks[0].steps[0]: found navigate.outdoor, expected one of the capabilities",
        ),
        (
            "porter navigate.indoor",
            "porter door.open",
            "tasks[0].steps[0]: found door.open, which porter cannot do, "
            "expected a capability of porter's own: navigate.indoor, or porter door.open door to delegate it",
        ),
        (
            "porter door.open door",
            "door navigate.indoor door",
            "tasks[0].steps[1]: found navigate.indoor, which door cannot do",
        ),
        ("porter door.open door", "door door.open door", "tasks[0].steps[1]: found door as its own target"),
        (
            'owner = "porter"',
            'owner = "porter"\ncheckpoints = ["3"]',
            "tasks[0].checkpoints[0]: found 3, expected one of the numbers of its steps (1, 2)",
        ),
        ('owner = "porter"', 'owner = "porter"\noffset_s = inf', "tasks[0].offset_s: found inf, expected seconds"),
        ('name = "night"', 'name = "night"\ndegradable = ["lift"]', "degradable[0]: found lift, expected one of the"),
        (
            'door"]\n',
            'door"]\n[[injections]]\nrequester = "porter"\ntarget = "door"\ncapability = "door.open"\ntimes = 0',
            "injections[0].times: found 0, expected 1 to 1,000",
        ),
        (
            'door"]\n',
            'door"]\n[[injections]]\nrequester = "door"\ntarget = "door"\ncapability = "door.open"',
            "injections[0].requester: found door, whom door trusts",
        ),
    ],
)
def test_a_scenario_that_cannot_happen_to_the_fleet_is_wrong_in_the_field_that_is(
    now: str, then: str, found: str
) -> None:
    assert SCENARIO.count(now) == 1
    fleet = decoded(FLEET, Fleet, "fleet.toml")
    problems = list(problems_of_scenario(decoded(SCENARIO.replace(now, then), Scenario, "my.toml"), fleet))
    assert problems
    assert str(problems[0]).startswith(found), str(problems[0])


def test_a_well_made_fleet_and_scenario_have_nothing_wrong() -> None:
    fleet = decoded(FLEET, Fleet, "fleet.toml")
    assert list(problems_of_fleet(fleet)) == []
    assert list(problems_of_scenario(decoded(SCENARIO, Scenario, "my.toml"), fleet)) == []
    assert msgspec.json.decode(msgspec.json.encode(fleet), type=Fleet) == fleet


def test_a_file_that_cannot_be_read_is_refused_with_what_was_found(tmp_path: Path) -> None:
    (tmp_path / "bytes.toml").write_bytes(b'name = "a"\n# \xff\n')
    (tmp_path / "long.toml").write_text("#" * (MAX_BYTES + 1))
    (tmp_path / "deep.toml").write_text("a = " + "[" * 10_000)
    (tmp_path / "folder.toml").mkdir()
    for name, found in (
        ("bytes.toml", "bytes.toml:2: found bytes that are not UTF-8"),
        ("long.toml", "found 40,001 bytes, expected a fleet in at most 40,000"),
        ("deep.toml", "deep.toml"),
        ("folder.toml", "Is a directory, expected a TOML file with a fleet"),
        ("none.toml", "No such file or directory, expected a TOML file with a fleet"),
    ):
        with pytest.raises(UsageError) as refused:
            read_design(tmp_path / name, Fleet)
        assert found in str(refused.value)


def test_a_scenario_that_gives_a_constant_two_values_is_refused_with_both(tmp_path: Path) -> None:
    path, name = tmp_path / "my.toml", "outages.off_rate_per_s"
    path.write_text(f'settings = [\n    "{name}=0.002",\n    "{name}=0.5",\n]\n{SCENARIO.lstrip()}')
    found = f"settings[1]: found {name}=0.5 beside {name}=0.002, expected one value for each name"
    fleet = tmp_path / "fleet.toml"
    fleet.write_text(FLEET)
    for settings in ((), (f"{name}=1",)):
        with pytest.raises(UsageError) as refused:
            with_own(Constants(), [str(path)], str(fleet), settings)
        assert found in str(refused.value)


def test_the_settings_of_a_scenario_are_judged_together(tmp_path: Path) -> None:
    path, fleet = tmp_path / "my.toml", tmp_path / "fleet.toml"
    fleet.write_text(FLEET)
    for low, high, is_range in ((0.7, 0.9, True), (0.7, 0.6, False)):
        path.write_text(f'settings = ["world.message.low_s={low}", "world.message.high_s={high}"]\n{SCENARIO.lstrip()}')
        if is_range:
            assert with_own(Constants(), [str(path)], str(fleet))[0].world.message.high_s == high
            continue
        with pytest.raises(UsageError, match=r"my\.toml:1: settings: --set: found world\.message from 0\.7 to 0\.6 s"):
            with_own(Constants(), [str(path)], str(fleet))
