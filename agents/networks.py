"""A policy's network as the export sees it, whatever trained it; torch is all it needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from torch import nn

#: Activations that a configuration file may name; the export can write each of them.
ACTIVATIONS: dict[str, type[nn.Module]] = {
    "nn.ELU": nn.ELU,
    "nn.LeakyReLU": nn.LeakyReLU,
    "nn.ReLU": nn.ReLU,
    "nn.Sigmoid": nn.Sigmoid,
    "nn.Tanh": nn.Tanh,
}
#: The layers that the export can write, besides nested `nn.Sequential`.
LAYERS: tuple[type[nn.Module], ...] = (nn.Linear, nn.Hardtanh, *ACTIVATIONS.values())


@dataclass(frozen=True, kw_only=True)
class Normalization:
    """clip((observation - mean) / std, ± bound) in double precision.

    Args:
        mean, std: one value per entry of the observation, (n_observation,) float64.
        bound: largest magnitude of the result.
    """

    mean: npt.NDArray[np.float64]
    std: npt.NDArray[np.float64]
    bound: float


@dataclass(frozen=True)
class PolicyNetwork:
    """Observation → normalisation → LSTM → layers → clip to [-1, 1]: the deterministic action.

    Args:
        n_observation: number of entries of the observation.
        normalization: None where the network sees raw observations.
        lstm: None for a policy without memory.
        layers: applied one after the other, each of :data:`LAYERS`.
    """

    n_observation: int
    normalization: Normalization | None
    lstm: nn.LSTM | None
    layers: Sequence[nn.Module]


def flat_layers(modules: Sequence[nn.Module]) -> list[nn.Module]:
    """Return the layers in modules one after the other.

    Raises:
        ValueError: one is none of :data:`LAYERS`.
    """
    flat: list[nn.Module] = []
    for module in modules:
        if isinstance(module, nn.Sequential):
            flat += flat_layers(list(module))
        elif isinstance(module, LAYERS):
            flat.append(module)
        else:
            names = ", ".join(layer.__name__ for layer in LAYERS)
            raise ValueError(f"cannot export a layer {type(module).__name__}, only {names}")
    return flat


__all__ = ["ACTIVATIONS", "LAYERS", "Normalization", "PolicyNetwork", "flat_layers"]
