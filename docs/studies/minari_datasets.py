"""`python docs/studies/minari_datasets.py`: episodes of several players as datasets of Minari, for offline learning.

Stores gfmwtg/VERSION/POLICY-v0 in the folder MINARI_DATASETS_PATH, or in Minari's own: episodes of the training split.
Episode i is what `reset(seed=i)` draws. The same command gives the same data. Needs the extra `data`.
"""

import argparse
import contextlib
import itertools
import warnings
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import minari
import numpy as np
from minari.data_collector import EpisodeBuffer

from wtg_gym.policies import load_entries
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite
from wtg_gym.systems.compiled import source_hash

#: Standard deviation of the noise on the actions [full action], and for how many steps a value is held: rotors answer
#: in seconds, and noise that is drawn anew at every step averages out before it shows.
NOISE, HELD_STEPS = 0.3, 20
#: Suite of a version of the benchmark and its trained policy, whose law the actions of all datasets modulate.
VERSIONS = {"v0": ("standard", "ppo-k+tau-0"), "v1": ("standard-v1", "ppo-v1-0")}
#: Players of a dataset's episodes, in turn: whether the trained policy acts, and whether noise is added.
POLICIES: dict[str, Sequence[tuple[bool, bool]]] = {
    "reference": [(False, False)],
    "noisy": [(False, True)],
    "ppo": [(True, False)],
    "mixed": [(False, False), (False, True), (True, False), (True, True)],
}


def make_dataset(version: str, policy: str, episodes: int) -> Any:
    """Play episodes and return the dataset of Minari; a ValueError if there is one of this name already."""
    if episodes < 1:
        raise ValueError(f"there must be 1 episode or more, got {episodes}")
    name, (suite, player) = f"gfmwtg/{version}/{policy}-v0", VERSIONS[version]
    if name in minari.list_local_datasets():
        raise ValueError(f"the dataset {name} is there already; delete it first: minari delete {name}")
    (entry,) = load_entries(player)
    modes: Any = {"action_mode": entry.action_mode, "observation_mode": entry.observation_mode}
    env = gym.make(f"wtg_gym:GFMWTG-14bus-{version}", suite=suite, split="train", strategy=entry.law.name, **modes)
    with contextlib.closing(env), entry.policy, Progress("episodes") as progress, warnings.catch_warnings():
        # Minari asks for an address and for the commit: the description has the hashes of the sources.
        warnings.simplefilter("ignore")
        buffers = []
        for seed in range(episodes):
            buffers.append(_played(env, entry.policy, *POLICIES[policy][seed % len(POLICIES[policy])], seed))
            progress.update(name, seed + 1, episodes)
        source = f"suite {suite} ({get_suite(suite).hash}), split train, law {entry.law.name}, source {source_hash()}"
        texts = {"algorithm_name": policy, "author": "The wtg_gym authors", "description": source}
        return minari.create_dataset_from_buffers(name, buffers, env=env, requirements=["wtg-gym"], **texts)


def _played(env: gym.Env[Any, Any], trained: Any, acts: bool, noisy: bool, seed: int) -> Any:
    """Return an episode; observations and infos have a row more than there are steps, the start."""
    rng, state, over = np.random.default_rng(seed), None, False
    noise = np.zeros(env.action_space.shape or ())
    observation, info = env.reset(seed=seed)
    keys = [key for key, value in info.items() if isinstance(value, (int, float, np.number))]
    seen, infos, steps = [observation], [[info[key] for key in keys]], list[tuple[Any, ...]]()
    while not over:
        if noisy and len(steps) % HELD_STEPS == 0:
            noise = rng.normal(0.0, NOISE, noise.shape)
        action = noise
        if acts:
            answer, state = trained.predict(seen[-1][None], state, np.array([not steps]))
            action = noise + np.clip(answer[0], -1.0, 1.0)
        action = np.clip(action, -1.0, 1.0).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append(observation)
        infos.append([info[key] for key in keys])
        steps.append((action, reward, terminated, truncated))
        over = terminated or truncated
    names = ("actions", "rewards", "terminations", "truncations")
    columns = dict(zip(names, map(np.array, zip(*steps, strict=True)), strict=True))
    numbers = dict(zip(keys, np.array(infos).T, strict=True))
    return EpisodeBuffer(seed=seed, observations=np.array(seen), infos=numbers, **columns)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--versions", nargs="+", choices=tuple(VERSIONS), default=list(VERSIONS), help="default: both")
    parser.add_argument("--policies", nargs="+", choices=tuple(POLICIES), default=list(POLICIES), help="default: all")
    parser.add_argument("--episodes", type=int, default=200, metavar="N", help="in each (default: 200)")
    arguments = parser.parse_args()
    for version, policy in itertools.product(arguments.versions, arguments.policies):
        made = make_dataset(version, policy, arguments.episodes)
        print(f"{made.spec.dataset_id}: {made.total_episodes} episodes, {made.total_steps} steps", flush=True)
