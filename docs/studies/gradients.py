"""For docs/gradients.md: what one per cent more of every parameter does to nadir, RoCoF and rotor speed.

Two minutes, and two more where nothing is compiled yet. A measure is one number of an episode at one instant; its
gradient with respect to all parameters together is one pass back through the episode.
"""

import dataclasses

import numpy as np
from output import folder

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.gradients import Tape, known_parameters
from wtg_gym.scenarios import get_suite

SUITE, SEEDS, N_ROWS = "standard", range(10_000, 10_020), 8
MEASURES = ("nadir [mHz]", "RoCoF [mHz/s]", "rotor speed [0.001 p.u.]")
SHARE = 1e-5  # by which k_nominal is moved to and fro


def measure(tape, scenario):
    """Play a scenario in every lane; return the measures [Hz, Hz/s, p.u.], and step, output and factor of each."""
    n_steps = round(tape.lanes.duration_s / 0.1)
    actions = np.zeros((n_steps, tape.lanes.n_lanes, tape.lanes.n_action))
    run = tape.play([scenario] * tape.lanes.n_lanes, actions).outputs[:, 0]
    rotors = [i for i, name in enumerate(tape.output_names) if name.startswith("rotor_")]
    lowest, steepest = int(run[:, 0].argmin()), int(np.abs(run[:, 1]).argmax())
    slowest, rotor = np.unravel_index(int(run[:, rotors].argmin()), (n_steps, len(rotors)))
    places = [
        (lowest, 0, tape.lanes.nominal_hz),
        (steepest, 1, float(np.sign(run[steepest, 1]))),
        (int(slowest), rotors[rotor], 1.0),
    ]
    return np.array([factor * run[step, output] for step, output, factor in places]), places


def effects(tape, moved, scenario, values):
    """Return the measures of a scenario, and what one per cent more of each parameter does to them, in thousandths."""
    found, places = measure(tape, scenario)
    n_steps = round(tape.lanes.duration_s / 0.1)
    seeds = np.zeros((n_steps, len(MEASURES), len(tape.output_names)))
    for lane, (step, output, factor) in enumerate(places):
        seeds[step, lane, output] = factor
    _, of_law, of_plant = tape.back(outputs=seeds)
    # All groups together; one per cent more of τ is one per cent less of 1/τ.
    law = (of_law * tape.law() * (1.0, 1.0, 1.0, -1.0)).sum(axis=1)
    # k_nominal moves the equilibrium before the run as well: its effect is the difference of two runs.
    up, down = (measure(other, scenario)[0] for other in moved)
    law[:, 1] = (up - down) / (2.0 * SHARE)
    return found, 10.0 * np.concatenate([of_plant * values, law], axis=1).T


def main(docs):
    """Renew the page."""
    settings = EnvSettings(suite=SUITE)
    # A parameter of value 0 has no per cent.
    known = {name: value for name, value in known_parameters(settings.plant()).items() if value != 0.0}
    tape = Tape(settings, len(MEASURES), parameters=tuple(known))
    law = tape.lanes.laws[0]
    shifted = [dataclasses.replace(law, k_nominal=law.k_nominal * (1.0 + share)) for share in (SHARE, -SHARE)]
    moved = [Tape(dataclasses.replace(settings, strategy=other), 1) for other in shifted]
    droop = list(known).index("machines.1.governor.droop_pu")
    measures, found, in_force = [], [], []
    for scenario in get_suite(SUITE).scenarios(list(SEEDS)):
        values = np.array(list(known.values()))
        values[droop] = scenario.governor_droop or values[droop]
        own, of_parameters = effects(tape, moved, scenario, values)
        measures.append(own)
        found.append(of_parameters)
        in_force.append(values)
    names = (*known, "law.k_min", "law.k_nominal", "law.k_max", "law.tau_s")
    values = (*np.mean(in_force, axis=0), law.k_min, law.k_nominal, law.k_max, law.damping_time_constant_s)
    sizes, means = np.abs(found).mean(axis=0), np.mean(found, axis=0)
    # Effects on a measure count as shares of the largest one on it, and a parameter by its largest share.
    order = np.argsort(-(sizes / sizes.max(axis=0)).max(axis=1), kind="stable")[:N_ROWS]
    rows = [(names[i], f"{values[i]:.4g}", *(f"{value:+.3g}" for value in means[i])) for i in order]
    nadir, rocof, rotor = np.mean(measures, axis=0)
    text = (
        f"Means over {len(SEEDS)} scenarios of {SUITE} under {settings.strategy}: nadir {nadir:.3f} Hz, largest RoCoF "
        f"{rocof:.3f} Hz/s, least rotor speed {rotor:.4f} p.u. Effect of one per cent more:\n\n"
        + markdown_table(("1 % more of", "value", *MEASURES), rows, right=range(1, 5))
    )
    update_between_markers(docs / "gradients.md", text, "influence")


if __name__ == "__main__":
    main(folder(__doc__))
