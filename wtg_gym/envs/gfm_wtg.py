"""The environment: one episode at a time."""

from __future__ import annotations

from threading import get_ident
from typing import TYPE_CHECKING, Any, Unpack

import gymnasium as gym

from wtg_gym.envs.actions import as_actions
from wtg_gym.envs.interface import (
    Action,
    Observation,
    OverLanes,
    check_options,
    in_use,
    one_thread,
    warn_of_no_render_mode,
)
from wtg_gym.envs.settings import EnvArguments, as_scenario
from wtg_gym.signals import HeldSignals

if TYPE_CHECKING:
    from wtg_gym.envs.rendering import Frame


class GFMWTGEnv(OverLanes, gym.Env[Observation, Action]):
    """Grid-forming wind turbine generators hold up the frequency of the modified IEEE 14-bus system.

    ## Description
    Groups of grid-forming wind turbines feed a transmission grid with one synchronous generator and three condensers.
    Loads switch on and off, lines trip, the wind blows as it likes. Each group runs the power-tracking-coefficient
    droop of Chen et al. (2026): P_st = k ω_m³ + D_p x with k = g(ω) and transient damping τ. The agent modulates k, τ
    or both on top of it, so that the frequency is held and no rotor is slowed down to a stall.

    ## Action Space
    `Box(-1, 1, (n_wtg · n_modes,), float32)`, per group: the offset on k (full action: half the regulation range
    K_opt - K_pr), then the scale of τ (full action: four times or a quarter, in v1 twice or half). It is held for
    0.1 s, in v1 for 0.5 s. An action of zero leaves the control law `strategy` unchanged, to the last bit; its default
    is the published law. Actions outside -1 … 1 are clipped; an action that is not finite raises a ValueError.

    ## Observation Space
    `Box(-5, 5, (n,), float32)`, per group what its own controller measures: frequency deviation and its rate of change
    (RoCoF), tip-speed ratio between λ_opt and λ_pr, rotor speed, power, rotor-effective wind, k, filter state, last
    action. With `observation_mode="privileged"` the grid follows: speed, power and voltage of each synchronous machine,
    then frequency deviation, RoCoF and the machines' torque. `observation_names` lists every entry with its unit.

    In v1 a group sees what its sensors say: frequency deviation, RoCoF, tip-speed ratio, rotor speed, power, wind, with
    noise and bias, 0.1 … 0.3 s late, and its last action. The privileged part begins with the exact values.

    ## Rewards
    In v1 what the score gains in the step, so that the return of an episode is its score less 100; see `reward`. In v0
    minus the cost of the step. The cost is the sum of the terms `info["cost_…"]`: frequency deviation, RoCoF, power
    tracking (`duty`), tip-speed ratio, converter overload, control effort, and failure, in v1 with load not served.
    `info["cost"]` is not that sum: it is 1 in a step that violates a constraint, else 0, for safe learning.

    ## Starting State
    The exact equilibrium of the drawn scenario's wind, load and grid at nominal frequency.

    ## Episode End
    Terminated (`info["termination_reason"]`) at a "frequency limit" (outside 47.5 … 51.5 Hz), a "loss of synchronism"
    (two units more than 180° apart), a "voltage collapse" (a unit's terminal below 0.85 p.u. for more than 3 s), or a
    "numerical failure". A "stall", an "over-speed" or, in extended physics, an "under-speed" of a rotor terminates too
    with `on_failure="terminate"`, as in v0; otherwise it disconnects the rotor's group. Protections act every 0.1 s,
    and at the end of shorter control intervals. Truncated when the time is over.

    ## Arguments
    `help(wtg_gym.envs.EnvSettings)` lists them; `render_mode` is one more. An unknown one raises a TypeError, a value
    that is not allowed a ValueError. `reset(options={"scenario": …})` plays a scenario of your own.

    ## Rendering
    `render_mode="rgb_array"` gives frames of 960 × 540 pixels: the grid with the events so far, and what frequency and
    turbines have done. `render_mode="human"` shows them in a window, in real time. Both need the `render` extra.
    Nothing of the simulation depends on it.

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

    def __init__(self, *, render_mode: str | None = None, **arguments: Unpack[EnvArguments]) -> None:
        self.observation_space, self.action_space = self._open(arguments, render_mode)
        self._action_shape = (self._lanes.n_action,)

    @one_thread
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: seeds the generator that scenarios are drawn with; None goes on with it.
            options: {"scenario": Scenario or its to_dict()} plays that scenario.

        Raises:
            ValueError: unknown options, or a scenario that does not fit; nothing has changed then.
            gymnasium.error.Error: the seed is not a whole number of 0 or more.
        """
        given = check_options(options, ("scenario",))
        # A given scenario that cannot start is refused before the first change, of the generator too.
        scenario = as_scenario('options["scenario"]', given["scenario"]) if "scenario" in given else None
        episodes = None if scenario is None else self._lanes.prepare([scenario], turning=True)
        super().reset(seed=seed)
        self._lanes.start([0], self._lanes.next_episode(self.np_random, 0) if episodes is None else episodes)
        if self._frames is not None:
            self._frames.sample()
            self._frames.show()
        return self._lanes.observations[0].copy(), self._lanes.info()

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold the action for one control interval.

        Args:
            action: (n_action,), clipped to [-1, 1].

        Raises:
            ValueError: wrong shape, or a value that is not finite.
            RuntimeError: the episode is over, call reset(); or another thread is in this environment.
        """
        lanes, use, thread = self._lanes, self._use, get_ident()
        outputs = lanes.outputs
        if outputs.terminated[0] or outputs.truncated[0]:
            raise RuntimeError("the episode is over or was never started; call reset() before step()")
        # As one_thread does; a decorator would add a tenth to the shortest step. An interrupt comes before or after the
        # one call that changes the episode.
        if use.taken_by("thread", thread) != thread:
            raise in_use(self, "step")
        try:
            actions = as_actions(action, self._action_shape)[None, :]
            if self._frames is None:
                lanes.step(actions)
            else:
                with HeldSignals():
                    lanes.step(actions)
                    self._frames.sample()
                self._frames.show()
            terminated, truncated = bool(outputs.terminated[0]), bool(outputs.truncated[0])
            return outputs.observations[0].copy(), float(outputs.rewards[0]), terminated, truncated, lanes.info()
        finally:
            use.give_back()

    def render(self) -> Frame | None:
        """Draw the episode up to now.

        Returns:
            With "rgb_array" the frame (540, 960, 3) uint8; with "human", where :meth:`reset` and :meth:`step` draw by
            themselves, None; without a render mode None and a warning.

        Raises:
            RuntimeError: no episode was started; or "human" finds no display.
        """
        if self._frames is None:
            warn_of_no_render_mode()
            return None
        if self.render_mode == "human":
            self._frames.show()
            return None
        return self._frames.paint()[0]

    def close(self) -> None:
        """Release the worker threads, and close the window; the environment can still be used."""
        self._lanes.simulator.close()
        if self._frames is not None:
            self._frames.close()
