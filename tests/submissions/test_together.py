"""Several submissions together, and beside entries that are there."""

import re
from pathlib import Path

import pytest
from onnx import ModelProto

from tests.submissions import models
from tests.submissions.models import TOML, folder, seed
from wtg_gym.policies.gate import Report, conflicts, read_submission


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
