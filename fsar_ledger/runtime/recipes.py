"""Recipes: the inputs of a run, which are its parameters and the changes of a fork, and how event 0 records them.

The recipe of a fork is enough to rebuild its base, so replay needs no other ledger to check how far the fork repeats
it.
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import combinations

import msgspec

from fsar_ledger.base import printable
from fsar_ledger.base.errors import InvalidExperiment, UsageError
from fsar_ledger.base.parameters import BadParameters
from fsar_ledger.base.printable import NAMED, list_few
from fsar_ledger.designs.constants import Constants, read_constants
from fsar_ledger.events.configuration import EVERY_MECHANISM, FULL, removed_mechanisms, without
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.runs import LedgerRun
from fsar_ledger.metrics.constant_names import constants_of, names_of_constants, unlike_ours

from .change_texts import COMMAND, parsed
from .changes import NOW, Answer, AnyChange, Architecture, Changes, Rules, Set, Without, microseconds_of
from .experiment import Experiment
from .live import ARCHITECTURE, SOURCE, LiveRecord, live_record, live_started
from .own import with_sets, with_values
from .simulation import MODEL_VERSION, RunSpec, run_id, run_started
from .world.schedule import arrivals_expected

NOTHING = "nothing"
"""The removed mechanisms of a full architecture."""
ABSENT = "absent"
"""The value of a constant whose group the base does not have."""
LATER = ("world", "outages", "membership")
_WATCH = ("membership.heartbeat_us", "membership.suspect_us", "membership.depart_us")
FROM_THE_START = ("world.floor_teams", "outages.answer_s", *_WATCH)
"""Constants of the world that the founding of the fleet depends on."""

FACTS_PER_ROBOT = 1_000
"""The most facts of the world that recorded rates may make, for each robot, in addition to the number of events.

