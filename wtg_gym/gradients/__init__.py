"""Gradients of what episodes cost, with respect to actions, the parameters of the tracking laws and those of the plant.

    plant_parameters  which parameters a plant has, and what constants they move
    adjoint           back through one control step
    tape              episodes that can be differentiated: the interface for NumPy
    differences       gradients compared with differences of plays
    torch             what tape does, for PyTorch; not imported here

Only `torch` needs more than the core.
"""

from wtg_gym.gradients.differences import Difference, Differences, check_by_differences
from wtg_gym.gradients.plant_parameters import known_parameters
from wtg_gym.gradients.tape import LAW_PARAMETERS, Gradient, Played, Pulled, Tape

__all__ = [
    "LAW_PARAMETERS",
    "Difference",
    "Differences",
    "Gradient",
    "Played",
    "Pulled",
    "Tape",
    "check_by_differences",
    "known_parameters",
]
