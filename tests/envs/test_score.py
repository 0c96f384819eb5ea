"""What v1 pays and charges, computed anew from states and events; starts and ends of episodes."""

import functools
import math

import numpy as np
import pytest

from tests.envs.rollouts import N_WTG, VERSIONS, actions_of, calm, episode, eventful, rising, sagging, started
from wtg_gym import GFMWTGEnv, GFMWTGVectorEnv, LoadStep, Plant, Scenario, get_suite, simulate
from wtg_gym.physics.parameters import ProtectionParameters
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Event, Fault, GroupTrip, LineTrip, MachineOutage
from wtg_gym.physics.units import ISLANDS, Spread, TripCause
from wtg_gym.tasks import V1
from wtg_gym.tasks.cost import COST_TERMS, FILTERED_DUTY, CostWeights

SUITE = get_suite("standard-v1")
N_STEPS = 60
SHORT = {"version": "v1", "duration_s": 30.0}
#: All load but a third is lost: the frequency passes its upper limit.
BLACKOUT = calm(n_wtg=4, duration_s=30.0, events=(LoadStep(time_s=12.3, bus=3, power_mw=-150.0),), inertia_scale=0.3)
ZERO, RANDOM = np.zeros((N_STEPS, 8)), actions_of(4, N_STEPS, n_action=8)[:, 0]
#: Lines whose opening leaves the groups at buses 6 and 8 to themselves.
CUT = [LineTrip(time_s=1.0, from_bus=a, to_bus=b) for a, b in ((5, 6), (4, 7), (4, 9))]
FAR = [
    (CUT, 60.0),
    ([Fault(time_s=1.0, bus=4, clears_after_s=0.25, opens=(4, 5))], 5.0),
    ([MachineOutage(time_s=1.0, bus=1)], 60.0),
    ([GroupTrip(time_s=1.0, group=1), LoadStep(time_s=1.0, bus=3, power_mw=90.0)], 30.0),
]


def drawn(seed: int) -> Scenario:
    """Return a scenario of the test split, cut, whose margin follows from what is left."""
    return SUITE.scenario(seed, duration_s=30.0)


CASES = {
    "ample": ({"strategy": "mppt"}, drawn(20_001), ZERO, 40.0),
    "tight": ({}, drawn(20_002), RANDOM, 200.0),
    "short": ({"action_mode": "k", "weights": {"duty": 1.0}}, drawn(20_000), RANDOM[:, :4], 1000.0),
    "of one's own": ({}, eventful(n_wtg=4), RANDOM, 1000.0),
    "blackout": ({"strategy": "coordinated-piecewise"}, BLACKOUT, ZERO, 40.0),
    "v0": ({"version": "v0", "reward": "score"}, eventful(), RANDOM[:, :4], 5.0),
}


def costs(settings, scenario: Scenario, actions: np.ndarray) -> np.ndarray:
    """Return what an episode has cost up to each step, by the environment whose reward is the cost."""
    env = GFMWTGEnv(scenario=scenario, **{**SHORT, **settings, "reward": "cost"})
    return np.cumsum([-reward for reward, *_ in episode(env, actions)])


def tuned(settings):
    """Return settings with the law that scores 100."""
    return {**settings, "strategy": "coordinated-piecewise" if settings.get("version") == "v0" else "coordinated-tuned"}


@functools.cache
def played(name: str) -> tuple[list[float], bool]:
    settings, scenario, actions, _ = CASES[name]
    taken = list(episode(GFMWTGEnv(scenario=scenario, **{**SHORT, **settings}), actions))
    return [step[0] for step in taken], taken[-1][1]


@pytest.mark.parametrize("name", CASES)
def test_an_episode_returns_its_score_less_a_hundred(name):
    settings, scenario, actions, offset = CASES[name]
    rewards, failed = played(name)
    paid = costs(settings, scenario, actions)
    hundred = costs(tuned(settings), scenario, 0.0 * actions)
    # v0 has no scale of its own.
    points = 100.0 / (V1.scale or 1.0) if name != "v0" else 100.0
    assert failed == (name == "blackout") and len(rewards) == len(paid) <= len(hundred)
    # Up to every step but the last, which makes up for the logarithm.
    expected = points * (hundred[: len(paid)] - paid) / (hundred[-1] + offset)
    expected[-1] = points * math.log((hundred[-1] + offset) / (paid[-1] + offset))
    assert np.cumsum(rewards) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_an_episode_that_is_cut_returns_what_it_is_worth_so_far():
    settings, scenario, actions, offset = CASES["tight"]
    env = started(GFMWTGVectorEnv(2, max_episode_steps=7, scenario=scenario, **SHORT))
    total = np.zeros(2)
    for step in range(1, 8):
        _, rewards, _, truncated, _ = env.step(np.tile(actions[step - 1], (2, 1)))
        total += rewards
    assert truncated.all()
    own, hundred = (costs(given, scenario, a)[6] for given, a in ((settings, actions), (tuned(settings), ZERO)))
    assert total == pytest.approx(100.0 / V1.scale * math.log((hundred + offset) / (own + offset)), rel=1e-9)
    # The step that resets it returns nothing.
    assert not env.step(np.ones((2, 8)))[1].any()


