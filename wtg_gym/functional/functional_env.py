"""The environment as pure functions of JAX, in the form of gymnax: `reset` and `step` with key, state and parameters.

jax.config.update("jax_enable_x64", True)
env = FunctionalEnv()
params = env.default_params
observation, state = env.reset(key, params)
observation, state, reward, done, info = env.step(key, state, action, params)
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.observation import OBSERVATION_BOUND
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task_records import Info
from wtg_gym.functional.bank import EnvParams, prepare
from wtg_gym.functional.programs import COTANGENT, Both, trace
from wtg_gym.physics.integration import protections_sample
from wtg_gym.physics.scenario import Scenario

#: Scenarios of the parameters that an environment has by default.
N_SCENARIOS = 64


class EnvState(NamedTuple):
    """What changes in an episode."""

    rows: Any  # of the block that a step keeps for the next (n_kept,)
    scenario: Any  # its place in the bank
    network: Any  # that is in force: its place in the bank
    time: Any  # control steps since the start


class Box(NamedTuple):
    """Numbers between bounds, with the methods that a space of gymnax has."""

    low: float
    high: float
    shape: tuple[int, ...]
    dtype: Any = np.float64

    def sample(self, key: Any) -> Any:
        """Draw from it, evenly."""
        return jax.random.uniform(key, self.shape, self.dtype, self.low, self.high)

    def contains(self, x: Any) -> Any:
        """Return whether it holds an array."""
        return jnp.all((x >= self.low) & (x <= self.high))


def _number(value: Any) -> Any:
    return value if isinstance(value, jax.Array) else np.float64(value)


#: What the operations of traced numbers mean.
_OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": operator.truediv,
    "power": jnp.power,
    "neg": operator.neg,
    "abs": jnp.abs,
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": operator.and_,
    "or": operator.or_,
    "not": operator.invert,
    "finite": jnp.isfinite,
    "min": jnp.minimum,
    "max": jnp.maximum,
    "sqrt": jnp.sqrt,
    "floor": jnp.floor,
    "ceil": jnp.ceil,
    # As the kernels' own, it stays where it is below -40.
    "exponential": lambda a: jnp.exp(jnp.maximum(a, -40.0)),
    "sine": jnp.sin,
    "cosine": jnp.cos,
    "select": lambda condition, *values: jax.lax.select(condition, *map(_number, values)),
    "fma": lambda a, b, c: a * b + c,
}


def _runner(program: Both) -> Callable[[Mapping[int, Any]], dict[int, Any]]:
    """Return a program as a function of what rows hold, which returns what it stores.

    JAX goes back through it by the rules of `wtg_gym.gradients`: it need not differentiate thousands of operations one
    by one, and at corners both have the same slope.
    """
    reads, rows = sorted(program.forward.reads), list(program.forward.stores)

    # Compiled functions are traced once, however often JAX goes through the loops around them.
    @jax.custom_vjp
    @jax.jit
    def call(given: tuple[Any, ...]) -> tuple[Any, ...]:
        return _stored(program.forward.run(_OPERATIONS, dict(zip(reads, given, strict=True))), rows)

    @jax.jit
    def back(given: tuple[Any, ...], cotangents: tuple[Any, ...]) -> tuple[tuple[Any, ...]]:
        known = dict(zip((*reads, *(COTANGENT + row for row in rows)), (*given, *cotangents), strict=True))
        return (_stored(program.pulled.run(_OPERATIONS, known), reads),)

    call.defvjp(lambda given: (call(given), given), back)
    return lambda values: dict(zip(rows, call(_stored({row: values[row] for row in reads}, reads)), strict=True))


def _stored(values: Mapping[int, Any], rows: Sequence[int]) -> tuple[Any, ...]:
    """Return what rows hold; those that hold nothing may hold anything."""
    return tuple(jnp.asarray(values.get(row, 0.0), jnp.float64) for row in rows)


class FunctionalEnv:
    """`GFMWTG-14bus-v0` as pure functions, for `jax.jit`, `jax.vmap`, `jax.lax.scan` and `jax.grad`. Experimental.

    Its equations are the kernels' own source, traced. Scenarios are drawn and prepared before, on the host: parameters
    are a bank of them, and :meth:`reset` takes one. Observations and rewards are floats of 64 bits.

    Args:
        settings: of the environment; the paper's physics and version v0. None: those of v0.
        n_scenarios: of the default parameters: the first ones of the settings' split.

    Raises:
        ValueError: the settings are of another version or physics, or JAX has floats of 32 bits.
    """

    def __init__(self, settings: EnvSettings | None = None, n_scenarios: int = N_SCENARIOS) -> None:
        settings = EnvSettings(version="v0") if settings is None else settings
        if not jax.config.jax_enable_x64:
            raise ValueError('floats of 64 bits are needed: call jax.config.update("jax_enable_x64", True) first')
        if (settings.version, settings.physics, settings.on_failure) != ("v0", "paper", "terminate"):
            raise ValueError(
                "the functional environment is for version='v0', physics='paper' and on_failure='terminate', got "
                f"version={settings.version!r}, physics={settings.physics!r}, on_failure={settings.on_failure!r}"
            )
        self.settings = settings
        self._lanes = TaskLanes(settings, 1)
        simulator = self._lanes.simulator
        plant, layout = simulator.plant, simulator.layout
        n_action, n_observation = self._lanes.n_action, self._lanes.n_observation
        self._programs = trace(plant, self._lanes.task, layout, n_action, n_observation)
        own = self._programs
        self._begin, self._end = _runner(own.begin), _runner(own.end)
        self._enter, self._stage, self._leave = _runner(own.enter), _runner(own.stage), _runner(own.leave)
        self._n_substeps, self._step = plant.n_substeps, layout.lane("step")
        self._status = layout.lane("status")
        self._samples = np.array(
            [protections_sample(plant.constants[0], k) for k in range(self._n_substeps)], np.float64
        )
        fixed = settings.fixed_scenario()
        seeds = self._lanes.suite.seeds(settings.split)
        given = self.scenarios(list(seeds[:n_scenarios])) if fixed is None else [fixed]
        self._default = self.bank(given)

    @property
    def name(self) -> str:
        """Its name in Gymnasium."""
        return self._lanes.suite.benchmark.env_id

    @property
    def num_actions(self) -> int:
        """Number of actions."""
        return self._lanes.n_action

    @property
    def observation_names(self) -> list[str]:
        """Names and units of the observation's entries."""
        return self._lanes.observation_names

    @property
    def default_params(self) -> EnvParams:
        """The bank of the settings' split, or of their scenario."""
        return self._default

    def action_space(self, params: EnvParams | None = None) -> Box:
        """Return the space of actions; those outside are clipped."""
        return Box(-1.0, 1.0, (self.num_actions,))

    def observation_space(self, params: EnvParams | None = None) -> Box:
        """Return the space of observations."""
        return Box(-OBSERVATION_BOUND, OBSERVATION_BOUND, (self._lanes.n_observation,))

    def scenarios(self, seeds: Sequence[int]) -> list[Scenario]:
        """Return the suite's scenarios of seeds."""
        return self._lanes.scenarios([int(seed) for seed in seeds])

    def bank(self, scenarios: Sequence[Scenario]) -> EnvParams:
        """Return parameters that hold given scenarios.

        Raises:
            ValueError: there are none, or one does not fit the plant or the episode length, or has no equilibrium.
        """
        return prepare(self._lanes, self._programs, scenarios)

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of the environment's blocks that a state holds, in its order."""
        return self._programs.kept

    def start(self, scenario: Any, params: EnvParams | None = None) -> tuple[Any, EnvState]:
        """Return first observation and state of an episode of the bank's scenario at a place."""
        params = self._given(params)
        scenario = jnp.asarray(scenario, jnp.int32)
        state = EnvState(
            rows=params.start[scenario],
            scenario=scenario,
            network=params.first_network[scenario],
            time=jnp.zeros((), jnp.int32),
        )
        return params.observation[scenario], state

    @partial(jax.jit, static_argnames=("self",))
    def reset(self, key: Any, params: EnvParams | None = None) -> tuple[Any, EnvState]:
        """Start an episode of a scenario that the key chooses; return (observation, state)."""
        return self.reset_env(key, self._given(params))

    @partial(jax.jit, static_argnames=("self",))
    def step(
        self, key: Any, state: EnvState, action: Any, params: EnvParams | None = None
    ) -> tuple[Any, EnvState, Any, Any, dict[str, Any]]:
        """Hold an action for one control interval; where the episode ends, start the next.

        Returns:
            observation, state, reward, done, and `info` with the numbers of the environment's, with "terminated",
            "truncated" and "status" (:class:`~wtg_gym.physics.protection.Status`), and with the "final_observation",
            which is that of the step where the next episode starts.
        """
        params = self._given(params)
        key, of_reset = jax.random.split(key)
        seen, after, reward, done, info = self.step_env(key, state, action, params)
        first, fresh = self.reset_env(of_reset, params)
        info["final_observation"] = seen
        state = jax.tree.map(partial(jnp.where, done), fresh, after)
        return jnp.where(done, first, seen), state, reward, done, info

    def reset_env(self, key: Any, params: EnvParams) -> tuple[Any, EnvState]:
        """Return :meth:`reset`'s result."""
        params = self._given(params)
        return self.start(jax.random.randint(key, (), 0, params.start.shape[0]), params)

    def step_env(
        self, key: Any, state: EnvState, action: Any, params: EnvParams
    ) -> tuple[Any, EnvState, Any, Any, dict[str, Any]]:
        """Return :meth:`step`'s result without starting another episode; one that has ended stands still.

        The way back works a step out anew, so that of every step only its state is remembered.
        """
        step: Callable[..., tuple[Any, EnvState, Any, Any, dict[str, Any]]] = jax.checkpoint(self._step_env)
        return step(state, jnp.asarray(action, jnp.float64), self._given(params))

    def _given(self, params: EnvParams | None) -> EnvParams:
        params = self._default if params is None else params
        return EnvParams(*map(jnp.asarray, params))

    def _step_env(
        self, state: EnvState, action: Any, params: EnvParams
    ) -> tuple[Any, EnvState, Any, Any, dict[str, Any]]:
        programs = self._programs
        inputs, reported = programs.inputs, programs.reported
        values: dict[int, Any] = dict(zip(programs.kept, state.rows, strict=True))
        interval = (values[self._step] / self._n_substeps).astype(jnp.int32)
        last = params.wind.shape[1] - 1
        winds = (params.wind[state.scenario, jnp.minimum(interval + k, last)] for k in range(2))
        noise = params.noise[state.scenario, jnp.minimum(interval, last - 1)]
        for rows, given in zip((inputs.actions, inputs.wind_start, inputs.wind_end), (action, *winds), strict=True):
            values |= zip(rows, given, strict=True)
        values[inputs.noise] = noise
        values |= self._begin(values)

        def advance(carried: Any, given: Any) -> Any:
            (rows, network), (stages, samples) = carried, given
            own = values | dict(zip(programs.moved, rows, strict=True))
            network = network + (own[self._step] >= params.until[network]).astype(jnp.int32)
            own |= zip((*programs.network, *inputs.lost), params.network[network], strict=True)
            own |= self._enter(own)

            def stage(rows: Any, given: Any) -> Any:
                here = own | dict(zip((*programs.staged, *inputs.stage), (*rows, *given), strict=True))
                found = self._stage(here)
                return tuple(found[row] for row in programs.staged), None

            staged, _ = jax.lax.scan(stage, _stored(own, programs.staged), stages)
            own |= zip((*programs.staged, inputs.samples), (*staged, samples), strict=True)
            own |= self._leave(own)
            return (_stored(own, programs.moved), network), None

        begun = (_stored(values, programs.moved), state.network)
        (moved, network), _ = jax.lax.scan(advance, begun, (programs.stages, self._samples))
        values |= zip(programs.moved, moved, strict=True)
        values |= zip(programs.network, params.network[network][: len(programs.network)], strict=True)
        values |= self._end(values)
        after = EnvState(
            rows=jnp.stack([values[row] for row in programs.kept]),
            scenario=state.scenario,
            network=network,
            time=state.time + 1,
        )
        terminated, truncated = (values[row] > 0.5 for row in (reported.terminated, reported.truncated))
        info = {name: values[row] for name, row in zip(Info._fields, reported.info, strict=True)}
        info |= {"terminated": terminated, "truncated": truncated, "status": values[self._status].astype(jnp.int32)}
        info["scenario_seed"] = params.scenario_seed[state.scenario]
        seen = jnp.stack([values[row] for row in reported.observation])
        return seen, after, values[reported.reward], terminated | truncated, info


__all__ = ["Box", "EnvParams", "EnvState", "FunctionalEnv"]
