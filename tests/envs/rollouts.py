"""Rollouts in a common form, so that an environment of a batch and a single environment can be compared bit for bit."""

import hashlib
import itertools

import numpy as np
from gymnasium.vector import AutoresetMode

from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.physics import scenario as sc

MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)
ACTION_MODES = ("k", "tau", "k+tau")
OBSERVATION_MODES = ("local", "privileged")
VERSIONS = ("v0", "v1")
N_WTG = {"v0": 2, "v1": 4}


def actions_of(seed: int, n_steps: int, num_envs: int = 1, n_action: int = 4, scale: float = 1.2) -> np.ndarray:
    """Return random actions, some of them out of range, shape (n_steps, num_envs, n_action)."""
    return np.random.default_rng(seed).uniform(-scale, scale, (n_steps, num_envs, n_action))


def eventful(wind: float = 9.0, duration_s: float = 4.0, n_wtg: int = 2, **changes) -> sc.Scenario:
    """Return a short scenario with every kind of event in it, off the control grid as well."""
    events = (
        sc.LoadStep(time_s=0.525, bus=2, power_mw=40.0, reactive_mvar=5.0),
        sc.LoadRamp(time_s=0.9, bus=14, power_mw=-10.0, duration_s=1.1),
        sc.LineTrip(time_s=1.3, from_bus=5, to_bus=4, recloses_after_s=0.85),
        sc.MachineOutage(time_s=1.525, bus=6),
        sc.LoadTrip(time_s=1.975, bus=9),
        sc.GovernorLoss(time_s=2.2, bus=1),
        sc.LoadStep(time_s=2.5, bus=5, power_mw=15.0),
        sc.GroupTrip(time_s=2.725, group=1),
    )
    noise = np.r_[0.0, np.random.default_rng(5).normal(0.0, 1.0, round(10 * duration_s))]
    values = {"events": events, "load_noise_mw": noise, "duration_s": duration_s, **changes}
    return sc.Scenario(name="eventful", wind_speed=wind + 0.5 * np.arange(n_wtg)[:, None], **values)


def sagging(wind: float = 8.0, duration_s: float = 60.0) -> sc.Scenario:
    """Return a low wind with the paper's load increase, early: maximum power point tracking stalls in it."""
    events = (sc.LoadStep(time_s=2.0, bus=2, power_mw=75.0), sc.LoadStep(time_s=10.0, bus=3, power_mw=75.0))
    return sc.Scenario(name="sagging", wind_speed=np.full((2, 1), wind), duration_s=duration_s, events=events)


def rising(duration_s: float = 20.0) -> sc.Scenario:
    wind = np.interp(np.arange(round(10 * duration_s) + 1) * 0.1, [3.0, 5.0], [8.0, 25.0])
    return sc.Scenario(name="rising", wind_speed=np.array([wind, wind]), duration_s=duration_s)


def calm(wind: float = 9.0, duration_s: float = 4.0, n_wtg: int = 2, **changes) -> sc.Scenario:
    return sc.Scenario(name="calm", wind_speed=np.full((n_wtg, 1), wind), duration_s=duration_s, **changes)


def started(env, **reset):
    """Return an environment, of whatever kind, after its reset."""
    env.reset(**reset)
    return env


