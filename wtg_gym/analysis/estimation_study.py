"""Inertia and droop found again from records of the frequency: of runs here, and of another simulator's."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wtg_gym.analysis.case_file import ReferenceCase, read_parameters
from wtg_gym.analysis.trace_file import choose_events, read_trace
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import markdown_table
from wtg_gym.gradients.estimator import INERTIA, Estimator, covered, estimates, unknown_of
from wtg_gym.gradients.plant_parameters import PlantEnvSettings
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters, WtgGroup
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import LoadStep, Scenario
from wtg_gym.ranges import require_range

#: What is sought by default: of the synchronous machines, and of the grid-forming converters.
UNKNOWNS = (INERTIA, "machines.1.governor.droop_pu", "control.inertia_constant_s", "control.droop_gain_pu")
#: Multiples of the true values that searches start from, in turn.
STARTS = (0.7, 1.4)
#: Inertia constant of a rotor that holds its speed [s], the largest there may be: its converter then stands for a
#: constant power P_st, to some 0.01 %.
_HELD_S = 1e4


def recorded_case(
    case: ReferenceCase, events: Sequence[LoadStep], bus: int, *, control_dt: float, duration_s: float
) -> tuple[PlantEnvSettings, Scenario]:
    """Return a case in which WTG groups under a constant P_st stand for the classical machines at a bus.

    A classical machine without a governor is what a grid-forming converter with droop and a constant set-point is: 2H
    is its virtual inertia, D its droop gain, x'_d its X_g.

    Args:
        case: of another simulator.
        events: what happens.
        bus: of the machines that groups stand for.
        control_dt: interval between two outputs [s]; a quarter of it is the integration step.
        duration_s: of the scenario [s].

    Raises:
        ValueError: there are no classical machines of equal data at the bus, or no others.
    """
    machines = dict(zip(case.machine_keys, case.network.machines, strict=True))
    units = {key: machine for key, machine in machines.items() if machine.bus == bus}
    kinds = {(m.two_h_s, m.damping_pu, m.x_d_transient, m.classical, m.governor) for m in units.values()}
    if len(kinds) != 1 or not next(iter(units.values())).classical or next(iter(units.values())).governor:
        raise ValueError(
            f"{case.network.name}: WTG groups stand for classical machines of equal data; bus {bus} has none"
        )
    unit = next(iter(units.values()))
    turbine = TurbineParameters(inertia_constant_s=_HELD_S)
    plant = PlantSettings(
        case=dataclasses.replace(
            case.network, machines=tuple(machine for key, machine in machines.items() if key not in units)
        ),
        groups=tuple(WtgGroup(bus=bus, n_turbines=m.rating_mva / turbine.rated_power_mw) for m in units.values()),
        turbine=turbine,
        control=GridFormingParameters(
            inertia_constant_s=0.5 * unit.two_h_s, droop_gain_pu=unit.damping_pu, reactance_pu=unit.x_d_transient
        ),
        control_dt=control_dt,
        simulation_dt=control_dt / 4.0,
    )
    best = tracking_point(0.0, turbine).power_coefficient * turbine.wind_power_pu_per_cubic_wind
    power = [case.power[key].real * case.network.base_mva / m.rating_mva for key, m in units.items()]
    scenario = Scenario(
        name=case.network.name,
        wind_speed=np.array([[(own / best) ** (1.0 / 3.0)] for own in power]),
        events=tuple(event for event in events if event.time_s < duration_s),
        duration_s=duration_s,
        load_noise_bus=case.network.slack_bus,
    )
    settings = EnvSettings(version="v0", scenario=scenario, strategy="mppt", action_mode="k", groups=len(units))
    return PlantEnvSettings.of(settings, plant), scenario


@dataclass(frozen=True)
class Noise:
    """White noise that is added to a record; a ValueError if a value is out of range."""

    mhz: float = 1.0  # standard deviation [mHz]
    n_draws: int = 100
    seed: int = 0

    def __post_init__(self) -> None:
        require_range("noise", self.mhz, 1e-3, 1e3, "mHz")
        if self.n_draws < 1:
            raise ValueError(f"the noise must be drawn once or more, got {self.n_draws}")
        if self.seed < 0:
            raise ValueError(f"the seed of the noise must be 0 or more, got {self.seed}")


@dataclass(frozen=True)
class FoundUnknown:
    """An unknown: its true `value` and where the search `start`s, the `estimate` and its interval from the first draw
    of the noise, the mean `half_width` of all intervals, and the share of them that `covered` the value."""

    name: str
    unit: str
    value: float
    start: float
    estimate: float
    low: float
    high: float
    half_width: float
    covered: float


@dataclass(frozen=True)
class EstimationStudy:
    """What records of one run with noise say about its plant: `record` names the run, `noise_mhz` is the standard
    deviation of the noise. Of the first draw: `residual_mhz` is the standard deviation of the residuals, `n_runs` what
    the search took, `correlated` the two estimates that are correlated most, `correlation` how much they are."""

    record: str
    n_values: int
    duration_s: float
    noise_mhz: float
    n_draws: int
    seed: int
    residual_mhz: float
    n_runs: int
    correlated: tuple[str, ...]
    correlation: float
    unknowns: tuple[FoundUnknown, ...]


def study_own_run(
    names: Sequence[str] = UNKNOWNS,
    *,
    power_mw: float = 60.0,
    duration_s: float = 20.0,
    noise: Noise = Noise(),
    on_progress: Callable[[int], None] = lambda _: None,
) -> EstimationStudy:
    """Find parameters of the benchmark's plant from its frequency after a load step, every 0.1 s.

    Raises:
        ValueError: a name or a value is not allowed.
    """
    step = LoadStep(time_s=1.0, bus=4, power_mw=power_mw)
    scenario = Scenario(name="load step", wind_speed=np.array([[8.0], [9.0]]), events=(step,), duration_s=duration_s)
    settings = EnvSettings(version="v0", scenario=scenario)
    unknowns = [unknown_of(settings.plant(), name) for name in names]
    estimator = Estimator(settings, scenario, unknowns, range(round(duration_s / settings.control_dt)))
    record = estimator.run(np.ones(len(unknowns)))[0]
    text = f"own run, {power_mw:g} MW of load at bus 4 after 1 s, frequency of the centre of inertia"
    hz = settings.plant().case.frequency_hz
    return _study(estimator, record, text, hz, duration_s, noise, on_progress)


def study_recorded_run(
    parameters: Path,
    trace_path: Path,
    names: Sequence[str] = UNKNOWNS,
    *,
    events: str | None = None,
    column: str = "w1",
    bus: int = 2,
    control_dt: float = 0.0625,
    duration_s: float = 25.0,
    noise: Noise = Noise(),
    on_progress: Callable[[int], None] = lambda _: None,
) -> EstimationStudy:
    """Find parameters of another simulator's case from the speed of a machine in its trace.

    Args:
        parameters, trace_path: of the case.
        names: of the unknowns.
        events: event list of the parameter file; None as for :func:`choose_events`.
        column: of the trace, the speed of a machine.
        bus: of the converters, see :func:`recorded_case`.
        control_dt: rows of the trace at multiples of it are used [s].
        duration_s: up to this time [s].
        noise: that is added to the trace.
        on_progress: called with the number of draws done.

    Raises:
        ValueError: a file, a name or a value is not allowed.
    """
    case = read_parameters(parameters)
    trace, _ = read_trace(trace_path, case)
    happens = choose_events(case, trace_path, events)
    settings, scenario = recorded_case(case, happens, bus, control_dt=control_dt, duration_s=duration_s)
    speeds = [
        f"w{key}" for key, machine in zip(case.machine_keys, case.network.machines, strict=True) if machine.bus != bus
    ]
    if column not in speeds or column not in trace.columns:
        raise ValueError(f"the column must be one of {', '.join(speeds)} of the trace, got {column!r}")
    steps = np.rint(trace.time_s / control_dt).astype(np.int64)
    used = (steps > 0) & (np.abs(trace.time_s - steps * control_dt) < 1e-9) & (trace.time_s <= duration_s + 1e-9)
    unknowns = [unknown_of(settings.plant(), name) for name in names]
    output = f"machine_{speeds.index(column)}_speed_pu"
    estimator = Estimator(settings, scenario, unknowns, steps[used] - 1, output)
    text = f"{parameters.parent.name}/{trace_path.name}, column {column}"
    record, hz = trace.columns[column][used], case.network.frequency_hz
    return _study(estimator, record, text, hz, duration_s, noise, on_progress)


def _study(
    estimator: Estimator,
    record: Floats,
    text: str,
    hz: float,
    duration_s: float,
    noise: Noise,
    on_progress: Callable[[int], None],
) -> EstimationStudy:
    start = np.resize(STARTS, len(estimator.unknowns))
    found = estimates(estimator, record, 1e-3 * noise.mhz / hz, noise.n_draws, noise.seed, start, on_progress)
    first, values = found[0], np.array([unknown.value for unknown in estimator.unknowns])
    widths = np.mean([0.5 * (estimate.high - estimate.low) for estimate in found], axis=0)
    shares = covered(found, values)
    apart = np.abs(np.triu(first.correlation, 1))
    pair = np.unravel_index(int(apart.argmax()), apart.shape)
    return EstimationStudy(
        record=text,
        n_values=record.size,
        duration_s=duration_s,
        noise_mhz=noise.mhz,
        n_draws=noise.n_draws,
        seed=noise.seed,
        residual_mhz=1e3 * hz * first.noise,
        n_runs=first.n_runs,
        correlated=tuple(estimator.unknowns[i].name for i in pair) if apart.size > 1 else (),
        correlation=float(first.correlation[pair]) if apart.size > 1 else 0.0,
        unknowns=tuple(
            FoundUnknown(
                unknown.name,
                unknown.unit,
                unknown.value,
                float(start[i] * unknown.value),
                *(float(own[i]) for own in (first.values, first.low, first.high, widths, shares)),
            )
            for i, unknown in enumerate(estimator.unknowns)
        ),
    )


def estimation_table(study: EstimationStudy) -> str:
    """Return a study as a Markdown table."""
    rows = [
        (
            f"{own.name}{f' [{own.unit}]' if own.unit else ''}",
            f"{own.value:.5g}",
            f"{own.start:.4g}",
            f"{own.estimate:.4g}",
            f"{own.low:.4g} … {own.high:.4g}",
            f"{100.0 * own.half_width / own.value:.2g} %",
            f"{round(own.covered * study.n_draws)} of {study.n_draws}",
        )
        for own in study.unknowns
    ]
    heads = ("unknown", "true", "start", "found", "95 % interval", "mean half-width", "true value within")
    return markdown_table(heads, rows, right=tuple(range(1, len(heads))))
