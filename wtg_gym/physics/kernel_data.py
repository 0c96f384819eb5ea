"""Arrays that the kernels read: constants of a plant, which all lanes share, and series and events of each lane."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.governor import HydroGovernor
from wtg_gym.physics.machine import Machine
from wtg_gym.physics.records import dtype
from wtg_gym.physics.wind_turbine import Extension, Turbine


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


class SheddingConstants(NamedTuple):
    """A stage of load shedding."""

    speed: float  # frequency of the centre of inertia at which it acts [p.u.]
    share: float  # of the load
    delay: float  # [s]


class Plant(NamedTuple):
    """Arrays that the kernels read: constants of the units and time steps, buses, branches."""

    constants: npt.NDArray[np.void]  # (1,), of constants_dtype
    buses: npt.NDArray[np.void]  # (n_bus,), of BusConstants
    branches: npt.NDArray[np.void]  # (n_branch,), of BranchConstants

    @property
    def share(self) -> npt.NDArray[np.float64]:
        """Rating of each WTG group on the system base (n_wtg,)."""
        return np.asarray(self.constants["share"][0])

    @property
    def n_substeps(self) -> int:
        """Simulation steps per control interval."""
        return int(self.constants["n_substeps"][0])

    @property
    def simulation_dt(self) -> float:
        """Step of the integration [s]."""
        return float(self.constants["simulation_dt"][0])


def constants_dtype(
    n_sync: int, n_wtg: int, n_hydro: int, n_stages: int, *, extended: bool, cells: tuple[int, ...]
) -> np.dtype[Any]:
    """Return the data type of a plant's constants: sizes that the compiler knows.

    Parts that a plant lacks take no space, and the compiler drops their code.
    """
    n_unit = n_sync + n_wtg
    return np.dtype(
        [
            ("machines", dtype(Machine), (n_sync,)),
            ("turbine", dtype(Turbine)),
            ("hydro", dtype(HydroGovernor), (n_hydro,)),
            ("extension", dtype(Extension), (1 if extended else 0,)),
            ("shedding", dtype(SheddingConstants), (n_stages,)),
            ("cells", np.float64, cells),  # of the rotor's C_p table
            ("share", np.float64, (n_wtg,)),  # rating of each WTG group on the system base
            ("unit_bus", np.int64, (n_unit,)),  # bus index of each unit, machines first
            ("unit_y", np.complex128, (n_unit,)),  # internal admittance of each unit
            ("dispatch", np.float64, (n_sync,)),  # power of each machine before the slack's share [p.u.]
            ("slack", np.int64),
            ("omega_n", np.float64),  # ω_n [rad/s]
            ("base_mva", np.float64),
            ("simulation_dt", np.float64),  # [s]
            ("n_substeps", np.int64),  # simulation steps per control interval
            ("trips_groups", np.bool_),  # the failure of a rotor disconnects its group instead of ending the run
        ],
        align=True,
    )


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
