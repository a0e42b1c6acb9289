"""A small part of `make soak-readers`, and that it would notice a reader who reads differently."""

import random
from pathlib import Path

import pytest

from tests.ledger import readers_soak
from tests.ledger.mutations import KINDS, Template, mutated
from tests.ledger.readers_soak import Readers, difference, is_accepted, segments


@pytest.mark.slow
def test_each_kind_of_mutation_is_refused_or_read_alike() -> None:
    templates, accepted, refused = [Template(data) for data in segments()], [], 0
    for number in range(20 * len(KINDS)):
        draw = random.Random(number)
        template = draw.choice(templates)
        data = mutated(template, list(KINDS)[number % len(KINDS)], draw)
        if is_accepted(data) and data != template.data:
            accepted.append(data)
        else:
            refused += 1
    assert refused > 250
    assert len(accepted) > 10
    readers = Readers()
    try:
        assert [
            found for data in accepted[:12] if (found := readers.differ(data)) not in (None, readers_soak.UNREAD)
        ] == []
    finally:
        readers.close()


@pytest.mark.slow
def test_readers_who_differ_are_found_where_nothing_is_refused() -> None:
    counts, differences = readers_soak.soak(0, 30, is_loose=True, kinds=("moved pages",))
    assert sum(count for (_, outcome), count in counts.items() if outcome == "different") > 3
    assert any("other values of column" in text or "cannot read" in text or "reads it" in text for text in differences)


def test_a_segment_as_it_is_written_is_read_alike_by_all(tmp_path: Path) -> None:
    for data in segments():
        assert is_accepted(data)
        assert difference(data, tmp_path / "segment.parquet") is None
