"""Measurements of the physics that the paper's model leaves out: rotor energy, limits of voltage, power and speed.

The energy-consistent rotor exists in these measurements only: after every simulation step the rotor speed is set so
that the kinetic energy has changed by the energy that went in. All else in such a run is the simulator's own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wtg_gym.analysis.steady_states import stable_equilibrium
from wtg_gym.analysis.voltage_limits import REACTIVE_LIMIT_PU, VoltageLimit, reactive_power, voltage_limits
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES, TrackingLaw
from wtg_gym.scenarios import get_suite

#: Winds of the energy balance [m/s].
WINDS = (6.0, 8.0, 10.0, 11.4)
#: Suites and strategies that are counted, on all validation seeds.
_SUITES = ("standard", "low-wind", "gust", "weak-grid")
_STRATEGIES = (REFERENCE_STRATEGY, "mppt", "deloaded-5", "deloaded-10")


@dataclass(frozen=True, kw_only=True)
class RotorEnergy:
    """Kinetic energy that the reference's rotor releases when the frequency falls, on the base of its rating.

    Args:
        wind_m_s: [m/s].
        before_pu, after_pu: ω_m of its equilibria at ω_st and at the lower frequency [p.u.].
        credited_s: 2H_m Δω_m, which the paper's rotor equation releases [p.u. s].
        stored_s: H_m Δ(ω_m²), by which the rotor's energy falls [p.u. s].
    """

    wind_m_s: float
    before_pu: float
    after_pu: float
    credited_s: float
    stored_s: float


@dataclass(frozen=True, kw_only=True)
class RotorRun:
    """A run under one of the two rotor equations.

    Args:
        status: why it ended, or RUNNING.
        end_s: when [s].
        nadir_hz, final_hz: lowest and last frequency of the centre of inertia [Hz].
        rotor_pu: ω_m at the start and at the end (2, n_wtg) [p.u.].
        released_s: ∫ p - p_w dt (n_wtg,) [p.u. s].
        least_rotor_pu, least_power_pu, peak_power_pu: over time, at every simulation step, (n_wtg,) [p.u.].
        voltage_pu: |E| behind X_g (n_wtg,) [p.u.].
        reactive_pu: what a group feeds into its bus at the start (n_wtg,) [p.u.].
    """

    status: Status
    end_s: float
    nadir_hz: float
    final_hz: float
    rotor_pu: Floats
    released_s: Floats
    least_rotor_pu: Floats
    least_power_pu: Floats
    peak_power_pu: Floats
    voltage_pu: Floats
    reactive_pu: Floats


@dataclass(frozen=True, kw_only=True)
class SuiteCounts:
    """Stalls and extremes of a strategy in the validation scenarios of a suite.

    Args:
        suite, strategy: names.
        n_scenarios: how many.
        stalls, energy_stalls: runs that end in a stall, with the paper's rotor and with the energy-consistent one.
        nadir_shift_hz: median of the energy-consistent minus the paper's nadir over runs that end in neither [Hz].
        motoring: runs in which a group's power falls below zero.
        peak_power_pu, least_rotor_pu: extremes over all runs and groups [p.u.].
        voltage_pu: smallest and largest |E| [p.u.].
        over_reactive: runs that start with more reactive power than a power factor of 0.95 gives at rated power.
    """

    suite: str
    strategy: str
    n_scenarios: int
    stalls: int
    energy_stalls: int
    nadir_shift_hz: float
    motoring: int
    peak_power_pu: float
    least_rotor_pu: float
    voltage_pu: tuple[float, float]
    over_reactive: int


@dataclass(frozen=True, kw_only=True)
class Omissions:
    """All of these measurements.

    Args:
        settled_pu: frequency at which the paper's load increase settles under the reference [p.u.].
        energy: one balance per wind, down to that frequency.
        paper_runs, energy_runs: the paper's load increase by strategy, under both rotor equations.
        counts: one per suite and strategy.
        held, limited: bus 2 at its scheduled voltage, and where |E| is at most 1.1 p.u.
    """

    settled_pu: float
    energy: tuple[RotorEnergy, ...]
    paper_runs: Mapping[str, RotorRun]
    energy_runs: Mapping[str, RotorRun]
    counts: tuple[SuiteCounts, ...]
    held: VoltageLimit
    limited: VoltageLimit


def study_omissions(on_progress: Callable[[str, float, int], None] = lambda *_: None) -> Omissions:
    """Measure them all; `on_progress` is called with (name of the part, parts done, parts in all)."""
    case = get_suite("paper").scenario(0)
    counts = []
    jobs = [(suite, strategy) for suite in _SUITES for strategy in _STRATEGIES]
    for done, (suite, strategy) in enumerate(jobs):
        on_progress(f"omissions, {suite}, {strategy}", done, len(jobs))
        counts.append(count_suite(suite, strategy))
    held, limited = voltage_limits(case)
    paper_runs, energy_runs = (
        {name: run_rotors([case], STRATEGIES[name], energy=energy)[0] for name in _STRATEGIES}
        for energy in (False, True)
    )
    settled_pu = paper_runs[REFERENCE_STRATEGY].final_hz / modified_ieee14().frequency_hz
    return Omissions(
        settled_pu=settled_pu,
        energy=tuple(rotor_energy(wind, settled_pu) for wind in WINDS),
        paper_runs=paper_runs,
        energy_runs=energy_runs,
        counts=tuple(counts),
        held=held,
        limited=limited,
    )


def rotor_energy(wind_m_s: float, frequency_pu: float) -> RotorEnergy:
    """Return the energy of the reference's rotor at a wind speed [m/s] as ω falls from ω_st to a frequency [p.u.]."""
    law, inertia_s = STRATEGIES[REFERENCE_STRATEGY], TurbineParameters().inertia_constant_s
    speeds = []
    for frequency in (GridFormingParameters().frequency_setpoint_pu, frequency_pu):
        point = stable_equilibrium(frequency, law, wind_m_s)
        assert point is not None
        speeds.append(point.rotor_speed_pu)
    before, after = speeds
    return RotorEnergy(
        wind_m_s=wind_m_s,
        before_pu=before,
        after_pu=after,
        credited_s=2.0 * inertia_s * (before - after),
        stored_s=inertia_s * (before**2 - after**2),
    )


