"""Facts about the datasets: the same data every time, of training scenarios only, and what the environment answers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import minari
import numpy as np
import pytest

from agents import datasets
from wtg_gym.physics.compiled import source_hash
from wtg_gym.policies import load_entries
from wtg_gym.scenarios import get_suite


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    return tmp_path


def printed(capsys: pytest.CaptureFixture[str]) -> dict[str, list[str]]:
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[2:]]
    return {name: cells for name, *cells in rows}


def test_command_gives_the_same_sha256_again_and_the_environment_the_same_bits(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["--versions", "v0", "v1", "--policies", "mixed", "--episodes", "4", "--output", str(folder)]
    assert datasets.main(command) == 0
    first = printed(capsys)
    assert list(first) == ["gfmwtg/v0/mixed-v0", "gfmwtg/v1/mixed-v0"]
    assert all(re.fullmatch("[0-9a-f]{64}", cells[2]) for cells in first.values())
    assert datasets.main(command) == 2
    assert "--overwrite replaces it" in capsys.readouterr().err
    assert datasets.main([*command, "--overwrite"]) == 0
    assert printed(capsys) == first
    assert datasets.main([*command, "--check"]) == 0
    assert printed(capsys) == first
    for name, suite in (("v0", "standard"), ("v1", "standard-v1")):
        dataset = minari.load_dataset(datasets.dataset_id(name, "mixed"))
        (entry,) = load_entries(datasets.VERSIONS[name].policy)
        said = dataset.storage.metadata
        assert (said["source_hash"], said["suite_hash"]) == (source_hash(), get_suite(suite).hash)
        assert (said["policy_sha256"], said["seeds"], said["split"]) == (entry.fingerprint, "0 … 3", "train")
        episodes = list(dataset.iterate_episodes())
        assert all(int(seed) in get_suite(suite).train for each in episodes for seed in each.infos["scenario_seed"])
        assert [bool(np.abs(each.actions).max()) for each in episodes] == [False, True, True, True]
        assert all(len(each.observations) == len(each.infos["cost"]) == len(each.actions) + 1 for each in episodes)


def test_noise_is_held_and_has_the_documented_spread(folder: Path) -> None:
    dataset = datasets.make_dataset("v0", "noisy", 6)
    actions = np.concatenate([each.actions[:600] for each in dataset.iterate_episodes()])
    changes = np.flatnonzero(np.diff(actions, axis=0).any(axis=1)) + 1
    assert (changes % datasets.HELD_STEPS == 0).all() and len(changes) > 100
    assert abs(actions[:: datasets.HELD_STEPS].std() - datasets.NOISE) < 0.05


@pytest.mark.parametrize("damage", ["reward", "hash"])
def test_other_data_is_found(damage: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = datasets.make_dataset("v0", "reference", 1)
    assert datasets.check(dataset)[0] == 1
    if damage == "hash":
        dataset.storage.update_metadata({"data_sha256": "0" * 64})
        with pytest.raises(ValueError, match="its metadata says 0000"):
            datasets.check(dataset)
        return
    (episode,) = dataset.iterate_episodes()
    rewards = episode.rewards.copy()
    rewards[17] = np.nextafter(rewards[17], 1.0)
    other: Any = type(episode)(**{**vars(episode), "rewards": rewards})
    monkeypatch.setattr(datasets, "_episodes", lambda _: iter([(0, other)]))
    dataset.storage.update_metadata({"data_sha256": datasets.data_sha256(dataset)})
    with pytest.raises(ValueError, match="step 18 of the episode of seed 0 is another one when played again"):
        datasets.check(dataset)
