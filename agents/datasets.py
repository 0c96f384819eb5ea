"""`python -m agents.datasets`: episodes of several policies as datasets of Minari, for offline learning."""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from agents.command import Parser, Progress, print_table, require_package, run_command
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.physics.compiled import source_hash
from wtg_gym.policies import Entry, OnnxPolicy, load_entries
from wtg_gym.scenarios import get_suite

Floats = npt.NDArray[np.float32]

#: Standard deviation of the noise on the actions [full action], and for how many steps a value is held: rotors answer
#: in seconds, and noise that is drawn anew at every step averages out before it shows.
NOISE, HELD_STEPS = 0.3, 20
_DEFAULT_EPISODES = 200
_BATCH = 64


@dataclass(frozen=True)
class Version:
    """Suite of a version of the benchmark and its trained policy, whose law the actions of all datasets modulate."""

    suite: str
    policy: str


VERSIONS = {"v0": Version("standard", "ppo-k+tau-0"), "v1": Version("standard-v1", "ppo-v1-0")}
#: Players of a dataset's episodes, in turn: whether the trained policy acts, and whether noise is added.
POLICIES: Mapping[str, Sequence[tuple[bool, bool]]] = {
    "reference": [(False, False)],
    "noisy": [(False, True)],
    "ppo": [(True, False)],
    "mixed": [(False, False), (False, True), (True, False), (True, True)],
}
_WORDS = {
    "reference": "zero action: the law by itself",
    "noisy": "zero action with noise",
    "ppo": "the trained policy",
    "mixed": "in turn: zero action, zero action with noise, the trained policy, the trained policy with noise",
}

_DESCRIPTION = f"""\
Plays episodes of the training split and stores them as datasets of Minari, gfmwtg/VERSION/POLICY-v0, then plays their
actions again and compares observations, rewards and ends bit for bit. The sha256 is over the data: the same command
gives the same one. Noise is normal, with a standard deviation of {NOISE} of the full action, held for {HELD_STEPS}
steps."""
_EXAMPLES = """\
examples:
  python -m agents.datasets                                       # all, into Minari's own folder
  python -m agents.datasets --versions v1 --policies ppo mixed --episodes 1000 --output datasets
  python -m agents.datasets --check --versions v1 --policies mixed"""


def dataset_id(version: str, policy: str) -> str:
    """Return the id under which Minari has a dataset."""
    return f"gfmwtg/{version}/{policy}-v0"


def make_dataset(version: str, policy: str, episodes: int, *, overwrite: bool = False) -> Any:
    """Play episodes and store them.

    Args:
        version, policy: of :data:`VERSIONS` and :data:`POLICIES`.
        episodes: how many; episode i is what `reset(seed=i)` draws from the training split.
        overwrite: replace a dataset that is there.

    Returns:
        the dataset of Minari; `data_sha256` in its metadata is :func:`data_sha256`.

    Raises:
        ValueError: there is one already.
    """
    import minari

    name, entry = dataset_id(version, policy), _entry(version)
    if name in minari.list_local_datasets():
        if not overwrite:
            raise ValueError(f"the dataset {name} is there already; --overwrite replaces it, --check plays it again")
        with contextlib.redirect_stdout(sys.stderr):
            minari.delete_dataset(name)
    env = gym.make(f"wtg_gym:GFMWTG-14bus-{version}", **_arguments(version, entry))
    with Progress("episodes") as progress:
        buffers = []
        for first in range(0, episodes, _BATCH):
            seeds = range(first, min(first + _BATCH, episodes))
            buffers += _played(version, entry, POLICIES[policy], seeds)
            progress.update(name, len(buffers), episodes)
    with warnings.catch_warnings():
        # It asks for an address and for the commit: the metadata has the hashes of the sources.
        warnings.simplefilter("ignore")
        dataset = _stored(name, buffers, env, version, policy)
    suite = get_suite(VERSIONS[version].suite)
    plays = any(acts for acts, _ in POLICIES[policy])
    dataset.storage.update_metadata(
        {
            "data_sha256": data_sha256(dataset),
            "source_hash": source_hash(),
            "suite_hash": suite.hash,
            "suite": VERSIONS[version].suite,
            "split": "train",
            "strategy": entry.law.name,
            "policy": VERSIONS[version].policy if plays else "none",
            "policy_sha256": entry.fingerprint if plays else "none",
            "noise_std": NOISE if any(noisy for _, noisy in POLICIES[policy]) else 0.0,
            "noise_held_steps": HELD_STEPS,
            "seeds": f"0 … {episodes - 1}",
        }
    )
    return dataset


