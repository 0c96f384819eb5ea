"""The courses of episodes, sample by sample: the grid, the rotors, and the k and τ in use."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies import Entry
from wtg_gym.policies.play import play, started_lanes

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Episodes of one entry, a sample at the start and one per control step; not a number after an early end.

    Arrays have the axes scenario, sample and, in brackets below, further ones.
    """

    time_s: Floats  # (n,), without scenarios [s]
    frequency_hz: Floats  # of the centre of inertia [Hz]
    deviation_hz: Floats  # of each group's own frequency from the nominal one (n_wtg) [Hz]
    rocof_hz_s: Floats  # of each group's own frequency over the last control interval (n_wtg) [Hz/s]
    rotor_speed_pu: Floats  # (n_wtg) [p.u.]
    tip_speed_ratio: Floats  # (n_wtg) [-]
    wind_m_s: Floats  # (n_wtg) [m/s]
    power_pu: Floats  # delivered, on each group's base (n_wtg) [p.u.]
    filter_hz: Floats  # state x of the transient damping (n_wtg) [Hz]
    coefficient_pu: Floats  # tracking coefficient k in use (n_wtg) [p.u.]
    offset_pu: Floats  # what the policy adds to the law's k (n_wtg) [p.u.]
    time_constant_s: Floats  # τ in use; not a number for a law without (n_wtg) [s]
    observations: Floats  # what the policy saw then (n_observation)
    observation_names: tuple[str, ...]  # with units
    cost_terms: Floats  # sums over the episode, in the order of `COST_TERMS` (n_scenarios, n_terms)


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
    rows = {"offset": "k_offset", "inverse_time_constant": "inv_tau"}
    names = ("speed", "rotor_speed", "filter", "wind", "power", "coefficient", *rows)
    return {
        "frequency": lanes.simulator.lane_values("coi"),
        "observation": lanes.observations.astype(np.float64),
        **{name: lanes.simulator.wtg_values(rows.get(name, name)) for name in names},
    }
