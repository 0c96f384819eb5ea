"""Under random settings and actions every output is finite and every episode ends."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.physics.scenario import (
    Event,
    GovernorLoss,
    GroupTrip,
    LineTrip,
    LoadRamp,
    LoadStep,
    LoadTrip,
    MachineOutage,
    Scenario,
)
from wtg_gym.physics.sensors import Sensors
from wtg_gym.physics.tracking_law import STRATEGIES
from wtg_gym.scenarios import SUITES, TRIPPABLE_LINES, get_suite

# The same examples on every machine, and no data base in the working tree.
FUZZ = settings(max_examples=60, derandomize=True, database=None, suppress_health_check=list(HealthCheck))

WEIGHTS = st.none() | st.dictionaries(
    st.sampled_from(["frequency", "rocof", "duty", "rotor", "overload", "effort"]),
    st.sampled_from([0.0, 1e-3, 1.0, 1e6]),
)
#: Control and simulation step that fit 3 s and the drawn events' grid of 0.1 s.
STEPS = st.sampled_from([(0.1, 0.02), (0.02, 0.02), (0.1, 0.005), (0.5, 0.02), (1.0, 0.01), (3.0, 0.025)])
ACTION = st.sampled_from([-1e30, -1.0, -0.5, -1e-300, 0.0, 1e-9, 0.3, 1.0, 1e308])


#: Why episodes may end; a numerical failure would be ours.
REASONS = ("stall", "over-speed", "under-speed", "frequency limit", "loss of synchronism", "voltage collapse")


@st.composite
def arguments(draw: Any) -> dict[str, Any]:
    """Return any arguments of the environment."""
    suite = draw(st.sampled_from(sorted(SUITES)))
    sensed = SUITES[suite].sensors is not None
    # Of version v1 each suite has its own number of turbines, and delays that are no whole number of long steps.
    n = len(SUITES[suite].plant.groups) if sensed else 2
    control_dt, simulation_dt = draw(STEPS)
    exact = {"sensors": "exact"} if sensed and (control_dt > 0.1 or draw(st.booleans())) else {}
    names = st.sampled_from(sorted(STRATEGIES))
    return {
        "groups": None if sensed else n,
        "strategy": draw(names | st.lists(names, min_size=n, max_size=n)),
        "action_mode": draw(st.sampled_from(["k", "tau", "k+tau"])),
        "observation_mode": draw(st.sampled_from(["local", "privileged"])),
        "suite": suite,
        "split": draw(st.sampled_from(["train", "validation", "test"])),
        "machine_model": draw(st.sampled_from(["genrou", "classical"])),
        "on_failure": draw(st.sampled_from(["terminate", "trip"])),
        "weights": draw(WEIGHTS),
        "duration_s": draw(st.sampled_from([3.0, 6.0])),
        "control_dt": control_dt,
        "simulation_dt": simulation_dt,
        **exact,
    }


def check_step(env: Any, result: tuple[Any, ...]) -> bool:
    """Check one step's result; return whether the episode is over."""
    observation, reward, terminated, truncated, info = result
    assert env.observation_space.contains(observation)
    assert math.isfinite(reward) and reward <= 0.0
    assert all(math.isfinite(value) for value in info.values() if not isinstance(value, str))
    assert info["termination_reason"] in (REASONS if terminated else ("",))
    return terminated or truncated


def play(env: GFMWTGEnv, actions: list[float], **reset: Any) -> int:
    """Play one episode, going round in `actions`; return its number of steps."""
    observation, _ = env.reset(**reset)
    assert env.observation_space.contains(observation)
    n_action = env.action_space.shape[0]
    limit = round(env.lanes.duration_s / env.settings.control_dt)
    for step in range(limit):
        action = [actions[(step * n_action + a) % len(actions)] for a in range(n_action)]
        if check_step(env, env.step(np.array(action))):
            return step + 1
    pytest.fail(f"the episode did not end within {limit} steps")


@FUZZ
@given(arguments(), st.lists(ACTION, min_size=1, max_size=12), st.integers(0, 2**31))
def test_any_settings_and_actions_play_to_the_end(given_arguments: dict, actions: list[float], seed: int):
    env = GFMWTGEnv(**given_arguments)
    for each in (seed, None):
        play(env, actions, seed=each)


@settings(FUZZ, max_examples=20)
@given(arguments(), st.sampled_from(["NextStep", "SameStep"]), st.integers(1, 18), st.integers(0, 2**31))
def test_any_batch_plays_on(given_arguments: dict, mode: str, n: int, seed: int):
    env = GFMWTGVectorEnv(n, autoreset_mode=mode, **{**given_arguments, "duration_s": 3.0})
    observations, _ = env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    for _ in range(min(70, 3 * env.lanes.simulator.n_intervals)):
        observations, rewards, terminated, truncated, infos = env.step(rng.normal(0.0, 1.0, env.action_space.shape))
        assert env.observation_space.contains(observations)
        assert np.isfinite(rewards).all() and (rewards <= 0.0).all()
        assert not (terminated & truncated).any() and "numerical failure" not in infos["termination_reason"]
        for each in (infos, infos.get("final_info", {})):
            numbers = [value for key, value in each.items() if key.startswith(("cost", "time", "freq", "rocof"))]
            assert np.isfinite(numbers).all()


