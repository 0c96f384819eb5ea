"""Time values with gradients of DiffPSSi and of `wtg_gym.gradients` on one case.

DiffPSSi is a differentiable simulator in PyTorch. It has no turbines, so the case is the grid of this benchmark without
its WTG groups, with a step of load in each of several runs side by side. Both integrate by the classical Runge-Kutta
method of fourth order. DiffPSSi's examples take steps of 5 ms, this package takes 25 ms; both steps are measured for
both. Compiling and building the grid are not counted, the power flow and the start of each run are.

DiffPSSi's torque is power over speed, which acts as a damping by the power, and is one here; it has no other damping.
Its subtransient equations lack some terms of GENROU's. So the results of the two are compared as well.

DiffPSSi is MIT-licensed; nothing in the package imports it.

Usage:
    pip install diffpssi==0.0.3
    python tests/gradients/time_diffpssi.py --page docs/performance.md
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib.metadata
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from wtg_gym.analysis.benchmarks.timing import machine
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.gradients import Tape
from wtg_gym.gradients.plant_parameters import PlantEnvSettings
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.machine_parameters import GovernorParameters, SynchronousMachineParameters
from wtg_gym.physics.network import Branch, Bus, NetworkCase
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.scenario import LoadStep, Scenario

# Its default is NumPy, without gradients; this variable alone says otherwise.
os.environ["DIFFPSSI_FORCE_SIM_BACKEND"] = "torch"
from diffpssi.power_sim_lib.models import static_models
from diffpssi.power_sim_lib.models.exciters import SEXS
from diffpssi.power_sim_lib.models.governors import TGOV1
from diffpssi.power_sim_lib.models.synchronous_machine import SynchMachine
from diffpssi.power_sim_lib.simulator import PowerSystemSimulation

Floats = npt.NDArray[np.float64]

N_RUNS, SECONDS, SAMPLE_S = 64, 2.0, 0.1
REPEATS, LEAST_S = 3, 1.0
N_SAMPLES = round(SECONDS / SAMPLE_S)
STEPS_S = (0.025, 0.005)
STEP_BUS = 4
STEPS_MW = np.linspace(20.0, 60.0, N_RUNS)
#: What the generator at bus 1 feeds in before the step, on its base: the damping that DiffPSSi's torque brings [p.u.].
GENERATOR_POWER_PU = 0.447


class Found(NamedTuple):
    """What both return for every run."""

    deviation_hz: Floats  # of the centre of inertia's frequency, every `SAMPLE_S` (n_samples, n_runs)
    gradient: Floats  # of the mean of its square, with respect to each machine's 2H [Hz²/s] (n_runs, n_machines)


Solver = Callable[[], Found]


class Row(NamedTuple):
    """Something to time."""

    name: str
    step_s: float
    threads: int
    solve: Solver


def grid() -> NetworkCase:
    """Return the grid: the benchmark's, with the damping of DiffPSSi."""
    case = modified_ieee14()
    damping = {case.slack_bus: GENERATOR_POWER_PU}
    machines = (dataclasses.replace(m, damping_pu=damping.get(m.bus, 0.0)) for m in case.machines)
    return dataclasses.replace(case, machines=tuple(machines))


def ours(case: NetworkCase, step_s: float) -> Solver:
    """Return value and gradient by the tape, on one thread."""
    plant = PlantSettings(case=case, groups=(), control_dt=SAMPLE_S, simulation_dt=step_s)
    names = [f"machines.{m.bus}.two_h_s" for m in case.machines]
    tape = Tape(PlantEnvSettings.of(EnvSettings(version="v0"), plant), N_RUNS, 1, names)
    scenarios = [
        Scenario(
            name="step",
            wind_speed=np.zeros((0, 1)),
            duration_s=SECONDS,
            events=(LoadStep(time_s=0.0, bus=STEP_BUS, power_mw=power),),
        )
        for power in STEPS_MW
    ]
    actions = np.zeros((N_SAMPLES, N_RUNS, tape.lanes.n_action))
    frequency = tape.output_names.index("frequency_pu")

    def solve() -> Found:
        outputs = tape.play(scenarios, actions).outputs
        deviation = case.frequency_hz * (outputs[:, :, frequency] - 1.0)
        seeds = np.zeros_like(outputs)
        seeds[:, :, frequency] = 2.0 * case.frequency_hz * deviation / N_SAMPLES
        return Found(deviation, tape.back(outputs=seeds)[2])

    return solve


class WithStep(PowerSystemSimulation):
    """A simulation of DiffPSSi with a step of load in each run; by itself it knows short circuits alone."""

    def initialize(self) -> None:
        """Solve the power flow; the runs begin with the additional load."""
        super().initialize()
        at = self.bus_idxs[str(STEP_BUS)]
        voltage = self.busses[at].voltage[:, 0].abs()
        self.dynamic_y_matrix[:, at, at] += torch.tensor(STEPS_MW) / self.base_mva / voltage**2


