"""Make the golden cases of GENROU machines, parameter files and traces, with ANDES.

ANDES (https://docs.andes.app) is an independent implementation of the same published models: GENROU without saturation,
the SEXS exciter, the governors TGOV1, TGOV1DB and HYGOV, classical machines (GENCLS) and the grid-forming converters
REGF1 and REGF2. Only the network and machine data come from `wtg_gym`; the power flow, the initial state and the
integration are ANDES' own. At bus 2 two units of 50 MVA stand for wind turbine groups with an ideal dc source:
classical machines, or in the case `grid-forming` one REGF1 and one REGF2.

With all gains of their voltage, current and limit controllers at zero these converters are a constant voltage behind a
reactance. The droop of REGF1 on filtered power, ω = 1 + m_p (P_0 - P_f), T_r dP_f/dt = P - P_f, is a swing equation
with M = T_r/m_p and D = 1/m_p; that of REGF2 is one as it stands, without its power filter and its damping by a PLL.

ANDES has no relay that sheds load. In the case `shedding` negative admittances are switched on at given instants. Nor
can the impedance of a line change: where it grows, two lines stand side by side, and the second is opened. An imposed
source is a classical machine of such inertia that only changes of its torque, which ramp its frequency, move it; its
angle jumps because the state is set.

ANDES integrates with the implicit trapezoidal rule, whose error falls with the square of the step. Every trace is made
with several fixed steps, the finest is kept, and what error remains in it is estimated from the two finest ones. Each
step divides 1/16 s, so that all rows and events lie on its grid.

ANDES takes one short step away from each event, half of it with the rates from before the event, and counts its steps
from its end. As ANDES has it, this step takes 0.1 ms, and speeds differ by up to 7e-7 p.u. whatever the step size; here
it takes 1 ns. Three more habits of ANDES are kept from the traces: it adds 1e-8 p.u. to every line's r and x (taken off
the data beforehand), it shortens a fixed step where Newton's method is slow, which is whenever a limit binds, and it
accepts an unfinished iteration that goes to and fro (both switched off).

Its HYGOV works on the system base, where it integrates e instead of e/(r T_r), lets the flow change with 1/T_w whatever
the machine's rating, counts the rating twice in D_t, and leaves ė/r out of the rate limit. The case `hydro` has r T_r =
1 there, D_t = 0 and a rate limit that never binds, and ANDES gets T_w divided by the rating: so the two models are one.

Other models of machines act alone at bus 1 of a network of three buses, where their limits bind; bus 2 has SEXS and
TGOV1. ANDES takes K_1 of IEESGO and the rate limits of IEEEG1 for numbers on the system base, and gets them multiplied
by the rating. It scales the limits of IEEEX1 by the voltage, so that none binds there: IEEET1 has the same regulator.
It has no STAB1: an IEEEST without a filter is one. These traces are extrapolated from the two finest steps to none.
What error remains is estimated by what the finest step has changed in that: where a limit binds within a step, errors
do not fall regularly, and after four iterations ANDES lets no limiter go, which finer steps need not mend.

Usage:
    pip install andes==2.0.0
    python docs/studies/make_andes_cases.py --help
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import json
import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import andes
import numpy as np
import numpy.typing as npt
from andes.routines.daeint import Trapezoid, method_map
from case import EXCITERS, GENROU, GOVERNORS, MACHINE, STABILISERS

from wtg_gym.physics.control_parameters import (
    BoilerGovernorParameters,
    FilterStabiliserParameters,
    GasGovernorParameters,
    LeadLagExciterParameters,
    ReheatGovernorParameters,
    SaturatingExciterParameters,
    SpeedStabiliserParameters,
)
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.machine_parameters import (
    ExciterParameters,
    GovernorParameters,
    HydroGovernorParameters,
    SynchronousMachineParameters,
)
from wtg_gym.physics.network import Branch, Bus, NetworkCase
from wtg_gym.physics.scenario import (
    EVENT_KINDS,
    Fault,
    FrequencyRamp,
    LineTrip,
    MachineOutage,
    PhaseJump,
    ReactanceStep,
)

Floats = npt.NDArray[np.float64]

DURATION_S = 60.0
STEPS_PER_SECOND = (96, 192, 384, 768)
#: Spacing of the rows of a trace, and in the second after an event [s].
ROW_S, FINE_ROW_S, FINE_SPAN_S = 0.25, 0.0625, 1.0
#: Length of ANDES' steps on both sides of an event [s].
EVENT_STEP_S = 1e-9
#: What ANDES adds to the resistance and reactance of every line [p.u.].
LINE_OFFSET_PU = 1e-8
#: What ten significant digits of a trace leave open, and a little more [p.u.].
WRITTEN_PU = 1e-10
#: All buses get one nominal voltage [kV]: the data are per unit throughout.
NOMINAL_KV = 69.0
#: Bus, power flow set-points and data of the units that stand for the wind turbine groups.
UNIT_BUS, UNIT_POWER_PU, UNIT_MVA, UNIT_REACTANCE_PU = 2, 0.65, 50.0, 0.55
#: Model and swing equation of each unit, M [s] and D on its own base, and those of the grid-forming converters.
UNITS = {"2a": ("GENCLS", 10.0, 62.5), "2b": ("GENCLS", 10.0, 62.5)}
FORMING_UNITS = {"2a": ("REGF1", 8.0, 50.0), "2b": ("REGF2", 8.0, 50.0)}
#: An imposed source in their place: nothing but a change of its torque moves such a mass.
SOURCE_M_S = 1e11
SOURCE = {"2": ("GENCLS", SOURCE_M_S, 0.0)}
QUANTITIES = ("w", "Pe", "V")
#: What has an upper limit, by model, and which.
LIMITED = (
    ("TGOV1", "LAG_y", "VMAX"),
    ("SEXS", "LAW_y", "EMAX"),
    ("IEEEX1", "LA_y", "VRMAX"),
    ("IEEET1", "LA_y", "VRMAX"),
    ("IEEEG1", "IAW_y", "PMAX"),
    ("IEESGO", "HL_x", "PMAX"),
    ("GAST", "LAG_y", "VMAX"),
    ("IEEEST", "WO_y", "LSMAX"),
)

NOTE = (
    "Made by make_andes_cases.py with ANDES {version}. System base {base:g} MVA, {frequency:g} Hz, theta in rad. "
    "line: pi model, b/2 at each end, tap on the from side (V_from/tap). load: constant impedance, y = (P - jQ)/V0^2 "
    "with V0 of the power flow in 'bus'. gens: machine data on Sn; gammap, gammaq: shares of the bus' P and Q in "
    "gen_static. GENCLS: constant E behind ra + j xd1. GENROU: no saturation. Both: M dw/dt = Tm - Te - D (w - 1), Te"
    " = psi_d i_q - psi_q i_d (the air-gap power: Te = Pe + ra i^2), d(delta)/dt = 2 pi fn (w - 1), no speed terms in"
    " the stator. sexs: vi = Vref - V; TB dx/dt = vi - x; y = x + TATB (vi - x); TE dEfd/dt = K y - Efd (anti-windup "
    "EMIN..EMAX). tgov1, on Sn: pd = Pref - (w - 1)/R; T1 dg/dt = pd - g (anti-windup VMIN..VMAX); T3 dx/dt = g - x; "
    "Tm = x + T2/T3 (g - x) - Dt (w - 1); Tm constant where there is no governor. events: dG_pu: conductance added; "
    "trip_load_MW: the whole load of the bus, with its reactive part, is disconnected. tolerance [p.u.]: three times "
    "the integration error that is estimated to remain in the traces. Traces: w, V in p.u., Pe terminal electrical "
    "power in p.u. of the system base; no row lies at an event."
)

GOVERNOR_NOTE = (
    " tgov1 with db: pd = Pref - u/R, u: w - 1 beyond -db..db. hygov, on Sn: Tf de/dt = R (gref - c) - (w - 1) - e; "
    "dc/dt = e/(r Tr) + (de/dt)/r (at most VELM, anti-windup GMIN..GMAX); Tg dg/dt = c - g; h = (q/g)^2; "
    "Tw dq/dt = 1 - h; Tm = At h (q - qNL) - Dt g (w - 1)."
)


class Step(NamedTuple):
    """A constant conductance switched on, given as its power at the bus voltage of the power flow [MW]."""

    time_s: float
    bus: int
    power_mw: float


class Trip(NamedTuple):
    """The load of a bus, active and reactive, is disconnected."""

    time_s: float
    bus: int


class Shed(NamedTuple):
    """A share of every load, and of what steps have switched on, is disconnected; later steps come without it."""

    time_s: float
    share: float


GridEvent = Fault | FrequencyRamp | LineTrip | MachineOutage | PhaseJump | ReactanceStep
Event = Step | Trip | Shed | GridEvent


class FixedTrapezoid(Trapezoid):
    """ANDES' trapezoidal rule with a step that stays fixed: ANDES shortens it where Newton's method is slow."""

    @staticmethod
    def calc_h(tds: Any) -> None:
        """Keep the step, or give up where the last one did not converge."""
        tds.deltat = tds.config.tstep if tds.converged else 0.0
        tds.busted = not tds.converged


method_map["fixed_trapezoid"] = FixedTrapezoid


@dataclass(frozen=True)
class Case:
    """One parameter file and its traces, by the key of their events; limits are those of the data but where given."""

    name: str
    events: dict[str, tuple[Event, ...]]
    governor: dict[str, float] = field(default_factory=dict)
    field_max_pu: dict[int, float] = field(default_factory=dict)  # by bus of the machine
    resistance_pu: dict[int, float] = field(default_factory=dict)  # by bus of the machine, on its base
    hydro: bool = False
    units: dict[str, tuple[str, float, float]] = field(default_factory=lambda: UNITS)
    duration_s: float = DURATION_S
    network: NetworkCase | None = None  # in place of the modified IEEE 14-bus system
    extrapolations: int = 0  # to a step of zero, each from two steps or from two results of the one before


STEPS_UP = (Step(5.0, 2, 75.0), Step(30.0, 3, 75.0))
SHEDDING = (Step(5.0, 2, 150.0), Shed(5.5, 0.05), Shed(5.625, 0.08), Shed(5.8125, 0.08), Step(30.0, 3, 75.0))
FAULTS = (
    Fault(time_s=1.0, bus=9, clears_after_s=0.125, resistance_pu=0.05, reactance_pu=0.1),
    Fault(time_s=7.0, bus=4, clears_after_s=0.125, resistance_pu=0.01, reactance_pu=0.05, opens=(2, 4)),
    ReactanceStep(time_s=13.0, from_bus=1, to_bus=5, factor=2.0),
)
#: Without 142 MW of load the units at bus 2 carry the rest.
OUTAGE = (Trip(1.0, 3), Trip(1.0, 4), MachineOutage(time_s=1.0, bus=1))
#: Lines around buses 2, 3 and 4: 65 MW of generation, 164 MW of load. The other island has 95 MW too much.
CUT = ((1, 2), (2, 5), (4, 5), (4, 7), (4, 9))
ISLANDS = (
    LineTrip(time_s=1.0, from_bus=2, to_bus=4, recloses_after_s=0.5),
    *(LineTrip(time_s=4.0, from_bus=a, to_bus=b) for a, b in CUT),
    MachineOutage(time_s=12.0, bus=8),
)
SOURCE_EVENTS = (
    PhaseJump(time_s=1.0, bus=UNIT_BUS, angle_deg=10.0),
    FrequencyRamp(time_s=7.0, bus=UNIT_BUS, rocof_hz_s=-0.05, duration_s=2.0),
)


def two_machines(**first: Any) -> NetworkCase:
    """Return two machines and a load between them; the first has the controls that are given, else SEXS."""
    rotor: dict[str, Any] = {
        "rating_mva": 200.0,
        "two_h_s": 8.0,
        "x_d": 1.8,
        "x_q": 1.7,
        "x_d_transient": 0.3,
        "x_q_transient": 0.55,
        "x_subtransient": 0.25,
        "x_leakage": 0.2,
        "t_d0_transient_s": 8.0,
        "t_d0_subtransient_s": 0.03,
        "t_q0_transient_s": 0.4,
        "t_q0_subtransient_s": 0.05,
        "resistance": 0.0025,
        "damping_pu": 0.0,
        "exciter": ExciterParameters(),
        "governor": None,
    }
    second = {**rotor, "bus": 2, "dispatch_mw": 80.0, "governor": GovernorParameters(droop_pu=0.05)}
    lines = ((1, 3, 0.005, 0.05), (2, 3, 0.005, 0.06), (1, 2, 0.01, 0.1))
    return NetworkCase(
        name="two machines",
        base_mva=100.0,
        frequency_hz=50.0,
        slack_bus=1,
        buses=(
            Bus(number=1, voltage_pu=1.03),
            Bus(number=2, voltage_pu=1.01),
            Bus(number=3, load_mw=200.0, load_mvar=60.0),
        ),
        branches=tuple(Branch(from_bus=a, to_bus=b, resistance=r, reactance=x, charging=0.02) for a, b, r, x in lines),
        machines=(
            SynchronousMachineParameters(**{**rotor, "bus": 1, **first}),
            SynchronousMachineParameters(**second),
        ),
    )


#: A load comes, a line opens, and most of the load goes again.
BOTH_WAYS = (Step(0.5, 3, 60.0), LineTrip(time_s=1.5, from_bus=1, to_bus=2), Step(3.0, 3, -50.0))
_EXCITER: dict[str, float] = {
    "regulator_gain": 40.0,
    "feedback_gain_s": 0.06,
    "saturation_voltage_1_pu": 1.5,
    "saturation_1": 0.06,
    "saturation_voltage_2_pu": 3.0,
    "saturation_2": 0.3,
}
#: Models of machines that act alone, by the names of their cases.
ALONE: dict[str, dict[str, Any]] = {
    "saturation": {"saturation_1_0": 0.1, "saturation_1_2": 0.4},
    "stab1": {"stabiliser": SpeedStabiliserParameters(signal_limit_pu=0.02)},
    "ieeest": {
        "stabiliser": FilterStabiliserParameters(
            filter_a1_s=0.1,
            filter_a2_s2=0.005,
            filter_a3_s=0.08,
            filter_a4_s2=0.002,
            filter_a5_s=0.05,
            filter_a6_s2=0.001,
            lead_time_1_s=0.2,
            lag_time_1_s=0.05,
            lead_time_2_s=0.1,
            lag_time_2_s=0.05,
            washout_gain_s=5.0,
            washout_time_s=5.0,
            gain=10.0,
            signal_min_pu=-0.015,
            signal_max_pu=0.02,
        )
    },
    "ieeet1": {"exciter": SaturatingExciterParameters(**_EXCITER, regulator_max_pu=2.4)},
    "ieeex1": {"exciter": LeadLagExciterParameters(**_EXCITER, lead_time_s=0.5, lag_time_s=1.5)},
    "ieeeg1": {
        "governor": BoilerGovernorParameters(
            lag_time_s=0.2,
            lead_time_s=0.5,
            gate_max_pu=0.69,
            fraction_1=0.3,
            fraction_2=0.3,
            fraction_3=0.25,
            fraction_4=0.15,
            pass_time_4_s=0.3,
        )
    },
    "ieesgo": {"governor": ReheatGovernorParameters(lag_time_s=0.1, lead_time_s=0.3, gate_max_pu=0.66)},
    "gast": {
        "governor": GasGovernorParameters(
            exhaust_time_s=2.0, load_limit_pu=0.66, temperature_gain=2.0, gate_max_pu=0.72, turbine_damping_pu=0.5
        )
    },
}


def without_limits(network: NetworkCase) -> NetworkCase:
    """Return a network whose limits are out of reach: where one binds, the error of a step does not fall regularly."""
    far = {"signal_limit_pu": 9.0, "field_min_pu": -99.0, "field_max_pu": 99.0, "gate_min_pu": -9.0, "gate_max_pu": 9.0}

    def widened(control: Any) -> Any:
        if control is None:
            return None
        return dataclasses.replace(control, **{name: far[name] for name in vars(control).keys() & far.keys()})

    names = ("exciter", "governor", "stabiliser")
    machines = (dataclasses.replace(m, **{n: widened(getattr(m, n)) for n in names}) for m in network.machines)
    return dataclasses.replace(network, machines=tuple(machines))


#: On 39 buses: every class of event.
ON_39_BUSES = without_limits(get_grid("ieee39").case)
ON_39 = {
    "loads": (Trip(1.0, 8), Step(4.0, 20, 200.0)),
    "lines": (
        LineTrip(time_s=1.0, from_bus=16, to_bus=17),
        Fault(time_s=4.0, bus=3, clears_after_s=0.125, resistance_pu=0.005, reactance_pu=0.02, opens=(3, 4)),
        ReactanceStep(time_s=7.0, from_bus=25, to_bus=26, factor=2.0),
    ),
    "outage": (MachineOutage(time_s=1.0, bus=32),),
}
CASES = (
    Case("genrou", {"a": STEPS_UP, "b": (Trip(5.0, 4), Trip(30.0, 9))}),
    Case(
        "limits",
        {"a": (*STEPS_UP, Step(42.375, 3, -45.0))},
        governor={"gate_max_pu": 0.49},
        field_max_pu={3: 1.95, 8: 2.0},
        resistance_pu={1: 0.003},
    ),
    Case("dead-band", {"a": STEPS_UP}, governor={"dead_band_pu": 6e-4}),
    Case("hydro", {"a": STEPS_UP}, hydro=True),
    Case("grid-forming", {"a": STEPS_UP}, units=FORMING_UNITS),
    Case("shedding", {"a": SHEDDING}),
    Case("grid-events", {"faults": FAULTS, "islands": ISLANDS, "outage": OUTAGE}, duration_s=20.0),
    Case("imposed-source", {"a": SOURCE_EVENTS}, units=SOURCE, duration_s=20.0),
    Case("ieee39", ON_39, units={}, duration_s=10.0, network=ON_39_BUSES, extrapolations=2),
    *(
        Case(name, {"a": BOTH_WAYS}, units={}, duration_s=6.0, network=two_machines(**own), extrapolations=1)
        for name, own in ALONE.items()
    ),
)


class Trace(NamedTuple):
    """Rows of one run: times (n,), speeds and powers (n, machines), voltages (n, buses)."""

    t: Floats
    w: Floats
    Pe: Floats
    V: Floats
    at_limit_s: dict[str, float]


def network_of(case: Case) -> NetworkCase:
    """Return the case's network: the modified IEEE 14-bus system with its limits, resistances and governor, if none."""
    if case.network is not None:
        return case.network
    network = get_grid("ieee14").case
    machines = []
    for m in network.machines:
        governor, exciter = m.governor, m.exciter
        if case.hydro and governor is not None:
            governor = HydroGovernorParameters(
                temporary_droop_pu=0.4,
                reset_time_s=m.rating_mva / network.base_mva / 0.4,
                gate_rate_limit_pu_s=10.0,
                turbine_damping_pu=0.0,
            )
        elif governor is not None:
            governor = dataclasses.replace(governor, **{"dead_band_pu": 0.0, **case.governor})
        if exciter is not None and m.bus in case.field_max_pu:
            exciter = dataclasses.replace(exciter, field_max_pu=case.field_max_pu[m.bus])
        resistance = case.resistance_pu.get(m.bus, m.resistance)
        machines.append(dataclasses.replace(m, governor=governor, exciter=exciter, resistance=resistance))
    return dataclasses.replace(network, machines=tuple(machines))


