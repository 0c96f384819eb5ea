"""How the policies and laws made by hand were found: by CMA-ES on training scenarios.

    python docs/studies/policies.py [--output FOLDER]

prints the laws and the three numbers of mean-droop of version v1, and writes the feedbacks of agents/policies again, as
entries, to FOLDER (default: results/policies); those that are there already are left. To tune something of your own,
change the lists below, or call `tune_law`, `tune_mean_droop` and `tune_feedback`. On two processors a law and the droop
take ten minutes each at most, a feedback half an hour.
"""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from output import folder as output_folder
from rollouts import HISTORY_COLUMNS, Rollouts, Search, history_feedback, history_gains, linear_feedback
from torch import Tensor, nn

from baselines.mean_droop import FULL_ACTION_HZ, ROTOR_GAIN, SLOW_ROTOR_PU, MeanDroop
from wtg_gym import export_onnx
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.tracking_law import (
    LARGEST_COEFFICIENT,
    TIME_CONSTANT_RANGE,
    TrackingLaw,
    Tuning,
    coordinated_piecewise,
)
from wtg_gym.progress import Progress
from wtg_gym.scenarios import get_suite
from wtg_gym.scenarios.benchmark import V1

#: Least coefficient that is tried [p.u.]: at 0 a group would give nothing.
LEAST_COEFFICIENT = 0.05


@dataclass(frozen=True, kw_only=True)
class Feedback:
    """A feedback of a group's own observation, the same in every group, and how it is tuned."""

    folder: str  # of the entry
    name: str
    suite: str
    strategy: str  # law that the actions modulate
    history: bool = False  # whether slow copies of the observation are fed back too
    n_scenarios: int = 96
    generations: int = 80
    population: int = 24
    seed: int = 0


FEEDBACKS = (
    Feedback(
        folder="linear-feedback",
        name="linear-feedback",
        suite="standard",
        strategy="coordinated-piecewise",
        n_scenarios=64,
        generations=150,
    ),
    Feedback(folder="linear-feedback-v1", name="linear-feedback", suite="standard-v1", strategy="coordinated-tuned"),
    Feedback(
        folder="history-feedback-v1",
        name="history-feedback",
        suite="standard-v1",
        strategy="coordinated-tuned",
        history=True,
        generations=150,
    ),
)


# --- laws ------------------------------------------------------------------------------------------------------------

#: Points of :func:`law_of` where searches begin, without and with the bound at K_opt.
_FREE, _CAPPED = (1.2, 0.0, 1.0, 0.0), (0.0, 1.0, 0.0)
#: Share of K_opt - K_pr by which K_n changes at most: with less power at nominal frequency runs could not start.
MOST_ABOVE_NOMINAL = 0.08
#: A multiple of 15 consecutive seeds holds as many of each stratum, and of each kind of extreme event.
N_SCENARIOS = 120


def law_of(x: Floats) -> TrackingLaw:
    """Return the law of a point, made monotone, and held in range.

    A point is how far k lies above K_opt, above K_n and below K_pr, as shares of K_opt - K_pr, and ln(τ / 0.8 s);
    without the first number k_min is K_opt, and nothing is beyond it.
    """
    paper = coordinated_piecewise()
    span, capped = paper.k_min - paper.k_max, len(x) == 3
    above_opt, above_nominal, below_limit, log_tau = (0.0, *x) if capped else x
    above_nominal = min(max(above_nominal, -MOST_ABOVE_NOMINAL), MOST_ABOVE_NOMINAL)
    nominal = paper.k_nominal + above_nominal * span
    corners = max(paper.k_min + above_opt * span, nominal), nominal, min(paper.k_max - below_limit * span, nominal)
    k_min, k_nominal, k_max = (min(max(float(k), LEAST_COEFFICIENT), LARGEST_COEFFICIENT) for k in corners)
    low, high = TIME_CONSTANT_RANGE
    tau = min(max(paper.damping_time_constant_s * math.exp(log_tau), low), high)
    return TrackingLaw(name="tuned", k_min=k_min, k_nominal=k_nominal, k_max=k_max, damping_time_constant_s=tau)


def tuning_of(law: TrackingLaw) -> Tuning:
    """Return the numbers that make a law of the piecewise one."""
    paper = coordinated_piecewise()
    away = law.k_min - paper.k_min, law.k_nominal - paper.k_nominal, paper.k_max - law.k_max
    return Tuning(*(offset / (paper.k_min - paper.k_max) for offset in away), law.damping_time_constant_s)


def tune_law(
    suite: str,
    capped: bool,
    n_scenarios: int = N_SCENARIOS,
    generations: int = 18,
    population: int = 12,
    seed: int = 1,
) -> TrackingLaw:
    """Return the law that scores most, by the scales that the present anchors have."""
    search = Search(np.array(_CAPPED if capped else _FREE), 0.4, population, seed)
    train = get_suite(suite).train[:n_scenarios]
    with Progress("generations") as progress, closing(Rollouts(suite, "train", train, population)) as rollouts:
        for generation in range(generations):
            asked = search.ask()
            costs = rollouts.objective(rollouts.play(laws=[law_of(x) for x in asked])).mean(axis=0)
            search.tell(asked, costs)
            progress.update(f"objective {costs.min():.4f}", generation + 1, generations)
    return law_of(search.mean)


def mean_droop_of(x: Floats) -> MeanDroop:
    """Return mean-droop of points (..., 3), each ln(F / 0.5 Hz), (ω_1 - 0.7) / 0.1 and ln(G / 5)."""
    full_action, slow_rotor, gain = np.moveaxis(np.asarray(x), -1, 0)[..., np.newaxis]
    return MeanDroop(FULL_ACTION_HZ * np.exp(full_action), SLOW_ROTOR_PU + 0.1 * slow_rotor, ROTOR_GAIN * np.exp(gain))


