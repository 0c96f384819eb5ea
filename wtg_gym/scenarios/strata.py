"""The strata of version v1, on any grid: what is drawn in each, and where it may happen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from wtg_gym.physics.checked import Checked
from wtg_gym.physics.grid import DEFAULT_GRID, get_grid
from wtg_gym.scenarios.benchmark import V1, Benchmark, SuitePlant
from wtg_gym.scenarios.distribution import ScenarioDistribution
from wtg_gym.scenarios.sensor_distribution import SensorDistribution
from wtg_gym.scenarios.suite import Suite

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


def suite_of_strata(
    name: str,
    description: str,
    plant: SuitePlant,
    places: Places,
    *,
    sensors: SensorDistribution | None = None,
    scenarios_of: str | None = None,
    event_size: float = 1.0,
    own: Mapping[str, Mapping[str, Any]] | None = None,
    benchmark: Benchmark = V1,
    **settings: Any,
) -> Suite:
    """Return a suite of version v1.

    Args:
        name: without "-v1".
        places: where events may happen; a kind of extreme event without a place is left out.
        scenarios_of: another suite that it shares all but the sensors with.
        event_size: factor on the load events of every stratum, which are in per cent of the load [-].
        own: what it has of its own in a stratum or a kind, by its name.
        settings: what it has of its own everywhere.
    """
    size = event_size * (1.0 if plant.grid == DEFAULT_GRID else get_grid(plant.grid).case.load_mw / _LOAD_MW)
    of_grid: dict[str, Any] = {
        "load_noise_mw": round(size / event_size, 2),
        "load_buses": places.load_buses,
        "load_trip_buses": places.load_trip_buses,
        "load_noise_bus": places.load_noise_bus,
        "line_trips": places.line_trips,
        "machine_outage_buses": places.machine_buses,
        "governor_loss_buses": places.governor_buses,
        "grid": plant.grid,
        "constant_mw": plant.constant_mw,
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
            made.append(ScenarioDistribution(name=prefix, generator_mva=plant.governed_mva, **values))
        drawn_from[stratum] = tuple(made)
    return Suite(
        name=f"{name}-v1",
        description=description,
        duration_s=180.0,
        benchmark=benchmark,
        plant=plant,
        sensors=sensors or SensorDistribution(),
        drawn_from=drawn_from,
        validation=range(10_000, 10_300),
        test=range(20_000, 20_900),
    )
