"""Where every quantity of a simulation lies in its buffer.

A block holds the complete state of `width` lanes (environments) as one flat array of rows; each row has one value per
lane, so that inner loops run over lanes with unit stride. The rows of one machine or WTG group are neighbours at
fixed distances, which lets the compiler see that they do not overlap.

    sync 0 | sync 1 | … | wtg 0 | wtg 1 | … | network | lane | extra
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.compiled import compiled
from wtg_gym.physics.synchronous_machine import SyncState
from wtg_gym.physics.wind_turbine import WtgState

Floats = npt.NDArray[np.float64]
#: A tuple of zeros as long as a block is wide; its length is known to the compiler.
Lanes = tuple[int, ...]

N_SYNC_STATES = len(SyncState)
N_WTG_STATES = len(WtgState)


class SyncRow(IntEnum):
    """Rows of a synchronous machine after its states."""

    RATE = 10
    BASE = 20
    SUM = 30
    VOLTAGE_REFERENCE = 40
    GATE_REFERENCE = 41
    INV_TWO_H = 42
    INV_DROOP = 43
    SINE = 44
    COSINE = 45
    E_D = 46
    E_Q = 47
    POWER = 48  # air-gap power [p.u. of the system base]
    VOLTAGE = 49  # terminal voltage [p.u.]
    TORQUE = 50  # mechanical torque [p.u. of the system base]
    N_ROWS = 51


class WtgRow(IntEnum):
    """Rows of a WTG group after its states; powers on its own base."""

    RATE = 8
    BASE = 16
    SUM = 24
    EMF = 32  # voltage magnitude behind the reactance [p.u.]
    K_MIN = 33
    K_NOMINAL = 34
    K_MAX = 35
    K_OFFSET = 36  # what a policy adds to g(ω) [p.u.]
    INV_TAU = 37  # [1/s]
    DROOP_CANCELLED = 38
    CONNECTED = 39  # 1 or, after a trip, 0
    WIND_START = 40  # [m/s]
    WIND_END = 41
    WIND = 42
    POWER = 43
    CAPTURED = 44
    COEFFICIENT = 45  # k in use [p.u.]
    PEAK_POWER = 46
    LEAST_TSR = 47
    LARGEST_TSR = 48
    OVERLOAD_TIME = 49  # [s]
    N_ROWS = 50


class LaneRow(IntEnum):
    """Rows of a lane."""

    ANGLE = 0  # of the first unit against a frame at nominal frequency [rad]
    RATE = 1
    BASE = 2
    SUM = 3
    ACTIVE = 4  # 1 while it runs, 0 once it has ended
    STEP = 5  # simulation steps since the reset
    NEXT_CHANGE = 6  # simulation step of the next network change
    STATUS = 7
    COI = 8  # frequency of the centre of inertia [p.u.]
    COI_MIN = 9
    COI_MAX = 10
    NOISE_Z_RE = 11
    NOISE_Z_IM = 12
    NOISE_PER_MW = 13  # admittance per MW of load noise [p.u.]
    LAST_CHANGE = 14  # simulation step at which the network was last reduced
    LEAST_ANGLE = 15  # of all connected units, when the protections last looked [rad]
    LARGEST_ANGLE = 16
    LEAST_VOLTAGE = 17  # at the terminals of all connected units, squared [p.u.²]
    HEALTHY_STEP = 18  # last simulation step at which the protections found no low voltage
    N_ROWS = 19


class Status(IntEnum):
    """Why a lane has ended."""

    RUNNING = 0
    STALL = 1
    OVER_SPEED = 2
    FREQUENCY_LIMIT = 3
    NUMERICAL_FAILURE = 4
    LOSS_OF_SYNCHRONISM = 5
    VOLTAGE_COLLAPSE = 6


class EventColumn(IntEnum):
    """Columns of a lane's table of network events; times in simulation steps, admittances in p.u."""

    START = 0
    END = 1
    BUS = 2
    CONDUCTANCE = 3
    SUSCEPTANCE = 4
    BRANCH = 5  # index of a branch that opens, or -1


