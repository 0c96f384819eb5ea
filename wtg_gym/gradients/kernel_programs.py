"""The kernels of a control step as programs: each row that they write, as an expression in the rows they read."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.actions import apply_actions
from wtg_gym.envs.charging import charge
from wtg_gym.envs.measuring import measure
from wtg_gym.envs.observation import N_MEASURED
from wtg_gym.envs.observing import observe
from wtg_gym.envs.task_records import Task, read_task
from wtg_gym.systems import expressions as ex
from wtg_gym.gradients.plant_parameters import Leaf
from wtg_gym.systems.tracing import ARITHMETIC, Actions, Rows, retargeted, traced
from wtg_gym.physics.currents import limit_group_current, unit_currents
from wtg_gym.physics.dynamics import derivatives, keep_energy, unit_rates, unit_voltages
from wtg_gym.physics.kernel_data import Plant
from wtg_gym.physics.layout import LANE, read_extension, read_turbine, rows_of
from wtg_gym.physics.protection import track_extremes
from wtg_gym.physics.rotor_table import tabulated_power_coefficient
from wtg_gym.physics.runge_kutta import EVALUATE
from wtg_gym.physics.sensors import N_CHANNELS

Indices = npt.NDArray[np.int64]

#: Constants of a machine that every lane has in a row of its own, since a scenario may replace them.
ROW_OF_LEAF = {"two_h": "inv_two_h", "governor.inv_droop": "inv_droop"}


class Programs(NamedTuple):
    """Programs of a control step, one lane wide: an expression by the row that it writes.

    Where a current can be limited the right-hand side has three parts: voltages and currents without that limit, the
    sweeps that go on until it holds, and the rates.
    """

    act: dict[int, Any]
    network: dict[int, Any]  # empty where no current can be limited
    sweep: dict[int, Any]  # empty too
    rates: dict[int, Any]
    finish: dict[int, Any]  # the end of a simulation step, after its last stage
    coi: dict[int, Any]  # the frequency of the centre of inertia, before protections act
    charge: dict[int, Any]
    measured: dict[int, int]  # by WTG group: first row in the observation, where sensors show it


def require_known(plant: Plant) -> None:
    """Raise a ValueError for a plant that gradients are not known for."""
    if plant.constants[0]["hydro"].shape[0] > 0:
        raise ValueError("gradients are not known for hydro governors")


class Further(NamedTuple):
    """Rows of a work block behind those of the block; see :class:`~wtg_gym.gradients.generated.Steps`."""

    actions: Indices
    seen: Indices
    noise: Indices
    interval: Indices
    constants: dict[Leaf, int]
    end: int

    @classmethod
    def of(cls, n_rows: int, n_action: int, n_sensed: int, leaves: Sequence[Leaf]) -> Further:
        """Return them for a block's number of rows; `n_sensed` is the number of WTG groups, 0 without sensors."""
        own = [leaf for leaf in leaves if not is_of_lane(leaf)]
        edges = np.cumsum([n_rows, n_action, n_sensed * N_MEASURED, n_sensed * N_CHANNELS, min(n_sensed, 1), len(own)])
        actions, seen, noise, interval, constants = (np.arange(*edge) for edge in itertools.pairwise(edges))
        return cls(
            actions=actions,
            seen=seen.reshape(n_sensed, N_MEASURED),
            noise=noise.reshape(n_sensed, N_CHANNELS),
            interval=interval,
            constants=dict(zip(own, constants.tolist(), strict=True)),
            end=int(edges[-1]),
        )


def _with_rows(c: Any, rows: Mapping[Leaf, int]) -> dict[str, Any]:
    """Return a plant's constants, some of which are what rows hold."""
    found: dict[str, Any] = {name: c[name] for name in c.dtype.names}
    machines = [{name: machine[name] for name in machine.dtype.names} for machine in c["machines"]]
    turbine = {name: c["turbine"][name] for name in c["turbine"].dtype.names}
    for leaf, row in rows.items():
        (machines[leaf.place] if leaf.part == "machines" else turbine)[leaf.name] = ex.row_of_block(row)
    return {**found, "machines": np.array(machines, dtype=object), "turbine": turbine}


