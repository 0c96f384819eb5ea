"""A suite of scenarios: its splits, its seeds and its hash."""

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property, partial
from itertools import pairwise
from types import EllipsisType
from typing import Any

import numpy as np

from wtg_gym.physics.grid import DEFAULT_GRID
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Event, Scenario, trusted
from wtg_gym.ranges import did_you_mean, is_whole, require_whole
from wtg_gym.scenarios.distribution import ScenarioDistribution
from wtg_gym.scenarios.draws import SensorDistribution, Span
from wtg_gym.scenarios.margin import ReserveMargin
from wtg_gym.tasks import ANY_GRID, V0, Task

#: Names of the frozen splits, in the order of the seeds' use.
SPLITS = ("train", "validation", "test")
#: Scenarios of one evaluation at most: the intervals of its scores take memory in proportion.
MOST_SCENARIOS = 10_000
#: Scenarios of a seed that are drawn at most until one has the reserve margin of its stratum.
_MOST_ATTEMPTS = 1000
#: Rated power of the default turbine [MW].
_RATED_MW = TurbineParameters().rated_power_mw


@dataclass(frozen=True, kw_only=True)
class FixedCase:
    """A case with constant wind and given events."""

    name: str
    wind_speed_m_s: tuple[float, ...]  # of the groups, repeated if there are more groups [m/s]
    events: tuple[Event, ...]