class Plant(NamedTuple):
    """What all lanes share: constants of machines, turbine and network (see :mod:`wtg_gym.physics.simulator`)."""

    syncs: tuple[int, ...]  # as long as there are synchronous machines: a length the compiler knows
    wtgs: tuple[int, ...]  # as long as there are WTG groups
    machines: npt.NDArray[np.float64]  # (n_sync, n_constants)
    turbine: npt.NDArray[np.float64]  # (n_constants,)
    share: npt.NDArray[np.float64]  # rating of each WTG group on the system base (n_wtg,)
    unit_bus: npt.NDArray[np.int64]  # bus index of each unit, machines first (n_unit,)
    unit_y: npt.NDArray[np.complex128]  # internal admittance of each unit (n_unit,)
    branch_from: npt.NDArray[np.int64]
    branch_to: npt.NDArray[np.int64]
    branch_y: npt.NDArray[np.complex128]  # (n_branch, 4)
    shunt_y: npt.NDArray[np.complex128]  # (n_bus,)
    load: npt.NDArray[np.complex128]  # P + jQ of the case [p.u.] (n_bus,)
    voltage: npt.NDArray[np.float64]  # held or starting voltage (n_bus,)
    holds_voltage: npt.NDArray[np.bool_]
    dispatch: npt.NDArray[np.float64]  # power of each machine before the slack's share [p.u.] (n_sync,)
    slack: int
    angular_frequency: float  # ω_n [rad/s]
    base_mva: float
    simulation_dt: float  # [s]
    n_substeps: int  # simulation steps per control interval
    trips_groups: bool  # a stalled or over-speeding group is disconnected instead of ending the run


class LaneData(NamedTuple):
    """What each lane was given at its reset, read-only while it runs."""

    wind: npt.NDArray[np.float64]  # at the ends of control intervals (n_lanes, n_wtg, n_intervals + 1) [m/s]
    noise: npt.NDArray[np.float64]  # load noise per control interval (n_lanes, n_intervals) [MW]
    noise_bus: npt.NDArray[np.int64]  # (n_lanes,)
    load_y: npt.NDArray[np.complex128]  # load admittance per bus (n_lanes, n_bus)
    events: npt.NDArray[np.float64]  # (n_lanes, n_events, n_columns)


@dataclass(frozen=True)
class Layout:
    """Sizes and row offsets of a block."""

    n_sync: int
    n_wtg: int
    n_extra: int = 0

    @property
    def n_unit(self) -> int:
        """Number of units: synchronous machines and WTG groups."""
        return self.n_sync + self.n_wtg

    @property
    def wtg(self) -> int:
        """Row at which the WTG groups start."""
        return self.n_sync * SyncRow.N_ROWS

    @property
    def network(self) -> int:
        """Row at which the network starts."""
        return self.wtg + self.n_wtg * WtgRow.N_ROWS

    @property
    def lane(self) -> int:
        """Row at which the lane's own rows start."""
        return self.network + network_rows(self.n_unit)

    @property
    def extra(self) -> int:
        """Row at which rows of the caller's own start."""
        return self.lane + LaneRow.N_ROWS

    @property
    def n_rows(self) -> int:
        """Number of rows of a block."""
        return self.extra + self.n_extra

    @property
    def state_rows(self) -> npt.NDArray[np.int64]:
        """Rows of the state vector: machines, WTG groups, reference angle."""
        rows = [i * SyncRow.N_ROWS + s for i in range(self.n_sync) for s in range(N_SYNC_STATES)]
        rows += [self.wtg + j * WtgRow.N_ROWS + s for j in range(self.n_wtg) for s in range(N_WTG_STATES)]
        return np.array([*rows, self.lane + LaneRow.ANGLE], dtype=np.int64)

    @property
    def rate_rows(self) -> npt.NDArray[np.int64]:
        """Rows of the time derivatives, in the order of :attr:`state_rows`."""
        rows = [i * SyncRow.N_ROWS + SyncRow.RATE + s for i in range(self.n_sync) for s in range(N_SYNC_STATES)]
        rows += [self.wtg + j * WtgRow.N_ROWS + WtgRow.RATE + s for j in range(self.n_wtg) for s in range(N_WTG_STATES)]
        return np.array([*rows, self.lane + LaneRow.RATE], dtype=np.int64)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state vector's entries."""
        names = [f"sync{i}.{s.name.lower()}" for i in range(self.n_sync) for s in SyncState]
        names += [f"wtg{j}.{s.name.lower()}" for j in range(self.n_wtg) for s in WtgState]
        return (*names, "reference_angle")


@compiled
def network_rows(n_unit: int) -> int:
    """Number of network rows: voltages, currents, noise transfer (6 n) and four matrices (4 n²)."""
    return 6 * n_unit + 4 * n_unit * n_unit


@compiled
def network_row(plant: Plant) -> int:
    """Return the row at which the network starts."""
    return len(plant.syncs) * SyncRow.N_ROWS + len(plant.wtgs) * WtgRow.N_ROWS


@compiled
def lane_row(plant: Plant) -> int:
    """Return the row at which the lane's own rows start."""
    return network_row(plant) + network_rows(len(plant.syncs) + len(plant.wtgs))