def named(names: Mapping[str, str], record: Any) -> dict[str, float]:
    """Return ANDES' parameters of a record, without a dead band of zero."""
    return {key: getattr(record, name) for name, key in names.items() if key != "db" or getattr(record, name)}


def genrou_data(m: SynchronousMachineParameters) -> dict[str, float]:
    """Return ANDES' parameters of a GENROU on its own base."""
    own = {**named(MACHINE | GENROU, m), "xq2": m.x_subtransient, "gammap": 1.0, "gammaq": 1.0}
    order = "Sn M D ra xl xd xq xd1 xq1 xd2 xq2 Td10 Td20 Tq10 Tq20 gammap gammaq"
    order += " S10 S12" if m.saturation_1_2 else ""
    return {key: own[key] for key in order.split()}


def control_data(record: Any, kinds: Mapping[str, tuple[Any, Mapping[str, str]]]) -> tuple[str, dict[str, float]]:
    """Return the model of a machine's control, "" where there is none, and its parameters as the file has them."""
    for model, (kind, names) in kinds.items():
        if type(record) is kind:
            return model, named(names, record)
    return "", {}


def andes_control(model: str, data: dict[str, float], rating: float) -> tuple[str, dict[str, float]]:
    """Return ANDES' model and parameters of a control; `rating` is that of its machine on the system base."""
    if model == "hygov":
        return "HYGOV", {**data, "Tw": data["Tw"] / rating}
    if model == "tgov1" and "db" in data:
        rest = {key: value for key, value in data.items() if key != "db"}
        return "TGOV1DB", {**rest, "dbL": -data["db"], "dbU": data["db"]}
    if model == "ieeeg1":
        rest = {key: value for key, value in data.items() if key != "R"}
        return "IEEEG1", {**rest, "K": 1.0 / data["R"], "UO": rating * data["UO"], "UC": rating * data["UC"]}
    if model == "ieesgo":
        rest = {key: value for key, value in data.items() if key != "R"}
        return "IEESGO", {**rest, "K1": rating / data["R"]}
    if model == "ieeex1":
        rest = {key: value for key, value in data.items() if key not in ("KF", "TF")}
        return "IEEEX1", {**rest, "KF1": data["KF"], "TF1": data["TF"]}
    if model == "stab1":
        filters = dict.fromkeys(("A1", "A2", "A3", "A4", "A5", "A6"), 0.0)
        leads = {"T1": data["T1"], "T2": data["T3"], "T3": data["T2"], "T4": data["T4"]}
        limits = {"LSMAX": data["HLIM"], "LSMIN": -data["HLIM"]}
        return "IEEEST", {**filters, **leads, "T5": data["T"], "T6": data["T"], "KS": data["K"], **limits}
    return model.upper(), data


