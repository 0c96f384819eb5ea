"""Names, authors and texts of tables: legal ones pass; markup, links and invisible characters do not."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import pytest

from tests.submissions.models import TOML, folder
from wtg_gym.policies.gate import check_submission
from wtg_gym.policies.names import plain_name
from wtg_gym.policies.submission_texts import check_author, check_name, check_text

#: Separated by line feeds.
AUTHORS = """\
Jane Doe
The wtg_gym authors
Łukasz Żółć-Nowak
José Ñúñez Ångström
Đặng Thị Ngọc
O'Brien, Seán (ETH)
Nikos Papadópoulos, Νίκος Παπαδόπουλος
Юрий Жёлтый
李明
山田 太郎・々ー
김철수
محمد بن علي
Müller & Söhne
राजेश कुमार
สมชาย ศรีสุวรรณ์
তানভীর হাসান
தமிழ்ச்செல்வன்
សុខ សុភា
သန်းရွှေ
מֹשֶׁה כהן
مُحَمَّد بن علي
አበበ ቢቂላ
Արամ Խաչատրյան
ნინო ბერიძე
Kaʻiulani ʻOkina
𠮷野 家"""


@pytest.mark.parametrize("author", AUTHORS.splitlines())
def test_authors_of_many_scripts_are_legal(author: str) -> None:
    assert check_author(unicodedata.normalize("NFC", author)) == unicodedata.normalize("NFC", author)


@pytest.mark.parametrize(
    "text", ["", "k and τ, 2·10⁶ steps", "standard, split train: 64 scenarios", "PPO (k+τ) at 50 %"]
)
def test_ordinary_texts_are_legal(text: str) -> None:
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


@pytest.mark.parametrize("text", MARKUP, ids=ascii)
def test_markup_links_and_commands_are_refused(text: str) -> None:
    for check in (check_name, check_author, lambda text: check_text("trained_on", text)):
        with pytest.raises(ValueError, match="must be"):
            check(text)


@pytest.mark.parametrize("sign", SIGNS, ids=ascii)
def test_signs_that_no_text_needs_are_refused(sign: str) -> None:
    for text in (f"a{sign}b", f"Jane Doe{sign}", f"{sign}Jane"):
        for check in (check_name, check_author, lambda text: check_text("trained_on", text)):
            with pytest.raises(ValueError, match="must be"):
                check(text)


@pytest.mark.parametrize("author", ["", " ", "\u3164", "...", "42", "\u2800\u2800"])
def test_authors_without_letters_are_refused(author: str) -> None:
    with pytest.raises(ValueError, match="an author must be"):
        check_author(author)


@pytest.mark.parametrize("name", ["", "x" * 61, "coordinated-undämped", "\uff21", "Мine", "(a)"])
def test_names_that_are_long_or_of_other_letters_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="name must be 1 … 60 letters"):
        check_name(name)


@pytest.mark.parametrize(
    "name", ["PPO (k) (5 seeds)", "Mine, 9 seeds", "Mine (1 Seed)", "M 5_seeds", "M5seeds", "M 5 S.E.E.D.S"]
)
def test_name_says_nothing_about_seeds(name: str) -> None:
    with pytest.raises(ValueError, match="say nothing of seeds"):
        check_name(name)


def test_names_and_letters_that_look_alike_are_one() -> None:
    assert {plain_name(name) for name in ("PPO (k, τ)", "ppo k,t", "PPO-κ-τ", "P.P.O. kT")} == {"ppokt"}
    assert {plain_name(name) for name in ("Iinear", "1inear", "LINEAR", "l-i-n-e-a-r")} == {plain_name("linear")}
    assert plain_name("PPO (k)") != plain_name("PPO (τ)")
    assert plain_name("SAC 0") == plain_name("SAC O") != plain_name("SAC 8")


@pytest.mark.parametrize("line", ['description = "_a_"', 'trained_on = "a@b"', 'authors = ["a", "*b*"]'])
def test_the_gate_looks_at_every_text(line: str, tmp_path: Path) -> None:
    toml = TOML.replace('authors = ["Jane Doe"]\n', "") if line.startswith("authors") else TOML
    refusal = check_submission(folder(tmp_path / "a", toml=toml + line + "\n")).refusal
    assert refusal is not None and refusal.name == "entry.toml" and "no markup" in refusal.reason
