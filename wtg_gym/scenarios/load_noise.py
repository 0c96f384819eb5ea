"""The load noise: an Ornstein-Uhlenbeck process that starts at zero, made from a stationary one."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from wtg_gym.physics.scenario import SERIES_DT
from wtg_gym.scenarios.wind import FloatArray, resolved_frequencies, spectrum_amplitude


@lru_cache(maxsize=64)
def noise_amplitude(correlation_s: float, n_period: int) -> FloatArray:
    """Return the scale of each Fourier coefficient of a stationary Ornstein-Uhlenbeck series of variance 1.

    Its samples are a first-order autoregression with phi = exp(-dt/T), whose spectrum is
    2 dt (1 - phi²)/(1 - 2 phi cos(2π f dt) + phi²).
    """
    phi = math.exp(-SERIES_DT / correlation_s)
    angle = 2.0 * math.pi * SERIES_DT * resolved_frequencies(n_period)
    spectrum = 2.0 * SERIES_DT * (1.0 - phi**2) / (1.0 - 2.0 * phi * np.cos(angle) + phi**2)
    amplitude = spectrum_amplitude(spectrum, n_period)
    amplitude.setflags(write=False)
    return amplitude


@lru_cache(maxsize=64)
def noise_decay(correlation_s: float, n_samples: int) -> FloatArray:
    """Return exp(-t/T) at every sample t.

    A stationary series minus exp(-t/T) times its first value is the process that starts at zero.
    """
    decay: FloatArray = np.exp(-SERIES_DT / correlation_s * np.arange(n_samples))
    decay.setflags(write=False)
    return decay