def unit_data(case: Case, two_h_s: float, damping_pu: float) -> dict[str, float]:
    """Return one of the units at bus 2 as a classical machine."""
    own = {"Sn": UNIT_MVA, "M": two_h_s, "D": damping_pu, "ra": 0.0, "xd1": UNIT_REACTANCE_PU}
    return {**own, **dict.fromkeys(("gammap", "gammaq"), 1.0 / len(case.units))}


def forming_data(model: str, unit: dict[str, float], base_mva: float) -> dict[str, float]:
    """Return ANDES' parameters of a REGF1 or REGF2 with a unit's swing equation; its droop is on the system base."""
    idle = ("KPi", "KIi", "KPv", "KIv", "KPplim", "KIplim", "KPqlim", "KIqlim")
    swing = {"Tr": 0.0, "mf": unit["M"] * UNIT_MVA / base_mva, "dd": 0.0}
    own = swing if model == "REGF2" else {"Tr": unit["M"] / unit["D"]}
    return {
        **{key: unit[key] for key in ("Sn", "gammap", "gammaq")},
        "rf": unit["ra"],
        "xf": unit["xd1"],
        "wdrp": base_mva / UNIT_MVA / unit["D"],
        **own,
        **dict.fromkeys(idle, 0.0),
        **dict.fromkeys(("Pmax", "Qmax"), 99.0),
        **dict.fromkeys(("Pmin", "Qmin"), -99.0),
    }


