"""Facts about drawn scenarios: what happens in them, the errors of sensors, the wind a group feels."""

import math
from collections import Counter
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from wtg_gym.physics import scenario as sc
from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.grid import DEFAULT_GRID, get_grid
from wtg_gym.scenarios import SUITES, ScenarioDistribution, draws, get_suite, wind

DRAWN = [suite for suite in SUITES.values() if suite.distributions]
#: With a share of the load few groups fit; those are in SHARED, with their suite's turbines. A suite without a wind
#: sensor has the distributions of another.
BY_NAME = {source.name: (suite, source) for suite in DRAWN for source in suite.distributions}
DISTRIBUTIONS = [source.changed({draws.Wind: {"penetration": None}}) for _, source in BY_NAME.values()]
WITH_SHARE = [own for own in BY_NAME.values() if own[1].wind.penetration is not None]
SHARED = [([group.n_turbines for group in suite.plant.groups], source) for suite, source in WITH_SHARE]
#: Twenty load events need more than one block of random numbers.
BUSY = ScenarioDistribution(name="busy").changed({draws.LoadEvents: {"number": (20, 20), "size_mw": (0.0, 1.0)}})
#: Loads of the IEEE 14-bus system at load level 1 [MW].
BUS_LOAD_MW = {
    2: 21.7, 3: 94.2, 4: 47.8, 5: 7.6, 6: 11.2, 9: 29.5, 10: 9.0, 11: 3.5, 12: 6.1, 13: 13.5, 14: 14.9,
}  # fmt: skip

STILL = {"turbulence_intensity": (0.0, 0.0), "gust_probability": 0.0, "ramp_probability": 0.0}
USUAL = draws.SensorDistribution()
SEEDS = range(10_000, 14_000)
SENSED = [name for name, suite in SUITES.items() if suite.sensors is not None]


def loads_mw(source: ScenarioDistribution) -> dict[int, float]:
    grid = BY_NAME[source.name][0].grid if source.name in BY_NAME else DEFAULT_GRID
    return BUS_LOAD_MW if grid == DEFAULT_GRID else {bus.number: bus.load_mw for bus in get_grid(grid).case.buses}


