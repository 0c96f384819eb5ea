"""Names, authors and texts of tables: legal ones pass; markup, links and invisible characters do not."""

from __future__ import annotations

import unicodedata
from pathlib import Path

import pytest

from tests.submissions.models import TOML, folder
from wtg_gym.policies.gate import check_submission
from wtg_gym.policies.names import plain_name
from wtg_gym.policies.submission_texts import check_author, check_name, check_text


@pytest.mark.parametrize(
    "author",
    [
        "Jane Doe",
        "The wtg_gym authors",
        "Łukasz Żółć-Nowak",
        "José Ñúñez Ångström",
        "Đặng Thị Ngọc",
        "O'Brien, Seán (ETH)",
        "Nikos Papadópoulos, Νίκος Παπαδόπουλος",
        "Юрий Жёлтый",
        "李明",
        "山田 太郎・々ー",
        "김철수",
        "محمد بن علي",
        "Müller & Söhne",
    ],
)
def test_authors_of_many_scripts_are_legal(author: str) -> None:
    assert check_author(unicodedata.normalize("NFC", author)) == unicodedata.normalize("NFC", author)


@pytest.mark.parametrize(
    "text", ["", "k and τ, 2·10⁶ steps", "standard, split train: 64 scenarios", "PPO (k+τ) at 50 %"]
)
def test_ordinary_texts_are_legal(text: str) -> None:
    assert check_text("description", text) == text


#: Would be markup, a link or a command, or is not what it looks like.
WRONG = {
    "emphasis": "a *b* c",
    "emphasis with underscores": "a _b_ c",
    "strong with underscores": "a __b__ c",
    "a link": "[a](b)",
    "an image": "![a](b)",
    "a tag": "<b>a</b>",
    "an entity": "a &lt; b",
    "code": "a `b`",
    "a cell": "a | b",
    "an escape": "a \\ b",
    "strikethrough": "a ~~b~~",
    "a formula": "a $b$",
    "a heading": "# a",
    "a list": "- a",
    "a numbered list": "1. a",
    "a reference": "see #1",
    "a mention": "see @a",
    "an address of mail": "a@example.org",
    "an address": "https://example.org",
    "an address without a scheme": "WWW.example.org",
    "a mail link": "mailto:a",
    "a picture by its name": "a :tada: b",
    "a line feed": "a\nb",
    "a carriage return": "a\rb",
    "a separator of lines": "a\u2028b",
    "a tabulator": "a\tb",
    "a command to the terminal": "a\x1b[31mb",
    "a change of direction": "a\u202eb",
    "an isolated direction": "a\u2067b\u2069",
    "no width": "a\u200bb",
    "a joiner": "a\u200db",
    "a soft hyphen": "a\u00adb",
    "a hard blank": "a\u00a0b",
    "a filler": "a\u3164b",
    "another filler": "a\uffa0b",
    "an empty pattern": "a\u2800b",
    "marks in a heap": "a\u0336\u0336b",
    "an accent apart": "e\u0301",
    "a variant": "a\ufe0fb",
    "a tag of no script": "a\U000e0041b",
    "for private use": "a\ue000b",
    "a blank before": " a",
    "a blank behind": "a ",
}


@pytest.mark.parametrize("what", WRONG)
def test_markup_links_and_what_is_unseen_are_refused(what: str) -> None:
    for check in (check_name, check_author, lambda text: check_text("trained_on", text)):
        with pytest.raises(ValueError, match="must be"):
            check(WRONG[what])


@pytest.mark.parametrize("author", ["", " ", "\u3164", "...", "42", "\u2800\u2800"])
def test_authors_without_letters_are_refused(author: str) -> None:
    with pytest.raises(ValueError, match="an author must be"):
        check_author(author)


@pytest.mark.parametrize(
    "name",
    [
        "",
        "x" * 61,
        "coordinated-undämped",
        "\uff21",
        "Мine",
        "(a)",
    ],
)
def test_names_that_are_long_or_of_other_letters_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="name must be 1 … 60 letters"):
        check_name(name)


def test_names_that_look_alike_are_told() -> None:
    assert {plain_name(name) for name in ("PPO (k, τ)", "ppo k,t", "PPO-κ-τ", "P.P.O. kT")} == {"ppokt"}
    assert plain_name("PPO (k)") != plain_name("PPO (τ)")


def test_the_gate_looks_at_every_text(tmp_path: Path) -> None:
    for index, line in enumerate(('description = "_a_"', 'trained_on = "a@b"', 'authors = ["a", "*b*"]')):
        toml = TOML.replace('authors = ["Jane Doe"]\n', "") if line.startswith("authors") else TOML
        refusal = check_submission(folder(tmp_path / str(index), toml=toml + line + "\n")).refusal
        assert refusal is not None and refusal.name == "entry.toml" and "no markup" in refusal.reason


@pytest.mark.parametrize(
    "name", ["PPO (k) (5 seeds)", "Mine, 9 seeds", "Mine (1 Seed)", "M 5_seeds", "M5seeds", "M 5 S.E.E.D.S"]
)
def test_name_says_nothing_about_seeds(name: str) -> None:
    with pytest.raises(ValueError, match="say nothing of seeds"):
        check_name(name)


@pytest.mark.parametrize("name", ["Iinear", "1inear", "LINEAR", "l-i-n-e-a-r"])
def test_letters_that_look_alike_are_one(name: str) -> None:
    assert plain_name(name) == plain_name("linear")
    assert plain_name("SAC 0") == plain_name("SAC O") != plain_name("SAC 8")
