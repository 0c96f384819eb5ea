"""The distribution scenarios are drawn from: every range is data, every draw a function of its seed."""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from wtg_gym.physics.checked import Checked, design, required
from wtg_gym.physics.grid import DEFAULT_GRID, Grid, digest_of_grid, get_grid
from wtg_gym.physics.parameters import MOST_GROUPS
from wtg_gym.physics.scenario import (
    LONGEST_RUN_S,
    SERIES_DT,
    Event,
    Fault,
    GovernorLoss,
    GroupTrip,
    LineTrip,
    LoadRamp,
    LoadStep,
    LoadTrip,
    MachineOutage,
    Scenario,
    trusted,
)
from wtg_gym.ranges import require_range, require_whole
from wtg_gym.scenarios import wind
from wtg_gym.scenarios.stream import FloatArray, Picker, Span, seed_streams

#: Lines of the IEEE 14-bus system that no part of it hangs on, without 1-2, which carries most of the output of bus 1:
#: with a load event on top, no wind controller could save the run.
_SURVIVABLE_LINES = (
    (1, 5), (2, 3), (2, 4), (2, 5), (3, 4), (4, 5), (6, 11), (6, 12), (6, 13),
    (9, 10), (9, 14), (10, 11), (12, 13), (13, 14),
)  # fmt: skip
#: Least share of the generator's units that is on line, by design: one of five.
LEAST_COMMITTED = 0.2
#: Share of the load that the network loses, at most.
LOSSES = 0.05
#: Mean winds that are drawn for a share of the load before it counts as impossible.
_MOST_DRAWS = 1000
#: Bus, largest load increase and largest decrease there [MW]: less at the buses behind weak lines; the
#: decrease is the load the bus has at 85 % load level, so that no bus turns into a generator.
_LOAD_BUSES = (
    (2, 75.0, 18.0), (3, 75.0, 80.0), (4, 75.0, 40.0), (5, 75.0, 6.0),
    (6, 50.0, 9.0), (9, 50.0, 25.0), (13, 30.0, 11.0), (14, 30.0, 12.0),
)  # fmt: skip


