"""Files: written whole or not at all, JSON with the same bytes every time, one guarded reader of JSON and TOML.

Files with code to run, such as machine code, are read and written by :func:`read_trusted` and :func:`write_trusted`.
"""

import contextlib
import errno
import hashlib
import json
import math
import os
import secrets
import shutil
import stat
import tempfile
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

#: Largest file of each kind that is read [B], by what messages call it. Each leaves room for more than what is in use:
#: a grid of 500 buses has 0.2 MB, an hour of measured wind of eight groups 3 MB, the table of a hundred entries 10 MB.
LARGEST_BYTES: Mapping[str, int] = {
    "case": 2**25,
    "description of the results": 2**22,
    "description of the run": 2**22,
    "entry file": 2**14,
    "file with the markers": 2**22,
    "finished batch": 2**22,
    "grid": 2**22,
    "hyperparameter file": 2**16,
    "law file": 2**14,
    "network of pandapower": 2**25,
    "policy": 2**26,
    "records of the trainings": 2**20,
    "rotor table": 2**21,
    "scenario file": 2**23,
    "suite": 2**18,
    "table of the results": 2**26,
    "wind series": 2**24,
}
#: Deepest nest of objects and lists that is read; results have five levels.
_DEEPEST = 20
#: Most lists and objects of a JSON text: each takes a hundred times its two characters. The largest grids have a third.
_MOST_INNER = 2**17
#: Whole numbers from here on are refused; nothing that is read counts further.
_LARGEST_WHOLE = 2**64
#: Most characters of an error's message.
_LONGEST_ERROR = 1500
#: Errors that unexpected content causes.
_UNEXPECTED = (ArithmeticError, AttributeError, LookupError, OSError, RecursionError, TypeError, ValueError)


def sha256(data: bytes) -> str:
    """Return the sha256 of `data` as hex digits."""
    return hashlib.sha256(data).hexdigest()


def to_json(data: Any) -> str:
    """Return `data` as JSON with sorted keys and a line feed at the end; a ValueError if a number is not finite."""
    return json.dumps(data, sort_keys=True, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def printable(text: str) -> str:
    """Return text without commands to a terminal and on one line: other signs appear as escapes such as ``\\x1b``."""
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in text)


def one_line(error: BaseException) -> str:
    """Return the message of an error in one printable line, shortened where it quotes a whole file."""
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    else:
        text = " ".join(str(error).split()) or type(error).__name__
    text = printable(text)
    return text if len(text) <= _LONGEST_ERROR else f"{text[:_LONGEST_ERROR]} …"


def write_atomically(path: Path, content: str | bytes) -> None:
    """Replace one file in one go, see :func:`write_together`."""
    write_together({path: content})


def write_together(contents: Mapping[Path, str | bytes]) -> None:
    """Replace files that belong together, all of them or, where one cannot be written, none; permissions stay.

    All are written under other names first, so that a full disk is met before the first old file is gone, and then
    replaced in the order of `contents`: bytes, or text (UTF-8, line feeds as given). An OSError names the file.
    """
    written: dict[Path, tuple[Path, Path]] = {}
    try:
        for path, content in contents.items():
            # A link stays a link; the file that it points to is replaced.
            target = path.resolve()
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            # Random: processes on several machines or in several containers may have the same number.
            temporary = target.with_name(f".{target.name}.{secrets.token_hex(8)}.tmp")
            written[path] = temporary, target
            with temporary.open("xb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
            if target.exists():
                shutil.copymode(target, temporary)
        for path in written:
            os.replace(*written[path])
    except OSError as error:
        # An error of writing names no file, others the temporary one.
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        for temporary, _ in written.values():
            temporary.unlink(missing_ok=True)


def trusted_folder(path: Path, *, make: bool = False) -> Path:
    """Return a folder, with all links followed, that no other user can put a file into or replace; else an OSError.

    It and every folder above it must belong to the user or to root. Others may write at most into folders above it, and
    only where they cannot replace what belongs to somebody else (the sticky bit, as /tmp has). Where the system knows
    no owners, as on Windows, every folder passes. `make` makes missing folders, which only the user can read.
    """
    path = Path(os.path.realpath(path))
    # From the top: below a folder that has passed, no other user can replace the next one.
    for folder in (*reversed(path.parents), path):
        if make:
            folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode) or not is_trusted(status, or_sticky=folder != path):
            raise PermissionError(errno.EPERM, "another user could change it", str(folder))
    return path


