"""Small signal: the paper's single-machine loops, and the modes of the whole system."""

from wtg_gym.small_signal.modes import LinearModel, Mode, linearise, modes
from wtg_gym.small_signal.single_machine import Margins, SingleMachine, ideal_source_loop, single_machine

__all__ = [
    "LinearModel",
    "Margins",
    "Mode",
    "SingleMachine",
    "ideal_source_loop",
    "linearise",
    "modes",
    "single_machine",
]