def _chance(default: float, doc: str) -> Any:
    return design(default, "-", doc, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class ScenarioDistribution(Checked):
    """Ranges and probabilities that scenarios are drawn from; a pair is a range of a uniform distribution.

    The unit, the allowed range and the meaning of every value are its field's metadata.

    Raises:
        ValueError: a value is outside its allowed range; the message names value, unit and range.
    """

    name: str = required("-", "design", "prefix of scenario names; picks the random stream")
    mean_wind_m_s: Span = design((6.5, 11.0), "m/s", "mean wind", 4.0, 20.0)
    mean_wind_spread_m_s: float | None = design(
        None, "m/s", "groups share one mean wind and differ from it by up to this; None: independent means", 0.0, 5.0
    )
    turbulence_intensity: Span = design((0.12, 0.16), "-", "I_ref; classes C … A of IEC 61400-1", 0.0, 0.3)
    n_turbines: float = design(10.0, "-", "turbines per group that the wind is averaged over", 1e-3, 1e4)
    gust_probability: float = _chance(0.1, "chance of an extreme operating gust on one group")
    gust_m_s: Span = design((2.0, 5.0), "m/s", "size of a gust", 0.0, 15.0)
    wind_ramp_probability: float = _chance(0.1, "chance of a wind ramp on all groups; excludes a gust")
    wind_ramp_m_s: Span = design((1.0, 3.0), "m/s", "size of a wind ramp; both signs", 0.0, 10.0)
    wind_ramp_s: Span = design((5.0, 20.0), "s", "length of a wind ramp", 0.1, 3600.0)
    n_load_events: tuple[int, int] = design((1, 3), "-", "number of load events", 0, 20)
    load_event_mw: Span = design((15.0, 50.0), "MW", "size of a load event", 0.0, 1e5)
    load_increase_probability: float = _chance(0.5, "chance that a load event is an increase")
    net_load_change_mw: float = design(
        75.0, "MW", "a load step or ramp that would take their sum beyond this changes its sign", 0.0, 1e5
    )
    load_buses: tuple[tuple[int, float, float], ...] = design(
        _LOAD_BUSES, "-", "bus, largest increase and largest decrease there [MW] over all load events of a run"
    )
    load_ramp_probability: float = _chance(0.25, "chance that a load event is a ramp")
    load_ramp_s: Span = design((2.0, 10.0), "s", "length of a load ramp", 0.1, 3600.0)
    load_trip_probability: float = _chance(0.15, "chance that one load event is a disconnection")
    load_trip_buses: tuple[int, ...] = design(
        (4, 9, 14), "-", "buses whose load may be disconnected; out of load_buses"
    )
    line_trip_probability: float = _chance(0.15, "chance that one line trips")
    line_trips: tuple[tuple[int, int], ...] = design(
        _SURVIVABLE_LINES, "-", "lines that may trip; none that a part of the network hangs on"
    )
    first_event_s: float = design(3.0, "s", "earliest event", 0.0, 3600.0)
    quiet_end_s: float = design(10.0, "s", "time without a new event at the end", 0.0, 3600.0)
    load_noise_mw: float = design(
        1.0, "MW", "standard deviation of the load noise, once its start has decayed", 0.0, 1e4
    )
    load_noise_correlation_s: float = design(2.0, "s", "correlation time of the load noise", 0.1, 60.0)
    load_noise_bus: int = design(3, "-", "bus of the load noise")
    governor_droop: Span = design((0.02, 0.05), "p.u.", "droop of the governors", 0.005, 1.0)
    inertia_scale: Span = design((0.5, 1.0), "-", "factor on the inertia of the synchronous machines", 0.05, 5.0)
    load_level: Span = design((0.85, 1.1), "-", "factor on the loads of the case", 0.3, 1.5)
    wind_share: Span | None = design(
        None,
        "-",
        "share of the load that the mean winds give to turbines at nominal reserve; others are drawn again",
        0.0,
        1.0,
    )
    governor_loss_probability: float = _chance(0.0, "chance that the governor is lost, every other time from the start")
    group_trip_probability: float = _chance(
        0.0, "chance that a WTG group but the largest trips; excludes the loss of the governor"
    )
    machine_outage_probability: float = _chance(0.0, "chance that a synchronous machine disconnects")
    machine_outage_buses: tuple[int, ...] = design((3, 6, 8), "-", "buses whose machine may disconnect")
    line_reclosing_s: Span | None = design(
        None, "s", "time after which a tripped line comes back; None: it does not", 0.1, 3600.0
    )
    generator_mva: float | None = design(
        None,
        "MVA",
        "rating of all units of the generator, where as many are committed as machine_loading asks",
        1.0,
        1e5,
    )
    machine_loading: Span | None = design(
        None,
        "-",
        "load that the wind leaves, over the rating of the generator's units on line; None: all are",
        0.05,
        1.0,
    )
    last_event_s: float | None = design(None, "s", "latest event; None: quiet_end_s alone bounds it", 0.0, 3600.0)
    fault_probability: float = _chance(0.0, "chance of a short circuit at a line's first bus, which opens the line")
    fault_lines: tuple[tuple[int, int], ...] = design(
        (), "-", "lines with a short circuit, its bus first; none that a part of the network hangs on"
    )
    fault_clearing_s: Span = design((0.1, 0.25), "s", "time until it is cleared; to a tenth of a second", 0.1, 1.0)
    islandings: tuple[tuple[tuple[int, int], ...], ...] = design(
        (), "-", "sets of lines of which one opens at once, in every run; none: it does not happen"
    )
    grid: str = design(DEFAULT_GRID, "-", "name of the grid, or path of its file")
    governor_loss_buses: tuple[int, ...] = design((1,), "-", "buses of machines of which one loses its governor")
    constant_mw: float = design(0.0, "MW", "what machines without a governor give", 0.0, 1e6)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.name:
            raise ValueError("a distribution needs a name")
        for first, second in (
            ("gust_probability", "wind_ramp_probability"),
            ("governor_loss_probability", "group_trip_probability"),
        ):
            if (total := getattr(self, first) + getattr(self, second)) > 1.0:
                raise ValueError(f"{first} + {second} = {total:g}, at most 1 is allowed: they exclude each other")
        self._check_places()

    def _check_places(self) -> None:
        buses = [bus for bus, _, _ in self.load_buses]
        if not buses or len(set(buses)) < len(buses):
            raise ValueError(f"load_buses needs at least one bus, and each bus once, got {buses}")
        for bus, increase, decrease in self.load_buses:
            require_range(f"largest load increase at bus {bus}", increase, 0.0, 1e4, "MW")
            require_range(f"largest load decrease at bus {bus}", decrease, 0.0, 1e4, "MW")
        if (self.load_trip_probability and not self.load_trip_buses) or not set(self.load_trip_buses) <= set(buses):
            raise ValueError(f"load_trip_buses must be one or more of the load buses {buses}: {self.load_trip_buses}")
        case = self._grid_data.case
        for name, chance in (("line_trips", self.line_trip_probability), ("fault_lines", self.fault_probability)):
            lines = getattr(self, name)
            if (chance and not lines) or any(case.branch_index(*line) in case.bridges for line in lines):
                raise ValueError(f"{name} must be one or more lines that no part of the network hangs on, got {lines}")
        for lines in self.islandings:
            if len(case.parts_without(tuple(case.branch_index(*line) for line in lines))) != 2:
                raise ValueError(f"islandings must each leave two parts of the network, got {lines}")
        if self.islandings and self.line_trip_probability + self.fault_probability > 0.0:
            raise ValueError("islandings exclude line trips and faults, which open lines too")

    def to_dict(self) -> dict[str, Any]:
        """Return every setting as JSON-ready data; the keyword arguments to build the distribution again.

        Settings that older suites do not have are left out where they do nothing, so that those keep their hashes. A
        digest of what is in the grid stands in its place.
        """
        data = dataclasses.asdict(self)
        names = list(data)
        for name in names[names.index("wind_share") :]:
            if data[name] == getattr(type(self), name):
                del data[name]
        return data | {"grid": digest_of_grid(self._grid_data)} if "grid" in data else data

    def draw(self, seed: int, *given: Any) -> Scenario:
        """Draw the scenario of a seed; everything else as for :meth:`draw_many`."""
        return self.draw_many([seed], *given)[0]

    def draw_many(
        self, seeds: Sequence[int], n_wtg: int = 2, n_turbines: Sequence[float] | None = None, duration_s: float = 60.0
    ) -> list[Scenario]:
        """Draw the scenarios of seeds, several quicker than one by one: the same seed always gives the same scenario.

        Args:
            seeds: non-negative integers.
            n_wtg: number of WTG groups.
            n_turbines: turbines per group for the averaging of wind, shape (n_wtg,); None: `self.n_turbines` each.
            duration_s: length of the run [s]; in a run too short for `first_event_s` and `quiet_end_s`, events
                come no later than half-way.

        Raises:
            ValueError: an argument is out of range; the message names it.
        """
        for seed in seeds:
            require_whole("a seed", seed, 0, 2**63 - 1)
        n_wtg = require_whole("n_wtg", n_wtg, 1, MOST_GROUPS)
        turbines = [self.n_turbines] * n_wtg if n_turbines is None else [float(n) for n in n_turbines]
        if len(turbines) != n_wtg:
            raise ValueError(f"n_turbines must have one value per WTG group ({n_wtg}), got {len(turbines)}")
        for number in turbines:
            require_range("n_turbines", number, 1e-3, 1e4, "")
        duration_s = require_range("duration_s", duration_s, SERIES_DT, LONGEST_RUN_S, "s")
        latest = max(duration_s - self.quiet_end_s, 0.5 * duration_s)
        if self.last_event_s is not None:
            latest = min(latest, self.last_event_s)
        window = (min(self.first_event_s, latest), latest)
        n_samples = math.ceil(round(duration_s / SERIES_DT, 6)) + 1
        # The name is part of the seed, so that two suites share no scenario.
        streams = seed_streams(seeds, zlib.crc32(self.name.encode()))
        plans = [self._plan(Picker(stream), turbines, n_samples, window) for stream in streams]
        speeds, noises = self._series(streams, plans, turbines, n_samples)
        return [
            trusted(
                Scenario,
                name=f"{self.name}/{seed}",
                wind_speed=speed,
                wind_dt_s=SERIES_DT,
                duration_s=duration_s,
                events=plan.events,
                load_noise_mw=noise,
                load_noise_bus=self.load_noise_bus,
                load_level=plan.load_level,
                governor_droop=plan.governor_droop,
                inertia_scale=plan.inertia_scale,
                committed=self._committed(plan, turbines, speed[:, 0]),
                sensors=None,
                seed=int(seed),
            )
            for seed, plan, speed, noise in zip(seeds, plans, speeds, noises, strict=True)
        ]

    def _plan(self, pick: Picker, turbines: list[float], n_samples: int, window: Span) -> _Plan:
        load_level: float
        plan = _Plan(
            governor_droop=pick.between(self.governor_droop),
            inertia_scale=pick.between(self.inertia_scale),
            load_level=(load_level := pick.between(self.load_level)),
            events=(*self._load_events(pick, window), *self._line_trips(pick, window)),
            intensity=pick.between(self.turbulence_intensity),
            mean_winds=self._mean_winds(pick, turbines, load_level),
            wind_event=self._wind_event(pick, len(turbines), n_samples, window),
        )
        # Last in the stream, so that suites without them draw what they always drew.
        outages = self._outages(pick, turbines, window)
        plan = plan._replace(events=(*plan.events, *outages, *self._faults(pick, plan.events, window)))
        if self.machine_loading is None:
            return plan
        return plan._replace(machine_loading=pick.between(self.machine_loading))

    def _committed(self, plan: _Plan, turbines: list[float], first_winds: FloatArray) -> float:
        """Return the share of the generator's units on line: enough for what the wind leaves, on average and at first.

        Where all of them do not suffice at the loading that was drawn, they carry more.
        """
        if plan.machine_loading is None or self.generator_mva is None:
            return 1.0
        load_mw = plan.load_level * self._load_mw
        given = min(wind.share_of_load(winds, turbines, load_mw) for winds in (plan.mean_winds, first_winds.tolist()))
        needed = ((1.0 + LOSSES - given) * load_mw - self.constant_mw) / (plan.machine_loading * self.generator_mva)
        return min(max(needed, LEAST_COMMITTED), 1.0)

    @property
    def _load_mw(self) -> float:
        """Load of the grid [MW]."""
        return self._grid_data.case.load_mw

    @cached_property
    def _grid_data(self) -> Grid:
        """The grid itself, read once: what is written to its file later does not change what was made of it."""
        return get_grid(self.grid)

    @cached_property
    def _load_rooms(self) -> tuple[dict[int, float], dict[int, float]]:
        """Largest increase and largest decrease of the load by bus [MW]."""
        return {bus: limit for bus, limit, _ in self.load_buses}, {bus: limit for bus, _, limit in self.load_buses}

    def _load_events(self, pick: Picker, window: Span) -> list[Event]:
        n_events = pick.whole(*self.n_load_events)
        times = sorted([pick.instant(window) for _ in range(n_events)])
        trip_index = pick.whole(0, n_events - 1) if n_events and pick.chance(self.load_trip_probability) else -1
        increase, decrease = self._load_rooms[0].copy(), self._load_rooms[1].copy()
        trip_bus = 0
        trip_mw = 0.0
        if trip_index >= 0:
            trip_bus = pick.choice(self.load_trip_buses)
            trip_mw, decrease[trip_bus] = decrease[trip_bus], 0.0
        events: list[Event] = []
        net_mw = 0.0
        for index, time_s in enumerate(times):
            if index == trip_index:
                events.append(trusted(LoadTrip, time_s=time_s, bus=trip_bus))
                net_mw -= trip_mw
                continue
            size = round(pick.between(self.load_event_mw), 2)
            sign = 1 if pick.chance(self.load_increase_probability) else -1
            if abs(net_mw + sign * size) > self.net_load_change_mw:
                sign = -sign
            room = increase if sign > 0 else decrease
            able = [bus for bus, limit in room.items() if limit >= size]
            bus = pick.choice(able) if able else max(room, key=room.__getitem__)
            size = min(size, room[bus])
            room[bus] = round(room[bus] - size, 2)
            net_mw += sign * size
            change = {"time_s": time_s, "bus": bus, "power_mw": sign * size, "reactive_mvar": 0.0}
            if pick.chance(self.load_ramp_probability):
                events.append(trusted(LoadRamp, **change, duration_s=round(pick.between(self.load_ramp_s), 1)))
            else:
                events.append(trusted(LoadStep, **change))
        return events

    def _line_trips(self, pick: Picker, window: Span) -> list[Event]:
        if not pick.chance(self.line_trip_probability):
            return []
        from_bus, to_bus = pick.choice(self.line_trips)
        time_s = pick.instant(window)
        after_s = None if self.line_reclosing_s is None else round(pick.between(self.line_reclosing_s), 1)
        return [_line_trip(time_s, from_bus, to_bus, after_s)]

    def _outages(self, pick: Picker, turbines: list[float], window: Span) -> list[Event]:
        events: list[Event] = []
        if self.governor_loss_probability + self.group_trip_probability > 0.0:
            kind = pick.uniform()
            if kind < self.governor_loss_probability:
                time_s = 0.0 if pick.chance(0.5) else pick.instant(window)
                # Of one there is nothing to draw.
                buses = self.governor_loss_buses
                bus = buses[0] if len(buses) == 1 else pick.choice(buses)
                events.append(trusted(GovernorLoss, time_s=time_s, bus=bus))
            elif kind < self.governor_loss_probability + self.group_trip_probability:
                # Of one group there is no other.
                group = pick.choice(sorted(range(len(turbines)), key=turbines.__getitem__)[:-1] or [0])
                events.append(trusted(GroupTrip, time_s=pick.instant(window), group=group, returns_after_s=None))
        if self.machine_outage_probability > 0.0 and pick.chance(self.machine_outage_probability):
            time_s, bus = pick.instant(window), pick.choice(self.machine_outage_buses)
            events.append(trusted(MachineOutage, time_s=time_s, bus=bus, returns_after_s=None))
        return events

    def _faults(self, pick: Picker, events: Sequence[Event], window: Span) -> list[Event]:
        found: list[Event] = []
        if self.fault_probability > 0.0 and pick.chance(self.fault_probability):
            # A line that is open already cannot clear it.
            open_lines = [(event.from_bus, event.to_bus) for event in events if isinstance(event, LineTrip)]
            able = [line for line in self.fault_lines if (min(line), max(line)) not in open_lines]
            if able:
                bus, other = pick.choice(able)
                fault = Fault(
                    time_s=pick.instant(window),
                    bus=bus,
                    clears_after_s=pick.instant(self.fault_clearing_s),
                    opens=(bus, other),
                )
                found.append(fault)
        if self.islandings:
            lines, time_s = pick.choice(self.islandings), pick.instant(window)
            found += [_line_trip(time_s, *ends) for ends in lines]
        return found

    def _series(
        self, streams: Sequence[np.random.Generator], plans: Sequence[_Plan], turbines: list[float], n_samples: int
    ) -> tuple[FloatArray, FloatArray]:
        """Wind per scenario and group, (n, n_wtg, n_samples) [m/s], and load noise, (n, n_samples or 0) [MW]."""
        n, n_wtg, n_period = len(plans), len(turbines), wind.period_length(n_samples)
        units, sigmas = [], []
        of_noise = wind.noise_amplitude(self.load_noise_correlation_s, n_period)
        for plan in plans:
            for mean, n_turbines in zip(plan.mean_winds, turbines, strict=True):
                units.append(wind.turbulence_amplitude(mean, n_turbines, n_period))
                sigmas.append(wind.ntm_sigma(mean, plan.intensity))
            units.append(of_noise)
            sigmas.append(self.load_noise_mw)
        amplitudes = np.concatenate(units).reshape(n, n_wtg + 1, -1)
        amplitudes *= np.array(sigmas).reshape(n, -1, 1)
        coefficients = np.empty(amplitudes.shape, dtype=np.complex128)
        normals = coefficients.view(np.float64).reshape(n, -1)
        for own, stream in zip(normals, streams, strict=True):
            stream.standard_normal(out=own)
        normals.reshape(*amplitudes.shape, 2)[:] *= amplitudes[..., np.newaxis]
        series: FloatArray = np.fft.irfft(coefficients, n_period)[..., :n_samples]
        speed, noise = series[:, :n_wtg], series[:, n_wtg]
        speed += np.array([plan.mean_winds for plan in plans])[:, :, None]
        for own, plan in zip(speed, plans, strict=True):
            if plan.wind_event is not None:
                group, change = plan.wind_event
                own[group] += change
        # New arrays, which do not hold the rest of the period in memory.
        speed = np.clip(speed, *wind.DRAWN_WIND_RANGE)
        if self.load_noise_mw:
            noise = noise - noise[:, :1] * wind.noise_decay(self.load_noise_correlation_s, n_samples)
        else:
            noise = np.zeros((n, 0))
        for array in (speed, noise):
            array.setflags(write=False)
        return speed, noise

    def _mean_winds(self, pick: Picker, turbines: list[float], load_level: float) -> list[float]:
        if self.wind_share is None:
            return self._any_mean_winds(pick, len(turbines))
        (low, high), load_mw = self.wind_share, load_level * self._load_mw
        for _ in range(_MOST_DRAWS):
            winds = self._any_mean_winds(pick, len(turbines))
            if low <= wind.share_of_load(winds, turbines, load_mw) <= high:
                return winds
        raise ValueError(
            f"wind_share: winds of {self.mean_wind_m_s[0]:g} … {self.mean_wind_m_s[1]:g} m/s hardly ever give these "
            f"{sum(turbines):g} turbines {100.0 * low:g} … {100.0 * high:g} % of the load"
        )

    def check_share(self, n_turbines: Sequence[float]) -> None:
        """Refuse turbines per group that hardly any mean winds let give the `wind_share`; a ValueError says why."""
        if self.wind_share is None:
            return
        low, high = self.mean_wind_m_s
        # A twentieth of the range at either end: that many draws at least must fit.
        margin = 0.05 * (high - low)
        for load_level in self.load_level:
            speeds, load_mw = (low + margin, high - margin), load_level * self._load_mw
            least, most = (wind.share_of_load([speed] * len(n_turbines), n_turbines, load_mw) for speed in speeds)
            if most < self.wind_share[0] or least > self.wind_share[1]:
                raise ValueError(
                    f"these {sum(n_turbines):g} turbines give {100.0 * least:.0f} … {100.0 * most:.0f} % of the load "
                    f"at level {load_level:g}; the wind_share of {self.name!r} is {100.0 * self.wind_share[0]:g} … "
                    f"{100.0 * self.wind_share[1]:g} %: other groups or another suite are needed"
                )

    def _any_mean_winds(self, pick: Picker, n_wtg: int) -> list[float]:
        spread = self.mean_wind_spread_m_s
        if spread is None:
            return [pick.between(self.mean_wind_m_s) for _ in range(n_wtg)]
        low, high = wind.DRAWN_WIND_RANGE
        shared = pick.between(self.mean_wind_m_s)
        return [min(max(shared + pick.between((-spread, spread)), low), high) for _ in range(n_wtg)]

    def _wind_event(
        self, pick: Picker, n_wtg: int, n_samples: int, window: Span
    ) -> tuple[int | slice, FloatArray] | None:
        """The groups that a gust or ramp reaches, and its change of wind [m/s]; None for neither."""
        kind = pick.uniform()
        if kind >= self.gust_probability + self.wind_ramp_probability:
            return None
        start_s = pick.instant(window)
        time_s = SERIES_DT * np.arange(n_samples, dtype=np.float64)
        if kind < self.gust_probability:
            # A gust spans at most a few hundred metres; a front passes the whole plant.
            group = pick.whole(0, n_wtg - 1)
            return group, wind.extreme_operating_gust(time_s, start_s, pick.between(self.gust_m_s))
        change = pick.between(self.wind_ramp_m_s) * (1.0 if pick.chance(0.5) else -1.0)
        return slice(None), wind.coherent_ramp(time_s, start_s, change, pick.between(self.wind_ramp_s))


def _line_trip(time_s: float, from_bus: int, to_bus: int, recloses_after_s: float | None = None) -> LineTrip:
    ends = {"from_bus": from_bus, "to_bus": to_bus}
    return trusted(LineTrip, time_s=time_s, **ends, recloses_after_s=recloses_after_s, circuit=None)


class _Plan(NamedTuple):
    """What is drawn of a scenario besides its series."""

    governor_droop: float
    inertia_scale: float
    load_level: float
    events: tuple[Event, ...]
    intensity: float
    mean_winds: list[float]
    wind_event: tuple[int | slice, FloatArray] | None
    machine_loading: float | None = None
