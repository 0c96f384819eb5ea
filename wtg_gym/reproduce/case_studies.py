"""The paper's case studies, and studies beyond it: margins over wind, lost equilibria, τ, machine models.

Every study is data with a sentence that states its result; :mod:`wtg_gym.plotting` draws them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.modes import Side
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES, TrackingLaw
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.reproduce.loops import ideal_source_loop, single_machine
from wtg_gym.reproduce.power_frequency import critical_frequency_pu
from wtg_gym.scenarios import get_suite

#: Called with (name of the part under way, parts done, parts in all).
OnProgress = Callable[[str, float, int], None]

_SIDES: tuple[Side, ...] = ("under", "over")
#: Wind speeds of the small-signal studies [m/s].
WINDS = np.arange(6.0, 12.0 + 1e-9, 0.25)
#: τ of the trade-off study [s]: from the cancelled droop to the kept one.
TIME_CONSTANTS = (0.0, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6)


@dataclass(frozen=True)
class CaseStudies:
    """Both case studies of the paper: scenario and recorded runs by strategy."""

    increase: Scenario
    increase_runs: Mapping[str, Trajectory]
    decrease: Scenario
    decrease_runs: Mapping[str, Trajectory]


@dataclass(frozen=True)
class MarginStudy:
    """Phase margins over wind speed: `wind_m_s` (n,) [m/s], and (n,) [deg] by label."""

    wind_m_s: Floats
    phase_margin_deg: Mapping[str, Floats]
    sentence: str


@dataclass(frozen=True)
class EquilibriumStudy:
    """Frequencies below which a fixed strategy has no equilibrium: (n,) [p.u.] by strategy, over `wind_m_s` (n,)."""

    wind_m_s: Floats
    critical_frequency_pu: Mapping[str, Floats]
    sentence: str


@dataclass(frozen=True)
class DampingStudy:
    """Nadir, rotor speed and power over τ in the paper's load increase.

    `time_constant_s` (n,) [s], `nadir_hz` (n,) [Hz], `lowest_rotor_speed_pu` and `peak_power_pu` (n, n_wtg) [p.u.];
    all over the first event's 25 s.
    """

    time_constant_s: Floats
    nadir_hz: Floats
    lowest_rotor_speed_pu: Floats
    peak_power_pu: Floats
    sentence: str


@dataclass(frozen=True)
class MachineModelStudy:
    """The load increase with classical machines and with GENROU machines and exciters: runs by (model, strategy)."""

    scenario: Scenario
    runs: Mapping[tuple[str, str], Trajectory]
    sentence: str


def run_case_studies(on_progress: OnProgress = lambda *_: None) -> CaseStudies:
    """Run both case studies of the paper under every strategy."""
    suite = get_suite("paper")
    found: list[Any] = []
    for seed in range(2):
        scenario = suite.scenario(seed)
        runs: dict[str, Trajectory] = {}
        for name, law in STRATEGIES.items():
            on_progress(f"{scenario.name}, {name}", len(STRATEGIES) * seed + len(runs), 2 * len(STRATEGIES))
            runs[name] = simulate(scenario, law)
        found += [scenario, runs]
    return CaseStudies(*found)


def linear_undamped() -> TrackingLaw:
    """Return the straight g(ω) with the droop cancelled: the loop whose margin the paper gives as about 28°."""
    return dataclasses.replace(
        STRATEGIES["coordinated-linear"], name="coordinated-linear-undamped", damping_time_constant_s=0.0
    )


def study_margins() -> MarginStudy:
    """Return the phase margin of every loop of the paper's Bode plots over wind speed."""
    laws = [STRATEGIES[name] for name in ("mppt", "deloaded-5", "deloaded-10")]
    laws += [linear_undamped(), STRATEGIES["coordinated-linear"]]
    margins = {"ideal-source": np.full(WINDS.size, ideal_source_loop().margins().phase_margin_deg)}
    margins.update({law.name: _margins(law, "under") for law in laws})
    undamped, damped = margins["coordinated-linear-undamped"], margins["coordinated-linear"]
    low, high = int(np.argmin(np.abs(WINDS - 6.0))), int(np.argmin(np.abs(WINDS - 11.5)))
    return MarginStudy(
        WINDS,
        margins,
        f"Without transient damping the margin of the linear law falls from {undamped[high]:.0f}° at 11.5 m/s to "
        f"{undamped[low]:.0f}° at 6 m/s, because its damping is the slope of g(ω) times ω_m³. With τ = 0.8 s it stays "
        f"at {damped.min():.0f}° or more. Above 11.5 m/s the pitch protection holds the operating point.",
    )


