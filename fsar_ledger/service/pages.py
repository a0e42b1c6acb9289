"""The pages of the service: the console of a person responsible for a fleet, and the description of the interface.

The console has the open calls and the robots (Paper: sec:model:supervision); its page is `console.html`, with its
script and style beside it. The interface is described from the command types, as OpenAPI 3.1 and as a page.
"""

import html
import inspect
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

import fsar_ledger
from fsar_ledger.events import CONCERNS
from fsar_ledger.events.envelope import FLEET_SUPERVISOR, Robot, recorded_robot
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.execution import doing_and_waiting
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import rules_in_force
from fsar_ledger.projections.supervision import density
from fsar_ledger.projections.task import given_up_us
from fsar_ledger.projections.trust import scope_of
from fsar_ledger.runtime.handlers.public import PublicCommand, commands, own_fields
from fsar_ledger.runtime.handlers.supervision import is_open
from fsar_ledger.runtime.live import MOST

from . import KINDS

FILES = {
    "/console": ("console.html", "text/html"),
    "/console.js": ("console.js", "text/javascript"),
    "/console.css": ("console.css", "text/css"),
}


class Reply(msgspec.Struct, frozen=True):
    """A reply that a person can give to a call, as the fields of `RespondToCall`."""

    label: str
    approves: bool
    preferred: str | None = None


class OpenCall(msgspec.Struct, frozen=True):
    """A call that waits for an answer.

    `why`: the rule that caused it; `known`: what is known about it, a sentence each; `otherwise`: what happens without
    an answer. `ends_us`: run time at which its task is given up; None: it has no task.
    """

    action_id: str
    purpose: str
    supervisor: str
    title: str
    why: str
    known: tuple[str, ...]
    otherwise: str
    ends_us: int | None
    replies: tuple[Reply, ...]


class RobotSeen(msgspec.Struct, frozen=True):
    """A robot: its supervisor, whether it is away, what it does or why not, and how many actions wait for it."""

    robot: str
    role: str
    supervisor: str
    is_away: bool
    does: str | None
    waiting: int


class Overview(msgspec.Struct, frozen=True):
    """What the console shows to one principal. Units: `now_us` run time."""

    principal: str
    run: str
    now_us: int
    calls: tuple[OpenCall, ...]
    robots: tuple[RobotSeen, ...]
    tasks: tuple[str, ...]


def overview(state: State, now_us: int, principal: str, run: str) -> Overview:
    """Return what the principal may see: of the calls, a supervisor only those to it."""
    calls = tuple(_calls(state, principal if principal.startswith("supervisor/") else None))
    return Overview(principal, run, now_us, calls, tuple(_robots(state)), tuple(state.task))


def _calls(state: State, supervisor: str | None) -> Iterator[OpenCall]:
    for call in state.supervision.calls.values():
        about = call.subject.action_id
        if not is_open(state, call) or supervisor not in (None, call.supervisor):
            continue
        task = state.task.get(call.subject.task_id)
        ends_us = None if task is None else given_up_us(task, state.fleet)
        title, why, replies = _question_and_replies(state, call)
        otherwise = "Nothing happens: what waits for the answer keeps waiting"
        otherwise += "." if ends_us is None else f", until task {call.subject.task_id} is given up."
        yield OpenCall(
            about, call.purpose, call.supervisor, title, why, tuple(_facts(state, call)), otherwise, ends_us, replies
        )


