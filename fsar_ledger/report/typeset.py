"""Typeset data and figures as a PDF, with the same bytes for the same input.

Data reaches the template as JSON and is never read as markup; only the packaged texts of `reports/` are.
"""

import os
import tempfile
from contextlib import suppress
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


def require_place(path: Path) -> None:
    """Check, before any work is done, that the file can be written. Raises: WriteFailed if that is known to fail."""
    try:
        _require_file(path)
        above = next(folder for folder in path.absolute().parents if folder.exists())
        if not above.is_dir():
            raise NotADirectoryError(f"{above} is a file; expected a folder")
        if not os.access(above, os.W_OK):
            raise PermissionError(f"{above} may not be written to")
    except OSError as error:
        raise _unwritten(path, error) from error


def _require_file(path: Path) -> None:
    if path.is_dir():
        raise IsADirectoryError(f"it is a folder; expected the name of a file, such as {path / 'report.pdf'}")


def _unwritten(path: Path, error: OSError) -> WriteFailed:
    return WriteFailed(
        f"{path}: cannot be written: {error.strerror or error}. Nothing was changed; free space or choose another "
        "--out."
    )


def publish(path: Path, content: bytes) -> None:
    """Replace the file by this content atomically: written beside it, made durable, renamed.

    Raises: WriteFailed if the disk refuses (no such folder can be made, read-only, full) or the path is a folder.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _require_file(path)
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        raise _unwritten(path, error) from error
    finally:
        _discard(partial)


def _discard(partial: Path) -> None:
    """Remove the partial file if the folder allows it."""
    with suppress(OSError):
        partial.unlink()