def study_slopes() -> MarginStudy:
    """Return the phase margins on both slopes of the piecewise law, damped and undamped, over wind speed."""
    margins = {
        f"{name}, {side}-frequency": _margins(STRATEGIES[name], side)
        for name in ("coordinated-piecewise", "coordinated-undamped")
        for side in _SIDES
    }
    return MarginStudy(
        WINDS, margins, "The piecewise law is steeper below the set-point than above it, and so better damped there."
    )


def _margins(law: TrackingLaw, side: Side) -> Floats:
    return np.array([single_machine(law, float(wind), side=side).margins().phase_margin_deg for wind in WINDS])


def study_equilibria() -> EquilibriumStudy:
    """Return where the fixed strategies lose their equilibrium, over wind and frequency."""
    winds = np.arange(4.0, 14.0 + 1e-9, 0.25)
    critical = {
        name: np.array([critical_frequency_pu(STRATEGIES[name], float(wind)) or np.nan for wind in winds])
        for name in ("mppt", "deloaded-5", "deloaded-10")
    }
    lowest = GridFormingParameters().frequency_min_pu

    def safe_from(name: str) -> float:
        """Return the wind at which the critical frequency is the lower end of the regulation range [m/s]."""

        def excess(wind: float) -> float:
            return (critical_frequency_pu(STRATEGIES[name], wind) or 0.0) - lowest

        return float(brentq(excess, 4.0, 14.0, xtol=1e-6))

    return EquilibriumStudy(
        winds,
        critical,
        f"A deloaded WTG keeps its equilibrium down to {50 * lowest:.1f} Hz, the end of the regulation range, only "
        f"above {safe_from('deloaded-5'):.2f} m/s (5 %) or {safe_from('deloaded-10'):.2f} m/s (10 %); the coordinated "
        "laws do so at every wind speed. The pitch protection makes the bend above 11.5 m/s.",
    )


def study_damping(on_progress: OnProgress = lambda *_: None) -> DampingStudy:
    """Return how τ trades the nadir against rotor speed in the first 25 s after the paper's first load step."""
    scenario = dataclasses.replace(get_suite("paper").scenario(0), duration_s=30.0)
    scenario = dataclasses.replace(scenario, events=scenario.events[:1])
    nadir, rotor, peak = [], [], []
    for done, tau in enumerate(TIME_CONSTANTS):
        on_progress(f"τ = {tau:g} s", done, len(TIME_CONSTANTS))
        run = simulate(scenario, dataclasses.replace(STRATEGIES[REFERENCE_STRATEGY], damping_time_constant_s=tau))
        nadir.append(run.frequency_hz.min())
        rotor.append(run.rotor_speed_pu.min(axis=0))
        peak.append(run.power_pu.max(axis=0))
    rotors = np.array(rotor)
    here = TIME_CONSTANTS.index(0.8)
    best = int(np.argmax(nadir))
    return DampingStudy(
        np.array(TIME_CONSTANTS),
        np.array(nadir),
        rotors,
        np.array(peak),
        f"A longer τ keeps the droop for longer: from τ = 0.8 s to {TIME_CONSTANTS[best]:g} s the nadir rises by "
        f"{1e3 * (nadir[best] - nadir[here]):.0f} mHz, and the rotor of the low-wind group falls to "
        f"{rotors[best, 1]:.3f} instead of {rotors[here, 1]:.3f} p.u.",
    )


def study_machine_models() -> MachineModelStudy:
    """Return the paper's load increase with classical machines and with GENROU machines and exciters."""
    scenario = get_suite("paper").scenario(0)
    runs = {
        (model, name): simulate(
            scenario, STRATEGIES[name], PlantSettings(case=modified_ieee14(classical=model == "classical"))
        )
        for model in ("genrou", "classical")
        for name in (REFERENCE_STRATEGY, "deloaded-5")
    }
    full, plain = (runs[model, REFERENCE_STRATEGY] for model in ("genrou", "classical"))
    ends = [runs[model, "deloaded-5"] for model in ("genrou", "classical")]
    stalls = [f"{run.time_s[-1]:.1f} s" if run.status == Status.STALL else "no stall" for run in ends]
    return MachineModelStudy(
        scenario,
        runs,
        "GENROU machines have exciters, which hold the voltage and so the power of resistive loads. The reference "
        f"settles at {full.frequency_hz[-1] / 50:.4f} p.u. with them and at {plain.frequency_hz[-1] / 50:.4f} p.u. "
        f"with classical machines; its nadir is {full.frequency_hz.min():.3f} and {plain.frequency_hz.min():.3f} Hz; "
        f"deloaded-5 stalls at {stalls[0]} and {stalls[1]}.",
    )
