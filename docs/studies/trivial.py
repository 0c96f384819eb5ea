"""Policies that should not be good: constants, relays, and gains of one observation."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np
from rollouts import Candidates, Rollouts

from wtg_gym.physics.layout import Floats
from wtg_gym.tasks.observation import FREQUENCY_UNIT_HZ

_CONSTANTS = (
    (-0.5, -0.2, -0.1, -0.05, -0.02, 0.0, 0.02, 0.05, 0.1, 0.2, 0.5),  # k
    (-1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0),  # tau
)
_AMPLITUDES, _GAINS = (0.05, 0.2, 1.0), (0.2, 0.6, 2.0)
#: Quantiles of an observation under the zero action at which an action jumps.
_JUMPS = (0.25, 0.5, 0.75)
#: Deviations of the frequency, its first observation, below which support is withdrawn, so that load is shed [Hz].
_WITHDRAWN_HZ = (-0.3, -0.5, -0.7, -0.9)


class Rule(NamedTuple):
    """A constant action, and a gain of an observation's distance from some value, or of its sign."""

    words: str
    constant: tuple[float, float] = (0.0, 0.0)
    observed: int = 0
    middle: float = 0.0
    gain: tuple[float, float] = (0.0, 0.0)
    jumps: bool = False


def simple_rules(rollouts: Rollouts) -> list[Rule]:
    """Return constants; jumps where one observation crosses a quartile of its values under the zero action; gains."""
    names = [name.split(".", 1)[1] for name in rollouts.lanes.observation_names[: rollouts.n_local]]
    rules = [Rule(f"k {k:+g}, tau {tau:+g}", (k, tau)) for k, tau in itertools.product(*_CONSTANTS)]
    rules += [_withdrawing(hz, size) for hz, size in itertools.product(_WITHDRAWN_HZ, _AMPLITUDES)]
    choices = itertools.product(zip(names, _seen(rollouts).T, strict=True), (1.0, -1.0), enumerate(("k", "tau")))
    for (name, values), sign, (i, action) in choices:
        at, unit = names.index(name), np.eye(2)[i] * sign
        for middle, size in itertools.product(np.quantile(values, _JUMPS), _AMPLITUDES):
            words = f"{action} {sign * size:+g} · sign({name} − {middle:.2f})"
            rules.append(Rule(words, observed=at, middle=middle, gain=tuple(size * unit), jumps=True))
        for size, middle in itertools.product(_GAINS, (float(np.median(values)),)):
            words = f"{action} {sign * size:+g} · ({name} − {middle:.2f})"
            rules.append(Rule(words, observed=at, middle=middle, gain=tuple(size * unit)))
    return rules


def _withdrawing(hz: float, size: float) -> Rule:
    """Return the law's action above a deviation, and less power below it."""
    half, middle = (0.5 * size, 0.0), hz / FREQUENCY_UNIT_HZ
    return Rule(f"k {-size:+g} below {hz:+g} Hz", (-0.5 * size, 0.0), 0, middle, half, jumps=True)


def together(rules: Sequence[Rule]) -> Candidates:
    """Return candidates that follow a rule each."""
    _, constants, observed, middles, gain, jumps = (np.array(column) for column in zip(*rules, strict=True))

    def act(_step: int, own: Floats) -> Floats:
        distance = np.take_along_axis(own, observed[None, :, None, None], axis=-1) - middles[:, None, None]
        moved = np.where(jumps[:, None, None], np.sign(distance), distance)
        return constants[:, None] + gain[:, None] * moved

    return act


def _seen(rollouts: Rollouts) -> Floats:
    """Return a group's observations under the zero action, every second, (n_samples, n_local)."""
    seen = []

    def act(step: int, own: Floats) -> Floats:
        if step % 10 == 0:
            seen.append(own[..., : rollouts.n_local].reshape(-1, rollouts.n_local))
        return np.zeros((*own.shape[:3], rollouts.n_action))

    with closing(rollouts.with_candidates(1)) as alone:
        alone.play(act)
    return np.concatenate(seen)
