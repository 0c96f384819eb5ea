"""For docs/validation.md: other simulators' traces, and the error of the integration step.

Three minutes. The golden cases are described in tests/golden/README.md.
"""

import dataclasses

import numpy as np
from output import DOCS

from tests.golden.case import TRACES, read_case, read_trace
from tests.golden.replay import differences, replay
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import group_laws
from wtg_gym.plotting import style
from wtg_gym.scenarios import get_suite

DEFAULT_S = Plant().simulation_dt
FINE_S = 0.00125  # half of it changes a golden run by less than a tenth of its tolerance [s]

STEPS_S = (0.0025, 0.005, 0.01, 0.02, DEFAULT_S, 0.1 / 3.0)  # each divides the control step of 0.1 s
EXACT_S = 0.0005  # the run that the others are compared with [s]
N_SCENARIOS = 100
RUNS = {"v0": 0.0, "v1": 0.0, "v1, random actions held for 0.5 s": 1.0}  # and how far actions go to either side
QUANTITIES = {"frequency": "Hz", "rotor speed": "p.u.", "power": "p.u."}


def golden_summary():
    """Return how many traces agree, and the largest difference of each quantity."""
    deviations, n_agree = {}, 0
    for path in TRACES:
        case = read_case(path.parent.name)
        times, trace = read_trace(path)
        fine = differences(case, trace, replay(case, case.events[path.stem], times, FINE_S))
        n_agree += all(fine[quantity] <= limit for quantity, limit in case.tolerance.items())
        deviations[path] = fine
    largest = []
    for quantity in ("w", "Pe", "V"):
        path = max(deviations, key=lambda path: deviations[path][quantity])
        largest.append(f"{quantity} {deviations[path][quantity]:.1e} ({path.parent.name}, {path.stem})")
    return (
        f"{n_agree} of {len(deviations)} traces agree within their tolerances. Largest differences at a step of "
        f"{1e3 * FINE_S:g} ms [p.u.]: {', '.join(largest)}."
    )


def samples(run, step_s):
    """Play scenarios of the standard suite under its law; return every quantity every 0.1 s.

    Returns (n_steps, num_envs, 3, n_wtg), NaN after a run's end and once load has been shed, which happens at a step,
    and the status of every run.
    """
    environment, rng = EnvSettings(version=run[:2]), np.random.default_rng(0)
    suite = get_suite(environment.suite_name)
    plant = dataclasses.replace(environment.resolved_plant, simulation_dt=step_s)
    hertz = plant.case.frequency_hz
    seeds, sizes = list(suite.validation[:N_SCENARIOS]), [group.n_turbines for group in plant.groups]
    scenarios = suite.scenarios(seeds, n_turbines=sizes)
    laws = group_laws(environment.strategy, plant.turbines, plant.control)
    simulator = Simulator(plant, num_envs=len(scenarios), duration_s=suite.duration_s)
    simulator.start(range(len(scenarios)), simulator.prepare(scenarios, laws))
    values = []
    rows = [simulator.layout.wtg(name) for name in ("k_offset", "inv_tau")]
    authority = environment.task.k_authority * (tracking_point(0.0, plant.turbine).coefficient - laws[0].k_max)
    for interval in range(simulator.n_intervals):
        if interval % environment.n_intervals == 0:
            k, tau = RUNS[run] * rng.uniform(-1.0, 1.0, (2, *simulator.blocks[:, rows[0], :].shape))
            simulator.blocks[:, rows[0], :] = authority * k
            faster = 4.0 ** (environment.task.tau_authority * tau)
            simulator.blocks[:, rows[1], :] = laws[0].inverse_time_constant * faster
        simulator.advance()
        simulator.evaluate()
        quantities = [
            hertz * (simulator.wtg_values("speed") + simulator.wtg_values("shift")),
            simulator.wtg_values("rotor_speed"),
            simulator.wtg_values("power"),
        ]
        running = (simulator.env_values("status") == Status.RUNNING) & (simulator.env_values("shed_energy") == 0.0)
        values.append(np.where(running[:, None, None], np.stack(quantities, axis=1), np.nan))
    status = simulator.env_values("status").copy()
    simulator.close()
    return np.array(values), status


def errors(run):
    """Return the largest error of each quantity in each scenario, (n_steps, n_scenarios, 3), and of the exact run."""
    exact, status = samples(run, EXACT_S)
    deviations = []
    for step_s in (2.0 * EXACT_S, *STEPS_S):
        values, value_status = samples(run, step_s)
        assert (value_status == status).all(), f"{run}: another run fails with steps of {1e3 * step_s:g} ms"
        deviations.append(np.nanmax(np.abs(values - exact), axis=(0, 3)))
    return np.array(deviations[1:]), deviations[0]


def step_table(results):
    """Return median and worst error of the default step in each kind of run."""
    rows, i = [], STEPS_S.index(DEFAULT_S)  # the picture has the other steps
    for run, (error, _) in results.items():
        cells = [f"{np.median(error[i, :, q]):.1e} / {error[i, :, q].max():.1e}" for q in range(len(QUANTITIES))]
        rows.append([f"{1e3 * DEFAULT_S:.3g}", run, *cells])
    header = ("step [ms]", "runs", *(f"{name} [{unit}]" for name, unit in QUANTITIES.items()))
    doubling = max(float(doubled[:, 0].max()) for _, doubled in results.values())
    return (
        f"Largest error of any group against steps of {1e3 * EXACT_S:g} ms (twice as long ones change {doubling:.0e} "
        f"Hz at most) in {N_SCENARIOS} validation scenarios of each standard suite, until load is shed: median / "
        "worst.\n\n" + markdown_table(header, rows, right=(0,))
    )


@style.printed
def draw(results):
    """Draw the error of frequency and of power against the step; dotted the median scenario, full the worst."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 70.0)
    steps = 1e3 * np.array(STEPS_S)
    for axes, quantity in zip(figure.subplots(1, 2, sharex=True), ("frequency", "power"), strict=True):
        q = list(QUANTITIES).index(quantity)
        for run, colour, marker in zip(results, style.PALETTE, "os^D", strict=False):
            error = results[run][0][:, :, q]
            axes.loglog(steps, error.max(axis=1), marker=marker, color=colour, label=f"{run}: worst")
            axes.loglog(steps, np.median(error, axis=1), ":", color=colour, label=f"{run}: median")
        median = np.median(results["v0"][0][:, :, q], axis=1)
        guide = median[-1] * (steps / steps[-1]) ** 4
        axes.loglog(steps, guide, color=style.REFERENCE_GREY, linewidth=0.6, label="fourth order")
        axes.axvline(1e3 * DEFAULT_S, color=style.REFERENCE_GREY, linestyle=(0.0, (5.0, 2.0)))
        axes.set_xticks(steps, [f"{step:.3g}" for step in steps], minor=False)
        axes.set_xticks([], minor=True)
        axes.set_xlabel("step [ms]")
        axes.set_ylabel(f"error of {quantity} [{QUANTITIES[quantity]}]")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


if __name__ == "__main__":
    results = {run: errors(run) for run in RUNS}
    style.save_figure(draw(results), DOCS / "validation" / "accuracy.svg")
    update_between_markers(DOCS / "validation.md", step_table(results), "accuracy")
    update_between_markers(DOCS / "validation.md", golden_summary(), "golden")
