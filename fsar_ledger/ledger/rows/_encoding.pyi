from typing import Any

def lines(
    types: dict[type, tuple[tuple[Any, ...], ...]],
    run_id: str,
    first: int,
    times_us: list[int],
    caused_by: list[int | None],
    events: list[Any],
    /,
) -> bytes | None: ...
