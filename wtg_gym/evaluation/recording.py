"""The courses of episodes, sample by sample: the grid, the rotors, and the k and τ in use."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.aerodynamics import surface_of
from wtg_gym.physics.converter import converter_constants, tracking_coefficient
from wtg_gym.physics.parameters import GridFormingParameters, PitchParameters, ProtectionParameters, TurbineParameters
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import coordinated_piecewise
from wtg_gym.physics.wind_turbine import turbine_constants, turbine_equilibrium
from wtg_gym.policies import Entry
from wtg_gym.policies.play import play, started_lanes

Floats = npt.NDArray[np.float64]

#: Winds below which no pitch protection acts on a rotor at rest, and above which it always does [m/s].
_LIGHT_WIND_M_S, _STRONG_WIND_M_S = 8.0, 20.0
_N_FREQUENCIES = 65


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Episodes of one entry, a sample at the start and one per control step; not a number after an early end.

    Args:
        time_s: (n,) [s].
        frequency_hz: of the centre of inertia (n_scenarios, n) [Hz].
        deviation_hz: of each group's own frequency from the nominal one (n_scenarios, n, n_wtg) [Hz].
        rocof_hz_s: of each group's own frequency over the last control interval (n_scenarios, n, n_wtg) [Hz/s].
        rotor_speed_pu: (n_scenarios, n, n_wtg) [p.u.].
        tip_speed_ratio: (n_scenarios, n, n_wtg) [-].
        target_ratio: where the reference would have its equilibrium at that frequency and wind, likewise [-].
        wind_m_s: (n_scenarios, n, n_wtg) [m/s].
        power_pu: delivered, on each group's base (n_scenarios, n, n_wtg) [p.u.].
        filter_hz: state x of the transient damping (n_scenarios, n, n_wtg) [Hz].
        coefficient_pu: tracking coefficient k in use (n_scenarios, n, n_wtg) [p.u.].
        offset_pu: what the policy adds to the law's k (n_scenarios, n, n_wtg) [p.u.].
        time_constant_s: τ in use; not a number for a law without (n_scenarios, n, n_wtg) [s].
        observations: what the policy saw then (n_scenarios, n, n_observation).
        observation_names: names of its entries, with units.
        cost_terms: sums over the episode, in the order of `COST_TERMS` (n_scenarios, n_terms).
    """

    time_s: Floats
    frequency_hz: Floats
    deviation_hz: Floats
    rocof_hz_s: Floats
    rotor_speed_pu: Floats
    tip_speed_ratio: Floats
    target_ratio: Floats
    wind_m_s: Floats
    power_pu: Floats
    filter_hz: Floats
    coefficient_pu: Floats
    offset_pu: Floats
    time_constant_s: Floats
    observations: Floats
    observation_names: tuple[str, ...]
    cost_terms: Floats

    @property
    def n_wtg(self) -> int:
        """Number of WTG groups."""
        return int(self.wind_m_s.shape[2])

    @property
    def ratio_above_target(self) -> Floats:
        """Return the tip-speed ratio minus its target (n_scenarios, n, n_wtg) [-]."""
        return self.tip_speed_ratio - self.target_ratio


def record(
    entry: Entry, settings: EnvSettings, scenarios: Sequence[Scenario], n_threads: int | None = None
) -> Recording:
    """Play an entry through scenarios side by side and record it.

    Args:
        entry: whose law, policy and modes are played.
        settings: all else, such as the cost's weights; their longest episode is that of the longest scenario.
        scenarios: at least one.
        n_threads: threads to step with; None for one per processor.

    Raises:
        ValueError: a scenario has no equilibrium under the entry's law, or its policy returns no action.
    """
    with started_lanes(entry, settings, scenarios, n_threads) as (lanes, _):
        return recorded(lanes, play(entry, lanes))