class BesideLoad(SynchMachine):
    """A machine of DiffPSSi that starts with its own power: by itself it takes that of its bus, less the load there."""

    load: complex

    def initialize(self, s_calc: Any, v_bb: Any) -> None:
        """Start at the power of the bus [p.u.] and its voltage [p.u.]."""
        super().initialize(s_calc + self.load, v_bb)


def add_bus(sim: PowerSystemSimulation, bus: Bus) -> None:
    """Add a bus with its load and its shunt."""
    name, base = str(bus.number), sim.base_mva
    sim.add_bus(static_models.Bus(name=name, v_n=1.0))
    if bus.load_mw or bus.load_mvar:
        sim.add_load(static_models.Load(base, name=f"load {name}", bus=name, p=bus.load_mw, q=bus.load_mvar, model="Z"))
    if bus.shunt_mvar:
        add_shunt(sim, bus.number, bus.shunt_mvar / base)


def add_shunt(sim: PowerSystemSimulation, bus: int, susceptance: float) -> None:
    """Add a shunt [p.u.] at a bus."""
    base, name = sim.base_mva, str(bus)
    sim.add_shunt(static_models.Shunt(base, name=f"shunt {name}", bus=name, v_n=1.0, q=base * susceptance, model="Z"))


def add_branch(sim: PowerSystemSimulation, branch: Branch) -> None:
    """Add a line or a transformer. DiffPSSi knows no taps: a reactance with a tap is another one between two shunts."""
    assert branch.tap == 1.0 or branch.resistance == branch.charging == 0.0
    from_bus, to_bus = str(branch.from_bus), str(branch.to_bus)
    sim.add_line(
        static_models.Line(
            sim.base_mva,
            1.0,
            name=f"{from_bus}-{to_bus}",
            from_bus=from_bus,
            to_bus=to_bus,
            length=1.0,
            s_n=sim.base_mva,
            v_n=1.0,
            unit="p.u.",
            r=branch.resistance,
            x=branch.reactance * branch.tap,
            b=branch.charging,
        )
    )
    if branch.tap != 1.0:
        share = (1.0 - branch.tap) / (branch.tap * branch.reactance)
        add_shunt(sim, branch.from_bus, -share / branch.tap)
        add_shunt(sim, branch.to_bus, share)


def add_machine(sim: PowerSystemSimulation, m: SynchronousMachineParameters, bus: Bus) -> SynchMachine:
    """Add a machine with its exciter and its governor, and return it."""
    found = BesideLoad(
        sim.fn,
        sim.base_mva,
        1.0,
        name=f"machine {m.bus}",
        bus=str(m.bus),
        s_n=m.rating_mva,
        v_n=1.0,
        p=m.dispatch_mw,
        v=bus.voltage_pu,
        h=0.5 * m.two_h_s,
        d=0.0,
        x_d=m.x_d,
        x_q=m.x_q,
        x_d_t=m.x_d_transient,
        x_q_t=m.x_q_transient,
        x_d_st=m.x_subtransient,
        x_q_st=m.x_subtransient,
        t_d0_t=m.t_d0_transient_s,
        t_q0_t=m.t_q0_transient_s,
        t_d0_st=m.t_d0_subtransient_s,
        t_q0_st=m.t_q0_subtransient_s,
    )
    found.load = complex(bus.load_mw, bus.load_mvar) / sim.base_mva
    sim.add_generator(found)
    e, g = m.exciter, m.governor
    assert e is not None
    sim.add_exciter(
        SEXS(
            name=f"exciter {m.bus}",
            gen=found.name,
            t_a=e.lead_lag_ratio * e.lag_time_s,
            t_b=e.lag_time_s,
            t_e=e.exciter_time_s,
            k=e.gain,
            e_min=e.field_min_pu,
            e_max=e.field_max_pu,
        )
    )
    if isinstance(g, GovernorParameters):
        sim.add_governor(
            TGOV1(
                name=f"governor {m.bus}",
                gen=found.name,
                r=g.droop_pu,
                d_t=g.turbine_damping_pu,
                t_1=g.gate_time_s,
                t_2=g.lead_time_s,
                t_3=g.reheat_time_s,
                v_min=g.gate_min_pu,
                v_max=g.gate_max_pu,
            )
        )
    return found