def line_data(network: NetworkCase) -> list[dict[str, Any]]:
    """Return the branches in the form of the parameter file."""
    return [
        {
            "f": branch.from_bus,
            "t": branch.to_bus,
            "r": branch.resistance,
            "x": branch.reactance,
            "b": branch.charging,
            "tap": branch.tap,
            "phi": 0.0,
        }
        for branch in network.branches
    ]


def load_data(network: NetworkCase) -> list[dict[str, Any]]:
    """Return the loads in the form of the parameter file."""
    base = network.base_mva
    return [
        {"bus": b.number, "P": b.load_mw / base, "Q": b.load_mvar / base}
        for b in network.buses
        if b.load_mw or b.load_mvar
    ]


def shunt_data(network: NetworkCase) -> list[dict[str, Any]]:
    """Return the shunts in the form of the parameter file."""
    return [{"bus": b.number, "g": 0.0, "b": b.shunt_mvar / network.base_mva} for b in network.buses if b.shunt_mvar]


def build_system(
    case: Case, network: NetworkCase, events: Sequence[Event], voltage: dict[int, float] | None = None
) -> Any:
    """Return an ANDES system with its power flow solved; steps and shedding need the bus voltages of that [p.u.]."""
    system = andes.System(default_config=True, no_output=True)
    base, frequency = network.base_mva, network.frequency_hz
    system.config.freq = frequency
    common = {"Vn": NOMINAL_KV}
    for b in network.buses:
        system.add("Bus", idx=b.number, name=f"bus {b.number}", v0=b.voltage_pu or 1.0, a0=0.0, **common)
    for name, line in named_lines(network, events):
        ends = {"bus1": line.pop("f"), "bus2": line.pop("t"), "Vn1": NOMINAL_KV, "Vn2": NOMINAL_KV}
        line |= {"r": line["r"] - LINE_OFFSET_PU, "x": line["x"] - LINE_OFFSET_PU, "trans": int(line["tap"] != 1.0)}
        system.add("Line", idx=name, Sn=base, fn=frequency, **ends, **line)
    loads, shunts = ({entry["bus"]: entry for entry in of(network)} for of in (load_data, shunt_data))
    for bus in network.bus_numbers:
        if bus in loads:
            power = {"p0": loads[bus]["P"], "q0": loads[bus]["Q"], "vmin": 0.1, "vmax": 2.0}
            system.add("PQ", idx=f"load {bus}", bus=bus, **power, **common)
        if bus in shunts:
            system.add("Shunt", idx=f"shunt {bus}", Sn=base, **shunts[bus], **common)
    dispatch = {m.bus: m.dispatch_mw / base for m in network.machines}
    dispatch |= {UNIT_BUS: UNIT_POWER_PU} if case.units else {}
    for bus, power in sorted(dispatch.items()):
        held = {"idx": f"static {bus}", "bus": bus, "v0": network.buses[network.bus_index(bus)].voltage_pu}
        if bus == network.slack_bus:
            system.add("Slack", a0=0.0, **held, **common)
        else:
            system.add("PV", p0=power, qmin=-9.0, qmax=9.0, **held, **common)
    for m in network.machines:
        key = str(m.bus)
        data = {"S10": 0.0, "S12": 1.0, **genrou_data(m), **common}
        system.add("GENROU", idx=key, bus=m.bus, gen=f"static {key}", fn=frequency, **data)
        for what, record, kinds, of in (
            ("exciter", m.exciter, EXCITERS, {"syn": key}),
            ("governor", m.governor, GOVERNORS, {"syn": key}),
            ("stabiliser", m.stabiliser, STABILISERS, {"avr": f"exciter {key}", "MODE": 1}),
        ):
            if record is not None:
                model, data = andes_control(*control_data(record, kinds), m.rating_mva / base)
                system.add(model, idx=f"{what} {key}", **of, **data)
    for key, (model, *swing) in case.units.items():
        data = unit_data(case, *swing)
        own = {**data, **common} if model == "GENCLS" else forming_data(model, data, base)
        system.add(model, idx=key, bus=UNIT_BUS, gen=f"static {UNIT_BUS}", fn=frequency, **own)
    for i, event in enumerate(events):
        for k, (model, device, time_s) in enumerate(toggles(event, network)):
            system.add("Toggle", idx=f"event {i} {k}", model=model, dev=device, t=time_s)
        if isinstance(event, Fault):
            impedance = {"rf": event.resistance_pu, "xf": event.reactance_pu}
            system.add("Fault", idx=f"fault {i}", bus=event.bus, tf=event.time_s, tc=event.end_s, **impedance)
        for k, (constant, amount, time_s) in enumerate(alterations(event, network)):
            source = {"model": "GENCLS", "dev": str(UNIT_BUS), "src": constant, "method": "+", "amount": amount}
            system.add("Alter", idx=f"alteration {i} {k}", t=time_s, **source)
        if not isinstance(event, (Step, Shed)):
            continue
        assert voltage is not None
        for k, (bus, admittance) in enumerate(changes(event, events, network, voltage)):
            added = {"idx": f"change {i} {k}", "bus": bus, "u": 0, **common}
            system.add("Shunt", g=admittance.real, b=admittance.imag, Sn=base, **added)
            system.add("Toggle", idx=f"event {i} {k}", model="Shunt", dev=added["idx"], t=event.time_s)
    # Constant impedances: no share of constant power or current.
    system.PQ.config.update(p2p=0.0, p2i=0.0, p2z=1.0, q2q=0.0, q2i=0.0, q2z=1.0)
    system.setup()
    system.PFlow.config.update(tol=1e-12)
    if not system.PFlow.run():
        raise RuntimeError("ANDES' power flow did not converge")
    return system


