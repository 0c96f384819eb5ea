"""The next episodes of a batch, prepared while lanes run."""

from collections.abc import Sequence

import numpy as np

from wtg_gym.envs.lanes import PreparedEpisodes, TaskLanes

#: Lanes whose episodes are drawn and prepared together: their series fit a processor's cache.
_LANES_AT_ONCE = 16


class NextEpisodes:
    """The episodes that lanes play next, drawn by each lane's own generator and prepared several at a time.

    Prepared by the handful, an episode takes less than half the time that it takes alone. Lanes whose episodes end soon
    are therefore prepared along with those that have ended. What a lane plays does not depend on when it was prepared.
    """

    def __init__(self, lanes: TaskLanes, generators: Sequence[np.random.Generator]) -> None:
        self._lanes = lanes
        self._generators = list(generators)
        #: The prepared group of a lane's episode, and its place there.
        self._ready: dict[int, tuple[PreparedEpisodes, int]] = {}
        #: Why a lane's episode cannot start.
        self._refused: dict[int, ValueError] = {}

    def choose(self, wanted: Sequence[int]) -> list[int]:
        """Return which lanes to prepare now: those of `wanted` that are not ready, filled up to whole groups."""
        missing = [lane for lane in wanted if lane not in self._ready and lane not in self._refused]
        n_more = min(-len(missing) % _LANES_AT_ONCE, self._lanes.n_lanes - len(missing))
        if not missing or n_more == 0:
            return missing
        remaining = self._lanes.task_values("end_step") - self._lanes.simulator.lane_values("step")
        remaining[[*missing, *self._ready, *self._refused]] = np.inf
        soonest = np.argpartition(remaining, n_more - 1)[:n_more]
        return [*missing, *(int(lane) for lane in soonest if np.isfinite(remaining[lane]))]

    def prepare(self, chosen: Sequence[int]) -> None:
        """Draw and prepare the next episodes of lanes; :meth:`start` raises the error of one that cannot start."""
        for first in range(0, len(chosen), _LANES_AT_ONCE):
            group = chosen[first : first + _LANES_AT_ONCE]
            scenarios = self._lanes.draw([self._generators[lane] for lane in group])
            try:
                self._put(group, self._lanes.prepare(scenarios))
            except ValueError:
                for lane, scenario in zip(group, scenarios, strict=True):
                    try:
                        self._put([lane], self._lanes.next_episode(self._generators[lane], lane, scenario))
                    except ValueError as error:
                        self._refused[lane] = error

    def _put(self, group: Sequence[int], episodes: PreparedEpisodes) -> None:
        self._ready.update({lane: (episodes, place) for place, lane in enumerate(group)})

    def reseed(self, generators: dict[int, np.random.Generator]) -> None:
        """Give lanes new generators; episodes drawn by the old ones are dropped."""
        for lane, generator in generators.items():
            self._generators[lane] = generator
            self._ready.pop(lane, None)
            self._refused.pop(lane, None)

    def start(self, wanted: Sequence[int]) -> None:
        """Start the next episode of lanes.

        A ValueError says that none of the scenarios drawn for one of them starts. None has been started, and that lane
        goes on to the scenario after them.
        """
        self.prepare(self.choose(wanted))
        for lane in wanted:
            if lane in self._refused:
                raise self._refused.pop(lane)
        groups: dict[int, list[int]] = {}
        for lane in wanted:
            groups.setdefault(id(self._ready[lane][0]), []).append(lane)
        for group in groups.values():
            ready = [self._ready.pop(lane) for lane in group]
            self._lanes.start(group, ready[0][0], [place for _, place in ready])
