"""Arrays of a network that compiled functions read: its constants, which all environments share; series and events."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.layout import Span
from wtg_gym.physics.sparse_flow import Pattern
from wtg_gym.systems.programs import Tables
from wtg_gym.systems.records import structured


class Facts(NamedTuple):
    """Numbers of a plant, and where its kinds of unit lie."""

    slack: int  # bus index
    base_mva: float
    simulation_dt: float  # [s]
    n_substeps: int  # simulation steps per control interval
    n_balances: int  # power flows after which machines share what the slack bus lacks
    is_large: bool  # whether the power flow is solved by sparse elimination
    curtails: bool  # whether WTG groups alone balance the power
    shares_frequency: float  # change of a load's conductance with the frequency [p.u./p.u.]
    # In a block:
    lane: Span = Span()
    machines: Span = Span()
    groups: Span = Span()
    units: Span = Span()
    pairs: Span = Span()
    stages: Span = Span()  # of shedding; those of an island are its rows
    buses: Span = Span()
    islands: Span = Span()
    transfers: Span = Span()
    sources: Span = Span()
    # In scratch:
    starting: Span = Span()  # of the lane


class Network(NamedTuple):
    """What compiled functions read of a plant; the types are the same for every plant.

    The tables say where the systems of a step find rows and constants: see :mod:`wtg_gym.systems.programs`.
    """

    facts: Facts
    branch_ends: npt.NDArray[np.int64]  # bus indices of each branch (n_branch, 2)
    branch_y: npt.NDArray[np.complex128]  # its admittances ff, ft, tf, tt (n_branch, 4) [p.u.]
    branch_series: npt.NDArray[np.complex128]  # the part of its series impedance in them (n_branch, 4) [p.u.]
    shunts: npt.NDArray[np.complex128]  # admittance at each bus (n_bus,) [p.u.]
    unit_bus: npt.NDArray[np.int64]  # bus index of each unit, machines first (n_unit,)
    unit_y: npt.NDArray[np.complex128]  # internal admittance of each unit (n_unit,) [p.u.]
    connected: npt.NDArray[np.int64]  # the row that says whether each unit is connected (n_unit,)
    angles: npt.NDArray[np.int64]  # the row of each unit's angle, -1 for none (n_unit,)
    shed_shares: npt.NDArray[np.float64]  # of the load, by each stage of shedding (n_stages,)
    pattern: Pattern  # of the power flow of a large network
    tables: Tables


class NetworkEvent(NamedTuple):
    """A change of the network; times in simulation steps, indices -1 for none."""

    start: float
    end: float  # later than start for a ramp, a fault, and for what comes back
    bus: int = -1  # of a load
    active: float = 0.0  # the load's P and Q until the run's start, then its admittance; a fault's admittance [p.u.]
    reactive: float = 0.0
    branch: int = -1  # that opens, or whose impedance changes
    unit: int = -1  # that is disconnected; machines first
    governor: int = -1  # that stops acting: its machine
    fault: int = -1  # bus of a fault
    factor: float = 0.0  # on the branch's series impedance; 0: it opens
    source: int = -1  # that an event moves
    jump: float = 0.0  # of its angle [rad]
    ramp: float = 0.0  # of its frequency [p.u./s]


NO_EVENT = structured(NetworkEvent, [NetworkEvent(np.inf, np.inf)])


class LaneData(NamedTuple):
    """Series and events of each environment, constant while it runs."""

    wind: npt.NDArray[np.float64]  # at the ends of control intervals (n_lanes, n_wtg, n_intervals + 1) [m/s]
    noise: npt.NDArray[np.float64]  # load noise per control interval (n_lanes, n_intervals) [MW]
    events: npt.NDArray[Any]  # (n_lanes, n_events), of NetworkEvent
