"""`python -m agents.lagrangian`: PPO under a bound on the violation of constraints, by a Lagrange multiplier.

The bound is on the share of steps with `info["cost"]` = 1. Every such step costs the multiplier, which rises while the
share is above the bound and falls while it is below; the share is that of the policy without noise, in lanes of its
own. This is reward-constrained policy optimisation (Tessler, Mankowitz and Mannor, "Reward Constrained Policy
Optimization", 2019) on top of Stable-Baselines3's PPO.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from torch import nn

from agents.command import KEPT, Parser, Progress, add_comparison_options, compare, require_range, run_command
from agents.gains import stagger
from agents.hyperparameters import CONFIG_FOLDER, parse, read_config
from agents.learners import build_model
from agents.vec_env import GainVecEnv
from wtg_gym.envs import GFMWTGVectorEnv
from wtg_gym.evaluation import Results
from wtg_gym.evaluation.statistics import mean_interval
from wtg_gym.policies.torch_export import export_onnx
from wtg_gym.sb3 import DeterministicPolicy
from wtg_gym.scenarios import get_suite

_SUITE, _NAME, _UNBOUND = "standard", "Lagrangian PPO", "PPO without bound"
#: The reward pays for frequency and RoCoF alone, so that nothing but the bound protects turbines and converters.
_WEIGHTS = {"duty": 0.0, "rotor": 0.0, "overload": 0.0}
#: It does not fall: the multiplier has to be heard to the end.
_LEARNING_RATE = 0.0003
#: The multiplier's rise in a rollout, per unit of the share of violating steps above the bound [% of an episode's cost
#: for a violating step].
_RATE = 300.0
#: The share that training aims at, of the bound: on other scenarios it is another one.
_AIM = 0.8

_DESCRIPTION = f"""\
Trains PPO on {_SUITE} to support the frequency, under a bound on the share of steps that violate a constraint, and once
more without the bound. Exports both as entries, and compares them with the law under their actions on scenarios of the
training split that they have not seen: violations are rare, and validation scenarios too few to count them."""
_EXAMPLES = f"""\
examples:
  python -m agents.lagrangian --bound 1.25 --output runs/lagrangian
  wtg-gym evaluate --suite {_SUITE} --entries runs/lagrangian/*"""


class PenalisedVecEnv(GainVecEnv):
    """Lanes whose gains are less by :attr:`multiplier` in every step that violates a constraint.

    A failure violates in all steps that are left: else it would be the cheapest way out of a violation that lasts.
    """

    #: [% of an episode's cost for a violating step].
    multiplier = 0.0

    def step_wait(self) -> Any:
        """Hold the actions for one control interval in every lane; returns observations, gains, dones and infos."""
        observations, gains, dones, infos = super().step_wait()
        violated = self.vector_env.lanes.info_arrays()["cost"].astype(np.float64)
        for lane in np.flatnonzero(dones):
            # The lane is in its next episode already.
            left = self._gains.n_steps - round(infos[lane]["time_s"] / self.vector_env.settings.control_dt)
            violated[lane] = infos[lane]["cost"] + left
        return observations, (gains - self.multiplier * violated).astype(np.float32), dones, infos


class Measure:
    """Episodes of the training split that a policy plays without noise, to measure what it violates.

    Exploring violates far more: a bound on its share would be another one.

    Args:
        n_envs: number of lanes.
        seed: lane i draws from seed + i.
    """

    def __init__(self, n_envs: int, seed: int) -> None:
        self._envs = GFMWTGVectorEnv(n_envs, autoreset_mode="SameStep", suite=_SUITE)
        self._envs.reset(seed=seed)
        self._observations = stagger(self._envs)

    @torch.no_grad()
    def share(self, actor: nn.Module, n_steps: int) -> float:
        """Return the share of violating steps in the next steps of every lane; `actor` answers (actions,)."""
        n_violated = 0.0
        for _ in range(n_steps):
            (actions,) = actor(torch.as_tensor(self._observations))
            self._observations, _, terminated, truncated, infos = self._envs.step(actions.numpy())
            over, violated = terminated | truncated, np.asarray(infos["cost"], dtype=np.float64).copy()
            if over.any():
                # The other infos are already those of the next episode.
                violated[over] = infos["final_info"]["cost"][over]
            n_violated += float(violated.sum())
        return n_violated / (n_steps * self._envs.num_envs)

    def close(self) -> None:
        """Release the worker threads."""
        self._envs.close()


class _Multiplier(BaseCallback):
    """Moves the multiplier after every rollout where there is a bound."""

    def __init__(self, envs: PenalisedVecEnv, measure: Measure, bound: float | None, progress: Progress) -> None:
        super().__init__()
        self._envs, self._measure, self._bound, self._progress = envs, measure, bound, progress
        #: Share and multiplier of every rollout.
        self.course: list[tuple[float, float]] = []

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        model = self.model
        assert isinstance(model, PPO)
        multiplier = self._envs.multiplier
        self.course.append((self._measure.share(DeterministicPolicy(model), model.n_steps), multiplier))
        # That of whole episodes: four rollouts are as long as one.
        share = float(np.mean([share for share, _ in self.course[-4:]]))
        if self._bound is not None:
            self._envs.multiplier = max(0.0, multiplier + _RATE * (share - _AIM * self._bound))
        said = f"violating {100 * share:.2f} %, multiplier {multiplier:.2f}"
        self._progress.update(said, self.num_timesteps // 1000, self.locals["total_timesteps"] // 1000)


def train(bound: float | None, timesteps: int, n_envs: int, seed: int, folder: Path) -> list[tuple[float, float]]:
    """Train under a bound and write the last policy as an entry.

    Args:
        bound: on the share of steps that violate a constraint; None for no bound.
        timesteps, n_envs, seed: environment steps, episodes side by side, and the seed of everything random.
        folder: of the entry.

    Returns:
        the share and the multiplier of every rollout.
    """
    torch.set_num_threads(1)
    raw = read_config(CONFIG_FOLDER / "ppo.yml", get_suite(_SUITE).benchmark.env_id)
    hyperparameters = parse("ppo", {**raw, "learning_rate": _LEARNING_RATE})
    envs = PenalisedVecEnv(n_envs, suite=_SUITE, weights=_WEIGHTS)
    normalized = VecNormalize(VecMonitor(envs), **(hyperparameters.normalize or {}))
    model = build_model("ppo", hyperparameters, normalized, seed=seed, device="cpu")
    assert isinstance(model, PPO)
    # Scenarios that no other lane begins with.
    measure = Measure(n_envs, seed + n_envs)
    with Progress("thousand steps") as progress:
        multiplier = _Multiplier(envs, measure, bound, progress)
        model.learn(timesteps, callback=multiplier)
    export_onnx(
        DeterministicPolicy(model),
        folder,
        name=_UNBOUND if bound is None else _NAME,
        environment=get_suite(_SUITE).benchmark.env_id,
        training_seed=seed,
        description="PPO" if bound is None else f"PPO under a bound of {100 * bound:g} % of violating steps.",
        trained_on=f"{_SUITE}, split train, {timesteps} steps",
    )
    normalized.close()
    measure.close()
    return multiplier.course


def violated_percent(results: Results, name: str) -> npt.NDArray[np.float64]:
    """Return the time in which an entry violated a constraint, of the mean time it survived [%], (n_runs, n_scenarios).

    The mean of all is the share of the steps it made.
    """
    episodes = sorted(results.episodes_of(name), key=lambda episode: episode.seed)
    runs: dict[int | None, list[float]] = {}
    for each in episodes:
        runs.setdefault(each.training_seed, []).append(each.metrics["constraint_time_s"] or 0.0)
    survived_s = np.mean([each.metrics["survived_s"] or 0.0 for each in episodes])
    shares: npt.NDArray[np.float64] = 100.0 * np.array(list(runs.values())) / survived_s
    return shares


def _violated(results: Results, name: str) -> str:
    share = mean_interval(violated_percent(results, name))
    return f"{share.value:.2f} ({share.low:.2f} … {share.high:.2f})"


def _paid_for(results: Results, name: str) -> str:
    """Say what the reward pays for: the mean cost of frequency and RoCoF."""
    episodes = results.episodes_of(name)
    costs = [(each.metrics["cost_frequency"] or 0.0) + (each.metrics["cost_rocof"] or 0.0) for each in episodes]
    return f"{np.mean(costs):.2f}"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.lagrangian", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument(
        "--bound", type=float, default=1.25, metavar="X", help="on the share of steps [%%] (default: 1.25)"
    )
    parser.add_argument(
        "--timesteps", type=int, default=3_000_000, metavar="N", help="of each training (default: 3000000)"
    )
    parser.add_argument("--n-envs", type=int, default=512, metavar="N", help="episodes side by side (default: 512)")
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0], metavar="N", help="two trainings for each (default: 0)"
    )
    add_comparison_options(parser, scenarios=2000)

    def work() -> None:
        given = parser.parse_args(argv)
        if not 0.0 < given.bound < 100.0:
            raise ValueError(f"--bound must be between 0 and 100 %, got {given.bound:g}")
        require_range("--timesteps", given.timesteps, 1, 10**12, "steps")
        require_range("--n-envs", given.n_envs, 1, 100_000, "episodes")
        seeds = sorted(set(given.seeds))
        for seed in seeds:
            require_range("--seeds", seed, 0, 2**31 - 1, "")

        def trained(output: Path) -> list[Path]:
            folders = []
            for seed in seeds:
                for name, bound in ((f"bound-{seed}", given.bound / 100.0), (f"free-{seed}", None)):
                    folders.append(output / name)
                    train(bound, given.timesteps, given.n_envs, seed, folders[-1])
            return folders

        compare(
            given,
            trained,
            _SUITE,
            f"{given.timesteps:,} steps, seeds {', '.join(map(str, seeds))}",
            "lagrangian",
            {"frequency, RoCoF": _paid_for, f"violating [%], bound {given.bound:g}": _violated},
            "train",
        )

    return run_command(work, KEPT)


if __name__ == "__main__":
    sys.exit(main())
