"""Write the pictures of the page that `view` writes: docs/view-*.png.

    python docs/pictures.py     after a change of the page; it needs what `make test-all` installs, and a minute

The runs are those of the default ledger. Two calls on one machine write the same bytes; other fonts, others.
"""

import os
import sys
import tempfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image

DOCS = Path(__file__).resolve().parent
sys.path.insert(0, str(DOCS.parent))

from fsar_ledger import simulate  # noqa: E402
from tests.view.browser import Tab, chromium, settle  # noqa: E402

RUN = "fsar.full.failure-recovery-chain.n4.s42.r0018"
SAME_WORLD = RUN.replace("fsar", "cfc")
MOST_BYTES = 200_000


def picture(browser: Any, page: Path, name: str, width: int, height: int, keys: Sequence[str], **options: Any) -> None:
    """Show the first call of a supervisor and write what the browser shows. Raises: ValueError if it is too large."""
    shown = Tab(browser).open(page, viewport={"width": width, "height": height}, **options)
    shown.locator("rect.call").first.click()
    shown.mouse.move(0, 0)
    for key in keys:
        shown.keyboard.press(key)
    shown.evaluate("document.activeElement.blur(); scrollTo(0, 0)")
    settle(shown)
    out = DOCS / name
    Image.open(BytesIO(shown.screenshot())).convert("RGB").quantize(256, dither=Image.Dither.NONE).save(
        out, optimize=True
    )
    shown.close()
    if (size := out.stat().st_size) > MOST_BYTES:
        raise ValueError(f"{out}: {size:,} bytes, expected at most {MOST_BYTES:,}; show less, or use fewer colours")


def main() -> None:
    """Write the pictures."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        ledger = simulate("out/ledger", scenario="failure-recovery-chain").ledger
        one, two = Path(folder, "one.html"), Path(folder, "two.html")
        ledger.view(one, RUN)
        ledger.view(two, RUN, SAME_WORLD)
        with chromium() as browser:
            picture(browser, one, "view-1280.png", 1280, 1010, ())
            picture(browser, one, "view-400.png", 400, 820, ())
            picture(browser, one, "view-1280-dark.png", 1280, 1010, ("+", "+"), color_scheme="dark")
            picture(browser, two, "view-two-1280.png", 1280, 1480, ("0",))
        os.chdir(DOCS)


if __name__ == "__main__":
    main()
