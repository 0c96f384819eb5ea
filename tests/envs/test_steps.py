"""What a step is, told and charged, and that every environment of a batch is a single environment of its own."""

import copy
import itertools

import numpy as np
import pytest
from gymnasium.utils.seeding import np_random

from tests.envs import rollouts
from tests.envs.rollouts import ACTION_MODES, VERSIONS, actions_of, calm, episode, eventful
from wtg_gym import GFMWTGEnv, GFMWTGVectorEnv, GroupTrip, LoadStep, Scenario, get_suite, simulate
from wtg_gym.envs import CostWeights
from wtg_gym.physics.grid import DEFAULT_GRID
from wtg_gym.physics.parameters import ProtectionParameters
from wtg_gym.physics.tracking_law import LAWS
from wtg_gym.scenarios import SUITES
from wtg_gym.scenarios.draws import SensorDistribution
from wtg_gym.tasks.cost import COST, COST_TERMS

EVENTFUL = get_suite("standard").scenario(20_003)
LOW_WIND = get_suite("low-wind").scenario(20_001)
KEYS = {*(f"cost_{name}" for name in COST_TERMS), "time_s", "frequency_hz", "rocof_hz_s", "cost", "scenario_seed"}
N_STEPS, N_HELD = 40, 5
#: The frequency passes its upper limit within a step.
BLACKOUT = calm(n_wtg=4, duration_s=20.0, events=(LoadStep(time_s=7.1, bus=3, power_mw=-150.0),), inertia_scale=0.3)
HELD = [
    (get_suite("faults-v1").scenario(20_002, duration_s=20.0), {"observation_mode": "privileged"}),
    (eventful(n_wtg=4, duration_s=6.5), {"strategy": "mppt", "action_mode": "tau"}),
    (BLACKOUT, {}),
]


