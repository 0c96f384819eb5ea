"""Names that are taken, and entry.toml in every shape: what the gate says, and that every reader sees the same.

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
from wtg_gym.scenarios.benchmark import V0, V1

POLICIES = Path(__file__).resolve().parents[2] / "agents" / "policies"


def refused(path: Path) -> tuple[str, str]:
    """The check that refuses a folder, and why, which is one line."""
    refusal = check_submission(path, rollout_only=True).refusal
    assert refusal is not None and refusal.reason.isprintable()
    return refusal.name, refusal.reason


# --- names that are taken --------------------------------------------------------------------------------------------

#: Of folders, and of entries; both are refused whatever their capitals, signs, and letters that look alike.
FOLDERS = """
baselines Baselines base-lines baselines.fast_droop policies po1icies POLICIES. agents agents.train tests wtg_gym
wtg-gym.evaluation mppt MPPT coordinated-tuned coordinated_tuned deloaded5 fast-droop fast_droop FastDroop
tip-speed-feedback tip.speed.feedback T1p-Speed-Feedback ppo-k-0 PPO-K-0 ppo-k-O ppo-k ppo-ktau-0 linear-feedback
linear_feedback gradient-LSTM numpy os.path torch.nn json \u017fac-v1-0 ppo-\u212a-0
"""
NAMES = """
baselines; policies; Policies; b a s e l i n e s; baselines.mppt; mppt; Coordinated-Piecewise; coordinated piecewise;
coordinated (tuned); fast-droop; Fast Droop; fast droop.; tip-speed feedback; TIP_SPEED_FEEDBACK; ppo-k-0; PPO k 0;
PPO (k); PPO-κ; ppo k, t; Iinear-feedback; PPO; sac-v1-2; numpy; Mine 5_seeds; Mine (5 seeds); Mine 5-SEEDS;
Mine 5seeds; Mine seeds=5; Mine s.e.e.d 0; 5_training_seeds; Mine (training seed 0)
"""


@pytest.mark.parametrize("name", FOLDERS.split())
def test_folder_cannot_have_a_name_by_which_something_is_found(name: str, tmp_path: Path) -> None:
    check, reason = refused(folder(tmp_path / name))
    assert check == "folder" and reason.startswith("the folder's name must")


@pytest.mark.parametrize("name", [name.strip() for name in NAMES.split(";")])
def test_entry_cannot_have_a_name_by_which_something_is_found(name: str, tmp_path: Path) -> None:
    check, reason = refused(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))
    assert check == "entry.toml" and reason.startswith("name must")


def test_everything_that_is_found_by_name_is_refused_as_a_name(tmp_path: Path) -> None:
    baselines = {entry.name for version in (V0, V1) for entry in load_entries("baselines", benchmark=version)}
    shipped = {name for path in policy_folders() for name in (path.name, policy_name(path))}
    for index, name in enumerate(sorted({*STRATEGY_NAMES, *baselines, *filter(None, shipped)})):
        assert load_entries(name)
        assert refused(folder(tmp_path / str(index), toml=TOML.replace("Mine", name)))[0] == "entry.toml"


@pytest.mark.parametrize("name", ["baselines", "policies", "mppt", "fast-droop"])
def test_folder_at_hand_does_not_stand_before_a_word_or_a_baseline(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = [entry.name for entry in load_entries(name)]
    shutil.copytree(POLICIES / "ppo-k-2", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert [entry.name for entry in load_entries(name)] == expected
    assert [entry.name for entry in load_entries(f"./{name}")] == ["PPO (k)"]


@pytest.mark.parametrize("name", ["fast-droop", "Fast Droop", "baselines", "MPPT", "po1icies"])
def test_own_law_and_own_folder_are_not_called_like_a_baseline(name: str, tmp_path: Path) -> None:
    law = tmp_path / "mine.toml"
    law.write_text(f'name = "{name}"\nk_min = 1.0\nk_nominal = 0.8\nk_max = 0.6\n')
    with pytest.raises(ValueError, match=r"^the name of the law in .*mine.toml must not be, or look like"):
        load_entries(law)
    with pytest.raises(ValueError, match=r"^the name in .*entry.toml must not be, or look like"):
        load_entries(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))


@pytest.mark.parametrize("name", ["ppo-k-0", "linear-feedback-v1"])
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


# --- entry.toml ------------------------------------------------------------------------------------------------------

_KEY = 'environment = "GFMWTG-14bus-v0"\n'
#: Ways to write the key, and the version that every reader takes.
VERSIONS = (
    (_KEY, "v0"),
    ("", "v1"),
    ('  environment   =\t "GFMWTG-14bus-v0"  \n', "v0"),
    ("'environment' = 'GFMWTG-14bus-v1'\n", "v1"),
    ('"\\u0065nvironment" = "GFMWTG-14bus-v0"\n', "v0"),
    ('environment = "GFMWTG-14bus-v\\u0030"\n', "v0"),
    ('environment = "GFMWTG-14bus-v0" # "GFMWTG-14bus-v1"\n', "v0"),
    ('environment = """GFMWTG-\\\n    14bus-v0"""\n', "v0"),
    ('# environment = "GFMWTG-14bus-v0"\n', "v1"),
    ('trained_on = """\\\n    environment = GFMWTG-14bus-v0"""\n', "v1"),
    ('environment = "GFMWTG-14bus-v0"\r\n', "v0"),
)
#: Ways that are refused; first in the file, so that a mark is the file's and a table takes in what follows.
REFUSED = (
    _KEY + 'environment = "GFMWTG-14bus-v1"\n',
    2 * _KEY,
    _KEY + '"environment" = "GFMWTG-14bus-v1"\n',
    'environment.id = "GFMWTG-14bus-v0"\n',
    '[environment]\nid = "GFMWTG-14bus-v0"\n',
    '[entry]\nenvironment = "GFMWTG-14bus-v0"\n',
    'environment = { id = "GFMWTG-14bus-v0" }\n',
    'environment = ["GFMWTG-14bus-v0"]\n',
    "environment = GFMWTG-14bus-v0\n",
    'environment = """GFMWTG-14bus-v0\n"""\n',
    'environment = "GFMWTG-14BUS-V0"\n',
    'Environment = "GFMWTG-14bus-v0"\n',
    '"environment " = "GFMWTG-14bus-v0"\n',
    'environment = "GFMWTG\u201014bus-v0"\n',
    '"\u0435nvironment" = "GFMWTG-14bus-v0"\n',
    'environment = "GFMWTG-14bus-v2"\n',
    'environment = "wtg_gym:GFMWTG-14bus-v0"\n',
    "\ufeff" + _KEY,
    "\r" + _KEY,
    "\0" + _KEY,
)


@pytest.mark.parametrize(("text", "version"), VERSIONS)
def test_every_reader_of_entry_toml_sees_the_same_version(text: str, version: str, tmp_path: Path) -> None:
    content = TOML.replace(_KEY, text)
    path = folder(tmp_path / "a", toml=content.encode())
    env_id = f"GFMWTG-14bus-{version}"
    assert parse_entry(content)["environment"] == parse_submission(content.encode()).environment == env_id
    assert load_entries(path)[0].environment == env_id


@pytest.mark.parametrize("text", REFUSED, ids=ascii)
def test_every_reader_of_entry_toml_refuses_the_same(text: str, tmp_path: Path) -> None:
    content = text + TOML.replace(_KEY, "")
    path = folder(tmp_path / "a", toml=content.encode())
    readers = (lambda: parse_entry(content), lambda: parse_submission(content.encode()), lambda: load_entries(path))
    for read in readers:
        with pytest.raises(ValueError, match=r"it must have the keys|environment must be one of|it is not TOML"):
            read()


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
    nodes = [node("MatMul", ["observation", "weights"], "all"), node("Add", ["all", "constant"], "moved")]
    nodes += [node("Clip", ["moved", "low", "high"], "action")]
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
