"""Names, authors and texts of tables: legal ones pass; markup, links and invisible characters do not."""

from __future__ import annotations

import functools
import unicodedata
from collections.abc import Callable

import pytest

from wtg_gym.policies.submission_texts import check_author, check_name, check_text

#: Separated by line feeds.
AUTHORS = """\
Jane Doe
The wtg_gym authors
Łukasz Żółć-Nowak
José Ñúñez Ångström
Đặng Thị Ngọc
O'Brien, Seán (ETH)
Юрий Жёлтый
李明
山田 太郎・々ー
محمد بن علي
राजेश कुमार
מֹשֶׁה כהן
مُحَمَّد بن علي
𠮷野 家"""


def test_authors_of_many_scripts_and_ordinary_texts_are_legal() -> None:
    for author in unicodedata.normalize("NFC", AUTHORS).splitlines():
        assert check_author(author) == author
    for text in ("", "k and τ, 2·10⁶ steps", "standard, split train: 64 scenarios", "PPO (k+τ) at 50 %"):
        assert check_text("description", text) == text


#: Would be markup, a link, an address or a command, or has a blank at an end.
MARKUP = (
    *("a *b* c", "a _b_ c", "a __b__ c", "[a](b)", "![a](b)", "<b>a</b>", "a &lt; b", "a `b`", "a | b", "a \\ b"),
    *("a ~~b~~", "a $b$", "# a", "- a", "1. a", "see #1", "see @a", "a@example.org", "https://example.org"),
    *("WWW.example.org", "mailto:a", "a :tada: b", "a\nb", "a\rb", "a\tb", "a\x1b[31mb", " a", "a "),
    # Marks in a heap, an accent apart, and vowel signs without a letter of their script or too many of them.
    *("a\u0336\u0336b", "e\u0301", "a ก" + "\u0e49" * 5, "a\u0e49", "ก \u0e49", "ก\u093f", "क\u0301"),
)
#: Are not seen, change the direction or other signs, are pictures or private, or are drawn for other letters: notes,
#: fillers of Hangul, Braille, joiners, marks of direction, blanks, separators, variants, tags, overlays, ligatures,
#: emoji, flags, bold and wide letters, lines and brackets that look like a table's and a tag's, and dead scripts.
SIGNS = (
    "\U0001d159\U0001d173\u115f\u1160\u3164\uffa0\u1100\u2800\u200b\u200d\u200c\u2060\u2064\ufeff\u00ad\u034f\u200e"
    "\u061c\u202e\u2066\u2067\u2069\u2003\u202f\u00a0\u3000\u1680\u180e\u2028\u2029\ufe0e\ufe0f\U000e0100\U000e0041"
    "\U000e0061\U000f0000\ue000\uffff\u0378\u0085\u0336\u20dd\u0301\u17b4\u093f\ufff9\ufffc\ufffd\U0001f3c6\u2603"
    "\U0001f1ea\U0001d400\uff21\u24b6\ufb01\u02b0\u0640\u2223\uff5c\u2039\uff1c\uff20\u2044\u2024\u037e\U00013000"
    "\U00012000\u16a0"
)


@pytest.mark.parametrize("check", [check_name, check_author, functools.partial(check_text, "trained_on")])
def test_markup_links_commands_and_signs_that_no_text_needs_are_refused(check: Callable[[str], str]) -> None:
    for text in (*MARKUP, *(text for sign in SIGNS for text in (f"a{sign}b", f"Jane Doe{sign}", f"{sign}Jane"))):
        with pytest.raises(ValueError, match="must be"):
            check(text)


@pytest.mark.parametrize("author", ["", " ", "\u3164", "...", "42", "\u2800\u2800"])
def test_authors_without_letters_are_refused(author: str) -> None:
    with pytest.raises(ValueError, match="an author must be"):
        check_author(author)


#: Too long or of other letters, and with the word for what the table counts.
NAMES = (
    *("", "x" * 61, "coordinated-undämped", "\uff21", "Мine", "(a)", "Mine (training seed 0)", "PPO (k) (5 seeds)"),
    *("Mine, 9 seeds", "Mine (1 Seed)", "M 5_seeds", "M5seeds", "M 5 S.E.E.D.S", "5_training_seeds", "Mine seeds=5"),
)


@pytest.mark.parametrize("name", NAMES)
def test_names_that_are_long_or_of_other_letters_or_speak_of_seeds_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"name must be 1 … 60 letters.*say nothing of seeds"):
        check_name(name)
