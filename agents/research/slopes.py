"""How k and τ of a policy depend on what it sees, by linear regression.

Every visited state counts once per WTG group; all groups share one regression.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from wtg_gym.evaluation.recording import Recording
from wtg_gym.files import markdown_table
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.layout import Floats

#: Actions: k added by the policy as a share of K_opt, and log2 of the factor on τ.
ACTIONS = ("k", "tau")


class Slope(NamedTuple):
    """A row of the regression on one action."""

    quantity: str  # that is seen
    unit: str  # in which the slope counts it
    slope: float  # of k [K_opt] or log2 τ per unit
    share: float  # of the action's variance that it explains, 0 … 1


class Slopes(NamedTuple):
    """Dependence of one action on what the policy sees."""

    mean: float  # of the action: k added [K_opt], or log2 of the factor on τ
    deviation: float  # its standard deviation, in the same unit
    alone: tuple[Slope, ...]  # each named observation on its own
    together: tuple[Slope, ...]  # the quantities that decide, in one regression; shares add up to `explained`
    explained: float  # share of the variance that these explain, 0 … 1
    with_others: float  # the same with those of the other groups beside them
    each_group: float  # the same with a regression for each group


def policy_slopes(recording: Recording) -> dict[str, Slopes]:
    """Return the slopes of every action that the policy modulates, by its name in :data:`ACTIONS`."""
    decided = {
        "k": recording.offset_pu / tracking_point(0.0).coefficient,
        "tau": np.log2(recording.time_constant_s / recording.time_constant_s[:, :1]),
    }
    # A step's action follows the state before it.
    actions = {name: values[:, 1:] for name, values in decided.items()}
    return {
        name: _slopes_of(recording, values)
        for name, values in actions.items()
        if np.isfinite(values).any() and np.nanstd(values) > 1e-9
    }


def _slopes_of(recording: Recording, action: Floats) -> Slopes:
    groups = range(recording.n_wtg)
    rows = [np.isfinite(action[:, :, group]) for group in groups]
    y = [action[:, :, group][row] for group, row in enumerate(rows)]
    decisive = [_quantities(recording, group) for group in groups]
    seen = [_observations(recording, group) for group in groups]
    x, o = (
        [np.stack([values[row] for values in each.values()], axis=1) for each, row in zip(own, rows, strict=True)]
        for own in (decisive, seen)
    )
    all_y, all_x, all_o = np.concatenate(y), np.concatenate(x), np.concatenate(o)
    # The other groups' sum, at the same instants.
    total = np.sum([np.stack(list(each.values()), axis=-1) for each in decisive], axis=0)
    others = np.concatenate([total[row] - each for row, each in zip(rows, x, strict=True)])
    left = sum(
        float(each.var()) * each.size * (1.0 - _explained(values, each)) for values, each in zip(x, y, strict=True)
    )
    found = zip(decisive[0], _slopes(all_x, all_y), _shares(all_x, all_y), strict=True)
    columns = [(key, column[:, None]) for key, column in zip(seen[0], all_o.T, strict=True)]
    return Slopes(
        mean=float(all_y.mean()),
        deviation=float(all_y.std()),
        alone=tuple(Slope(*key, float(_slopes(o, all_y)[0]), _explained(o, all_y)) for key, o in columns),
        together=tuple(Slope(*key, float(slope), float(share)) for key, slope, share in found),
        explained=_explained(all_x, all_y),
        with_others=_explained(np.hstack([all_x, others]), all_y),
        each_group=1.0 - left / (float(all_y.var()) * all_y.size),
    )


def _quantities(recording: Recording, group: int) -> dict[tuple[str, str], Floats]:
    """Return the quantities that decide at each step, by name and unit of the slope, (n_scenarios, n_steps).

    None of them is the last action by another name, as k and the power are.
    """
    values = {
        ("frequency deviation", "0.1 Hz"): recording.deviation_hz / 0.1,
        ("RoCoF", "0.1 Hz/s"): recording.rocof_hz_s / 0.1,
        ("tip-speed ratio above its target", "0.1"): recording.ratio_above_target / 0.1,
        ("wind", "1 m/s"): recording.wind_m_s,
        ("filter state", "0.1 Hz"): recording.filter_hz / 0.1,
    }
    return {key: each[:, :-1, group] for key, each in values.items()}


def _observations(recording: Recording, group: int) -> dict[tuple[str, str], Floats]:
    """Return a group's own observations and those that all share, by name and unit, (n_scenarios, n_steps)."""
    found = {}
    for i, name in enumerate(recording.observation_names):
        owner, quantity = name.split(".", 1)
        if owner == f"wtg{group}" or not owner.startswith("wtg"):
            quantity = quantity if owner.startswith("wtg") else name
            words, _, unit = quantity.partition(" [")
            found[words, unit.removesuffix("]") or "full action"] = recording.observations[:, :-1, i]
    return found


