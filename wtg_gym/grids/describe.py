"""A grid in words: sizes, power flow, equilibrium, modes, step."""

import dataclasses
import math
import re
import time
from collections import Counter
from collections.abc import Iterator

import numpy as np

from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.physics import equilibrium, linearisation, protection, tracking_law, trajectory
from wtg_gym.physics.grid import DEFAULT_GRID, Grid, get_grid, known_grids
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.simulator import Simulator, longest_step
from wtg_gym.scenarios import DEFAULT_SUITE, SUITES, suite_of_grid
from wtg_gym.tasks import V1

#: Wind at which all groups stand, and the law under which they do.
WIND_M_S, LAW = 10.0, "coordinated-tuned"

#: Voltages that a grid usually has [p.u.].
USUAL_VOLTAGE_PU = (0.9, 1.1)
#: Longer than a low voltage is ridden through [s].
_REST_S = 4.0
#: Scenarios that are tried, and how many must start: then 200 draws find one.
TRIED, LEAST_STARTS = 100, 15
#: Moving numbers up to which modes are computed: eigenvalues take their cube.
_MOST_MOVING, _PER_MACHINE = 2500, 15

Line = tuple[str, str]


def grid_of(name: str) -> tuple[Grid, str]:
    """Return the grid that version v1 plays by the name of a grid, its file, or a suite; and the suite."""
    suite = SUITES.get(DEFAULT_SUITE if name == DEFAULT_GRID else name)
    if suite is None or suite.task.version != V1.version:
        return get_grid(name), suite_of_grid(name)
    of_suite = next((grid for grid in known_grids() if suite_of_grid(grid) == suite.name), DEFAULT_GRID)
    grid = get_grid(of_suite)
    if of_suite == DEFAULT_GRID:
        # Each suite of 14 buses has machines and groups of its own.
        grid = dataclasses.replace(grid, case=suite.plant.case, groups=suite.plant.groups)
    return grid, suite.name


def describe_grid(grid: Grid) -> Iterator[Line]:
    """Yield what is in a grid."""
    case, machines = grid.case, grid.with_groups.machines if grid.groups else grid.case.machines
    governed = [machine for machine in machines if machine.governor is not None]
    rating, turbines = sum(m.rating_mva for m in machines), sum(group.n_turbines for group in grid.groups)
    replaced = len(case.machines) - len(machines)
    yield "name", case.name
    yield "network", f"{len(case.buses)} buses, {len(case.branches)} branches ({len(case.bridges)} of them bridges)"
    yield "base", f"{case.base_mva:g} MVA, {case.frequency_hz:g} Hz"
    yield "load", f"{case.load_mw:.1f} MW"
    yield "machines", f"{len(machines)}, {rating:.0f} MVA together, {len(governed)} with a governor"
    others = f", in place of {replaced} others" if replaced else ""
    yield "WTG groups", f"{len(grid.groups)}, {turbines:g} turbines together{others}"
    if odd := [f"{branch.from_bus}-{branch.to_bus}" for branch in case.branches if branch.reactance < 0.0]:
        yield "negative reactance", f"of branches {', '.join(odd)}"
    yield "source", f"{grid.source or 'not given'}; licence: {grid.licence or 'not given'}"
    for name, lines in (("repaired", grid.repairs), ("assumed", grid.substitutions)):
        for line in lines:
            yield name, line