@pytest.mark.parametrize("num_envs", [1, 33])
def test_the_law_that_scores_a_hundred_returns_nothing_and_others_what_they_return_alone(num_envs):
    settings = {**SHORT, "autoreset_mode": "SameStep", "n_threads": 2}
    env = started(GFMWTGVectorEnv(num_envs, strategy="coordinated-tuned", **settings), seed=3)
    assert not any(env.step(np.zeros((num_envs, 8)))[1].any() for _ in range(2 * N_STEPS))
    env.close()
    names = [("tight", "of one's own")[env_index % 2] for env_index in range(num_envs)]
    options = {"scenarios": [CASES[name][1] for name in names]}
    env = started(GFMWTGVectorEnv(num_envs, **settings), options=options)
    rewards = np.array([env.step(np.tile(action, (num_envs, 1)))[1] for action in RANDOM])
    for env_index, name in enumerate(names):
        expected = played(name)[0]
        assert rewards[: len(expected), env_index].tolist() == expected, (env_index, name)
    env.close()


def cost_steps(*events: Event, duration_s: float = 12.0, action: float = 0.0, **settings):
    """Play a scenario of v1; yield environment, reward and terms of the cost after each step."""
    scenario = calm(wind=10.0, n_wtg=4, duration_s=duration_s, events=events)
    env = GFMWTGEnv(version="v1", scenario=scenario, **{"control_dt": 0.1, "reward": "cost", **settings})
    for reward, _, _, info in episode(env, action, seed=0):
        yield env, reward, {name: info[f"cost_{name}"] for name in COST_TERMS}


def farthest_hz(env: GFMWTGEnv) -> tuple[float, float]:
    """Largest deviation of a connected unit or of the centre of inertia, and that of the centre alone."""
    simulator = env.batch.simulator
    omega = simulator.machine_values("speed")[0], (simulator.wtg_values("speed") + simulator.wtg_values("shift"))[0]
    connected = simulator.machine_values("connected")[0], simulator.wtg_values("connected")[0]
    centre = abs(simulator.env_values("coi")[0] - 1.0)
    units = np.abs(np.concatenate(omega) - 1.0)[np.concatenate(connected) > 0.5]
    return 50.0 * max(centre, units.max()), 50.0 * centre


@pytest.mark.parametrize(("events", "reached"), FAR, ids=["island", "fault", "last generator", "group"])
def test_the_frequency_charged_is_that_of_the_worst_connected_unit_without_a_cap(events, reached):
    apart, largest = 0.0, 0.0
    for env, _, terms in cost_steps(*events):
        worst, centre = farthest_hz(env)
        ratio = worst / 0.2
        rate = ratio**2 if ratio < 1.0 else 1.0 + 8.0 * (ratio - 1.0)
        assert terms["frequency"] == pytest.approx(0.1 * rate, rel=1e-9)
        apart, largest = max(apart, worst - centre), max(largest, rate)
    assert apart > 0.05 and largest > reached


def test_the_cap_holds_for_the_other_terms_together():
    events, capped = (*CUT, LoadStep(time_s=3.0, bus=9, power_mw=30.0)), (None, {"cap": 1e6})
    played = [[terms for *_, terms in cost_steps(*events, action=1.0, weights=weights)] for weights in capped]
    n_capped = 0
    for held, free in zip(*played, strict=True):
        assert held["frequency"] == free["frequency"] and held["failure"] == free["failure"]
        others = [name for name in COST_TERMS if name not in ("frequency", "failure")]
        total = sum(free[name] for name in others)
        share = min(1.0, 1.5 / total)
        assert [held[name] for name in others] == pytest.approx([share * free[name] for name in others], rel=1e-9)
        n_capped += share < 1.0
    assert 0 < n_capped < len(played[0])


