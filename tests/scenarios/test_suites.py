"""Facts about the frozen suites, and the reserve margin of scenarios against calculations by hand.

The margin's grid has three buses. Loads of 60 and 40 MW at buses 2 and 3 need 103 MW with their losses. A wind of which
40 MW are available at bus 2 gives 38 MW at the start, the machine without a governor at bus 3 gives 10 MW, and that at
bus 1 the other 55 MW, to which 0.8 Hz add 32 MW by its droop: 100 MVA · 0.8 / 50 / 0.05.
"""

import dataclasses
import math
import pickle

import gymnasium as gym
import numpy as np
import pytest

from tests.envs.rollouts import calm, started
from wtg_gym import GFMWTGEnv, LineTrip, Plant, evaluate, get_suite
from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics import scenario as sc
from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.grid import Branch, Bus, NetworkCase
from wtg_gym.physics.machine_parameters import GovernorParameters
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup
from wtg_gym.scenarios import FROZEN_HASHES, SUITES, ScenarioDistribution, Suite
from wtg_gym.scenarios.draws import Draft, LoadEvents, LoadNoise, Picker, Record, SensorDistribution, Wind
from wtg_gym.scenarios.margin import ReserveMargin
from wtg_gym.tasks import V1

FIRST = [name for name, suite in SUITES.items() if suite.task.version == "v0"]
SECOND = [suite for suite in SUITES.values() if suite.task.version == "v1"]
FEW = {"validation": range(10_000, 10_002), "test": range(20_000, 20_002)}
STANDARD, STANDARD_V1 = (dataclasses.replace(get_suite(name), **FEW) for name in ("standard", "standard-v1"))
NOISIER = STANDARD.distributions[0].changed({LoadNoise: {"standard_deviation_mw": 1.01}})
CHANGES = [
    (STANDARD, {"drawn_from": {"": (NOISIER,)}}),
    (STANDARD, {"test": range(9, 99)}),
    (STANDARD_V1, {"drawn_from": dict(reversed(STANDARD_V1.drawn_from.items()))}),
    (STANDARD_V1, {"plant": dataclasses.replace(STANDARD_V1.plant, secondary_time_s=31.0)}),
    (STANDARD_V1, {"sensors": SensorDistribution(delay_s=(0.1, 0.2))}),
    (STANDARD_V1, {"sensors": None}),
    (STANDARD_V1, {"task": dataclasses.replace(V1, weights=V1.weights._replace(rotor=21.0))}),
    (STANDARD_V1, {"task": dataclasses.replace(V1, duty_time_s=20.0)}),
]


def test_suites_are_those_of_the_benchmark():
    assert FIRST == ["paper", "standard", "low-wind", "gust", "weak-grid"]
    drawn = ["standard", "low-share", "high-share", "gusty", "no-wind-sensor", "faults", "weak-grid", "paper"]
    assert [suite.name for suite in SECOND] == [f"{name}-v1" for name in (*drawn, "ieee39", "kundur", "nordic45")]


@pytest.fixture(scope="module", params=FROZEN_HASHES)
def drawn(request):
    """A suite of the benchmark, its hash, and the scenarios of validation and test that the hash was computed of."""
    suite, scenarios, real = dataclasses.replace(get_suite(request.param)), [], Suite.scenarios
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Suite, "scenarios", lambda *own: [result := real(*own), scenarios.extend(result)][0])
        return suite, suite.hash, scenarios


def test_hash_is_the_frozen_one(drawn):
    suite, result, _ = drawn
    assert result == FROZEN_HASHES[suite.name], "a changed suite is a new version of the benchmark"