def check(scenario: sc.Scenario, source: ScenarioDistribution, duration_s: float) -> None:
    n_samples = math.ceil(duration_s / 0.1 - 1e-6) + 1
    assert scenario.wind_speed.shape == (scenario.n_wtg, n_samples)
    assert scenario.load_noise_mw.shape == (n_samples,)
    assert scenario.load_noise_mw[0] == 0.0
    low, high = wind.DRAWN_WIND_RANGE
    assert low <= scenario.wind_speed.min() and scenario.wind_speed.max() <= high
    kinds = (draws.OperatingPoint, draws.LoadEvents, draws.LineTrips, draws.Islandings)
    point, loads, lines, islandings = map(source.find, kinds)
    islanded = islandings is not None and islandings.line_sets
    for key in ("governor_droop", "inertia_scale", "load_level"):
        first, last = getattr(point, key)
        assert first <= getattr(scenario, key) <= last
    trips = [event for event in scenario.events if isinstance(event, sc.LineTrip)]
    kinds = sc.GovernorLoss | sc.GroupTrip | sc.MachineOutage | sc.Fault
    load_events = [event for event in scenario.events if not isinstance(event, sc.LineTrip | kinds)]
    counts = Counter(type(event) for event in scenario.events)
    assert loads.number[0] <= len(load_events) <= loads.number[1]
    assert max(counts[kind] for kind in (sc.MachineOutage, sc.Fault, sc.LoadTrip)) <= 1
    assert counts[sc.GovernorLoss] + counts[sc.GroupTrip] <= 1
    if islanded:
        assert tuple((trip.from_bus, trip.to_bus) for trip in trips) in islanded
        assert len({trip.time_s for trip in trips}) == 1
    else:
        assert len(trips) <= 1
    bus_load_mw = loads_mw(source)
    load = {bus: scenario.load_level * power for bus, power in bus_load_mw.items()}
    for event in scenario.events:
        if isinstance(event, sc.GovernorLoss) and event.time_s == 0.0:
            continue
        first, last = min(3.0, 0.5 * duration_s), max(duration_s - source.quiet_end_s, 0.5 * duration_s)
        assert first - 0.05 <= event.time_s <= last + 0.05
        if source.last_event_s is not None:
            assert event.time_s <= source.last_event_s + 0.05
        assert event.time_s == round(event.time_s, 1)
        if isinstance(event, sc.Fault):
            other = sum(event.opens) - event.bus
            assert (event.bus, other) in source.find(draws.Faults).lines
            low, high = source.find(draws.Faults).clearing_s
            assert low <= event.clears_after_s <= high and event.clears_after_s == round(event.clears_after_s, 1)
            assert event.opens not in [(trip.from_bus, trip.to_bus) for trip in trips]
        elif isinstance(event, sc.LineTrip):
            if islanded:
                continue
            assert (event.from_bus, event.to_bus) in lines.lines
            after_s = event.recloses_after_s
            assert (after_s is None) == (lines.reclosing_s is None)
            if after_s is not None:
                assert lines.reclosing_s[0] <= after_s <= lines.reclosing_s[1]
        elif isinstance(event, sc.MachineOutage):
            assert event.bus in source.find(draws.MachineOutages).buses
        elif isinstance(event, sc.GroupTrip):
            assert event.group < scenario.n_wtg
        elif isinstance(event, sc.GovernorLoss):
            assert event.bus in source.find(draws.GovernorLosses).buses
        elif isinstance(event, sc.LoadTrip):
            assert event.bus in loads.trip_buses
            load[event.bus] -= scenario.load_level * bus_load_mw[event.bus]
        else:
            increase_mw, decrease_mw = {bus: limits for bus, *limits in loads.buses}[event.bus]
            largest_mw = increase_mw if event.power_mw > 0.0 else decrease_mw
            assert min(loads.size_mw[0], largest_mw) <= abs(event.power_mw) + 0.01
            assert abs(event.power_mw) <= min(loads.size_mw[1], largest_mw) + 0.01
            load[event.bus] += min(event.power_mw, 0.0)
    # Buses that feed in are negative loads from the start.
    assert min(power for bus, power in load.items() if bus_load_mw[bus] >= 0.0) > -1e-9
    changes = [event.power_mw for event in load_events if isinstance(event, sc.LoadStep)]
    # One disconnection counts too, so a limit met with it may be missed without it.
    largest_mw = max((bus_load_mw[bus] for bus in loads.trip_buses), default=0.0)
    assert abs(sum(changes)) <= loads.net_change_mw + 1.1 * largest_mw


@pytest.mark.parametrize("suite", DRAWN, ids=lambda suite: suite.name)
def test_drawn_scenarios_are_what_the_checking_constructors_make_of_their_values(suite):
    for scenario in suite.scenarios(list(suite.validation)[:100]):
        records = [scenario, *scenario.events, *([] if scenario.sensors is None else [scenario.sensors])]
        for record in records:
            checked = replace(record)
            assert vars(record).keys() == {field.name for field in fields(record)}
            # Only drawing knows the reserve margin.
            assert vars(record).keys() - vars(checked).keys() <= {"reserve_margin"}
            for name, value in vars(checked).items():
                drawn = getattr(record, name)
                assert type(drawn) is type(value) and np.array_equal(drawn, value)
        assert not (scenario.wind_speed.flags.writeable or scenario.load_noise_mw.flags.writeable)


@pytest.mark.parametrize(("turbines", "source"), SHARED, ids=lambda given: getattr(given, "name", ""))
def test_scenarios_of_the_suites_own_groups_keep_every_promise_and_their_share_of_the_load(turbines, source):
    seeds = range(200)
    for scenario in source.draw_many(seeds, len(turbines), turbines, 120.0):
        check(scenario, source, 120.0)
        # Of groups of one size, one stays.
        largest = max(range(len(turbines)), key=lambda group: (turbines[group], group))
        assert all(event.group != largest for event in scenario.events if isinstance(event, sc.GroupTrip))
    # Without turbulence, gusts and ramps the wind is its mean; the numbers of the stream are the same.
    still = source.changed({draws.Wind: STILL})
    low, high = source.wind.penetration
    shares = []
    for scenario in still.draw_many(seeds, len(turbines), turbines):
        assert np.ptp(scenario.wind_speed, axis=1).max() < 1e-9
        # Turbines of 5 MW; the law holds 5 % of what is available, or of the rated power, in reserve.
        given_mw = 4.75 * np.dot(turbines, np.minimum(available_power_pu(scenario.wind_speed[:, 0]), 1.0))
        shares.append(given_mw / (scenario.load_level * sum(loads_mw(source).values())))
    assert low <= min(shares) and max(shares) <= high
    assert np.std(shares) > 0.2 * (high - low), "the range is used"