def tune_mean_droop(
    suite: str,
    strategy: str = "coordinated-tuned",
    n_scenarios: int = N_SCENARIOS,
    generations: int = 18,
    population: int = 12,
    seed: int = 1,
) -> tuple[MeanDroop, float]:
    """Return the three numbers that cost little on a law, and what they cost in the scales of the score."""
    search = Search(np.zeros(3), 0.4, population, seed)
    train, how = get_suite(suite).train[:n_scenarios], {"strategy": strategy, "action_mode": "k"}
    with Progress("generations") as progress, closing(Rollouts(suite, "train", train, population, **how)) as rollouts:

        def costs_of(points: Floats) -> Floats:
            policy = mean_droop_of(points)
            return rollouts.objective(rollouts.play(lambda _step, own: policy.act(own)[..., np.newaxis])).mean(axis=0)

        for generation in range(generations):
            asked = search.ask()
            costs = costs_of(asked)
            search.tell(asked, costs)
            progress.update(f"mean-droop, objective {costs.min():.4f}", generation + 1, generations)
        return mean_droop_of(search.mean), float(costs_of(np.tile(search.mean, (population, 1)))[0])


# --- feedbacks -------------------------------------------------------------------------------------------------------


def tune_feedback(how: Feedback) -> tuple[Floats, int]:
    """Return gains that make the objective small, b as their last column, and the number of groups."""
    train = get_suite(how.suite).train[: how.n_scenarios]
    with (
        Progress("generations") as progress,
        closing(Rollouts(how.suite, "train", train, how.population, strategy=how.strategy)) as rollouts,
    ):
        dt = rollouts.lanes.settings.control_dt
        shape = rollouts.n_action, rollouts.n_local + (len(HISTORY_COLUMNS) if how.history else 0) + 1
        search = Search(np.zeros(shape), 0.15, how.population, how.seed)
        for generation in range(how.generations):
            asked = search.ask()
            gains = asked.reshape(-1, *shape)
            act = history_feedback(gains, dt) if how.history else linear_feedback(gains)
            costs = rollouts.objective(rollouts.play(act)).mean(axis=0)
            search.tell(asked, costs)
            progress.update(f"{how.folder}, objective {costs.min():.4f}", generation + 1, how.generations)
        return search.mean.reshape(shape), rollouts.n_wtg


class FeedbackModule(nn.Module):
    """a = G (o, slow copies) + b of each group's own observation, for the export.

    Slow copies y += gain (o - y) begin at o: the second state is 0 at the start of an episode and 1 from then on.
    """

    def __init__(self, gains: Floats, n_wtg: int, history_dt: float | None = None) -> None:
        super().__init__()
        n_history = 0 if history_dt is None else len(HISTORY_COLUMNS)
        self._gains = nn.Parameter(torch.as_tensor(gains[:, :-1], dtype=torch.float32))
        self._offset = nn.Parameter(torch.as_tensor(gains[:, -1], dtype=torch.float32))
        self._n_wtg, self._n_local = n_wtg, gains.shape[1] - 1 - n_history
        self._filters = torch.as_tensor(history_gains(history_dt or 1.0), dtype=torch.float32)
        self.state_widths = (n_wtg * n_history, 1) if n_history else ()

    def forward(self, observation: Tensor, *states: Tensor) -> tuple[Tensor, ...]:
        own = observation.reshape(observation.shape[0], self._n_wtg, -1)
        seen, following = own[..., : self._n_local], ()
        if states:
            slow, started = states
            now = own[..., list(HISTORY_COLUMNS)]
            before = torch.where(started[:, None] > 0.5, slow.reshape(now.shape), now)
            slow = before + self._filters * (now - before)
            seen, following = torch.cat([seen, slow], dim=-1), (slow.flatten(1), torch.ones_like(started))
        return ((seen @ self._gains.T + self._offset).flatten(1), *following)


def write_feedback(how: Feedback, gains: Floats, n_wtg: int, folder: Path) -> None:
    """Write a feedback as an entry of the leaderboard."""
    history_dt = EnvSettings(suite=how.suite).control_dt if how.history else None
    past = " and its past" if how.history else ""
    export_onnx(
        FeedbackModule(gains, n_wtg, history_dt),
        folder,
        name=how.name,
        environment=get_suite(how.suite).benchmark.env_id,
        strategy=how.strategy,
        description=f"Linear feedback of a group's own observation{past}, the same in every group, tuned by CMA-ES on "
        f"{how.n_scenarios} training scenarios of {how.suite}.",
        training_seed=how.seed,
        authors=["The wtg_gym authors"],
    )


if __name__ == "__main__":
    target = output_folder(__doc__, "results/policies")
    for feedback in FEEDBACKS:
        if not (target / feedback.folder / "entry.toml").exists():
            write_feedback(feedback, *tune_feedback(feedback), target / feedback.folder)
            print(f"wrote {target / feedback.folder}")
    for name, capped in (("coordinated-tuned", True), ("coordinated-free", False)):
        law = tune_law("standard-v1", capped)
        print(f"{name}: " + ", ".join(f"{key} {value:.3f}" for key, value in tuning_of(law)._asdict().items()))
        print(f"k {law.k_min:.3f}, {law.k_nominal:.3f}, {law.k_max:.3f} p.u.")
    for strategy in V1.anchors:
        droop, cost = tune_mean_droop("standard-v1", strategy)
        numbers = ", ".join(f"{name} {float(value):.3f}" for name, value in vars(droop).items())
        print(f"mean-droop on {strategy}: {numbers}; objective {cost:.4f}")