def _standardised(x: Floats) -> tuple[Floats, Floats]:
    """Return columns with mean 0 and deviation 1, constant ones as zeros, and their deviations."""
    deviation = x.std(axis=0)
    scale = np.where(deviation > 1e-9, deviation, np.inf)
    return (x - x.mean(axis=0)) / scale, scale


def _slopes(x: Floats, y: Floats) -> Floats:
    """Return the slopes (n,) of a regression of y (m,) on the columns of x (m, n); 0 for a constant column."""
    z, scale = _standardised(x)
    slopes: Floats = np.linalg.lstsq(z, y - y.mean(), rcond=1e-9)[0] / scale
    return slopes


def _explained(x: Floats, y: Floats) -> float:
    """Return the share of y's variance that a regression on x's columns explains."""
    variance = float(y.var())
    residual = y - y.mean() - (x - x.mean(axis=0)) @ _slopes(x, y)
    return 1.0 - float(residual.var()) / variance if variance > 0.0 else 0.0


def _shares(x: Floats, y: Floats) -> Floats:
    """Return what each column adds to the explained share, the mean over all orders of adding them (n,)."""
    n = x.shape[1]
    z, own = _standardised(np.column_stack([x, y]))[0], np.zeros(n)
    correlation = z.T @ z / y.size

    def explained(columns: tuple[int, ...]) -> float:
        rows = list(columns)
        to_y = correlation[rows, n]
        return float(to_y @ np.linalg.lstsq(correlation[np.ix_(rows, rows)], to_y, rcond=1e-9)[0]) if rows else 0.0

    found = {c: explained(c) for size in range(n + 1) for c in itertools.combinations(range(n), size)}
    for columns, value in found.items():
        for i in set(range(n)) - set(columns):
            orders = math.factorial(len(columns)) * math.factorial(n - len(columns) - 1) / math.factorial(n)
            own[i] += orders * (found[tuple(sorted((*columns, i)))] - value)
    return own


def slopes_tables(found: Mapping[str, Mapping[str, Slopes]]) -> str:
    """Return a Markdown table for each action, and one of single observations; `found` by entry and action."""
    parts: list[str] = []
    alone: dict[str, tuple[Slope, ...]] = {}
    for action, words in zip(ACTIONS, ("Added to k, in shares of K_opt", "Factor on τ"), strict=True):
        own = {name: actions[action] for name, actions in found.items() if action in actions}
        if not own:
            continue
        parts += [f"{words}, for one unit more; in brackets, the share of its variance [%]:", _table(action, own)]
        alone |= {f"{'τ' if action == 'tau' else action}: {name}": slopes.alone for name, slopes in own.items()}
    if alone:
        quantities = dict.fromkeys(row.quantity for rows in alone.values() for row in rows)
        shares = [{row.quantity: _percent(row.share) for row in rows} for rows in alone.values()]
        cells = [(quantity, *(each.get(quantity, "–") for each in shares)) for quantity in quantities]
        parts += [
            "Share of the variance that each observation of a group explains on its own [%]:",
            markdown_table(("observation", *alone), cells, right=range(1, 1 + len(alone))),
        ]
    return "\n\n".join(parts)


def _table(action: str, own: Mapping[str, Slopes]) -> str:
    rows = [
        (
            key.quantity,
            key.unit,
            *(
                f"{_change(action, slopes.together[i].slope)} ({_percent(slopes.together[i].share)})"
                for slopes in own.values()
            ),
        )
        for i, key in enumerate(next(iter(own.values())).together)
    ]
    for words, key in (
        ("all of these", "explained"),
        ("and those of the other groups", "with_others"),
        ("a regression for each group", "each_group"),
    ):
        rows.append((words, "", *(f"({_percent(getattr(slopes, key))})" for slopes in own.values())))
    rows.append(("mean of the action", "", *(_change(action, slopes.mean) for slopes in own.values())))
    deviations = [_change(action, slopes.deviation).removeprefix("+") for slopes in own.values()]
    rows.append(("standard deviation of the action", "", *deviations))
    return markdown_table(("seen", "unit", *own), rows, right=range(2, 2 + len(own)))


def _change(action: str, value: float) -> str:
    return f"{value:+.4f}".replace("-", "−") if action == "k" else f"×{2.0**value:.3f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f}"


def slopes_csv(found: Mapping[str, Mapping[str, Slopes]]) -> str:
    """Return all slopes as CSV: that of k in K_opt per unit, that of τ in doublings per unit; `found` as above."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("entry", "action", "regression", "quantity", "unit", "slope", "share_percent"))
    for name, actions in found.items():
        for action, result in actions.items():
            for regression, rows in (("together", result.together), ("alone", result.alone)):
                for row in rows:
                    numbers = f"{row.slope:.6g}", f"{100.0 * row.share:.4g}"
                    writer.writerow([name, action, regression, row.quantity, row.unit, *numbers])
    return text.getvalue()