def test_scenarios_of_a_drawn_suite_of_v1_have_the_margin_of_their_stratum_in_any_order_and_start(drawn):
    suite, _, scenarios = drawn
    if suite.task is not V1 or not suite.distributions:
        assert suite.strata == () and suite.stratum(0) == ""
        return
    assert suite.strata == ("ample", "tight", "short")
    seeds = [*suite.validation, *suite.test]
    assert [scenario.seed for scenario in scenarios] == list(seeds)
    assert [suite.stratum(seed) for seed in seeds] == [suite.strata[seed % 3] for seed in seeds]
    named = "standard-v1" if suite.name == "no-wind-sensor-v1" else suite.name
    parts = [scenario.name.split("/") for scenario in scenarios]
    assert all(own == named and int(seed) in seeds for own, _, seed in parts)
    for stratum, (low, high) in zip(suite.strata, ((0.1, math.inf), (0.0, 0.1), (-0.1, 0.0)), strict=True):
        of_stratum = [scenario for scenario in scenarios if suite.stratum(scenario.seed) == stratum]
        assert all(low <= scenario.reserve_margin < high for scenario in of_stratum)
    assert all(scenario.reserve_margin == ReserveMargin(suite.plant).of(scenario) for scenario in scenarios[::30])
    assert [own.to_json() for own in suite.scenarios(seeds[::-70])] == [own.to_json() for own in scenarios[::-70]]
    assert [suite.scenario(seed).to_json() for seed in seeds[:3]] == [own.to_json() for own in scenarios[:3]]
    # The other laws begin between these two.
    for law in ("mppt", "deloaded-10"):
        EnvBatch(EnvSettings(suite=suite.name, strategy=law, reward="cost")).prepare(scenarios)


@pytest.mark.parametrize(("suite", "change"), CHANGES, ids=str)
def test_hash_sees_scenarios_plant_sensors_and_task_but_not_words_and_copies(suite, change):
    assert dataclasses.replace(suite, **change).hash != suite.hash
    assert dataclasses.replace(suite, description="other words").hash == suite.hash
    assert pickle.loads(pickle.dumps(suite)).hash == suite.hash


@dataclasses.dataclass(frozen=True, kw_only=True)
class Blinks(Record):
    """A kind of event that the package does not draw: a line is open for some time."""

    away_s: tuple[float, float] = (1.0, 2.0)

    def draw(self, pick: Picker, draft: Draft) -> None:
        away_s, time_s = pick.instant(self.away_s), pick.instant(draft.window)
        draft.events.append(LineTrip(time_s=time_s, from_bus=4, to_bus=5, recloses_after_s=away_s))


def test_a_suite_of_ones_own_records_is_played_without_a_file():
    drawn = ScenarioDistribution(name="mine", records=(LoadEvents(number=(2, 2)), Wind(), Blinks()))
    suite = dataclasses.replace(STANDARD_V1, name="mine", drawn_from={"": (drawn,)})
    other = dataclasses.replace(suite, drawn_from={"": (drawn.changed({Blinks: {"away_s": (1.0, 3.0)}}),)})
    assert other.hash != suite.hash and drawn.to_dict()["records"]["Blinks"] == {"away_s": (1.0, 2.0)}
    env = started(gym.make("wtg_gym:GFMWTG-14bus-v1", suite=suite), seed=1)
    assert env.unwrapped.settings.resolved_suite is suite and env.unwrapped.settings.suite_name == "mine"
    for scenario in suite.scenarios(range(10_000, 10_002)):
        assert [type(event) for event in scenario.events[2:]] == [LineTrip]
        # Nothing else is drawn: droop, inertia, load and commitment are those of the grid.
        assert (scenario.governor_droop, scenario.inertia_scale, scenario.load_level) == (None, 1.0, 1.0)
        assert scenario.committed == 1.0 and scenario.load_noise_mw.size == 0
    with pytest.raises(ValueError, match=r"suite must be a name or the path of a file, .*Suite"):
        evaluate([], suite)


