"""Plants with converter limits, voltage control, an energy-keeping rotor, shedding and hydro governors, for tests.

Two plants are compiled: the paper's curve, and a table with a hydro governor. Options are numbers within them.
"""

import dataclasses
import functools
import itertools

import numpy as np

from wtg_gym import LoadStep, Plant, Scenario, get_law, get_suite
from wtg_gym.physics import parameters
from wtg_gym.physics.grid import NetworkCase, get_grid
from wtg_gym.physics.machine_parameters import GovernorParameters, HydroGovernorParameters, classical_machine
from wtg_gym.physics.scenario import Event
from wtg_gym.physics.simulator import Simulator
from wtg_gym.systems.systems import Kind

#: Limits, voltage control, rotor that keeps its energy: all but none of them.
OPTIONS = [options for options in itertools.product((False, True), repeat=3) if any(options)]
#: As many stages as Europe's, so that the plant is compiled once; without an effect.
NO_SHEDDING = tuple(dataclasses.replace(stage, share=0.0) for stage in parameters.european_shedding())
LAW = "coordinated-piecewise"
WIND = np.array([[11.4], [8.0]])
CURRENT_MAX = parameters.ConverterLimitParameters().current_max_pu
#: A constant voltage behind a reactance of ordinary size, at a bus.
classical = functools.partial(classical_machine, rating_mva=100.0, dispatch_mw=0.0, two_h_s=10.0, x_d_transient=0.2)


def plant(*, table=False, limits=True, voltage=True, energy=True, dead_band: float = 0.0, **more) -> Plant:
    """Extended plant of these options; limits and voltage control may be given by their parameters."""
    governor = HydroGovernorParameters if table else GovernorParameters
    turbine = parameters.nrel_5mw if table else parameters.TurbineParameters
    given = {
        "case": with_machine(governor=governor(dead_band_pu=dead_band)),
        "turbine": turbine(conserves_energy=energy),
        "limits": parameters.ConverterLimitParameters() if limits is True else limits or None,
        "voltage_control": parameters.VoltageControlParameters() if voltage is True else voltage or None,
        "shedding": parameters.european_shedding(),
    }
    return Plant(**{**given, **more})


def with_machine(**changes) -> NetworkCase:
    """The default network with other data of the machine at bus 1."""
    case = get_grid("ieee14").case
    return dataclasses.replace(case, machines=(dataclasses.replace(case.machines[0], **changes), *case.machines[1:]))


def scenario(*events: Event, wind=WIND, **more) -> Scenario:
    return Scenario(name="x", wind_speed=np.asarray(wind, dtype=float), events=events, **more)


def started(settings: Plant, what: Scenario, law: str = LAW, duration_s: float = 60.0) -> Simulator:
    simulator = Simulator(settings, duration_s=duration_s)
    simulator.start(0, what, (get_law(law, settings.turbine),) * len(settings.groups))
    return simulator


def recorded(simulator: Simulator, seconds: float, *names: str, act=None) -> dict[str, np.ndarray]:
    """Numbers of the groups at the end of every control interval, until the run ends, and the frequency "coi"."""
    result = {name: [] for name in ("coi", *names)}
    for interval in range(round(seconds / simulator.settings.interval_s)):
        if act is not None:
            simulator.blocks[0, simulator.layout.wtg("k_offset"), 0] = act(interval)
        simulator.advance()
        result["coi"].append(simulator.env_values("coi")[0])
        for name in names:
            result[name].append(simulator.wtg_values(name)[0])
        if simulator.env_values("active")[0] < 0.5:
            break
    return {name: np.array(values) for name, values in result.items()}


def phasors(simulator: Simulator, kind: Kind, part: str) -> np.ndarray:
    """Voltages, currents or admittances of every unit of a kind in a single run at its present state [p.u.]."""
    # Of a copy: the run's outputs stay as they are.
    scratch, first = simulator._evaluated(simulator.blocks.copy())[0, :, 0], simulator.layout.first_rows(kind, part)
    return scratch[first] + 1j * scratch[first + 1]


def numbers(simulator: Simulator, kind: Kind, part: str) -> np.ndarray:
    """A part of the first run's state for every unit of a kind; of a complex one, its real part."""
    return simulator.blocks[0, simulator.layout.first_rows(kind, part), 0]


def largest_rate(simulator: Simulator) -> float:
    """Largest |dx/dt|; the energies, which grow in every equilibrium, do not count."""
    keep = [i for i, name in enumerate(simulator.layout.state_names) if "energy" not in name]
    simulator.evaluate()
    return float(np.abs(simulator.rates()[keep]).max())


def fault(time_s: float = 1.0, duration_s: float = 0.15, bus: int = 2) -> tuple[LoadStep, ...]:
    """A short circuit nearby: its reactance takes 2000 Mvar at nominal voltage."""
    return pulse(bus, reactive_mvar=2000.0, from_s=time_s, until_s=time_s + duration_s)


def pulse(bus: int, power_mw: float = 0.0, reactive_mvar: float = 0.0, from_s: float = 1.0, until_s: float = 21.0):
    return tuple(
        LoadStep(time_s=time_s, bus=bus, power_mw=sign * power_mw, reactive_mvar=sign * reactive_mvar)
        for time_s, sign in ((from_s, 1.0), (until_s, -1.0))
    )


def rough(seed: int) -> Scenario:
    """A scenario of a suite with a large load step more, and every third time a fault."""
    rng = np.random.default_rng(seed)
    drawn = get_suite(("standard", "weak-grid", "gust", "low-wind")[seed % 4]).scenario(20_000 + seed)
    place = {"time_s": 5.0 + round(float(rng.uniform(0.0, 10.0)), 1), "bus": int(rng.integers(2, 15))}
    size = {"power_mw": float(rng.uniform(-150.0, 250.0)), "reactive_mvar": float(rng.uniform(-50.0, 50.0))}
    step = LoadStep(**place, **size)
    return dataclasses.replace(drawn, events=(*drawn.events, step, *(fault(20.0, bus=4) if seed % 3 == 0 else ())))