@dataclass(frozen=True, kw_only=True)
class Suite:
    """A frozen list of scenarios: distributions with seed ranges, or fixed cases with seeds 0, 1, …

    A ValueError says that there are neither or both of distributions and cases, that a stratum has no name or
    distribution, or that splits of distributions overlap.
    """

    name: str
    description: str = ""  # one line on what it is about
    duration_s: float  # length of its runs [s]
    task: Task = V0  # what is acted, charged and observed: a version of the benchmark
    grid: str = DEFAULT_GRID  # name of its grid, or path of the grid's file
    plant: Plant = field(default_factory=Plant)  # the grid with its machines, turbines and physics
    plant_data: Mapping[str, Any] = field(default_factory=dict)  # what its hash holds of the plant in versions after v0
    described: Plant | None = None  # the plant that `plant_data` describes; of any other the hash takes everything
    sensors: SensorDistribution | None = None  # of the measurements' errors; None for exact measurements
    #: Distributions of its scenarios by the name of their stratum, "" where there is only one. The first of n strata
    #: has the seeds with seed % n = 0, of its m distributions the first those with seed // n % m = 0.
    drawn_from: Mapping[str, tuple[ScenarioDistribution, ...]] = field(default_factory=dict)
    #: Range of the :class:`~wtg_gym.scenarios.margin.ReserveMargin` of each stratum [-]; its distributions are tried in
    #: turn, from a seed's own on, until a scenario falls in it.
    margins: Mapping[str, Span] = field(default_factory=dict)
    cases: tuple[FixedCase, ...] = ()  # the fixed ones, case i having the seed i in every split
    train: range = range(1_000_000, 2**31)  # seeds to train on
    validation: range = range(10_000, 10_100)  # to select on
    test: range = range(20_000, 20_200)  # to rank on

    def __post_init__(self) -> None:
        if bool(self.drawn_from) == bool(self.cases):
            raise ValueError(f"suite {self.name!r} needs either distributions or cases")
        if not all(self.drawn_from.values()) or ("" in self.drawn_from and len(self.drawn_from) > 1):
            raise ValueError(f"every stratum of suite {self.name!r} needs a name and a distribution")
        if self.cases:
            for split in SPLITS:
                object.__setattr__(self, split, range(len(self.cases)))
            return
        ordered = sorted((self.train, self.validation, self.test), key=lambda seeds: seeds.start)
        if any(low.stop > high.start for low, high in pairwise(ordered)):
            raise ValueError(f"the splits of suite {self.name!r} overlap: {self._split_text()}")

    @property
    def env_id(self) -> str:
        """Id of its environment."""
        return self.task.env_id if self.grid == DEFAULT_GRID else ANY_GRID

    @property
    def nominal_hz(self) -> float:
        """Nominal frequency of its grid [Hz]."""
        return self.plant.case.frequency_hz

    @property
    def distributions(self) -> tuple[ScenarioDistribution, ...]:
        """Every distribution that its scenarios are drawn from; none for fixed cases."""
        return tuple(distribution for draws in self.drawn_from.values() for distribution in draws)

    @property
    def strata(self) -> tuple[str, ...]:
        """Names of its strata, in the order of seed % n; none where all scenarios are drawn alike, or fixed."""
        return tuple(stratum for stratum in self.drawn_from if stratum)

    def stratum(self, seed: int) -> str:
        """Return the name of a seed's stratum, "" where there are none."""
        return self.strata[seed % len(self.strata)] if self.strata else ""

    def margin(self, scenario: Scenario, plant: Plant | None = None) -> float:
        """Return the margin that a scenario was drawn with, else compute it; NaN in a suite without margins."""
        if not self.margins:
            return math.nan
        return self._margins_in(plant).of(scenario) if scenario.reserve_margin is None else scenario.reserve_margin

    def _margins_in(self, plant: Plant | None) -> ReserveMargin:
        """Return what computes margins: in the suite's plant, or in `plant` if its groups or buses differ."""
        base = self.plant
        is_other = plant and (plant.groups, plant.case.bus_numbers) != (base.groups, base.case.bus_numbers)
        return ReserveMargin(plant) if plant and is_other else self._usual_margins

    @cached_property
    def _usual_margins(self) -> ReserveMargin:
        return ReserveMargin(self.plant)

    def cost_offset(self, scenario: Scenario, plant: Plant | None = None) -> float:
        """Return J0 of the score in a scenario, by its :meth:`margin`; below all strata that of the last."""
        if not self.margins:
            return self.task.cost_offsets[""]
        margin = self.margin(scenario, plant)
        strata = [name for name, (low, _) in self.margins.items() if margin >= low]
        return self.task.cost_offsets[strata[0] if strata else list(self.margins)[-1]]

    def _distribution(self, seed: int, attempt: int) -> ScenarioDistribution:
        turn, place = divmod(int(seed), len(self.drawn_from))
        distributions = list(self.drawn_from.values())[place]
        return distributions[(turn + attempt) % len(distributions)]

    def _split_text(self) -> str:
        texts = ((split, self.seeds(split)) for split in SPLITS)
        return ", ".join(f"{split} {seeds.start} … {seeds.stop - 1}" for split, seeds in texts)

    def seeds(self, split: str) -> range:
        """Return the seeds of the split "train", "validation" or "test"; a ValueError lists them."""
        if split not in SPLITS:
            raise ValueError(f"unknown split {split!r}; known splits: {', '.join(SPLITS)}{did_you_mean(split, SPLITS)}")
        seeds: range = getattr(self, split)
        return seeds

    def scenario(self, seed: int, **changes: Any) -> Scenario:
        """Return the scenario of a seed; everything else as for :meth:`scenarios`."""
        return self.scenarios([seed], **changes)[0]

    def scenarios(
        self,
        seeds: Sequence[int],
        *,
        n_turbines: Sequence[float] | None = None,
        duration_s: float | None = None,
        sensors: SensorDistribution | EllipsisType | None = ...,
        plant: Plant | None = None,
    ) -> list[Scenario]:
        """Return the scenarios of seeds. A ValueError says that a seed is in no split, or an argument is out of range.

        Args:
            seeds: each of one of the splits.
            n_turbines: turbines of each WTG group, of as many groups as there are values, see
                :meth:`ScenarioDistribution.draw_many`; None: those of `plant`.
            duration_s: length of the run [s]; None: the suite's own.
            sensors: replaces the suite's own; None measures exactly.
            plant: plant whose WTG groups reserve margins are computed for; None: the suite's, with as many groups as
                `n_turbines` at the bus of the first.
        """
        splits = [self.seeds(split) for split in SPLITS]
        for seed in seeds:
            if not is_whole(seed) or not any(int(seed) in split for split in splits):
                raise ValueError(f"seed {seed!r} is in no split of suite {self.name!r}: {self._split_text()}")
        duration = self.duration_s if duration_s is None else duration_s
        if n_turbines is None:
            n_turbines = self.default_turbines(plant or self.plant)
        elif plant is not None and len(n_turbines) != len(plant.groups):
            n_wtg = len(plant.groups)
            raise ValueError(f"n_turbines must have one value per WTG group ({n_wtg}), got {len(n_turbines)}")
        if self.drawn_from:
            if plant is None and len(n_turbines) != len(self.plant.groups):
                plant = self.plant.replaced(groups=len(n_turbines))
            scenarios = self._drawn_scenarios(seeds, n_turbines, duration, self._margins_in(plant))
        else:
            scenarios = self._fixed_scenarios(seeds, len(n_turbines), duration)
        measuring = self.sensors if sensors is ... else sensors
        if measuring is None:
            return scenarios
        # Suites that share all but the sensors draw the errors alike.
        name = self.name if self.cases else self.distributions[0].name.partition("/")[0]
        errors = measuring.draw_many(name, seeds, len(n_turbines))
        return [_with(scenario, sensors=error) for scenario, error in zip(scenarios, errors, strict=True)]

    def default_turbines(self, plant: Plant) -> list[float]:
        """Return as many of the default turbines as give what those of each group do; v0 counts them as they are."""
        counts = [float(group.n_turbines) for group in plant.groups]
        if self.task is V0:
            return counts
        ratings = [group.turbine.rated_power_mw if group.turbine else _RATED_MW for group in plant.groups]
        return [n * (rating / _RATED_MW) for n, rating in zip(counts, ratings, strict=True)]

    def _drawn_scenarios(
        self, seeds: Sequence[int], n_turbines: Sequence[float], duration_s: float, margins: ReserveMargin
    ) -> list[Scenario]:
        accepted: dict[int, Scenario] = {}
        missing = list(range(len(seeds)))
        for attempt in range(_MOST_ATTEMPTS):
            # Episodes shorter than the suite's may end before any event can leave so little: then the last draw counts.
            takes_any = attempt == _MOST_ATTEMPTS - 1 and duration_s < self.duration_s
            suited = partial(self._suited, margins=margins, takes_any=takes_any)
            by_distribution: dict[str, list[int]] = {}
            for place in missing:
                by_distribution.setdefault(self._distribution(seeds[place], attempt).name, []).append(place)
            for places in by_distribution.values():
                of_seeds = [seeds[place] for place in places]
                distribution = self._distribution(of_seeds[0], attempt)
                drawn = distribution.draw_suited(of_seeds, len(n_turbines), n_turbines, duration_s, attempt, suited)
                with_places = zip(places, drawn, strict=True)
                accepted.update((place, scenario) for place, scenario in with_places if scenario is not None)
            missing = [place for place in missing if place not in accepted]
            if not missing:
                return [accepted[place] for place in range(len(seeds))]
        stratum = self.stratum(seeds[missing[0]])
        what = f"suite {self.name!r}: none of {_MOST_ATTEMPTS} scenarios of seed {seeds[missing[0]]} has"
        raise ValueError(f"{what} the reserve margin of its stratum {stratum!r}, {self.margins[stratum]}")

    def _suited(self, scenario: Scenario, margins: ReserveMargin, takes_any: bool) -> Scenario | None:
        """Return a drawn scenario with its margin, None where that is not one of its stratum and must be."""
        if not self.margins:
            return scenario
        assert scenario.seed is not None
        # A stratum of a user's own need not have a range.
        low, high = self.margins.get(self.stratum(scenario.seed), (-math.inf, math.inf))
        margin = margins.of(scenario, -math.inf if takes_any else low)
        return _with(scenario, reserve_margin=margin) if takes_any or low <= margin < high else None

    def _fixed_scenarios(self, seeds: Sequence[int], n_wtg: int, duration_s: float) -> list[Scenario]:
        require_whole("number of values of n_turbines", n_wtg, 1)
        cases = [self.cases[int(seed)] for seed in seeds]
        return [
            Scenario(
                name=f"{self.name}/{case.name}",
                wind_speed=np.resize(case.wind_speed_m_s, (n_wtg, 1)),
                duration_s=duration_s,
                events=case.events,
                seed=int(seed),
            )
            for seed, case in zip(seeds, cases, strict=True)
        ]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of settings, seed ranges and drawn test and validation scenarios, to six decimals, as hex digits."""
        seeds = {split: self.seeds(split) for split in SPLITS}
        sources = {stratum: [draw.hashed() for draw in draws] for stratum, draws in self.drawn_from.items()}
        drawn = [_fingerprint(scenario) for split in SPLITS[1:] for scenario in self.scenarios(seeds[split])]
        data = {
            "name": self.name,
            "duration_s": self.duration_s,
            "distribution": sources[""][0] if "" in sources else sources or None,
            "cases": [asdict(case) for case in self.cases],
            "splits": {split: [s.start, s.stop, s.step] for split, s in seeds.items()},
            "drawn": drawn,
        }
        if self.task is not V0:
            whole = {} if self.plant == self.described else {"whole": repr(self.plant)}
            data["benchmark"], data["plant"] = self.task.to_dict(), {**self.plant_data, **whole}
            data["sensors"] = None if self.sensors is None else asdict(self.sensors)
        text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


def _with(scenario: Scenario, **values: Any) -> Scenario:
    return trusted(Scenario, **{**vars(scenario), **values})


def _decimal(value: float) -> str:
    # Adding 0.0 turns -0.0 into 0.0.
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