def recorded(lanes: TaskLanes, steps: Iterable[npt.NDArray[np.bool_]]) -> Recording:
    """Record started episodes while they are played.

    Args:
        lanes: the episodes.
        steps: plays them; after every step it yields which lanes made it, (n_lanes,).
    """
    samples = [_sample(lanes)]
    for stepped in steps:
        samples.append(_sample(lanes))
        for values in samples[-1].values():
            values[~stepped] = np.nan
    costs = lanes.cost_sums()
    n = 1 + int(lanes.task_values("end_step").max()) // lanes.simulator.plant.n_substeps
    samples += [{key: np.full_like(values, np.nan) for key, values in samples[0].items()}] * (n - len(samples))
    table = {key: np.stack([sample[key] for sample in samples], axis=1) for key in samples[0]}
    names = tuple(lanes.observation_names)
    rocof = [names.index(f"wtg{j}.rocof [Hz/s]") for j in range(lanes.n_wtg)]
    nominal_hz = lanes.nominal_hz
    tip_speed = TurbineParameters().tip_speed_ratio_per_speed_m_s
    wind, rate = table["wind"], table["inverse_time_constant"]
    return Recording(
        time_s=np.arange(n, dtype=np.float64) * lanes.settings.control_dt,
        frequency_hz=nominal_hz * table["frequency"],
        deviation_hz=nominal_hz * (table["speed"] - 1.0),
        rocof_hz_s=table["observation"][:, :, rocof],
        rotor_speed_pu=table["rotor_speed"],
        tip_speed_ratio=tip_speed * table["rotor_speed"] / wind,
        target_ratio=tip_speed * target_rotor_speed_pu(table["speed"], wind) / wind,
        wind_m_s=wind,
        power_pu=table["power"],
        filter_hz=nominal_hz * table["filter"],
        coefficient_pu=table["coefficient"],
        offset_pu=table["offset"],
        time_constant_s=np.divide(1.0, rate, out=np.full_like(rate, np.nan), where=rate > 0.0),
        observations=table["observation"],
        observation_names=names,
        cost_terms=costs,
    )


def _sample(lanes: TaskLanes) -> dict[str, Floats]:
    """Return where the lanes stand, a row each."""
    simulator = lanes.simulator
    groups = {
        "speed": "speed",
        "rotor_speed": "rotor_speed",
        "filter": "filter",
        "wind": "wind",
        "power": "power",
        "coefficient": "coefficient",
        "offset": "k_offset",
        "inverse_time_constant": "inv_tau",
    }
    return {
        "frequency": simulator.lane_values("coi"),
        "observation": lanes.observations.astype(np.float64),
        **{name: simulator.wtg_values(row) for name, row in groups.items()},
    }


def target_rotor_speed_pu(frequency_pu: Floats, wind_m_s: Floats) -> Floats:
    """Return where the reference's rotor comes to rest at frequencies and winds of one shape [p.u.].

    In proportion to the wind, by the law alone, up to where the pitch protection holds it.
    """
    corners, light, strong = _resting_speeds()
    # Beyond its corners the law saturates, as the interpolation does.
    free = np.interp(frequency_pu, corners, light / _LIGHT_WIND_M_S) * wind_m_s
    return np.minimum(free, np.interp(frequency_pu, corners, strong))


@functools.cache
def _resting_speeds() -> tuple[Floats, Floats, Floats]:
    """Return frequencies [p.u.], and the reference's rotor speeds there in light and in strong wind [p.u.]."""
    control, law, turbine = GridFormingParameters(), coordinated_piecewise(), TurbineParameters()
    constants = turbine_constants(turbine, PitchParameters(), control, ProtectionParameters())
    cells = surface_of(turbine.power_coefficient)[1]
    of_law = law.k_min, law.k_nominal, law.k_max, converter_constants(control).corners
    frequencies = np.linspace(control.frequency_min_pu, control.frequency_max_pu, _N_FREQUENCIES)
    coefficients = [tracking_coefficient(frequency, *of_law) for frequency in frequencies]
    light, strong = (
        np.array([turbine_equilibrium(wind, k, constants, cells)[0] for k in coefficients])
        for wind in (_LIGHT_WIND_M_S, _STRONG_WIND_M_S)
    )
    return frequencies, light, strong


def one_scenario(recording: Recording, index: int) -> Recording:
    """Return the recording of one of its scenarios, by its place."""
    return _each(lambda name: getattr(recording, name)[index : index + 1], recording)


def pooled(recordings: Sequence[Recording]) -> Recording:
    """Return recordings of the same length and observations as one, scenario after scenario."""
    return _each(lambda name: np.concatenate([getattr(each, name) for each in recordings]), recordings[0])


def _each(make: Callable[[str], Floats], like: Recording) -> Recording:
    """Return a recording whose arrays over scenarios are made anew, by their names."""
    names = [field.name for field in fields(Recording) if field.name not in ("time_s", "observation_names")]
    arrays: dict[str, Any] = {name: make(name) for name in names}
    return replace(like, **arrays)
