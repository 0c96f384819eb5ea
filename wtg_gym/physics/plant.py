"""`Plant`, the description of a plant, and `PlantTables`, its constants as compiled functions read them."""

import dataclasses
import functools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.physics import (
    integration,
    machine_models,
    machine_parameters,
    machine_unit,
    parameters,
    units,
    wind_turbine,
)
from wtg_gym.physics.aerodynamics import surface_of
from wtg_gym.physics.converter import converter_limits, voltage_control
from wtg_gym.physics.devices import SOURCES, Devices, source_units
from wtg_gym.physics.grid import NetworkCase, get_grid
from wtg_gym.physics.layout import Facts, Layout, Network, Span, names_of
from wtg_gym.physics.machine import Machine, RotorSaturation, gate_limits, machine_constants, rotor_saturation
from wtg_gym.physics.network import SPARSE_FROM, assemble_admittance, branch_admittances, pattern_of
from wtg_gym.physics.parameters import TurbineParameters, WtgGroup
from wtg_gym.physics.protection import STAGES, Shedding
from wtg_gym.physics.units import BUSES, ENV, ISLANDS, MAIN, MEMBERS, PAIRS, TRANSFERS, UNITS, Bus, Connection, Phasor
from wtg_gym.physics.wtg_unit import COLUMNS, EXTENSIONS, GROUPS
from wtg_gym.ranges import Checked, design, require_choice, require_known, require_range, whole_steps
from wtg_gym.systems.programs import Code, Complex, Floats, MemoryMap, Program, Whole, link
from wtg_gym.systems.routines import Routine
from wtg_gym.systems.systems import Kind, structured

#: Islands that a network may fall into, of those with a unit.
ISLANDS_AT_MOST = 4
#: Power flows after which machines share what the slack bus lacks: losses, within a thousandth of them.
_BALANCES = 2
#: Integration steps that are accepted [s].
SIMULATION_DT_RANGE = (5e-5, 0.05)


