"""Wind as a WTG group feels it: turbulence averaged over rotor and group, gusts and ramps, or measured wind.

With it the noise of the load.

The averages over the rotor's disk and over the turbines of a group follow from one coherence function, that of
IEC 61400-1 ed. 3, annex B; both are filters |H(f)|² on the Kaimal spectrum.

Everywhere here frequencies and instants are of any shape [Hz, s], and the mean wind is the mean wind speed U [m/s].
"""

import math
import os
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.fft import next_fast_len

from wtg_gym.files import interpreting, read_bytes
from wtg_gym.physics import aerodynamics, scenario
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import MOST_GROUPS, GridFormingParameters, TurbineParameters
from wtg_gym.ranges import require_count, require_range

#: Longitudinal turbulence scale Λ1 for hub heights of 60 m and more [m] (IEC 61400-1 ed. 3, eq. 5).
TURBULENCE_SCALE_M = 42.0
#: Integral length scale of the Kaimal spectrum, and coherence scale L_c, both 8.1 Λ1 [m] (annex B).
LENGTH_SCALE_M = 8.1 * TURBULENCE_SCALE_M
#: Rotor radius [m].
ROTOR_RADIUS_M = TurbineParameters().blade_radius_m
#: Distance between the turbines of a group: seven rotor diameters [m].
TURBINE_SPACING_M = 14.0 * ROTOR_RADIUS_M
#: Power of a turbine at nominal reserve [MW], and its available power at 1 m/s [p.u.].
_TURBINE_MW = TurbineParameters().rated_power_mw * (1.0 - GridFormingParameters().deloading_nominal)
_PER_CUBIC_WIND = float(aerodynamics.available_power_pu(1.0))
#: Length of the extreme operating gust [s] (IEC 61400-1 ed. 3, section 6.3.2.2).
GUST_DURATION_S = 10.5
#: Drawn wind is clipped into this range, inside cut-in and cut-out [m/s].
DRAWN_WIND_RANGE = (4.0, 20.0)


def ntm_sigma(mean_wind_m_s: float, turbulence_intensity: float) -> float:
    """Return the standard deviation of the normal turbulence model at hub height [m/s].

    The intensity is the reference one I_ref at 15 m/s [-]: 0.16, 0.14 and 0.12 in the classes A, B and C. Source:
    IEC 61400-1 ed. 3, table 1 and eq. 11, sigma = I_ref (0.75 U + 5.6 m/s).
    """
    return turbulence_intensity * (0.75 * mean_wind_m_s + 5.6)


def kaimal_spectrum(frequency_hz: Floats, mean_wind_m_s: float, sigma_m_s: float) -> Floats:
    """Return the one-sided Kaimal spectrum of the longitudinal wind at a point [(m/s)²/Hz].

    It integrates to the square of the standard deviation [m/s]. Source: IEC 61400-1 ed. 3, annex B, eq. B.14.
    """
    time_scale_s = LENGTH_SCALE_M / mean_wind_m_s
    return sigma_m_s**2 * 4.0 * time_scale_s / (1.0 + 6.0 * frequency_hz * time_scale_s) ** (5.0 / 3.0)


def coherence_decay(frequency_hz: Floats, mean_wind_m_s: float) -> Floats:
    """Return a = 12 sqrt((f/U)² + (0.12/L_c)²) of the coherence exp(-a r) over the distance r [1/m].

    Source: IEC 61400-1 ed. 3, annex B, eq. B.16.
    """
    return 12.0 * np.hypot(frequency_hz / mean_wind_m_s, 0.12 / LENGTH_SCALE_M)


@lru_cache(maxsize=1)
def _disk_table() -> tuple[Floats, Floats]:
    """Logarithms of a R and of the mean of exp(-a r) over the pairs of points of a disk."""
    node, weight = np.polynomial.legendre.leggauss(200)
    root = 0.5 * (node + 1.0)
    # s = 2 u² crowds the nodes at short distances, where all the weight is when a R is large.
    distance = 2.0 * root**2
    # The density of the distance s in 0 … 2 between two random points of a disk of radius 1 is disk line picking's
    # p(s) = (4s/π) arccos(s/2) - (2s²/π) sqrt(1 - s²/4).
    half = distance / 2.0
    density = (4.0 * distance * np.arccos(half) - 2.0 * distance**2 * np.sqrt(1.0 - half**2)) / math.pi
    weight = weight * 2.0 * root * density
    decay = np.geomspace(1e-4, 1e4, 1601)
    return np.log(decay), np.log(np.exp(-decay[:, None] * distance) @ weight)


def rotor_filter(frequency_hz: Floats, mean_wind_m_s: float) -> Floats:
    """Return |H(f)|², the share of the point spectrum that is left in the mean over the rotor disk [-].

    It is the mean of exp(-a r) over all pairs of points of the disk, constant beyond a R of 1e-4 … 1e4.
    """
    decay_radii = ROTOR_RADIUS_M * coherence_decay(frequency_hz, mean_wind_m_s)
    return np.exp(np.interp(np.log(decay_radii), *_disk_table()))


