"""The environment: one episode at a time."""

import copy
from threading import get_ident
from typing import Any

import gymnasium as gym
import numpy as np

from wtg_gym.envs import interface, rendering
from wtg_gym.envs.batch import EnvBatch, PreparedEpisodes
from wtg_gym.signals import HeldSignals
from wtg_gym.systems.routines import WIDE

#: Time of all episodes that are prepared together, at most [s]: sixteen of v1, which fill a block of the simulator.
_MOST_AHEAD_S = WIDE * 180.0


class _EpisodesAhead:
    """The next episodes of an environment, prepared several at a time, which takes a third to a half of the time.

    They are those that its generator is going to draw. Where it draws another one, since others have drawn from it or
    it was given another state, those ahead are dropped; so an episode does not depend on when it was prepared.
    """

    def __init__(self, batch: EnvBatch) -> None:
        self._batch = batch
        self._most = min(WIDE, max(1, int(_MOST_AHEAD_S / batch.duration_s)))
        self.drop()

    def __getstate__(self) -> dict[str, Any]:
        # A copy prepares them again.
        return {**self.__dict__, "_ready": []}

    def drop(self) -> None:
        """Forget all episodes; the next one is prepared alone, then two at a time, then four …"""
        self._at_once = 1
        #: The seed of each scenario, its place among episodes prepared together, and these, or why it cannot start.
        self._ready: list[tuple[int, int, PreparedEpisodes | ValueError]] = []

    def take(self, rng: np.random.Generator) -> tuple[PreparedEpisodes, list[int]]:
        """Return the episode that the generator draws: its place among others; a ValueError says why none can start."""
        seed = self._batch.draw_seed(rng)
        if self._ready and self._ready[0][0] != seed:
            self.drop()
        if not self._ready:
            # Where memory is short, the next reset begins with one episode again.
            at_once, self._at_once = self._at_once, 1
            ahead = copy.deepcopy(rng)
            self._ready = self._prepare([seed, *(self._batch.draw_seed(ahead) for _ in range(at_once - 1))])
            self._at_once = min(2 * at_once, self._most)
        _, place, episodes = self._ready.pop(0)
        if isinstance(episodes, ValueError):
            raise episodes
        return episodes, [place]

    def _prepare(self, seeds: list[int]) -> list[tuple[int, int, PreparedEpisodes | ValueError]]:
        try:
            episodes = self._batch.prepare(self._batch.drawn_scenarios(seeds))
            return [(seed, place, episodes) for place, seed in enumerate(seeds)]
        except ValueError as error:
            if len(seeds) == 1:
                return [(seeds[0], 0, error)]
        # One of them cannot start.
        return [ready for seed in seeds for ready in self._prepare([seed])]