@dataclass(frozen=True, kw_only=True)
class Plant(Checked):
    """A network, its WTG groups and the time steps.

    A ValueError says that a bus is unknown, a step does not divide, or a value is outside its range.
    """

    MOST = MappingProxyType({"groups": parameters.MOST_GROUPS})

    case: NetworkCase = dataclasses.field(default_factory=lambda: get_grid("ieee14").case)
    groups: tuple[WtgGroup, ...] = dataclasses.field(default_factory=parameters.default_groups)
    turbine: TurbineParameters = dataclasses.field(default_factory=TurbineParameters)
    pitch: parameters.PitchParameters = dataclasses.field(default_factory=parameters.PitchParameters)
    control: parameters.GridFormingParameters = dataclasses.field(default_factory=parameters.GridFormingParameters)
    protection: parameters.ProtectionParameters = dataclasses.field(default_factory=parameters.ProtectionParameters)
    limits: parameters.ConverterLimitParameters | None = None  # of every converter, with its chopper; None: the paper's
    voltage_control: parameters.VoltageControlParameters | None = None  # None: constant voltage behind X_g
    shedding: tuple[parameters.SheddingStage, ...] = ()  # of load at a low frequency, which every island has
    secondary_time_s: float = 0.0  # integration time of secondary control, against each governor's droop; 0: none [s]
    #: Whether machines with a governor share the initial load by rating and largest gate (1 p.u. at most), instead of
    #: their `dispatch_mw`.
    shares_dispatch: bool = False
    interval_s: float = 0.1  # control interval, in which inputs hold: a whole number of simulation steps [s]
    #: Step of the integration [s]; a simulator refuses one that is too long for the plant's fastest mode.
    simulation_dt: float = design(0.025, "s", "step of the integration", *SIMULATION_DT_RANGE)
    trips_groups: bool = False  # whether the failure of a rotor disconnects its group instead of ending the run
    load_frequency_dependence: float = design(
        0.0, "p.u./p.u.", "change of a load's conductance with frequency", 0.0, 10.0
    )
    devices: tuple[Devices, ...] = ()  # those of users; where they see the task, they need an environment

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.secondary_time_s:
            require_range("secondary_time_s", self.secondary_time_s, 1.0, 3600.0, "s")
        require_range("interval_s", self.interval_s, self.simulation_dt, 10.0, "s")
        whole_steps("interval_s", self.interval_s, self.simulation_dt, "simulation step")
        for group in self.groups:
            self.case.bus_index(group.bus)
        at_slack = any(group.bus == self.case.slack_bus for group in self.groups)
        if not self.case.balanced and not at_slack:
            raise ValueError(
                f"{self.case.name}: no synchronous machine, source or WTG group is at the slack bus "
                f"{self.case.slack_bus} to balance the power"
            )
        with_group = {group.bus for group in self.groups}
        for bus in self.case.buses:
            weights = [machine.reactive_weight for machine in self.case.machines if machine.bus == bus.number]
            needs_weight = bus.voltage_pu is not None and bus.number not in with_group
            if needs_weight and weights and all(weight == 0.0 for weight in weights):
                raise ValueError(f"reactive_weight is 0 MVA for every machine at bus {bus.number}; one must have more")
        if self.control.frequency_setpoint_pu != 1.0:
            raise ValueError(
                "runs start at nominal frequency, so that frequency_setpoint_pu must be 1 p.u., got "
                f"{self.control.frequency_setpoint_pu:g} p.u."
            )
        if any(turbine.power_coefficient != self.turbines[0].power_coefficient for turbine in self.turbines):
            raise ValueError("the turbines of all groups must have one C_p curve, or one table of it")
        total = sum(stage.share for stage in self.shedding)
        if total > 1.0 + 1e-12:
            raise ValueError(f"the shedding stages disconnect {100.0 * total:g} % of the load; allowed: at most 100 %")

    def replaced(
        self,
        *,
        physics: str | None = None,
        machine_model: str = "genrou",
        groups: int | Sequence[WtgGroup | Mapping[str, Any]] | None = None,
        **fields: Any,
    ) -> "Plant":
        """Return the plant with parts of it replaced, by name or as plain data.

        A ValueError says that a name is unknown, or a value is outside its range.

        Args:
            physics: "extended", the physics of version v1; "nrel-5mw", the same with the NREL 5 MW turbine and its C_p
                table; or "paper", which is refused for an extended plant. A governor keeps its own dead band.
            machine_model: "classical" puts a constant voltage behind x'_d in place of every synchronous machine and its
                exciter; "genrou" leaves them as they are.
            groups: the WTG groups, their data, or how many share the paper's twenty turbines at the bus of the first.
            fields: fields of this class; they replace those of `physics` too. A dictionary replaces parts of a record,
                as in `control={"droop_gain_pu": 20.0}`.
        """
        known = [*(field.name for field in dataclasses.fields(self)), "physics", "machine_model"]
        parts = [name for name in known[:-2] if isinstance(getattr(self, name), Checked)]
        for name in fields.keys() - set(known):
            if of := [part for part in parts if name in getattr(self, part).__dataclass_fields__]:
                way = f'plant={{"{of[0]}": {{"{name}": …}}}}'
                raise ValueError(f"{name} is a setting of {' and of '.join(of)}: {way}")
        require_known("settings of a plant", fields, known)
        case = fields.pop("case", self.case)
        if not isinstance(case, NetworkCase):
            raise ValueError(f"case must be a NetworkCase, got {case!r:.80}")
        require_choice("machine_model", machine_model, MACHINE_MODELS)
        changes: dict[str, Any] = {"case": case.classical() if machine_model == "classical" else case}
        if physics is not None:
            require_choice("physics", physics, PHYSICS)
            if physics != "paper":
                turbine = parameters.nrel_5mw() if physics == "nrel-5mw" else TurbineParameters(conserves_energy=True)
                changes = _extended(changes["case"], turbine)
            elif self.extended:
                raise ValueError("an extended plant cannot go back to the physics of the paper; start from Plant()")
        if groups is not None:
            changes["groups"] = parameters.groups_of(groups, self.groups[0].bus if self.groups else self.case.slack_bus)
        for name, value in fields.items():
            part = changes.get(name, getattr(self, name))
            if isinstance(value, Mapping) and hasattr(part, "__dataclass_fields__"):
                require_known(f"settings of {name}", value, part.__dataclass_fields__)
                fields[name] = dataclasses.replace(part, **value)
        return dataclasses.replace(self, **{**changes, **fields})

    @property
    def all_devices(self) -> tuple[Devices, ...]:
        """All units that are neither machines nor WTG groups: imposed sources of the network, then `devices`."""
        return (*source_units(self.case.sources), *self.devices)

    @property
    def unit_buses(self) -> tuple[int, ...]:
        """Bus number of each unit: machines, WTG groups, devices."""
        devices = (bus for device in self.all_devices for bus in device.buses)
        return (*(machine.bus for machine in self.case.machines), *(group.bus for group in self.groups), *devices)

    @property
    def turbines(self) -> tuple[TurbineParameters, ...]:
        """Turbines of each group; whether a rotor keeps its energy is a choice for all."""
        keeps = self.turbine.conserves_energy
        chosen = (group.turbine and dataclasses.replace(group.turbine, conserves_energy=keeps) for group in self.groups)
        return tuple(turbine or self.turbine for turbine in chosen)

    @functools.cached_property
    def extended(self) -> bool:
        """Whether the WTG groups have limits, voltage control, or a rotor that keeps its energy."""
        return self.limits is not None or self.voltage_control is not None or self.turbine.conserves_energy