def describe_equilibrium(grid: Grid) -> Iterator[Line]:
    """Yield what a grid is at its loads and a steady wind, without its groups where it has none."""
    case = grid.with_groups if grid.groups else grid.case
    shares = sum(machine.governor is not None for machine in case.machines) > 1 and bool(grid.groups)
    plant = Plant().replaced(physics="extended", case=case, groups=grid.groups, shares_dispatch=shares)
    step = longest_step(plant)
    plant = dataclasses.replace(plant, simulation_dt=step)
    yield "step", f"{1000.0 * step:g} ms"
    simulator = Simulator(plant, duration_s=1.0)
    wind = np.full((len(grid.groups), 1), WIND_M_S)
    scenario = Scenario(name="steady wind", wind_speed=wind, duration_s=1.0, load_noise_bus=case.slack_bus)
    simulator.start(0, scenario, tracking_law.group_laws(LAW, plant.turbines, plant.control))
    simulator.evaluate()
    voltages = np.abs(simulator.bus_voltages())
    begun = time.perf_counter()
    run = trajectory.simulate(dataclasses.replace(scenario, duration_s=_REST_S), LAW, plant)
    cost = f"a second takes {1e3 * (time.perf_counter() - begun) / max(run.time_s[-1], step):.3g} ms to simulate"
    if run.status != protection.Status.RUNNING:
        raise ValueError(
            f"without any event a run ends after {run.time_s[-1]:g} s by {run.status.name.lower().replace('_', ' ')}, "
            f"with voltages of {voltages.min():.3f} … {voltages.max():.3f} p.u. and "
            f"angles {np.ptp(np.angle(simulator.bus_voltages(), deg=True)):.0f}° apart; {cost}"
        )
    yield "cost of a run", cost
    yield "state below", f"{WIND_M_S:g} m/s, all groups under {LAW}"
    yield "voltages", f"{voltages.min():.3f} … {voltages.max():.3f} p.u."
    low, high = USUAL_VOLTAGE_PU
    if (beyond := np.flatnonzero((voltages < low) | (voltages > high))).size:
        first, last = (f"{voltages[at]:.3f} p.u. at bus {case.bus_numbers[at]}" for at in np.argsort(voltages)[[0, -1]])
        where = f"{beyond.size} of {voltages.size} buses: lowest {first}, highest {last}"
        yield f"beyond {low:g} … {high:g} p.u.", where
    rows, layout = simulator.blocks[0, :, 0], simulator.layout
    if layout.n_sync * _PER_MACHINE > _MOST_MOVING:
        yield "modes", "not computed for so many machines"
        return
    matrix, keep = linearisation.moving_matrix(rows, simulator.plant, layout, -1.0)
    yield "equilibrium", f"largest rate {np.abs(simulator.rates()[keep]).max():.1e} p.u./s"
    eigenvalues = np.linalg.eigvals(matrix).astype(np.complex128)
    for damping, hertz in linearisation.swing_modes(eigenvalues)[:3]:
        yield "mode", f"{hertz:.2f} Hz, damped by {100.0 * damping:.1f} %"
    growing = [
        f"{value.real:+.3g}/s" + (f" at {value.imag / math.tau:.2f} Hz" if value.imag else "")
        for value in eigenvalues.tolist()
        if value.real > 1e-6 and value.imag >= 0.0
    ]
    yield "stable", "yes" if not growing else f"no, modes grow: {', '.join(growing)}"


def describe_starts(suite: str) -> Iterator[Line]:
    """Yield how many scenarios of a suite start, why others do not, and what reset and step take; refuse too few."""
    # Whether a scenario starts does not depend on what its rewards are compared with, which takes most of a reset.
    batch = EnvBatch(EnvSettings(suite=suite, reward="cost"))
    seeds = range(batch.suite.seeds("train").start, batch.suite.seeds("train").start + TRIED)
    reasons, starts = Counter[str](), list[Scenario]()
    for scenario in batch.scenarios(seeds):
        try:
            batch.prepare([scenario])
            starts.append(scenario)
        except (equilibrium.StartError, linearisation.StepError) as error:
            reason = re.sub(r"^.*? cannot start: |; `.*", "", str(error))
            # The same reason at another operating point.
            reasons[re.sub(r"-?\d+(\.\d+)?(e-?\d+)?", "…", reason)] += 1
    n = len(starts)
    if n < LEAST_STARTS:
        texts = "; ".join(f"{times} do not: {reason}" for reason, times in reasons.most_common(2))
        raise ValueError(f"{n} of {TRIED} scenarios start, too few to train on; {texts}")
    yield "scenarios", f"{n} of {TRIED} start; others are drawn again"
    for reason, times in reasons.most_common(3):
        yield f"{times} do not", reason
    batch = EnvBatch(EnvSettings(suite=suite))
    batch.start([0], starts[:1])
    begun = time.perf_counter()
    batch.start([0], starts[-1:])
    began = time.perf_counter()
    for _ in range(steps := 10):
        batch.step(np.zeros((1, batch.n_action)))
    step = (time.perf_counter() - began) / steps
    yield "cost", f"a reset takes {1e3 * (began - begun):.3g} ms, a step {1e3 * step:.3g} ms"
