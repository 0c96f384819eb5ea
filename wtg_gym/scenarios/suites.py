"""Frozen suites of scenarios to train, select and rank on, each with a hash.

A change of anything here, or of what is drawn, changes the hash. It is then a new version of the benchmark.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from wtg_gym.physics import parameters, scenario
from wtg_gym.physics.grid import DEFAULT_GRID, FOLDER, get_grid
from wtg_gym.ranges import did_you_mean
from wtg_gym.scenarios import draws, grid_suite, strata
from wtg_gym.scenarios.distribution import ScenarioDistribution
from wtg_gym.scenarios.suite import FixedCase, Suite
from wtg_gym.tasks import V1


def _paper_cases(wind_speed_m_s: tuple[float, float], increase_mw: float) -> tuple[FixedCase, FixedCase]:
    more = (scenario.LoadStep(time_s=at, bus=bus, power_mw=increase_mw) for at, bus in ((5.0, 2), (30.0, 3)))
    less = (scenario.LoadTrip(time_s=5.0, bus=4), scenario.LoadTrip(time_s=30.0, bus=9))
    return (
        FixedCase(name="load-increase", wind_speed_m_s=wind_speed_m_s, events=tuple(more)),
        FixedCase(name="load-decrease", wind_speed_m_s=wind_speed_m_s, events=less),
    )


def _drawn(name: str, description: str, changes: draws.Changes = MappingProxyType({})) -> Suite:
    distribution = ScenarioDistribution(name=name).changed(changes)
    return Suite(name=name, description=description, duration_s=60.0, drawn_from={"": (distribution,)})


def _wind_plant(generator_mva: float, *turbines: float, **network: Any) -> dict[str, Any]:
    """Return the plant of version v1: a small generator at bus 1, WTG groups in place of others."""
    groups = tuple(parameters.WtgGroup(bus=bus, n_turbines=n) for bus, n in zip((2, 3, 6, 8), turbines, strict=True))
    return strata.wind_plant(DEFAULT_GRID, groups, generator_mva=generator_mva, **network)


#: Lines with a short circuit at their first bus; a fault of 0.4 s next to the generator can end its synchronism.
_FAULT_LINES = draws.lines_of("1-2 1-5 2-1 2-3 2-4 2-5 3-2 3-4 4-5 5-1 6-13 9-14")
#: Lines whose opening leaves a part of the network to the group at bus 6, or to those at 6 and 8.
_ISLANDINGS = tuple(map(draws.lines_of, ("5-6 10-11 13-14", "5-6 9-10 13-14", "5-6 9-10 9-14", "5-6 4-7 4-9")))
_PLACES = strata.Places(
    load_buses=draws.LoadEvents.buses,
    # The load of bus 4 is more than all other events together.
    load_trip_buses=(9, 14),
    load_noise_bus=draws.LoadNoise.bus,
    line_trips=draws.LineTrips.lines,
    fault_lines=_FAULT_LINES,
    islandings=_ISLANDINGS,
    machine_buses=(3, 6, 8),
    generator_buses=(1,),
    governor_buses=(1,),
)
_WIND_PLANT = _wind_plant(250.0, 20.0, 14.0, 10.0, 8.0)


def _drawn_v1(name: str, description: str, plant: Mapping[str, Any] = _WIND_PLANT, **settings: Any) -> Suite:
    return strata.suite_of_strata(name, description, plant, _PLACES, **settings)


#: Failures besides load events in faults-v1.
_FAULTS: draws.Changes = {
    draws.LineTrips: {"probability": 0.6},
    draws.MachineOutages: {"probability": 0.4},
    draws.Faults: {"probability": 0.3, "lines": _FAULT_LINES},
}

_SUITES = (
    Suite(
        name="paper",
        description="The two cases of the paper: 75 MW more at bus 2 and at bus 3; the loads of buses 4 and 9 lost.",
        duration_s=120.0,
        cases=_paper_cases((11.4, 8.0), 75.0),
    ),
    _drawn("standard", "Medium wind, one to three load events, grids from weak to strong."),
    _drawn(
        "low-wind",
        "Wind far below rated, where there is little reserve and a rotor stalls soonest.",
        {draws.Wind: {"mean_m_s": (6.0, 8.0), "gust_m_s": (1.5, 3.5), "ramp_m_s": (0.5, 1.5)}},
    ),
    _drawn(
        "gust",
        "A gust on one group or a wind ramp on all in every run, in turbulence of class A.",
        {
            draws.Wind: {
                "mean_m_s": (7.0, 11.0),
                "turbulence_intensity": (0.16, 0.16),
                "gust_probability": 0.6,
                "gust_m_s": (3.0, 6.0),
                "ramp_probability": 0.4,
                "ramp_m_s": (2.0, 4.0),
            },
            draws.LoadEvents: {"number": (1, 2)},
        },
    ),
    _drawn(
        "weak-grid",
        "Half the inertia and governors with a high droop: the frequency falls fast and far.",
        {
            draws.OperatingPoint: {
                "governor_droop": (0.04, 0.05),
                "inertia_scale": (0.5, 0.6),
                "load_level": (0.9, 1.1),
            },
            draws.LoadNoise: {"standard_deviation_mw": 1.5},
            draws.LineTrips: {"probability": 0.3},
        },
    ),
    _drawn_v1("standard", "Three fifths of the power from wind beside one small generator: the wind decides."),
    _drawn_v1(
        "low-share",
        "Two fifths of the power from wind, and larger events.",
        _wind_plant(300.0, 14.0, 10.0, 7.0, 5.0),
        event_size=1.25,
        changes={draws.Wind: {"penetration": (0.25, 0.6)}},
        changes_in={
            "machine": {
                draws.OperatingPoint: {"load_level": (0.85, 0.88)},
                draws.LoadEvents: {"size_mw": (6.0, 12.0), "net_change_mw": 12.0},
                draws.Wind: {"mean_m_s": (10.5, 13.0), "penetration": (0.72, 0.77)},
            },
            "island": {draws.Wind: {"penetration": (0.45, 0.65)}},
        },
    ),
    _drawn_v1(
        "high-share",
        "Three quarters of the power from wind beside a generator of 150 MVA.",
        _wind_plant(150.0, 26.0, 18.0, 13.0, 10.0),
        event_size=0.7,
        changes={draws.Wind: {"penetration": (0.6, 0.83)}},
        changes_in={"machine": {draws.Wind: {"mean_m_s": (8.5, 11.0), "penetration": (0.74, 0.88)}}},
    ),
    _drawn_v1(
        "gusty",
        "A gust on one group or a wind ramp on all in nearly every run, in turbulence of class A.",
        event_size=0.9,
        changes={
            draws.Wind: {
                "mean_m_s": (9.0, 11.5),
                "turbulence_intensity": (0.16, 0.16),
                "gust_probability": 0.5,
                # V_gust of class A in these winds (IEC 61400-1 ed. 3, eq. 17).
                "gust_m_s": (4.5, 6.0),
                "ramp_probability": 0.4,
                "ramp_m_s": (1.0, 1.8),
                "penetration": (0.4, 0.74),
            }
        },
        changes_in={
            "machine": {draws.Wind: {"mean_m_s": (9.5, 12.0), "penetration": (0.7, 0.85), "ramp_m_s": (0.5, 1.2)}},
            "island": {draws.Wind: {"mean_m_s": (9.0, 12.0), "penetration": (0.55, 0.82)}},
        },
    ),
    _drawn_v1(
        "no-wind-sensor",
        "The scenarios of standard-v1, but nobody measures the wind.",
        sensors=draws.SensorDistribution(wind_sensor=False),
        scenarios_of="standard",
    ),
    _drawn_v1(
        "faults",
        "Short circuits, lines that open and close again, machines and groups that trip, in every stratum.",
        changes={draws.LineTrips: {"reclosing_s": (1.0, 10.0)}},
        changes_in={"loads": _FAULTS, "large-loads": {**_FAULTS, draws.GroupTrips: {"probability": 0.15}}},
    ),
    _drawn_v1(
        "weak-grid",
        "Long lines and no condensers: a short-circuit ratio of 1.5 … 3 at every WTG group.",
        _wind_plant(122.0, 20.0, 14.0, 10.0, 8.0, branch_scale=2.5, condensers=False),
        event_size=0.8,
        changes={
            draws.OperatingPoint: {"load_level": (0.85, 1.0)},
            draws.Wind: {"penetration": (0.69, 0.79)},
            draws.UnitCommitment: {"loading": (0.6, 0.8)},
        },
        changes_in={
            "large-loads": {draws.MachineOutages: {"probability": 0.0}},
            "machine": {
                draws.OperatingPoint: {"load_level": (0.93, 1.0)},
                draws.Wind: {"penetration": (0.74, 0.88)},
                draws.UnitCommitment: {"loading": (0.3, 0.45)},
            },
        },
    ),
    Suite(
        name="paper-v1",
        description="The paper's cases in this grid: 35 MW more at buses 2 and 3; the loads of buses 4 and 9 lost.",
        duration_s=120.0,
        task=V1,
        sensors=draws.SensorDistribution(),
        cases=_paper_cases((11.0, 9.0), 35.0),
        **_WIND_PLANT,
    ),
    # Without events that no law survives in simulation.
    *(grid_suite.read_suite(path).suite for path in sorted((FOLDER / "suites").glob("*.json"))),
)
#: Every suite by its name.
SUITES: Mapping[str, Suite] = MappingProxyType({suite.name: suite for suite in _SUITES})

DEFAULT_SUITE = "standard-v1"
#: The hashes that the suites must have.
FROZEN_HASHES: Mapping[str, str] = MappingProxyType(
    {
        "paper": "7aaa8a1c75a47f259104b4d8d5b94a7e1b9e51f918aa5e1a5e5dff708b7ed360",
        "standard": "ebb8c5bcdf75973ef5cee1e48639976e9cb4db654fa5f0b201595dfbc517a045",
        "low-wind": "3c6454dd11d019be25e8282164a9b8c8a00bf377ca149c67b1af51261ce2f54f",
        "gust": "a6a50118d0a21891c75f9eea0470f8c06c45c4b9cec95a635fb9b51815b708c5",
        "weak-grid": "54861ae09060eb4e63541f6e14187da30e9bd11d3cce7b366e3fab39b4350ad9",
        "standard-v1": "6c26bf19889eef30ef3ab969586cea0426ae3b144f67f8a7bfcfe219c79f0bdd",
        "low-share-v1": "74167f1e915123ea4bc55c9123372559ad9412eca7f0e9850d0c155fb39b888e",
        "high-share-v1": "f81430c0b5df0baf73a80316997cda8638a3c7d9033632e230b1cbb3abf6ae0e",
        "gusty-v1": "e658b6bee2c3988e6c332b733eb5aa16a4d2129363a5619e9339e7830b0bb246",
        "no-wind-sensor-v1": "3db2f02c2c391d5f7e0d3e99ca94891654887d45ad9f72dabbf8f244cf563dc8",
        "faults-v1": "9b290d469af2e66c1458935a6611a83a010d30ea0a5136f3575d6e812c8410a0",
        "weak-grid-v1": "eabd8f914a8cec8a3ccf5aed2b7a9007b5ba738c0fb0b60533ceb9a80fc8ee12",
        "paper-v1": "74c85e2c9ee800fb57b0f1c0cf134d62604664c4547946bbac86386aa7a50192",
        "ieee39-v1": "4ae3bae7970de02f6978921da316ae985402b8dd16ea33381868146cd7067a59",
        "kundur-v1": "12660480d88c72415255a591597107a210c238de62565b4adc3e8c43ace0c874",
        "nordic45-v1": "6999eead5f09adc77c4fcbae3854165942ea8ecf18bc0b9e511221692492c3d1",
    }
)


def suite_of_grid(grid: str) -> str:
    """Return the name of a grid's suite, or the path of the grid's file, which stands for one with all events."""
    if not isinstance(grid, str):
        raise ValueError(f"grid must be a name or the path of a .json file, got {grid!r:.80}")
    get_grid(grid)
    if grid == DEFAULT_GRID:
        return DEFAULT_SUITE
    return grid if grid.endswith(".json") else f"{grid}-v1" if f"{grid}-v1" in SUITES else str(FOLDER / f"{grid}.json")


def get_suite(name: str) -> Suite:
    """Return a suite by its name, or the path of its file or a grid's, a .json; a ValueError says why there is none."""
    if isinstance(name, str) and name.endswith(".json"):
        suite = grid_suite.suite_of_file(name)
        if suite.name in FROZEN_HASHES and suite.hash != FROZEN_HASHES[suite.name]:
            raise ValueError(f"{name} is another suite than {suite.name}: give it another name")
        return suite
    if not isinstance(name, str) or name not in SUITES:
        known = f"{', '.join(SUITES)}, or the path of a .json file{did_you_mean(name, SUITES)}"
        raise ValueError(f"unknown suite {name!r}; known suites: {known}")
    return SUITES[name]
