"""Typeset data and figures as a PDF, with the same bytes for the same input.

Data reaches the template as JSON and is never read as markup; only the packaged texts of `reports/` are.
"""

import tempfile
from pathlib import Path

from fsar_ledger.errors import WriteFailed
from fsar_ledger.report import specs


def pdf(data: bytes, figures: dict[str, bytes]) -> bytes:
    """Return the report as a PDF. `data` is JSON, `figures` are SVG by file name.

    Raises: WriteFailed if the folder for temporary files is full.
    """
    try:
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)
            (root / "report.typ").write_text(specs.text("templates", "report.typ"), encoding="utf-8")
            (root / "data.json").write_bytes(data)
            for name, svg in figures.items():
                (root / name).write_bytes(svg)
            return _compiled(root)
    except OSError as error:
        raise WriteFailed(
            f"{tempfile.gettempdir()}: temporary files cannot be written: {error.strerror}. Nothing was changed; free "
            "space or set TMPDIR."
        ) from error


def _compiled(root: Path) -> bytes:
    """Compile `report.typ` in this folder; it can read nothing outside, and only Typst's own fonts."""
    import typst

    compiled: bytes = typst.compile(
        root / "report.typ", root=root, timestamp=0, font_paths=typst.Fonts(include_system_fonts=False)
    )
    return compiled
