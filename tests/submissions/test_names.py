"""Names that are taken: a stranger's folder is found by its name and by its entry's, so neither may find another."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.submissions import models
from tests.submissions.models import TOML, folder
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.tracking_law import STRATEGY_NAMES
from wtg_gym.policies import gate
from wtg_gym.policies.conflicts import conflicts
from wtg_gym.policies.gate import check_submission
from wtg_gym.policies.load import ROOT, policy_folders, policy_name
from wtg_gym.policies.names import plain_name
from wtg_gym.tasks import V0, V1

POLICIES = ROOT / "agents" / "policies"


def refused(path: Path) -> tuple[str, str]:
    """The check that refuses a folder, and why, which is one line."""
    refusal = check_submission(path, rollout_only=True).refusal
    assert refusal is not None and refusal.reason.isprintable()
    return refusal.name, refusal.reason


#: Of folders, and of entries; both are refused whatever their capitals, signs, and letters that look alike.
FOLDERS = """
baselines Baselines base-lines baselines.fast_droop policies po1icies POLICIES. agents agents.train tests wtg_gym
wtg-gym.evaluation mppt MPPT coordinated-tuned coordinated_tuned deloaded5 fast-droop fast_droop FastDroop
tip-speed-feedback tip.speed.feedback T1p-Speed-Feedback ppo-k-0 PPO-K-0 ppo-k-O ppo-k ppo-ktau-0 linear-feedback
linear_feedback gradient-LSTM \u017fac-v1-0 ppo-\u212a-0
"""
NAMES = """
baselines; policies; Policies; b a s e l i n e s; baselines.mppt; Coordinated-Piecewise; coordinated piecewise;
coordinated (tuned); Fast Droop; fast droop.; TIP_SPEED_FEEDBACK; PPO k 0; PPO-κ; ppo k, t; Iinear-feedback
"""


@pytest.mark.parametrize("name", FOLDERS.split())
def test_folder_cannot_have_a_name_by_which_something_is_found(name: str, tmp_path: Path) -> None:
    check, reason = refused(folder(tmp_path / name))
    assert check == "folder" and reason.startswith("the folder's name must")


@pytest.mark.parametrize("name", [name.strip() for name in NAMES.split(";")])
def test_entry_cannot_have_a_name_by_which_something_is_found(name: str, tmp_path: Path) -> None:
    check, reason = refused(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))
    assert check == "entry.toml" and reason.startswith("name must not be")


def test_everything_that_is_found_by_name_is_refused_as_a_name(tmp_path: Path) -> None:
    baselines = {entry.name for version in (V0, V1) for entry in load_entries("baselines", task=version)}
    shipped = {name for path in policy_folders() for name in (path.name, policy_name(path))}
    for index, name in enumerate(sorted({*STRATEGY_NAMES, *baselines, *filter(None, shipped)})):
        assert load_entries(name)
        assert refused(folder(tmp_path / str(index), toml=TOML.replace("Mine", name)))[0] == "entry.toml"


def test_names_and_letters_that_look_alike_are_one() -> None:
    assert {plain_name(name) for name in ("PPO (k, τ)", "ppo k,t", "PPO-κ-τ", "P.P.O. kT")} == {"ppokt"}
    assert {plain_name(name) for name in ("Iinear", "1inear", "LINEAR", "l-i-n-e-a-r")} == {plain_name("linear")}
    assert plain_name("PPO (k)") != plain_name("PPO (τ)")
    assert plain_name("SAC 0") == plain_name("SAC O") != plain_name("SAC 8")


@pytest.mark.parametrize("name", ["baselines", "policies", "mppt", "fast-droop"])
def test_folder_at_hand_does_not_stand_before_a_word_or_a_baseline(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = [entry.name for entry in load_entries(name)]
    shutil.copytree(POLICIES / "ppo-k-2", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert [entry.name for entry in load_entries(name)] == expected
    assert [entry.name for entry in load_entries(f"./{name}")] == ["PPO (k)"]


@pytest.mark.parametrize("name", ["Fast Droop", "baselines", "po1icies"])
def test_own_law_and_own_folder_are_not_called_like_a_baseline(name: str, tmp_path: Path) -> None:
    law = tmp_path / "mine.toml"
    law.write_text(f'name = "{name}"\nk_min = 1.0\nk_nominal = 0.8\nk_max = 0.6\n')
    with pytest.raises(ValueError, match=r"^the name of the law in .*mine.toml must not be, or look like"):
        load_entries(law)
    with pytest.raises(ValueError, match=r"^the name in .*entry.toml must not be, or look like"):
        load_entries(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))


# --- shipped policies ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ppo-k-0", "linear-feedback-v1"])
def test_shipped_folder_passes_beside_all_others(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "_ROLLOUT_LANES", 2)
    own = check_submission(POLICIES / name, rollout_only=True)
    assert own.accepted and own.shipped
    mates = [path for path in policy_folders() if path.name != name and policy_name(path) == policy_name(own.folder)]
    beside = [check_submission(path, rollout_only=True) for path in mates]
    assert beside and conflicts([own], beside) == [] == conflicts([own, *beside])


def test_names_of_all_shipped_folders_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise ValueError("its names have passed")

    monkeypatch.setattr(gate, "OnnxPolicy", stop)
    for path in policy_folders():
        assert refused(path) == ("loading", "its names have passed")


# --- copies of baselines ---------------------------------------------------------------------------------------------


def network(mode: str, version: str, gain: float, constant: float) -> models.ModelProto:
    """A policy whose action on each group's first quantity is a gain times the group's own frequency, and a constant.

    Its observations are those of the mode and version: of every group, its own and the actions before.
    """
    n_groups, measured = (2, 8) if version == "v0" else (4, 6)
    of_group = 2 if mode == "k+tau" else 1
    weights = np.zeros((n_groups, measured + of_group, n_groups, of_group))
    for group in range(n_groups):
        weights[group, 0, group, 0] = gain
    weights = weights.reshape(n_groups * (measured + of_group), -1)
    return models.linear(*weights.shape, weights, constant)


@pytest.mark.parametrize(
    ("case", "baseline"),
    [
        # What does nothing is the law itself.
        (("v0", "mppt", "k", 0.0, 0.0), "mppt"),
        (("v0", "coordinated-piecewise", "k+tau", 0.0, 0.004), "coordinated-piecewise"),
        (("v1", "coordinated-tuned", "tau", 0.0, 0.0), "coordinated-tuned"),
        (("v1", "coordinated-piecewise", "k", -1.0, 0.0), "fast-droop"),
        (("v1", "coordinated-piecewise", "k+tau", -1.001, 0.0), "fast-droop"),
        # The same on another law, or with another gain, is another controller.
        (("v1", "coordinated-tuned", "k", -1.0, 0.0), None),
        (("v1", "coordinated-piecewise", "k", -1.5, 0.0), None),
    ],
)
def test_policy_that_plays_as_a_baseline_is_refused(
    case: tuple[str, str, str, float, float], baseline: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    version, strategy, mode, gain, constant = case
    monkeypatch.setattr(gate, "_ROLLOUT_LANES", 4)
    toml = TOML.replace("k+tau", mode).replace("-v0", f"-{version}") + f'strategy = "{strategy}"\n'
    path = folder(tmp_path / "a", network(mode, version, gain, constant), toml)
    if baseline is None:
        assert check_submission(path, rollout_only=True).accepted
    else:
        check, reason = refused(path)
        assert check == "rollout" and f"it plays as the baseline {baseline}:" in reason
