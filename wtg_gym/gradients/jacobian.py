"""How the outputs of an episode follow parameters, step by step: the whole Jacobian of a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.gradients.tape import Tape
from wtg_gym.physics.scenario import Scenario

Floats = npt.NDArray[np.float64]


class Response(NamedTuple):
    """Outputs of an episode under its law, and their derivatives."""

    outputs: Floats  # at the end of each step (n_steps, n_outputs), in the order of Tape.output_names
    parameters: Floats  # with respect to parameters (n_steps, n_outputs, n_parameters)
    law: Floats  # with respect to each group's law (n_steps, n_outputs, n_wtg, 4), in the order of LAW_PARAMETERS


class Responses:
    """Episodes without actions, and the derivatives of all that they show.

    One lane each goes back through a step from one number that it carries on, or from one output. Their cotangents are
    the rows of the step's Jacobian; the product of these, from the first step on, is that of the run.

    Args:
        settings, parameters, n_threads: as for :class:`~wtg_gym.gradients.tape.Tape`.
    """

    def __init__(self, settings: EnvSettings, parameters: Sequence[str] = (), n_threads: int | None = None) -> None:
        small = Tape(settings, 1, n_threads, parameters)
        self.tape = Tape(settings, small.n_carried + len(small.output_names), n_threads, parameters)

    def __call__(self, scenario: Scenario, n_steps: int) -> Response:
        """Play a scenario for some steps; after an early end its outputs stay, and nothing moves them."""
        tape = self.tape
        n_lanes, n_carried = tape.lanes.n_lanes, tape.n_carried
        played = tape.play([scenario] * n_lanes, np.zeros((n_steps, n_lanes, tape.lanes.n_action)))
        n_outputs = played.outputs.shape[2]
        seeds = np.eye(n_lanes)
        terms = np.zeros((n_lanes, len(COST_TERMS)))
        n_law = tape.law()[0].size
        moved = np.zeros((n_carried, len(tape.parameters) + n_law))
        slopes = np.empty((n_steps, n_outputs, moved.shape[1]))
        for step in range(n_steps):
            pulled = tape.pull(step, seeds[:, :n_carried], terms, outputs=seeds[:, n_carried:])
            own = np.concatenate([pulled.parameters, pulled.law.reshape(n_lanes, n_law)], axis=1)
            after = pulled.carried @ moved + own
            moved, slopes[step] = after[:n_carried], after[n_carried:]
        n_parameters = len(tape.parameters)
        law = slopes[:, :, n_parameters:].reshape(n_steps, n_outputs, *tape.law().shape[1:])
        return Response(played.outputs[:, 0], slopes[:, :, :n_parameters], law)