#: Physics by name: the paper's, what :func:`_extended` adds to it, and the same with the NREL 5 MW turbine.
PHYSICS = ("paper", "extended", "nrel-5mw")
#: Models of synchronous machines by name: that of the network's data, or a constant voltage behind x'_d.
MACHINE_MODELS = ("genrou", "classical")
#: Dead band of the governors in extended physics [p.u.]: 10 mHz of 50 Hz, the combined effect of insensitivity and dead
#: band that frequency containment reserve of continental Europe may have. Source: Commission Regulation (EU) 2017/1485,
#: annex V.
DEAD_BAND_PU = 0.0002
#: Rotor speed that trips a group in extended physics [p.u.]. A trip lies below the speeds of operation, which begin at
#: 6.9 rpm, 0.57 p.u., for the NREL 5 MW turbine (NREL/TP-500-38060, table 1-1); the paper's has its size and speed. By
#: design it is 12 % below, much as the over-speed trip is 10 % above the speed that the pitch defends.
ROTOR_SPEED_MIN_PU = 0.5


def _extended(case: NetworkCase, turbine: TurbineParameters) -> dict[str, Any]:
    """Return what extended physics replaces in a plant.

    It adds to the paper's model: a rotor that keeps its energy, limits of current, power and torque with a chopper,
    terminal voltage control with reactive limits, a rotor under-speed trip, a governor dead band, and load shedding as
    continental Europe asks for. It takes from machines without a governor their damping D, which would be power without
    a source.
    """

    def changed(m: machine_parameters.SynchronousMachineParameters) -> machine_parameters.SynchronousMachineParameters:
        if m.governor is None:
            return dataclasses.replace(m, damping_pu=0.0)
        dead_band = m.governor.dead_band_pu or DEAD_BAND_PU
        return dataclasses.replace(m, governor=dataclasses.replace(m.governor, dead_band_pu=dead_band))

    return {
        "case": case.with_machines(changed),
        "turbine": turbine,
        "limits": parameters.ConverterLimitParameters(),
        "voltage_control": parameters.VoltageControlParameters(),
        "protection": parameters.ProtectionParameters(rotor_speed_min_pu=ROTOR_SPEED_MIN_PU),
        "shedding": parameters.european_shedding(),
    }


class PlantTables(NamedTuple):
    """Constants of a plant."""

    network: Network  # what compiled functions read
    bus_y: Complex  # bus admittance matrix without loads and units (n_bus, n_bus) [p.u.]
    machines: npt.NDArray[np.void]  # (n_sync,), of Machine
    dispatch: Floats  # power of each machine before the slack's share (n_sync,) [p.u.]
    participation: Floats  # its share of what loads need at the start (n_sync,)
    turbine: npt.NDArray[np.void]  # of each WTG group, or one where there is none (n_wtg,), of Turbine
    share: Floats  # rating of each WTG group on the system base (n_wtg,)
    cells: Floats  # of the rotor's C_p table (n, m, 16)
    saturation: tuple[RotorSaturation, ...]  # of each machine (n_sync,)
    controls: Mapping[str, npt.NDArray[np.void]]  # constants of those that are units, by the names of kinds
    extension: npt.NDArray[np.void]  # likewise, of Extension; (0,) where the groups are not extended
    shedding: npt.NDArray[np.void]  # (n_stages,), of Shedding
    buses: npt.NDArray[np.void]  # (n_bus,), of Bus
    of_env: Mapping[str, Any]  # constants of every environment
    devices: tuple[Devices, ...]

    @property
    def simulation_dt(self) -> float:
        """Step of the integration [s]."""
        return self.network.facts.simulation_dt

    def with_addresses(self, addresses: Whole) -> "PlantTables":
        """Return the plant with the addresses of its machine code in this process."""
        return self._replace(network=self.network._replace(code=self.network.code._replace(addresses=addresses)))