def test_a_group_that_its_protection_has_tripped_owes_its_power_at_the_frequency_of_the_grid():
    # Over-voltage disconnects the group at bus 8, then a load lowers the frequency.
    capacitor = LoadStep(time_s=1.0, bus=8, power_mw=0.0, reactive_mvar=-120.0)
    load = LoadStep(time_s=4.0, bus=3, power_mw=40.0)
    before = 0.0
    for env, _, _ in cost_steps(capacitor, load):
        simulator = env.batch.simulator
        now = simulator.values(simulator.layout.rows_of(FILTERED_DUTY, "mean_duty")[3])[0]
        # The available power of a calm wind, of which 0.05 are a unit.
        owed, before = (now - before) / -math.expm1(-0.1 / 15.0) + before, now
        gone, centre = simulator.wtg_values("connected")[0, 3] < 0.5, simulator.env_values("coi")[0]
        if gone:
            share = np.interp(centre, [0.992, 1.0, 1.008], [1.0, 0.95, 0.9])
            assert owed == pytest.approx(-share / 0.05, rel=1e-9)
    assert gone and abs(simulator.wtg_values("speed")[0, 3] - centre) > 0.002


def test_load_that_is_shed_is_charged_by_its_share():
    step = LoadStep(time_s=1.0, bus=3, power_mw=150.0)
    played = list(cost_steps(step, duration_s=20.0))
    charged = {round(terms["failure"], 9) for *_, terms in played}
    env = played[0][0]
    env.reset()
    buses = env.batch.simulator.settings.case.buses
    loads = np.array([bus.load_mw + (step.power_mw if bus.number == step.bus else 0.0) for bus in buses])
    # The first stage, 5 % at 49 Hz, of the event's load too; counted at 1 p.u. of voltage.
    unserved = 0.05 * (loads / np.abs(env.batch.simulator.bus_voltages()) ** 2).sum()
    assert sum(bus.load_mw for bus in buses) == pytest.approx(259.0)
    assert sorted(charged) == pytest.approx([0.0, 0.1 * 300.0 * unserved / 259.0], rel=1e-6)


@pytest.mark.parametrize("weights", [None, {"failure": 130.0}])
def test_an_episode_of_v1_ends_at_its_frequency_limit_and_costs_the_same_whenever_it_does(weights):
    for time_s in (1.0, 9.0):
        more = LoadStep(time_s=0.5, bus=4, power_mw=60.0)
        paid = list(cost_steps(more, LoadStep(time_s=time_s, bus=3, power_mw=-330.0), duration_s=12.0, weights=weights))
        env, _, last = paid[-1]
        assert env.batch.statuses()[0] == Status.FREQUENCY_LIMIT and 10.0 * time_s < len(paid) < 10.0 * time_s + 30.0
        frequency_pu, shed = (env.batch.simulator.env_values(name)[0] for name in ("coi", "shed_energy"))
        assert 51.5 < 50.0 * frequency_pu < 51.6 and shed == 0.0
        assert last["failure"] > 0.0
        total = -sum(reward for _, reward, _ in paid)
        assert total == pytest.approx((weights or {"failure": 250.0})["failure"] * 13.0, rel=1e-12)


GONE = calm(duration_s=20.0, events=(LoadStep(time_s=1.025, bus=2, power_mw=600.0),))
TRIPS = [LineTrip(time_s=t, from_bus=a, to_bus=b) for t, a, b in ((1.0, 1, 2), (1.2, 2, 5), (1.2, 2, 4))]
TORN = calm(duration_s=20.0, events=(*TRIPS, LoadStep(time_s=2.0, bus=3, power_mw=75.0)))
SAGGED = calm(duration_s=20.0, events=(LoadStep(time_s=1.0, bus=2, power_mw=0.0, reactive_mvar=800.0),))
FAILURES = [
    (GONE, "frequency limit", 0.0, 47.5),
    (TORN, "loss of synchronism", 49.0, 51.0),
    (SAGGED, "voltage collapse", 49.0, 51.0),
    (rising(), "over-speed", 49.0, 51.0),
]


def play(scenario: Scenario, action=0.0, **settings):
    arguments = {"version": "v0", "scenario": scenario.to_dict(), "control_dt": 0.1, "reward": "cost", **settings}
    env = GFMWTGEnv(**arguments)
    steps = list(episode(env, action, seed=0))
    return np.array([step[0] for step in steps]), steps[-1], env


