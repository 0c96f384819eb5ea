"""Frozen suites of scenarios: what is trained on, selected on and ranked on, each with a hash.

A change of anything here, or of what is drawn, changes the hash. It is then a new version of the benchmark.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import pairwise
from types import EllipsisType, MappingProxyType
from typing import Any

import numpy as np

from wtg_gym.physics.machine_parameters import GovernorParameters
from wtg_gym.physics.parameters import WtgGroup
from wtg_gym.physics.scenario import Event, LoadStep, LoadTrip, Scenario, trusted
from wtg_gym.ranges import is_whole
from wtg_gym.scenarios.benchmark import V0, V1, Benchmark, SuitePlant
from wtg_gym.scenarios.distribution import ScenarioDistribution
from wtg_gym.scenarios.sensor_distribution import SensorDistribution

#: Names of the frozen splits, in the order of the seeds' use.
SPLITS = ("train", "validation", "test")
#: The split of seeds that are drawn after a submission, see :mod:`wtg_gym.scenarios.fresh`.
FRESH = "fresh"
_TRAIN_SEEDS = range(1_000_000, 2**31)
_VALIDATION_SEEDS = range(10_000, 10_100)
_TEST_SEEDS = range(20_000, 20_200)
#: Far beyond the other splits, and whole numbers in JavaScript too.
_FRESH_SEEDS = range(2**32, 2**53)


@dataclass(frozen=True, kw_only=True)
class FixedCase:
    """A case with constant wind and given events.

    Args:
        name: name of the case.
        wind_speed_m_s: wind of the groups, repeated if there are more groups [m/s].
        events: load and line events.
    """

    name: str
    wind_speed_m_s: tuple[float, ...]
    events: tuple[Event, ...]


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A frozen list of scenarios: a distribution with seed ranges, or fixed cases with seeds 0, 1, …

    Args:
        name: name of the suite.
        description: one line on what it is about.
        duration_s: length of its runs [s].
        benchmark: version of the benchmark that it belongs to.
        plant: its grid and turbines.
        sensors: distribution of the measurements' errors; None for exact measurements.
        distribution: distribution of its scenarios; None for fixed cases.
        cases: the fixed cases, case i having the seed i in every split; empty with a distribution.
        train: seeds to train on.
        validation: seeds to select on.
        test: seeds to rank on.

    Raises:
        ValueError: neither or both of distribution and cases, or splits of a distribution overlap.
    """

    name: str
    description: str
    duration_s: float
    benchmark: Benchmark = V0
    plant: SuitePlant = field(default_factory=SuitePlant)
    sensors: SensorDistribution | None = None
    distribution: ScenarioDistribution | None = None
    cases: tuple[FixedCase, ...] = ()
    train: range = _TRAIN_SEEDS
    validation: range = _VALIDATION_SEEDS
    test: range = _TEST_SEEDS

    def __post_init__(self) -> None:
        if (self.distribution is None) == (not self.cases):
            raise ValueError(f"suite {self.name!r} needs either a distribution or cases")
        if self.cases:
            for split in SPLITS:
                object.__setattr__(self, split, range(len(self.cases)))
            return
        ordered = sorted((self.train, self.validation, self.test), key=lambda seeds: seeds.start)
        if any(low.stop > high.start for low, high in pairwise(ordered)):
            raise ValueError(f"the splits of suite {self.name!r} overlap: {self._split_text()}")

    @property
    def _splits(self) -> tuple[str, ...]:
        return SPLITS if self.distribution is None else (*SPLITS, FRESH)

    def _split_text(self) -> str:
        texts = ((split, self.seeds(split)) for split in self._splits)
        return ", ".join(f"{split} {seeds.start} … {seeds.stop - 1}" for split, seeds in texts)

    def seeds(self, split: str) -> range:
        """Return the seeds of a split.

        Args:
            split: "train", "validation", "test" or "fresh".

        Raises:
            ValueError: the split is unknown; the message lists them.
        """
        if split == FRESH and self.distribution is not None:
            return _FRESH_SEEDS
        if split not in SPLITS:
            fixed = f"; suite {self.name!r} has fixed cases, there is nothing to draw" if split == FRESH else ""
            raise ValueError(f"unknown split {split!r}; known splits: {', '.join(self._splits)}{fixed}")
        seeds: range = getattr(self, split)
        return seeds

    def scenario(
        self,
        seed: int,
        *,
        n_wtg: int | None = None,
        n_turbines: Sequence[float] | None = None,
        duration_s: float | None = None,
    ) -> Scenario:
        """Return the scenario of a seed.

        Args:
            seed: a seed of one of the splits.
            n_wtg: number of WTG groups; None: the suite's own.
            n_turbines: turbines per group, shape (n_wtg,), see :meth:`ScenarioDistribution.draw`; fixed cases have
                no turbulence to average.
            duration_s: length of the run [s]; None: the suite's own.

        Raises:
            ValueError: the seed is in no split, or an argument is out of range; the message says what is allowed.
        """
        return self.scenarios([seed], n_wtg=n_wtg, n_turbines=n_turbines, duration_s=duration_s)[0]

    def scenarios(
        self,
        seeds: Sequence[int],
        *,
        n_wtg: int | None = None,
        n_turbines: Sequence[float] | None = None,
        duration_s: float | None = None,
        sensors: SensorDistribution | EllipsisType | None = ...,
    ) -> list[Scenario]:
        """Return the scenarios of several seeds; everything else as for :meth:`scenario`.

        `sensors` replaces the suite's own; None measures exactly.
        """
        splits = [self.seeds(split) for split in self._splits]
        for seed in seeds:
            if not is_whole(seed) or not any(int(seed) in split for split in splits):
                raise ValueError(f"seed {seed!r} is in no split of suite {self.name!r}: {self._split_text()}")
        duration = self.duration_s if duration_s is None else duration_s
        if n_wtg is None:
            n_wtg = len(self.plant.groups)
            n_turbines = [group.n_turbines for group in self.plant.groups] if n_turbines is None else n_turbines
        if self.distribution is not None:
            drawn = self.distribution.draw_many(seeds, n_wtg, n_turbines, duration)
        else:
            drawn = self._fixed_scenarios(seeds, n_wtg, n_turbines, duration)
        measuring = self.sensors if sensors is ... else sensors
        if measuring is None:
            return drawn
        name = self.name if self.distribution is None else self.distribution.name
        errors = measuring.draw_many(name, seeds, n_wtg)
        return [
            trusted(Scenario, **{**vars(scenario), "sensors": own}) for scenario, own in zip(drawn, errors, strict=True)
        ]

    def _fixed_scenarios(
        self, seeds: Sequence[int], n_wtg: int, n_turbines: Sequence[float] | None, duration: float
    ) -> list[Scenario]:
        if not is_whole(n_wtg) or n_wtg < 1:
            raise ValueError(f"n_wtg must be a positive integer, got {n_wtg!r}")
        if n_turbines is not None and len(n_turbines) != n_wtg:
            raise ValueError(f"n_turbines must have one value per WTG group ({n_wtg}), got {len(n_turbines)}")
        return [self._fixed_scenario(int(seed), n_wtg, duration) for seed in seeds]

    def _fixed_scenario(self, seed: int, n_wtg: int, duration_s: float) -> Scenario:
        case = self.cases[seed]
        return Scenario(
            name=f"{self.name}/{case.name}",
            wind_speed=np.resize(case.wind_speed_m_s, (n_wtg, 1)),
            duration_s=duration_s,
            events=case.events,
            seed=seed,
        )

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the settings, the seed ranges and the drawn test and validation scenarios, as hex digits.

        Numbers of drawn scenarios enter with six decimals: platforms differ in the last bits of exp and FFT.
        """
        seeds = {split: self.seeds(split) for split in SPLITS}
        drawn = [_fingerprint(self.scenario(seed)) for split in SPLITS[1:] for seed in seeds[split]]
        data = {
            "name": self.name,
            "duration_s": self.duration_s,
            "distribution": None if self.distribution is None else self.distribution.to_dict(),
            "cases": [asdict(case) for case in self.cases],
            "splits": {split: [s.start, s.stop, s.step] for split, s in seeds.items()},
            "drawn": drawn,
        }
        if self.benchmark != V0:
            data["benchmark"], data["plant"] = self.benchmark.to_dict(), self.plant.to_dict()
            data["sensors"] = None if self.sensors is None else asdict(self.sensors)
        text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


def _decimal(value: float) -> str:
    # The zero takes the sign off a negative number that rounds to nought.
    return f"{round(float(value), 6) + 0.0:.6f}"


def _fingerprint(scenario: Scenario) -> dict[str, Any]:
    """A scenario in short, the same on every platform: statistics of its series, and all its plain values."""
    data = scenario.to_dict()
    wind = scenario.wind_speed
    data["wind_speed"] = [[_decimal(w.mean()), _decimal(w.std()), _decimal(w[0]), _decimal(w[-1])] for w in wind]
    noise = scenario.load_noise_mw
    data["load_noise_mw"] = [_decimal(noise.std()), _decimal(noise[-1])] if noise.size else []
    data["n_samples"] = [wind.shape[1], noise.size]
    for values in (data, *data["events"]):
        values.update({key: _decimal(value) for key, value in values.items() if isinstance(value, float)})
    return data


_PAPER_WIND = (11.4, 8.0)
_PAPER = Suite(
    name="paper",
    description="The two cases of the paper: 75 MW more at bus 2 and at bus 3; the loads of buses 4 and 9 lost.",
    duration_s=120.0,
    cases=(
        FixedCase(
            name="load-increase",
            wind_speed_m_s=_PAPER_WIND,
            events=(LoadStep(time_s=5.0, bus=2, power_mw=75.0), LoadStep(time_s=30.0, bus=3, power_mw=75.0)),
        ),
        FixedCase(
            name="load-decrease",
            wind_speed_m_s=_PAPER_WIND,
            events=(LoadTrip(time_s=5.0, bus=4), LoadTrip(time_s=30.0, bus=9)),
        ),
    ),
)


def _drawn(name: str, description: str, **settings: Any) -> Suite:
    distribution = ScenarioDistribution(name=name, **settings)
    return Suite(name=name, description=description, duration_s=60.0, distribution=distribution)


def _wind_plant(generator_mva: float, *turbines: float) -> SuitePlant:
    """Return the grid of version v1: a small generator at bus 1, WTG groups in place of others."""
    return SuitePlant(
        groups=tuple(WtgGroup(bus=bus, n_turbines=n) for bus, n in zip((2, 3, 6, 8), turbines, strict=True)),
        physics="extended",
        generator_mva=generator_mva,
        governor=GovernorParameters(lead_time_s=1.0, reheat_time_s=10.0),
        frequency_limits_hz=(48.5, 51.5),
        overload_from_pu=1.05,
    )


_WIND_PLANT = _wind_plant(250.0, 20.0, 14.0, 10.0, 8.0)
#: What the scenarios of version v1 have in common; a suite replaces some of it.
_WIND_SCENARIOS: Mapping[str, Any] = MappingProxyType(
    {
        "mean_wind_m_s": (8.5, 11.0),
        "mean_wind_spread_m_s": 1.0,
        "wind_share": (0.4, 0.78),
        "wind_ramp_probability": 0.15,
        "wind_ramp_m_s": (0.5, 1.8),
        "load_event_mw": (10.0, 34.0),
        "net_load_change_mw": 38.0,
        "load_trip_probability": 0.1,
        # The load of bus 4 is more than all other events together.
        "load_trip_buses": (9, 14),
        "line_trip_probability": 0.1,
        "governor_droop": (0.03, 0.08),
        "inertia_scale": (0.25, 0.6),
        "governor_loss_probability": 0.05,
        "group_trip_probability": 0.05,
    }
)


def _drawn_v1(
    name: str,
    description: str,
    plant: SuitePlant = _WIND_PLANT,
    sensors: SensorDistribution | None = None,
    scenarios_of: str | None = None,
    **settings: Any,
) -> Suite:
    """Return a suite of version v1; `scenarios_of` names another suite that it shares all but the sensors with."""
    return Suite(
        name=f"{name}-v1",
        description=description,
        duration_s=60.0,
        benchmark=V1,
        plant=plant,
        sensors=sensors or SensorDistribution(),
        distribution=ScenarioDistribution(name=f"{scenarios_of or name}-v1", **{**_WIND_SCENARIOS, **settings}),
        validation=range(10_000, 10_200),
        test=range(20_000, 21_000),
    )


_PAPER_V1 = Suite(
    name="paper-v1",
    description="The paper's cases in this grid: 35 MW more at bus 2 and at bus 3; the loads of buses 4 and 9 lost.",
    duration_s=120.0,
    benchmark=V1,
    plant=_WIND_PLANT,
    sensors=SensorDistribution(),
    cases=(
        FixedCase(
            name="load-increase",
            wind_speed_m_s=(11.0, 9.0),
            events=(LoadStep(time_s=5.0, bus=2, power_mw=35.0), LoadStep(time_s=30.0, bus=3, power_mw=35.0)),
        ),
        FixedCase(
            name="load-decrease",
            wind_speed_m_s=(11.0, 9.0),
            events=(LoadTrip(time_s=5.0, bus=4), LoadTrip(time_s=30.0, bus=9)),
        ),
    ),
)

#: Every suite by its name.
SUITES: Mapping[str, Suite] = MappingProxyType(
    {
        suite.name: suite
        for suite in (
            _PAPER,
            _drawn("standard", "Medium wind, one to three load events, grids from weak to strong."),
            _drawn(
                "low-wind",
                "Wind far below rated, where there is little reserve and a rotor stalls soonest.",
                mean_wind_m_s=(6.0, 8.0),
                gust_m_s=(1.5, 3.5),
                wind_ramp_m_s=(0.5, 1.5),
            ),
            _drawn(
                "gust",
                "A gust on one group or a wind ramp on all in every run, in turbulence of class A.",
                mean_wind_m_s=(7.0, 11.0),
                turbulence_intensity=(0.16, 0.16),
                gust_probability=0.6,
                gust_m_s=(3.0, 6.0),
                wind_ramp_probability=0.4,
                wind_ramp_m_s=(2.0, 4.0),
                n_load_events=(1, 2),
            ),
            _drawn(
                "weak-grid",
                "Half the inertia and governors with a high droop: the frequency falls fast and far.",
                governor_droop=(0.04, 0.05),
                inertia_scale=(0.5, 0.6),
                load_level=(0.9, 1.1),
                load_noise_mw=1.5,
                line_trip_probability=0.3,
            ),
            _drawn_v1("standard", "Three fifths of the power from wind beside one small generator: the wind decides."),
            _drawn_v1(
                "low-share",
                "Two fifths of the power from wind, and larger events.",
                _wind_plant(300.0, 14.0, 10.0, 7.0, 5.0),
                wind_share=(0.25, 0.6),
                load_event_mw=(12.0, 42.0),
                net_load_change_mw=48.0,
            ),
            _drawn_v1(
                "high-share",
                "Three quarters of the power from wind beside a generator of 150 MVA.",
                _wind_plant(150.0, 26.0, 18.0, 13.0, 10.0),
                wind_share=(0.6, 0.83),
                load_event_mw=(6.0, 24.0),
                net_load_change_mw=27.0,
                inertia_scale=(0.35, 0.7),
            ),
            _drawn_v1(
                "gusty",
                "A gust on one group or a wind ramp on all in nearly every run, in turbulence of class A.",
                mean_wind_m_s=(9.0, 11.5),
                turbulence_intensity=(0.16, 0.16),
                gust_probability=0.5,
                gust_m_s=(2.5, 4.0),
                wind_ramp_probability=0.4,
                wind_ramp_m_s=(1.0, 1.8),
                wind_share=(0.4, 0.74),
                n_load_events=(1, 2),
                load_event_mw=(10.0, 30.0),
            ),
            _drawn_v1(
                "no-wind-sensor",
                "The scenarios of standard-v1, but nobody measures the wind.",
                sensors=SensorDistribution(wind_sensor=False),
                scenarios_of="standard",
            ),
            _drawn_v1(
                "faults",
                "Lines that open and close again, machines and groups that trip, besides the load events.",
                line_trip_probability=0.6,
                line_reclosing_s=(1.0, 10.0),
                machine_outage_probability=0.4,
                group_trip_probability=0.15,
            ),
            _PAPER_V1,
        )
    }
)

#: What the hashes of the suites must be.
FROZEN_HASHES: Mapping[str, str] = MappingProxyType(
    {
        "paper": "7aaa8a1c75a47f259104b4d8d5b94a7e1b9e51f918aa5e1a5e5dff708b7ed360",
        "standard": "ebb8c5bcdf75973ef5cee1e48639976e9cb4db654fa5f0b201595dfbc517a045",
        "low-wind": "3c6454dd11d019be25e8282164a9b8c8a00bf377ca149c67b1af51261ce2f54f",
        "gust": "a6a50118d0a21891c75f9eea0470f8c06c45c4b9cec95a635fb9b51815b708c5",
        "weak-grid": "54861ae09060eb4e63541f6e14187da30e9bd11d3cce7b366e3fab39b4350ad9",
        "standard-v1": "fafbb7c797d135f6d65027d6e2dfa7af00cacb88abe3d9e05236ca710b1ad973",
        "low-share-v1": "131a04a7c92ee1eb58030f67dbb8bc9a84b5b505aa0459f33e8985be33c157c9",
        "high-share-v1": "a76891367ec8edf29942adac484b45ff2f48412d8745546db05789bf37acd7fb",
        "gusty-v1": "acef93dc422a964093855ee9a35aadffc8e1065ea75c77386bbfd2127cdc7a4d",
        "no-wind-sensor-v1": "d2a3c6a450b4841dcc76de1b4473f61f524bcfe33813b584de05021645728e42",
        "faults-v1": "4d93ccc01be624696157f96aa62f066ac965806d6fd90cafd3b511b270748c24",
        "paper-v1": "a566d1e110a6a7b4b5697635c086000549b4da1089a0ca395d3e2f5518a6098a",
    }
)


def get_suite(name: str) -> Suite:
    """Return a suite by its name.

    Raises:
        ValueError: the suite is unknown; the message lists the known ones.
    """
    if not isinstance(name, str) or name not in SUITES:
        raise ValueError(f"unknown suite {name!r}; known suites: {', '.join(SUITES)}")
    return SUITES[name]