def group_filter(frequency_hz: Floats, mean_wind_m_s: float, n_turbines: float) -> Floats:
    """Return |G(f)|² = 1/n + (1 - 1/n) coh(f, d), left by averaging over n turbines [-]; n below 1 counts as 1."""
    alone = min(1.0, 1.0 / n_turbines)
    return alone + (1.0 - alone) * np.exp(-TURBINE_SPACING_M * coherence_decay(frequency_hz, mean_wind_m_s))


def period_length(n_samples: int) -> int:
    """Return the number of samples of the period that a synthesised series is cut from, of a quick transform."""
    # Twice the series at least: one as long as its period would end where it began.
    length: int = 2 * next_fast_len(n_samples, real=True)
    return length


def resolved_frequencies(n_period: int) -> Floats:
    """Return the frequencies of the harmonics of a period of `n_period` samples, zero included [Hz]."""
    return np.arange(n_period // 2 + 1) / (n_period * scenario.SERIES_DT)


def spectrum_amplitude(spectrum: Floats, n_period: int) -> Floats:
    """Return the scale of the Fourier coefficients of a series with a one-sided spectrum, (n_frequencies,) [unit²/Hz].

    Coefficients of standard normal real and imaginary parts, times this, are those of a Gaussian series. The spectrum
    is that at :func:`resolved_frequencies`, for an even number of samples.
    """
    amplitude = 0.5 * n_period * np.sqrt(spectrum / (n_period * scenario.SERIES_DT))
    # Mean and Nyquist harmonic have a real coefficient only.
    amplitude[[0, -1]] *= math.sqrt(2.0)
    return amplitude


@lru_cache(maxsize=4096)
def turbulence_amplitude(mean_tenth_m_s: int, n_turbines: float, n_period: int) -> Floats:
    """Return the scale of the coefficients of rotor-effective, group-averaged turbulence, of 1 m/s at a point.

    The mean wind is a whole number of tenths [0.1 m/s], so that the spectrum is worked out for few of them.
    """
    mean = 0.1 * mean_tenth_m_s
    frequency = resolved_frequencies(n_period)
    spectrum = kaimal_spectrum(frequency, mean, 1.0)
    spectrum = spectrum * rotor_filter(frequency, mean) * group_filter(frequency, mean, n_turbines)
    amplitude = spectrum_amplitude(spectrum, n_period)
    amplitude[[0, -1]] = 0.0
    amplitude.setflags(write=False)
    return amplitude


def extreme_operating_gust(time_s: Floats, start_s: float, size_m_s: float) -> Floats:
    """Return the change of wind in an extreme operating gust: a dip, a peak and a dip in 10.5 s [m/s].

    The size is V_gust, about the rise from the dip to the peak. Source: IEC 61400-1 ed. 3, eq. 18.
    """
    phase = np.clip((time_s - start_s) / GUST_DURATION_S, 0.0, 1.0) * math.pi
    return -0.37 * size_m_s * np.sin(3.0 * phase) * (1.0 - np.cos(2.0 * phase))


def gust_share(mean_wind_m_s: float, n_turbines: float) -> float:
    """Return the size of an extreme gust in the mean over a group's turbines, as a share of that at one of them [-].

    The extremes of the mean are to those at one turbine as the spectrum's roots at the gust's frequency: |G(1/T)|, here
    close to 1/√n, since turbines `TURBINE_SPACING_M` apart do not see one gust together.
    """
    return math.sqrt(float(group_filter(np.array(1.0 / GUST_DURATION_S), mean_wind_m_s, n_turbines)))


def share_of_load(mean_winds: Sequence[float], turbines: Sequence[float], load_mw: float) -> float:
    """Return the share of a load that turbines at nominal reserve cover; mean wind and turbines of each WTG group."""
    sizes = zip(turbines, mean_winds, strict=True)
    return sum(n * _TURBINE_MW * min(_PER_CUBIC_WIND * wind**3, 1.0) for n, wind in sizes) / load_mw


@lru_cache(maxsize=64)
def noise_amplitude(correlation_s: float, n_period: int) -> Floats:
    """Return the scale of each Fourier coefficient of a stationary Ornstein-Uhlenbeck series of variance 1.

    It is a first-order autoregression with φ = exp(-dt/T), of the spectrum 2 dt (1 - φ²)/(1 - 2 φ cos(2π f dt) + φ²).
    """
    phi = math.exp(-scenario.SERIES_DT / correlation_s)
    angle = 2.0 * math.pi * scenario.SERIES_DT * resolved_frequencies(n_period)
    spectrum = 2.0 * scenario.SERIES_DT * (1.0 - phi**2) / (1.0 - 2.0 * phi * np.cos(angle) + phi**2)
    amplitude = spectrum_amplitude(spectrum, n_period)
    amplitude.setflags(write=False)
    return amplitude


@lru_cache(maxsize=64)
def noise_decay(correlation_s: float, n_samples: int) -> Floats:
    """Return exp(-t/T) at every sample: a stationary series minus this times its first value starts at zero."""
    decay: Floats = np.exp(-scenario.SERIES_DT / correlation_s * np.arange(n_samples))
    decay.setflags(write=False)
    return decay


#: Time step of a measured series [s].
_STEP_RANGE_S = (1e-3, 3600.0)
#: As many as a day has tenths of a second.
_MOST_ROWS = 864_001
#: Rounded time stamps (0.033, 0.067, 0.100 s) are still uniform; a missing row is a deviation of 100 %.
_STEP_TOLERANCE = 0.05
_FORMAT = "time_s,wind_1_m_s,wind_2_m_s,… (time [s] first, then one column of wind speed [m/s] per WTG group)"


def read_wind_csv(path: str | os.PathLike[str], *, duration_s: float | None = None) -> tuple[Floats, float]:
    """Return wind speeds (n_wtg, n_samples) [m/s] and their time step [s] from a CSV file, ready for a `Scenario`.

    The file is UTF-8, has a header and a uniform time step: `time_s` first, then one column per WTG group of any name
    [m/s]. The series is cut to `duration_s`, None takes all [s]. A ValueError names file, line, value and what is
    allowed.
    """
    raw = read_bytes(Path(path), "wind series")
    with interpreting(Path(path), "wind series"):
        return _parse(raw, duration_s)


def _parse(raw: bytes, duration_s: float | None) -> tuple[Floats, float]:
    try:
        text = raw.decode("utf-8-sig").rstrip()
    except UnicodeDecodeError as error:
        line, bad = raw.count(b"\n", 0, error.start) + 1, raw[error.start]
        raise ValueError(f"line {line}: byte 0x{bad:02x} is not UTF-8; expected text: {_FORMAT}") from error
    require_count("the table", text.count("\n"), _MOST_ROWS)
    first, *lines = text.split("\n")
    require_count("line 1", first.count(",") + 1, MOST_GROUPS + 1)
    header = _cells(first)
    if header[0] != "time_s" or len(header) < 2:
        raise ValueError(f"line 1: the header is {first[:80]!r} or empty; expected: {_FORMAT}")
    if len(lines) < 2:
        raise ValueError(f"{len(lines)} data row(s) after the header, at least 2 are needed")
    values = np.array([_numbers(f"line {number}", header, line) for number, line in enumerate(lines, start=2)])
    dt_s = _uniform_step(values[:, 0])
    wind = np.ascontiguousarray(values[:, 1:].T)
    if duration_s is None:
        return wind, dt_s
    duration_s = require_range("duration_s", duration_s, dt_s, 1e9, "s")
    n_samples = math.ceil(duration_s / dt_s - 1e-6) + 1
    if n_samples > len(lines):
        what = f"line {len(lines) + 1}: the series ends after {(len(lines) - 1) * dt_s:g} s"
        raise ValueError(f"{what}, at least {duration_s:g} s ({n_samples} rows of {dt_s:g} s) are needed")
    return wind[:, :n_samples].copy(), dt_s


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split(",")]