The model's rates make 37 to 373. Recorded rates may come from an adversary: a record of a few events cannot come from
a world of a billion facts, which is not simulated to find that out.
"""
_MAKERS = {"1": "fsar-ledger 0.2.0", "2": "fsar-ledger 0.9.0"}
"""The last release that simulates an earlier model version, by version."""
_ROOT = re.compile(r"[0-9a-f]{64}")


class Recipe(msgspec.Struct, frozen=True):
    """The inputs of a run. Changes from the start are already in `spec` and `constants`.

    `live`: the record of a live run; `spec` names the draws that replace missing answers then. `rules`: what the
    changes mean, which earlier releases read otherwise.
    """

    spec: RunSpec
    constants: Constants
    changes: Changes = ()
    live: LiveRecord | None = None
    rules: Rules = NOW


class CannotReplay(Exception):
    """Raised for a run that this version cannot rebuild: the field of event 0, the expected and the found value."""

    def __init__(self, field: str | None, expected: str, actual: str) -> None:
        super().__init__(f"{field + ': ' if field else ''}found {actual}, expected {expected}")
        self.field, self.expected, self.actual = field, expected, actual


def with_changes(base: Recipe, changes: Changes) -> Recipe:
    """Return the recipe of the base with these changes, each with the value before it.

    Raises:
        UsageError: There is no such constant, architecture or mechanism, or a change from the start has no effect.
    """
    _require_once(changes)
    spec, whole = base.spec, list[AnyChange]()
    for change in changes:
        if base.live is not None:
            _require_live(change)
        match change:
            case Set():
                whole.append(_with_before(base.constants, change))
            case Architecture():
                whole.append(msgspec.structs.replace(change, before=_differs(change, base.spec.architecture)))
                spec = msgspec.structs.replace(spec, architecture=change.architecture)
            case Without():
                lacking = (
                    "+".join(name for name in EVERY_MECHANISM if name in removed_mechanisms(base.spec.configuration))
                    or NOTHING
                )
                whole.append(msgspec.structs.replace(change, before=_differs(change, lacking)))
                spec = msgspec.structs.replace(spec, configuration=_configuration(change.mechanisms))
            case _:
                whole.append(change)
    constants = with_sets(base.constants, [change for change in changes if isinstance(change, Set)])
    return Recipe(spec, constants, tuple(whole), base.live)


def _require_live(change: AnyChange) -> None:
    """Check that the change means something in a live run. Raises: UsageError."""
    if isinstance(change, Architecture | Without):
        raise UsageError(f"change {change}: found a live run, whose robots speak for themselves under FSAR in full")
    if isinstance(change, Set) and change.from_s is not None:
        raise UsageError(
            f"change {change}: found a live run, whose world no constant makes; expected a constant from the start"
        )


def base_of(recipe: Recipe) -> Recipe:
    """Return the recipe of the run that a fork is based on."""
    spec = recipe.spec
    values: dict[str, float | int | None] = {}
    absent: dict[str, None] = {}
    for change in recipe.changes:
        match change:
            case Set(before=str(before)) if change.from_s is None:
                if before == ABSENT:
                    absent[change.constant.partition(".")[0]] = None
                else:
                    values[change.constant] = msgspec.json.decode(before)
            case Architecture(before=str(before)):
                spec = msgspec.structs.replace(spec, architecture=before)
            case Without(before=str(before)):
                spec = msgspec.structs.replace(spec, configuration=_configuration(before))
            case _:
                pass
    constants = with_values(recipe.constants, values)
    return Recipe(spec, msgspec.structs.replace(constants, **absent))


def _configuration(mechanisms: str) -> str:
    names = [] if mechanisms == NOTHING else mechanisms.split("+")
    for name in names:
        if name not in EVERY_MECHANISM:
            hint = printable.did_you_mean(name, EVERY_MECHANISM) or ";"
            raise UsageError(f"without {printable.value(mechanisms)}: there is no such mechanism{hint} see simulate -h")
    return without(names)


def _with_before(constants: Constants, change: Set) -> Set:
    """Return the change of a constant with its value in the base. Raises: UsageError."""
    name = change.constant
    if name not in names_of_constants():
        hint = printable.did_you_mean(name, names_of_constants()) or "; `fsar-ledger info LEDGER --json` prints all"
        raise UsageError(f"change {change}: unknown constant {printable.value(name)}{hint}")
    group = name.partition(".")[0]
    if change.from_s is not None and (group not in LATER or name in FROM_THE_START):
        raise UsageError(
            f"change {change}: found a time for {name}, expected none: a fleet is built with it, so it holds from the "
            "start"
        )
    text = msgspec.json.encode(msgspec.to_builtins(constants)).decode()
    values = {constant["name"]: constant["value"] for constant in constants_of(text) or ()}
    before = values.get(name, "null" if getattr(constants, group) is not None else ABSENT)
    if change.from_s is None and before not in (ABSENT, "null") and msgspec.json.decode(before) == change.value:
        raise UsageError(f"change {change}: {name} is {before} already, expected another value")
    return msgspec.structs.replace(change, before=before)


def _differs(change: Architecture | Without, before: str) -> str:
    after = change.architecture if isinstance(change, Architecture) else change.mechanisms
    if after == before:
        raise UsageError(f"change {change}: the run has that already, expected another one")
    return before


def _require_once(changes: Sequence[AnyChange]) -> None:
    """Check that nothing is changed twice from the start, or answered twice. Raises: UsageError."""
    seen: set[str] = set()
    for change in changes:
        match change:
            case Set(from_s=None):
                name = change.constant
            case Architecture() | Without():
                name = type(change).__name__.lower()
            case Answer():  # of a command, only one field
                field = change.answer.partition("=")[0] if change.question.startswith(COMMAND) else ""
                name = f"{change.question} {field}".rstrip()
            case _:
                continue
        if name in seen:
            raise UsageError(f"change {change}: {name} is changed twice, expected one change of it")
        seen.add(name)


def started_of(recipe: Recipe, origin: RunStarted | None = None) -> RunStarted:
    """Return event 0 of the recipe's run, a fork with the origin in `origin`, or no fork (None)."""
    plain = run_started(recipe.spec, recipe.constants)
    if recipe.live is not None:
        plain = live_started(recipe.constants, recipe.spec.fleet_size, recipe.live.started.epoch)
    if origin is None or origin.changes is None:
        return plain
    return msgspec.structs.replace(
        plain,
        forked_from_root=origin.forked_from_root,
        forked_from_run=origin.forked_from_run,
        forked_from_seq=origin.forked_from_seq,
        changes=tuple(map(str, recipe.changes)),
    )