def _question_and_replies(state: State, call: SupervisorCalled) -> tuple[str, str, tuple[Reply, ...]]:
    """Return the question of the call, the rule that caused it, and the replies."""
    about = call.subject.action_id
    executor, capability, requester = _parties(state, about)
    if call.purpose == "review":
        title = f"May {executor or 'the robot'} do {capability}" + (f" for {requester}?" if requester else "?")
        why = "; ".join(_rules(state, executor, capability, call.subject.task_id)) or "A rule asked for a review."
        return title, why, (Reply("Approve", True), Reply("Refuse", False))
    if call.purpose == "recovery":
        title = f"{executor or 'A robot'} failed at {capability}, and nothing has helped. Is it resolved?"
        return title, "Recovery has reached its last level, a person.", (Reply("It is resolved", True),)
    other = call.competing or ""
    title = f"Two requests want {executor or 'the same robot'}: {about} and {other}. Which goes first?"
    replies = tuple(Reply(f"{action} first", True, action) for action in (about, other) if action)
    why = "The fleet's supervisor orders requests for one robot when one of them is time-critical."
    return title, why, replies


def _parties(state: State, about: str) -> tuple[Robot | None, str, str | None]:
    """Return the executor, the capability and the requester of an action or a request."""
    if (action := state.execution.actions.get(about)) is not None:
        return action.robot, action.capability, action.requested_by if action.is_delegated else None
    request = state.request.open[about]
    executor = request.candidates[0] if request.candidates else request.target
    return executor, request.capability, request.requester


def _rules(state: State, executor: Robot | None, capability: str, task: str) -> Iterator[str]:
    """Yield each rule, window and density that requires a review by a person."""
    if executor is None:
        return
    for rule in rules_in_force(state.policy):
        is_about = rule.capability in (None, capability) and rule.context in (None, task)
        if rule.robot == executor and rule.outcome == "review" and is_about:
            yield f"A {rule.scope} rule asks for a review of {rule.capability or 'everything'} at {executor}"
    for scope in ("local", "fleet"):
        for window, outcome in getattr(state.world, scope).get(executor, ()):
            if outcome == "review":
                yield f"The {scope} window {window} asks for a review at {executor}"
    if (every := density(state.supervision, executor)) > 0:
        yield f"One in {every} admissions by {executor} is reviewed"


def _facts(state: State, call: SupervisorCalled) -> Iterator[str]:
    about = call.subject.action_id
    executor, _, requester = _parties(state, about)
    task = state.task.get(call.subject.task_id)
    other = state.request.open.get(call.competing or "")
    for item in (task, None if other is None else state.task.get(other.task_id)):
        if item is not None:
            urgent = ", time-critical" if item.is_time_critical else ""
            yield f"Task {item.task_id} of {item.robot}, step {item.step + 1} of {len(item.steps)}{urgent}."
    if executor is not None and requester is not None and requester in state.fleet.robots:
        trusted = scope_of(state.trust, executor, recorded_robot(requester), None, None)
        yield f"{executor} trusts {requester}: {trusted}."
    if (recovery := state.recovery.get(about)) is not None:
        yield f"Cause: {recovery.cause or 'not known'}. Attempts of its own: {recovery.number}."
        yield f"Asked for help: {', '.join(recovery.tried) or 'nobody'}."
    for robot in (recorded_robot(name) for name in (executor, requester) if name is not None):
        if (away := _away(state, robot)) is not None:
            yield f"{robot} is away: {away}."


def _robots(state: State) -> Iterator[RobotSeen]:
    for robot, member in state.fleet.robots.items():
        doing, waiting = doing_and_waiting(state.execution, robot)
        current = doing[0] if doing else None
        action = None if current is None else state.execution.actions.get(current)
        does = current if action is None else f"{action.capability} ({action.action_id}, {action.stage})"
        away = _away(state, robot)
        supervisor = member.supervisor or FLEET_SUPERVISOR
        yield RobotSeen(robot, member.role, supervisor, away is not None, away or does, len(waiting))


def _away(state: State, robot: Robot) -> str | None:
    """Return why the robot is away; None if it is not."""
    if (how := state.fleet.departed.get(robot)) is not None:
        return f"left the fleet ({how})"
    if robot in state.knowledge.suspected:
        return "no longer heard from"
    return "off" if robot in state.world.off else None


def page_file(name: str) -> bytes:
    """Return a file of the page."""
    return (Path(__file__).parent / name).read_bytes()