def line_name(network: NetworkCase, from_bus: int, to_bus: int) -> str:
    """Return ANDES' name of a branch."""
    return f"line {network.branch_index(from_bus, to_bus)}"


def named_lines(network: NetworkCase, events: Sequence[Event]) -> list[tuple[str, dict[str, Any]]]:
    """Return ANDES' names and data of all lines; two stand for one whose impedance will grow by a factor."""
    lines = [(f"line {i}", line) for i, line in enumerate(line_data(network))]
    for e in events:
        if isinstance(e, ReactanceStep):
            stays = dict(lines)[line_name(network, e.from_bus, e.to_bus)]
            lost = {key: stays[key] * e.factor / (e.factor - 1.0) for key in ("r", "x")}
            lines.append((line_name(network, e.from_bus, e.to_bus) + " lost", {**stays, **lost, "b": 0.0}))
            stays |= {key: stays[key] * e.factor for key in ("r", "x")}
    return lines


def toggles(event: Event, network: NetworkCase) -> list[tuple[str, str, float]]:
    """Return model, name and instant [s] of every device that an event switches."""
    if isinstance(event, Trip):
        return [("PQ", f"load {event.bus}", event.time_s)]
    if isinstance(event, MachineOutage):
        return [("GENROU", str(event.bus), event.time_s)]
    if isinstance(event, Fault) and event.opens is not None:
        return [("Line", line_name(network, *event.opens), event.end_s)]
    if isinstance(event, ReactanceStep):
        return [("Line", line_name(network, event.from_bus, event.to_bus) + " lost", event.time_s)]
    if isinstance(event, LineTrip):
        name = line_name(network, event.from_bus, event.to_bus)
        return [("Line", name, time_s) for time_s in sorted({event.time_s, event.end_s})]
    return []


