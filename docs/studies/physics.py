"""For docs/physics.md: the paper's conclusions in its own plant, and in plants with more physics; some minutes."""

import numpy as np
from output import DOCS

from wtg_gym.envs.batch import TERMINATION_REASONS
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_LAW
from wtg_gym.physics.trajectory import simulate
from wtg_gym.plotting import plot_trajectories, save_figure
from wtg_gym.scenarios import get_suite

OTHERS = ("mppt", "deloaded-5", "deloaded-10")
INCREASE, DECREASE = get_suite("paper").scenarios([0, 1])
PLANTS = {"the paper's": Plant(), **{name: Plant().replaced(physics=name) for name in ("extended", "nrel-5mw")}}
SUITES, N_SCENARIOS = ("standard", "gust", "weak-grid", "low-wind"), 100
SECOND_STEP_S = 30.0  # of the load increase; the claims on nadir and RoCoF are about the first step [s]


def case_study(scenario, plant):
    """Return the runs of a case by strategy."""
    return {strategy: simulate(scenario, strategy, plant) for strategy in (REFERENCE_LAW, *OTHERS)}


def never_fails(plant):
    """Return whether no run of the suites fails under the reference, and how many do, with the first reason."""
    n_failed, reasons = 0, []
    for suite in map(get_suite, SUITES):
        scenarios = suite.scenarios(list(suite.validation[:N_SCENARIOS]))
        statuses = [simulate(scenario, REFERENCE_LAW, plant).status for scenario in scenarios]
        if failed := [TERMINATION_REASONS[status] for status in statuses if status != Status.RUNNING]:
            n_failed += len(failed)
            reasons.append(f"{suite.name}: {len(failed)} {failed[0]}")
    text = f"{n_failed}/{N_SCENARIOS * len(SUITES) + 2}" + (f" ({', '.join(reasons)})" if reasons else "")
    return n_failed == 0, text


def fail_in_turn(runs):
    """Return whether the other strategies fail one after another, when, and why unless they stall."""
    others = [runs[strategy] for strategy in OTHERS]
    failed = [run.status != Status.RUNNING for run in others]
    ends_s = [float(run.time_s[-1]) for run in others]
    text = "/".join(f"{end:.1f}" if fails else "none" for fails, end in zip(failed, ends_s, strict=True))
    reasons = {TERMINATION_REASONS[run.status] for run in others if run.status not in (Status.RUNNING, Status.STALL)}
    text += f" ({', '.join(reasons)})" if reasons else ""
    return all(failed) and ends_s == sorted(set(ends_s)), text


def compared(runs, limit_s, quantity):
    """Return a quantity of the reference, those of the others, and a note where a run ends before `limit_s`.

    It is a function of a run and the samples before the limit, or before the first run ends.
    """
    end_s = min(limit_s, *(float(run.time_s[-1]) for run in runs.values()))
    values = {strategy: quantity(run, run.time_s < end_s) for strategy, run in runs.items()}
    note = f" until {end_s:.1f} s" if end_s < limit_s else ""
    return values.pop(REFERENCE_LAW), list(values.values()), note


def verdicts(plant, increase, decrease):
    """Return each conclusion, whether it holds in a plant, and its numbers."""
    assert all(runs[REFERENCE_LAW].status == Status.RUNNING for runs in (increase, decrease))
    yield "coordinated never fails", *never_fails(plant)
    yield "MPPT, 5, 10 % fail in turn [s]", *fail_in_turn(increase)
    nadir, nadirs, note = compared(increase, SECOND_STEP_S, lambda run, before: run.frequency_hz[before].min())
    below = [1e3 * (other - nadir) for other in nadirs]
    holds = min(below) > 0.0 and max(below) < 10.0
    yield "its nadir is lower, by < 10 mHz", holds, f"{min(below):.0f}…{max(below):.0f}{note}"
    rocof, rocofs, _ = compared(increase, SECOND_STEP_S, lambda run, before: np.abs(run.rocof_hz_s()[before]).max())
    yield "its RoCoF is smaller [Hz/s]", rocof < min(rocofs), f"{rocof:.3f} to {min(rocofs):.3f}"
    rise, (_, *rises), note = compared(
        decrease,
        DECREASE.duration_s,
        lambda run, before: run.rotor_speed_pu[before].max(axis=0) - run.rotor_speed_pu[0],
    )
    least = np.minimum(*rises)
    texts = ("/".join(f"{value:.2f}" for value in values) for values in (rise, least))
    holds = (rise < least).all()
    yield "its rotors rise less, load decrease [p.u.]", holds, " to ".join(texts) + note


if __name__ == "__main__":
    increases = {name: case_study(INCREASE, plant) for name, plant in PLANTS.items()}
    rows = {}
    for name, plant in PLANTS.items():
        for conclusion, holds, text in verdicts(plant, increases[name], case_study(DECREASE, plant)):
            rows.setdefault(conclusion, [conclusion]).append(f"{'yes' if holds else '**no**'}: {text}")
    save_figure(plot_trajectories(increases["extended"], INCREASE), DOCS / "physics" / "load-increase.svg")
    table = markdown_table(("the paper concludes", *PLANTS), rows.values())
    update_between_markers(DOCS / "physics.md", table, "survival")
