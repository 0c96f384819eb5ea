"""The wind at every turbine of a group, whose average is the group's.

Two turbines of a group have the coherence c(f) = exp(-a(f) d) at the group's spacing d, so each wind is a common part
with the spectrum c S and a part of its own with (1 - c) S, where S is the rotor's. The mean over n turbines then has
the spectrum S (c + (1 - c)/n), which is the group filter of :mod:`wtg_gym.scenarios.wind`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.scenario import SERIES_DT, Scenario
from wtg_gym.ranges import is_whole, require_range
from wtg_gym.scenarios.wind import (
    DRAWN_WIND_RANGE,
    TURBINE_SPACING_M,
    coherence_decay,
    kaimal_spectrum,
    period_length,
    resolved_frequencies,
    rotor_filter,
    spectrum_amplitude,
)

Floats = npt.NDArray[np.float64]


def turbine_winds(
    mean_wind_m_s: float, sigma_m_s: float, n_turbines: int, n_samples: int, rng: np.random.Generator
) -> Floats:
    """Return rotor-effective winds of the turbines of one group, (n_turbines, n_samples) [m/s], `SERIES_DT` apart.

    Args:
        mean_wind_m_s: mean wind speed U, of all of them [m/s].
        sigma_m_s: standard deviation of the wind at a point [m/s].
        n_turbines: 1 … 1000.
        n_samples: length of the series.
        rng: what they are drawn from.

    Raises:
        ValueError: mean wind, sigma, number of turbines or number of samples is outside its range.
    """
    require_range("mean wind", mean_wind_m_s, *DRAWN_WIND_RANGE, "m/s")
    require_range("sigma", sigma_m_s, 0.0, 20.0, "m/s")
    if not is_whole(n_samples) or not 2 <= n_samples <= 10_000_000:
        raise ValueError(f"the number of samples must be 2 … 10000000, got {n_samples!r}")
    if not is_whole(n_turbines) or not 1 <= n_turbines <= 1000:
        raise ValueError(f"the number of turbines must be 1 … 1000, got {n_turbines!r}")
    n_period = period_length(n_samples)
    frequency = resolved_frequencies(n_period)
    rotor = kaimal_spectrum(frequency, mean_wind_m_s, sigma_m_s) * rotor_filter(frequency, mean_wind_m_s)
    coherence = np.exp(-TURBINE_SPACING_M * coherence_decay(frequency, mean_wind_m_s))
    series = []
    for spectrum, n in ((coherence * rotor, 1), ((1.0 - coherence) * rotor, n_turbines)):
        amplitude = spectrum_amplitude(spectrum, n_period)
        amplitude[[0, -1]] = 0.0
        normal = rng.standard_normal((n, amplitude.size, 2))
        series.append(np.fft.irfft(amplitude * (normal[..., 0] + 1j * normal[..., 1]), n_period)[:, :n_samples])
    return np.clip(mean_wind_m_s + series[0] + series[1], *DRAWN_WIND_RANGE)


def with_wakes(winds: Floats, deficits: Sequence[float]) -> Floats:
    """Return winds behind other turbines: each slowed by its share 0 … 0.6 of the free wind.

    The deficits may come from a wake model such as PyWake, which is not needed here: with a wind farm model `farm` of
    PyWake, ``1.0 - farm(x, y, wd=[270], ws=[9.0]).WS_eff.values.ravel() / 9.0``.

    Args:
        winds: (n_turbines, n_samples) [m/s].
        deficits: 1 - v/v_free of each turbine (n_turbines,) [-].

    Raises:
        ValueError: their number differs from that of the turbines, or one is outside its range.
    """
    winds = np.asarray(winds, dtype=np.float64)
    if winds.ndim != 2 or not np.isfinite(winds).all():
        raise ValueError(f"winds must be finite numbers of shape (n_turbines, n_samples), got shape {winds.shape}")
    if len(deficits) != winds.shape[0]:
        raise ValueError(f"there must be one wake deficit per turbine, {winds.shape[0]}, got {len(deficits)}")
    factors = [1.0 - require_range("wake deficit", deficit, 0.0, 0.6, "") for deficit in deficits]
    slowed: Floats = np.clip(winds * np.array(factors)[:, None], *DRAWN_WIND_RANGE)
    return slowed


def single_and_aggregate(scenario: Scenario, winds: Sequence[Floats]) -> tuple[Scenario, Scenario]:
    """Return a scenario with the wind of every turbine, and the same with the mean wind of every group.

    Args:
        scenario: what else happens.
        winds: per group (n_turbines, n_samples) [m/s], `SERIES_DT` apart.
    """
    single = np.concatenate([np.asarray(wind) for wind in winds])
    aggregate = np.stack([np.asarray(wind).mean(axis=0) for wind in winds])
    return tuple(  # type: ignore[return-value]
        dataclasses.replace(scenario, wind_speed=wind, wind_dt_s=SERIES_DT) for wind in (single, aggregate)
    )
