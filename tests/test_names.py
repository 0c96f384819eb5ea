"""One rule of names and texts at every door: they are plain text in tables, spreadsheets, Markdown and HTML."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.submissions.models import TOML, folder
from wtg_gym import Entry, Plant, TrackingLaw, get_law, get_suite, load_entries
from wtg_gym.envs import EnvSettings
from wtg_gym.names import check_name, check_text, plain_name
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.tracking_law import read_law
from wtg_gym.policies.entry_folder import parse_submission
from wtg_gym.ranges import ByName

LAW = {"k_min": 1.0, "k_nominal": 0.8, "k_max": 0.6}
#: Would be another name, a formula of a spreadsheet, a command, markup, a link, an address, or has a blank at an end.
WRONG = (
    *("m\u043ept", "\u00e9", "\uff21", "x\u200b", "=1+1", "@SUM(A1)", "+1", "-1", "a;=1+1", "a; -1"),
    *("\tx", " x", "x ", "", "'x", "x\n", "x\x1b[31m", "a *b* c", "a _b_ c", "a __b__ c", "[a](b)", "<b>a</b>"),
    *("a &lt; b", "a `b`", "a | b", "a \\ b", "a ~b~", "a $b$", "# a", "1. a", "see #1", "see GH-1", "see @a"),
    *("a@example.org", "https://example.org", "WWW.example.org", "a :b: c"),
)
DOORS: dict[str, Callable[[str, Path], object]] = {
    "law": lambda name, _: TrackingLaw(name=name, **LAW),
    "law file": lambda name, path: read_law(_law(name, path / "x.toml")),
    "law file as an entry": lambda name, path: load_entries(_law(name, path / "x.toml")),
    "entry": lambda name, _: Entry(name=name),
    "folder": lambda name, path: load_entries(folder(path / "x", toml=TOML.replace("Mine", name))),
    "author": lambda name, path: load_entries(folder(path / "x", toml=TOML.replace("Jane Doe", name))),
    "text": lambda name, path: load_entries(folder(path / "x", toml=f'{TOML}trained_on = "{name}"\n')),
    "submission": lambda name, _: parse_submission(TOML.replace("Mine", name).encode()),
}
MISSPELT_ENTRIES = {
    **{"folder/mine.py": "folder.mine:ENTRY", "folder/mine.py:own": "folder.mine:own"},
    **{"Coordinated-Tunned": "coordinated-tuned", "fast-drop": "fast-droop", "polices": "policies"},
}
MISSPELT = [
    (lambda: get_suite("standrad"), "standard"),
    (lambda: EnvSettings(version="v1", suite="wek-grid-v1"), "weak-grid-v1"),
    (lambda: get_suite("standard").seeds("tests"), "test"),
    (lambda: EnvSettings(version="V1"), "v1"),
    (lambda: EnvSettings(plant={"physics": "extented"}).resolved_plant, "extended"),
    (lambda: Plant().replaced(physics="nrel_5mw"), "nrel-5mw"),
    (lambda: EnvSettings(action_mode="k+taw"), "k+tau"),
    (lambda: EnvSettings(action_mode="tau+k"), "k+tau"),
    (lambda: EnvSettings(weights={"dutty": 0.0}).cost_weights(), "duty"),
    (lambda: get_grid("kundru"), "kundur"),
    (lambda: get_law("mptt"), "mppt"),
    (lambda: get_law("tuned"), "coordinated-tuned"),
    (lambda: EnvSettings(split="val"), "validation"),
    *((lambda spec=spec: load_entries(spec), nearest) for spec, nearest in MISSPELT_ENTRIES.items()),
    (lambda: ByName("agent", {"wtg0": 0})["wtg"], "wtg0"),
]


def test_ordinary_names_and_texts_are_legal():
    for name in ("x", "Jane Doe", "O'Brien, Sean (ETH)", "The wtg_gym authors", "PPO (k, tau)", "SAC, k+tau", "A & B"):
        assert check_name("it", name) == name
    for text in ("", "standard, split train: 64 scenarios; 2e6 steps", "1.5 % of k/tau, see the paper!"):
        assert check_text("it", text) == text


@pytest.mark.parametrize("text", WRONG)
def test_what_is_more_than_text_is_refused(text):
    with pytest.raises(ValueError, match="it must be 1 … 60 characters on one line"):
        check_name("it", text)
    if text:
        with pytest.raises(ValueError, match="it must be up to 400 characters on one line"):
            check_text("it", text)


@given(st.text(max_size=70))
def test_names_are_ascii_begin_with_a_letter_or_digit_and_are_short(text):
    try:
        check_name("it", text)
    except ValueError as error:
        assert str(error).isprintable() and len(str(error)) < 400
    else:
        assert text.isascii() and text.isprintable() and text[0].isalnum() and len(text) <= 60


def _law(name: str, path: Path) -> Path:
    path.write_text(f'name = "{name}"\n' + "".join(f"{key} = {k}\n" for key, k in LAW.items()), encoding="utf-8")
    return path


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("name", ["m\u043ept", "=1+1", "@SUM(A1)", "<b>"])
def test_every_door_has_the_rule(door, name, tmp_path):
    DOORS[door]("Another", tmp_path / "legal" if door in ("folder", "author", "text") else tmp_path)
    with pytest.raises(ValueError, match="characters on one line"):
        DOORS[door](name, tmp_path)


def test_names_that_look_alike_are_one():
    assert {plain_name(name) for name in ("PPO (k, t)", "ppo k,t", "P.P.O. kT")} == {"ppokt"}
    assert {plain_name(name) for name in ("Iinear", "1inear", "LINEAR", "l-i-n-e-a-r")} == {plain_name("linear")}
    assert plain_name("SAC 0") == plain_name("SAC O") != plain_name("SAC 8")


@pytest.mark.parametrize(("look_up", "nearest"), MISSPELT)
def test_a_misspelt_name_is_refused_with_the_nearest(look_up, nearest):
    with pytest.raises((ValueError, KeyError), match=f"; did you mean '{nearest.replace('+', '.')}'\\?"):
        look_up()