def plant_tables(settings: Plant) -> PlantTables:
    """Return the constants of a plant; :func:`with_places` adds where its rows lie."""
    case, base = settings.case, settings.case.base_mva
    machines = [machine_constants(machine, base) for machine in case.machines]
    of_groups = settings.turbines or (settings.turbine,)
    of_all = settings.pitch, settings.control, settings.protection, settings.extended
    turbines = [wind_turbine.turbine_constants(turbine, *of_all) for turbine in of_groups]
    limits = converter_limits(settings.limits, settings.simulation_dt), voltage_control(settings.voltage_control)
    extensions = [wind_turbine.Extension(*limits, float(turbine.conserves_energy)) for turbine in of_groups]
    sizes = zip(settings.groups, settings.turbines, strict=True)
    share = [group.n_turbines * turbine.rated_power_mw / base for group, turbine in sizes]
    impedances = [complex(machine.resistance, machine.internal_reactance) for machine in machines]
    impedances += [1j * turbines[0].converter.reactance / rating for rating in share]
    impedances += [impedance for device in settings.all_devices for impedance in device.impedances]
    stages = [Shedding(stage.frequency_pu, stage.share, stage.delay_s) for stage in settings.shedding]
    # Each machine's share of what loads need at the start; none where the case dispatches them.
    sharing = [power_at_gate_mw(machine) if settings.shares_dispatch else 0.0 for machine in case.machines]
    participation = np.array(sharing) / (sum(sharing) or 1.0)
    with_unit = set(settings.unit_buses)
    buses = [
        Bus(
            load=Phasor(bus.load_mw / base, bus.load_mvar / base),
            voltage=1.0 if bus.voltage_pu is None else bus.voltage_pu,
            holds_voltage=bus.voltage_pu is not None and bus.number in with_unit,
            is_slack=bus.number == case.slack_bus,
        )
        for bus in case.buses
    ]
    unit_y = 1.0 / np.array(impedances, dtype=np.complex128)
    network, bus_y = _network_of(settings, unit_y, bool(participation.any()))
    return PlantTables(
        network=network,
        bus_y=bus_y,
        machines=structured(Machine, machines),
        dispatch=np.where(participation > 0.0, 0.0, [m.dispatch_mw / base for m in case.machines]),
        participation=participation,
        turbine=structured(wind_turbine.Turbine, turbines),
        share=np.array(share, dtype=np.float64),
        cells=surface_of(of_groups[0].power_coefficient)[1],
        saturation=tuple(rotor_saturation(machine) for machine in case.machines),
        controls=machine_models.control_constants(case.machines),
        extension=structured(wind_turbine.Extension, extensions * settings.extended),
        shedding=structured(Shedding, stages * (ISLANDS_AT_MOST if settings.extended else 1)),
        buses=structured(Bus, buses),
        of_env={
            "omega_n": 2.0 * math.pi * case.frequency_hz,
            "base_mva": base,
            "shedding_speed": max([stage.speed for stage in stages], default=0.0),
            "simulation_dt": settings.simulation_dt,
            "limits": turbines[0].limits,
            "trips_groups": settings.trips_groups,
            "reactive_max": extensions[0].voltage.reactive_max,
            "voltage_gain": extensions[0].voltage.integral_gain,
            "secondary_gain": settings.simulation_dt / settings.secondary_time_s if settings.secondary_time_s else 0.0,
        },
        devices=settings.all_devices,
    )


