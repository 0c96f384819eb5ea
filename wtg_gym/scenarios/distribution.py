"""The distribution scenarios are drawn from: a named list of records; every draw is a function of its seed."""

import dataclasses
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np

from wtg_gym.physics import parameters, scenario
from wtg_gym.physics.grid import DEFAULT_GRID, Grid, digest_of_grid, get_grid
from wtg_gym.physics.layout import Floats
from wtg_gym.ranges import Checked, describe, design, require_known, require_range, require_whole, required
from wtg_gym.scenarios import draws, wind

R = TypeVar("R", bound=draws.Record)

#: Names of the fields of records, in their order, in the data of a hash, on which frozen suites depend.
_HASHED: Mapping[type[draws.Record], str] = MappingProxyType(
    {
        draws.OperatingPoint: "governor_droop inertia_scale load_level",
        draws.LoadEvents: "n_load_events load_event_mw load_increase_probability net_load_change_mw load_buses "
        "load_ramp_probability load_ramp_s load_trip_probability load_trip_buses",
        draws.LineTrips: "line_trip_probability line_trips line_reclosing_s",
        draws.Wind: "mean_wind_m_s mean_wind_spread_m_s turbulence_intensity n_turbines gust_probability gust_m_s "
        "gust_averaged wind_ramp_probability wind_ramp_m_s wind_ramp_s wind_share",
        draws.GovernorLosses: "governor_loss_probability governor_loss_buses",
        draws.GroupTrips: "group_trip_probability",
        draws.MachineOutages: "machine_outage_probability machine_outage_buses",
        draws.Faults: "fault_probability fault_lines fault_clearing_s",
        draws.Islandings: "islandings",
        draws.UnitCommitment: "generator_mva machine_loading constant_mw",
        draws.LoadNoise: "load_noise_mw load_noise_correlation_s load_noise_bus",
    }
)
_NO_CHANCES = ("governor_loss_probability", "group_trip_probability", "machine_outage_probability", "fault_probability")
#: Values that are left out of the data of a hash: suites were frozen before these fields existed.
_UNMENTIONED: Mapping[str, Any] = MappingProxyType(
    {
        **dict.fromkeys(("wind_share", "last_event_s", "line_reclosing_s")),
        **dict.fromkeys(("constant_mw", *_NO_CHANCES), 0.0),
        **dict.fromkeys(("islandings", "fault_lines"), ()),
        **{"governor_loss_buses": (1,), "machine_outage_buses": (3, 6, 8), "fault_clearing_s": (0.1, 0.25)},
        "gust_averaged": False,
    }
)