def run_rotors(scenarios: Sequence[Scenario], law: TrackingLaw, *, energy: bool) -> list[RotorRun]:
    """Run scenarios with 2H_m ω̇_m = p_w - p, or with 2H_m ω_m ω̇_m = p_w - p, in the paper's plant.

    Args:
        scenarios: what happens, side by side; all as long as the first.
        law: of all groups.
        energy: whether the rotor's energy is H_m ω_m².
    """
    # A control step as short as the simulation step: the rotors are set, and looked at, after each of them.
    settings = PlantSettings(control_dt=PlantSettings().simulation_dt)
    simulator = Simulator(settings, n_lanes=len(scenarios), duration_s=scenarios[0].duration_s)
    laws = (law,) * len(settings.groups)
    simulator.commit(range(len(scenarios)), simulator.prepare(scenarios, laws))
    reactive = np.array([reactive_power(simulator, lane) for lane in range(len(scenarios))])
    rotors = simulator.layout.wtg("rotor_speed")
    blocks = simulator.blocks.reshape(-1, simulator.layout.n_rows, simulator.width)
    start = least_rotor = simulator.wtg_values("rotor_speed")
    least_power = simulator.wtg_values("power")
    for _ in range(simulator.n_intervals):
        before = blocks[:, rotors]
        simulator.advance()
        if energy:
            # H_m (ω² - ω_before²) = 2H_m (ω_paper - ω_before): both are the energy that went in.
            blocks[:, rotors] = np.sqrt(before**2 + 2.0 * (blocks[:, rotors] - before))
        least_rotor = np.minimum(least_rotor, simulator.wtg_values("rotor_speed"))
        least_power = np.minimum(least_power, simulator.wtg_values("power"))
    hertz = settings.case.frequency_hz
    statuses, steps = simulator.lane_values("status"), simulator.lane_values("step")
    nadirs, frequencies = simulator.lane_values("coi_min"), simulator.lane_values("coi")
    rotor, peak = simulator.wtg_values("rotor_speed"), simulator.wtg_values("peak_power")
    released = simulator.wtg_values("energy_delivered") - simulator.wtg_values("energy_captured")
    voltage = simulator.wtg_values("emf")
    return [
        RotorRun(
            status=Status(int(statuses[lane])),
            end_s=float(steps[lane]) * settings.simulation_dt,
            nadir_hz=hertz * float(nadirs[lane]),
            final_hz=hertz * float(frequencies[lane]),
            rotor_pu=np.stack([start[lane], rotor[lane]]),
            released_s=released[lane],
            least_rotor_pu=least_rotor[lane],
            least_power_pu=least_power[lane],
            peak_power_pu=peak[lane],
            voltage_pu=voltage[lane],
            reactive_pu=reactive[lane],
        )
        for lane in range(len(scenarios))
    ]


def count_suite(suite: str, strategy: str, n_scenarios: int | None = None) -> SuiteCounts:
    """Count over the first `n_scenarios` validation scenarios of a suite; None for all."""
    seeds = list(get_suite(suite).validation[:n_scenarios])
    scenarios = get_suite(suite).scenarios(seeds)
    runs, others = (run_rotors(scenarios, STRATEGIES[strategy], energy=energy) for energy in (False, True))
    shifts = [
        other.nadir_hz - run.nadir_hz
        for run, other in zip(runs, others, strict=True)
        if run.status == other.status == Status.RUNNING
    ]
    return SuiteCounts(
        suite=suite,
        strategy=strategy,
        n_scenarios=len(seeds),
        stalls=sum(run.status == Status.STALL for run in runs),
        energy_stalls=sum(run.status == Status.STALL for run in others),
        nadir_shift_hz=float(np.median(shifts)) if shifts else math.nan,
        motoring=sum(bool((run.least_power_pu < 0.0).any()) for run in runs),
        peak_power_pu=max(float(run.peak_power_pu.max()) for run in runs),
        least_rotor_pu=min(float(run.least_rotor_pu.min()) for run in runs),
        voltage_pu=(
            min(float(run.voltage_pu.min()) for run in runs),
            max(float(run.voltage_pu.max()) for run in runs),
        ),
        over_reactive=sum(bool((run.reactive_pu > REACTIVE_LIMIT_PU).any()) for run in runs),
    )
