"""A match: actions by hand against the reference in the same scenario, and the cost of both at the end."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.scenarios import SPLITS, Suite

#: Name of the one who plays.
YOU = "you"
#: Lanes of the two.
OWN, REFERENCE = 0, 1


class Verdict(NamedTuple):
    """What you or an anchor made of the scenario."""

    name: str  # of who played
    cost: float  # as it was paid
    deviation_hz: float  # largest deviation of the frequency, up or down [Hz]
    failure: str  # why it ended before its time; empty where it did not


class Match:
    """You against the reference, which never acts, in one scenario of a suite; a ValueError if the seed is in no split.

    Both run the reference's law; your actions come on top of it, as an agent's do.
    """

    def __init__(self, suite: Suite, seed: int, duration_s: float | None = None) -> None:
        self.suite, self.seed, self._split = suite, seed, split_of(suite, seed)
        settings = EnvSettings(suite=suite.name, duration_s=duration_s)
        self.duration_s = settings.episode_duration_s()
        self._lanes = TaskLanes(settings, 2, 1)
        self._lanes.start([OWN, REFERENCE], self._lanes.scenarios([seed, seed]))
        self.n_groups, self.control_dt = self._lanes.n_wtg, settings.step_s
        self.nominal_hz = self._lanes.nominal_hz
        self._actions: list[npt.NDArray[np.float64]] = []

    @property
    def over(self) -> bool:
        """Whether your run has ended."""
        return self.has_ended(OWN)

    def has_ended(self, lane: int) -> bool:
        """Whether the run of a lane has ended."""
        return bool(self._lanes.outputs.terminated[lane] or self._lanes.outputs.truncated[lane])

    @property
    def time_s(self) -> float:
        """Time since your start [s]; of a failure its instant."""
        return float(self._lanes.simulator.lane_values("step")[OWN]) * self._lanes.simulator.settings.simulation_dt

    def step(self, k: float, tau: float) -> list[tuple[float, str]]:
        """Hold your action on k and τ of all groups for a control interval; return times [s] and words of events."""
        # An event at the very start is one too.
        before_s = self.time_s if self._actions else -1.0
        # Group after group, as the environment takes them.
        self._actions.append(np.tile([k, tau], self.n_groups))
        self._lanes.step(np.stack([self._actions[-1], np.zeros(self._lanes.n_action)]))
        events = sorted(self._lanes.events[OWN], key=lambda event: event.time_s)
        return [(e.time_s, e.words) for e in events if before_s < e.time_s <= self.time_s]

    def sample(self) -> dict[str, npt.NDArray[np.float64]]:
        """Return where both stand: frequency (2,) [Hz]; rotor speed and power (2, n_groups) [p.u.]."""
        simulator = self._lanes.simulator
        return {
            "frequency": self.nominal_hz * simulator.lane_values("coi"),
            "rotor": simulator.wtg_values("rotor_speed"),
            "power": simulator.wtg_values("power"),
        }

    def verdicts(self) -> list[Verdict]:
        """Play your actions and the suite's anchors again, and return what the evaluator says, yours first."""
        results = evaluate(
            [Entry(name=YOU, policy=_Played(self._actions))],
            self.suite.name,
            self._split,
            seeds=[self.seed],
            duration_s=self.duration_s,
            n_threads=1,
        )
        verdicts = []
        for name in (YOU, *results.task.anchors):
            (episode,) = results.episodes_of(name)
            metrics = {key: float(value) for key, value in episode.metrics.items() if value is not None}
            deviation = max(self.nominal_hz - metrics["nadir_hz"], metrics["zenith_hz"] - self.nominal_hz)
            verdicts.append(Verdict(name, metrics["cost"], deviation, episode.failure))
        return verdicts

    def next_seed(self) -> int:
        """Return the seed after this one in its split; after the last one the first."""
        seeds = self.suite.seeds(self._split)
        return seeds[(seeds.index(self.seed) + 1) % len(seeds)]


class _Played:
    """A policy that repeats the actions of one episode; its state is the number of steps."""

    def __init__(self, actions: list[npt.NDArray[np.float64]]) -> None:
        self._actions = actions

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        step = state or 0
        return self._actions[step][np.newaxis], step + 1


def split_of(suite: Suite, seed: int) -> str:
    """Return the split that a seed is in; a ValueError says which seeds there are."""
    for split in SPLITS:
        if seed in suite.seeds(split):
            return split
    known = ", ".join(f"{split} {(s := suite.seeds(split)).start} … {s.stop - 1}" for split in SPLITS)
    raise ValueError(f"seed {seed} is in no split of suite {suite.name!r} that can be played: {known}")
