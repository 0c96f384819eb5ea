"""The strata of version v1, on any grid: what is drawn in each, and where it may happen."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from wtg_gym.physics.checked import Checked
from wtg_gym.physics.grid import DEFAULT_GRID, digest_of_grid, get_grid
from wtg_gym.physics.machine_parameters import GovernorParameters
from wtg_gym.physics.parameters import GridFormingParameters, WtgGroup
from wtg_gym.physics.plant import Plant
from wtg_gym.scenarios.distribution import ScenarioDistribution
from wtg_gym.scenarios.sensor_distribution import SensorDistribution
from wtg_gym.scenarios.suite import Suite
from wtg_gym.tasks import V1, Task

#: Load of the grid that the sizes below are for [MW].
_LOAD_MW = 259.0


_CHANCES = {
    "load_trip_probability": "load_trip_buses",
    "line_trip_probability": "line_trips",
    "machine_outage_probability": "machine_outage_buses",
}


@dataclass(frozen=True, kw_only=True)
class Places(Checked):
    """Where events may happen in a grid.

    Args:
        load_buses: bus, largest increase and largest decrease there [MW].
        load_trip_buses: buses whose load may be disconnected, out of these.
        load_noise_bus: bus of the load noise.
        line_trips: lines that may trip.
        fault_lines: lines with a short circuit, its bus first.
        islandings: sets of lines whose opening leaves a part with WTG groups alone.
        machine_buses: buses of machines that may be lost in large events.
        generator_buses: and in extreme ones.
        governor_buses: buses of machines that may lose their governor.
    """

    load_buses: tuple[tuple[int, float, float], ...]
    load_trip_buses: tuple[int, ...]
    load_noise_bus: int
    line_trips: tuple[tuple[int, int], ...]
    fault_lines: tuple[tuple[int, int], ...] = ()
    islandings: tuple[tuple[tuple[int, int], ...], ...] = ()
    machine_buses: tuple[int, ...] = ()
    generator_buses: tuple[int, ...] = ()
    governor_buses: tuple[int, ...] = ()


#: What the scenarios of version v1 have in common; a stratum, a suite or both replace some of it.
WIND_SCENARIOS: Mapping[str, Any] = MappingProxyType(
    {
        "mean_wind_m_s": (8.5, 11.0),
        "mean_wind_spread_m_s": 1.0,
        "wind_share": (0.4, 0.78),
        "wind_ramp_probability": 0.15,
        "wind_ramp_m_s": (0.5, 1.8),
        "load_trip_probability": 0.0,
        "line_trip_probability": 0.1,
        # Frequency and rotors have two minutes to come back: after one, entries still pay for what they have lent.
        "last_event_s": 60.0,
        "wind_ramp_s": (5.0, 10.0),
        "governor_droop": (0.03, 0.08),
        "inertia_scale": (1.0, 1.0),
        "machine_loading": (0.5, 0.85),
    }
)
_EXTREME: Mapping[str, Any] = MappingProxyType(
    {
        "n_load_events": (1, 2),
        "load_event_mw": (25.0, 50.0),
        "net_load_change_mw": 60.0,
        "load_increase_probability": 0.65,
        "wind_ramp_probability": 0.2,
    }
)
#: What the strata of version v1, and the kinds of the extreme one, replace.
STRATA: Mapping[str, Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "ordinary": {
            "": {
                "n_load_events": (2, 4),
                "load_event_mw": (4.0, 16.0),
                "net_load_change_mw": 20.0,
                "machine_loading": (0.5, 0.75),
                "wind_ramp_m_s": (0.2, 0.7),
            }
        },
        "large": {
            "": {
                "n_load_events": (2, 3),
                "load_event_mw": (22.0, 40.0),
                "net_load_change_mw": 50.0,
                "load_increase_probability": 0.65,
                "load_trip_probability": 0.15,
                "line_trip_probability": 0.25,
                "wind_ramp_probability": 0.25,
                "wind_ramp_m_s": (0.5, 1.5),
                "machine_outage_probability": 0.15,
            }
        },
        "extreme": {
            "governor": {**_EXTREME, "wind_share": (0.5, 0.8), "governor_loss_probability": 1.0},
            # The wind has to carry what load shedding leaves.
            "machine": {
                **_EXTREME,
                "mean_wind_m_s": (9.5, 12.0),
                "wind_share": (0.7, 0.88),
                "load_event_mw": (10.0, 30.0),
                "net_load_change_mw": 30.0,
                "load_increase_probability": 0.5,
                "machine_outage_probability": 1.0,
            },
            "group": {**_EXTREME, "wind_share": (0.5, 0.8), "group_trip_probability": 1.0},
            "fault": {
                **_EXTREME,
                "line_trip_probability": 0.0,
                "fault_probability": 1.0,
                "fault_clearing_s": (0.15, 0.35),
            },
            # A part far from its balance would die whatever its groups do.
            "island": {
                **_EXTREME,
                "mean_wind_m_s": (9.0, 12.0),
                "wind_share": (0.55, 0.82),
                "line_trip_probability": 0.0,
            },
        },
    }
)


#: Power above which a converter counts as overloaded in version v1 [p.u.].
_OVERLOAD_FROM_PU = 1.05
#: Integration time of its secondary control [s].
_SECONDARY_TIME_S = 30.0


def wind_plant(
    grid: str,
    groups: tuple[WtgGroup, ...],
    *,
    generator_mva: float | None = None,
    branch_scale: float = 1.0,
    condensers: bool = True,
    simulation_dt: float = 0.025,
) -> dict[str, Any]:
    """Return `grid`, `plant`, `plant_data` and `described` of a suite of version v1.

    Args:
        grid: its name, or the path of its file.
        groups: the WTG groups.
        generator_mva: rating of the machine at the slack bus, whose gate then opens to 1 p.u.; None: the grid's [MVA].
        branch_scale: factor on the impedance of every line and transformer [-].
        condensers: whether machines without a governor are there.
        simulation_dt: step of the integration [s].
    """
    grid_data = get_grid(grid)
    case = grid_data.with_groups
    governor = None if generator_mva is None else GovernorParameters(gate_max_pu=1.0)
    machines = [
        dataclasses.replace(m, rating_mva=generator_mva, governor=governor)
        if generator_mva is not None and m.bus == case.slack_bus
        else m
        for m in case.machines
    ]
    branches = [
        dataclasses.replace(b, resistance=branch_scale * b.resistance, reactance=branch_scale * b.reactance)
        for b in case.branches
    ]
    governed = sum(machine.governor is not None for machine in machines)
    plant = Plant(
        case=dataclasses.replace(
            case,
            machines=tuple(m for m in machines if condensers or m.governor is not None),
            branches=tuple(branches),
        ),
        groups=groups,
        control=GridFormingParameters(overload_limit_pu=_OVERLOAD_FROM_PU),
        secondary_time_s=_SECONDARY_TIME_S,
        shares_dispatch=governed > 1,
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


def suite_of_strata(
    name: str,
    description: str,
    plant: Mapping[str, Any],
    places: Places,
    *,
    sensors: SensorDistribution | None = None,
    scenarios_of: str | None = None,
    event_size: float = 1.0,
    own: Mapping[str, Mapping[str, Any]] | None = None,
    task: Task = V1,
    **settings: Any,
) -> Suite:
    """Return a suite of version v1.

    Args:
        name: without "-v1".
        plant: what :func:`wind_plant` returns.
        places: where events may happen; a kind of extreme event without a place is left out.
        scenarios_of: another suite that it shares all but the sensors with.
        event_size: factor on the load events of every stratum, which are in per cent of the load [-].
        own: what it has of its own in a stratum or a kind, by its name.
        settings: what it has of its own everywhere.
    """
    grid = plant["grid"]
    size = event_size * (1.0 if grid == DEFAULT_GRID else plant["plant"].case.load_mw / _LOAD_MW)
    of_grid: dict[str, Any] = {
        "load_noise_mw": round(size / event_size, 2),
        "load_buses": places.load_buses,
        "load_trip_buses": places.load_trip_buses,
        "load_noise_bus": places.load_noise_bus,
        "line_trips": places.line_trips,
        "machine_outage_buses": places.machine_buses,
        "governor_loss_buses": places.governor_buses,
        "grid": grid,
        "constant_mw": constant_mw(plant["plant"]),
    }
    of_kinds: dict[str, dict[str, Any]] = {
        "governor": {"governor_loss_buses": places.governor_buses},
        "machine": {"machine_outage_buses": places.generator_buses},
        "fault": {"fault_lines": places.fault_lines},
        "island": {"islandings": places.islandings},
    }
    drawn_from: dict[str, tuple[ScenarioDistribution, ...]] = {}
    for stratum, kinds in STRATA.items():
        made = []
        for kind, given in kinds.items():
            if not all(of_kinds.get(kind, {"": True}).values()):
                continue
            values = {**WIND_SCENARIOS, **of_grid, **given, **of_kinds.get(kind, {}), **settings}
            values |= (own or {}).get(kind or stratum, {})
            # What has no place does not happen.
            values |= {chance: 0.0 for chance, where in _CHANCES.items() if not values[where]}
            least, most = values["load_event_mw"]
            values["load_event_mw"] = (round(size * least, 2), round(size * most, 2))
            values["net_load_change_mw"] *= size
            prefix = f"{scenarios_of or name}-v1/{stratum}"
            prefix = f"{prefix}-{kind}" if kind else prefix
            made.append(ScenarioDistribution(name=prefix, generator_mva=governed_mva(plant["plant"]), **values))
        drawn_from[stratum] = tuple(made)
    return Suite(
        name=f"{name}-v1",
        description=description,
        duration_s=180.0,
        task=task,
        sensors=sensors or SensorDistribution(),
        drawn_from=drawn_from,
        validation=range(10_000, 10_300),
        test=range(20_000, 20_900),
        **plant,
    )
