"""Output of commands: lines, tables, JSON and files."""

import importlib
import json
import os
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from wtg_gym.extras import install_advice
from wtg_gym.files import find_markers, printable, read_text, write_atomically


def note(text: str) -> None:
    """Write a line to stderr, so that stdout carries results only."""
    print(printable(text), file=sys.stderr)


def say(*lines: str) -> None:
    """Write lines to stdout; no command prints past this, :func:`note` and :func:`print_json`."""
    for line in lines:
        print(printable(line))


def require_extra(package: str, purpose: str) -> None:
    """Raise a ValueError that says what to install if a package of the leaderboard extra cannot be imported."""
    try:
        importlib.import_module(package)
    except ImportError as error:
        raise ValueError(f"{purpose} needs {package}; {install_advice('leaderboard')} ({error})") from error


def write_and_say(path: Path, content: str | bytes) -> None:
    """Write a file and say so."""
    write_atomically(path, content)
    note(f"wrote {path}")


def check_page(option: str, path: Path, sections: Sequence[str]) -> str:
    """Return which of some sections a page has markers of; a ValueError if it has none, or cannot be written."""
    try:
        text = read_text(path, "file with the markers")
        section = next((name for name in sections if f"<!-- {name}:start -->" in text), sections[0])
        find_markers(path, section)
        check_writable(path.resolve().parent)
    except ValueError as error:
        raise ValueError(f"{option}: {error}") from error
    if not os.access(path, os.W_OK):
        raise ValueError(f"{option} {path} is not writable")
    return section


def check_writable(folder: Path) -> None:
    """Raise a ValueError if no file can be made in a folder, such as /proc, whose permissions say otherwise."""
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise ValueError(f"The folder {folder} is not writable: no file can be made ({error.strerror})") from error


def print_json(data: Any) -> None:
    """Print data as JSON, with nothing in it that a terminal takes for a command."""
    text = json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)
    print("".join(sign if sign.isprintable() or sign == "\n" else json.dumps(sign)[1:-1] for sign in text))


def print_table(header: Sequence[str], rows: Iterable[Sequence[str]], *, left: Sequence[int] = (0,)) -> None:
    """Print a table with aligned columns: those of text, `left`, on the left, the others on the right."""
    cells = [[printable(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for row in (cells[0], ["-" * width for width in widths], *cells[1:]):
        aligned = (
            cell.ljust(width) if index in left else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        say("  ".join(aligned).rstrip())