def follow(scenario: Scenario, **settings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequency, rotor speed and coefficient over an episode of zero actions (one of them minus zero)."""
    env = GFMWTGEnv(version="v0", scenario=scenario.to_dict(), **settings)
    _, info = env.reset(seed=0)
    simulator = env.batch.simulator
    rows, over, zero = [], False, 0.0
    while True:
        rows.append((info["frequency_hz"], *(simulator.wtg_values(name)[0] for name in ("rotor_speed", "coefficient"))))
        if over:
            return tuple(map(np.array, zip(*rows, strict=True)))
        zero = -zero
        _, _, terminated, truncated, info = env.step(np.full(env.action_space.shape, zero))
        over = terminated or truncated


@pytest.mark.parametrize("scenario", [EVENTFUL, LOW_WIND, eventful()], ids=lambda scenario: scenario.name)
def test_zero_action_is_the_strategy_to_the_last_bit(scenario):
    strategies = [*((name, name) for name in LAWS), ("mppt", "deloaded-10")]
    for names, action_mode in zip(strategies, itertools.cycle(ACTION_MODES), strict=False):
        frequency, speed, coefficient = follow(scenario, strategy=list(names), action_mode=action_mode)
        run = simulate(scenario, names)
        assert frequency.tobytes() == run.frequency_hz.tobytes(), names
        assert speed.tobytes() == run.rotor_speed_pu.tobytes()
        assert coefficient.tobytes() == run.coefficient_pu.tobytes()


def test_action_on_k_moves_power_up_and_on_tau_only_the_transient():
    for mode, value in (("k", 1.0), ("k", -1.0), ("tau", 1.0), ("tau", -1.0)):
        env = rollouts.started(GFMWTGEnv(scenario=calm().to_dict(), action_mode=mode, version="v0"), seed=0)
        before = env.batch.simulator.wtg_values("power")[0]
        env.step(np.full(2, value))
        change = env.batch.simulator.wtg_values("power")[0] - before
        assert (value * change > 1e-4).all() if mode == "k" else np.abs(change).max() < 1e-9


def test_action_names_are_in_the_order_of_the_action():
    for mode in ACTION_MODES:
        env = GFMWTGEnv(scenario=calm(n_wtg=4).to_dict(), action_mode=mode, version="v1")
        for i, name in enumerate(env.action_names):
            env.reset()
            observation = env.step(np.eye(len(env.action_names))[i])[0]
            seen = dict(zip(env.observation_names, observation, strict=True))
            assert [key for key in seen if "last_action" in key and seen[key]] == [name.replace(".", ".last_action_")]


def test_groups_at_a_shared_bus_in_the_same_wind_behave_alike():
    # Bus 2 holds its voltage with the groups alone: two turbines could not. The number is a constant of the compiled
    # code, without a limit of its own there: more than three groups would take half a minute to compile.
    groups = [{"bus": bus, "n_turbines": 10.0 if bus == 2 else 1.0} for bus in (2, 9, 9)]
    env = GFMWTGEnv(groups=groups, scenario=calm(n_wtg=3, duration_s=2.0).to_dict(), version="v0")
    observation, _ = env.reset(seed=0)
    n = observation.size // 3
    assert env.action_space.shape == (6,) and observation.size == len(env.observation_names) == 3 * n
    for _ in range(20):
        observation, _, terminated, truncated, _ = env.step(np.array([0.4, -0.2] * 3))
        assert env.observation_space.contains(observation)
    assert truncated and not terminated
    assert observation[n : 2 * n] == pytest.approx(observation[2 * n :].tolist(), abs=1e-6)
    assert observation[:n] != pytest.approx(observation[n : 2 * n].tolist(), abs=1e-3)


@pytest.mark.parametrize("name", ["frequency", "rocof", "duty", "rotor", "effort"])
def test_every_weight_scales_its_own_term_alone(name):
    scenario, term, weight = eventful(7.0).to_dict(), f"cost_{name}", getattr(CostWeights(), name)
    weights = [{name: factor * weight, "cap": 1e6} for factor in (1.0, 3.0)]
    light, heavy = (GFMWTGEnv(scenario=scenario, weights=own, version="v0") for own in weights)
    total = 0.0
    for (*_, info), (*_, other) in zip(episode(light, -1.0), episode(heavy, -1.0), strict=True):
        total += info[term]
        assert other[term] == pytest.approx(3.0 * info[term], rel=1e-12)
        assert all(other[key] == info[key] for key in KEYS - {term} | {"termination_reason"})
    assert total > 0.0 or name == "rotor"


@pytest.mark.parametrize("action_mode", ACTION_MODES)
@pytest.mark.parametrize("version", VERSIONS)
def test_observations_stay_in_their_space_and_no_entry_is_constant(version, action_mode):
    modes = {"action_mode": action_mode, "observation_mode": "privileged"}
    env = GFMWTGVectorEnv(5, version=version, duration_s=15.0, **modes)
    n_action = env.single_action_space.shape[0]
    seen = [env.reset(seed=0)[0]]
    for action in actions_of(2, 320, 5, n_action):
        seen.append(env.step(action)[0])
        assert env.observation_space.contains(seen[-1])
    values = np.stack(seen)
    assert values.dtype == np.float32 and np.isfinite(values).all()
    names = env.batch.observation_names
    assert len(names) == len(set(names)) == values.shape[-1]
    assert all("[" in name or "last_action" in name for name in names)
    spread = np.ptp(values.reshape(-1, values.shape[-1]), axis=0)
    assert [name for name, width in zip(names, spread, strict=True) if width < 1e-4] == []


def state(env: GFMWTGVectorEnv):
    """Return all that an environment carries on, but what the last interval cost: after an end that is nothing."""
    simulator = env.batch.simulator
    return np.delete(simulator.blocks, simulator.layout.first_rows(COST, "cost"), axis=1)


@pytest.mark.parametrize("num_envs", [1, 3])
@pytest.mark.parametrize(("scenario", "settings"), HELD, ids=["drawn", "every event", "blackout"])
def test_a_step_is_five_intervals_with_its_action(scenario, settings, num_envs):
    given = {"duration_s": 20.0, "reward": "cost", "n_threads": 1, **settings}
    held, fine = (GFMWTGVectorEnv(num_envs, control_dt=dt, **given) for dt in (None, 0.1))
    for env in (held, fine):
        env.reset(seed=0, options={"scenarios": [scenario] * num_envs})
    n, within = 0, 0
    for action in actions_of(2, N_STEPS, 1, held.single_action_space.shape[0]).repeat(num_envs, axis=1):
        observations, rewards, *ends, info = held.step(action)
        shares = []
        for _ in range(N_HELD):
            shares.append(fine.step(action))
            if (shares[-1][2] | shares[-1][3]).any():
                break
        n, within = n + len(shares), len(shares)
        assert observations.tobytes() == shares[-1][0].tobytes()
        assert [end.tolist() for end in ends] == [end.tolist() for end in shares[-1][2:4]]
        assert state(held).tobytes() == state(fine).tobytes()
        # A step costs what its intervals do, term by term, and violates a constraint if one of them does.
        for name in ("cost", *(f"cost_{term}" for term in COST_TERMS)):
            values = [each[4][name] for each in shares]
            assert info[name].tolist() == (np.max(values, axis=0) if name == "cost" else sum(values)).tolist()
        assert rewards.tolist() == sum(each[1] for each in shares).tolist()
        assert -rewards == pytest.approx(sum(info[f"cost_{term}"] for term in COST_TERMS), rel=1e-12)
        assert all(info[name].tolist() == shares[-1][4][name].tolist() for name in ("time_s", "frequency_hz"))
        if any(end.any() for end in ends):
            break
    assert ends[0].any() == (scenario is BLACKOUT) and (within < N_HELD or scenario is not BLACKOUT)
    assert held.batch.n_steps().tolist() == [-(-n // N_HELD)] * num_envs


SUITES_V1 = [name for name, suite in SUITES.items() if suite.task.version == "v1"]


def equal_steps(mode, actions, seed: int = 0, scenarios=None, of=None, n_threads: int | None = None, **settings):
    """Return the steps of a batch, once those of some or all of its environments are those of a single one."""
    env = GFMWTGVectorEnv(actions.shape[1], autoreset_mode=mode, n_threads=n_threads, **settings)
    batch = rollouts.vector_steps(env, actions, seed=seed, start=scenarios and {"scenarios": scenarios})
    env.close()
    single = GFMWTGEnv(**settings)
    for env_index in range(env.num_envs) if of is None else of:
        start = scenarios and {"scenario": scenarios[env_index]}
        alone = rollouts.single_steps(single, actions[:, env_index], mode, seed=seed + env_index, start=start)
        assert batch[env_index] == alone, f"environment {env_index}"
    return batch


@pytest.mark.parametrize("suite", SUITES_V1)
def test_env_of_version_v1_equals_the_single_environment_in_every_suite_and_mode(suite):
    n_wtg, some = len(SUITES[suite].plant.groups), (0, 11, 16)
    # Scenarios of other grids take long to draw: each grid has a mode of its own.
    for seed in range(3) if SUITES[suite].grid == DEFAULT_GRID else [SUITES_V1.index(suite) % 3]:
        action_mode, observation_mode = ACTION_MODES[seed], rollouts.OBSERVATION_MODES[seed % 2]
        settings = {"suite": suite, "action_mode": action_mode, "observation_mode": observation_mode}
        # Episodes of five steps.
        actions = actions_of(seed, 20, 17, n_wtg * (1 + (action_mode == "k+tau")))
        threads = {"of": some, "n_threads": 1 + seed % 2, "duration_s": 2.5}
        batch = equal_steps(rollouts.MODES[seed % 3], actions, seed, **threads, **settings)
        assert all(rollouts.n_resets(batch[env_index]) >= 2 for env_index in some)


def failing(version: str):
    if version == "v0":
        return {"version": "v0", "strategy": "mppt", "scenario": rollouts.sagging(7.6, 45.0).to_dict()}
    events = (GroupTrip(time_s=1.025, group=2), LoadStep(time_s=2.0, bus=3, power_mw=40.0))
    sensors = SensorDistribution().draw_many("x", [1], 4)[0]
    course = calm(8.0, 30.0, 4, events=events, sensors=sensors, inertia_scale=0.3, governor_droop=0.08)
    settings = {"version": "v1", "control_dt": 0.1, "strategy": "mppt", "on_failure": "terminate"}
    return {**settings, "scenario": course.to_dict()}


@pytest.mark.parametrize(("version", "n_steps", "reason"), [("v0", 420, "stall"), ("v1", 200, "under-speed")])
@pytest.mark.parametrize("mode", rollouts.MODES)
def test_env_equals_the_single_environment_where_envs_end_at_different_times(mode, version, n_steps, reason):
    actions = np.linspace(-1.0, 1.0, 17)[None, :, None].repeat(n_steps, 0).repeat(2 * rollouts.N_WTG[version], 2)
    batch = equal_steps(mode, actions, **failing(version))
    ends = {tuple(i for i, step in enumerate(steps) if step[2]) for steps in batch}
    assert len(ends) > 5 and rollouts.reasons(batch[-1]) == {reason}


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("mode", rollouts.MODES)
def test_env_plays_its_own_scenario_and_then_draws(mode, version):
    n_wtg = rollouts.N_WTG[version]
    scenarios = [eventful(7.0 + env_index, duration_s=2.0 + 0.5 * env_index, n_wtg=n_wtg) for env_index in range(5)]
    actions = actions_of(6, 70, 5, 2 * n_wtg)
    batch = equal_steps(mode, actions, 9, scenarios, version=version, duration_s=4.0)
    assert all(rollouts.n_resets(steps) >= 1 for steps in batch)


def test_returned_arrays_are_not_overwritten_by_later_steps():
    env = GFMWTGVectorEnv(3, duration_s=2.0, autoreset_mode="SameStep", version="v0")
    first = env.reset(seed=0)
    kept = [first, *(env.step(action) for action in rollouts.actions_of(12, 25, 3))]
    copies = repr(kept)
    for action in rollouts.actions_of(13, 25, 3):
        env.step(action)
    assert repr(kept) == copies
    env = GFMWTGEnv(duration_s=2.0, version="v0")
    observation, info = env.reset(seed=0)
    before = observation.tobytes(), dict(info)
    env.step(np.ones(4))
    assert (observation.tobytes(), info) == before


def test_episodes_prepared_together_are_those_that_the_generator_draws():
    # With machines of so little voltage some scenarios cannot start.
    plant = get_suite("standard").plant.replaced(protection=ProtectionParameters(internal_voltage_max_pu=1.32))
    settings = {"version": "v0", "duration_s": 5.0, "plant": plant}
    env, one_by_one = GFMWTGEnv(**settings), GFMWTGVectorEnv(1, **settings)

    def play(environment, seed) -> list[tuple[int, int, bytes]]:
        results = []
        for episode_seed in (seed, *[None] * 20):
            observation, info = environment.reset(seed=episode_seed)
            counted = environment.batch.redrawn[0]
            results.append((int(np.ravel(info["scenario_seed"])[0]), int(counted), observation.tobytes()))
        return results

    together = play(env, 3)
    assert together == play(one_by_one, 3)
    redrawn = together[-1][1]
    assert 3 < redrawn < 100
    generator, _ = np_random(3)
    before = generator.bit_generator.state
    drawn = [env.batch.draw_seed(generator) for _ in range(21 + redrawn)]
    assert drawn[-1] == together[-1][0] and env.np_random.bit_generator.state == generator.bit_generator.state
    # A generator that is set back draws the same episodes again.
    env.np_random.bit_generator.state = before
    assert [(seed, values) for seed, _, values in play(env, None)] == [(seed, values) for seed, _, values in together]


def test_rewards_and_copies_do_not_depend_on_how_many_episodes_were_prepared_together():
    env, one_by_one = GFMWTGEnv(duration_s=2.0), GFMWTGVectorEnv(1, duration_s=2.0)
    env.np_random = np.random.Generator(np.random.MT19937(5))
    generator = np.random.Generator(np.random.MT19937(5))
    for _ in range(6):
        env.reset()
        one_by_one.reset(options={"scenarios": [env.batch.draw_seed(generator)]})
        for single, alone in zip(env.batch.outputs, one_by_one.batch.outputs, strict=True):
            assert single.tobytes() == alone.tobytes()
    again = copy.deepcopy(env)
    assert again.reset()[0].tobytes() == env.reset()[0].tobytes()


def test_a_generator_that_others_draw_from_prepares_few_episodes_in_vain(monkeypatch):
    env, sizes = GFMWTGEnv(version="v0", duration_s=5.0), []
    env.reset(seed=0)
    prepare = env.batch.prepare
    monkeypatch.setattr(env.batch, "prepare", lambda scenarios: sizes.append(len(scenarios)) or prepare(scenarios))
    for _ in range(10):
        env.np_random.uniform()
        env.reset()
    assert max(sizes) == 2


def test_steps_read_the_data_that_the_simulator_holds_now():
    env, other = GFMWTGEnv(version="v0"), GFMWTGEnv(version="v0")
    env.reset(seed=0)
    env.step(np.zeros(4))
    env.batch.simulator.restore(env.batch.simulator.snapshot())
    results = [
        rollouts.started(each, seed=1) and [each.step(np.zeros(4))[0] for _ in range(100)] for each in (env, other)
    ]
    assert np.array_equal(*results)
