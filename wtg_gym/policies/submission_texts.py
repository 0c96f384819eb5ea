"""Names and texts of a submission. They stand in Markdown and HTML: nothing may be markup, a link, or unseen."""

from __future__ import annotations

import re
import unicodedata
from typing import Any

_NAME_SIGNS = " ()+-.,=_"
#: Quantities that a name may speak of.
_GREEK = "βγδκλμπτω"
#: The table says itself how many seeds a row has: "seed" in any word, or spread over signs.
_SEED = re.compile("seed|(?<![a-z])s[^a-z]*e[^a-z]*e[^a-z]*d", re.IGNORECASE)
#: All signs of ASCII that a text may have; a colon and an ampersand only before a blank, an underscore within a word.
_TEXT_SIGNS = " '\"(),-./:;%+=!?&_"
#: All signs beyond ASCII but for letters of Latin, Greek and Cyrillic.
_FURTHER_SIGNS = "·×±°µ–—…’‘“”«»−≤≥≈→²³¹⁰⁴⁵⁶⁷⁸⁹⁻₀₁₂₃₄₅₆₇₈₉½¼¾"
_LETTER = re.compile("(LATIN|GREEK|CYRILLIC) (SMALL|CAPITAL) LETTER ")
#: Forms of letters for old systems begin here.
_FORMS = 0xFB00
_LONGEST_NAME, _LONGEST_TEXT = 60, 400
#: `_so_` would be set in italics, `a_b` is not; `:so:` is a picture, `so:so` may be an address; `1. ` begins a list.
_MARKUP = re.compile(r"(?<![^\W_])_|_(?![^\W_])|[:&](?! )|www\.|^\d+[.)](?= |$)", re.IGNORECASE)


def check_name(value: str) -> str:
    """Return the name of an entry; a ValueError says what is allowed."""
    allowed = (
        f"name must be 1 … {_LONGEST_NAME} letters, digits and signs out of {_NAME_SIGNS.strip()}{_GREEK} or blanks, "
        "begin with a letter or digit, have _ within words only, and say nothing of seeds, which the table counts"
    )
    # Letters of other scripts look like these, or like nothing at all.
    plain = all((sign.isascii() and sign.isalnum()) or sign in _NAME_SIGNS + _GREEK for sign in value)
    fits = 1 <= len(value) <= _LONGEST_NAME and value[0].isalnum() and value == value.strip()
    if not plain or not fits or _MARKUP.search(value) or _SEED.search(value):
        raise ValueError(f"{allowed}; got {short(value)}")
    return value


def check_author(value: str) -> str:
    """Return a name of a person or a group, in Latin, Greek or Cyrillic letters; a ValueError says what is allowed."""
    if not any(sign.isalpha() for sign in value):
        raise ValueError(f"an author must be a text with letters, got {short(value)}")
    return check_text("an author", value)


def check_text(key: str, value: str) -> str:
    """Return a line of plain text, which may be empty; a ValueError says what is allowed."""
    if len(value) > _LONGEST_TEXT or not _is_plain(value):
        raise ValueError(
            f"{key} must be up to {_LONGEST_TEXT} visible characters on one line: Latin, Greek or Cyrillic letters (in "
            f"the form NFC), digits, blanks and the signs {_TEXT_SIGNS.strip()}{_FURTHER_SIGNS}, with : and & before a "
            f"blank and _ within a word; no markup and no addresses; got {short(value)}"
        )
    return value


def _is_plain(text: str) -> bool:
    signs = all(
        sign.isalnum() or sign in _TEXT_SIGNS if sign.isascii() else sign in _FURTHER_SIGNS or _is_letter(sign)
        for sign in text
    )
    if not signs or unicodedata.normalize("NFC", text) != text or text != text.strip() or _MARKUP.search(text):
        return False
    return not text or text[0].isalnum() or text[0] in "('\""


def _is_letter(sign: str) -> bool:
    return sign.isalpha() and ord(sign) < _FORMS and _LETTER.match(unicodedata.name(sign, "")) is not None


def short(value: Any) -> str:
    """Return a stranger's value as at most 80 harmless characters."""
    try:
        text = ascii(value)
    # Python writes no number of more than 4300 digits.
    except (ValueError, RecursionError):
        text = f"a very long {type(value).__name__}"
    return text if len(text) <= 80 else text[:77] + "..."
