"""Names, texts and links of a submission. They stand in Markdown and HTML: nothing may be markup, a link, or unseen."""

from __future__ import annotations

import re
import unicodedata
from typing import Any

from wtg_gym.physics.tracking_law import STRATEGY_NAMES

_NAME_SIGNS = " ()+-.,=_"
#: Quantities that a name may speak of, and the letters that some of them look like.
_GREEK = "βγδκλμπτω"
_LOOKS = str.maketrans("βγκτω", "byktw")
#: Small letters and digits that are one line or one ring in many typefaces.
_SAME = str.maketrans("1i0", "llo")
#: Names of a checkout's own entries that submissions cannot have: one row, one maker.
TAKEN = (*STRATEGY_NAMES, "tip-speed-feedback", "fast-droop")
#: The table says itself how many seeds a row has.
_SEEDS = re.compile(r"\d\W*seeds?\b", re.IGNORECASE)
#: All signs of ASCII that a text may have; a colon and an ampersand only before a blank, an underscore within a word.
_TEXT_SIGNS = " '\"(),-./:;%+=!?&_"
#: Letters that are drawn as a blank or not at all, and the empty pattern of Braille.
_UNSEEN = "\u115f\u1160\u3164\uffa0\u2800"
_LONGEST_NAME, _LONGEST_TEXT, _LONGEST_LINK = 60, 400, 200
_LINK = re.compile(r"https://[A-Za-z0-9][A-Za-z0-9.-]*\.[A-Za-z]{2,24}(/[A-Za-z0-9._~/%#?=&+-]*)?")
#: `_so_` would be set in italics, `a_b` is not; `:so:` is a picture, `so:so` may be an address; `1. ` begins a list.
_MARKUP = re.compile(r"(?<![^\W_])_|_(?![^\W_])|[:&](?! )|www\.|^\d+[.)](?= |$)", re.IGNORECASE)


def check_name(value: Any) -> str:
    """Return the name of an entry; a ValueError says what is allowed."""
    allowed = (
        f"name must be 1 … {_LONGEST_NAME} letters, digits and signs out of {_NAME_SIGNS.strip()}{_GREEK} or blanks, "
        f"begin with a letter or digit, have _ within words only, give no number of seeds, and be none of "
        f"{', '.join(TAKEN)}"
    )
    if not isinstance(value, str) or not 1 <= len(value) <= _LONGEST_NAME:
        raise ValueError(f"{allowed}; got {short(value)}")
    # Letters of other scripts look like these, or like nothing at all.
    plain = all((sign.isascii() and sign.isalnum()) or sign in _NAME_SIGNS + _GREEK for sign in value)
    taken = plain_name(value) in {plain_name(name) for name in TAKEN} or _SEEDS.search(value)
    if not plain or not value[0].isalnum() or value != value.strip() or _MARKUP.search(value) or taken:
        raise ValueError(f"{allowed}; got {short(value)}")
    return value


def plain_name(name: str) -> str:
    """Return what people read of a name: no capitals, blanks and signs, and letters as what they look like."""
    plain = name.translate(_LOOKS).casefold().translate(_SAME)
    return "".join(sign for sign in plain if sign.isalnum())


def check_author(value: Any) -> str:
    """Return a name of a person or a group, in letters of any script; a ValueError says what is allowed."""
    if not isinstance(value, str) or not any(sign.isalpha() for sign in value):
        raise ValueError(f"an author must be a text with letters, got {short(value)}")
    return check_text("an author", value)


def check_text(key: str, value: Any) -> str:
    """Return a line of plain text, which may be empty; a ValueError says what is allowed."""
    if not isinstance(value, str) or len(value) > _LONGEST_TEXT or not _is_plain(value):
        raise ValueError(
            f"{key} must be up to {_LONGEST_TEXT} visible characters on one line: letters with their accents (in the "
            f"form NFC), digits, and of the signs of ASCII {_TEXT_SIGNS.strip()} alone, : and & before a blank and _ "
            f"within a word; no markup and no addresses (those are for links); got {short(value)}"
        )
    return value


def _is_plain(text: str) -> bool:
    for sign in text:
        if sign.isascii():
            allowed = sign.isalnum() or sign in _TEXT_SIGNS
        else:
            # Not printable in Python are controls, changes of direction, other blanks and unassigned signs.
            allowed = sign.isprintable() and sign not in _UNSEEN and not unicodedata.category(sign).startswith("M")
        if not allowed:
            return False
    if unicodedata.normalize("NFC", text) != text or text != text.strip() or _MARKUP.search(text):
        return False
    return not text or text[0].isalnum() or text[0] in "('\""


def check_link(value: Any) -> str:
    """Return a plain https address; a ValueError says what is allowed."""
    if not isinstance(value, str) or len(value) > _LONGEST_LINK or _LINK.fullmatch(value) is None:
        raise ValueError(f"a link must be a plain https:// address of up to {_LONGEST_LINK}, got {short(value)}")
    return value


def short(value: Any) -> str:
    """Return a stranger's value as at most 80 harmless characters."""
    try:
        text = ascii(value)
    # Python writes no number of more than 4300 digits.
    except (ValueError, RecursionError):
        text = f"a very long {type(value).__name__}"
    return text if len(text) <= 80 else text[:77] + "..."
