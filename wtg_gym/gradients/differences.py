"""Gradients compared with differences of plays: what a user asks before trusting them in a new setting."""

import functools
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from wtg_gym.files import markdown_table
from wtg_gym.gradients.tape import LAW_PARAMETERS, Tape, term_weights
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.scenario import Scenario


class Difference(NamedTuple):
    """Slopes of each episode's cost as something moves, by the gradient and by plays (num_envs,).

    Each is in the cost's unit per unit of what moves: of the direction through the actions, of a number of the law
    [p.u. or 1/s] in all groups alike, of a parameter of the plant in its own unit.
    """

    name: str  # "actions", one of LAW_PARAMETERS or a parameter of the plant
    gradient: Floats
    central: Floats  # from one step below to one step above
    below: Floats  # from one step below; not a number for a parameter of value 0, below which there is none
    above: Floats  # to one step above

    @property
    def error(self) -> Floats:
        """Distance of the gradient from the central difference, as a share of the larger of both (num_envs,)."""
        size = np.maximum(np.abs(self.gradient), np.abs(self.central))
        return np.abs(self.gradient - self.central) / np.where(size > 0.0, size, 1.0)


class Differences(tuple[Difference, ...]):
    """One :class:`Difference` for each thing moved; printed, it is a table of the episode with the largest error."""

    __slots__ = ()

    def __str__(self) -> str:
        rows = []
        for difference in self:
            name, *slopes = difference
            episode = int(np.argmax(difference.error))
            shown = (f"{slope[episode]:.6g}" for slope in slopes)
            rows.append([name, str(episode), *shown, f"{difference.error[episode]:.1e}"])
        header = ("moved", "episode", "gradient", "central difference", "slope below", "slope above", "error")
        return markdown_table(header, rows, right=range(1, len(header)))


def _compared(base: Floats, name: str, slope: Floats, up: Floats, down: Floats, h: float, h_below: float) -> Difference:
    below = (base - down) / h_below if h_below > 0.0 else np.full_like(base, math.nan)
    return Difference(name, slope, (up - down) / (h + h_below), below, (up - base) / h)


def check_by_differences(
    tape: Tape,
    scenarios: Sequence[Scenario],
    actions: Floats,
    weights: Mapping[str, float] | None = None,
    *,
    direction: Floats | None = None,
    step: float = 1e-5,
) -> Differences:
    """Compare the gradient of episodes' costs with differences of plays of the environment.

    What is moved, one after the other: the actions along one direction, each number of the laws (in all groups at
    once), each parameter that the tape was made for. Slopes on both sides are given too: where they differ, a corner or
    an event that moves lies between the plays, and no gradient can be both. The tape needs to be started again
    afterwards; it has the values of its parameters that it had. A ValueError names an argument that has another shape,
    is not finite or not in its range.

    Args:
        tape: of the settings in question.
        scenarios, actions, weights: as for :meth:`~wtg_gym.gradients.tape.Tape.gradient`.
        direction: through the actions, of their shape; None for normal numbers of a fixed seed.
        step: by which actions and laws move, and, as a share of its value, each parameter [-]; 1e-9 … 0.1. Shorter
            ones keep clear of corners, longer ones of rounding.
    """
    if not (isinstance(step, (int, float)) and 1e-9 <= step <= 0.1):
        raise ValueError(f"step must be a number in 1e-9 … 0.1, got {step!r}")
    actions, weight = np.asarray(actions, dtype=np.float64), term_weights(weights)
    delta = np.random.default_rng(0).normal(size=actions.shape) if direction is None else np.asarray(direction, float)
    if delta.shape != actions.shape or not np.isfinite(delta).all():
        raise ValueError(f"direction must be finite numbers of the actions' shape {actions.shape}, got {delta.shape}")
    gradient = tape.gradient(scenarios, actions, weights)
    tape.start(scenarios)
    law, values = tape.law(), tape.parameter_values()

    def cost(actions: Floats = actions, law: Floats = law, parameters: Mapping[str, float] | None = None) -> Floats:
        if parameters is not None:
            tape.set_parameters(parameters)
        tape.start(scenarios)
        tape.set_law(law)
        costs: Floats = np.sum([tape.step(each)[1] @ weight for each in actions], axis=0)
        return costs

    compared = functools.partial(_compared, cost())
    along = np.einsum("kla,kla->l", gradient.actions, delta)
    up, down = (cost(actions + h * delta) for h in (step, -step))
    rows = [compared("actions", along, up, down, step, step)]
    for i, name in enumerate(LAW_PARAMETERS):
        shift = step * (np.arange(len(LAW_PARAMETERS)) == i)
        up, down = (cost(law=moved) for moved in (law + shift, law - shift))
        rows.append(compared(name, gradient.law[:, :, i].sum(axis=1), up, down, step, step))
    for i, (name, value) in enumerate(values.items()):
        h = step * (abs(value) or 1.0)
        # Nothing lies below 0.
        h_below = h if value else 0.0
        up, down = (cost(parameters={name: moved}) for moved in (value + h, value - h_below))
        rows.append(compared(name, gradient.parameters[:, i], up, down, h, h_below))
        tape.set_parameters({name: value})
    return Differences(rows)