def _stored(name: str, buffers: list[Any], env: Any, version: str, policy: str) -> Any:
    import minari

    return minari.create_dataset_from_buffers(
        name,
        buffers,
        env=env,
        algorithm_name=_WORDS[policy],
        author="The wtg_gym authors",
        description=f"{_WORDS[policy]}; suite {VERSIONS[version].suite}, split train; by python -m agents.datasets",
        requirements=["wtg-gym"],
    )


def data_sha256(dataset: Any) -> str:
    """Return the sha256 over a dataset's seeds, observations, actions, rewards, ends and infos."""
    digest = hashlib.sha256()
    for seed, episode in _episodes(dataset):
        digest.update(str(seed).encode())
        arrays = {name: getattr(episode, name) for name in ("observations", "actions", "rewards")}
        arrays |= {"terminations": episode.terminations, "truncations": episode.truncations, **episode.infos}
        for name in sorted(arrays):
            values = np.ascontiguousarray(arrays[name])
            digest.update(f"{name} {values.dtype.str} {values.shape}".encode())
            digest.update(values.tobytes())
    return digest.hexdigest()


def _episodes(dataset: Any) -> Iterator[tuple[int, Any]]:
    """Yield the seed and the data of every episode."""
    for episode in dataset.iterate_episodes():
        (metadata,) = dataset.storage.get_episode_metadata([episode.id])
        yield int(metadata["seed"]), episode


def check(dataset: Any) -> tuple[int, int]:
    """Play a dataset's actions again, in the environment that it says it is from.

    Returns:
        the numbers of episodes and of steps.

    Raises:
        ValueError: the data is not that of `data_sha256`, or an observation, a reward or an end differs in a bit.
    """
    name = dataset.spec.dataset_id
    if (found := data_sha256(dataset)) != (said := dataset.storage.metadata.get("data_sha256")):
        raise ValueError(f"the data of {name} has the sha256 {found}, its metadata says {said}")
    env, n_steps = dataset.recover_environment(), 0
    with contextlib.closing(env):
        for seed, episode in _episodes(dataset):
            observation, _ = env.reset(seed=seed)
            steps = zip(
                episode.observations[1:],
                episode.actions,
                episode.rewards,
                episode.terminations,
                episode.truncations,
                strict=True,
            )
            _require_same(name, seed, 0, observation, episode.observations[0])
            for step, (expected, action, *others) in enumerate(steps, start=1):
                observation, *outcome, _ = env.step(action)
                _require_same(name, seed, step, observation, expected)
                _require_same(name, seed, step, outcome, others)
                n_steps += 1
    return int(dataset.total_episodes), n_steps


def _require_same(name: str, seed: int, step: int, one: Any, other: Any) -> None:
    if not np.array_equal(one, other):
        raise ValueError(f"{name}: step {step} of the episode of seed {seed} is another one when played again")


# --- playing ---------------------------------------------------------------------------------------------------------


def _entry(version: str) -> Entry:
    (entry,) = load_entries(VERSIONS[version].policy)
    return entry


def _arguments(version: str, entry: Entry) -> dict[str, Any]:
    arguments = {"suite": VERSIONS[version].suite, "split": "train", "strategy": entry.law.name}
    return {**arguments, "action_mode": entry.action_mode, "observation_mode": entry.observation_mode}


