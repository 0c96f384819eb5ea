"""The paper's plant and more honest ones: which they are, and runs of them that note what a machine would feel.

The paper's form is an extended plant whose limits lie out of reach: it does what the paper's plant does, and tells its
currents and voltages too.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.machine_parameters import HydroGovernorParameters
from wtg_gym.physics.nrel5mw import nrel_5mw
from wtg_gym.physics.parameters import (
    ConverterLimitParameters,
    GridFormingParameters,
    ProtectionParameters,
    TurbineParameters,
)
from wtg_gym.physics.plant import PHYSICS, PlantSettings, plant_settings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES, TrackingLaw, get_law, group_laws
from wtg_gym.reproduce.steady_states import stable_equilibrium

#: Limits that nothing reaches.
UNLIMITED = ConverterLimitParameters(
    current_max_pu=10.0, power_max_pu=10.0, power_min_pu=-10.0, power_gain=0.0, power_integral_gain=0.0
)
PAPER, HONEST, NREL, HYDRO = "the paper's", "all together", "all, NREL 5 MW turbine", "all, hydro and shedding"
#: The kinds of physics that environment and commands offer besides the paper's.
PRESETS = PHYSICS[1:]
#: Winds of the energy balance [m/s].
WINDS = (6.0, 8.0, 10.0, 11.4)
#: Window of the rate of change of frequency [s].
_ROCOF_WINDOW_S = 0.5


def plant_forms() -> Mapping[str, PlantSettings]:
    """Return the plants by name: the paper's, it with one part more each, with parts together, and the presets."""
    paper = PlantSettings(limits=UNLIMITED)
    presets = {name: plant_settings(name) for name in PRESETS}
    extended = presets["extended"]
    limits = dataclasses.replace(ConverterLimitParameters(), power_min_pu=UNLIMITED.power_min_pu)
    chopper = dataclasses.replace(UNLIMITED, power_min_pu=0.0)
    # The stages are there, and shed nothing: a plant without them would be compiled for itself.
    idle = tuple(dataclasses.replace(stage, share=0.0) for stage in extended.shedding)
    hydro = modified_ieee14().with_governors(lambda steam: HydroGovernorParameters(droop_pu=steam.droop_pu))
    untripped = ProtectionParameters()
    return {
        PAPER: paper,
        "rotor energy": dataclasses.replace(paper, turbine=extended.turbine),
        "current and power limits": dataclasses.replace(paper, limits=limits),
        "chopper": dataclasses.replace(paper, limits=chopper),
        "voltage control": dataclasses.replace(paper, voltage_control=extended.voltage_control),
        "dead band": dataclasses.replace(paper, case=extended.case),
        HONEST: plant_settings("extended", protection=untripped, shedding=()),
        "under-speed trip": dataclasses.replace(paper, protection=extended.protection),
        "NREL 5 MW rotor": dataclasses.replace(paper, turbine=nrel_5mw(conserves_energy=False)),
        NREL: plant_settings("nrel-5mw", protection=untripped, shedding=()),
        "hydro governor": dataclasses.replace(paper, case=hydro, shedding=idle),
        "hydro governor, shedding": dataclasses.replace(paper, case=hydro, shedding=extended.shedding),
        HYDRO: plant_settings("extended", protection=untripped, case=hydro),
        **presets,
    }


@dataclass(frozen=True, kw_only=True)
class RotorEnergy:
    """Kinetic energy that the reference's rotor releases when the frequency falls, on the base of its rating."""

    wind_m_s: float  # [m/s]
    #: before_pu, after_pu: ω_m of its equilibria at ω_st and at the lower frequency [p.u.].
    before_pu: float
    after_pu: float
    credited_s: float  # 2H_m Δω_m, which the paper's rotor equation releases [p.u. s]
    stored_s: float  # H_m Δ(ω_m²), by which the rotor's energy falls [p.u. s]


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


def least_start_wind(settings: PlantSettings, strategy: str) -> float:
    """Return the wind below which rotors start below a plant's under-speed trip under a strategy [m/s]."""
    law, some_wind = get_law(strategy, settings.turbine, settings.control), 6.0
    point = stable_equilibrium(settings.control.frequency_setpoint_pu, law, some_wind, turbine=settings.turbine)
    assert point is not None
    # At nominal frequency and with blades at rest a law holds one tip-speed ratio, whatever the wind.
    return some_wind * settings.protection.rotor_speed_min_pu / point.rotor_speed_pu