def power_at_gate_mw(machine: machine_parameters.SynchronousMachineParameters) -> float:
    """Return what a machine gives at its largest gate, 1 p.u. at most; 0 without a governor [MW]."""
    # A gate beyond 1 p.u. says nothing about the power that a machine is meant for.
    return machine.rating_mva * min(gate_limits(machine.governor)[1], 1.0) if machine.governor is not None else 0.0


def _network_of(settings: Plant, unit_y: Complex, shares_dispatch: bool) -> tuple[Network, Complex]:
    """Return what compiled functions read of a plant, from its units' admittances, and the bus matrix [p.u.]."""
    case, base = settings.case, settings.case.base_mva
    ends = [(case.bus_index(branch.from_bus), case.bus_index(branch.to_bus)) for branch in case.branches]
    branch_ends, branch_y = np.array(ends, dtype=np.int64).reshape(-1, 2), branch_admittances(case.branches)
    series = tuple(dataclasses.replace(branch, charging=0.0) for branch in case.branches)
    shunts = np.array([complex(bus.shunt_mw, bus.shunt_mvar) / base for bus in case.buses], dtype=np.complex128)
    bus_y, is_large = assemble_admittance(branch_ends, branch_y, shunts), len(case.buses) >= SPARSE_FROM
    facts = Facts(
        slack=case.bus_index(case.slack_bus),
        base_mva=base,
        simulation_dt=settings.simulation_dt,
        n_substeps=whole_steps("interval_s", settings.interval_s, settings.simulation_dt, "simulation step"),
        n_balances=_BALANCES if shares_dispatch else 0,
        is_large=is_large,
        curtails=bool(settings.groups) and not case.balanced,
        shifts_phases=any(branch.phase_rad != 0.0 for branch in case.branches),
        load_frequency_dependence=settings.load_frequency_dependence,
    )
    network = Network(
        facts=facts,
        branch_ends=branch_ends,
        branch_y=branch_y,
        branch_series=branch_admittances(series),
        shunts=shunts,
        unit_bus=np.array([case.bus_index(bus) for bus in settings.unit_buses], dtype=np.int64),
        unit_y=unit_y,
        connected=np.zeros(unit_y.size, dtype=np.int64),
        angles=np.zeros(unit_y.size, dtype=np.int64),
        pattern=pattern_of(bus_y if is_large else bus_y[:0, :0]),
        shed_shares=np.array([stage.share for stage in settings.shedding], dtype=np.float64),
        code=Code(),
    )
    return network, bus_y


@dataclass(frozen=True, eq=False, kw_only=True)
class TaskUnits:
    """What a caller adds to the physics: kinds of unit of its own, and programs over them."""

    n_units: Mapping[Kind, int] = dataclasses.field(default_factory=dict)
    links: Mapping[tuple[Kind, str], Whole] = dataclasses.field(default_factory=dict)
    programs: tuple[Program, ...] = ()
    stepping: tuple[Routine, ...] = ()  # that are called with blocks of the simulator's width
    starting: tuple[Routine, ...] = ()  # and with blocks of one environment, to start runs
    constants: Mapping[tuple[Kind, str], Any] = dataclasses.field(default_factory=dict)
    has: Collection[str] = ()  # conditions of its kinds that hold


NO_TASK = TaskUnits()


def _nested(n_outer: int, n_inner: int) -> tuple[Whole, Whole]:
    """Return the outer and the inner number of each pair, inner ones fastest (n_outer · n_inner,)."""
    outer, inner = np.indices((n_outer, n_inner)).reshape(2, -1)
    return outer, inner


