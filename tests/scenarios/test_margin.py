"""The reserve margin against calculations by hand, in a grid of three buses.

Loads of 60 and 40 MW at buses 2 and 3 need 103 MW with their losses. A wind of which 40 MW are available at bus 2 gives
38 MW at the start, the machine without a governor at bus 3 gives 10 MW, and that at bus 1 the other 55 MW, to which
0.8 Hz add 32 MW by its droop: 100 MVA · 0.8 / 50 / 0.05.
"""

import dataclasses

import numpy as np
import pytest

from tests.envs.rollouts import calm
from wtg_gym import GFMWTGEnv, Plant, get_suite
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.grid import Branch, Bus, NetworkCase
from wtg_gym.physics.machine_parameters import GovernorParameters
from wtg_gym.physics.parameters import WtgGroup
from wtg_gym.scenarios.margin import ReserveMargin

GOVERNOR = GovernorParameters(droop_pu=0.05, gate_max_pu=1.0)
ANY = Plant().case.machines[0]
LARGE = dataclasses.replace(ANY, bus=1, rating_mva=100.0, governor=GOVERNOR, dispatch_mw=0.0)
SMALL = dataclasses.replace(ANY, bus=3, rating_mva=50.0, governor=None, dispatch_mw=10.0)
CASE = NetworkCase(
    name="three",
    base_mva=100.0,
    frequency_hz=50.0,
    slack_bus=1,
    buses=(Bus(number=1, voltage_pu=1.0), Bus(number=2, load_mw=60.0), Bus(number=3, load_mw=40.0, voltage_pu=1.0)),
    branches=tuple(Branch(from_bus=a, to_bus=b, resistance=0.0, reactance=0.1) for a, b in ((1, 2), (2, 3), (1, 3))),
    machines=(LARGE, SMALL),
)
PLANT = Plant(case=CASE, groups=(WtgGroup(bus=2, n_turbines=10.0),))
GOVERNED = dataclasses.replace(SMALL, governor=dataclasses.replace(GOVERNOR, gate_max_pu=1.2), dispatch_mw=0.0)
SHARING = dataclasses.replace(PLANT, case=dataclasses.replace(CASE, machines=(LARGE, GOVERNED)), shares_dispatch=True)


def wind_of(share: float) -> float:
    return float((share / available_power_pu(1.0)) ** (1.0 / 3.0))


WIND = wind_of(0.8)
FALLING = np.array([[WIND] * 400 + [wind_of(0.2)] * 401])
MORE = sc.LoadStep(time_s=20.0, bus=3, power_mw=60.0)
OPEN = [sc.LineTrip(time_s=5.0, from_bus=1, to_bus=2), sc.LineTrip(time_s=10.0, from_bus=2, to_bus=3)]
CASES = {
    "nothing": ([], {}, 0.34),
    "load": ([sc.LoadStep(time_s=5.0, bus=3, power_mw=20.0)], {}, 137 / 120 - 1.03),
    "less load": (
        [sc.LoadRamp(time_s=5.0, bus=3, power_mw=-20.0, duration_s=5.0), sc.LoadTrip(time_s=9.0, bus=2)],
        {},
        0.34,
    ),
    "load of a bus that is tripped": (
        [sc.LoadTrip(time_s=5.0, bus=2), MORE, sc.GroupTrip(time_s=20.0, group=0)],
        {},
        -0.06,
    ),
    "group": ([sc.GroupTrip(time_s=5.0, group=0)], {}, -0.06),
    "generator": ([sc.MachineOutage(time_s=5.0, bus=1)], {}, -0.53),
    "governor": ([sc.GovernorLoss(time_s=5.0, bus=1)], {}, 0.02),
    "droop": ([], {"governor_droop": 0.1}, 0.18),
    "fewer units": ([], {"committed": 0.6}, 0.07),
    "largest gate": ([], {"load_level": 1.3}, 150 / 130 - 1.03),
    "falling wind": ([sc.LoadStep(time_s=40.0, bus=3, power_mw=0.0)], {"wind_speed": FALLING, "wind_dt_s": 0.1}, 0.04),
    "two parts": (OPEN, {}, 40 / 60 - 1.03),
    "a part without supply": ([OPEN[0], sc.LineTrip(time_s=10.0, from_bus=1, to_bus=3)], {}, -0.53),
    "a line that is closed again": ([dataclasses.replace(OPEN[0], recloses_after_s=3.0), OPEN[1]], {}, 0.34),
    "a fault": ([sc.Fault(time_s=5.0, bus=1, clears_after_s=0.2, opens=(1, 2)), OPEN[1]], {}, 40 / 60 - 1.03),
}


@pytest.mark.parametrize("name", CASES)
def test_the_margin_is_that_of_a_calculation_by_hand(name):
    events, changes, margin = CASES[name]
    scenario = sc.Scenario(
        name=name, **{"wind_speed": np.array([[WIND]]), "duration_s": 80.0, "events": tuple(events), **changes}
    )
    assert ReserveMargin(PLANT).of(scenario) == pytest.approx(margin, abs=1e-6)


def test_machines_that_share_the_load_share_it_by_what_they_can_give():
    # Of 65 MW the small one gives a third, and 16 MW more at 0.8 Hz.
    assert ReserveMargin(SHARING).of(calm(WIND, n_wtg=1)) == pytest.approx((40 + 65 + 32 + 16 - 103) / 100, abs=1e-6)


def test_the_environment_tells_the_margin_in_the_suites_plant_with_its_own_groups():
    suite = get_suite("standard-v1")
    env = GFMWTGEnv(duration_s=5.0)
    _, info = env.reset(seed=3)
    assert info["reserve_margin"] == suite.scenario(info["scenario_seed"], duration_s=5.0).reserve_margin
    own = calm(9.0, 5.0, 4, events=(sc.GroupTrip(time_s=2.0, group=3),))
    _, info = env.reset(options={"scenario": own})
    assert info["reserve_margin"] == ReserveMargin(suite.plant).of(own) == env.step(np.zeros(8))[4]["reserve_margin"]
    groups = [{"bus": 2, "n_turbines": 20.0}, {"bus": 6, "n_turbines": 18.0}, {"bus": 8, "n_turbines": 16.0}]
    for arguments, n_wtg in (({"groups": groups}, 3), ({"groups": 2, "scenario": calm(duration_s=5.0)}, 2)):
        env = GFMWTGEnv(duration_s=5.0, **arguments)
        _, info = env.reset(seed=3)
        plant = suite.plant.replaced(groups=arguments["groups"])
        own = arguments.get("scenario") or env.lanes.scenarios([info["scenario_seed"]])[0]
        assert own.n_wtg == n_wtg and info["reserve_margin"] == ReserveMargin(plant).of(own)
        env.step(np.zeros(2 * n_wtg))