def test_outages_are_as_likely_as_the_settings_say():
    records = (
        draws.LineTrips(probability=0.5, reclosing_s=(1.0, 5.0)),
        draws.Wind(),
        draws.GovernorLosses(probability=0.2, buses=(1,)),
        draws.GroupTrips(probability=0.3),
        draws.MachineOutages(probability=0.4, buses=(3, 6, 8)),
    )
    source = ScenarioDistribution(name="faults", records=records)
    n = 3000
    events = [event for scenario in source.draw_many(range(n), 3, [3.0, 1.0, 2.0]) for event in scenario.events]
    lost = [event for event in events if isinstance(event, sc.GovernorLoss)]
    assert len(lost) / n == pytest.approx(0.2, abs=4.0 * math.sqrt(0.16 / n))
    assert sum(event.time_s == 0.0 for event in lost) / len(lost) == pytest.approx(0.5, abs=2.0 / math.sqrt(len(lost)))
    trips = [event for event in events if isinstance(event, sc.GroupTrip)]
    assert len(trips) / n == pytest.approx(0.3, abs=4.0 * math.sqrt(0.21 / n)) and {t.group for t in trips} == {1, 2}
    machines = [event.bus for event in events if isinstance(event, sc.MachineOutage)]
    assert len(machines) / n == pytest.approx(0.4, abs=4.0 * math.sqrt(0.24 / n))
    assert {bus: round(3.0 * machines.count(bus) / len(machines)) for bus in set(machines)} == {3: 1, 6: 1, 8: 1}
    lines = [event.recloses_after_s for event in events if isinstance(event, sc.LineTrip)]
    assert len(lines) / n == pytest.approx(0.5, abs=4.0 * 0.5 / math.sqrt(n))
    assert np.mean(lines) == pytest.approx(3.0, abs=0.15) and min(lines) >= 1.0 and max(lines) <= 5.0


@pytest.mark.parametrize(("own", "source"), SHARED, ids=lambda given: getattr(given, "name", ""))
def test_turbines_that_pass_the_check_of_the_share_can_be_drawn_for(own, source):
    checked = 0
    for factor in np.geomspace(0.4, 2.5, 15):
        turbines = [factor * n for n in own]
        try:
            source.check_turbines(turbines)
        except ValueError:
            continue
        checked += 1
        source.draw_many(range(100), len(turbines), turbines, 1.0)
    assert 1 <= checked <= 14


TURBINES = st.lists(st.floats(0.2, 40.0), min_size=1, max_size=5)


@settings(max_examples=60)
@given(st.sampled_from([*DISTRIBUTIONS, BUSY]), st.integers(0, 2**63 - 1), TURBINES, st.floats(1.0, 300.0))
def test_any_seed_group_count_and_duration_gives_a_valid_scenario(source, seed, n_turbines, duration_s):
    scenario = source.draw(seed, len(n_turbines), n_turbines, duration_s)
    check(scenario, source, duration_s)
    assert scenario.name == f"{source.name}/{seed}"
    assert sc.Scenario.from_json(scenario.to_json()).to_json() == scenario.to_json()


@pytest.mark.parametrize("source", DISTRIBUTIONS, ids=lambda source: source.name)
def test_scenarios_drawn_together_equal_scenarios_drawn_alone_bit_for_bit(source):
    seeds = [0, 2**63 - 1, *range(20_000, 20_040)]
    for seed, scenario in zip(seeds, source.draw_many(seeds, 3, [1.0, 5.0, 60.0], 47.3), strict=True):
        assert source.draw(seed, 3, [1.0, 5.0, 60.0], 47.3).to_json() == scenario.to_json()


def test_draws_depend_on_seed_and_name_alone_and_not_on_their_neighbours():
    together = USUAL.draw_many("a", [5, 2**40, 7], 3)
    assert together == [USUAL.draw_many("a", [seed], 3)[0] for seed in (5, 2**40, 7)]
    assert len({own.seed for own in (*together, *USUAL.draw_many("b", [5, 2**40, 7], 3))}) == 6
    # More groups keep the seed, the delay and the bias of those before.
    for few, more in zip(together, USUAL.draw_many("a", [5, 2**40, 7], 5), strict=True):
        assert (few.seed, few.delay_s, few.wind_bias) == (more.seed, more.delay_s, more.wind_bias[:3])


