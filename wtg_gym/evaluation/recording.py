"""Episodes recorded step by step, for the pages and pictures that show them."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.batch import TERMINATION_REASONS
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.statistics import Floats, mean
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.policies import Entry
from wtg_gym.policies.play import play, started_batch

_MJ_PER_MWH = 3600.0


class Energy(NamedTuple):
    """Power and energy of all turbines into the grid, and the kinetic energy that their rotors lent and got back."""

    power_mw: float
    energy_mwh: float
    borrowed_mj: float
    repaid_mj: float


@dataclass(frozen=True, kw_only=True)
class Recorded:
    """Episodes side by side, a sample at the start and after every step; NaN once one has ended; (n, num_envs) each."""

    time_s: Floats  # (n,)
    frequency_hz: Floats  # of the centre of inertia
    worst_hz: Floats  # of the bus or unit farthest from nominal
    wind_m_s: Floats  # mean over the turbines
    power_mw: Floats  # of all groups
    rotor_speed_pu: Floats  # of the slowest rotor of a connected group
    unserved_mw: Floats  # load
    stored_mj: Floats  # kinetic energy of the rotors of each group (n, num_envs, n_wtg)
    whole: npt.NDArray[np.bool_]  # whether each episode went to its end, with all groups connected (num_envs,)
    costs: Floats  # (num_envs,)
    failures: list[str]  # why each ended before its time, empty where it did not (num_envs,)

    def energy(self, chosen: npt.NDArray[np.bool_]) -> Energy:
        """Return the means over some of the episodes, `chosen` (num_envs,)."""
        power_mw = mean(self.power_mw[1:, chosen])
        change_mj = np.diff(self.stored_mj[:, chosen], axis=0) / chosen.sum()
        lent, repaid = (float(part.sum()) for part in (np.minimum(change_mj, 0.0), np.maximum(change_mj, 0.0)))
        return Energy(power_mw, power_mw * float(self.time_s[-1]) / _MJ_PER_MWH, -lent, repaid)


def recorded(entry: Entry, settings: EnvSettings, scenarios: Sequence[Scenario], n_threads: int | None = 1) -> Recorded:
    """Play an entry through scenarios, and record them."""
    with started_batch(entry, settings, scenarios, n_threads) as (batch, _):
        simulator, base_mva = batch.simulator, batch.simulator.settings.case.base_mva
        inertia = np.array([turbine.inertia_constant_s for turbine in simulator.settings.turbines])
        rating_mva = base_mva * np.asarray(simulator.plant.share)
        connected, samples = np.ones(batch.num_envs, dtype=np.bool_), []
        for running, _ in itertools.chain([(connected.copy(), None)], play(entry, batch)):
            rotors, power = simulator.wtg_values("rotor_speed"), simulator.wtg_values("power")
            on = simulator.wtg_values("connected") > 0.5
            columns = {
                "frequency_hz": batch.nominal_hz * simulator.env_values("coi"),
                "worst_hz": batch.nominal_hz * simulator.env_values("worst"),
                "wind_m_s": simulator.wtg_values("wind") @ rating_mva / rating_mva.sum(),
                "power_mw": power @ rating_mva,
                "rotor_speed_pu": np.fmin.reduce(np.where(on, rotors, np.nan), axis=1),
                "unserved_mw": base_mva * simulator.env_values("unserved"),
                "stored_mj": inertia * rating_mva * np.square(rotors),
            }
            samples.append({name: np.where(running, values.T, np.nan).T for name, values in columns.items()})
            connected &= on.all(axis=1)
        series = {name: np.array([each[name] for each in samples]) for name in samples[0]}
        return Recorded(
            time_s=batch.settings.step_s * np.arange(len(samples), dtype=np.float64),
            **series,
            whole=connected & ~batch.ended()[0],
            costs=batch.cost_sums().sum(axis=1),
            failures=[TERMINATION_REASONS[Status(status)] for status in batch.statuses().tolist()],
        )
