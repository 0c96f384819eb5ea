"""Writing files so that nobody ever sees half of one, and JSON that is the same bytes every time."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any


def sha256(data: bytes) -> str:
    """Return the sha256 of `data` as hex digits."""
    return hashlib.sha256(data).hexdigest()


def to_json(data: Any) -> str:
    """Return `data` as JSON with sorted keys and a line feed at the end.

    Raises:
        ValueError: a number is not finite.
    """
    return json.dumps(data, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_atomically(path: Path, content: str | bytes) -> None:
    """Replace the file `path` by bytes, or by text (UTF-8, line feeds as given), in one go, keeping its permissions.

    Raises:
        OSError: the folder cannot be written to.
    """
    # A link stays a link: what it points to is replaced.
    path = path.resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content.encode("utf-8") if isinstance(content, str) else content)
        if path.exists():
            shutil.copymode(path, temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]], *, right: Sequence[int] = ()) -> str:
    """Return a Markdown table without a line feed at the end; `right` are the columns of numbers."""
    rules = ["---:" if index in right else "---" for index in range(len(header))]
    lines = (header, rules, *rows)
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in lines)


def update_between_markers(path: str | Path, content: str, name: str) -> bool:
    """Put text between `<!-- NAME:start -->` and `<!-- NAME:end -->` of a file, which are lines of their own.

    Args:
        path: the file; all else in it stays as it is.
        content: what to put there.
        name: name in the markers.

    Returns:
        whether the file has changed.

    Raises:
        ValueError: the file cannot be read, or does not have each marker once, the start before the end.
    """
    path = Path(path)
    text, start, end = _with_markers(path, name)
    newline = "\r\n" if "\r\n" in text else "\n"
    before, after = text[: text.index(start) + len(start)], text[text.index(end) :]
    changed = before + newline + content.strip().replace("\n", newline) + newline + after
    if changed != text:
        write_atomically(path, changed)
    return changed != text


def require_markers(path: str | Path, *names: str) -> None:
    """Raise the ValueError that :func:`update_between_markers` would, before the work."""
    for name in names:
        _with_markers(Path(path), name)


def _with_markers(path: Path, name: str) -> tuple[str, str, str]:
    text = read_text(path, "file with the markers")
    start, end = (f"<!-- {name}:{edge} -->" for edge in ("start", "end"))
    if text.count(start) != 1 or text.count(end) != 1 or text.index(start) > text.index(end):
        raise ValueError(f"{path} must have the markers {start} and {end} once each, in this order")
    return text, start, end


def read_text(path: Path, what: str) -> str:
    """Return a file's text.

    Args:
        path: the file.
        what: what it is, for the message.

    Raises:
        ValueError: the file cannot be read or is not UTF-8; the message names it.
    """
    try:
        return path.read_bytes().decode("utf-8")
    except OSError as error:
        raise ValueError(f"cannot read the {what} {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"the {what} {path} is not UTF-8 text: {error}") from error


def parse_json(text: str, path: Path, what: str) -> Any:
    """Return the data of a JSON text.

    Raises:
        ValueError: it is not JSON, is cut short, or holds NaN or Infinity; the message names the file.
    """

    def refuse(name: str) -> Any:
        raise ValueError(f"{name} is not a finite number")

    try:
        return json.loads(text, parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"the {what} {path} is not JSON, or was cut short: {error}") from error


__all__ = [
    "markdown_table",
    "parse_json",
    "read_text",
    "require_markers",
    "sha256",
    "to_json",
    "update_between_markers",
    "write_atomically",
]
