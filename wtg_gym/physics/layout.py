"""Where every number of a simulation lies.

A block holds the complete state of `width` lanes (runs side by side) as one flat array of rows; each row has one number
per lane, so that loops over lanes have unit stride. A record takes neighbouring rows. What the right-hand side touches
lies together at the beginning, small enough for a processor's first cache:

    machines | WTG groups | hydro governors | voltages | currents | admittances | lane
    || rates | extremes | shedding | reduction | caller's own rows

Hydro governors, extensions of WTG groups and shedding take rows only in a plant that has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.compiled import inlined
from wtg_gym.physics.extended_converter import VoltageInput
from wtg_gym.physics.governor import HydroGovernor, HydroState
from wtg_gym.physics.kernel_data import Plant
from wtg_gym.physics.machine import Machine, MachineInput, MachineOutput, MachineState, MachineVoltage
from wtg_gym.physics.records import loader, offsets, reader, short_names, size, storer
from wtg_gym.physics.wind_turbine import (
    Extension,
    ExtensionOutput,
    ExtensionState,
    Turbine,
    WtgExtremes,
    WtgInput,
    WtgOutput,
    WtgState,
)

Floats = npt.NDArray[np.float64]
#: A tuple of zeros as long as a block is wide; its length is known to the compiler.
Lanes = tuple[int, ...]


class MachineRows(NamedTuple):
    """Rows of a synchronous machine; `base` and `sum` belong to the integration."""

    state: MachineState
    base: MachineState
    sum: MachineState
    input: MachineInput
    emf: MachineVoltage
    output: MachineOutput


class WtgRows(NamedTuple):
    """Rows of a WTG group; `base` and `sum` belong to the integration."""

    state: WtgState
    base: WtgState
    sum: WtgState
    input: WtgInput
    output: WtgOutput


class Phasor(NamedTuple):
    """A voltage, a current or an admittance [p.u.]."""

    re: float
    im: float


class HydroRows(NamedTuple):
    """Rows of a synchronous machine's hydro governor."""

    state: HydroState
    base: HydroState
    sum: HydroState


class ExtensionRows(NamedTuple):
    """Further rows of an extended WTG group."""

    state: ExtensionState
    base: ExtensionState
    sum: ExtensionState
    input: VoltageInput
    output: ExtensionOutput
    source: Phasor  # voltage behind X_g before its current is limited [p.u.]
    change: Phasor  # of the voltage behind X_g in the latest sweep [p.u.]


class LaneRows(NamedTuple):
    """Rows of a lane."""

    angle: float  # of the first unit against a frame at nominal frequency [rad]
    base: float  # of `angle`, for the integration [rad]
    sum: float  # of rates of `angle` [rad/s]
    rate: float  # of `angle` [rad/s]
    reference_speed: float  # of the first unit, or where it stands still after an outage [p.u.]
    active: float  # 1 while it runs, 0 once it has ended
    step: float  # simulation steps since the reset
    next_change: float  # simulation step of the next network change
    last_change: float  # simulation step at which the network was last reduced
    status: float  # of :class:`~wtg_gym.physics.protection.Status`
    coi: float  # frequency of the centre of inertia [p.u.]
    coi_min: float  # least since the start [p.u.]
    coi_max: float
    noise_z: Phasor  # Thévenin impedance at the bus of the load noise [p.u.]
    noise_per_mw: float  # admittance per MW of load noise [p.u.]
    noise_factor: Phasor  # of the load noise's part in the reduced admittance: Δy/(1 + Δy z) [p.u.]
    least_angle: float  # of all connected units, when the protections last sampled [rad]
    largest_angle: float
    least_squared_voltage: float  # at the terminals of all connected units, squared [p.u.²]
    healthy_step: float  # last simulation step at which the protections found no low voltage


MACHINE, WTG, LANE = offsets(MachineRows), offsets(WtgRows), offsets(LaneRows)
EXTENSION = offsets(ExtensionRows)
N_MACHINE_ROWS, N_WTG_ROWS, N_LANE_ROWS = size(MachineRows), size(WtgRows), size(LaneRows)
N_HYDRO_ROWS, N_EXTENSION_ROWS = size(HydroRows), size(ExtensionRows)
N_MACHINE_STATES, N_WTG_STATES, N_EXTREMES = size(MachineState), size(WtgState), size(WtgExtremes)
N_HYDRO_STATES, N_EXTENSION_STATES = size(HydroState), size(ExtensionState)


def row_of(record: type, name: str) -> int:
    """Return the row of a record's number; where a state is kept three times (state, base, sum), that of the state."""
    names = short_names(record)
    if name not in names:
        raise KeyError(f"{name!r} is no number of {record.__name__}; it has {', '.join(dict.fromkeys(names))}")
    return names.index(name)


