"""A match: actions by hand against the reference in the same scenario, and the score of both at the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import NoScaleError, evaluate
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.score import log_gains, mean_score, pinned, points_by_term, score_scale
from wtg_gym.evaluation.summary import POINTS, REST, parts_of_costs
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.plotting.live.episode import LiveEpisode, happened
from wtg_gym.scenarios import SPLITS, Suite

#: Scenarios of the suite on which its anchors make the scale of the scores.
N_SCALE = 50
#: Name of the one who plays.
YOU = "you"


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Numbers that a suite's scores are computed with."""

    #: suite, duration_s: which episodes it is for.
    suite: Suite
    duration_s: float
    value: float | None  # Λ, None where there is none
    missing: str = ""  # why there is none; else empty

    @classmethod
    def of(cls, suite: Suite, duration_s: float | None = None) -> Scale:
        """Play the suite's anchors on its first validation scenarios; `duration_s` is None for the suite's own."""
        seeds = list(suite.validation[:N_SCALE])
        results = evaluate([], suite.name, "validation", seeds=seeds, duration_s=duration_s)
        anchors = results.benchmark.anchors
        zero, hundred = (results.pinned_costs[name][0] for name in anchors)
        length = suite.duration_s if duration_s is None else duration_s
        try:
            return cls(suite=suite, duration_s=length, value=score_scale(zero, hundred, anchors))
        except NoScaleError as error:
            return cls(suite=suite, duration_s=length, value=None, missing=str(error))


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What one of the two, or an anchor, made of the scenario."""

    name: str  # of who played
    score: float | None  # None without a scale
    #: Points of the score above 100 by the terms of the cost; they add up to the score minus 100.
    points: Mapping[str, float]
    cost: float  # as it was paid
    deviation_hz: float  # largest deviation of the frequency, up or down [Hz]
    failure: str  # why it ended before its time; empty where it did not


class Match:
    """You against the reference, which never acts, in one scenario of a suite.

    Both run the reference's law; your actions come on top of it, as an agent's do.

    Args:
        scale: of the suite and of the length of its episodes.
        seed: of the scenario, in any split of the suite.

    Raises:
        ValueError: the seed is in no split, or the scenario cannot start.
    """

    def __init__(self, scale: Scale, seed: int) -> None:
        self.scale, self.seed = scale, seed
        suite = scale.suite
        self._split = split_of(suite, seed)
        self.scenario = suite.scenario(seed, duration_s=scale.duration_s)
        settings = EnvSettings(suite=suite.name, scenario=self.scenario)
        self.you, self.reference = LiveEpisode(settings, self.scenario), LiveEpisode(settings, self.scenario)
        self.n_groups = self.you.lanes.n_wtg
        self.control_dt = settings.control_dt

    @property
    def over(self) -> bool:
        """Whether your run has ended."""
        return self.you.over

    def step(self, on_k: npt.ArrayLike, on_tau: npt.ArrayLike) -> list[tuple[float, str]]:
        """Advance both by one control interval, and return what happened in it: instants [s] and words.

        Args:
            on_k, on_tau: your action, (n_groups,) each, -1 … 1.
        """
        before = self.you.time_s
        # Group after group, as the environment takes them.
        self.you.step(np.stack([np.asarray(on_k), np.asarray(on_tau)], axis=1).ravel())
        self.reference.step()
        # An event at the very start is one too.
        return happened(self.scenario, -1.0 if before == 0.0 else before, self.you.time_s)

    def verdicts(self) -> list[Verdict]:
        """Return yours first, then those of the suite's anchors, of which the reference is one, once you are over."""
        suite = self.scale.suite
        results = evaluate(
            [], suite.name, self._split, seeds=[self.seed], duration_s=self.scale.duration_s, n_threads=1
        )
        anchors = {name: results.episodes_of(name)[0] for name in results.benchmark.anchors}
        cap = float(results.settings["weights"]["cap"])
        hundred = anchors[results.benchmark.hundred]
        return [
            verdict(episode, hundred, self.scale.value, cap) for episode in (self.you.measured(YOU), *anchors.values())
        ]

    def next_seed(self) -> int:
        """Return the seed after this one in its split; after the last one the first."""
        seeds = self.scale.suite.seeds(self._split)
        return seeds[(seeds.index(self.seed) + 1) % len(seeds)]


def split_of(suite: Suite, seed: int) -> str:
    """Return the split that a seed is in; a ValueError says which seeds there are."""
    for split in SPLITS:
        if seed in suite.seeds(split):
            return split
    known = ", ".join(f"{split} {(s := suite.seeds(split)).start} … {s.stop - 1}" for split in SPLITS)
    raise ValueError(f"seed {seed} is in no split of suite {suite.name!r} that can be played: {known}")


def verdict(episode: Episode, hundred: Episode, scale: float | None, cap: float) -> Verdict:
    """Return what an episode is worth beside that of the hundred, with Λ and the largest cost rate [1/s]."""
    metrics = {name: float(value) for name, value in episode.metrics.items() if value is not None}
    nominal = modified_ieee14().frequency_hz
    deviation = max(nominal - metrics["nadir_hz"], metrics["zenith_hz"] - nominal)
    score, points = None, dict.fromkeys((*POINTS, REST), 0.0)
    if scale is not None:
        own, best = np.array([[pinned(episode, cap)]]), np.array([pinned(hundred, cap)])
        score = mean_score(log_gains(own, best), scale)
        terms, of_best = parts_of_costs([[episode]], own), parts_of_costs([[hundred]], best[np.newaxis])
        shares = points_by_term(own, best, terms, of_best[:, 0], scale)
        points = dict(zip((*POINTS, REST), shares.tolist(), strict=True))
    return Verdict(
        name=episode.entry,
        score=score,
        points=points,
        cost=metrics["cost"],
        deviation_hz=deviation,
        failure=episode.failure,
    )