@dataclass(frozen=True, kw_only=True)
class PlantRun:
    """A run of a plant; the extremes count every simulation step."""

    status: Status  # why it ended, or RUNNING
    end_s: float  # when [s]
    times_s: Floats  # start, and every simulation step until the end (n,) [s]
    frequency_hz: Floats  # of the centre of inertia (n,) [Hz]
    #: rotor_pu, power_pu, current_pu: ω_m, p and |I| (n, n_wtg) [p.u.].
    rotor_pu: Floats
    power_pu: Floats
    current_pu: Floats
    #: internal_pu, reactive_pu: |E| behind X_g and q at the terminal (n, n_wtg) [p.u.].
    internal_pu: Floats
    reactive_pu: Floats
    least_ratio: Floats  # smallest tip-speed ratio (n_wtg,)
    released_s: Floats  # ∫ p - p_w dt (n_wtg,) [p.u. s]

    @property
    def failed(self) -> bool:
        """Whether something ended it before its time."""
        return self.status != Status.RUNNING

    @property
    def nadir_hz(self) -> float:
        """Return the lowest frequency [Hz]."""
        return float(self.frequency_hz.min())

    @property
    def rocof_hz_s(self) -> float:
        """Return the largest change of frequency within half a second, per second [Hz/s]."""
        n = min(round(_ROCOF_WINDOW_S / PlantSettings().simulation_dt), self.times_s.size - 1)
        change = np.abs(self.frequency_hz[n:] - self.frequency_hz[: self.frequency_hz.size - n])
        return float(change.max() / (self.times_s[n] - self.times_s[0]))

    def until(self, time_s: float) -> PlantRun:
        """Return the run with its series cut off at a time [s]."""
        n = int(np.searchsorted(self.times_s, time_s))
        names = ("times_s", "frequency_hz", "rotor_pu", "power_pu", "current_pu", "internal_pu", "reactive_pu")
        return dataclasses.replace(self, **{name: getattr(self, name)[:n] for name in names})


def run_plant(settings: PlantSettings, scenarios: Sequence[Scenario], strategy: str) -> list[PlantRun | None]:
    """Run scenarios side by side in an extended plant under one strategy; None where a plant refuses to start.

    Args:
        settings: the plant; each simulation step is a control interval here, so that protections act after it.
        scenarios: what happens; all as long as the first.
        strategy: of all groups, for the plant's turbine.
    """
    settings = dataclasses.replace(settings, control_dt=settings.simulation_dt)
    simulator = Simulator(settings, n_lanes=len(scenarios), duration_s=scenarios[0].duration_s)
    laws = group_laws(strategy, len(settings.groups), settings.turbine)
    started = [lane for lane, scenario in enumerate(scenarios) if _start(simulator, lane, scenario, laws)]
    names = ("rotor_speed", "power", "current", "internal_voltage", "reactive")
    series: list[list[Floats]] = [[] for _ in names]
    frequencies: list[Floats] = []

    def look() -> None:
        frequencies.append(settings.case.frequency_hz * simulator.lane_values("coi"))
        for values, name in zip(series, names, strict=True):
            values.append(simulator.wtg_values(name))

    look()
    for _ in range(simulator.n_intervals):
        simulator.advance()
        look()
    frequency, tables = np.stack(frequencies), [np.stack(values) for values in series]
    steps, statuses = simulator.lane_values("step"), simulator.lane_values("status")
    ratios = simulator.wtg_values("least_tsr")
    released = simulator.wtg_values("energy_delivered") - simulator.wtg_values("energy_captured")
    runs: list[PlantRun | None] = [None] * len(scenarios)
    for lane in started:
        n = int(steps[lane]) + 1
        rotor, power, current, internal, reactive = (table[:n, lane] for table in tables)
        runs[lane] = PlantRun(
            status=Status(int(statuses[lane])),
            end_s=float(steps[lane]) * settings.simulation_dt,
            times_s=settings.simulation_dt * np.arange(n, dtype=np.float64),
            frequency_hz=frequency[:n, lane],
            rotor_pu=rotor,
            power_pu=power,
            current_pu=current,
            internal_pu=internal,
            reactive_pu=reactive,
            least_ratio=ratios[lane],
            released_s=released[lane],
        )
    simulator.close()
    return runs


def _start(simulator: Simulator, lane: int, scenario: Scenario, laws: Sequence[TrackingLaw]) -> bool:
    try:
        simulator.start(lane, scenario, laws)
    except ValueError:
        simulator.stop(lane)
        return False
    return True