_ERRORS = {
    "400": "not a command: the fields are not those of its type",
    "401": "not the token of a principal",
    "403": "an auditor gives no commands",
    "404": "there is no such command",
    "408": "the body did not arrive in time",
    "409": "the key was already used for another command",
    "413": "too long",
    "429": "more commands than the principal may give in a second",
    "503": "too many commands wait, the disk refuses, or no token can be checked; nothing was decided",
}


def _fields(kind: type[PublicCommand]) -> type[msgspec.Struct]:
    """Return a struct of the fields that a command of this kind gives, without those that the run stamps."""
    hints = get_type_hints(kind)
    defaults = {field.name: field for field in msgspec.structs.fields(kind)}
    fields: list[Any] = []
    for name in own_fields(kind):
        default = defaults[name].default
        fields.append((name, hints[name]) if default is msgspec.NODEFAULT else (name, hints[name], default))
    fields.sort(key=len)
    return msgspec.defstruct(kind.__name__, fields, forbid_unknown_fields=True)


@cache
def described() -> dict[str, Any]:
    """Return the OpenAPI document."""
    kinds = commands()
    schemas, components = msgspec.json.schema_components(
        [_fields(kind) for kind in kinds.values()], ref_template="#/components/schemas/{name}"
    )
    _limit(components)
    schema_of = dict(zip(kinds, schemas, strict=True))
    components["Decision"] = _DECISION
    components["Error"] = {"type": "object", "required": ["error"], "properties": {"error": {"type": "string"}}}
    paths: dict[str, Any] = {}
    for name, kind in sorted(kinds.items()):
        paths[f"/commands/{name}"] = {
            "post": {
                "operationId": name,
                "summary": summary(kind),
                "parameters": [_KEY],
                "requestBody": {"required": True, "content": _json(schema_of[name])},
                "responses": {"200": _response("the decision, once it is on disk", "Decision"), **_errors()},
            }
        }
    paths["/events"] = {"get": _EVENTS}
    for path, text in (("/health", "whether decisions can be made"), ("/metrics", "counts, for Prometheus")):
        paths[path] = {"get": {"security": [], "summary": text, "responses": {"200": {"description": text}}}}
    paths["/health"]["get"]["responses"]["503"] = _response("why none can be made", "Error")
    return {
        "openapi": "3.1.0",
        "info": {"title": "FSAR ledger: a live federation", "version": fsar_ledger.__version__},
        "security": [{"token": []}],
        "paths": paths,
        "components": {"schemas": components, "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}},
    }


def _limit(schema: Any) -> None:
    """Add what a command refuses beyond its types: text that cannot be printed, and numbers of more than 2^50."""
    match schema:
        case {"type": "string"}:
            schema["pattern"] = r"^(?: |[^\p{C}\p{Z}])*$"  # as in ECMA-262 with the flag u
        case {"type": "integer"}:
            schema |= {"minimum": -MOST, "maximum": MOST}
        case dict() | list():
            for part in schema.values() if isinstance(schema, dict) else schema:
                _limit(part)


def summary(kind: type[Any]) -> str:
    """Return the first sentence about the command."""
    return " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split())


def _json(schema: Any) -> dict[str, Any]:
    return {"application/json": {"schema": schema}}


def _response(text: str, name: str) -> dict[str, Any]:
    return {"description": text, "content": _json({"$ref": f"#/components/schemas/{name}"})}


def _errors() -> dict[str, Any]:
    return {status: _response(text, "Error") for status, text in _ERRORS.items()}


_EVENT_LIST = {"type": "array", "items": {"type": "object", "required": ["type"]}}
_DECISION = {
    "type": "object",
    "required": ["seq", "rejected", "events"],
    "properties": {
        "seq": {"type": "integer", "description": "the number of the command's record within the run"},
        "rejected": {"type": ["string", "null"], "description": "why it could not be executed"},
        "events": {**_EVENT_LIST, "description": "what it led to"},
        "followed": {**_EVENT_LIST, "description": "what happened immediately after them"},
    },
}
_KEY = {
    "name": "Idempotency-Key",
    "in": "header",
    "schema": {"type": "string", "minLength": 1, "maxLength": 200},
    "description": "A command with the same key is decided once, however often it is sent.",
}
_EVENTS = {
    "summary": "Follow the events of the run as server-sent events, each at least once, from any point.",
    "parameters": [
        {
            "name": "after",
            "in": "query",
            "schema": {"type": "integer"},
            "description": "The seq of the last known event, like Last-Event-ID. Without it: new events only.",
        },
        {"name": "robot", "in": "query", "schema": {"type": "string"}, "description": "Only events that name it."},
        {"name": "task", "in": "query", "schema": {"type": "string"}, "description": "Only events of this task."},
        {
            "name": "concern",
            "in": "query",
            "schema": {"enum": list(CONCERNS)},
            "description": "Only events of this concern.",
        },
    ],
    "responses": {
        "200": {"description": "events", "content": {"text/event-stream": {}}},
        **{status: _response(_ERRORS[status], "Error") for status in ("400", "401", "503")},
    },
}


@cache
def page(run: str) -> str:
    """Return the description of the interface as a self-contained page."""
    kinds = "".join(f"<dt><code>{kind}/</code><dd>{html.escape(text)}" for kind, text in KINDS.items())
    rows = "".join(_command(name, kind) for name, kind in sorted(commands().items()))
    return _PAGE.format(run=html.escape(run), kinds=kinds, rows=rows, version=fsar_ledger.__version__)


def _command(name: str, kind: type[PublicCommand]) -> str:
    hints, fields = get_type_hints(kind), []
    for field in msgspec.structs.fields(kind):
        if field.name in own_fields(kind):
            text = inspect.formatannotation(hints[field.name]).replace("typing.", "")
            text = text.replace("fsar_ledger.events.envelope.", "").replace(
                "fsar_ledger.runtime.handlers.candidates.", ""
            )
            mark = "" if field.required else " <i>optional</i>"
            fields.append(f"<li><code>{field.name}</code> {html.escape(text)}{mark}")
    return f"<section><h2 id={name}>{name}</h2><p>{html.escape(summary(kind))}</p><ul>{''.join(fields)}</ul></section>"


_PAGE = """<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content="width=device-width">
<title>FSAR ledger: {run}</title>
<style>body{{font:16px/1.5 system-ui,sans-serif;max-width:46rem;margin:2rem auto;padding:0 1rem;color:#1c1c1c}}
code,pre{{font:14px/1.5 ui-monospace,monospace}}pre{{background:#f3f3f0;padding:.8rem;overflow:auto}}
h2{{font-size:1.1rem;margin:1.6rem 0 0}}ul{{margin:.2rem 0;padding-left:1.2rem}}p{{margin:.2rem 0}}i{{color:#666}}
@media(prefers-color-scheme:dark){{body{{background:#161616;color:#e6e6e6}}pre{{background:#222}}i{{color:#aaa}}}}</style>
<h1>A live federation: {run}</h1>
<p>Commands go to <code>POST /commands/NAME</code>; the answer comes once the decision is on disk.
Events come from <code>GET /events</code>.
The machine-readable description is <a href=openapi.json>openapi.json</a>. Version {version}.</p>
<pre>curl -H "Authorization: Bearer $TOKEN" -H "Idempotency-Key: 1" \\
     -d '{{"robot": "robot/A1", "action_id": "t/1.1"}}' \\
     http://127.0.0.1:8000/commands/ReportStart
curl -N -H "Authorization: Bearer $TOKEN" "http://127.0.0.1:8000/events?after=0"</pre>
<p>The token identifies the caller, and nobody speaks for another:</p><dl>{kinds}</dl>
{rows}</html>"""
