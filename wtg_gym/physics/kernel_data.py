"""Arrays that the kernels read: constants of a plant, which all lanes share, and series and events of each lane."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.systems.programs import Tables
from wtg_gym.systems.records import dtype, flatten


class BranchConstants(NamedTuple):
    """A branch of the network: buses at its ends, and its admittances [p.u.]."""

    start: int
    end: int
    y_ff: complex
    y_ft: complex
    y_tf: complex
    y_tt: complex


class BusConstants(NamedTuple):
    """A bus of the network."""

    shunt: complex  # admittance [p.u.]
    load: complex  # P + jQ of the case [p.u.]
    voltage: float  # held, or where the power flow starts [p.u.]
    holds_voltage: bool


class Facts(NamedTuple):
    """Numbers of a plant, and the first rows of its kinds of unit in a block."""

    slack: int  # bus index
    omega_n: float  # ω_n [rad/s]
    base_mva: float
    simulation_dt: float  # [s]
    n_substeps: int  # simulation steps per control interval
    trips_groups: bool  # the failure of a rotor disconnects its group instead of ending the run
    machines: int
    groups: int
    hydro: int
    extensions: int
    lane: int
    units: int
    pairs: int
    stages: int
    starts: int  # of what units start from, in scratch


class Plant(NamedTuple):
    """A plant as arrays, whose types are the same for every plant.

    The tables say where the systems of a step find rows and constants: see :mod:`wtg_gym.systems.programs`.
    """

    facts: npt.NDArray[np.void]  # (1,), of Facts
    machines: npt.NDArray[np.void]  # (n_sync,), of Machine
    turbine: npt.NDArray[np.void]  # (1,), of Turbine
    hydro: npt.NDArray[np.void]  # (n_hydro,), of HydroGovernor
    extension: npt.NDArray[np.void]  # (1,), of Extension; (0,) where the groups are not extended
    shedding: npt.NDArray[np.void]  # (n_stages,), of SheddingConstants
    cells: npt.NDArray[np.float64]  # of the rotor's C_p table (n, m, 16)
    share: npt.NDArray[np.float64]  # rating of each WTG group on the system base (n_wtg,)
    unit_bus: npt.NDArray[np.int64]  # bus index of each unit, machines first (n_unit,)
    unit_y: npt.NDArray[np.complex128]  # internal admittance of each unit (n_unit,)
    dispatch: npt.NDArray[np.float64]  # power of each machine before the slack's share (n_sync,) [p.u.]
    buses: npt.NDArray[np.void]  # (n_bus,), of BusConstants
    branches: npt.NDArray[np.void]  # (n_branch,), of BranchConstants
    tables: Tables

    @property
    def n_substeps(self) -> int:
        """Simulation steps per control interval."""
        return int(self.facts["n_substeps"][0])

    @property
    def simulation_dt(self) -> float:
        """Step of the integration [s]."""
        return float(self.facts["simulation_dt"][0])


class NetworkEvent(NamedTuple):
    """A change of the network; times in simulation steps, indices -1 for none."""

    start: float
    end: float  # later than start for a ramp, and for a branch that closes again
    bus: int = -1  # of a load
    admittance: complex = 0j  # [p.u.]; power P + jQ until the lane's start turns it into an admittance
    branch: int = -1  # that opens
    unit: int = -1  # that is disconnected; machines first
    governor: int = -1  # that stops acting: its machine


EVENT_DTYPE = dtype(NetworkEvent)
NO_EVENT = np.array([NetworkEvent(np.inf, np.inf)], dtype=EVENT_DTYPE)


class LaneData(NamedTuple):
    """Series and events of each lane, constant while it runs."""

    wind: npt.NDArray[np.float64]  # at the ends of control intervals (n_lanes, n_wtg, n_intervals + 1) [m/s]
    noise: npt.NDArray[np.float64]  # load noise per control interval (n_lanes, n_intervals) [MW]
    noise_bus: npt.NDArray[np.int64]  # (n_lanes,)
    load_y: npt.NDArray[np.complex128]  # load admittance per bus (n_lanes, n_bus)
    events: npt.NDArray[np.void]  # (n_lanes, n_events), of NetworkEvent


def structured(record: type, entries: Any) -> npt.NDArray[Any]:
    """Return entries of a record as a structured array."""
    return np.array([flatten(entry) for entry in entries], dtype=dtype(record))