def _numbers(where: str, header: list[str], line: str) -> list[float]:
    cells = _cells(line)
    if len(cells) != len(header):
        raise ValueError(f"{where}: {len(cells)} cells, the header has {len(header)}: {line[:80]!r}")
    low, high = scenario.WIND_SPEED_RANGE
    numbers: list[float] = []
    for name, text in zip(header, cells, strict=True):
        try:
            # Python reads 1_0 as ten; in a table it is a typing error.
            number = float("not a number" if "_" in text else text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or (numbers and not low <= number <= high):
            allowed = f"wind speeds of {low:g} … {high:g} m/s" if numbers else "finite times in s"
            shown = f"{text[:40]!r}" if text else "an empty cell"
            raise ValueError(f"{where}, column {name!r}: {shown} is none of the allowed {allowed}")
        numbers.append(number)
    return numbers


def _uniform_step(time_s: Floats) -> float:
    """Return the mean time step, or raise a ValueError that names the first line where the step is another one."""
    # Times such as 1e308 give steps that are not finite, which are refused below.
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.diff(time_s)
        usual = float(np.median(steps))
        wrong = np.flatnonzero(~(np.abs(steps - usual) <= _STEP_TOLERANCE * abs(usual)))
    low, high = _STEP_RANGE_S
    if not low <= usual <= high or wrong.size:
        row = int(wrong[0]) + 1 if wrong.size else 1
        reason = "time does not increase" if steps[row - 1] <= 0.0 else "gap or change of step in time"
        raise ValueError(
            f"line {row + 2}: {reason}: time_s goes from {time_s[row - 1]:g} to {time_s[row]:g} s; "
            f"the step must be uniform ({usual:g} s in most rows) and within {low:g} … {high:g} s"
        )
    return float((time_s[-1] - time_s[0]) / (len(time_s) - 1))
