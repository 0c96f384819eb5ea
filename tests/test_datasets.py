"""Facts about the datasets: of training scenarios only, with the actions of their players, and repeatable."""

from __future__ import annotations

from pathlib import Path

import minari
import numpy as np
import pytest
from minari_datasets import make_dataset

from wtg_gym.scenarios import get_suite


def test_episodes_are_those_of_their_players_and_play_again_to_the_bit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    make_dataset("v1", "mixed", 3)
    with pytest.raises(ValueError, match="is there already"):
        make_dataset("v1", "mixed", 3)
    dataset = minari.load_dataset("gfmwtg/v1/mixed-v0")
    episodes, env = list(dataset.iterate_episodes()), dataset.recover_environment()
    assert [bool(np.abs(each.actions).max()) for each in episodes] == [False, True, True]
    for seed, episode in enumerate(episodes):
        assert all(int(own) in get_suite("standard-v1").train for own in episode.infos["scenario_seed"])
        observation, _ = env.reset(seed=seed)
        assert np.array_equal(observation, episode.observations[0])
        for action, expected, reward in zip(episode.actions, episode.observations[1:], episode.rewards, strict=True):
            observation, earned, *_ = env.step(action)
            assert np.array_equal(observation, expected) and earned == reward
