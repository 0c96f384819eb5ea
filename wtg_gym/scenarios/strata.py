"""The strata of version v1, on any grid: what is drawn in each, and where it may happen."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from wtg_gym.physics import machine_parameters, parameters
from wtg_gym.physics.grid import DEFAULT_GRID, digest_of_grid, get_grid
from wtg_gym.physics.plant import Plant
from wtg_gym.ranges import Checked
from wtg_gym.scenarios import distribution, draws, suite
from wtg_gym.tasks import V1


@dataclass(frozen=True, kw_only=True)
class Places(Checked):
    """Where events may happen in a grid."""

    load_buses: tuple[tuple[int, float, float], ...]  # bus, largest increase and largest decrease there [MW]
    load_trip_buses: tuple[int, ...]  # buses whose load may be disconnected, out of these
    load_noise_bus: int
    line_trips: tuple[draws.Line, ...]
    fault_lines: tuple[draws.Line, ...] = ()  # lines with a short circuit, its bus first
    islandings: tuple[tuple[draws.Line, ...], ...] = ()  # sets whose opening leaves a part with WTG groups alone
    machine_buses: tuple[int, ...] = ()  # of machines that may be lost in large events
    generator_buses: tuple[int, ...] = ()  # and in extreme ones
    governor_buses: tuple[int, ...] = ()  # of machines that may lose their governor
    group_trips: bool = True


#: Records that scenarios of version v1 are drawn from, in this order; strata, kinds and suites replace some fields.
COMMON: draws.Changes = {
    draws.OperatingPoint: {"governor_droop": (0.03, 0.08), "inertia_scale": (1.0, 1.0)},
    draws.LoadEvents: {"trip_probability": 0.0},
    draws.LineTrips: {"probability": 0.1},
    draws.Wind: {
        "mean_m_s": (8.5, 11.0),
        "mean_spread_m_s": 1.0,
        "penetration": (0.4, 0.78),
        "gust_averaged": True,
        "ramp_probability": 0.15,
        "ramp_m_s": (0.5, 1.8),
        "ramp_s": (5.0, 10.0),
    },
    draws.GovernorLosses: {"probability": 0.0},
    draws.GroupTrips: {"probability": 0.0},
    draws.MachineOutages: {"probability": 0.0},
    draws.Faults: {"probability": 0.0, "lines": ()},
    draws.Islandings: {},
    draws.UnitCommitment: {"loading": (0.5, 0.85)},
    draws.LoadNoise: {},
}
#: The load events of kinds whose main event is another.
_ONE_OR_TWO_LOADS: draws.Changes = {
    draws.LoadEvents: {"number": (1, 2), "size_mw": (25.0, 50.0), "net_change_mw": 60.0, "increase_probability": 0.65}
}
#: Latest event [s]. Frequency and rotors need two minutes to recover, and energy that rotors lent is still paid for.
_LAST_EVENT_S = 60.0
#: Fields that the kinds of event replace.
KINDS: Mapping[str, draws.Changes] = {
    "loads": {
        draws.LoadEvents: {"number": (2, 4), "size_mw": (4.0, 16.0), "net_change_mw": 20.0},
        draws.Wind: {"ramp_m_s": (0.2, 0.7)},
        draws.UnitCommitment: {"loading": (0.5, 0.75)},
    },
    "large-loads": {
        draws.LoadEvents: {
            "number": (2, 3),
            "size_mw": (22.0, 40.0),
            "net_change_mw": 50.0,
            "increase_probability": 0.65,
            "trip_probability": 0.15,
        },
        draws.LineTrips: {"probability": 0.25},
        draws.Wind: {"ramp_probability": 0.25, "ramp_m_s": (0.5, 1.5)},
        draws.MachineOutages: {"probability": 0.15},
    },
    "governor": {
        **_ONE_OR_TWO_LOADS,
        draws.Wind: {"ramp_probability": 0.2, "penetration": (0.5, 0.8)},
        draws.GovernorLosses: {"probability": 1.0},
    },
    # The wind has to supply the load that is left after shedding.
    "machine": {
        draws.LoadEvents: {"number": (1, 2), "size_mw": (10.0, 30.0), "net_change_mw": 30.0},
        draws.Wind: {"ramp_probability": 0.2, "mean_m_s": (9.5, 12.0), "penetration": (0.7, 0.88)},
        draws.MachineOutages: {"probability": 1.0},
    },
    "group": {
        **_ONE_OR_TWO_LOADS,
        draws.Wind: {"ramp_probability": 0.2, "penetration": (0.5, 0.8)},
        draws.GroupTrips: {"probability": 1.0},
    },
    "fault": {
        **_ONE_OR_TWO_LOADS,
        draws.LineTrips: {"probability": 0.0},
        draws.Wind: {"ramp_probability": 0.2},
        draws.Faults: {"probability": 1.0, "clearing_s": (0.15, 0.35)},
    },
    # An island far from its balance would be lost under every controller.
    "island": {
        **_ONE_OR_TWO_LOADS,
        draws.LineTrips: {"probability": 0.0},
        draws.Wind: {"ramp_probability": 0.2, "mean_m_s": (9.0, 12.0), "penetration": (0.55, 0.82)},
    },
}


#: Range of the reserve margin in each stratum of version v1 [-]. Below -0.04 no actions save a quarter of the runs.
_MARGINS: Mapping[str, draws.Span] = {"ample": (0.10, math.inf), "tight": (0.0, 0.10), "short": (-0.04, 0.0)}
#: Kinds of event that are tried in turn until a scenario falls in its stratum.
_KINDS_IN: Mapping[str, tuple[str, ...]] = {
    "ample": ("loads", "large-loads", "fault", "group"),
    "tight": ("large-loads", "governor", "group", "fault", "island"),
    "short": ("large-loads", "governor", "group", "fault", "machine", "island"),
}


#: Power above which a converter counts as overloaded in version v1 [p.u.].
_OVERLOAD_FROM_PU = 1.05
#: Integration time of its secondary control [s].
_SECONDARY_TIME_S = 30.0


def wind_plant(
    grid: str,
    groups: tuple[parameters.WtgGroup, ...],
    *,
    generator_mva: float | None = None,
    branch_scale: float = 1.0,
    condensers: bool = True,
    simulation_dt: float = 0.025,
) -> dict[str, Any]:
    """Return `grid`, `plant`, `plant_data` and `described` of a suite of version v1, on a grid by its name or file.

    The machine at the slack bus is rated `generator_mva` [MVA] if given, and its gate then opens to 1 p.u. The
    impedance of every branch is scaled. `condensers` says whether machines without a governor are there.
    """
    grid_data = get_grid(grid)
    governor = None if generator_mva is None else machine_parameters.GovernorParameters(gate_max_pu=1.0)
    case = grid_data.with_groups
    machines = [machine for machine in case.machines if condensers or machine.governor is not None]
    if generator_mva is not None:
        generator: dict[str, Any] = {"rating_mva": generator_mva, "governor": governor}
        machines = [dataclasses.replace(m, **generator) if m.bus == case.slack_bus else m for m in machines]
    scaled = [{name: branch_scale * getattr(b, name) for name in ("resistance", "reactance")} for b in case.branches]
    branches = tuple(dataclasses.replace(b, **values) for b, values in zip(case.branches, scaled, strict=True))
    plant = Plant(
        case=dataclasses.replace(case, machines=tuple(machines), branches=branches),
        groups=groups,
        control=parameters.GridFormingParameters(overload_limit_pu=_OVERLOAD_FROM_PU),
        secondary_time_s=_SECONDARY_TIME_S,
        shares_dispatch=sum(machine.governor is not None for machine in machines) > 1,
        simulation_dt=simulation_dt,
        trips_groups=True,
    )
    data: dict[str, Any] = {
        "groups": [group.to_dict() for group in groups],
        "physics": "extended",
        "generator_mva": generator_mva,
        "governor": None if governor is None else dataclasses.asdict(governor),
        "overload_from_pu": _OVERLOAD_FROM_PU,
        "secondary_time_s": _SECONDARY_TIME_S,
        "branch_scale": branch_scale,
        "condensers": condensers,
    }
    if grid != DEFAULT_GRID:
        data["grid"] = digest_of_grid(grid_data)
    if simulation_dt != Plant.simulation_dt:
        data["simulation_dt"] = simulation_dt
    plant = plant.replaced(physics="extended")
    return {"grid": grid, "plant": plant, "plant_data": data, "described": plant}


def governed_mva(plant: Plant) -> float:
    """Return the rating of all machines with a governor [MVA]."""
    return sum(machine.rating_mva for machine in plant.case.machines if machine.governor is not None)


def constant_mw(plant: Plant) -> float:
    """Return what machines without a governor give [MW]."""
    return sum(machine.dispatch_mw for machine in plant.case.machines if machine.governor is None)


#: Load of the grid that the sizes above are for, and the largest of them [MW].
_LOAD_MW, _LARGEST_MW = 259.0, 50.0


def _records(layers: Sequence[draws.Changes], size: float) -> tuple[draws.Record, ...]:
    """Return the records that layers of values make, later ones first, with a factor on the load events' sizes [-]."""
    values: dict[type[draws.Record], dict[str, Any]] = {}
    for layer in layers:
        for record, fields in layer.items():
            values.setdefault(record, {}).update(fields)
    loads = values[draws.LoadEvents]
    least, most = loads["size_mw"]
    loads["size_mw"] = (round(size * least, 2), round(size * most, 2))
    loads["net_change_mw"] *= size
    # Events without a bus or line get probability 0.
    if not loads["trip_buses"]:
        loads["trip_probability"] = 0.0
    for record, fields in values.items():
        if issubclass(record, draws.RareEvent) and record.WHERE and not fields[record.WHERE]:
            fields["probability"] = 0.0
    return tuple(record(**fields) for record, fields in values.items())


