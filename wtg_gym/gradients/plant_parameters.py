"""Parameters of a plant that gradients are taken with respect to: which there are, and what constants they move."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from wtg_gym.physics.layout import Floats
from wtg_gym.physics.machine_parameters import ExciterParameters, GovernorParameters
from wtg_gym.physics.plant import Plant, plant_tables

#: Fields of the parameter classes that act on a run, and neither on the equilibrium it starts from nor on a law.
_OF_MACHINES = {
    "": (
        "two_h_s",
        "damping_pu",
        "t_d0_transient_s",
        "t_d0_subtransient_s",
        "t_q0_transient_s",
        "t_q0_subtransient_s",
    ),
    "governor": ("droop_pu", "gate_time_s", "lead_time_s", "reheat_time_s", "turbine_damping_pu", "dead_band_pu"),
    "exciter": ("lead_lag_ratio", "lag_time_s", "exciter_time_s"),
}
_OF_GROUPS = {
    "turbine": ("inertia_constant_s",),
    "pitch": (
        "speed_weight",
        "proportional_gain_deg",
        "integral_gain_deg_s",
        "gain_schedule_deg",
        "actuator_time_s",
        "rate_limit_deg_s",
    ),
    "control": ("inertia_constant_s", "droop_gain_pu"),
}
#: Share of its value by which a parameter is moved to see what it does to constants, which are its simple functions.
_STEP = 1e-5


class Leaf(NamedTuple):
    """A number of the plant's constants: one of a machine, or of the turbine that all groups have."""

    part: str  # "machines" or "turbine"
    place: int
    name: str


def known_parameters(plant: Plant) -> dict[str, float]:
    """Return every parameter that gradients are known for, by name, with its value in a plant.

    A machine's is named by its bus ("machines.1.governor.droop_pu"), and is that of all machines there; the others are
    those of every WTG group ("control.droop_gain_pu").
    """
    found: dict[str, float] = {}
    for bus in dict.fromkeys(machine.bus for machine in plant.case.machines):
        machines = [machine for machine in plant.case.machines if machine.bus == bus]
        for part, fields in _OF_MACHINES.items():
            owners = [getattr(machine, part) if part else machine for machine in machines]
            if part == "governor" and not all(isinstance(owner, GovernorParameters) for owner in owners):
                continue
            if part == "exciter" and not all(isinstance(owner, ExciterParameters) for owner in owners):
                continue
            if any(owner is None for owner in owners):
                continue
            for field in fields:
                values = {getattr(owner, field) for owner in owners}
                classical = any(machine.classical for machine in machines) and (
                    part == "exciter" or field.startswith("t_")
                )
                if len(values) == 1 and not classical:
                    found[".".join(filter(None, ("machines", str(bus), part, field)))] = float(values.pop())
    if plant.groups:
        for part, fields in _OF_GROUPS.items():
            found |= {f"{part}.{field}": float(getattr(getattr(plant, part), field)) for field in fields}
    return found


def with_parameters(plant: Plant, values: Mapping[str, float]) -> Plant:
    """Return a plant with other values of some parameters.

    Raises:
        ValueError: a parameter is unknown, or a value is out of its range.
    """
    require_known_parameters(plant, values)
    for name, value in values.items():
        part, *path = name.split(".")
        if part == "machines":
            bus, *path = path
            machines = tuple(
                _replaced(machine, path, value) if str(machine.bus) == bus else machine
                for machine in plant.case.machines
            )
            plant = dataclasses.replace(plant, case=dataclasses.replace(plant.case, machines=machines))
        else:
            plant = dataclasses.replace(plant, **{part: _replaced(getattr(plant, part), path, value)})
    return plant


def _replaced(owner: Any, path: list[str], value: float) -> Any:
    first, *rest = path
    return dataclasses.replace(owner, **{first: _replaced(getattr(owner, first), rest, value) if rest else value})


def require_known_parameters(plant: Plant, names: Iterable[str]) -> None:
    """Raise a ValueError for a name that is none of :func:`known_parameters`; it lists these."""
    known = known_parameters(plant)
    if unknown := sorted(set(names) - set(known)):
        raise ValueError(
            f"unknown parameters {unknown}: gradients are not known for those that move the equilibrium before a run; "
            f"known: {', '.join(known)}"
        )


class Moved(NamedTuple):
    """The constants of a plant that some of its parameters move."""

    leaves: tuple[Leaf, ...]
    values: Floats  # of them (n_leaves,)
    slopes: Floats  # derivatives with respect to the parameters (n_leaves, n_parameters)


def moved_by(plant: Plant, names: Sequence[str]) -> Moved:
    """Return the constants that parameters move; which these are does not depend on the parameters' values."""
    values, slopes = _leaves_of(plant), [_slopes_of(plant, name) for name in names]
    leaves = tuple(sorted({leaf for each in slopes for leaf in each}))
    by_leaf = np.array([[each.get(leaf, 0.0) for each in slopes] for leaf in leaves])
    return Moved(leaves, np.array([values[leaf] for leaf in leaves]), by_leaf.reshape(len(leaves), len(slopes)))


def _leaves_of(plant: Plant) -> dict[Leaf, float]:
    """Return the numbers of a plant's machines and of its turbine."""
    built = plant_tables(plant)
    found = {
        Leaf("machines", i, leaf): float(machine[leaf])
        for i, machine in enumerate(built.machines)
        for leaf in machine.dtype.names
    }
    turbine = built.turbine[0]
    return found | {Leaf("turbine", 0, leaf): float(turbine[leaf]) for leaf in turbine.dtype.names}


def _slopes_of(plant: Plant, name: str) -> dict[Leaf, float]:
    """Return the derivatives of those constants that a parameter moves."""
    value = known_parameters(plant)[name]
    step = _STEP * (abs(value) or 1.0)
    # Nothing lies below 0: a parameter of that value moves constants in proportion.
    low, high = (value - step if value else 0.0), value + step
    below, above = (_leaves_of(with_parameters(plant, {name: at})) for at in (low, high))
    return {leaf: (above[leaf] - below[leaf]) / (high - low) for leaf in above if above[leaf] != below[leaf]}
