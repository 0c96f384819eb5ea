"""Series and network events that each lane reads while it runs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.records import dtype


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