def alterations(event: Event, network: NetworkCase) -> list[tuple[str, float, float]]:
    """Return what an event adds to the source: to its angle [rad] or its torque [p.u. of the system base], and when."""
    if isinstance(event, PhaseJump):
        return [("delta", math.radians(event.angle_deg), event.time_s)]
    if isinstance(event, FrequencyRamp):
        torque = SOURCE_M_S * UNIT_MVA / network.base_mva * event.rocof_hz_s / network.frequency_hz
        return [("tm0", torque, event.time_s), ("tm0", -torque, event.end_s)]
    return []


def changes(
    event: Step | Shed, events: Sequence[Event], network: NetworkCase, voltage: dict[int, float]
) -> list[tuple[int, complex]]:
    """Return the buses of an event and the admittances that it adds there [p.u.]."""
    stages = [e for e in events if isinstance(e, Shed)]
    steps = [(e.bus, complex(e.power_mw), e.time_s) for e in events if isinstance(e, Step)]
    if isinstance(event, Step):
        served = 1.0 - sum(e.share for e in stages if e.time_s < event.time_s)
        powers = [(event.bus, served * event.power_mw + 0j)]
    else:
        loads = [(b.number, complex(b.load_mw, b.load_mvar)) for b in network.buses if b.load_mw or b.load_mvar]
        present = loads + [(bus, power) for bus, power, time_s in steps if time_s < event.time_s]
        powers = [(bus, -event.share * power) for bus, power in present]
    return [(bus, power.conjugate() / network.base_mva / voltage[bus] ** 2) for bus, power in powers]


def machine_keys(case: Case, network: NetworkCase, events: Sequence[Event]) -> tuple[str, ...]:
    """Return the names of the machines that stay, in the order of their buses; an imposed source is none."""
    lost = [event.bus for event in events if isinstance(event, MachineOutage)]
    units = () if case.units is SOURCE else case.units
    return tuple(sorted([*(str(m.bus) for m in network.machines if m.bus not in lost), *units]))


def row_times(events: Sequence[Event], duration_s: float) -> Floats:
    """Return the times of a trace's rows [s]."""
    coarse = np.arange(round(duration_s / ROW_S) + 1) * ROW_S
    instants = [e.time_s for e in events] + [e.end_s for e in events if isinstance(e, GridEvent)]
    fine = [instant + np.arange(1, round(FINE_SPAN_S / FINE_ROW_S) + 1) * FINE_ROW_S for instant in instants]
    return np.setdiff1d(np.concatenate([coarse, *fine]), instants)


