"""Facts about the wind a WTG group feels."""

import numpy as np
import pytest

from wtg_gym.scenarios import draws, wind
from wtg_gym.scenarios.distribution import ScenarioDistribution


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
    changes = {"turbulence_intensity": (0.0, 0.0), "gust_probability": 1.0, "ramp_probability": 0.0}
    distribution = ScenarioDistribution(name="x", records=(draws.Wind(**changes),))
    averaged = distribution.changed({draws.Wind: {"gust_averaged": True}})
    at_one, of_group = (np.ptp(drawn.draw(1, 1, [16.0]).wind_speed) for drawn in (distribution, averaged))
    assert 2.0 <= at_one <= 5.1 and of_group == pytest.approx(0.25 * at_one, rel=1e-3)