class GFMWTGEnv(interface.OverBatch, gym.Env[interface.Observation, interface.Action]):
    """Grid-forming wind turbine generators hold up the frequency of the modified IEEE 14-bus system.

    ## Description
    Groups of grid-forming wind turbines feed a transmission grid with one synchronous generator and three condensers.
    Loads switch on and off, lines trip, the wind varies. Each group runs the control law of Chen et al. (2026):
    P_st = k ω_m³ + D_p x with k = g(ω) and transient damping τ. The agent adjusts k, τ or both, to hold the frequency
    without stalling a rotor.

    ## Action Space
    `Box(-1, 1, (n_wtg · n_modes,), float32)`: k of group 1, its τ, k of group 2, … (`action_names`); an offset on k (at
    ±1 half of K_opt - K_pr) and a factor on τ (at ±1 four times or a quarter, in v1 twice or half). Zero leaves the
    control law `strategy` unchanged, to the last bit; its default is the published law. Actions outside -1 … 1 are
    clipped; one that is not finite raises a ValueError.

    ## Observation Space
    `Box(-5, 5, (n,), float32)`, per group what its own controller measures: frequency deviation and its rate of change
    (RoCoF), tip-speed ratio between λ_opt and λ_pr, rotor speed, power, rotor-effective wind, k, filter state, last
    action. With `observation_mode="privileged"` the grid follows: speed, power and voltage of each synchronous machine,
    then frequency deviation, RoCoF and the machines' torque. `observation_names` lists every entry with its unit.

    In v1 a group observes frequency deviation, RoCoF, tip-speed ratio, rotor speed, power and wind through sensors with
    noise, bias and a delay of 0.1 … 0.3 s, and its last action. The privileged part begins with the exact values.

    ## Rewards
    In v0 minus the cost of the step; see `reward`. In v1 what the step saves against the reference at 100,
    100/Λ · (c_100 - c) / (J_100 + J0); the last step adds what makes the return the score minus 100: mostly less than
    10 points, up to thousands where an episode cost much more than the reference. Where `max_episode_steps` cuts an
    episode, `gym.make_vec` has this step; `gym.make` does not, so that the return is no score. The cost is the sum of
    the terms `info["cost_…"]`. `info["cost"]` is another number, for safe reinforcement learning.

    ## Starting State
    The exact equilibrium of the scenario's wind, load and grid at nominal frequency.

    ## Episode End
    Terminated (`info["termination_reason"]`) at a "frequency limit" (outside 0.95 … 1.03 p.u., at 50 Hz 47.5 … 51.5),
    a "loss of synchronism" (two units more than 180° apart), a "voltage collapse" (a unit's terminal below 0.85 p.u.
    for more than 3 s), or a "numerical failure". A rotor's "stall", "over-speed" or, in extended physics, "under-speed"
    terminates in v0 and disconnects its group in v1 (`on_failure`). Truncated when the time is over; learners that then
    bootstrap, such as Stable-Baselines3's, expect more than the score counts.

    ## Arguments
    Those of `wtg_gym.envs.EnvSettings`, and `render_mode`. `reset(options={"scenario": …})` plays a scenario of your
    own, or that of a seed of the suite, in a batch {"scenarios": one for each}; {"reset_mask": (num_envs,) bool}
    restarts some. `reset(seed=10003)` seeds the generator that draws scenarios: it does not play scenario 10003.

    ## Rendering
    `render_mode="rgb_array"` gives frames of 960 × 540 pixels: the grid with the events so far, and curves of frequency
    and turbines. `render_mode="human"` shows them in a window, in real time. Both need the `render` extra. Rendering
    does not change the simulation.

    ## Vectorized environment
    `gym.make_vec("GFMWTG-14bus-v0", num_envs=…)` gives :class:`GFMWTGVectorEnv`; its environment i seeded with s
    equals this one seeded with s + i, bit for bit.

    ## Version History
    * v1: a grid that needs the wind, extended physics, secondary control, sensors, a score by difficulty classes.
    * v0: first version, the paper's system.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium sets it so)
        "render_modes": ["human", "rgb_array"],
        "render_fps": 10,
    }

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        self.observation_space, self.action_space = self._open(arguments, render_mode)
        self._action_shape = (self._batch.n_action,)
        self._ahead = _EpisodesAhead(self._batch)

    @interface.one_thread
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[interface.Observation, dict[str, Any]]:
        """Start an episode.

        A ValueError refuses unknown options and a scenario that does not fit, a gymnasium.error.Error a seed that is
        not a whole number of 0 or more; nothing has changed then.

        Args:
            seed: seeds the generator that draws scenarios; None continues with it.
            options: {"scenario": Scenario, its to_dict(), or a seed of any split of the suite} plays that scenario.
        """
        checked = interface.check_options(options, ("scenario",))
        # A given scenario that cannot start is refused before the first change, of the generator too.
        episodes = None
        if "scenario" in checked:
            scenario = self._batch.scenario_of('options["scenario"]', checked["scenario"])
            episodes = self._batch.prepare([scenario], turning=True)
        super().reset(seed=seed)
        if seed is not None:
            self._ahead.drop()
        places = None
        if episodes is None:
            episodes, places = self._batch.first_to_start(0, lambda: self._ahead.take(self.np_random))
        self._batch.start([0], episodes, places)
        if self._frames is not None:
            self._frames.sample()
            self._frames.show()
        return self._batch.observations[0].copy(), self._batch.info()

    def step(self, action: interface.Action) -> tuple[interface.Observation, float, bool, bool, dict[str, Any]]:
        """Hold the action (n_action,), clipped to [-1, 1], for one control step.

        A ValueError says that the action has another shape or is not finite, a RuntimeError that the episode is over,
        so that reset() is needed, or that another thread is in this environment.
        """
        batch, use, thread = self._batch, self._use, get_ident()
        outputs = batch.outputs
        if outputs.terminated[0] or outputs.truncated[0]:
            raise RuntimeError("the episode is over or was never started; call reset() before step()")
        # As one_thread does; a decorator would add a tenth to the shortest step. An interrupt comes before or after the
        # one call that changes the episode.
        if use.taken_by("thread", thread) != thread:
            raise interface.in_use(self, "step")
        try:
            actions = interface.as_actions(action, self._action_shape)[None, :]
            if self._frames is None:
                batch.step(actions)
            else:
                with HeldSignals():
                    batch.step(actions)
                    self._frames.sample()
                self._frames.show()
            terminated, truncated = bool(outputs.terminated[0]), bool(outputs.truncated[0])
            return outputs.observations[0].copy(), float(outputs.rewards[0]), terminated, truncated, batch.info()
        finally:
            use.give_back()

    def render(self) -> rendering.Frame | None:
        """Draw the episode up to now: the frame (540, 960, 3) uint8 with "rgb_array", else None.

        With "human" :meth:`reset` and :meth:`step` draw by themselves; without a render mode there is a warning. A
        RuntimeError says that no episode was started, or that "human" finds no display.
        """
        if self._frames is None:
            interface.warn_of_no_render_mode()
            return None
        if self.render_mode == "human":
            self._frames.show()
            return None
        return self._frames.paint()[0]

    def close(self) -> None:
        """Release the worker threads, and close the window; the environment can still be used."""
        self._batch.close()
        if self._frames is not None:
            self._frames.close()
