"""Names that are taken, texts that are not what they look like, and entry.toml in every shape: what the gate says.

A stranger's folder is found by its name and by its entry's, so neither may be what something else is found by.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.submissions import models
from tests.submissions.models import TOML, folder, info, node
from tests.submissions.models import model as make
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.tracking_law import STRATEGY_NAMES
from wtg_gym.policies import gate
from wtg_gym.policies.conflicts import conflicts
from wtg_gym.policies.entry_toml import parse_entry
from wtg_gym.policies.gate import check_submission
from wtg_gym.policies.load import policy_folders, policy_name
from wtg_gym.policies.submission_folder import parse_submission
from wtg_gym.policies.submission_texts import check_author, check_text
from wtg_gym.scenarios.benchmark import V0, V1

POLICIES = Path(__file__).resolve().parents[2] / "agents" / "policies"


def refused(path: Path) -> tuple[str, str]:
    """The check that refuses a folder, and why, which is one line."""
    refusal = check_submission(path, rollout_only=True).refusal
    assert refusal is not None and refusal.reason.isprintable()
    return refusal.name, refusal.reason


# --- names that are taken --------------------------------------------------------------------------------------------

FOLDERS = [
    "baselines",
    "Baselines",
    "base-lines",
    "baselines.fast_droop",
    "policies",
    "po1icies",
    "POLICIES.",
    "agents",
    "agents.train",
    "tests",
    "wtg_gym",
    "wtg-gym.evaluation",
    "mppt",
    "MPPT",
    "coordinated-tuned",
    "coordinated_tuned",
    "deloaded5",
    "fast-droop",
    "fast_droop",
    "FastDroop",
    "tip-speed-feedback",
    "tip.speed.feedback",
    "T1p-Speed-Feedback",
    "ppo-k-0",
    "PPO-K-0",
    "ppo-k-O",
    "ppo-k",
    "ppo-ktau-0",
    "linear-feedback",
    "linear_feedback",
    "gradient-LSTM",
    "numpy",
    "os.path",
    "torch.nn",
    "json",
    "\u017fac-v1-0",
    "ppo-\u212a-0",
]
NAMES = [
    "baselines",
    "policies",
    "Policies",
    "b a s e l i n e s",
    "baselines.mppt",
    "mppt",
    "Coordinated-Piecewise",
    "coordinated piecewise",
    "coordinated (tuned)",
    "fast-droop",
    "Fast Droop",
    "fast droop.",
    "tip-speed feedback",
    "TIP_SPEED_FEEDBACK",
    "ppo-k-0",
    "PPO k 0",
    "PPO (k)",
    "PPO-κ",
    "ppo k, t",
    "Iinear-feedback",
    "PPO",
    "sac-v1-2",
    "numpy",
    "Mine 5_seeds",
    "Mine (5 seeds)",
    "Mine 5-SEEDS",
    "Mine 5seeds",
    "Mine seeds=5",
    "Mine s.e.e.d 0",
    "5_training_seeds",
    "Mine (training seed 0)",
]


@pytest.mark.parametrize("name", FOLDERS)
def test_folder_cannot_have_a_name_by_which_something_is_found(name: str, tmp_path: Path) -> None:
    check, reason = refused(folder(tmp_path / name))
    assert check == "folder" and reason.startswith("the folder's name must")


@pytest.mark.parametrize("name", NAMES)
def test_entry_cannot_have_a_name_by_which_something_is_found(name: str, tmp_path: Path) -> None:
    check, reason = refused(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))
    assert check == "entry.toml" and reason.startswith("name must")


def test_everything_that_is_found_by_name_is_refused_as_a_name(tmp_path: Path) -> None:
    baselines = {entry.name for version in (V0, V1) for entry in load_entries("baselines", benchmark=version)}
    shipped = {name for path in policy_folders() for name in (path.name, policy_name(path))}
    for index, name in enumerate(sorted({*STRATEGY_NAMES, *baselines, *filter(None, shipped)})):
        assert load_entries(name)
        assert refused(folder(tmp_path / str(index), toml=TOML.replace("Mine", name)))[0] == "entry.toml"


@pytest.mark.parametrize("name", ["baselines", "policies", "mppt", "fast-droop", "tip-speed-feedback"])
def test_folder_at_hand_does_not_stand_before_a_word_or_a_baseline(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = [entry.name for entry in load_entries(name)]
    shutil.copytree(POLICIES / "ppo-k-2", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert [entry.name for entry in load_entries(name)] == expected
    assert [entry.name for entry in load_entries(f"./{name}")] == ["PPO (k)"]


@pytest.mark.parametrize("name", ["fast-droop", "Fast Droop", "tip-speed-feedback", "baselines", "MPPT", "po1icies"])
def test_own_law_and_own_folder_are_not_called_like_a_baseline(name: str, tmp_path: Path) -> None:
    law = tmp_path / "mine.toml"
    law.write_text(f'name = "{name}"\nk_min = 1.0\nk_nominal = 0.8\nk_max = 0.6\n')
    with pytest.raises(ValueError, match=r"^the name of the law in .*mine.toml must not be, or look like"):
        load_entries(law)
    with pytest.raises(ValueError, match=r"^the name in .*entry.toml must not be, or look like"):
        load_entries(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))


@pytest.mark.parametrize("name", ["ppo-k-0", "linear-feedback", "linear-feedback-v1"])
def test_shipped_folder_passes_beside_all_others(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "_ROLLOUT_LANES", 2)
    own = check_submission(POLICIES / name, rollout_only=True)
    assert own.accepted and own.shipped
    mates = [path for path in policy_folders() if path.name != name and policy_name(path) == policy_name(own.folder)]
    beside = [check_submission(path, rollout_only=True) for path in mates]
    assert beside and conflicts([own], beside) == [] == conflicts([own, *beside])


def test_names_of_all_shipped_folders_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise ValueError("its names have passed")

    monkeypatch.setattr(gate, "_check_widths", stop)
    for path in policy_folders():
        assert refused(path) == ("loading", "its names have passed")


# --- texts -----------------------------------------------------------------------------------------------------------

#: Signs that are not seen, change others, are pictures, or are drawn for other letters; each stands within a word.
SIGNS = {
    "a blank note": "\U0001d159",
    "a beam of notes begins": "\U0001d173",
    "the first filler of Hangul": "\u115f",
    "the second filler of Hangul": "\u1160",
    "the third filler of Hangul": "\u3164",
    "half a filler": "\uffa0",
    "a part of a syllable": "\u1100",
    "Braille without dots": "\u2800",
    "no width": "\u200b",
    "a joiner": "\u200d",
    "a non-joiner": "\u200c",
    "a joiner of words": "\u2060",
    "an invisible plus": "\u2064",
    "a byte order mark": "\ufeff",
    "a soft hyphen": "\u00ad",
    "a joiner of marks": "\u034f",
    "a mark of direction": "\u200e",
    "an Arabic mark of direction": "\u061c",
    "an override of direction": "\u202e",
    "an isolate": "\u2066",
    "a blank as wide as m": "\u2003",
    "a narrow hard blank": "\u202f",
    "a Chinese blank": "\u3000",
    "a blank of Ogham": "\u1680",
    "a separator of Mongolian vowels": "\u180e",
    "a separator of paragraphs": "\u2029",
    "a variant": "\ufe0e",
    "a further variant": "\U000e0100",
    "a tag": "\U000e0061",
    "for private use": "\U000f0000",
    "a non-character": "\uffff",
    "an unassigned sign": "\u0378",
    "a control": "\u0085",
    "an overlay": "\u0336",
    "a circle around": "\u20dd",
    "an accent that floats": "\u0301",
    "an unseen vowel of Khmer": "\u17b4",
    "a vowel without a letter": "\u093f",
    "a note between lines": "\ufff9",
    "an object": "\ufffc",
    "no character": "\ufffd",
    "an emoji": "\U0001f3c6",
    "an emoji of the first plane": "\u2603",
    "a flag": "\U0001f1ea",
    "a bold letter": "\U0001d400",
    "a wide letter": "\uff21",
    "a letter in a circle": "\u24b6",
    "a ligature": "\ufb01",
    "a small letter above": "\u02b0",
    "a stretcher": "\u0640",
    "a line that looks like a cell's": "\u2223",
    "a wide cell's line": "\uff5c",
    "a bracket that looks like a tag's": "\u2039",
    "a wide bracket": "\uff1c",
    "a dotless mark at": "\uff20",
    "a slash of fractions": "\u2044",
    "a dot that leads": "\u2024",
    "a Greek question mark": "\u037e",
    "a hieroglyph": "\U00013000",
    "cuneiform": "\U00012000",
    "a rune": "\u16a0",
}


@pytest.mark.parametrize("what", SIGNS)
def test_signs_that_no_text_needs_are_refused(what: str) -> None:
    for text in (f"a{SIGNS[what]}b", f"Jane Doe{SIGNS[what]}", f"{SIGNS[what]}Jane"):
        with pytest.raises(ValueError, match="an author must be"):
            check_author(text)
        with pytest.raises(ValueError, match="description must be"):
            check_text("description", text)


@pytest.mark.parametrize(
    "author",
    [
        "राजेश कुमार",
        "สมชาย ศรีสุวรรณ์",
        "তানভীর হাসান",
        "தமிழ்ச்செல்வன்",
        "សុខ សុភា",
        "သန်းရွှေ",
        "מֹשֶׁה כהן",
        "مُحَمَّد بن علي",
        "አበበ ቢቂላ",
        "Արամ Խաչատրյան",
        "ნინო ბერიძე",
        "Kaʻiulani ʻOkina",
        "𠮷野 家",
    ],
)
def test_authors_in_scripts_with_vowel_signs_are_legal(author: str) -> None:
    assert check_author(author) == author


@pytest.mark.parametrize("text", ["ก" + "\u0e49" * 5, "a\u0e49", "ก \u0e49", "ก\u093f", "क\u0301"])
def test_vowel_signs_follow_a_letter_of_their_script_and_are_few(text: str) -> None:
    with pytest.raises(ValueError, match="an author must be"):
        check_author(f"Jane {text}")


# --- entry.toml ------------------------------------------------------------------------------------------------------

_KEY = 'environment = "GFMWTG-14bus-v0"\n'
#: Ways to write the key, and the version that every reader takes; None where it is refused.
SHAPES: dict[str, tuple[str, str | None]] = {
    "as it is usually written": (_KEY, "v0"),
    "without it": ("", "v1"),
    "without blanks": ('environment="GFMWTG-14bus-v0"\n', "v0"),
    "with many blanks": ('  environment   =\t "GFMWTG-14bus-v0"  \n', "v0"),
    "in single quotes": ("environment = 'GFMWTG-14bus-v0'\n", "v0"),
    "with a quoted key": ('"environment" = "GFMWTG-14bus-v0"\n', "v0"),
    "with a key in single quotes": ("'environment' = 'GFMWTG-14bus-v1'\n", "v1"),
    "with an escape in the key": ('"\\u0065nvironment" = "GFMWTG-14bus-v0"\n', "v0"),
    "with an escape in the value": ('environment = "GFMWTG-14bus-v\\u0030"\n', "v0"),
    "with a comment": ('environment = "GFMWTG-14bus-v0" # "GFMWTG-14bus-v1"\n', "v0"),
    "in several lines": ('environment = """\nGFMWTG-14bus-v0"""\n', "v0"),
    "in several lines that a backslash joins": ('environment = """GFMWTG-\\\n    14bus-v0"""\n', "v0"),
    "in a comment alone": ('# environment = "GFMWTG-14bus-v0"\n', "v1"),
    "within another text": ('trained_on = """\\\n    environment = GFMWTG-14bus-v0"""\n', "v1"),
    "with line ends of Windows": ('environment = "GFMWTG-14bus-v0"\r\n', "v0"),
    "twice": (_KEY + 'environment = "GFMWTG-14bus-v1"\n', None),
    "twice the same": (2 * _KEY, None),
    "twice, once quoted": (_KEY + '"environment" = "GFMWTG-14bus-v1"\n', None),
    "with dots": ('environment.id = "GFMWTG-14bus-v0"\n', None),
    "as a table": ('[environment]\nid = "GFMWTG-14bus-v0"\n', None),
    "in a table": ('[entry]\nenvironment = "GFMWTG-14bus-v0"\n', None),
    "as an inline table": ('environment = { id = "GFMWTG-14bus-v0" }\n', None),
    "as a list": ('environment = ["GFMWTG-14bus-v0"]\n', None),
    "as lists of tables": ('[[environment]]\nid = "GFMWTG-14bus-v0"\n', None),
    "without quotes": ("environment = GFMWTG-14bus-v0\n", None),
    "with a blank in it": ('environment = "GFMWTG-14bus-v0 "\n', None),
    "with a line feed in it": ('environment = """GFMWTG-14bus-v0\n"""\n', None),
    "in capitals": ('environment = "GFMWTG-14BUS-V0"\n', None),
    "with a key in capitals": ('Environment = "GFMWTG-14bus-v0"\n', None),
    "with a blank in the key": ('"environment " = "GFMWTG-14bus-v0"\n', None),
    "with another hyphen": ('environment = "GFMWTG\u201014bus-v0"\n', None),
    "with another e": ('"\u0435nvironment" = "GFMWTG-14bus-v0"\n', None),
    "empty": ('environment = ""\n', None),
    "a version alone": ('environment = "v0"\n', None),
    "a number": ("environment = 0\n", None),
    "a version that is not there": ('environment = "GFMWTG-14bus-v2"\n', None),
    "with a module before it": ('environment = "wtg_gym:GFMWTG-14bus-v0"\n', None),
    "after a byte order mark": ("\ufeff" + _KEY, None),
    "after a line end of old": ("\r" + _KEY, None),
    "after a zero": ("\0" + _KEY, None),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_every_reader_of_entry_toml_sees_the_same_version(shape: str, tmp_path: Path) -> None:
    text, version = SHAPES[shape]
    # First, so that a mark is the file's and a table takes in what follows.
    content = text + TOML.replace(_KEY, "") if version is None else TOML.replace(_KEY, text)
    path = folder(tmp_path / "a", toml=content.encode())
    if version is None:
        for read in (
            lambda: parse_entry(content),
            lambda: parse_submission(content.encode()),
            lambda: load_entries(path),
        ):
            with pytest.raises(ValueError, match=r"it must have the keys|environment must be one of|it is not TOML"):
                read()
        return
    env_id = f"GFMWTG-14bus-{version}"
    assert parse_entry(content)["environment"] == parse_submission(content.encode()).environment == env_id
    assert load_entries(path)[0].environment == env_id


# --- copies of baselines ---------------------------------------------------------------------------------------------


def network(mode: str, version: str, gain: float, constant: float = 0.0) -> bytes:
    """A policy whose action on each group's first quantity is a gain times the group's own frequency, and a constant.

    Its observations are those of the mode and version: of every group, its own and the actions before.
    """
    n_groups, measured = (2, 8) if version == "v0" else (4, 6)
    of_group = 2 if mode == "k+tau" else 1
    weights = np.zeros((n_groups, measured + of_group, n_groups, of_group))
    for group in range(n_groups):
        weights[group, 0, group, 0] = gain
    weights = weights.reshape(n_groups * (measured + of_group), -1)
    nodes = [
        node("MatMul", ["observation", "weights"], "all"),
        node("Add", ["all", "constant"], "moved"),
        node("Clip", ["moved", "low", "high"], "action"),
    ]
    values = {"weights": weights, "constant": constant, "low": -1.0, "high": 1.0}
    return make(
        nodes,
        [info("observation", "batch", len(weights))],
        [info("action", "batch", weights.shape[1])],
        [models.constant(name, value) for name, value in values.items()],
    ).SerializeToString()


def toml(mode: str, version: str, strategy: str) -> str:
    """An entry.toml of a mode, a version and a law."""
    return TOML.replace("k+tau", mode).replace("-v0", f"-{version}") + f'strategy = "{strategy}"\n'


@pytest.mark.parametrize("version", ["v0", "v1"])
@pytest.mark.parametrize("strategy", ["mppt", "coordinated-piecewise", "coordinated-tuned"])
@pytest.mark.parametrize(("mode", "constant"), [("k", 0.0), ("tau", 0.0), ("k+tau", 0.004)])
def test_policy_that_does_nothing_is_the_law_itself(
    version: str, strategy: str, mode: str, constant: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "_ROLLOUT_LANES", 2)
    content = network(mode, version, 0.0, constant)
    check, reason = refused(folder(tmp_path / "a", content, toml(mode, version, strategy)))
    assert check == "rollout" and f"it plays as the baseline {strategy}:" in reason


@pytest.mark.parametrize("mode", ["k", "k+tau"])
@pytest.mark.parametrize("gain", [-1.0, -1.001])
def test_network_that_plays_as_the_fast_droop_is_refused(
    mode: str, gain: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gate, "_ROLLOUT_LANES", 4)
    path = folder(tmp_path / "a", network(mode, "v1", gain), toml(mode, "v1", "coordinated-piecewise"))
    check, reason = refused(path)
    assert check == "rollout" and "it plays as the baseline fast-droop:" in reason
    # The same on another law, or with another gain, is another controller.
    for name, other, law in (("b", -1.0, "coordinated-tuned"), ("c", -1.5, "coordinated-piecewise")):
        path = folder(tmp_path / name, network(mode, "v1", other), toml(mode, "v1", law))
        assert check_submission(path, rollout_only=True).accepted
