"""Parameters of a plant that gradients are taken with respect to: which there are, and what constants they move."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from wtg_gym.physics.layout import Floats, Layout, Whole, rows_of_envs
from wtg_gym.physics.machine_parameters import ExciterParameters, GovernorParameters
from wtg_gym.physics.plant import Plant, plant_tables
from wtg_gym.ranges import did_you_mean

#: Fields of the parameter classes that act on a run, and neither on the equilibrium it starts from nor on a law.
_OF_MACHINES = {
    "": "two_h_s damping_pu t_d0_transient_s t_d0_subtransient_s t_q0_transient_s t_q0_subtransient_s",
    "governor": "droop_pu gate_time_s lead_time_s reheat_time_s turbine_damping_pu dead_band_pu",
    "exciter": "lead_lag_ratio lag_time_s exciter_time_s",
}
#: Models whose parameters these are.
_MODELS = {"governor": GovernorParameters, "exciter": ExciterParameters}
_OF_GROUPS = {
    "turbine": "inertia_constant_s",
    "pitch": "speed_weight proportional_gain_deg integral_gain_deg_s gain_schedule_deg actuator_time_s "
    "rate_limit_deg_s",
    "control": "inertia_constant_s droop_gain_pu",
}
_DROOP = "governor.inv_droop"
#: Constants of a machine that every environment has in a row of its own, since a scenario may replace them.
_ROW_OF_LEAF = {"two_h": "inv_two_h", _DROOP: "inv_droop"}
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
    parameters: dict[str, float] = {}
    for bus in dict.fromkeys(machine.bus for machine in plant.case.machines):
        machines = [machine for machine in plant.case.machines if machine.bus == bus]
        for part, fields in _OF_MACHINES.items():
            owners = [getattr(machine, part) if part else machine for machine in machines]
            if not all(isinstance(owner, _MODELS.get(part, object)) for owner in owners):
                continue
            is_classical = any(machine.classical for machine in machines)
            for field in fields.split():
                values = {getattr(owner, field) for owner in owners}
                of_rotor = part == "exciter" or field.startswith("t_")
                if len(values) == 1 and not (is_classical and of_rotor):
                    parameters[".".join(filter(None, ("machines", str(bus), part, field)))] = float(values.pop())
    if plant.groups:
        for part, fields in _OF_GROUPS.items():
            parameters |= {f"{part}.{field}": float(getattr(getattr(plant, part), field)) for field in fields.split()}
    return parameters


def with_parameters(plant: Plant, values: Mapping[str, float]) -> Plant:
    """Return a plant with other values of some parameters.

    A ValueError names a parameter that is unknown or out of its range.
    """
    require_known_parameters(plant, values)
    for name, value in values.items():
        part, *path = name.split(".")
        if part == "machines":
            bus, *path = path
            machines = (_replaced(m, path, value) if str(m.bus) == bus else m for m in plant.case.machines)
            plant = dataclasses.replace(plant, case=dataclasses.replace(plant.case, machines=tuple(machines)))
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
            f"known: {', '.join(known)}{did_you_mean(unknown[0], known)}"
        )


class Moved:
    """The constants of a plant that parameters move; which they are does not depend on the plant's values.

    `places_of` returns where among the constants of code a leaf is (:func:`~wtg_gym.systems.programs.constant_places`)
    from what systems call it: an argument and its number there, and the unit whose it is.
    """

    def __init__(
        self, plant: Plant, names: Sequence[str], layout: Layout, places_of: Callable[[str, str, int | None], list[int]]
    ) -> None:
        values, slopes = _leaves_of(plant), [_slopes_of(plant, name) for name in names]
        leaves = sorted({leaf for slope in slopes for leaf in slope})
        #: Derivatives of the constants with respect to the parameters (n_leaves, n_parameters).
        self._slopes = np.array([[slope.get(leaf, 0.0) for slope in slopes] for leaf in leaves])
        self._slopes = self._slopes.reshape(len(leaves), len(names))
        #: The row in which every environment has a constant of its own (1,), with its value and name; or its places.
        self._rows: dict[int, tuple[Whole, float, str]] = {}
        self._places: dict[int, Whole] = {}
        for i, leaf in enumerate(leaves):
            if leaf.name in _ROW_OF_LEAF:
                row = layout.machine(_ROW_OF_LEAF[leaf.name])[leaf.place : leaf.place + 1]
                self._rows[i] = row, values[leaf], leaf.name
            else:
                meant = ("machine", leaf.name, leaf.place) if leaf.part == "machines" else ("turbine", leaf.name, None)
                self._places[i] = np.array(places_of(*meant), dtype=np.int64)

    def in_force(self, blocks: Floats, num_envs: int) -> Floats:
        """Return how far an environment's own row follows each constant of the plant (num_envs, n_leaves); else 1.

        A scenario scales inertias, 1/2H = 1/(scale · 2H). Its droop takes the place of the plant's, which then means
        the droop in force; a lost governor has none.
        """
        factors = np.ones((num_envs, len(self._slopes)))
        for i, (row, value, name) in self._rows.items():
            ratio = rows_of_envs(blocks, row, num_envs)[:, 0] / value
            factors[:, i] = ratio**2 if name == _DROOP else -ratio
        return factors

    def pull(self, bars: Floats, constants: Floats, in_force: Floats) -> Floats:
        """Return cotangents of the parameters (num_envs, n_parameters), by what was `in_force` before the step.

        Those of the constants that have rows in the blocks are taken out of `bars`; `constants` are the cotangents of
        the code's constants (n_blocks, n_numbers, width).
        """
        num_envs = len(in_force)
        leaves = np.zeros_like(in_force)
        for i, (row, *_) in self._rows.items():
            leaves[:, i] = rows_of_envs(bars, row, num_envs)[:, 0]
            bars[:, row] = 0.0
        for i, places in self._places.items():
            leaves[:, i] = rows_of_envs(constants, places, num_envs).sum(axis=1)
        return np.asarray(leaves * in_force @ self._slopes)


def _leaves_of(plant: Plant) -> dict[Leaf, float]:
    """Return the numbers of a plant's machines and of its turbine."""
    built = plant_tables(plant)
    return {
        Leaf(part, place, name): float(record[name])
        for part, table in (("machines", built.machines), ("turbine", built.turbine[:1]))
        for place, record in enumerate(table)
        for name in table.dtype.names or ()
    }


def _slopes_of(plant: Plant, name: str) -> dict[Leaf, float]:
    """Return the derivatives of those constants that a parameter moves."""
    value = known_parameters(plant)[name]
    step = _STEP * (abs(value) or 1.0)
    # Nothing lies below 0: a parameter of that value moves constants in proportion.
    low, high = (value - step if value else 0.0), value + step
    below, above = (_leaves_of(with_parameters(plant, {name: at})) for at in (low, high))
    return {leaf: (above[leaf] - below[leaf]) / (high - low) for leaf in above if above[leaf] != below[leaf]}
