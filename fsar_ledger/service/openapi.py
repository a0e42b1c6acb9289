"""The description of the interface, made from the command types, as OpenAPI 3.1 and as a page."""

import html
import inspect
from functools import cache
from typing import Any, get_type_hints

import msgspec

import fsar_ledger
from fsar_ledger.events import CONCERNS
from fsar_ledger.runtime.handlers.public import PublicCommand, commands, own_fields

from .principals import KINDS

_ERRORS = {
    "400": "no command: the fields are not those of its type",
    "401": "no token of a principal",
    "403": "an auditor gives no commands",
    "404": "there is no such command",
    "408": "the body did not come in time",
    "409": "the key was given with another command",
    "413": "too long",
    "429": "more than the principal may give in a second",
    "503": "too many wait, or the disk refuses; nothing was decided",
}


def _fields(kind: type[PublicCommand]) -> type[msgspec.Struct]:
    """Return a struct of what a command of this kind says, without what the run stamps."""
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
                "responses": {"200": _response("what became of it, once it is on disk", "Decision"), **_errors()},
            }
        }
    paths["/events"] = {"get": _EVENTS}
    for path, text in (("/health", "whether decisions can be made"), ("/metrics", "counts, for Prometheus")):
        paths[path] = {"get": {"security": [], "summary": text, "responses": {"200": {"description": text}}}}
    return {
        "openapi": "3.1.0",
        "info": {"title": "FSAR ledger: a live federation", "version": fsar_ledger.__version__},
        "security": [{"token": []}],
        "paths": paths,
        "components": {"schemas": components, "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}},
    }


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
        "rejected": {"type": ["string", "null"], "description": "why it could not be carried out"},
        "events": {**_EVENT_LIST, "description": "what it led to"},
        "followed": {**_EVENT_LIST, "description": "what happened at once after them"},
    },
}
_KEY = {
    "name": "Idempotency-Key",
    "in": "header",
    "schema": {"type": "string", "minLength": 1, "maxLength": 200},
    "description": "A command with the same key is decided once, however often it comes.",
}
_EVENTS = {
    "summary": "Follow the events of the run as server-sent events, each at least once, from any place on.",
    "parameters": [
        {
            "name": "after",
            "in": "query",
            "schema": {"type": "integer"},
            "description": "The seq of the last event that is known; as Last-Event-ID. Without it: new events only.",
        },
        {"name": "robot", "in": "query", "schema": {"type": "string"}, "description": "Only those that name it."},
        {"name": "task", "in": "query", "schema": {"type": "string"}, "description": "Only those of the task."},
        {
            "name": "concern",
            "in": "query",
            "schema": {"enum": list(CONCERNS)},
            "description": "Only those of it.",
        },
    ],
    "responses": {
        "200": {"description": "events", "content": {"text/event-stream": {}}},
        **{status: _response(_ERRORS[status], "Error") for status in ("400", "401", "503")},
    },
}


@cache
def page(run: str) -> str:
    """Return the interface as a page that needs nothing from elsewhere."""
    kinds = "".join(f"<dt><code>{one}/</code><dd>{html.escape(text)}" for one, text in KINDS.items())
    rows = "".join(_command(name, kind) for name, kind in sorted(commands().items()))
    return _PAGE.format(run=html.escape(run), kinds=kinds, rows=rows, version=fsar_ledger.__version__)


def _command(name: str, kind: type[PublicCommand]) -> str:
    hints, fields = get_type_hints(kind), []
    for one in msgspec.structs.fields(kind):
        if one.name in own_fields(kind):
            text = inspect.formatannotation(hints[one.name]).replace("typing.", "")
            text = text.replace("fsar_ledger.events.envelope.", "").replace(
                "fsar_ledger.runtime.handlers.candidates.", ""
            )
            mark = "" if one.required else " <i>may be left out</i>"
            fields.append(f"<li><code>{one.name}</code> {html.escape(text)}{mark}")
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
<p>Who speaks is told by the token, and nobody speaks for another:</p><dl>{kinds}</dl>
{rows}</html>"""
