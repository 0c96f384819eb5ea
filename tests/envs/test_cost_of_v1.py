"""Facts about what v1 charges, computed anew from states and events."""

import math

import numpy as np
import pytest

from tests.envs.rollouts import calm
from wtg_gym.envs import GFMWTGEnv
from wtg_gym.physics.scenario import Event, Fault, GroupTrip, LineTrip, LoadStep, MachineOutage
from wtg_gym.tasks.cost import COST_TERMS, FILTERED_DUTY

#: Lines whose opening leaves the groups at buses 6 and 8 to themselves.
CUT = [LineTrip(time_s=1.0, from_bus=a, to_bus=b) for a, b in ((5, 6), (4, 7), (4, 9))]
TERMS = [f"cost_{name}" for name in COST_TERMS]


def steps(*events: Event, duration_s: float = 12.0, action: float = 0.0, **settings):
    """Play a scenario of v1; yield environment, reward and terms of the cost after each step."""
    scenario = calm(wind=10.0, n_wtg=4, duration_s=duration_s, events=events)
    env = GFMWTGEnv(version="v1", scenario=scenario, **{"control_dt": 0.1, "reward": "cost", **settings})
    env.reset(seed=0)
    over = False
    while not over:
        _, reward, terminated, truncated, info = env.step(np.full(8, action))
        over = terminated or truncated
        yield env, reward, dict(zip(COST_TERMS, (info[name] for name in TERMS), strict=True))


def farthest_hz(env: GFMWTGEnv) -> tuple[float, float]:
    """Largest deviation of a connected unit or of the centre of inertia, and that of the centre alone."""
    simulator = env.lanes.simulator
    omega = simulator.machine_values("speed")[0], (simulator.wtg_values("speed") + simulator.wtg_values("shift"))[0]
    connected = simulator.machine_values("connected")[0], simulator.wtg_values("connected")[0]
    centre = abs(simulator.lane_values("coi")[0] - 1.0)
    units = np.abs(np.concatenate(omega) - 1.0)[np.concatenate(connected) > 0.5]
    return 50.0 * max(centre, units.max()), 50.0 * centre


@pytest.mark.parametrize(
    ("events", "reached"),
    [
        (CUT, 60.0),
        ([Fault(time_s=1.0, bus=4, clears_after_s=0.25, opens=(4, 5))], 5.0),
        ([MachineOutage(time_s=1.0, bus=1)], 60.0),
        ([GroupTrip(time_s=1.0, group=1), LoadStep(time_s=1.0, bus=3, power_mw=90.0)], 30.0),
    ],
    ids=["island", "fault", "last generator", "group"],
)
def test_the_frequency_charged_is_that_of_the_worst_connected_unit_without_a_cap(events, reached):
    apart, largest = 0.0, 0.0
    for env, _, terms in steps(*events):
        worst, centre = farthest_hz(env)
        ratio = worst / 0.2
        rate = ratio**2 if ratio < 1.0 else 1.0 + 8.0 * (ratio - 1.0)
        assert terms["frequency"] == pytest.approx(0.1 * rate, rel=1e-9)
        apart, largest = max(apart, worst - centre), max(largest, rate)
    assert apart > 0.05 and largest > reached


def test_the_cap_holds_for_the_other_terms_together():
    played = [
        [terms for *_, terms in steps(*CUT, LoadStep(time_s=3.0, bus=9, power_mw=30.0), action=1.0, weights=weights)]
        for weights in (None, {"cap": 1e6})
    ]
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
    capacitor, load = (
        LoadStep(time_s=1.0, bus=8, power_mw=0.0, reactive_mvar=-120.0),
        LoadStep(time_s=4.0, bus=3, power_mw=40.0),
    )
    before = 0.0
    for env, _, _ in steps(capacitor, load):
        simulator = env.lanes.simulator
        now = simulator.values(simulator.layout.rows_of(FILTERED_DUTY, "mean_duty")[3])[0]
        # The available power of a calm wind, of which 0.05 are a unit.
        owed, before = (now - before) / -math.expm1(-0.1 / 15.0) + before, now
        gone, centre = simulator.wtg_values("connected")[0, 3] < 0.5, simulator.lane_values("coi")[0]
        if gone:
            share = np.interp(centre, [0.992, 1.0, 1.008], [1.0, 0.95, 0.9])
            assert owed == pytest.approx(-share / 0.05, rel=1e-9)
    assert gone and abs(simulator.wtg_values("speed")[0, 3] - centre) > 0.002


def test_load_that_is_shed_is_charged_by_its_share():
    step = LoadStep(time_s=1.0, bus=3, power_mw=150.0)
    played = list(steps(step, duration_s=20.0))
    charged = {round(terms["failure"], 9) for *_, terms in played}
    env = played[0][0]
    env.reset()
    buses = env.lanes.simulator.settings.case.buses
    loads = np.array([bus.load_mw + (step.power_mw if bus.number == step.bus else 0.0) for bus in buses])
    # The first stage, 5 % at 49 Hz, of the event's load too; counted at 1 p.u. of voltage.
    unserved = 0.05 * (loads / np.abs(env.lanes.simulator.bus_voltages()) ** 2).sum()
    assert sum(bus.load_mw for bus in buses) == pytest.approx(259.0)
    assert sorted(charged) == pytest.approx([0.0, 0.1 * 300.0 * unserved / 259.0], rel=1e-6)


@pytest.mark.parametrize("weights", [None, {"failure": 130.0}])
def test_a_failed_episode_costs_the_same_whenever_it_fails(weights):
    for time_s in (1.0, 9.0):
        more = LoadStep(time_s=0.5, bus=4, power_mw=60.0)
        paid = list(steps(more, LoadStep(time_s=time_s, bus=3, power_mw=-330.0), duration_s=12.0, weights=weights))
        env, _, last = paid[-1]
        assert env.lanes.statuses()[0] and 10.0 * time_s < len(paid) < 10.0 * time_s + 30.0
        assert last["failure"] > 0.0
        total = -sum(reward for _, reward, _ in paid)
        assert total == pytest.approx((weights or {"failure": 250.0})["failure"] * 13.0, rel=1e-12)
