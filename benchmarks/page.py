"""Measures the page of `view` with ten thousand events in Chromium: until it is drawn, and how it answers to keys.

    python benchmarks/page.py

Printed are the best of three. Needs Chromium and Playwright, which `make test-all` installs.
"""

import sys
import tempfile
import timeit
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fsar_ledger.view import page as page_of
from tests.view.browser import Tab, chromium, press
from tests.view.conftest import a_run, shown

KEYS = ("ArrowRight",) * 5 + ("+",) * 5


def main() -> None:
    """Print the measurements."""
    run = a_run("dhma", "fleet-contention", 36)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        file = Path(folder) / "large.html"
        file.write_bytes(page_of(shown(run)))
        loaded_s = min(timeit.repeat(lambda: Tab(browser).open(file).close(), number=1, repeat=3))
        page = Tab(browser).open(file)
        keys_s = min(timeit.repeat(lambda: press(page, *KEYS), number=1, repeat=3))
    print(f"page of {len(run.events):,} events: drawn after {loaded_s:.2f} s   (target: at most 2)")
    print(f"a key is answered after {keys_s / len(KEYS):.3f} s   (target: at most 0.2)")


if __name__ == "__main__":
    main()
