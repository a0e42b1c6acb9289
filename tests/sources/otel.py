"""Small recordings of spans as OTLP JSON, of our own making by the published schemas."""

from collections.abc import Iterable, Iterator
from typing import Any

BEGINS_NS = 1_772_359_200_000_000_000
"""2026-03-01T10:00:00Z."""
Line = dict[str, Any]


def attributes(values: dict[str, object]) -> list[Line]:
    return [
        {"key": name, "value": {"intValue": f"{one}"} if isinstance(one, int) else {"stringValue": one}}
        for name, one in values.items()
    ]


def span(
    own: str,
    parent: str | None,
    operation: str,
    *,
    trace: str = "1",
    agent: str | None = None,
    tool: str | None = None,
    from_s: float = 0.0,
    to_s: float = 1.0,
    kind: int = 1,
    failure: str | None = None,
    **more: object,
) -> Line:
    """A span, with ids of the right length that end in these."""
    named = {"gen_ai.operation.name": operation, "gen_ai.agent.name": agent, "gen_ai.tool.name": tool}
    made = {
        "traceId": trace.rjust(32, "a"),
        "spanId": own.rjust(16, "b"),
        "name": f"{operation} {agent or tool}",
        "kind": kind,
        "startTimeUnixNano": f"{BEGINS_NS + round(from_s * 1e9)}",
        "endTimeUnixNano": f"{BEGINS_NS + round(to_s * 1e9)}",
        "attributes": attributes({name: one for name, one in named.items() if one is not None} | more),
        "status": {} if failure is None else {"code": 2, "message": failure},
    }
    return made if parent is None else made | {"parentSpanId": parent.rjust(16, "b")}


def batch(*spans: Line, service: str = "agents") -> Line:
    return {
        "resourceSpans": [
            {
                "resource": {"attributes": attributes({"service.name": service})},
                "scopeSpans": [{"scope": {"name": "by hand"}, "spans": list(spans)}],
            }
        ]
    }


def honest_day(traces: Iterable[str] = ("1", "2")) -> Iterator[Line]:
    """Traces in which a planner asks a picker, which uses a tool and tries another that fails; children come first."""
    for at, trace in enumerate(traces):
        begins = 10.0 * at
        yield batch(
            span("3", "2", "execute_tool", trace=trace, tool="grasp", from_s=begins + 2, to_s=begins + 3),
            span("4", "2", "chat", trace=trace, from_s=begins + 3, to_s=begins + 4),
            span("5", "2", "execute_tool", trace=trace, tool="lift", to_s=begins + 5, failure="too heavy"),
        )
        yield batch(span("2", "1", "invoke_agent", trace=trace, agent="picker", from_s=begins + 1, to_s=begins + 6))
        yield batch(span("1", None, "invoke_agent", trace=trace, agent="planner", from_s=begins, to_s=begins + 7))


def snake(found: Any) -> Any:
    """The same with the names of protobuf."""
    if isinstance(found, list):
        return [snake(one) for one in found]
    if not isinstance(found, dict):
        return found
    return {"".join(f"_{c.lower()}" if c.isupper() else c for c in name): snake(one) for name, one in found.items()}
