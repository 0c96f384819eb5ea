"""Several submissions together, beside entries that are there, and names by which something is found already."""

import re
import shutil
from pathlib import Path

import pytest
from onnx import ModelProto

from tests.submissions import models
from tests.submissions.models import TOML, folder, seed
from wtg_gym.evaluation import load_entries
from wtg_gym.physics.tracking_law import STRATEGY_NAMES
from wtg_gym.policies.entry_folder import ROOT, policy_folders, policy_name
from wtg_gym.policies.gate import Report, conflicts, read_submission
from wtg_gym.tasks import V0, V1


def report(path: Path, content: ModelProto | None = None, toml: str = TOML) -> Report:
    made = read_submission(folder(path, content, toml))
    assert made.accepted, made.refusal
    return made


DIFFERENT = {
    "authors": '["John Roe"]',
    "action_mode": '"k"',
    "environment": '"GFMWTG-14bus-v1"',
    "observation_mode": '"privileged"',
    "per_group": "true",
    "strategy": '"mppt"',
    "description": '"Better"',
    "trained_on": '"The test scenarios"',
}


def different(key: str) -> str:
    lines = [line for line in seed(1).splitlines() if not line.startswith(f"{key} =")]
    return "\n".join([*lines, f"{key} = {DIFFERENT[key]}\n"])


def test_seeds_of_one_entry_are_accepted(tmp_path):
    first, second = report(tmp_path / "a"), report(tmp_path / "b", models.other(), seed(1))
    assert conflicts([first, second]) == []
    assert conflicts([first], [report(tmp_path / "c", models.other(), TOML.replace("Mine", "Yours"))]) == []


def test_name_belongs_to_one_entry_of_one_version(tmp_path):
    old, new = report(tmp_path / "a"), report(tmp_path / "b", models.of_v1(), seed(1, models.TOML_V1))
    assert "must agree on environment" in conflicts([old, new])[0].reason
    for one, other in ((old, new), (new, old)):
        assert "is taken by Mine" in conflicts([one], [other])[0].reason


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        (seed(1).replace("Mine", "M I N E"), "the names Mine and M I N E look alike"),
        (TOML, r"Mine \(training seed 0\) is given twice"),
        *((different(key), rf"must agree on .*{key}.*, got .+ and .+: /") for key in DIFFERENT),
    ],
)
def test_nobody_joins_anothers_row(toml, said, tmp_path):
    first, second = report(tmp_path / "a"), report(tmp_path / "b", models.other(), toml)
    (conflict,) = conflicts([first, second])
    assert conflict.folders == (first.folder, second.folder) and re.search(said, conflict.reason)
    # Not even who says the same joins a row that is there.
    (conflict,) = conflicts([second], [first])
    assert conflict.folders == (second.folder,) and "is taken by Mine of" in conflict.reason


def test_file_counts_once_whatever_it_is_called(tmp_path):
    first, second = report(tmp_path / "a"), report(tmp_path / "b", toml=seed(1))
    third = report(tmp_path / "c", toml=TOML.replace("Mine", "Yours"))
    for found in (conflicts([first, second]), conflicts([first, third]), conflicts([third], [first])):
        assert "the same policy file is given twice" in found[0].reason


YOURS = TOML.replace("Mine", "Yours")


@pytest.mark.parametrize(
    ("name", "toml", "said"),
    [
        ("One", YOURS, "differ in capitals alone"),
        ("one", YOURS, "looks like"),
        ("m-ine", YOURS, "looks like"),
        ("b", TOML.replace("Mine", "O N E"), "looks like"),
    ],
)
def test_folder_is_not_called_as_another_folder_or_entry(name, toml, said, tmp_path):
    first, second = report(tmp_path / "a" / "one"), report(tmp_path / "b" / name, models.other(), toml)
    for found in (conflicts([first, second]), conflicts([second], [first])):
        assert said in found[0].reason


def test_what_is_there_is_compared_as_far_as_it_can_be_read(tmp_path):
    broken = read_submission(folder(tmp_path / "a", toml="name = "))
    assert not broken.accepted
    (conflict,) = conflicts([report(tmp_path / "b")], [broken])
    assert "the same policy file is given twice" in conflict.reason


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