@pytest.mark.parametrize("weights", [None, {"cap": 1e-3}, {"rotor": 1e6}])
def test_stall_costs_more_than_any_way_of_living_on(weights):
    settings = {"strategy": "mppt", "weights": weights}
    rewards, (*_, info), _ = play(sagging(), **settings)
    assert info["termination_reason"] == "stall"
    cap = (weights or {}).get("cap", CostWeights().cap)
    living_on = cap * (60.0 - 0.1 * (rewards.size - 1))
    assert -rewards[-1] > living_on
    tripped, (_, terminated, truncated, info), env = play(sagging(), on_failure="trip", **settings)
    assert truncated and not terminated and tripped.size == 600 and info["termination_reason"] == ""
    assert env.batch.simulator.wtg_values("connected").tolist() == [[0.0, 0.0]]
    assert env.batch.simulator.wtg_values("trip_cause").tolist() == [[TripCause.STALL] * 2]
    assert np.isfinite(env.batch.observations).all() and tripped.min() >= -0.1 * cap * (1 + 1e-12)
    assert rewards.sum() < tripped.sum()
    assert tripped[-1] < -0.1 * min(cap, CostWeights().duty) * 0.999, "a group that captures nothing is charged for it"


@pytest.mark.parametrize("on_failure", ["terminate", "trip"])
@pytest.mark.parametrize("failure", FAILURES, ids=lambda failure: failure[1])
def test_each_failure_ends_the_episode_under_its_own_name_and_a_tripped_group_does_not(failure, on_failure):
    scenario, reason, least_hz, most_hz = failure
    rewards, (_, terminated, truncated, info), env = play(scenario, -1.0, on_failure=on_failure)
    if reason == "over-speed" and on_failure == "trip":
        assert TripCause.OVER_SPEED in env.batch.simulator.wtg_values("trip_cause")
        assert truncated and not terminated and info["termination_reason"] == ""
        return
    assert terminated and not truncated and info["termination_reason"] == reason
    assert least_hz < info["frequency_hz"] < most_hz
    assert rewards[-1] < -CostWeights().cap * (20.0 - 0.1 * rewards.size)


def test_low_voltage_may_last_three_seconds():
    _, (*_, info), env = play(SAGGED)
    simulator = env.batch.simulator
    spread = Spread(*simulator.scratches[0][simulator.layout.first_rows(ISLANDS, "spread")[0] :][:3, 0])
    assert spread.least_squared_voltage < 0.85**2
    assert info["time_s"] == pytest.approx(1.0 + 3.0 + 0.1)
    longer = Plant(protection=ProtectionParameters(low_voltage_time_s=10.0))
    assert simulate(SAGGED, "coordinated-piecewise", longer).time_s[-1] == pytest.approx(1.0 + 10.0 + 0.1)


@pytest.mark.parametrize(("scenario", "status"), [(sagging(), Status.STALL), (SAGGED, Status.VOLTAGE_COLLAPSE)])
def test_run_ends_when_it_does_whatever_the_control_interval(scenario, status):
    usual, *runs = (simulate(scenario, "mppt", Plant(interval_s=dt)) for dt in (0.1, 0.05, 0.5, 10.0))
    assert usual.status == status
    for run in runs:
        assert run.status == status
        assert run.time_s[-1] == pytest.approx(usual.time_s[-1], abs=0.051)
        assert run.tip_speed_ratio[-1] == pytest.approx(usual.tip_speed_ratio[-1], rel=1e-3)


@pytest.mark.parametrize("control_dt", [0.1, 10.0])
def test_no_run_costs_more_than_one_that_fails_at_once_even_if_it_ends_within_a_long_step(control_dt):
    for scenario in (GONE, TORN):
        rewards, (_, terminated, *_), env = play(scenario, 1.0, control_dt=control_dt, weights={"cap": 1e-3})
        assert terminated and -rewards.sum() <= 1e-3 * (20.0 + 1.0) * (1.0 + 1e-9)
        error = env.batch.task_values("duty_error")[0]
        assert 0.0 < error < env.batch.simulator.env_values("step")[0] * 0.025


@pytest.mark.parametrize("version", VERSIONS)
def test_scenario_shorter_than_the_episode_is_cut_at_its_end(version):
    env = GFMWTGEnv(version=version, duration_s=5.0)
    short = eventful(duration_s=2.0, n_wtg=N_WTG[version])
    steps = list(episode(env, seed=0, options={"scenario": short}))
    per_s = {"v0": 10, "v1": 2}[version]
    assert len(steps) == 2 * per_s and steps[-1][2] and steps[-1][3]["time_s"] == pytest.approx(2.0)
    assert len(list(episode(env))) == 5 * per_s
