"""The service that tests ask."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.service.site import Site


@pytest.fixture
def site(tmp_path: Path) -> "Iterator[Site]":
    from tests.service.site import Site  # which is not there without the extra

    with Site(tmp_path) as one:
        yield one