def recorded_recipe(started: RunStarted, event_count: int) -> Recipe:
    """Return the inputs of the run with this event 0. Raises: CannotReplay."""
    if started.kind != "simulated":
        found = f"a {started.kind} run, whose commands are not stored"
        raise CannotReplay("kind", "a simulated run, or a live one with its commands", found)
    _require_our_model(started)
    try:
        spec = msgspec.convert({name: getattr(started, name) for name in RunSpec.__struct_fields__}, RunSpec)
        if spec.fleet_size > event_count:  # each robot has an event: checked before the fleet is built
            found = f"fleet size: found {spec.fleet_size}, expected at most {event_count}, the events of the run"
            raise CannotReplay(None, "a run that can be simulated", found)
        recipe = Recipe(spec, _constants(started.parameters or ""), parsed(started.changes or ()))
        for constants in (recipe.constants, *constants_by_time(recipe).values()):
            most = FACTS_PER_ROBOT * spec.fleet_size + event_count
            if not arrivals_expected(constants, spec.fleet_size) <= most:
                raise CannotReplay("parameters", f"rates that make at most {most} facts", "rates that make more")
        require_possible(recipe)
    except BadParameters as error:
        raise CannotReplay("parameters", "the constants of the model", str(error).removeprefix("found ")) from error
    except (InvalidExperiment, msgspec.ValidationError) as error:
        raise CannotReplay(None, "a run that can be simulated", str(error)) from error
    except UsageError as error:
        raise CannotReplay("changes", "the changes of a fork, as they are written", str(error)) from error
    _require_own_words(started, recipe)
    return recipe


def _require_our_model(started: RunStarted) -> None:
    if started.model_version != MODEL_VERSION:
        maker = _MAKERS.get(started.model_version or "", "the version that wrote it")
        raise CannotReplay("model_version", f"{MODEL_VERSION!r}; replay it with {maker}", repr(started.model_version))


def recipe_of(record: LedgerRun, started: RunStarted) -> Recipe:
    """Return the inputs of the run on record, simulated or live. Raises: CannotReplay."""
    if started.kind != "live" or started.source != SOURCE:
        return recorded_recipe(started, len(record.events))
    constants, live = recorded_constants(started, len(record.events)), live_record(record, started)
    recipe = Recipe(RunSpec(0, ARCHITECTURE, FULL, "live", started.fleet_size or 0, 0), constants, live=live)
    _require_same("event 0", started_of(recipe), started)
    return recipe


def recorded_constants(started: RunStarted, event_count: int) -> Constants:
    """Return the constants of the live run with this event 0. Raises: CannotReplay."""
    _require_our_model(started)
    size = started.fleet_size or 0
    if not 0 < size <= event_count:
        raise CannotReplay("fleet_size", f"1 to {event_count}, the events of the run", f"{started.fleet_size}")
    try:
        return _constants(started.parameters or "")
    except BadParameters as error:
        raise CannotReplay("parameters", "the constants of the model", str(error).removeprefix("found ")) from error


def require_possible(recipe: Recipe) -> None:
    """Check that such a run can be simulated. Raises: InvalidExperiment."""
    spec = recipe.spec
    if recipe.live is not None:
        return
    Experiment(
        (spec.architecture,),
        (spec.scenario,),
        spec.run + 1,
        spec.seed,
        spec.fleet_size,
        (spec.configuration,),
        recipe.constants,
    )


def _require_own_words(started: RunStarted, recipe: Recipe) -> None:
    """Check that event 0 is what this version writes for such a run. Raises: CannotReplay."""
    own = started_of(recipe, started)
    if started.observes != own.observes:
        raise CannotReplay("observes", repr(own.observes), repr(started.observes))
    if started.parameters != own.parameters:
        recorded, ours = ([named["name"] for named in constants_of(each.parameters) or ()] for each in (started, own))
        lacks = list_few(name for name in ours if name not in recorded)
        actual = f"{started.parameters!r:.300}{lacks and f' without {lacks}'}"
        raise CannotReplay("parameters", "all constants of the model, in the form in which it writes them", actual)
    if started.changes is not None:
        base = base_of(recipe)
        _require_same("forked_from_run", run_id(run_started(base.spec, base.constants)), started.forked_from_run)
        if not _ROOT.fullmatch(started.forked_from_root or ""):
            raise CannotReplay("forked_from_root", "a root of 64 hexadecimal digits", repr(started.forked_from_root))
        try:
            whole = with_changes(base, recipe.changes)
        except UsageError as error:
            raise CannotReplay("changes", "changes of its base", str(error)) from error
        _require_same("changes", tuple(map(str, whole.changes)), started.changes)
        if whole != recipe:
            raise CannotReplay(
                "changes", "those that make its parameters from those of its base", repr(started.changes)[:300]
            )
        if started.forked_from_seq is None:
            raise CannotReplay("forked_from_seq", "the last event that it has in common with its base", "none")
    if own != started:
        raise CannotReplay(None, f"{own!r:.300}", f"{started!r:.300}")


