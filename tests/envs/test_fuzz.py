"""Under random settings, scenarios, sensors and actions every output is finite and every episode ends."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.envs.rollouts import ACTION_MODES
from wtg_gym.envs import GFMWTGEnv
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.sensors import Sensors
from wtg_gym.physics.tracking_law import LAWS
from wtg_gym.scenarios import SUITES

# The same examples on every machine, and no data base in the working tree.
FUZZ = settings(derandomize=True, database=None, suppress_health_check=list(HealthCheck))

TERMS = st.sampled_from(["frequency", "rocof", "duty", "rotor", "overload", "effort"])
WEIGHTS = st.none() | st.dictionaries(TERMS, st.sampled_from([0.0, 1e-3, 1.0, 1e6]))
STEPS = st.sampled_from([(0.1, 0.02), (0.02, 0.02), (0.1, 0.005), (0.5, 0.02), (1.0, 0.01), (3.0, 0.025)])
ACTIONS = st.lists(st.sampled_from([-1e30, -1.0, -0.5, -1e-300, 0.0, 1e-9, 0.3, 1.0, 1e308]), min_size=1, max_size=12)
ON_FAILURE, OBSERVATION_MODES = st.sampled_from(["terminate", "trip"]), st.sampled_from(["local", "privileged"])
#: Why episodes may end; a numerical failure would be ours.
REASONS = ("stall", "over-speed", "under-speed", "frequency limit", "loss of synchronism", "voltage collapse")
POWERS_MW = st.sampled_from([-1e4, -300.0, 0.0, 75.0, 1e4])
TIMES = st.integers(0, 80).map(lambda n: n * 0.025)
LINES = st.sampled_from([(1, 2), (2, 4), (4, 5), (6, 12), (9, 14), (13, 14)])
SENSOR_NUMBERS = {f.name: f.metadata for f in dataclasses.fields(Sensors) if f.type is float}


@st.composite
def arguments(draw: Any) -> dict[str, Any]:
    suite = draw(st.sampled_from(sorted(SUITES)))
    sensed, n = SUITES[suite].sensors is not None, len(SUITES[suite].plant.groups)
    control_dt, simulation_dt = draw(STEPS)
    exact = {"sensors": "exact"} if sensed and draw(st.booleans()) else {}
    names = st.sampled_from(sorted(LAWS))
    return {
        **{"suite": suite, "control_dt": control_dt, "duration_s": 3.0, **exact},
        "strategy": draw(names | st.lists(names, min_size=n, max_size=n)),
        **{"action_mode": draw(st.sampled_from(ACTION_MODES)), "observation_mode": draw(OBSERVATION_MODES)},
        "split": draw(st.sampled_from(["train", "validation", "test"])),
        "plant": {"machine_model": draw(st.sampled_from(["genrou", "classical"])), "simulation_dt": simulation_dt},
        **{"on_failure": draw(ON_FAILURE), "weights": draw(WEIGHTS)},
        "reward": draw(st.sampled_from([None, "score", "cost"])),
    }


def play(env: GFMWTGEnv, actions: list[float], **reset: Any) -> None:
    """Play one episode, going round in `actions`, and check what every step returns."""
    observation, _ = env.reset(**reset)
    assert env.observation_space.contains(observation)
    n_action = env.action_space.shape[0]
    for step in range(round(env.batch.duration_s / env.settings.step_s)):
        before = env.batch.cost_sums()
        action = [actions[(step * n_action + a) % len(actions)] for a in range(n_action)]
        observation, reward, terminated, truncated, info = env.step(np.array(action))
        assert env.observation_space.contains(observation)
        assert math.isfinite(reward)
        assert all(math.isfinite(value) for value in info.values() if not isinstance(value, str))
        terms = [value for key, value in info.items() if key.startswith("cost_")]
        assert min(terms) >= 0.0 and (env.settings.scores or -reward == pytest.approx(sum(terms), rel=1e-12, abs=1e-15))
        sums = env.batch.cost_sums()
        assert sum(terms) == pytest.approx((sums - before).sum(), rel=1e-9, abs=1e-12 * sums.max())
        assert info["termination_reason"] in (REASONS if terminated else ("",))
        if terminated or truncated:
            return
    pytest.fail("the episode did not end")


@settings(FUZZ, max_examples=40)
@given(arguments(), ACTIONS, st.integers(0, 2**31))
def test_any_settings_and_actions_play_to_the_end(given_arguments, actions, seed):
    play(GFMWTGEnv(**given_arguments), actions, seed=seed)


@st.composite
def event_lists(draw: st.DrawFn) -> tuple[sc.Event, ...]:
    buses = st.integers(1, 14)
    result: list[sc.Event] = [sc.LoadStep(time_s=draw(TIMES), bus=draw(buses), power_mw=draw(POWERS_MW))]
    result.append(sc.LoadRamp(time_s=draw(TIMES), bus=draw(buses), power_mw=draw(POWERS_MW), duration_s=0.5))
    result += [sc.LoadTrip(time_s=draw(TIMES), bus=bus) for bus in draw(st.sets(st.sampled_from([5, 9, 14])))]
    result += [sc.MachineOutage(time_s=draw(TIMES), bus=bus) for bus in draw(st.sets(st.sampled_from([3, 6, 8])))]
    result += [sc.GroupTrip(time_s=draw(TIMES), group=group) for group in draw(st.sets(st.integers(0, 1)))]
    result += [sc.GovernorLoss(time_s=draw(TIMES), bus=1)] if draw(st.booleans()) else []
    after_s = draw(st.none() | st.integers(1, 60).map(lambda n: n * 0.025))
    from_bus, to_bus = draw(LINES)
    result.append(sc.LineTrip(time_s=draw(TIMES), from_bus=from_bus, to_bus=to_bus, recloses_after_s=after_s))
    return tuple(draw(st.permutations(result)))


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


@st.composite
def scenarios(draw: Any) -> sc.Scenario:
    """Return any scenario, however unkind: with sensors for the groups of version v1, without for those of v0."""
    sensors = draw(st.none() | ANY_SENSORS)
    n_wtg = 2 if sensors is None else 4
    winds = st.lists(st.sampled_from([3.0, 5.0, 8.0, 11.4, 17.0, 25.0]), min_size=4, max_size=4)
    return sc.Scenario(
        **{"name": "fuzz", "duration_s": 3.0, "sensors": sensors},
        wind_speed=np.array([draw(winds) for _ in range(n_wtg)]),
        wind_dt_s=draw(st.sampled_from([0.05, 0.1, 0.7, 5.0])),
        events=draw(event_lists()),
        load_noise_mw=np.array([0.0, *draw(st.lists(st.sampled_from([-100.0, 0.0, 3.0, 100.0]), max_size=30))]),
        load_noise_bus=draw(st.integers(1, 14)),
        load_level=draw(st.sampled_from([0.3, 0.8, 1.0, 1.5])),
        governor_droop=draw(st.sampled_from([None, 0.005, 0.05, 1.0])),
        inertia_scale=draw(st.sampled_from([0.05, 0.5, 1.0, 5.0])),
    )


@settings(FUZZ, max_examples=100)
@given(scenarios(), st.sampled_from(sorted(LAWS)), ON_FAILURE, OBSERVATION_MODES, ACTIONS)
def test_any_scenario_plays_to_a_physical_end(scenario, strategy, on_failure, observation_mode, actions):
    drawn = {"strategy": strategy, "on_failure": on_failure, "observation_mode": observation_mode}
    env = GFMWTGEnv(version="v0" if scenario.sensors is None else "v1", duration_s=3.0, **drawn)
    try:
        env.reset(options={"scenario": scenario})
    except ValueError as error:
        assert "cannot start" in str(error)
        return
    play(env, actions, options={"scenario": scenario})