BUSES = st.integers(1, 14)
TIMES = st.integers(0, 200).map(lambda n: n * 0.025)
POWERS = st.sampled_from([-1e4, -300.0, -75.0, 0.0, 75.0, 300.0, 1e4])
WINDS = st.lists(st.sampled_from([3.0, 5.0, 8.0, 11.4, 17.0, 25.0]), min_size=1, max_size=6)


@st.composite
def scenarios(draw: Any) -> Scenario:
    """Return any scenario, however unkind."""
    lost = draw(st.lists(BUSES, max_size=2, unique=True))
    steps = draw(st.lists(st.builds(LoadStep, time_s=TIMES, bus=BUSES, power_mw=POWERS), max_size=3))
    ramp = draw(st.none() | st.builds(LoadRamp, time_s=TIMES, bus=BUSES, power_mw=POWERS, duration_s=st.just(1.5)))
    line = draw(st.none() | st.sampled_from(TRIPPABLE_LINES))
    events: list[Event] = [*steps, *(LoadTrip(time_s=draw(TIMES), bus=bus) for bus in lost)]
    if ramp is not None:
        events.append(ramp)
    if line is not None:
        after_s = draw(st.none() | st.sampled_from([0.025, 0.5, 10.0]))
        events.append(LineTrip(time_s=draw(TIMES), from_bus=line[0], to_bus=line[1], recloses_after_s=after_s))
    # One machine stays.
    outages = draw(st.lists(st.sampled_from([1, 3, 6, 8]), max_size=3, unique=True))
    events += [MachineOutage(time_s=draw(TIMES), bus=bus) for bus in outages]
    tripped = draw(st.lists(st.integers(0, 1), max_size=2, unique=True))
    events += [GroupTrip(time_s=draw(TIMES), group=group) for group in tripped]
    if draw(st.booleans()):
        events.append(GovernorLoss(time_s=draw(TIMES), bus=1))
    winds = [draw(WINDS) for _ in range(2)]
    length = max(len(wind) for wind in winds)
    return Scenario(
        name="fuzz",
        wind_speed=np.array([wind + wind[-1:] * (length - len(wind)) for wind in winds]),
        wind_dt_s=draw(st.sampled_from([0.05, 0.1, 0.7, 5.0])),
        duration_s=6.0,
        events=tuple(events),
        load_noise_mw=np.array([0.0, *draw(st.lists(st.sampled_from([-100.0, 0.0, 3.0, 100.0]), max_size=60))]),
        load_noise_bus=draw(BUSES),
        load_level=draw(st.sampled_from([0.3, 0.8, 1.0, 1.5])),
        governor_droop=draw(st.sampled_from([None, 0.005, 0.05, 1.0])),
        inertia_scale=draw(st.sampled_from([0.05, 0.5, 1.0, 5.0])),
    )


@settings(FUZZ, max_examples=250)
@given(
    scenarios(),
    st.sampled_from(sorted(STRATEGIES)),
    st.sampled_from(["terminate", "trip"]),
    st.sampled_from(["genrou", "classical"]),
    st.lists(ACTION, min_size=1, max_size=12),
)
def test_any_scenario_plays_to_a_physical_end(
    scenario: Scenario, strategy: str, on_failure: str, machine_model: str, actions: list[float]
):
    env = GFMWTGEnv(duration_s=6.0, strategy=strategy, on_failure=on_failure, machine_model=machine_model, version="v0")
    try:
        env.reset(options={"scenario": scenario})
    except ValueError as error:
        assert "cannot start" in str(error)
        return
    play(env, actions, options={"scenario": scenario})


SENSOR_NUMBERS = {f.name: f.metadata for f in dataclasses.fields(Sensors) if f.type == "float"}


def numbers(name: str) -> st.SearchStrategy[float]:
    low, high = (SENSOR_NUMBERS[name][edge] for edge in ("low", "high"))
    return st.sampled_from([low, high]) | st.floats(low, high, allow_subnormal=False)


ANY_SENSORS = st.builds(
    Sensors,
    seed=st.integers(0, 2**31 - 1),
    wind_bias=st.tuples(*[st.floats(-0.5, 0.5)] * 4),
    delay_s=st.integers(0, 10).map(lambda steps: round(0.1 * steps, 9)),
    wind_sensor=st.booleans(),
    **{name: numbers(name) for name in SENSOR_NUMBERS if name != "delay_s"},
)


@FUZZ
@given(
    ANY_SENSORS,
    st.sampled_from([3.0, 6.0, 9.0, 15.0, 25.0]),
    st.lists(ACTION, min_size=1, max_size=12),
    st.sampled_from(["local", "privileged"]),
)
def test_whatever_the_sensors_say_observations_are_finite_and_in_the_box(
    sensors: Sensors, wind: float, actions: list[float], observation_mode: str
):
    env = GFMWTGEnv(version="v1", duration_s=2.0, observation_mode=observation_mode)
    drawn = get_suite("standard-v1").scenario(1_000_003, duration_s=2.0)
    scenario = dataclasses.replace(drawn, sensors=sensors, wind_speed=np.full((4, 1), wind))
    try:
        env.reset(options={"scenario": scenario})
    except ValueError as error:
        assert "cannot start" in str(error)
        return
    play(env, actions, options={"scenario": scenario})
