"""Names that are taken: a stranger's folder is found by its name and by its entry's, so neither may find another."""

import shutil
from pathlib import Path

import pytest

from tests.submissions.models import TOML, folder
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.tracking_law import STRATEGY_NAMES
from wtg_gym.policies.entry_folder import ROOT, policy_folders, policy_name
from wtg_gym.policies.gate import conflicts, read_submission
from wtg_gym.tasks import V0, V1

POLICIES = ROOT / "agents" / "policies"


def refused(path: Path) -> tuple[str, str]:
    """The check that refuses a folder, and why, which is one line."""
    refusal = read_submission(path).refusal
    assert refusal.reason.isprintable()
    return refusal.name, refusal.reason


#: Of folders, and of entries; both are refused whatever their capitals, signs, and letters that look alike.
FOLDERS = """
baselines Baselines base-lines baselines.fast_droop policies po1icies POLICIES. agents agents.train tests wtg_gym
wtg-gym.evaluation mppt MPPT coordinated-tuned coordinated_tuned deloaded5 fast-droop fast_droop FastDroop
tip-speed-feedback tip.speed.feedback T1p-Speed-Feedback ppo-k-0 PPO-K-0 ppo-k-O ppo-k ppo-ktau-0 linear-feedback
linear_feedback Gradient-0 \u017fac-v1-0 ppo-\u212a-0
"""
NAMES = """
baselines; policies; Policies; b a s e l i n e s; baselines.mppt; Coordinated-Piecewise; coordinated piecewise;
coordinated (tuned); Fast Droop; fast droop.; TIP_SPEED_FEEDBACK; PPO k 0; ppo k, tau; Iinear-feedback
"""


@pytest.mark.parametrize("name", FOLDERS.split())
def test_folder_cannot_have_a_name_by_which_something_is_found(name, tmp_path):
    check, reason = refused(folder(tmp_path / name))
    assert check == "folder" and reason.startswith("the folder's name must")


@pytest.mark.parametrize("name", [name.strip() for name in NAMES.split(";")])
def test_entry_cannot_have_a_name_by_which_something_is_found(name, tmp_path):
    check, reason = refused(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))
    assert check == "entry.toml" and reason.startswith("name must not be")


def test_everything_that_is_found_by_name_is_refused_as_a_name(tmp_path):
    baselines = {entry.name for version in (V0, V1) for entry in load_entries("baselines", task=version)}
    shipped = {name for path in policy_folders() for name in (path.name, policy_name(path))}
    for index, name in enumerate(sorted({*STRATEGY_NAMES, *baselines, *filter(None, shipped)})):
        assert load_entries(name)
        assert refused(folder(tmp_path / str(index), toml=TOML.replace("Mine", name)))[0] == "entry.toml"


@pytest.mark.parametrize("name", ["baselines", "policies", "mppt", "fast-droop"])
def test_folder_at_hand_does_not_stand_before_a_word_or_a_baseline(name, tmp_path, monkeypatch):
    expected = [entry.name for entry in load_entries(name)]
    shutil.copytree(POLICIES / "ppo-k-2", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert [entry.name for entry in load_entries(name)] == expected
    assert [entry.name for entry in load_entries(f"./{name}")] == ["PPO (k)"]


@pytest.mark.parametrize("name", ["Fast Droop", "baselines", "po1icies"])
def test_own_law_and_own_folder_are_not_called_like_a_baseline(name, tmp_path):
    law = tmp_path / "mine.toml"
    law.write_text(f'name = "{name}"\nk_min = 1.0\nk_nominal = 0.8\nk_max = 0.6\n')
    with pytest.raises(ValueError, match=r"^the name of the law in .*mine.toml must not be, or look like"):
        load_entries(law)
    with pytest.raises(ValueError, match=r"^the entry file .*entry.toml: name must not be, or look like"):
        load_entries(folder(tmp_path / "a", toml=TOML.replace("Mine", name)))


def test_shipped_folders_pass_beside_all_others():
    reports = [read_submission(path) for path in policy_folders()]
    assert all(report.accepted and report.shipped for report in reports)
    assert conflicts(reports) == [] == conflicts(reports[:1], reports[1:])
