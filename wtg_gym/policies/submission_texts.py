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
#: All signs beyond ASCII but for letters of :data:`_SCRIPTS`; the last ones repeat, stretch or break a sound.
_FURTHER_SIGNS = "·×±°µ–—…’‘“”«»−≤≥≈→²³¹⁰⁴⁵⁶⁷⁸⁹⁻₀₁₂₃₄₅₆₇₈₉½¼¾№、。・々ーゝゞヽヾๆໆៗʻʼ"
#: First words of the names of letters: the scripts that Unicode recommends for names (UAX 31, table 5).
_SCRIPTS = re.compile(
    "ARABIC|ARMENIAN|BENGALI|BOPOMOFO|CJK|CYRILLIC|DEVANAGARI|ETHIOPIC|GEORGIAN|GREEK|GUJARATI|GURMUKHI|HANGUL|HEBREW|"
    "HIRAGANA|KANNADA|KATAKANA|KHMER|LAO|LATIN|MALAYALAM|MYANMAR|ORIYA|SINHALA|TAMIL|TELUGU|THAANA|THAI|TIBETAN"
)
#: What of two of them is made of single letters alone: the rest are parts, fillers and forms for old systems.
_SECOND_WORDS = {"HANGUL": "SYLLABLE", "CJK": "UNIFIED"}
#: Forms of letters for old systems begin here; Chinese goes on from the second number.
_FORMS, _FURTHER_CHINESE = 0xFB00, 0x20000
#: Vowels of Khmer that are not drawn.
_UNSEEN = "\u17b4\u17b5"
#: Vowel signs and tones that may follow a letter: there are no more in a word of these scripts.
_MOST_MARKS = 4
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
    """Return a name of a person or a group, in letters of any script; a ValueError says what is allowed."""
    if not any(sign.isalpha() for sign in value):
        raise ValueError(f"an author must be a text with letters, got {short(value)}")
    return check_text("an author", value)


def check_text(key: str, value: str) -> str:
    """Return a line of plain text, which may be empty; a ValueError says what is allowed."""
    if len(value) > _LONGEST_TEXT or not _is_plain(value):
        raise ValueError(
            f"{key} must be up to {_LONGEST_TEXT} visible characters on one line: letters of living scripts (in the "
            f"form NFC), digits, blanks and the signs {_TEXT_SIGNS.strip()}{_FURTHER_SIGNS}, with : and & before a "
            f"blank and _ within a word; no markup and no addresses; got {short(value)}"
        )
    return value


def _is_plain(text: str) -> bool:
    # The script of the letter before, and the marks since.
    script, marks = "", 0
    for sign in text:
        if sign.isascii():
            allowed, script = sign.isalnum() or sign in _TEXT_SIGNS, ""
        elif sign in _FURTHER_SIGNS:
            allowed, script = True, ""
        elif unicodedata.category(sign).startswith("M"):
            marks += 1
            allowed = script != "" and script == _script(sign) and marks <= _MOST_MARKS
        else:
            script, marks = _script(sign), 0
            allowed = script != "" and unicodedata.category(sign) in ("Lu", "Ll", "Lt", "Lo")
        if not allowed:
            return False
    if unicodedata.normalize("NFC", text) != text or text != text.strip() or _MARKUP.search(text):
        return False
    return not text or text[0].isalnum() or text[0] in "('\""


def _script(sign: str) -> str:
    """Return the first word of the Unicode name of a letter or mark if it is an allowed one, else nothing."""
    first, second, *_ = f"{unicodedata.name(sign, '')}  ".split(" ")
    ordinary = ord(sign) < _FORMS or (first == "CJK" and ord(sign) >= _FURTHER_CHINESE)
    own = _SCRIPTS.fullmatch(first) and second.startswith(_SECOND_WORDS.get(first, ""))
    return first if ordinary and own and sign not in _UNSEEN else ""


def short(value: Any) -> str:
    """Return a stranger's value as at most 80 harmless characters."""
    try:
        text = ascii(value)
    # Python writes no number of more than 4300 digits.
    except (ValueError, RecursionError):
        text = f"a very long {type(value).__name__}"
    return text if len(text) <= 80 else text[:77] + "..."