MACHINE_ANGLE, WTG_ANGLE = row_of(MachineRows, "angle"), row_of(WtgRows, "angle")
WTG_EMF, OVERLOAD_TIME = row_of(WtgRows, "emf"), row_of(WtgExtremes, "overload_time")
MACHINE_TORQUE = row_of(MachineRows, "torque")
WTG_CAPTURED, WTG_ROTOR_SPEED = row_of(WtgRows, "captured"), row_of(WtgRows, "rotor_speed")
WTG_K_OFFSET, WTG_INV_TAU = row_of(WtgRows, "k_offset"), row_of(WtgRows, "inv_tau")

load_machine_state, store_machine_state = loader(MachineState), storer(MachineState)
load_machine_input, store_machine_input = loader(MachineInput), storer(MachineInput)
load_machine_emf, store_machine_emf = loader(MachineVoltage), storer(MachineVoltage)
load_machine_output, store_machine_output = loader(MachineOutput), storer(MachineOutput)
load_wtg_state, store_wtg_state = loader(WtgState), storer(WtgState)
load_wtg_input, store_wtg_input = loader(WtgInput), storer(WtgInput)
load_wtg_output, store_wtg_output = loader(WtgOutput), storer(WtgOutput)
load_extremes, store_extremes = loader(WtgExtremes), storer(WtgExtremes)
load_phasor, store_phasor = loader(Phasor), storer(Phasor)
load_hydro_state, store_hydro_state = loader(HydroState), storer(HydroState)
load_extension_state, store_extension_state = loader(ExtensionState), storer(ExtensionState)
load_extension_input, store_extension_input = loader(VoltageInput), storer(VoltageInput)
store_extension_output = storer(ExtensionOutput)
read_machine, read_turbine = reader(Machine), reader(Turbine)
read_hydro, read_extension = reader(HydroGovernor), reader(Extension)


class Rows(NamedTuple):
    """First row of each part of a block."""

    wtg: int
    wtg_stride: int  # rows of a group, with those of its extension
    hydro: int
    voltage: int
    current: int
    admittance: int
    lane: int
    machine_rate: int
    wtg_rate: int
    hydro_rate: int
    extension_rate: int
    extremes: int
    shedding: int  # of each stage: see shed_load
    transfer: int  # y_i Z_in of each unit to the bus of the load noise
    fixed_admittance: int  # without load noise
    extra: int


@inlined
def block_rows(n_sync: int, n_wtg: int, n_hydro: int, n_extended: int, n_stages: int) -> Rows:
    """Return where the parts of a block begin."""
    n = n_sync + n_wtg
    wtg = n_sync * N_MACHINE_ROWS
    # Behind the other rows of its group: loops over lanes become vectors where distances are known to the compiler.
    wtg_stride = N_WTG_ROWS + (N_EXTENSION_ROWS if n_extended > 0 else 0)
    hydro = wtg + n_wtg * wtg_stride
    voltage = hydro + n_hydro * N_HYDRO_ROWS
    lane = voltage + 4 * n + 2 * n * n
    machine_rate = lane + N_LANE_ROWS
    wtg_rate = machine_rate + n_sync * N_MACHINE_STATES
    hydro_rate = wtg_rate + n_wtg * N_WTG_STATES
    extension_rate = hydro_rate + n_hydro * N_HYDRO_STATES
    extremes = extension_rate + n_extended * N_EXTENSION_STATES
    shedding = extremes + n_wtg * N_EXTREMES
    transfer = shedding + n_stages
    fixed = transfer + 2 * n
    return Rows(
        wtg=wtg,
        wtg_stride=wtg_stride,
        hydro=hydro,
        voltage=voltage,
        current=voltage + 2 * n,
        admittance=voltage + 4 * n,
        lane=lane,
        machine_rate=machine_rate,
        wtg_rate=wtg_rate,
        hydro_rate=hydro_rate,
        extension_rate=extension_rate,
        extremes=extremes,
        shedding=shedding,
        transfer=transfer,
        fixed_admittance=fixed,
        extra=fixed + 2 * n * n,
    )


@inlined
def rows_of(c: Any) -> Rows:
    """Return where the parts of a block begin, for a plant's constants."""
    n_wtg = c["share"].shape[0]
    return block_rows(
        c["machines"].shape[0], n_wtg, c["hydro"].shape[0], n_wtg * c["extension"].shape[0], c["shedding"].shape[0]
    )


@inlined
def wtg_row(c: Any, j: int) -> int:
    """Return the first row of WTG group j."""
    rows = rows_of(c)
    return rows.wtg + j * rows.wtg_stride