def is_trusted(status: os.stat_result, *, or_sticky: bool = False) -> bool:
    """Return whether only the user or root owns and may write a file or folder (or it is sticky)."""
    if not hasattr(os, "getuid"):
        return True
    # By the convention of many systems, a group with the user's number has this user alone.
    is_private = os.getuid() == os.getgid() == status.st_gid != 0
    others = stat.S_IWOTH if is_private else stat.S_IWGRP | stat.S_IWOTH
    others_write = status.st_mode & others and not (or_sticky and status.st_mode & stat.S_ISVTX)
    return status.st_uid in (0, os.getuid()) and not others_write


def trusted_files(path: Path) -> Path:
    """Return a :func:`trusted_folder` of files, none of which another user can have written; else an OSError."""
    folder = trusted_folder(path.parent) / path.name
    for inside in (folder, *folder.iterdir()):
        status = inside.lstat()
        is_kind = stat.S_ISDIR if inside == folder else stat.S_ISREG
        if not is_kind(status.st_mode) or not is_trusted(status):
            raise PermissionError(errno.EPERM, "another user could have written it", str(inside))
    return folder


def read_trusted(path: Path, largest: int = 2**28) -> bytes:
    """Return the content of a file of at most `largest` bytes that no other user can have written; else an OSError."""
    return read_plain(trusted_folder(path.parent) / path.name, largest, links=False, trusted=True)


def write_trusted(path: Path, content: bytes) -> None:
    """Write a file for :func:`read_trusted`, whole or not at all; only the user can read it. Else an OSError."""
    folder = trusted_folder(path.parent, make=True)
    descriptor, temporary = tempfile.mkstemp(dir=folder, suffix=".tmp")
    try:
        with open(descriptor, "wb") as file:
            file.write(content)
        os.replace(temporary, folder / path.name)
    finally:
        Path(temporary).unlink(missing_ok=True)


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]], *, right: Sequence[int] = ()) -> str:
    """Return a Markdown table without a line feed at the end; `right` are the columns of numbers."""
    rules = ["---:" if index in right else "---" for index in range(len(header))]
    lines = (header, rules, *rows)
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in lines)


def update_between_markers(path: str | Path, content: str, name: str) -> bool:
    """Put text between `<!-- NAME:start -->` and `<!-- NAME:end -->` of a file; return whether the file has changed.

    A ValueError says that it cannot be read, or does not have each marker once, the start before the end.
    """
    path = Path(path)
    text, start, end = find_markers(path, name)
    newline = "\r\n" if "\r\n" in text else "\n"
    before, after = text[: text.index(start) + len(start)], text[text.index(end) :]
    changed = before + newline + content.strip().replace("\n", newline) + newline + after
    if changed != text:
        write_atomically(path, changed)
    return changed != text


def find_markers(path: Path, name: str) -> tuple[str, str, str]:
    """Return the text of a file and its markers; raises the ValueError of :func:`update_between_markers`."""
    text = read_text(path, "file with the markers")
    start, end = (f"<!-- {name}:{edge} -->" for edge in ("start", "end"))
    if text.count(start) != 1 or text.count(end) != 1 or text.index(start) > text.index(end):
        raise ValueError(f"{path} must have the markers {start} and {end} once each, in this order")
    return text, start, end


@contextlib.contextmanager
def interpreting(path: Path, what: str) -> Iterator[None]:
    """Turn every error that the content of a file causes into a ValueError of one line that names the file.

    Inside stands nothing but the making of objects out of that content: elsewhere such an error is a programmer's.
    """
    try:
        yield
    except _UNEXPECTED as error:
        reason = one_line(error)
        if isinstance(error, KeyError):
            reason = f"it misses {reason}"
        elif not isinstance(error, (OSError, ValueError)):
            reason = f"it holds what cannot be used ({type(error).__name__}: {reason})"
        name = printable(str(path))
        raise ValueError(reason if name in reason else f"the {what} {name}: {reason}") from error


def read_plain(path: Path, largest: int, *, links: bool = True, trusted: bool = False) -> bytes:
    """Return the content of a plain file, without waiting for a pipe.

    It has at most `largest` bytes, is a link only where `links` are followed, and, where it must be `trusted`, is
    nothing that another user can write. Else it is an OSError, or a ValueError if the path holds a null byte.
    """

    def opened(name: str, flags: int) -> int:
        flags |= 0 if links else getattr(os, "O_NOFOLLOW", 0)
        return os.open(name, flags | getattr(os, "O_NONBLOCK", 0))

    if path.is_socket() or (path.is_symlink() and not links):
        raise OSError(errno.EINVAL, "it is no plain file", str(path))
    with open(path, "rb", opener=opened) as file:
        # Of the open file: the name could stand for another one by now.
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is no plain file", str(path))
        if trusted and not is_trusted(status):
            raise PermissionError(errno.EPERM, "another user could change it", str(path))
        # It may grow meanwhile.
        content = file.read(largest + 1) if status.st_size <= largest else b""
    if (size := max(status.st_size, len(content))) > largest:
        raise OSError(errno.EFBIG, f"it has {size} bytes; allowed: at most {largest}", str(path))
    return content