def _played(version: str, entry: Entry, in_turn: Sequence[tuple[bool, bool]], seeds: range) -> list[Any]:
    """Play the episodes of neighbouring seeds side by side, which gives each the bits that it has alone.

    Returns:
        an `EpisodeBuffer` of each; observations and infos have a row more than there are steps, the start.
    """
    from minari.data_collector import EpisodeBuffer

    policy = entry.policy
    assert isinstance(policy, OnnxPolicy)
    n = len(seeds)
    ways = [in_turn[seed % len(in_turn)] for seed in seeds]
    acts, noisy = (np.array([way[index] for way in ways], dtype=np.float32)[:, None] for index in (0, 1))
    envs = GFMWTGVectorEnv(n, version=version, **_arguments(version, entry))
    with contextlib.closing(envs), policy:
        observations, infos = envs.reset(seed=seeds.start)
        keys = sorted(key for key, column in infos.items() if column.dtype.kind in "if")
        rows: list[tuple[Any, ...]] = []
        state, running = None, np.ones(n, dtype=np.bool_)
        lengths = np.zeros(n, dtype=np.int64)
        starts = (observations, np.stack([infos[key] for key in keys], axis=1))
        shape = envs.action_space.shape or ()
        generators = [np.random.default_rng(seed) for seed in seeds]
        noise = np.zeros(shape, dtype=np.float32)
        while running.any():
            if len(rows) % HELD_STEPS == 0:
                drawn = [generator.normal(0.0, NOISE, shape[1]) for generator in generators]
                noise = np.stack(drawn).astype(np.float32)
            actions = noisy * noise
            if acts.any():
                answer, state = policy.predict(observations, state, np.full(n, not rows), deterministic=True)
                actions = actions + acts * np.clip(answer, -1.0, 1.0)
            actions = np.clip(actions, -1.0, 1.0).astype(np.float32)
            observations, rewards, terminated, truncated, infos = envs.step(actions)
            columns = np.stack([infos[key] for key in keys], axis=1)
            rows.append((observations.copy(), actions, rewards.copy(), terminated.copy(), truncated.copy(), columns))
            lengths[running] += 1
            running &= ~(terminated | truncated)
    table = [np.stack(column) for column in zip(*rows, strict=True)]
    played = []
    for lane, seed in enumerate(seeds):
        seen, acted, rewards, terminated, truncated, columns = (each[: lengths[lane], lane] for each in table)
        infos_of = np.concatenate([starts[1][lane][None], columns])
        played.append(
            EpisodeBuffer(
                seed=seed,
                observations=np.concatenate([starts[0][lane][None], seen]),
                actions=acted,
                rewards=rewards.astype(np.float64),
                terminations=terminated,
                truncations=truncated,
                infos={key: infos_of[:, index] for index, key in enumerate(keys)},
            )
        )
    return played


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.datasets", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument(
        "--versions", nargs="+", choices=tuple(VERSIONS), default=list(VERSIONS), help="of the benchmark"
    )
    parser.add_argument("--policies", nargs="+", choices=tuple(POLICIES), default=list(POLICIES), help="who plays")
    parser.add_argument("--episodes", type=int, default=_DEFAULT_EPISODES, metavar="N", help="in each (default: 200)")
    parser.add_argument("--output", metavar="FOLDER", help="folder of the datasets (default: Minari's own)")
    parser.add_argument("--check", action="store_true", help="only play datasets that are there again")
    parser.add_argument("--overwrite", action="store_true", help="replace datasets that are there")

    def work() -> None:
        given = parser.parse_args(argv)
        require_package("minari", "'.[data]'")
        if given.episodes < 1:
            raise ValueError(f"--episodes must be 1 or more, got {given.episodes}")
        if given.output is not None:
            os.environ["MINARI_DATASETS_PATH"] = str(Path(given.output).resolve())
        import minari

        rows = []
        for version in given.versions:
            for policy in given.policies:
                name = dataset_id(version, policy)
                if given.check:
                    if name not in minari.list_local_datasets():
                        raise ValueError(f"there is no dataset {name}; leave out --check to make it")
                    dataset = minari.load_dataset(name)
                else:
                    dataset = make_dataset(version, policy, given.episodes, overwrite=given.overwrite)
                n_episodes, n_steps = check(dataset)
                rows.append([name, str(n_episodes), str(n_steps), dataset.storage.metadata["data_sha256"]])
        print_table(["dataset", "episodes", "steps, same bits again", "sha256 of the data"], rows, left=(0, 3))

    return run_command(work)


if __name__ == "__main__":
    sys.exit(main())