def diffpssi(case: NetworkCase, step_s: float, threads: int) -> tuple[Solver, int]:
    """Return value and gradient by DiffPSSi on some threads, and the number of its states."""
    sim = WithStep(step_s, SECONDS, N_RUNS, "rk4", verbose=False)
    sim.fn, sim.base_mva, sim.base_voltage = case.frequency_hz, case.base_mva, 1.0
    for bus in case.buses:
        add_bus(sim, bus)
    for branch in case.branches:
        add_branch(sim, branch)
    machines = [add_machine(sim, m, case.buses[case.bus_index(m.bus)]) for m in case.machines]
    sim.set_slack_bus(str(case.slack_bus))
    sim.set_record_function(lambda _: [m.omega.real for m in machines])
    ratings = torch.tensor([m.rating_mva for m in case.machines])
    every = round(SAMPLE_S / step_s)

    def solve() -> Found:
        torch.set_num_threads(threads)
        two_h = torch.tensor([[m.two_h_s for m in case.machines]] * N_RUNS, requires_grad=True)
        for i, each in enumerate(machines):
            each.h = 0.5 * two_h[:, i : i + 1]
        sim.reset()
        speeds = sim.run()[1][:, every - 1 :: every]
        weights = two_h * ratings
        deviation = case.frequency_hz * (speeds * weights[:, None]).sum(2) / weights.sum(1, keepdim=True)
        (deviation**2).mean(1).sum().backward()
        return Found(deviation.detach().numpy().T, two_h.grad.numpy())

    sim.initialize()
    return solve, sum(m.get_state_vector().shape[1] for m in machines)


def core_times(rows: list[Row]) -> tuple[list[float], list[Found]]:
    """Return the processor time [s] of each row, least of several means over `LEAST_S` in turns, and what it finds."""
    # The first call compiles.
    found = [row.solve() for row in rows]
    times = [float("inf")] * len(rows)
    for _ in range(REPEATS):
        for i, row in enumerate(rows):
            n, passed, begin = 0, 0.0, time.process_time()
            while passed < LEAST_S:
                row.solve()
                n, passed = n + 1, time.process_time() - begin
            times[i] = min(times[i], passed / n)
    return times, found


def three_digits(value: float) -> str:
    """Return a number with three digits, without an exponent."""
    return f"{float(f'{value:.3g}'):,g}"


def difference(one: Floats, other: Floats) -> str:
    """Return the largest difference as a share of the largest value."""
    return f"{100.0 * np.abs(one - other).max() / np.abs(other).max():.2g} %"


def main() -> None:
    """Measure, print the table, and put it between the markers `bench:gradients-peers` of a page."""
    parser = argparse.ArgumentParser(description="Time values with gradients of DiffPSSi and of wtg_gym.gradients.")
    parser.add_argument(
        "--page", help="Markdown file with the markers 'bench:gradients-peers' to put the table between"
    )
    arguments = parser.parse_args()
    torch.set_default_dtype(torch.float64)
    case, rows, n_states = grid(), [], 0
    name = f"DiffPSSi {importlib.metadata.version('diffpssi')}, torch {torch.__version__}"
    default = torch.get_num_threads()
    for step_s in STEPS_S:
        for threads in sorted({1, default}):
            solve, n_states = diffpssi(case, step_s, threads)
            rows.append(Row(name, step_s, threads, solve))
        rows.append(Row("wtg_gym.gradients", step_s, 1, ours(case, step_s)))
    times, found = core_times(rows)
    cells = [
        (
            row.name,
            f"{1e3 * row.step_s:g}",
            str(row.threads),
            three_digits(seconds),
            three_digits(N_RUNS / seconds),
            three_digits(1e6 * seconds * row.step_s / (N_RUNS * SECONDS)),
        )
        for row, seconds in zip(rows, times, strict=True)
    ]
    header = ("simulator", "step [ms]", "threads", "core time [s]", "runs per s of core time", "µs per run and step")
    table = markdown_table(header, cells, right=range(1, len(header)))
    text = (
        f"{machine()}; least processor time of {REPEATS}, of all threads together.\n\n"
        f"{N_RUNS} runs of {SECONDS:g} s side by side: {len(case.buses)} buses, {len(case.machines)} machines with "
        f"exciters, one with a governor, {n_states} states; {STEPS_MW[0]:g} … {STEPS_MW[-1]:g} MW of load at bus "
        f"{STEP_BUS} from the start on. Gradient of the mean square of the frequency's deviation, taken every "
        f"{SAMPLE_S:g} s, with respect to the inertia of each machine in each run.\n\n{table}\n\n"
        f"With steps of {1e3 * STEPS_S[-1]:g} ms the two differ by at most "
        f"{difference(found[-1].deviation_hz, found[-2].deviation_hz)} of the largest deviation and "
        f"{difference(found[-1].gradient, found[-2].gradient)} of the largest derivative."
    )
    print(text)
    if arguments.page is not None:
        update_between_markers(Path(arguments.page), text, "bench:gradients-peers")


if __name__ == "__main__":
    main()