@dataclass(frozen=True)
class Layout:
    """Rows of a block by name.

    A machine's or group's number is named as in its records without those around it ("speed", "power", "k_offset",
    "peak_power"); a lane's as in :class:`LaneRows`.
    """

    n_sync: int
    n_wtg: int
    n_extra: int = 0
    n_hydro: int = 0
    n_extended: int = 0
    n_stages: int = 0

    @classmethod
    def of(cls, plant: Plant, n_extra: int = 0) -> Layout:
        """Return the layout of a plant's blocks, with `n_extra` rows of the caller's own."""
        c = plant.constants[0]
        n_wtg = c["share"].size
        return cls(c["machines"].size, n_wtg, n_extra, c["hydro"].size, n_wtg * c["extension"].size, c["shedding"].size)

    @cached_property
    def rows(self) -> Rows:
        """First row of each part."""
        rows: Rows = getattr(block_rows, "py_func", block_rows)(
            self.n_sync, self.n_wtg, self.n_hydro, self.n_extended, self.n_stages
        )
        return rows

    @property
    def n_unit(self) -> int:
        """Number of units: synchronous machines and WTG groups."""
        return self.n_sync + self.n_wtg

    @property
    def n_rows(self) -> int:
        """Number of rows of a block."""
        return self.rows.extra + self.n_extra

    def machine(self, name: str) -> npt.NDArray[np.int64]:
        """Return the row of each machine's number of this name (n_sync,), or of each hydro governor's (n_hydro,)."""
        return _machine_rows(self, name)

    def wtg(self, name: str) -> npt.NDArray[np.int64]:
        """Return the row of each WTG group's number of this name (n_wtg,)."""
        return _wtg_rows(self, name)

    def lane(self, name: str) -> int:
        """Return the row of the lane's number of this name."""
        return self.rows.lane + row_of(LaneRows, name)

    @cached_property
    def state_rows(self) -> npt.NDArray[np.int64]:
        """Rows of the state vector: machines, WTG groups, hydro governors, extensions, reference angle."""
        parts = (
            (0, self.n_sync, N_MACHINE_ROWS, N_MACHINE_STATES),
            (self.rows.wtg, self.n_wtg, self.rows.wtg_stride, N_WTG_STATES),
            (self.rows.hydro, self.n_hydro, N_HYDRO_ROWS, N_HYDRO_STATES),
            (self.rows.wtg + N_WTG_ROWS, self.n_extended, self.rows.wtg_stride, N_EXTENSION_STATES),
        )
        rows = [
            (first + np.arange(n)[:, None] * stride + np.arange(states)).ravel() for first, n, stride, states in parts
        ]
        return np.concatenate([*rows, [self.lane("angle")]])

    @cached_property
    def rate_rows(self) -> npt.NDArray[np.int64]:
        """Rows of the time derivatives, in the order of :attr:`state_rows`."""
        return np.append(np.arange(self.rows.machine_rate, self.rows.extremes), self.lane("rate"))

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state vector's entries."""
        names = [f"sync{i}.{name}" for i in range(self.n_sync) for name in short_names(MachineState)]
        names += [f"wtg{j}.{name}" for j in range(self.n_wtg) for name in short_names(WtgState)]
        names += [f"hydro{i}.{name}" for i in range(self.n_hydro) for name in short_names(HydroState)]
        names += [f"wtg{j}.{name}" for j in range(self.n_extended) for name in short_names(ExtensionState)]
        return (*names, "reference_angle")


@lru_cache(maxsize=1024)
def _machine_rows(layout: Layout, name: str) -> npt.NDArray[np.int64]:
    if layout.n_hydro and name in short_names(HydroRows):
        return _every(layout.rows.hydro + row_of(HydroRows, name), N_HYDRO_ROWS, layout.n_hydro)
    return _every(row_of(MachineRows, name), N_MACHINE_ROWS, layout.n_sync)


@lru_cache(maxsize=1024)
def _wtg_rows(layout: Layout, name: str) -> npt.NDArray[np.int64]:
    rows = layout.rows
    if name in WtgExtremes._fields:
        return _every(rows.extremes + row_of(WtgExtremes, name), N_EXTREMES, layout.n_wtg)
    if layout.n_extended and name in short_names(ExtensionRows):
        return _every(rows.wtg + N_WTG_ROWS + row_of(ExtensionRows, name), rows.wtg_stride, layout.n_wtg)
    return _every(rows.wtg + row_of(WtgRows, name), rows.wtg_stride, layout.n_wtg)


def _every(first: int, stride: int, n: int) -> npt.NDArray[np.int64]:
    rows = first + np.arange(n) * stride
    # Everybody who asks gets the same array.
    rows.setflags(write=False)
    return rows


@inlined
def extension_at(c: Any, j: int, width: int) -> int:
    """Return where the extension of WTG group j begins: behind its other rows."""
    return (wtg_row(c, j) + N_WTG_ROWS) * width