@ex.making()
def programs_of(
    plant: Plant, task: npt.NDArray[np.void], n_rows: int, n_action: int, leaves: Sequence[Leaf] = ()
) -> Programs:
    """Trace the kernels of a control step; what :class:`Further` names is in rows n_rows … of a work block."""
    lanes, sensed = (0,), task["sensed"].shape[1] > 0
    t = retargeted(read_task)(task[0])
    further = Further.of(n_rows, n_action, plant.constants[0]["share"].size * sensed, leaves)
    c = _with_rows(plant.constants[0], further.constants)
    act, extremes, charged = retargeted(apply_actions), retargeted(track_extremes), retargeted(charge)
    measured: dict[int, int] = {}

    def show(block: Rows, j: int, c: Any, task: Task, row: int, lanes: Any) -> None:
        measured[j] = row

    # Random numbers are given, and so is the place in the ring of measurements, which is none that a program knows.
    sensing = {
        "noise_key": lambda seed, step: None,
        "normal": lambda key, channel: ex.row_of_block(int(further.noise.ravel()[channel])),
        "newest_row": lambda block, x, j, *_: int(further.seen[j, 0]),
        "int": lambda value: value if isinstance(value, ex.Number) else int(value),
    }
    taken = retargeted(measure, {**ARITHMETIC, **sensing}, {})
    observed = retargeted(observe, {**ARITHMETIC, "show_delayed": show}, {})

    def at_end(block: Rows) -> None:
        charged(block, c, t, sensed, lanes)
        if sensed:
            taken(block, c, t, [0], lanes)
        observed(block, c, t, sensed, lanes)

    coi = retargeted(rows_of)(plant.constants[0]).lane + LANE.coi
    return Programs(
        act=traced(lambda block: act(block, c, t, Actions(n_rows, n_action, ex.row_of_block), lanes)),
        **_dynamics_of(c),
        coi={coi: traced(lambda block: extremes(block, c, lanes))[coi]},
        charge=traced(at_end),
        measured=measured,
    )


def _dynamics_of(c: Any) -> dict[str, dict[int, Any]]:
    """Trace the right-hand side and the end of a simulation step."""
    lanes, fraction = (0,), ex.argument(0)
    whole = {**ARITHMETIC, "np": SimpleNamespace(int64=lambda value: value)}
    surface = retargeted(tabulated_power_coefficient, whole, {})
    # The cells of the C_p table are looked up when the program runs.
    whole["tabulated_power_coefficient"] = lambda ratio, pitch, cells, grid: surface(
        ratio, pitch, ex.Cells(cells.shape), grid
    )
    if c["extension"].shape[0] == 0:
        rates = retargeted(derivatives, whole, {})
        return {"network": {}, "sweep": {}, "rates": traced(lambda b: rates(b, c, fraction, lanes)), "finish": {}}
    voltages, rates, finish = retargeted(unit_voltages), retargeted(unit_rates, whole, {}), retargeted(keep_energy)
    currents = retargeted(unit_currents, {**ARITHMETIC, "limit_currents": lambda *_: None}, {})
    # However little a voltage moves: where it stands is where the limit holds.
    sweeping = {"SETTLED": -1.0, "np": SimpleNamespace(int64=lambda _: 0)}
    limit_current = retargeted(limit_group_current, {**ARITHMETIC, **sweeping}, {})
    limit = retargeted(read_extension)(c["extension"][0]).limits.current_max
    turbine, n_wtg = retargeted(read_turbine)(c["turbine"]), c["share"].size

    def network(block: Rows) -> None:
        voltages(block, c, lanes)
        currents(block, c, lanes)

    def sweep(block: Rows) -> None:
        for j in range(n_wtg):
            limit_current(block, c, j, limit * c["share"][j], lanes)

    def energies(block: Rows) -> None:
        for j in range(n_wtg):
            finish(block, c, j, 0, turbine, 1)

    return {
        "network": traced(network),
        "sweep": traced(sweep),
        "rates": traced(lambda block: rates(block, c, fraction, EVALUATE, 0.0, lanes)),
        "finish": traced(energies),
    }


def is_of_lane(leaf: Leaf) -> bool:
    """Return whether every lane has this constant in a row of its own."""
    return leaf.part == "machines" and leaf.name in ROW_OF_LEAF
