"""Influence of every parameter of plant and law on nadir, RoCoF and rotor speed, by gradients."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.files import markdown_table
from wtg_gym.gradients.plant_parameters import known_parameters
from wtg_gym.gradients.tape import Tape
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario
from wtg_gym.physics.tracking_law import TrackingLaw

#: Parameters of a law, for all groups in common.
LAW_NAMES = ("law.k_min", "law.k_nominal", "law.k_max", "law.tau_s")
#: Each measure: its unit, how much finer that is than Hz, Hz/s and p.u., and its meaning.
MEASURES = {
    "nadir": ("mHz", 1e3, "least frequency of the centre of inertia"),
    "rocof": ("mHz/s", 1e3, "largest size of its rate of change over 0.5 s"),
    "rotor_speed": ("0.001 p.u.", 1e3, "least speed of any rotor"),
}
#: Share by which k_nominal is moved to and fro.
_SHARE = 1e-5


@dataclass(frozen=True)
class Influences:
    """What parameters do to runs.

    `scenarios` names the runs; `values` holds each measure in each (n_scenarios, 3), [Hz, Hz/s, p.u.]; `effects` what
    one per cent more of each parameter does to it (n_scenarios, n_parameters, 3), in the units of `MEASURES`;
    `parameters` names them, with their `nominal` values, means over the scenarios.
    """

    scenarios: tuple[str, ...]
    parameters: tuple[str, ...]
    nominal: tuple[float, ...]
    values: Floats
    effects: Floats

    def order(self) -> list[int]:
        """Return the places of the parameters, those with the largest mean effect first.

        Effects on a measure count as shares of the largest one on it, and a parameter by its largest share.
        """
        size = np.abs(self.effects).mean(axis=0)
        shares = size / np.where(size.max(axis=0) > 0.0, size.max(axis=0), 1.0)
        return [int(place) for place in np.argsort(-shares.max(axis=1), kind="stable")]

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as JSON-ready data, parameters in :meth:`order`."""
        measures = tuple(MEASURES)
        return {
            "units": {name: MEASURES[name][0] for name in measures},
            "scenarios": [
                {"name": name, **dict(zip(measures, own.tolist(), strict=True))}
                for name, own in zip(self.scenarios, self.values, strict=True)
            ],
            "parameters": [
                {
                    "name": self.parameters[i],
                    "value": self.nominal[i],
                    "effect_of_one_percent": {name: self.effects[:, i, m].tolist() for m, name in enumerate(measures)},
                }
                for i in self.order()
            ],
        }


def measure_influences(
    settings: EnvSettings,
    scenarios: Sequence[Scenario],
    on_progress: Callable[[int], None] = lambda _: None,
    n_threads: int | None = None,
) -> Influences:
    """Play scenarios under their law and go back from each measure.

    A measure is that of the ends of control steps; its instant counts as given. A parameter of value 0 has no per cent,
    and is left out. k_nominal moves the equilibrium before the run as well: its effect is the difference of two runs.

    Raises:
        ValueError: gradients are not known for the settings, or a scenario does not fit them.
    """
    known = {name: value for name, value in known_parameters(settings.plant()).items() if value != 0.0}
    tape = Tape(settings, len(MEASURES), n_threads, tuple(known))
    moved = [
        Tape(dataclasses.replace(settings, strategy=[_with_k_nominal(law, share) for law in tape.lanes.laws]), 1, 1)
        for share in (_SHARE, -_SHARE)
    ]
    finer = np.array([scale for _, scale, _ in MEASURES.values()])
    values, effects = [], []
    for done, scenario in enumerate(scenarios):
        n_steps = round(min(scenario.duration_s, tape.lanes.duration_s) / settings.control_dt)
        found, places = _measured(tape, scenario, n_steps)
        seeds = np.zeros((n_steps, len(MEASURES), len(tape.output_names)))
        for measure, (step, output, factor) in enumerate(places):
            seeds[step, measure, output] = factor
        _, of_law, of_plant = tape.back(outputs=seeds)
        # One per cent of every group's k; of τ it is one per cent less of 1/τ.
        law = 0.01 * (of_law * tape.law() * (1.0, 1.0, 1.0, -1.0)).sum(axis=1)
        up, down = (_measured(other, scenario, n_steps)[0] for other in moved)
        law[:, 1] = 0.01 * (up - down) / (2.0 * _SHARE)
        in_force = np.array([_in_force(name, value, scenario) for name, value in known.items()])
        values.append(found)
        effects.append(finer * np.concatenate([0.01 * of_plant * in_force, law], axis=1).T)
        on_progress(done + 1)
    own = tape.lanes.laws[0]
    names = LAW_NAMES if own.inverse_time_constant > 0.0 else LAW_NAMES[:3]
    nominal = [float(np.mean([_in_force(name, value, each) for each in scenarios])) for name, value in known.items()]
    return Influences(
        scenarios=tuple(scenario.name for scenario in scenarios),
        parameters=(*known, *names),
        nominal=(*nominal, *(own.k_min, own.k_nominal, own.k_max, own.damping_time_constant_s)[: len(names)]),
        values=np.array(values),
        effects=np.array(effects)[:, : len(known) + len(names)],
    )


def _with_k_nominal(law: TrackingLaw, share: float) -> TrackingLaw:
    return dataclasses.replace(law, k_nominal=law.k_nominal * (1.0 + share))


def _measured(tape: Tape, scenario: Scenario, n_steps: int) -> tuple[Floats, list[tuple[int, int, float]]]:
    """Play a scenario in every lane; return its measures, and the step and output of each with a factor."""
    n_lanes, hz = tape.lanes.n_lanes, tape.lanes.nominal_hz
    run = tape.play([scenario] * n_lanes, np.zeros((n_steps, n_lanes, tape.lanes.n_action))).outputs[:, 0]
    rotors = [i for i, name in enumerate(tape.output_names) if name.startswith("rotor_")]
    # After an early end the outputs stand still: the first instant of an extreme is one of the run's.
    lowest, steepest = int(run[:, 0].argmin()), int(np.abs(run[:, 1]).argmax())
    slowest, rotor = np.unravel_index(int(run[:, rotors].argmin()), (n_steps, len(rotors)))
    places = [(lowest, 0, hz), (steepest, 1, float(np.sign(run[steepest, 1]))), (int(slowest), rotors[rotor], 1.0)]
    return np.array([factor * run[step, output] for step, output, factor in places]), places


def _in_force(name: str, value: float, scenario: Scenario) -> float:
    """Return a parameter's value in a scenario, whose droop takes the place of the governors'."""
    if name.endswith("governor.droop_pu") and scenario.governor_droop is not None:
        return scenario.governor_droop
    return value


def influences_table(found: Influences, n_rows: int) -> str:
    """Return what the parameters of most influence do, as a Markdown table: means over the scenarios."""
    means = found.effects.mean(axis=0)
    heads = ("1 % more of", "value", *(f"{name.replace('_', ' ')} [{unit}]" for name, (unit, *_) in MEASURES.items()))
    rows = [
        (found.parameters[i], f"{found.nominal[i]:.4g}", *(f"{value:+.3g}" for value in means[i]))
        for i in found.order()[:n_rows]
    ]
    return markdown_table(heads, rows, right=tuple(range(1, len(heads))))
