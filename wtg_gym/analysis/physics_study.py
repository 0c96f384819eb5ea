"""What the paper's model leaves out, measured: its conclusions in its own plant and in more honest ones."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wtg_gym.analysis.load_models import LOAD_MODELS, LoadRun, run_with_loads
from wtg_gym.analysis.plant_forms import (
    HONEST,
    HYDRO,
    NREL,
    PAPER,
    PRESETS,
    WINDS,
    PlantRun,
    RotorEnergy,
    least_start_wind,
    plant_forms,
    rotor_energy,
    run_plant,
)
from wtg_gym.analysis.voltage_limits import REGULATED_PU, VoltageLimit, start_at, voltage_limits
from wtg_gym.envs.lanes import TERMINATION_REASONS
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.nrel5mw import nrel_5mw
from wtg_gym.physics.parameters import TurbineParameters, VoltageControlParameters
from wtg_gym.physics.plant import PlantSettings, plant_settings
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law
from wtg_gym.reproduce.loops import PAPER_SYNCHRONISING_COEFFICIENT, single_machine
from wtg_gym.reproduce.steady_states import critical_frequency_pu
from wtg_gym.scenarios import get_suite

#: The reference first.
COMPARED = (REFERENCE_STRATEGY, "mppt", "deloaded-5", "deloaded-10")
#: Plants in which the paper's conclusions are checked, and those whose failures are shown side by side.
CHECKED = (PAPER, HONEST, NREL, HYDRO, *PRESETS)
THREE_FORMS = (PAPER, "rotor energy", HONEST)
#: Suites of every plant, and those of the plants above alone.
SUITES_OF_ALL, FURTHER_SUITES = ("standard", "low-wind"), ("gust", "weak-grid")
#: The wind at which critical frequencies are compared: that of the group that stalls [m/s].
CRITICAL_WIND = 8.0


@dataclass(frozen=True, kw_only=True)
class SuiteCount:
    """A strategy in validation scenarios of a suite."""

    #: n_scenarios, refused: how many, and how many of them the plant does not start.
    n_scenarios: int
    refused: int
    ends: Mapping[str, int]  # runs that end in a failure, by its reason
    motoring: int  # runs in which a group's p falls below 0
    nadirs_hz: Floats  # of every scenario, not a number where it failed or did not start (n_scenarios,) [Hz]
    least_ratio: float  # smallest tip-speed ratio of all runs
    #: least_rotor_pu, peak_current_pu: extremes of ω_m and |I| [p.u.].
    least_rotor_pu: float
    peak_current_pu: float
    internal_pu: tuple[float, float]  # smallest and largest |E| [p.u.]
    lowest_hz: float  # lowest frequency of all runs [Hz]

    @property
    def failures(self) -> int:
        """Return the number of runs that end in a failure."""
        return sum(self.ends.values())


@dataclass(frozen=True, kw_only=True)
class PhysicsStudy:
    """All measurements."""

    scenario: Scenario  # the paper's load increase
    #: increase, decrease: the paper's cases, by plant and strategy.
    increase: Mapping[str, Mapping[str, PlantRun]]
    decrease: Mapping[str, Mapping[str, PlantRun]]
    counts: Mapping[str, Mapping[str, Mapping[str, SuiteCount]]]  # by plant, suite and strategy
    #: By preset and strategy, the wind below which rotors start below the under-speed trip [m/s].
    least_start_m_s: Mapping[str, Mapping[str, float]]
    #: The rotor's energy, by wind, down to the frequency at which the load increase settles.
    energy: tuple[RotorEnergy, ...]
    settled_hz: float  # that frequency [Hz]
    #: held, limited, regulated, consistent, nrel: starts: constant E at the scheduled voltage and where |E| is at most
    #: 1.1 p.u.; voltage control, then with an energy-consistent rotor, then with the NREL 5 MW turbine.
    held: VoltageLimit
    limited: VoltageLimit
    regulated: VoltageLimit
    consistent: VoltageLimit
    nrel: VoltageLimit
    paper_margins_deg: Floats  # of the reference at the paper's K_p, by group [deg]
    #: By turbine ("paper", "NREL 5 MW") and strategy, at 8 m/s [Hz]; None: equilibria everywhere.
    critical_hz: Mapping[str, Mapping[str, float | None]]
    loads: tuple[LoadRun, ...]  # the load increase by load model and strategy


def study_physics(n_scenarios: int, on_progress: Callable[[str, float, int], None] = lambda *_: None) -> PhysicsStudy:
    """Measure all of it, on the first validation scenarios of each suite."""
    forms = plant_forms()
    cases = get_suite("paper").scenarios([0, 1])
    increase: dict[str, dict[str, PlantRun]] = {}
    decrease: dict[str, dict[str, PlantRun]] = {}
    counts: dict[str, dict[str, dict[str, SuiteCount]]] = {}
    for done, (name, settings) in enumerate(forms.items()):
        on_progress(name, done, len(forms))
        increase[name], decrease[name], counts[name] = {}, {}, {}
        for strategy in COMPARED:
            runs = run_plant(settings, cases, strategy)
            for table, run in zip((increase, decrease), runs, strict=True):
                assert run is not None, f"the paper's case does not start in the plant {name!r}"
                table[name][strategy] = run
        for suite in (*SUITES_OF_ALL, *(FURTHER_SUITES if name in {*CHECKED, *THREE_FORMS} else ())):
            counts[name][suite] = {s: count_suite(settings, suite, s, n_scenarios) for s in COMPARED}
    on_progress("small signal and loads", len(forms) - 0.5, len(forms))
    case, hertz = cases[0], modified_ieee14().frequency_hz
    settled_hz = float(increase[PAPER][REFERENCE_STRATEGY].frequency_hz[-1])
    held, limited = voltage_limits(case)
    law = get_law(REFERENCE_STRATEGY)
    margins = [
        single_machine(law, float(wind), PAPER_SYNCHRONISING_COEFFICIENT).margins().phase_margin_deg
        for wind in case.wind_speed[:, 0]
    ]
    turbines = {"paper": None, "NREL 5 MW": nrel_5mw()}

    def critical(strategy: str, turbine: TurbineParameters | None) -> float | None:
        found = critical_frequency_pu(get_law(strategy, turbine), CRITICAL_WIND, turbine=turbine)
        return None if found is None else hertz * found

    def regulated(turbine: TurbineParameters | None = None) -> VoltageLimit:
        return start_at(case, REGULATED_PU, turbine=turbine, voltage_control=VoltageControlParameters())

    return PhysicsStudy(
        scenario=case,
        increase=increase,
        decrease=decrease,
        counts=counts,
        least_start_m_s={name: {s: least_start_wind(plant_settings(name), s) for s in COMPARED} for name in PRESETS},
        energy=tuple(rotor_energy(wind, settled_hz / hertz) for wind in WINDS),
        settled_hz=settled_hz,
        held=held,
        limited=limited,
        regulated=regulated(),
        consistent=regulated(TurbineParameters(conserves_energy=True)),
        nrel=regulated(nrel_5mw()),
        paper_margins_deg=np.array(margins),
        critical_hz={
            name: {strategy: critical(strategy, turbine) for strategy in COMPARED[1:]}
            for name, turbine in turbines.items()
        },
        loads=tuple(run_with_loads(model, case, s) for model in LOAD_MODELS for s in COMPARED),
    )


def count_suite(settings: PlantSettings, suite: str, strategy: str, n_scenarios: int) -> SuiteCount:
    """Count over the first validation scenarios of a suite in a plant."""
    runs = run_plant(settings, get_suite(suite).scenarios(list(get_suite(suite).validation[:n_scenarios])), strategy)
    started = [run for run in runs if run is not None]
    return SuiteCount(
        n_scenarios=len(runs),
        refused=len(runs) - len(started),
        ends=Counter(TERMINATION_REASONS[run.status] for run in started if run.failed),
        motoring=sum(bool((run.power_pu < 0.0).any()) for run in started),
        nadirs_hz=np.array([np.nan if run is None or run.failed else run.nadir_hz for run in runs]),
        least_ratio=min(float(run.least_ratio.min()) for run in started),
        least_rotor_pu=min(float(run.rotor_pu.min()) for run in started),
        peak_current_pu=max(float(run.current_pu.max()) for run in started),
        internal_pu=(
            min(float(run.internal_pu.min()) for run in started),
            max(float(run.internal_pu.max()) for run in started),
        ),
        lowest_hz=min(run.nadir_hz for run in started),
    )


def summary_of(run: PlantRun) -> dict[str, float | str]:
    """Return the numbers of a run without its series, for JSON."""
    return {
        "status": run.status.name,
        "end_s": run.end_s,
        "nadir_hz": run.nadir_hz,
        "highest_hz": float(run.frequency_hz.max()),
        "rocof_hz_s": run.rocof_hz_s,
        "least_tip_speed_ratio": float(run.least_ratio.min()),
        "least_rotor_pu": float(run.rotor_pu.min()),
        "least_power_pu": float(run.power_pu.min()),
        "peak_power_pu": float(run.power_pu.max()),
        "peak_current_pu": float(run.current_pu.max()),
        "peak_internal_pu": float(run.internal_pu.max()),
        "peak_reactive_pu": float(np.abs(run.reactive_pu).max()),
    }


def as_data(study: PhysicsStudy) -> dict[str, object]:
    """Return the numbers of a study without the series of its runs, for JSON."""
    plain = {
        field.name: getattr(study, field.name)
        for field in dataclasses.fields(study)
        if field.name not in ("scenario", "increase", "decrease", "counts")
    }
    cases = {
        name: {plant: {s: summary_of(run) for s, run in runs.items()} for plant, runs in getattr(study, name).items()}
        for name in ("increase", "decrease")
    }
    counts = {
        plant: {suite: {s: _count_data(count) for s, count in row.items()} for suite, row in suites.items()}
        for plant, suites in study.counts.items()
    }
    rest = {name: _plain(value) for name, value in plain.items()}
    return {**cases, "counts": counts, **rest}


def _count_data(count: SuiteCount) -> dict[str, object]:
    nadirs = count.nadirs_hz[~np.isnan(count.nadirs_hz)]
    median = float(np.median(nadirs)) if nadirs.size else None
    plain = {k: v for k, v in vars(count).items() if k != "nadirs_hz"}
    return {**plain, "failures": count.failures, "median_nadir_hz": median}


def _plain(value: object) -> object:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return value
