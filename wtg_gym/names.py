"""One rule for the names of laws, entries and people, and for the lines of text about them.

They stand in terminals, spreadsheets, Markdown and HTML, and must be nothing but text there: no markup, link, formula
or command, and no sign that looks like another one or like nothing.
"""

import re
from typing import Any

#: Signs that may stand in a name besides letters, digits and blanks, and in a text.
_NAME_SIGNS = "'()+-.,=_&"
_TEXT_SIGNS = f"{_NAME_SIGNS}/:;%!?"
_LONGEST_NAME, _LONGEST_TEXT = 60, 400
#: `_so_` would be set in italics, `a_b` is not; `:so:` is a picture, `so:so` may be an address, `&so` may be a sign;
#: `1. ` begins a list, `GH-1` is a link, and `; =` a formula where a spreadsheet separates by semicolons.
_MARKUP = re.compile(r"(?<![A-Z0-9])_|_(?![A-Z0-9])|[:&](?! )|www\.|^\d+[.)](?= |$)|\bGH-\d|; *[-=+]", re.IGNORECASE)
#: Small letters and digits that are one line or one ring in many typefaces.
_SAME = str.maketrans("1i0", "llo")


def check_name(what: str, value: Any) -> str:
    """Return a name of 1 … 60 characters; a ValueError names `what` it is, and what is allowed."""
    if not isinstance(value, str) or not 1 <= len(value) <= _LONGEST_NAME or not _is_plain(value, _NAME_SIGNS):
        raise _error(what, value, f"1 … {_LONGEST_NAME}", _NAME_SIGNS)
    return value


def check_text(what: str, value: Any) -> str:
    """Return a line of up to 400 characters, which may be empty; errors as of :func:`check_name`."""
    if value == "":
        return ""
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT or not _is_plain(value, _TEXT_SIGNS):
        raise _error(what, value, f"up to {_LONGEST_TEXT}", _TEXT_SIGNS)
    return value


def _is_plain(text: str, signs: str) -> bool:
    allowed = text.isascii() and all(sign.isalnum() or sign in f" {signs}" for sign in text)
    return allowed and text[0].isalnum() and text[-1] != " " and _MARKUP.search(text) is None


def _error(what: str, value: Any, length: str, signs: str) -> ValueError:
    return ValueError(
        f"{what} must be {length} characters on one line: letters and digits of ASCII, blanks and {signs}, a "
        "letter or digit first, _ within words, : and & before a blank, no markup, formula or address; "
        f"got {short(value)}"
    )


def plain_name(name: str) -> str:
    """Return what people read of a name: no capitals, blanks and signs, and letters as what they look like."""
    return "".join(sign for sign in name.casefold().translate(_SAME) if sign.isalnum())


def short(value: Any) -> str:
    """Return a stranger's value as at most 80 harmless characters."""
    try:
        text = ascii(value)
    # Python writes no number of more than 4300 digits.
    except (ValueError, RecursionError):
        text = f"a very long {type(value).__name__}"
    return text if len(text) <= 80 else text[:77] + "..."