def _where(places: Places) -> dict[str, draws.Changes]:
    """Return where each kind of event strikes that needs a place."""
    return {
        "governor": {draws.GovernorLosses: {"buses": places.governor_buses}},
        "machine": {draws.MachineOutages: {"buses": places.generator_buses}},
        "group": {draws.GroupTrips: {"probability": float(places.group_trips)}},
        "fault": {draws.Faults: {"lines": places.fault_lines}},
        "island": {draws.Islandings: {"line_sets": places.islandings}},
    }


def suite_of_strata(
    name: str,
    description: str,
    plant: Mapping[str, Any],
    places: Places,
    *,
    sensors: draws.SensorDistribution | None = None,
    scenarios_of: str | None = None,
    event_size: float = 1.0,
    changes: draws.Changes = MappingProxyType({}),
    changes_in: Mapping[str, draws.Changes] = MappingProxyType({}),
) -> suite.Suite:
    """Return a suite of version v1, which `name` lacks, in a :func:`wind_plant`.

    A kind of event without a place is left out. All but the sensors is that of the suite `scenarios_of`. `event_size`
    is a factor on the load events of every stratum [-]; on other grids these are in per cent of the load, the largest
    at most the loss that the grid is planned for. `changes` replace fields everywhere, `changes_in` in a kind of event.
    """
    settings, grid, size, of_events = plant["plant"], plant["grid"], 1.0, 1.0
    if grid != DEFAULT_GRID:
        size = settings.case.load_mw / _LOAD_MW
        of_events = min(size, get_grid(grid).largest_loss_mw / _LARGEST_MW)
    of_grid: draws.Changes = {
        draws.LoadEvents: {"buses": places.load_buses, "trip_buses": places.load_trip_buses},
        draws.LoadNoise: {"standard_deviation_mw": round(size, 2), "bus": places.load_noise_bus},
        draws.LineTrips: {"lines": places.line_trips},
        draws.GovernorLosses: {"buses": places.governor_buses},
        draws.MachineOutages: {"buses": places.machine_buses},
        draws.UnitCommitment: {"generator_mva": governed_mva(settings), "constant_mw": constant_mw(settings)},
    }
    kinds, where = {}, _where(places)
    for kind, of_kind in KINDS.items():
        of_place = where.get(kind, {})
        if all(place for fields in of_place.values() for place in fields.values()):
            layers = (COMMON, of_grid, of_kind, of_place, changes, changes_in.get(kind, {}))
            kinds[kind] = distribution.ScenarioDistribution(
                name=f"{scenarios_of or name}-v1/{kind}",
                records=_records(layers, event_size * of_events),
                grid=grid,
                last_event_s=_LAST_EVENT_S,
            )
    return suite.Suite(
        name=f"{name}-v1",
        description=description,
        duration_s=180.0,
        task=V1,
        sensors=sensors or draws.SensorDistribution(),
        drawn_from={name: tuple(kinds[kind] for kind in tried if kind in kinds) for name, tried in _KINDS_IN.items()},
        margins=dict(_MARGINS),
        validation=range(10_000, 10_300),
        test=range(20_000, 20_450),
        **plant,
    )