def _units_of(plant: PlantTables) -> tuple[dict[Kind, int], dict[tuple[Kind, str], Any]]:
    """Return how many units of each kind there are, and which others each of them sees."""
    n_sync, n_wtg, unit_bus = plant.machines.size, plant.share.size, plant.network.unit_bus
    extended, n_bus, n = plant.extension.size > 0, plant.buses.size, unit_bus.size
    n_islands, groups = ISLANDS_AT_MOST if extended else 1, n_sync + np.arange(n_wtg)
    limited = groups if extended else groups[:0]
    # Units of every pair, of the islands but the grid, and of every bus: extended plants alone find voltages of buses.
    row, column = _nested(n, n)
    island, member = _nested(n_islands - 1, n)
    bus, unit = _nested(n_bus if extended else 0, n)
    column_group, column_unit = _nested(limited.size, n)
    n_units = {
        machine_unit.MACHINES: n_sync,
        GROUPS: n_wtg,
        EXTENSIONS: limited.size,
        ENV: 1,
        BUSES: n_bus,
        UNITS: n,
        ISLANDS: n_islands,
        MEMBERS: member.size,
        MAIN: 1,
        TRANSFERS: unit.size,
        PAIRS: row.size,
        STAGES: plant.shedding.size,
        machine_unit.FIRST_MACHINE: min(n_sync, 1),
        COLUMNS: column_unit.size,
        **dict.fromkeys((control.kind for control in machine_models.CONTROLS.values()), 0),
    }
    links = {
        # All of them are in the grid, or seen from there.
        (machine_unit.MACHINES, "island"): np.zeros(n_sync, dtype=np.int64),
        (GROUPS, "island"): np.zeros(n_wtg, dtype=np.int64),
        (GROUPS, "unit"): groups,
        (STAGES, "island"): _nested(n_islands, plant.shedding.size // n_islands)[0],
        (UNITS, "bus"): unit_bus,
        (UNITS, "grid_"): np.zeros(n, dtype=np.int64),
        (MEMBERS, "unit_"): member,
        (MEMBERS, "island_"): 1 + island,
        (TRANSFERS, "unit_"): unit,
        (TRANSFERS, "bus_"): bus,
        (PAIRS, "row_"): row,
        (PAIRS, "column_"): column,
        (EXTENSIONS, "unit"): limited,
        (EXTENSIONS, "bus_"): unit_bus[limited],
        (EXTENSIONS, "diagonal_"): limited * (n + 1),
        (COLUMNS, "entry"): column_unit * n + limited[column_group],
        (COLUMNS, "unit"): column_unit,
        (COLUMNS, "group"): column_group,
    }
    return n_units, links


def layout_of(plant: PlantTables, task: TaskUnits = NO_TASK) -> Layout:
    """Return where the numbers of a plant's environments lie, with those of devices and of a task behind them."""
    n_units, links = _units_of(plant)
    for name, constants in plant.controls.items():
        kind, of_machine = machine_models.CONTROLS[name].kind, constants["machine"]
        n_units[kind] = constants.size
        links |= {(kind, "machine"): of_machine, (kind, "unit"): of_machine}
    first = plant.machines.size + plant.share.size
    for device in plant.devices:
        units = first + np.arange(len(device.buses))
        first += units.size
        if device.kind in n_units or device.kind in task.n_units:
            raise ValueError(f"there are units of a kind {device.kind.name!r} already")
        n_units[device.kind] = units.size
        known = {UNITS: units, BUSES: plant.network.unit_bus[units]}
        for label, kind in device.kind.sees.items():
            if kind in known:
                links[device.kind, label] = known[kind]
            elif (n := {**n_units, **task.n_units}.get(kind)) != 1:
                why = "nothing says which of them each one means" if n else "there are none here, as in `simulate`"
                raise ValueError(f"{device.kind.name} cannot see {kind.name}: {why}")
    return Layout({**n_units, **task.n_units}, {**links, **task.links})


def programs_of(plant: PlantTables, *programs: Program) -> tuple[Program, ...]:
    """Return programs with the systems of a plant's devices, and of controls that only some machines have."""
    return _joined(plant.devices, tuple(plant.controls), programs)


@functools.lru_cache(maxsize=64)
def _joined(
    devices: tuple[Devices, ...], controls: tuple[str, ...], programs: tuple[Program, ...]
) -> tuple[Program, ...]:
    systems = units.joining([device.systems for device in devices]) | machine_models.joining_controls(controls)
    return tuple(program.joined(systems) for program in programs)


def memory_map(plant: PlantTables, layout: Layout, task: TaskUnits) -> MemoryMap:
    """Return what :func:`~wtg_gym.systems.programs.link` asks of a plant and its layout."""
    n_wtg, network = plant.share.size, plant.network
    has = {
        "table": plant.cells.size > 0,
        "curve": not plant.cells.size,
        "extended": plant.extension.size > 0,
        "constant voltage": not plant.extension.size,
        "no machine": not plant.machines.size,
        "sheds": plant.shedding.size > 0,
        "saturates": any(rotor.curve.gain > 0.0 for rotor in plant.saturation),
        "secondary control": plant.of_env["secondary_gain"] > 0.0,
    }
    added = [*task.has, *(condition for device in plant.devices for condition in device.has)]
    require_known("conditions", added, [condition for kind in layout.counts for condition in kind.conditions])
    conditions = {*(condition for condition, holds in has.items() if holds), *added}
    # Rating, weights as a machine and as a group, participation.
    machines = zip(plant.machines["rating"], plant.machines["reactive_weight"], plant.participation, strict=True)
    sizes = [(rating, weight, 0.0, share) for rating, weight, share in machines]
    sizes += [(0.0, 0.0, weight, 0.0) for weight in plant.share]
    for device in plant.devices:
        sizes += [(w, w, 0.0, 0.0) if device.balances else (0.0, 0.0, w, 0.0) for w in device.reactive_weights]
    connections = [
        Connection(float(number), *size, Phasor(y.real, y.imag))
        for number, (size, y) in enumerate(zip(sizes, network.unit_y, strict=True))
    ]
    constants: dict[tuple[Kind, str], Any] = {
        (machine_unit.MACHINES, "machine"): plant.machines,
        (machine_unit.MACHINES, "dispatch"): plant.dispatch,
        (machine_unit.MACHINES, "saturation"): plant.saturation,
        (GROUPS, "turbine"): plant.turbine[:n_wtg],
        (GROUPS, "cells"): plant.cells,
        (GROUPS, "share"): plant.share,
        (GROUPS, "inv_share"): 1.0 / plant.share,
        (EXTENSIONS, "extension"): plant.extension[:n_wtg],
        (STAGES, "stage"): plant.shedding,
        (BUSES, "bus"): plant.buses,
        (UNITS, "connection"): connections,
        (ISLANDS, "number"): np.arange(float(layout.n_units(ISLANDS))),
        **{(ENV, name): [value] for name, value in plant.of_env.items()},
        **{(machine_models.CONTROLS[name].kind, "model"): values for name, values in plant.controls.items()},
        **{(device.kind, name): values for device in plant.devices for name, values in device.constants.items()},
        **task.constants,
    }
    return MemoryMap(layout.n_units, layout.first_rows, layout.seen, constants, conditions)


def with_places(
    plant: PlantTables,
    layout: Layout,
    programs: Sequence[Program],
    task: TaskUnits = NO_TASK,
    taped: Sequence[Program] = (),
) -> PlantTables:
    """Return a plant that knows where its rows lie, for programs that are to run; those `taped` have a way back."""
    kinds = dict(env=ENV, machines=machine_unit.MACHINES, groups=GROUPS, units=UNITS, pairs=PAIRS, buses=BUSES)
    kinds |= dict(islands=ISLANDS, transfers=TRANSFERS, sources=SOURCES)
    spans: dict[str, Any] = {name: layout.span(kind) for name, kind in kinds.items()}
    n_islands = layout.n_units(ISLANDS)
    spans["stages"] = Span(layout.span(STAGES).first, n_islands, layout.n_units(STAGES) // n_islands)
    spans["starting"], spans["planning"] = layout.span(ENV, scratch=True), layout.span(BUSES, scratch=True)
    connected = [layout.machine("connected"), layout.wtg("connected")]
    connected += [layout.rows_of(device.kind, "connected") for device in plant.devices]
    angles = [layout.machine("angle"), layout.wtg("angle")]
    for device in plant.devices:
        turns = "angle" in names_of(device.kind)
        angles.append(layout.rows_of(device.kind, "angle") if turns else np.full(len(device.buses), -1))
    facts = plant.network.facts._replace(**spans)
    network = plant.network._replace(
        facts=facts,
        connected=np.concatenate(connected),
        angles=np.concatenate(angles),
        code=link(programs, memory_map(plant, layout, task), taped),
    )
    return plant._replace(network=network).with_addresses(plant.network.code.addresses)


@functools.lru_cache(maxsize=16)
def placed(settings: Plant, task: TaskUnits = NO_TASK) -> tuple[PlantTables, Layout]:
    """Return what is compiled of a plant, which is read only, and the layout of its numbers, with those of a task."""
    plant = plant_tables(settings)
    layout = layout_of(plant, task)
    return with_places(plant, layout, programs_of(plant, *integration.PROGRAMS, *task.programs), task), layout
