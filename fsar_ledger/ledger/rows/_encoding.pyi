from typing import Any

class Types: ...

def types(marked: dict[type, tuple[int, tuple[tuple[Any, ...], ...]]], /) -> Types: ...
def lines(
    types: Types,
    run_id: str,
    first: int,
    times_us: list[int],
    caused_by: list[int | None],
    events: list[Any],
    /,
) -> tuple[bytes, int] | None: ...
