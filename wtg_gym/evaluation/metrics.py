"""The metrics of an episode: unit, definition and measurement.

Every environment is measured from its own values alone, so that no number depends on the batch it was played in.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from wtg_gym.envs.batch import TERMINATION_REASONS, EnvBatch
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status
from wtg_gym.tasks.cost import COST_TERMS

#: Window at the end of an episode over which the quasi-steady frequency is averaged [s].
STEADY_WINDOW_S = 5.0


@dataclass(frozen=True)
class Metric:
    """Unit and definition of a metric, and whether it may be missing (None, an empty cell)."""

    unit: str
    doc: str
    optional: bool = False


#: Every metric of an episode. Extremes are taken at every simulation step.
METRICS: Mapping[str, Metric] = {
    "cost": Metric("-", "total cost, minus the return"),
    **{f"cost_{term}": Metric("-", f"{term} term of the total cost") for term in COST_TERMS},
    "nadir_hz": Metric("Hz", "lowest frequency of the centre of inertia"),
    "zenith_hz": Metric("Hz", "highest frequency of the centre of inertia"),
    "worst_nadir_hz": Metric("Hz", "lowest frequency of any bus or unit; in extended physics only", optional=True),
    "worst_zenith_hz": Metric("Hz", "highest frequency of any bus or unit; in extended physics only", optional=True),
    "largest_voltage_pu": Metric(
        "p.u.", "highest terminal voltage of any connected group; in extended physics only", optional=True
    ),
    "largest_rocof_hz_s": Metric(
        "Hz/s", "largest absolute rate of change of the centre of inertia's frequency over 500 ms"
    ),
    "quasi_steady_deviation_hz": Metric(
        "Hz", "mean frequency of the last 5 s minus the nominal one; none after a failure", optional=True
    ),
    "energy_mwh": Metric("MWh", "energy all groups captured until the end or the failure"),
    "energy_share_percent": Metric("%", "captured of the available energy, at the best power coefficient"),
    "duty_error_percent": Metric(
        "%", "mean distance of the captured from the asked power, of the available, over time and groups"
    ),
    "least_tip_speed_ratio": Metric("-", "smallest tip-speed ratio of any group"),
    "largest_tip_speed_ratio": Metric("-", "largest tip-speed ratio of any group"),
    "overload_time_s": Metric("s", "time above the converter's overload limit, of the group with most of it"),
    "peak_power_pu": Metric("p.u.", "largest delivered power of any group, on its own base"),
    "constraint_time_s": Metric("s", "time of the intervals with a constraint violated"),
    "tripped_groups": Metric(
        "-", "groups disconnected by an event, or by their protection where a failure trips instead of ends"
    ),
    "shed_energy_mwh": Metric("MWh", "load not served, at 1 p.u. of voltage; in extended physics only", optional=True),
    "survived_s": Metric("s", "simulated time until the end or the failure"),
    "reserve_margin": Metric("-", "reserve margin of the scenario; in version v1 only", optional=True),
}


def frequencies(batch: EnvBatch, steps: Iterable[Any]) -> list[Floats]:
    """Follow started episodes to their ends; return each environment's frequency [Hz] at its start and after its steps.

    `steps` are those of :func:`~wtg_gym.policies.play.play`. The frequency is that of the centre of inertia, whose
    course the simulator does not keep.
    """
    samples = [batch.nominal_hz * batch.simulator.env_values("coi")]
    samples += [batch.nominal_hz * batch.simulator.env_values("coi") for _ in steps]
    return [course[: 1 + n] for course, n in zip(np.transpose(samples), batch.n_steps().tolist(), strict=True)]


def quasi_steady_deviation(frequency_hz: Floats, interval_s: float, nominal_hz: float) -> float:
    """Return the quasi-steady deviation of an episode that reached its end [Hz].

    The frequencies (n_steps + 1,) [Hz] are those of the start and after every control interval [s].
    """
    n_window = max(1, min(round(STEADY_WINDOW_S / interval_s), frequency_hz.size - 1))
    return math.fsum(frequency_hz[-n_window:].tolist()) / n_window - nominal_hz


def measure(batch: EnvBatch, env: int, frequency_hz: Floats) -> dict[str, Any]:
    """Return "metrics" of an episode that is over, by the names in :data:`METRICS`, and its "failure" (empty: none).

    `frequency_hz` is the environment's part of :func:`frequencies`.
    """
    simulator, nominal_hz = batch.simulator, batch.nominal_hz
    base_mva, extended = simulator.settings.case.base_mva, simulator.settings.extended
    status = Status(int(batch.statuses()[env]))
    n_steps, dt = frequency_hz.size - 1, batch.settings.step_s

    def grid(name: str) -> float:
        return float(simulator.env_values(name)[env])

    def task(name: str) -> float:
        return float(batch.task_values(name)[env])

    def groups(name: str) -> list[float]:
        return list(simulator.wtg_values(name)[env].tolist())

    terms = {f"cost_{t}": float(value) for t, value in zip(COST_TERMS, batch.cost_sums()[env], strict=True)}
    energies = zip(simulator.plant.share, groups("energy_captured"), strict=True)
    captured = math.fsum(share * energy for share, energy in energies)
    is_whole = status == Status.RUNNING
    metrics: dict[str, float | None] = {
        "cost": math.fsum(terms.values()),
        **terms,
        "nadir_hz": nominal_hz * grid("coi_min"),
        "zenith_hz": nominal_hz * grid("coi_max"),
        "worst_nadir_hz": nominal_hz * grid("worst_min") if extended else None,
        "worst_zenith_hz": nominal_hz * grid("worst_max") if extended else None,
        "largest_voltage_pu": max(groups("largest_voltage")) if extended else None,
        "largest_rocof_hz_s": task("largest_rocof"),
        "quasi_steady_deviation_hz": quasi_steady_deviation(frequency_hz, dt, nominal_hz) if is_whole else None,
        "energy_mwh": captured * base_mva / 3600.0,
        "energy_share_percent": 100.0 * captured / task("available_energy"),
        "duty_error_percent": 100.0 * task("duty_error") / (n_steps * dt),
        "least_tip_speed_ratio": min(groups("least_tsr")),
        "largest_tip_speed_ratio": max(groups("largest_tsr")),
        "overload_time_s": max(groups("overload_time")),
        "peak_power_pu": max(groups("peak_power")),
        "constraint_time_s": task("constraint_sum") * batch.settings.interval_s,
        "tripped_groups": float(sum(connected < 0.5 for connected in groups("connected"))),
        "shed_energy_mwh": grid("shed_energy") * base_mva / 3600.0 if extended else None,
        "survived_s": grid("step") * simulator.plant.simulation_dt,
        "reserve_margin": float(batch.reserve_margins[env]) if batch.suite.margins else None,
    }
    return {"metrics": metrics, "failure": TERMINATION_REASONS[status]}
