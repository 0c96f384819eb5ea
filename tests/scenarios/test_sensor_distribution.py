"""Facts about what the errors of sensors are drawn from."""

import math

import pytest

from wtg_gym.scenarios import SUITES, get_suite
from wtg_gym.scenarios.draws import SensorDistribution

USUAL = SensorDistribution()
SEEDS = range(10_000, 14_000)
SENSED = [name for name, suite in SUITES.items() if suite.sensors is not None]


def test_draws_depend_on_seed_and_name_alone_and_not_on_their_neighbours():
    together = USUAL.draw_many("a", [5, 2**40, 7], 3)
    assert together == [USUAL.draw_many("a", [seed], 3)[0] for seed in (5, 2**40, 7)]
    assert len({own.seed for own in (*together, *USUAL.draw_many("b", [5, 2**40, 7], 3))}) == 6
    # More groups keep the seed, the delay and the bias of those before.
    for few, more in zip(together, USUAL.draw_many("a", [5, 2**40, 7], 5), strict=True):
        assert (few.seed, few.delay_s, few.wind_bias) == (more.seed, more.delay_s, more.wind_bias[:3])


def test_every_delay_of_the_range_is_as_likely():
    for span, expected in (((0.1, 0.3), [0.1, 0.2, 0.3]), ((0.0, 1.0), [round(0.1 * n, 9) for n in range(11)])):
        source = SensorDistribution(delay_s=span)
        assert source.delays_s() == expected
        delays = [own.delay_s for own in source.draw_many("x", SEEDS, 1)]
        assert sorted(set(delays)) == expected
        share = 1.0 / len(expected)
        sure = 4.5 * math.sqrt(share * (1.0 - share) / len(delays))
        assert all(delays.count(delay) / len(delays) == pytest.approx(share, abs=sure) for delay in expected)
    assert {own.delay_s for own in SensorDistribution(delay_s=(0.2, 0.2)).draw_many("x", range(50), 1)} == {0.2}


@pytest.mark.parametrize("suite", SENSED)
def test_sensors_of_a_suite_are_those_of_its_distribution_and_can_be_replaced(suite):
    own = get_suite(suite)
    seed = own.test[0]
    scenario = own.scenario(seed)
    # The suite without a wind sensor shares the scenarios of another.
    name = scenario.name.partition("/")[0] if own.distributions else suite
    assert scenario.sensors == own.sensors.draw_many(name, [seed], scenario.n_wtg)[0]
    assert scenario.sensors.wind_sensor == (suite != "no-wind-sensor-v1")
    slower = own.sensors.replaced({"delay_s": (0.4, 0.6)})
    moved = own.scenarios([seed], sensors=slower)[0]
    assert moved.sensors == slower.draw_many(name, [seed], scenario.n_wtg)[0]
    # Whatever measures, the scenario is the same: more delay by an override is a shift of the same draw.
    assert moved.sensors.delay_s == pytest.approx(scenario.sensors.delay_s + 0.3)
    exact = own.scenarios([seed], sensors=None)[0]
    assert exact.sensors is None and "sensors" not in exact.to_dict()
    for other in (moved, exact):
        assert {**other.to_dict(), "sensors": 0} == {**scenario.to_dict(), "sensors": 0}
