"""Several submissions together, and beside entries that are there."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import ModelProto
from onnxruntime import InferenceSession

from tests.submissions import models
from tests.submissions.models import TOML, M, N, constant, folder, seed
from tests.submissions.models import model as make
from wtg_gym.evaluation import load_entries
from wtg_gym.policies import gate
from wtg_gym.policies.conflicts import conflicts
from wtg_gym.policies.gate import COPY_TOLERANCE, Report, action_difference, check_submission, rollout
from wtg_gym.policies.load import policy_folders
from wtg_gym.policies.submission_folder import parse_submission


@pytest.fixture(autouse=True)
def few_scenarios(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "_ROLLOUT_LANES", 8)


#: The reports on what was played before, by its files.
_PLAYED: dict[tuple[bytes, bytes], Report] = {}


def report(path: Path, content: ModelProto | None = None, toml: str = TOML) -> Report:
    made = folder(path, content, toml)
    files = (made / "policy.onnx").read_bytes(), (made / "entry.toml").read_bytes()
    if files not in _PLAYED:
        _PLAYED[files] = check_submission(made, rollout_only=True)
    found = dataclasses.replace(_PLAYED[files], folder=made)
    assert found.accepted, found.refusal
    return found


def nudged(size: float) -> ModelProto:
    """The plain policy with noise on its weights."""
    noise = np.random.default_rng(0).normal(0.0, size, (N, M))
    return make(constants=[constant("weights", 0.01 + noise)])


def test_seeds_of_one_entry_are_accepted(tmp_path: Path) -> None:
    first, second = report(tmp_path / "a"), report(tmp_path / "b", models.other(), seed(1))
    assert conflicts([first, second]) == []
    assert conflicts([first], [report(tmp_path / "c", models.other(), TOML.replace("Mine", "Yours"))]) == []
    assert conflicts([first, report(tmp_path / "d", nudged(0.01), seed(1))]) == []


def test_name_belongs_to_one_entry_of_one_version(tmp_path: Path) -> None:
    old, new = report(tmp_path / "a"), report(tmp_path / "b", models.of_v1(), seed(1, models.TOML_V1))
    assert "must agree on environment" in conflicts([old, new])[0].reason
    for one, other in ((old, new), (new, old)):
        assert "is taken by Mine" in conflicts([one], [other])[0].reason


@pytest.mark.parametrize(
    ("toml", "said"),
    [
        (seed(1).replace('"Jane Doe"', '"Jane Doe", "John Roe"'), "must agree on authors:"),
        (seed(1) + 'description = "Better"\n', "must agree on description:"),
        (seed(1) + 'trained_on = "The test scenarios"\n', "must agree on trained_on:"),
        (seed(1).replace("Mine", "M I N E"), "the names Mine and M I N E look alike"),
        (TOML, "Mine, training seed 0 is given twice"),
    ],
)
def test_nobody_joins_anothers_row(toml: str, said: str, tmp_path: Path) -> None:
    first, second = report(tmp_path / "a"), report(tmp_path / "b", models.other(), toml)
    (conflict,) = conflicts([first, second])
    assert conflict.folders == (first.folder, second.folder) and said in conflict.reason
    # Not even who says the same joins a row that is there.
    (conflict,) = conflicts([second], [first])
    assert conflict.folders == (second.folder,) and "is taken by Mine of" in conflict.reason


@pytest.mark.parametrize("content", [models.disguised(), nudged(1e-5)], ids=["other bytes", "a little noise"])
def test_copies_are_refused_whatever_their_bytes(content: ModelProto, tmp_path: Path) -> None:
    first, second = report(tmp_path / "a"), report(tmp_path / "b", content, seed(1))
    assert first.sha256 != second.sha256
    (conflict,) = conflicts([first, second])
    assert "the policies are one policy" in conflict.reason
    third = report(tmp_path / "c", content, TOML.replace("Mine", "Yours"))
    (conflict,) = conflicts([third], [first])
    assert conflict.folders == (third.folder,) and "the policies are one policy" in conflict.reason


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
def test_folder_is_not_called_as_another_folder_or_entry(name: str, toml: str, said: str, tmp_path: Path) -> None:
    first, second = report(tmp_path / "a" / "one"), report(tmp_path / "b" / name, models.other(), toml)
    for found in (conflicts([first, second]), conflicts([second], [first])):
        assert said in found[0].reason


def test_what_is_there_is_compared_as_far_as_it_can_be_read(tmp_path: Path) -> None:
    broken = check_submission(folder(tmp_path / "a", b"no model"), rollout_only=True)
    assert not broken.accepted
    (conflict,) = conflicts([report(tmp_path / "b", models.other(), seed(1))], [broken])
    assert "is taken by Mine" in conflict.reason


class AtOnce:
    """Answers all scenarios in one call, in this process: its actions equal the other process's up to the last bits."""

    def __init__(self, file: Path) -> None:
        self._session = InferenceSession(file, providers=["CPUExecutionProvider"])

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        widths = {given.name: given.shape[1] for given in self._session.get_inputs() if given.name != "observation"}
        states = {name: np.zeros((len(observation), n), np.float32) for name, n in widths.items()} | (state or {})
        answers = ["action", *(f"next_{name}" for name in states)]
        action, *following = self._session.run(answers, {"observation": observation.astype(np.float32), **states})
        return action, dict(zip(states, following, strict=True))


def test_shipped_policies_are_far_from_being_copies() -> None:
    compared: dict[tuple[str | None, str], list[Any]] = {}
    for path in policy_folders():
        (entry,) = load_entries(path)
        if entry.source != "The wtg_gym authors":
            # Those that others have submitted only have to differ.
            continue
        actions = rollout(AtOnce(path / "policy.onnx"), entry)
        gate._check_no_baseline(actions, parse_submission((path / "entry.toml").read_bytes()))
        compared.setdefault((entry.environment, entry.action_mode), []).append(actions)
    assert sorted(len(actions) for actions in compared.values()) == [5, 5, 16, 16]
    for (_, mode), actions in compared.items():
        for one, other in itertools.combinations(actions, 2):
            assert action_difference(one, other, mode, mode) > 3.0 * COPY_TOLERANCE