def simulate(
    case: Case, network: NetworkCase, events: Sequence[Event], voltage: dict[int, float], steps_per_second: int
) -> Trace:
    """Integrate one event list with a fixed step and return the rows to keep."""
    system = build_system(case, network, events, voltage)
    system.store_switch_times = functools.partial(system.store_switch_times, eps=EVENT_STEP_S)
    # Residuals are not scaled by the step: beside 1 ns of the torque that moves a source ANDES takes its step for lost.
    fixed = {"fixt": 1, "shrinkt": 0, "method": "fixed_trapezoid", "chatter_iter": 1000, "linesearch": 0, "g_scale": 0}
    quiet = {"max_iter": 100, "reset_tiny": 0, "criteria": 0, "no_tqdm": 1}
    system.TDS.config.update(tf=case.duration_s, tstep=1.0 / steps_per_second, tol=1e-11, **fixed, **quiet)
    if not (system.TDS.run(no_summary=True) and system.TDS.test_ok and system.exit_code == 0):
        raise RuntimeError("ANDES' time-domain simulation failed")
    series = system.dae.ts
    t, x, y = np.asarray(series.t), np.asarray(series.x), np.asarray(series.y)

    speed, power = {}, {}
    for model in ("GENROU", "GENCLS", "REGF1", "REGF2"):
        m = getattr(system, model)
        for i, key in enumerate(m.idx.v):
            power[key] = y[:, m.Pe.a[i]]
            # A converter's speed is in the rate of its angle [rad/s], here before limits that are out of reach.
            speed[key] = x[:, m.omega.a[i]] if model[:3] == "GEN" else 1.0 + y[:, m.dw_x.a[i]] / m.w0.v[i]
    keys = machine_keys(case, network, events)
    before = t < min(e.time_s for e in events) - 0.5 * EVENT_STEP_S
    drift = np.abs(x[before] - x[0]).max()
    if drift > 1e-9:
        raise RuntimeError(f"ANDES does not start in equilibrium: a state drifts by {drift:.1e} before the first event")

    wanted = row_times(events, case.duration_s)
    at = np.array([np.argmin(np.abs(t - row)) for row in wanted])
    if np.abs(t[at] - wanted).max() > 10.0 * EVENT_STEP_S:
        raise RuntimeError("a row does not lie on the grid of time steps")

    # Times that machines that stay spend at an upper limit, for the summary only.
    step = np.diff(t, append=t[-1])
    at_limit = {}
    for model, state, limit in LIMITED:
        m = getattr(system, model)
        for i, name in enumerate(m.idx.v):
            own = getattr(m, state)
            held = (x if own.v_code == "x" else y)[:, own.a[i]] > getattr(m, limit).v[i] - 1e-9
            at_limit[name] = float(step[held].sum()) if m.syn.v[i] in keys else 0.0
    columns = (np.column_stack([found[key][at] for key in keys]) for found in (speed, power))
    return Trace(wanted, *columns, y[np.ix_(at, system.Bus.v.a)], at_limit)


def difference(trace: Trace, other: Trace) -> dict[str, float]:
    """Return the largest difference per quantity."""
    return {q: float(np.abs(getattr(trace, q) - getattr(other, q)).max()) for q in QUANTITIES}


def extrapolated(traces: Sequence[Trace], steps: Sequence[int], times: int) -> Trace:
    """Return the finest trace, extrapolated to a step of zero so often: errors are a series of even powers of it."""
    found = list(traces)
    for order in range(1, times + 1):
        ratios = [(after / before) ** 2 for before, after in zip(steps[:-order], steps[order:], strict=True)]
        found = [
            finer._replace(
                **{q: getattr(finer, q) + (getattr(finer, q) - getattr(coarser, q)) / (ratio - 1.0) for q in QUANTITIES}
            )
            for (coarser, finer), ratio in zip(itertools.pairwise(found), ratios, strict=True)
        ]
    return found[-1]


def event_data(
    event: Event, events: Sequence[Event], network: NetworkCase, voltage: dict[int, float]
) -> list[dict[str, Any]]:
    """Return an event in the form of the parameter file."""
    if isinstance(event, GridEvent):
        kind = next(kind for kind, record in EVENT_KINDS.items() if record is type(event))
        return [{"kind": kind, **{key: value for key, value in vars(event).items() if value is not None}}]
    if isinstance(event, Trip):
        load = network.buses[network.bus_index(event.bus)].load_mw
        return [{"t": event.time_s, "bus": event.bus, "trip_load_MW": load}]
    found = []
    for bus, admittance in changes(event, events, network, voltage):
        entry = {"t": event.time_s, "bus": bus, "dG_pu": admittance.real}
        if isinstance(event, Step):
            entry["MW_at_V0"] = admittance.real * network.base_mva * voltage[bus] ** 2
        else:
            entry["dB_pu"] = admittance.imag
        found.append(entry)
    return found


def parameter_file(case: Case, network: NetworkCase, system: Any, tolerance: dict[str, float]) -> dict[str, Any]:
    """Return the contents of a parameter file; `system` has the power flow."""
    voltage = dict(zip(system.Bus.idx.v, system.Bus.v.v.tolist(), strict=True))
    static = {}
    for model in (system.Slack, system.PV):
        for bus, p, q in zip(model.bus.v, model.p.v.tolist(), model.q.v.tolist(), strict=True):
            static[str(bus)] = {"P": p, "Q": q}
    gens: dict[str, dict[str, Any]] = {
        str(m.bus): {"model": "GENROU", "bus": m.bus, **genrou_data(m)} for m in network.machines
    }
    common = {"model": "source" if case.units is SOURCE else "GENCLS", "bus": UNIT_BUS}
    gens |= {key: {**common, **unit_data(case, *swing)} for key, (_, *swing) in case.units.items()}
    note = NOTE.format(version=andes.__version__, base=network.base_mva, frequency=network.frequency_hz)
    forming = [f"{key} is a {model}" for key, (model, *_) in case.units.items() if model != "GENCLS"]
    units = f" In ANDES {' and '.join(forming)}; M, D and xd1 are those of its equivalent." if forming else ""
    controls: dict[str, list[dict[str, Any]]] = {"sexs": [], "tgov1": []}
    for m in network.machines:
        own = (m.exciter, EXCITERS, {}), (m.stabiliser, STABILISERS, {}), (m.governor, GOVERNORS, {"bus": m.bus})
        for record, kinds, place in own:
            kind, data = control_data(record, kinds)
            if kind:
                controls.setdefault(kind, []).append({"gen": str(m.bus), **place, **data})
    others = [kind for kind in controls if kind not in ("sexs", "tgov1", "hygov")]
    alone = f" {', '.join(others)}: as in PSS/E, see wtg_gym/physics." if others else ""
    saturates = any(m.saturation_1_2 for m in network.machines)
    note = note.replace("GENROU: no saturation", "GENROU: saturation S10, S12") if saturates else note
    return {
        "note": note + (GOVERNOR_NOTE if case.hydro or "dead_band_pu" in case.governor else "") + units + alone,
        "fn": network.frequency_hz,
        "Sbase": network.base_mva,
        "bus": [
            {"bus": b.number, "V": voltage[b.number], "theta": a, "Vn": NOMINAL_KV}
            for b, a in zip(network.buses, system.Bus.a.v.tolist(), strict=True)
        ],
        "line": line_data(network),
        "shunt": shunt_data(network),
        "load": load_data(network),
        "gen_static": dict(sorted(static.items())),
        "gens": dict(sorted(gens.items())),
        **controls,
        "events": {
            key: [entry for e in events for entry in event_data(e, events, network, voltage)]
            for key, events in case.events.items()
        },
        "tolerance": tolerance,
    }


