"""Frozen environments answer as ever: over suites, modes, autoresets and threads, single and batched.

`python -m tests.envs.test_frozen v0` wrote the answers of version 0.1.0, once: another answer is another environment,
with another id.
"""

import hashlib
import itertools
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import ACTION_MODES, MODES, OBSERVATION_MODES
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.evaluation.circumstances import versions
from wtg_gym.scenarios import FROZEN_HASHES, SUITES

#: Longer than an episode, so that environments start again; episodes of v1 are cut to a minute.
_N_STEPS, _NUM_ENVS = {"v0": 640, "v1": 130}, 17
_LENGTHS = {"v0": {}, "v1": {"duration_s": 60.0}}
_TWO_LAWS = ["coordinated-linear", "coordinated-undamped"]
#: Settings besides the modes under which a suite is played once more.
_VARIANTS = {}
_VARIANTS["v0"] = {
    "stalls": {"suite": "low-wind", "strategy": "mppt"},
    "trips": {"suite": "low-wind", "strategy": "deloaded-5", "on_failure": "trip"},
    "classical": {"suite": "gust", "plant": {"machine_model": "classical"}},
    "three groups": {"suite": "weak-grid", "groups": 3},
    "one group": {"suite": "standard", "groups": [{"bus": 3, "n_turbines": 4.0}]},
    "fine steps": {"suite": "standard", "control_dt": 0.05, "plant": {"simulation_dt": 0.0125}},
    "laws": {"suite": "standard", "strategy": _TWO_LAWS},
}
_VARIANTS["v1"] = {
    "fails": {"suite": "gusty-v1", "strategy": "mppt"},
    "trips": {"suite": "high-share-v1", "strategy": "deloaded-5", "on_failure": "trip"},
    "classical": {"suite": "faults-v1", "plant": {"machine_model": "classical"}},
    "exact": {"suite": "standard-v1", "sensors": "exact", "observation_mode": "privileged"},
    "late": {"suite": "standard-v1", "sensors": {"delay_s": (0.0, 1.0), "wind_bias": 0.2}},
    "fine steps": {"suite": "standard-v1", "control_dt": 0.05, "plant": {"simulation_dt": 0.0125}},
    "laws": {"suite": "low-share-v1", "strategy": [*_TWO_LAWS, "mppt", "deloaded-10"]},
    "ieee39": {"suite": "ieee39-v1"},
    "kundur": {"suite": "kundur-v1", "strategy": "coordinated-free"},
    "nordic45": {"suite": "nordic45-v1", "observation_mode": "privileged"},
}


class _Answers:
    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._n_ends = 0
        self._sums = np.zeros(3)

    def add(self, observations, rewards=0.0, terminated=False, truncated=False) -> None:
        for values in (observations, np.float64(rewards), np.bool_(terminated), np.bool_(truncated)):
            self._hash.update(np.ascontiguousarray(values).tobytes())
        self._n_ends += int(np.sum(terminated) + np.sum(truncated))
        wide = np.asarray(observations, dtype=np.float64)
        self._sums += [np.sum(rewards), np.sum(wide), np.sum(wide * np.arange(1, wide.shape[-1] + 1))]

    def as_dict(self):
        return {"sha256": self._hash.hexdigest(), "n_ends": self._n_ends, "sums": self._sums.tolist()}


def _batched(mode: AutoresetMode, n_threads: int, n_steps: int, **settings):
    env = GFMWTGVectorEnv(_NUM_ENVS, autoreset_mode=mode, n_threads=n_threads, **settings)
    rng, answers = np.random.default_rng(7), _Answers()
    answers.add(env.reset(seed=3)[0])
    for _ in range(n_steps):
        observations, rewards, terminated, truncated, _ = env.step(rng.uniform(-1.1, 1.1, env.action_space.shape))
        answers.add(observations, rewards, terminated, truncated)
        over = terminated | truncated
        if mode == AutoresetMode.DISABLED and over.any():
            answers.add(env.reset(options={"reset_mask": over})[0])
    env.close()
    return answers.as_dict()


def _single(**settings):
    env = GFMWTGEnv(**settings)
    rng, answers = np.random.default_rng(8), _Answers()
    for seed in range(2):
        answers.add(env.reset(seed=seed)[0])
        over = False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(rng.uniform(-1.1, 1.1, env.action_space.shape))
            answers.add(observation, reward, terminated, truncated)
            over = terminated or truncated
    return answers.as_dict()


def cases(version: str):
    result = {}
    modes = list(itertools.product(ACTION_MODES, OBSERVATION_MODES))
    splits = itertools.cycle(("train", "validation", "test"))
    autoresets, threads = itertools.cycle(MODES), itertools.cycle((1, 2))

    def add(name: str, settings) -> None:
        settings = {"split": next(splits), **_LENGTHS[version], **settings}
        mode, n_threads = next(autoresets), next(threads)
        result[f"{name}, single"] = lambda: _single(**settings)
        result[f"{name}, batched"] = lambda: _batched(mode, n_threads, _N_STEPS[version], **settings)

    suites = [name for name, suite in SUITES.items() if suite.env_id == f"GFMWTG-14bus-{version}"]
    for suite, (action, observation) in itertools.product(suites, modes):
        chosen = {"suite": suite, "action_mode": action, "observation_mode": observation}
        add(f"{suite}, {action}, {observation}", chosen)
    for name, settings in _VARIANTS[version].items():
        add(name, settings)
    return result


FILES = sorted(Path(__file__).parent.glob("frozen_v*.json"))
RECORDED = {path.stem.removeprefix("frozen_"): json.loads(path.read_text(encoding="utf-8")) for path in FILES}
CASES = {version: cases(version) for version in RECORDED}


def test_a_version_is_frozen_in_its_suites_and_its_answers_alike_and_every_case_is_recorded():
    assert "v0" in RECORDED
    assert {SUITES[name].task.version for name in FROZEN_HASHES} == set(RECORDED)
    assert set(FROZEN_HASHES) == {name for name, suite in SUITES.items() if suite.task.version in RECORDED}
    assert all(list(CASES[version]) == list(recorded["cases"]) for version, recorded in RECORDED.items())


@pytest.mark.parametrize(("version", "name"), [(version, name) for version in CASES for name in CASES[version]])
def test_answers_are_those_of_the_first_version(version, name):
    recorded, answers = RECORDED[version]["cases"][name], CASES[version][name]()
    assert answers["n_ends"] == recorded["n_ends"]
    assert answers["sums"] == pytest.approx(recorded["sums"], rel=1e-6, abs=1e-3)
    # Equilibria come from LAPACK, whose last bits depend on the processor.
    ours, theirs = versions(), RECORDED[version]["versions"]
    if all(theirs[key] == ours.get(key) for key in ("processor", "numpy", "scipy", "numba")):
        assert answers["sha256"] == recorded["sha256"]


if __name__ == "__main__":
    version = sys.argv[1]
    answers = {name: play() for name, play in cases(version).items()}
    text = json.dumps({"versions": versions(), "cases": answers}, indent=1)
    Path(__file__).with_name(f"frozen_{version}.json").write_text(f"{text}\n", encoding="utf-8")