GOVERNOR = GovernorParameters(droop_pu=0.05, gate_max_pu=1.0)
ANY = Plant().case.machines[0]
LARGE = dataclasses.replace(ANY, bus=1, rating_mva=100.0, governor=GOVERNOR, dispatch_mw=0.0)
SMALL = dataclasses.replace(ANY, bus=3, rating_mva=50.0, governor=None, dispatch_mw=10.0)
BUSES = (Bus(number=1, voltage_pu=1.0), Bus(number=2, load_mw=60.0), Bus(number=3, load_mw=40.0, voltage_pu=1.0))
LINES = tuple(Branch(from_bus=a, to_bus=b, resistance=0.0, reactance=0.1) for a, b in ((1, 2), (2, 3), (1, 3)))
BASE = {"name": "three", "base_mva": 100.0, "frequency_hz": 50.0, "slack_bus": 1}
CASE = NetworkCase(buses=BUSES, branches=LINES, machines=(LARGE, SMALL), **BASE)
PLANT = Plant(case=CASE, groups=(WtgGroup(bus=2, n_turbines=10.0),))
GOVERNED = dataclasses.replace(SMALL, governor=dataclasses.replace(GOVERNOR, gate_max_pu=1.2), dispatch_mw=0.0)
SHARING = dataclasses.replace(PLANT, case=dataclasses.replace(CASE, machines=(LARGE, GOVERNED)), shares_dispatch=True)


def wind_of(share: float) -> float:
    return float((share / available_power_pu(1.0)) ** (1.0 / 3.0))


WIND = wind_of(0.8)
FALLING = np.array([[WIND] * 400 + [wind_of(0.2)] * 401])
LESS = sc.LoadRamp(time_s=5.0, bus=3, power_mw=-20.0, duration_s=5.0)
MORE = sc.LoadStep(time_s=20.0, bus=3, power_mw=60.0)
OPEN = [sc.LineTrip(time_s=5.0, from_bus=1, to_bus=2), sc.LineTrip(time_s=10.0, from_bus=2, to_bus=3)]
CASES = {
    "nothing": ([], {}, 0.34),
    "load": ([sc.LoadStep(time_s=5.0, bus=3, power_mw=20.0)], {}, 137 / 120 - 1.03),
    "less load": ([LESS, sc.LoadTrip(time_s=9.0, bus=2)], {}, 0.34),
    "load of a tripped bus": ([sc.LoadTrip(time_s=5.0, bus=2), MORE, sc.GroupTrip(time_s=20.0, group=0)], {}, -0.06),
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
    usual = {"wind_speed": np.array([[WIND]]), "duration_s": 80.0}
    scenario = sc.Scenario(name=name, events=tuple(events), **usual | changes)
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
    # A drawn scenario that was changed has another margin than it was drawn with.
    lost = {"kind": "group_trip", "time_s": 1.0, "group": 1}
    drawn = suite.scenario(20_000, duration_s=5.0)
    changed = sc.Scenario.from_dict({**drawn.to_dict(), "events": [lost]})
    assert suite.margin(changed) == ReserveMargin(suite.plant).of(changed) != drawn.reserve_margin
    assert dataclasses.replace(drawn, events=changed.events).reserve_margin is None
    groups = [{"bus": 2, "n_turbines": 20.0}, {"bus": 6, "n_turbines": 18.0}, {"bus": 8, "n_turbines": 16.0}]
    for arguments, n_wtg in (({"groups": groups}, 3), ({"groups": 2, "scenario": calm(duration_s=5.0)}, 2)):
        env = GFMWTGEnv(duration_s=5.0, **arguments)
        _, info = env.reset(seed=3)
        plant = suite.plant.replaced(groups=arguments["groups"])
        own = arguments.get("scenario") or env.batch.scenarios([info["scenario_seed"]])[0]
        assert own.n_wtg == n_wtg and info["reserve_margin"] == ReserveMargin(plant).of(own)
        env.step(np.zeros(2 * n_wtg))


@pytest.mark.parametrize("suite", [STANDARD, STANDARD_V1], ids=["v0", "v1"])
def test_a_suite_and_its_environment_draw_the_same_whatever_its_turbines_are_rated(suite):
    turbine = TurbineParameters(rated_power_mw=2.0 * TurbineParameters().rated_power_mw)
    groups = tuple(
        dataclasses.replace(group, n_turbines=0.5 * group.n_turbines, turbine=turbine) for group in suite.plant.groups
    )
    suite = dataclasses.replace(suite, plant=dataclasses.replace(suite.plant, groups=groups))
    batch = EnvBatch(EnvSettings(suite=suite, reward="cost"))
    assert suite.scenario(20_000).to_json() == batch.scenarios([20_000])[0].to_json()