@dataclass(frozen=True, kw_only=True)
class ScenarioDistribution(Checked):
    """A named list of records that scenarios are drawn from, in the order in which they take numbers from the stream.

    Without `OperatingPoint`, droop, inertia and load are the grid's; without `UnitCommitment`, all units are on line. A
    ValueError says that a value is outside its range, records do not fit the grid or each other, or there is no `Wind`.
    """

    name: str = required("-", "design", "prefix of scenario names; picks the random stream")
    records: tuple[draws.Record, ...] = dataclasses.field(
        default=(draws.OperatingPoint(), draws.LoadEvents(), draws.LineTrips(), draws.Wind(), draws.LoadNoise()),
        metadata=describe("-", "design", "what is drawn"),
    )
    grid: str = design(DEFAULT_GRID, "-", "name of the grid, or path of its file")
    first_event_s: float = design(3.0, "s", "earliest event", 0.0, 3600.0)
    last_event_s: float | None = design(None, "s", "latest event; None: quiet_end_s alone bounds it", 0.0, 3600.0)
    quiet_end_s: float = design(10.0, "s", "time without a new event at the end", 0.0, 3600.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.name:
            raise ValueError("a distribution needs a name")
        types = [type(record) for record in self.records]
        known = [type_ for type_ in types if type_ in _HASHED]
        if draws.Wind not in types or len(set(types)) < len(types) or known != [k for k in _HASHED if k in types]:
            order, names = (", ".join(type_.__name__ for type_ in group) for group in (_HASHED, types))
            raise ValueError(f"records must be a Wind, and at most one each of {order}, in this order, got {names}")
        for record in self.records:
            record.check(self._grid_data.with_groups, self.records)

    def find(self, record_class: type[R]) -> R | None:
        """Return the record of a type, None where there is none."""
        return next((record for record in self.records if isinstance(record, record_class)), None)

    def changed(self, changes: draws.Changes) -> "ScenarioDistribution":
        """Return the distribution with fields of its records replaced; a ValueError lists the records there are."""
        names = [type(record).__name__ for record in self.records]
        require_known("records", [type_.__name__ for type_ in changes], names)
        records = (dataclasses.replace(record, **changes.get(type(record), {})) for record in self.records)
        return dataclasses.replace(self, records=tuple(records))

    def to_dict(self) -> dict[str, Any]:
        """Return every setting as JSON-ready data, the records by their type."""
        records = {type(record).__name__: dataclasses.asdict(record) for record in self.records}
        return {**dataclasses.asdict(self), "records": records}

    def hashed(self) -> dict[str, Any]:
        """Return what enters a suite's hash, as flat JSON-ready data; a digest stands for what is in the grid."""
        data = {name: getattr(self, name) for name in ("name", "first_event_s", "last_event_s", "quiet_end_s")}
        for record in self.records:
            values, names = dataclasses.asdict(record), _HASHED.get(type(record))
            named = names and dict(zip(names.split(), values.values(), strict=True))
            data |= named or {type(record).__name__: values}
        if self.grid != DEFAULT_GRID:
            data["grid"] = digest_of_grid(self._grid_data)
        return {name: value for name, value in data.items() if name not in _UNMENTIONED or value != _UNMENTIONED[name]}

    def draw(self, seed: int, *arguments: Any) -> scenario.Scenario:
        """Draw the scenario of a seed; everything else as for :meth:`draw_many`."""
        return self.draw_many([seed], *arguments)[0]

    def draw_many(
        self,
        seeds: Sequence[int],
        n_wtg: int = 2,
        n_turbines: Sequence[float] | None = None,
        duration_s: float = 60.0,
    ) -> list[scenario.Scenario]:
        """Draw the scenarios of seeds, several quicker than one by one: the same seed always gives the same scenario.

        Wind is averaged over turbines per group, (n_wtg,); None: those of `Wind` each. In a short run [s] events come
        no later than half-way.
        """
        drawn = self.draw_suited(seeds, n_wtg, n_turbines, duration_s, 0, lambda scenario: scenario)
        return [each for each in drawn if each is not None]

    def draw_suited(
        self,
        seeds: Sequence[int],
        n_wtg: int,
        n_turbines: Sequence[float] | None,
        duration_s: float,
        attempt: int,
        suited: Callable[[scenario.Scenario], scenario.Scenario | None],
    ) -> list[scenario.Scenario | None]:
        """Draw scenarios as :meth:`draw_many` does; each is what `suited` makes of it, None if it does not suit.

        Another attempt is another scenario of each seed. The load noise comes last, and is not there yet for `suited`.
        """
        for seed in seeds:
            require_whole("a seed", seed, 0, 2**63 - 1)
        n_wtg = require_whole("n_wtg", n_wtg, 1, parameters.MOST_GROUPS)
        turbines = [self.wind.n_turbines] * n_wtg if n_turbines is None else [float(n) for n in n_turbines]
        if len(turbines) != n_wtg:
            raise ValueError(f"n_turbines must have one value per WTG group ({n_wtg}), got {len(turbines)}")
        for number in turbines:
            require_range("n_turbines", number, 1e-3, 1e4, "")
        duration_s = require_range("duration_s", duration_s, scenario.SERIES_DT, scenario.LONGEST_RUN_S, "s")
        # The name is part of the seed, so that two suites share no scenario.
        streams = draws.seed_streams(seeds, zlib.crc32(self.name.encode()), attempt)
        drafts = [self._draft(stream, turbines, duration_s) for stream in streams]
        noise = self.find(draws.LoadNoise) or draws.LoadNoise(standard_deviation_mw=0.0)
        commitment = self.find(draws.UnitCommitment)
        without_noise = (
            scenario.trusted(
                scenario.Scenario,
                name=f"{self.name}/{seed}",
                wind_speed=speed,
                wind_dt_s=scenario.SERIES_DT,
                duration_s=duration_s,
                events=tuple(draft.events),
                load_noise_mw=np.zeros(0),
                load_noise_bus=noise.bus,
                load_level=draft.load_level,
                governor_droop=draft.governor_droop,
                inertia_scale=draft.inertia_scale,
                committed=1.0 if commitment is None else commitment.committed(draft, speed[:, 0].tolist()),
                sensors=None,
                reserve_margin=None,
                seed=int(seed),
            )
            for seed, draft, speed in zip(seeds, drafts, _winds(streams, drafts), strict=True)
        )
        drawn = [suited(each) for each in without_noise]
        if drafts and noise.standard_deviation_mw:
            places = [place for place, each in enumerate(drawn) if each is not None]
            for place, noise_mw in zip(places, _noises([streams[i] for i in places], drafts[0], noise), strict=True):
                drawn[place] = scenario.trusted(scenario.Scenario, **{**vars(drawn[place]), "load_noise_mw": noise_mw})
        return drawn

    def check_turbines(self, n_turbines: Sequence[float]) -> None:
        """Refuse turbines per group that hardly any mean winds let give the penetration; a ValueError says why."""
        point = self.find(draws.OperatingPoint)
        for level in (1.0,) if point is None else point.load_level:
            self.wind.check_turbines(n_turbines, level * self._grid_data.case.load_mw)

    @property
    def wind(self) -> draws.Wind:
        """The record of mean wind, turbulence, gusts and ramps."""
        wind = self.find(draws.Wind)
        assert wind is not None
        return wind

    def _draft(self, stream: np.random.Generator, n_turbines: Sequence[float], duration_s: float) -> draws.Draft:
        latest = max(duration_s - self.quiet_end_s, 0.5 * duration_s)
        if self.last_event_s is not None:
            latest = min(latest, self.last_event_s)
        draft = draws.Draft(
            n_turbines=n_turbines,
            load_mw=self._grid_data.case.load_mw,
            window=(min(self.first_event_s, latest), latest),
            n_samples=math.ceil(round(duration_s / scenario.SERIES_DT, 6)) + 1,
        )
        pick = draws.Picker(stream)
        for record in self.records:
            record.draw(pick, draft)
        return draft

    @cached_property
    def _grid_data(self) -> Grid:
        """The grid, read once: later changes of its file have no effect."""
        return get_grid(self.grid)


def _winds(streams: Sequence[np.random.Generator], drafts: Sequence[draws.Draft]) -> Floats:
    """Wind per scenario and group, (n, n_wtg, n_samples) [m/s]."""
    if not drafts:
        return np.zeros((0, 0, 0))
    n_samples = drafts[0].n_samples
    n_period = wind.period_length(n_samples)
    units, sigmas = [], []
    for draft in drafts:
        for mean, n_turbines in zip(draft.mean_winds_m_s, draft.n_turbines, strict=True):
            units.append(wind.turbulence_amplitude(round(10.0 * mean), n_turbines, n_period))
            sigmas.append(wind.ntm_sigma(mean, draft.turbulence_intensity))
    amplitudes = np.array(units) * np.array(sigmas)[:, np.newaxis]
    speed = _series(streams, amplitudes.reshape(len(drafts), -1, amplitudes.shape[1]), n_period)[..., :n_samples]
    speed += np.array([draft.mean_winds_m_s for draft in drafts])[:, :, None]
    for of_scenario, draft in zip(speed, drafts, strict=True):
        if draft.wind_change is not None:
            groups, change = draft.wind_change
            of_scenario[groups] += change
    # A new array, which does not hold the rest of the period in memory.
    speed = np.clip(speed, *wind.DRAWN_WIND_RANGE)
    speed.setflags(write=False)
    return speed


def _noises(streams: Sequence[np.random.Generator], draft: draws.Draft, noise: draws.LoadNoise) -> Floats:
    """Load noise per scenario, (n, n_samples) [MW]; drawn after the wind, in scenarios as long as the draft."""
    n_period = wind.period_length(draft.n_samples)
    amplitude = wind.noise_amplitude(noise.correlation_s, n_period) * noise.standard_deviation_mw
    series = _series(streams, np.broadcast_to(amplitude, (len(streams), 1, amplitude.size)), n_period)
    noise_mw = series[:, 0, : draft.n_samples]
    noise_mw = noise_mw - noise_mw[:, :1] * wind.noise_decay(noise.correlation_s, draft.n_samples)
    noise_mw.setflags(write=False)
    return noise_mw


def _series(streams: Sequence[np.random.Generator], amplitudes: Floats, n_period: int) -> Floats:
    """Gaussian series of Fourier amplitudes (n, n_series, n_frequencies): (n, n_series, n_period)."""
    coefficients = np.empty(amplitudes.shape, dtype=np.complex128)
    for numbers, stream in zip(coefficients.view(np.float64), streams, strict=True):
        stream.standard_normal(out=numbers)
    coefficients.real *= amplitudes
    coefficients.imag *= amplitudes
    series: Floats = np.fft.irfft(coefficients, n_period)
    return series