def read_bytes(path: Path, what: str) -> bytes:
    """Return the content of a plain file of a kind in :data:`LARGEST_BYTES`; a ValueError says why it is not read."""
    try:
        return read_plain(path, LARGEST_BYTES[what])
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"cannot read the {what} {printable(str(path))}: {reason}") from error


def read_text(path: Path, what: str, *, or_latin: bool = False) -> str:
    """Return the text of a file, see :func:`read_bytes`; a ValueError, too, if it is not UTF-8, `or_latin` Latin-1."""
    content = read_bytes(path, what)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        if or_latin:
            return content.decode("latin-1")
        raise ValueError(f"the {what} {printable(str(path))} is not UTF-8 text: {error}") from error


def read_json(path: Path, what: str) -> Any:
    """Return the data of a JSON file; a ValueError of :func:`read_text` or :func:`parse_json` names the file."""
    return parse_json(read_text(path, what), f"the {what} {printable(str(path))}")


def parse_json(text: str, where: str) -> Any:
    """Return the data of a JSON text; `where` it is from, for the message.

    A ValueError says that it is not JSON, gives a key twice, is nested deeper than 20 levels, has more than 131072
    lists and objects, or holds half a character, a number that is not finite or a whole number of 2^64 or more.
    """

    if text.count("[") + text.count("{") > _MOST_INNER:
        raise ValueError(f"{where} has more than {_MOST_INNER} lists and objects")

    def refuse(name: str) -> Any:
        raise ValueError(f"{name} is not a finite number")

    try:
        data = json.loads(text, parse_constant=refuse, object_pairs_hook=_with_each_key_once)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where} is not JSON, or was cut short: {error}") from error
    require_plain(data, where, len(text), infinite=False)
    return data


def _with_each_key_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        ((twice, _),) = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"it gives the key {twice!r} more than once")
    return data


def read_toml(path: Path, what: str) -> dict[str, Any]:
    """Return the data of a TOML file; a ValueError of :func:`read_text` or :func:`parse_toml` names it."""
    return parse_toml(read_text(path, what), f"the {what} {printable(str(path))}")


def parse_toml(text: str, where: str) -> dict[str, Any]:
    """Return the data of a TOML text; `where` it is from, for the message.

    A ValueError says that it is not TOML, is nested deeper than 20 levels, or holds a whole number of 2^64 or more.
    """
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{where} is not TOML: {error}") from error
    require_plain(data, where, len(text), infinite=True)
    return data


def require_plain(data: Any, where: str, most: int, *, infinite: bool) -> None:
    """Refuse what the code after a reader could not convert or print; `where` it is from, for the message.

    A ValueError says that nests are deeper than 20 levels, a level has more than `most` values, a key is no text, a
    text holds half a character, a number is not finite, unless it may be `infinite`, a whole number is 2^64 or more, or
    a value is of another kind. A text has fewer values than characters, unless it names some again and again (YAML).
    """
    level: list[Any] = [data]
    for _ in range(_DEEPEST + 1):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                if not all(isinstance(key, str) for key in value):
                    raise ValueError(f"{where} holds a key that is no text")
                inner += [*value, *value.values()]
            elif isinstance(value, list):
                inner += value
            elif problem := _problem(value, infinite):
                raise ValueError(f"{where} holds {problem}")
            if len(inner) > most:
                raise ValueError(f"{where} holds more than {most} values on one level")
        if not inner:
            return
        level = inner
    raise ValueError(f"{where} is nested deeper than {_DEEPEST} levels")


def _problem(value: Any, infinite: bool) -> str:
    if isinstance(value, str):
        has_half = not value.isascii() and any("\ud800" <= sign <= "\udfff" for sign in value)
        return "a text with half a character (a lone surrogate)" if has_half else ""
    if isinstance(value, float):
        return "" if infinite or math.isfinite(value) else "a number that is not a finite number in floating point"
    if value is None or isinstance(value, int):
        too_large = value is not None and abs(value) >= _LARGEST_WHOLE
        return "a whole number outside the allowed range -2^64 … 2^64" if too_large else ""
    return f"a {type(value).__name__}; allowed: texts, numbers, lists and objects"
