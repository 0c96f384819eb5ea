"""Gradients of what episodes cost, with respect to actions, the parameters of the tracking laws and those of the plant.

    expressions       numbers that remember how they came about, their derivatives, their source
    tracing           the kernels' own source over such numbers
    kernel_programs   the kernels of a control step as such numbers
    generated         the vector-Jacobian products of the kernels, compiled
    plant_parameters  which parameters a plant has, and what constants they move
    adjoint           back through one control step
    tape              episodes that can be differentiated: the interface for NumPy
    differences       gradients compared with differences of plays
    torch             what tape does, for PyTorch; not imported here

Only `torch` needs more than the core.
"""

from wtg_gym.gradients.differences import Difference, Differences, check_by_differences
from wtg_gym.gradients.generated import LAW_PARAMETERS
from wtg_gym.gradients.plant_parameters import known_parameters
from wtg_gym.gradients.tape import Gradient, Played, Pulled, Tape

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