def _require_same(field: str, expected: object, actual: object) -> None:
    if expected != actual:
        raise CannotReplay(field, f"{expected!r:.300}", f"{actual!r:.300}")


def constants_by_time(recipe: Recipe) -> dict[int, Constants]:
    """Return the constants of the world by the time from which they hold, in order, in microseconds."""
    constants = recipe.constants
    by_time: dict[int, Constants] = {}
    later = [change for change in recipe.changes if isinstance(change, Set) and change.from_s is not None]
    for change in sorted(later, key=lambda change: change.from_s or 0.0):
        constants = with_values(constants, {change.constant: change.value})
        by_time[microseconds_of(change.from_s or 0.0)] = constants
    return by_time


@lru_cache(maxsize=8)
def _constants(parameters: str) -> Constants:
    return read_constants(parameters)


KINDS = {
    "other constants": "met a world or a structure that is not this version's",
    "another load": "had a non-default load",
}

World = tuple[int | None, str | None, int | None, int | None]  # seed, scenario, fleet size, run


class WorldConstantsUsed(msgspec.Struct, frozen=True):
    """The worlds that runs of one kind met under the same constants; `parameters` as in `RunStarted`."""

    parameters: str
    architecture: str
    configuration: str
    worlds: tuple[World, ...]


def constants_used(starts: Iterable[RunStarted]) -> tuple[WorldConstantsUsed, ...]:
    """Return the worlds that these runs met, in the order in which they were first met."""
    groups: dict[tuple[str, str, str], list[World]] = {}
    for run in starts:
        kind = (
            run.parameters or "",
            run.architecture or "",
            run.configuration or "",
        )  # none is missing in a replayed run
        groups.setdefault(kind, []).append((run.seed, run.scenario, run.fleet_size, run.run))
    return tuple(WorldConstantsUsed(*kind, tuple(worlds)) for kind, worlds in groups.items())


def remarks_on(found: Iterable[WorldConstantsUsed]) -> tuple[str, ...]:
    """Return a line for each set of constants that is not this version's.

    A last line reports if two architectures or configurations never met a world under the same constants.
    """
    runs: dict[str, Counter[str]] = {}
    met: dict[World, dict[str, set[int]]] = {}
    numbers: dict[str, int] = {}
    for used in found:
        side = used.architecture if used.configuration == "full" else f"{used.architecture} {used.configuration}"
        runs.setdefault(used.parameters, Counter())[side] += len(used.worlds)
        number = numbers.setdefault(used.parameters, len(numbers))
        for world in used.worlds:
            met.setdefault(world, {}).setdefault(side, set()).add(number)
    total = sum(count.total() for count in runs.values())
    lines = [
        f"{_kind(differences)}: {counts.total():,} of {total:,} runs "
        f"({list_few(f'{count:,} of {side}' for side, count in counts.items())}) "
        f"{KINDS[_kind(differences)]}: {list_few(differences)}"
        for parameters, counts in runs.items()
        if (differences := unlike_ours(parameters))
    ]
    if len(lines) > NAMED:
        lines[NAMED:] = [f"other constants: {len(lines) - NAMED:,} more sets"]
    unlike = [
        world
        for world, sides in met.items()
        if any(first.isdisjoint(second) for first, second in combinations(sides.values(), 2))
    ]
    if unlike:
        seed, scenario, fleet_size, run = unlike[0]
        lines.append(
            f"no pairs: under {len(unlike):,} of {len(met):,} combinations of seed, scenario, fleet size and run "
            f"two architectures or configurations met no constants in common, first under {seed}, {scenario}, "
            f"{fleet_size}, {run}; `statistics` does not compare those two there"
        )
    return tuple(lines)


def _kind(differences: Iterable[str]) -> str:
    return "another load" if all(name.startswith("load.") for name in differences) else "other constants"