def write_trace(path: Path, trace: Trace, keys: Sequence[str], network: NetworkCase) -> None:
    """Write a trace as CSV with ten significant digits."""
    pairs = [pair for i in range(trace.w.shape[1]) for pair in (trace.w[:, i], trace.Pe[:, i])]
    names = [name for key in keys for name in (f"w{key}", f"Pe{key}")]
    names += [f"V{b.number}" for b in network.buses]
    rows = np.column_stack([trace.t, *pairs, trace.V])
    # Adding zero turns a negative zero into a positive one.
    lines = [",".join(f"{value:.10g}" for value in np.round(row, 12) + 0.0) for row in rows]
    path.write_text("\n".join([",".join(["t", *names]), *lines]) + "\n", encoding="utf-8")


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON as the other parameter files have it."""
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def short(values: dict[str, float]) -> dict[str, float]:
    """Return values with three significant digits."""
    return {key: float(f"{value:.3g}") for key, value in values.items()}


def one_digit_up(value: float) -> float:
    """Return a positive value rounded up to one significant digit."""
    exponent = math.floor(math.log10(value))
    return float(f"{math.ceil(value / 10.0**exponent)}e{exponent}")


def make_case(case: Case, folder: Path, steps: Sequence[int]) -> dict[str, Any]:
    """Write one case's files and return its convergence by event list."""
    (folder / case.name).mkdir(parents=True, exist_ok=True)
    network = network_of(case)
    static = build_system(case, network, ())
    voltage = dict(zip(static.Bus.idx.v, static.Bus.v.v.tolist(), strict=True))
    worst = dict.fromkeys(QUANTITIES, 0.0)
    convergence = {}
    for key, events in case.events.items():
        traces = [simulate(case, network, events, voltage, n) for n in steps]
        finest = traces[-1]
        to_finest = {f"1/{n}": difference(t, finest) for n, t in zip(steps[:-1], traces[:-1], strict=True)}
        remaining = {q: value / 3.0 for q, value in to_finest[f"1/{steps[-2]}"].items()}
        if case.extrapolations:
            finest = extrapolated(traces, steps, case.extrapolations)
            remaining = difference(extrapolated(traces[:-1], steps[:-1], case.extrapolations), finest)
        worst = {q: max(worst[q], remaining[q]) for q in QUANTITIES}
        name = f"{case.name}/{key}.csv"
        write_trace(folder / name, finest, machine_keys(case, network, events), network)
        convergence[name] = {
            "step_s": f"1/{steps[-1]}",
            "largest_difference_to_it_pu": {step: short(d) for step, d in to_finest.items()},
            "estimated_remaining_error_pu": short(remaining),
            "time_at_upper_limit_s": {k: round(v, 3) for k, v in finest.at_limit_s.items() if v > 0.0},
        }
        print(f"{name}: {json.dumps(convergence[name])}; lowest speed {finest.w.min():.5f} p.u.", flush=True)
    tolerance = {q: one_digit_up(max(3.0 * worst[q], WRITTEN_PU)) for q in QUANTITIES}
    write_json(folder / case.name / "params.json", parameter_file(case, network, static, tolerance))
    return convergence


def main(arguments: Sequence[str] | None = None) -> None:
    """Make the cases that are asked for."""
    parser = argparse.ArgumentParser(description="Make the golden cases of GENROU, SEXS and TGOV1 with ANDES.")
    parser.add_argument(
        "--out", type=Path, default=Path("tests/golden"), help="folder for the files (default: tests/golden)"
    )
    parser.add_argument("--case", choices=[c.name for c in CASES], action="append", help="case to make (default: all)")
    parser.add_argument(
        "--steps",
        type=int,
        nargs="+",
        default=list(STEPS_PER_SECOND),
        metavar="N",
        help=f"steps per second, at least three multiples of 16, rising (default: {STEPS_PER_SECOND})",
    )
    options = parser.parse_args(arguments)
    if len(options.steps) < 3 or options.steps != sorted(set(options.steps)) or any(n % 16 for n in options.steps):
        parser.error(f"--steps must be at least three rising multiples of 16, got {options.steps}")
    andes.config_logger(stream_level=logging.WARNING)
    logging.getLogger("andes").setLevel(logging.WARNING)
    path = options.out / "andes_convergence.json"
    traces = json.loads(path.read_text(encoding="utf-8"))["traces"] if options.case and path.exists() else {}
    for case in CASES:
        if not options.case or case.name in options.case:
            traces |= make_case(case, options.out, options.steps)
    note = (
        "Largest difference over all rows and columns of a trace between each step and the finest; the trapezoidal "
        "rule's error falls fourfold with every halving of the step, and these differences about fourfold, fivefold at "
        "the last one, where the finest step's own error counts. Remaining error: a third of the last difference."
    )
    write_json(path, {"note": note, "andes": andes.__version__, "event_step_s": EVENT_STEP_S, "traces": traces})


if __name__ == "__main__":
    main()