def test_every_delay_of_the_range_is_as_likely():
    for span, expected in (((0.1, 0.3), [0.1, 0.2, 0.3]), ((0.0, 1.0), [round(0.1 * n, 9) for n in range(11)])):
        source = draws.SensorDistribution(delay_s=span)
        assert source.delays_s() == expected
        delays = [own.delay_s for own in source.draw_many("x", SEEDS, 1)]
        assert sorted(set(delays)) == expected
        share = 1.0 / len(expected)
        sure = 4.5 * math.sqrt(share * (1.0 - share) / len(delays))
        assert all(delays.count(delay) / len(delays) == pytest.approx(share, abs=sure) for delay in expected)
    assert {own.delay_s for own in draws.SensorDistribution(delay_s=(0.2, 0.2)).draw_many("x", range(50), 1)} == {0.2}


@pytest.mark.parametrize("suite", SENSED)
def test_sensors_of_a_suite_are_those_of_its_distribution_and_can_be_replaced(suite):
    own = get_suite(suite)
    seed = own.test[0]
    scenario = own.scenario(seed)
    # The suite without a wind sensor shares the scenarios of another.
    name = scenario.name.partition("/")[0] if own.distributions else suite
    assert scenario.sensors == own.sensors.draw_many(name, [seed], scenario.n_wtg)[0]
    assert scenario.sensors.wind_sensor == (suite != "no-wind-sensor-v1")
    slower = replace(own.sensors, delay_s=(0.4, 0.6))
    moved = own.scenarios([seed], sensors=slower)[0]
    assert moved.sensors == slower.draw_many(name, [seed], scenario.n_wtg)[0]
    # Whatever measures, the scenario is the same: more delay by an override is a shift of the same draw.
    assert moved.sensors.delay_s == pytest.approx(scenario.sensors.delay_s + 0.3)
    exact = own.scenarios([seed], sensors=None)[0]
    assert exact.sensors is None and "sensors" not in exact.to_dict()
    assert all({**other.to_dict(), "sensors": 0} == {**scenario.to_dict(), "sensors": 0} for other in (moved, exact))


@pytest.mark.parametrize("mean", [4.0, 20.0])
def test_kaimal_spectrum_integrates_to_the_variance(mean):
    frequency = np.concatenate([[0.0], np.geomspace(1e-7, 1e5, 20_001)])
    spectrum = wind.kaimal_spectrum(frequency, mean, 1.7)
    area = np.sum(0.5 * (spectrum[1:] + spectrum[:-1]) * np.diff(frequency))
    assert area == pytest.approx(1.7**2, rel=1e-3)


def test_gust_dips_peaks_and_leaves_no_trace():
    time_s = np.arange(0.0, 60.0, 0.01)
    change = wind.extreme_operating_gust(time_s, 20.0, 5.0)
    outside = (time_s <= 20.0) | (time_s >= 20.0 + wind.GUST_DURATION_S)
    assert change[outside] == pytest.approx(0.0, abs=1e-12)
    assert time_s[change.argmax()] == pytest.approx(20.0 + 0.5 * wind.GUST_DURATION_S, abs=0.02)
    assert change.max() == pytest.approx(0.74 * 5.0, rel=1e-4)
    assert change.max() - change.min() == pytest.approx(5.0, rel=0.02)


def test_a_group_feels_a_gust_at_one_turbine_divided_by_the_root_of_their_number():
    assert [wind.gust_share(9.0, n) for n in (1.0, 4.0, 16.0)] == pytest.approx([1.0, 0.5, 0.25], rel=1e-3)
    distribution = ScenarioDistribution(name="x", records=(draws.Wind(**{**STILL, "gust_probability": 1.0}),))
    averaged = distribution.changed({draws.Wind: {"gust_averaged": True}})
    at_one, of_group = (np.ptp(drawn.draw(1, 1, [16.0]).wind_speed) for drawn in (distribution, averaged))
    assert 2.0 <= at_one <= 5.1 and of_group == pytest.approx(0.25 * at_one, rel=1e-3)