def bits(value):
    """Return a value in a form that compares equal only where every bit and every type is."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, bits(value.tolist()) if value.dtype.kind == "O" else value.tobytes()
    if isinstance(value, dict):
        return {key: bits(each) for key, each in value.items()}
    return [bits(each) for each in value] if isinstance(value, (list, tuple)) else (type(value), repr(value))


def as_step(observation: np.ndarray, reward: float, terminated: bool, truncated: bool, info, final=None):
    plain = {key: value if isinstance(value, str) else float(value).hex() for key, value in info.items()}
    return observation.tobytes(), float(reward).hex(), bool(terminated), bool(truncated), plain, final


def single_steps(env: GFMWTGEnv, actions: np.ndarray, mode: AutoresetMode, seed: int | None = None, start=None):
    """Step a single environment over `actions` (n_steps, n_action), with the resets of an autoreset mode."""

    def start_of(**reset):
        observation, info = env.reset(**reset)
        return observation, 0.0, False, False, info

    steps = [] if seed is None else [as_step(*start_of(seed=seed, options=start))]
    over = False
    for action in actions:
        observation, reward, *ends, info = start_of() if over else env.step(action)
        over, final = any(ends), None
        if over and mode == AutoresetMode.SAME_STEP:
            final, over = as_step(observation, 0.0, False, False, info), False
            observation, info = env.reset()
        steps.append(as_step(observation, reward, *ends, info, final))
        if over and mode == AutoresetMode.DISABLED:
            steps.append(as_step(*start_of()))
            over = False
    return steps


def vector_steps(env: GFMWTGVectorEnv, actions: np.ndarray, seed: int | None = None, start=None):
    """Step a batch over `actions` (n_steps, num_envs, n_action), and return each environment's own steps."""
    batch = [[] for _ in range(env.num_envs)]
    zeros, never = np.zeros(env.num_envs), np.zeros(env.num_envs, dtype=bool)
    if seed is not None:
        observations, infos = env.reset(seed=seed, options=start)
        for env_index, steps in enumerate(batch):
            steps.append(_env_step(env_index, observations, zeros, never, never, infos))
    for action in actions:
        result = env.step(action)
        for env_index, steps in enumerate(batch):
            steps.append(_env_step(env_index, *result))
        over = result[2] | result[3]
        if env.autoreset_mode == AutoresetMode.DISABLED and over.any():
            observations, infos = env.reset(options={"reset_mask": over})
            for env_index in np.flatnonzero(over):
                batch[env_index].append(_env_step(env_index, observations, zeros, never, never, infos))
    return batch


def _env_step(env_index: int, observations: np.ndarray, rewards: np.ndarray, terminated, truncated, infos):
    final = None
    if "final_obs" in infos and infos["_final_obs"][env_index]:
        assert infos["_final_info"][env_index]
        final = as_step(infos["final_obs"][env_index], 0.0, False, False, env_info(infos["final_info"], env_index))
    values = (each[env_index] for each in (observations, rewards, terminated, truncated))
    return as_step(*values, env_info(infos, env_index), final)


def env_info(infos, env_index: int):
    keys = [key for key in infos if not key.startswith(("_", "final_"))]
    return {key: infos[key][env_index] for key in keys if infos[f"_{key}"][env_index]}


def n_resets(steps) -> int:
    return sum(step[2] or step[3] for step in steps)


def reasons(steps) -> set[str]:
    # Where an episode was restarted within the step, its own info is the final one.
    infos = (step[4] if step[5] is None else step[5][4] for step in steps if step[2] or step[3])
    return {info["termination_reason"] for info in infos}


def episode(env: GFMWTGEnv, actions=0.0, **reset):
    """Play an episode with a constant action or one per step; yield (reward, terminated, truncated, info) per step."""
    env.reset(**reset)
    actions, shape = np.asarray(actions, dtype=float), env.action_space.shape
    for action in actions if actions.ndim == 2 else itertools.repeat(np.broadcast_to(actions, shape)):
        observation, *step = env.step(action)
        assert env.observation_space.contains(observation)
        yield tuple(step)
        if step[1] or step[2]:
            return


def digest(num_envs: int = 17, n_steps: int = 45, n_threads: int | None = None, **settings) -> str:
    env = GFMWTGVectorEnv(num_envs, n_threads=n_threads, **{"version": "v0", "duration_s": 2.0, **settings})
    batch = vector_steps(env, actions_of(1, n_steps, num_envs, env.single_action_space.shape[0]), seed=11)
    env.close()
    return hashlib.sha256(repr(batch).encode()).hexdigest()
