"""What scenarios are drawn from: records of wind, load, outages and operating point, and the errors of sensors."""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar

import numpy as np

from wtg_gym.physics import grid, scenario
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.scenario import SERIES_DT, Event, trusted
from wtg_gym.physics.sensors import DELAY_MAX_S, Sensors
from wtg_gym.ranges import Checked, design, require_range, required
from wtg_gym.scenarios import wind

Line = tuple[int, int]
Span = tuple[float, float]
T = TypeVar("T")
#: Uniform numbers that a picker takes from a stream at a time.
_N_UNIFORMS = 64


def seed_streams(seeds: Sequence[int], key: int, attempt: int = 0) -> list[np.random.Generator]:
    """Return one stream per seed; another key or attempt gives others."""
    more = [attempt] if attempt else []
    return [np.random.default_rng([seed, key, *more]) for seed in seeds]


class Picker:
    """Uniform draws of plain Python values."""

    def __init__(self, stream: np.random.Generator) -> None:
        self._stream = stream
        self._left: list[float] = []

    def uniform(self) -> float:
        """Return a number in [0, 1): those of the stream by the block, each block from its end."""
        if not self._left:
            self._left = self._stream.random(_N_UNIFORMS).tolist()
        return self._left.pop()

    def between(self, span: Span) -> float:
        """Return a number of the span low … high."""
        low, high = span
        return low + (high - low) * self.uniform()

    def chance(self, probability: float) -> bool:
        return self.uniform() < probability

    def whole(self, low: int, high: int) -> int:
        """Return one of the whole numbers low … high."""
        return low + int((high - low + 1) * self.uniform())

    def choice(self, options: Sequence[T]) -> T:
        return options[self.whole(0, len(options) - 1)]

    def instant(self, window: Span) -> float:
        """Return an instant of the window, to a tenth of a second [s]."""
        return round(self.between(window), 1)


def lines_of(text: str) -> tuple[Line, ...]:
    """Return the lines of a text such as "1-5 2-3": the buses at both ends of each."""
    pairs = (line.split("-") for line in text.split())
    return tuple((int(from_bus), int(to_bus)) for from_bus, to_bus in pairs)


#: Lines of the IEEE 14-bus system whose loss leaves it connected, without 1-2, which carries most of the output of bus
#: 1: its loss together with a load event ends the run under every controller.
_SURVIVABLE_LINES = lines_of("1-5 2-3 2-4 2-5 3-4 4-5 6-11 6-12 6-13 9-10 9-14 10-11 12-13 13-14")
_BUSES, _INCREASES_MW = (2, 3, 4, 5, 6, 9, 13, 14), (75.0, 75.0, 75.0, 75.0, 50.0, 50.0, 30.0, 30.0)
_DECREASES_MW = (18.0, 80.0, 40.0, 6.0, 9.0, 25.0, 11.0, 12.0)
#: Bus, largest load increase and largest decrease there [MW]: less at the buses behind weak lines; the
#: decrease is the load the bus has at 85 % load level, so that no bus turns into a generator.
_LOAD_BUSES = tuple(zip(_BUSES, _INCREASES_MW, _DECREASES_MW, strict=True))
#: Least share of the generator's units that is on line, by design: one of five.
LEAST_COMMITTED = 0.2
#: Share of the load that the network loses, at most.
LOSSES = 0.05
#: Mean winds that are drawn for a penetration before it counts as impossible.
_MOST_DRAWS = 1000


@dataclass(kw_only=True)
class Draft:
    """The part of a scenario that is drawn so far; records read values of earlier ones."""

    n_turbines: Sequence[float]  # of each WTG group
    load_mw: float  # of the grid, at the load level that was drawn [MW]
    window: Span  # earliest and latest instant of an event [s]
    n_samples: int  # of the wind series
    governor_droop: float | None = None
    inertia_scale: float = 1.0
    load_level: float = 1.0
    events: list[Event] = field(default_factory=list)
    turbulence_intensity: float = 0.0
    mean_winds_m_s: Sequence[float] = ()
    wind_change: tuple[int | slice, Floats] | None = None  # groups that a gust or ramp reaches, and its change [m/s]
    machine_loading: float | None = None  # load that the wind leaves, over the rating of the generator's units on line


@dataclass(frozen=True, kw_only=True)
class Record(Checked):
    """A part of what scenarios are drawn from; a pair of numbers is the range of a uniform distribution.

    The unit, the allowed range and the meaning of every value are its field's metadata. A ValueError names a value
    outside its allowed range, its unit and the range.
    """

    def check(self, case: grid.NetworkCase, records: "Sequence[Record]") -> None:
        """Refuse with a ValueError what does not fit the network with its groups, or the other records."""

    def draw(self, pick: Picker, draft: Draft) -> None:
        """Draw this part of a scenario into the draft."""


#: New values of records' fields, by the type of the record.
Changes = Mapping[type[Record], Mapping[str, Any]]


def _require_buses(name: str, buses: Sequence[int], known: Sequence[int], what: str = "bus") -> None:
    for bus in buses:
        if bus not in known:
            raise ValueError(f"{name}: there is no {what} {bus!r}")


def _chance(default: float, doc: str) -> Any:
    return design(default, "-", doc, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class OperatingPoint(Record):
    """Droop, inertia and load that a run starts with."""

    governor_droop: Span = design((0.02, 0.05), "p.u.", "droop of the governors", 0.005, 1.0)
    inertia_scale: Span = design((0.5, 1.0), "-", "factor on the inertia of the synchronous machines", 0.05, 5.0)
    load_level: Span = design((0.85, 1.1), "-", "factor on the loads of the case", 0.3, 1.5)

    def draw(self, pick: Picker, draft: Draft) -> None:
        draft.governor_droop = pick.between(self.governor_droop)
        draft.inertia_scale = pick.between(self.inertia_scale)
        draft.load_level = pick.between(self.load_level)
        draft.load_mw *= draft.load_level


@dataclass(frozen=True, kw_only=True)
class LoadEvents(Record):
    """Load steps and ramps, and at most one disconnection of a bus's load."""

    number: tuple[int, int] = design((1, 3), "-", "number of load events", 0, 20)
    size_mw: Span = design((15.0, 50.0), "MW", "size of a load event", 0.0, 1e5)
    increase_probability: float = _chance(0.5, "chance that a load event is an increase")
    net_change_mw: float = design(75.0, "MW", "a step or ramp changes its sign if their sum exceeds this", 0.0, 1e5)
    buses: tuple[tuple[int, float, float], ...] = design(
        _LOAD_BUSES, "-", "bus, largest increase and largest decrease there over a run [MW]"
    )
    ramp_probability: float = _chance(0.25, "chance that a load event is a ramp")
    ramp_s: Span = design((2.0, 10.0), "s", "length of a load ramp", 0.1, 3600.0)
    trip_probability: float = _chance(0.15, "chance that one load event is a disconnection")
    trip_buses: tuple[int, ...] = design((4, 9, 14), "-", "buses whose load may be disconnected; out of buses")

    def __post_init__(self) -> None:
        super().__post_init__()
        for bus, *changes_mw in self.buses:
            for change_mw in changes_mw:
                require_range(f"largest load change at bus {bus}", change_mw, 0.0, 1e4, "MW")
        numbers = [bus for bus, _, _ in self.buses]
        if not numbers or len(set(numbers)) < len(numbers):
            raise ValueError(f"LoadEvents.buses needs at least one bus, and each bus once, got {numbers}")
        if (self.trip_probability and not self.trip_buses) or not set(self.trip_buses) <= set(numbers):
            raise ValueError(f"trip_buses must be one or more of the load buses {numbers}, got {self.trip_buses}")

    def check(self, case: grid.NetworkCase, records: Sequence[Record]) -> None:
        _require_buses("LoadEvents.buses", [bus for bus, _, _ in self.buses], case.bus_numbers)

    def draw(self, pick: Picker, draft: Draft) -> None:
        n_events = pick.whole(*self.number)
        times = sorted([pick.instant(draft.window) for _ in range(n_events)])
        trip_index = pick.whole(0, n_events - 1) if n_events and pick.chance(self.trip_probability) else -1
        increase_mw = {bus: limit for bus, limit, _ in self.buses}
        decrease_mw = {bus: limit for bus, _, limit in self.buses}
        trip_bus, trip_mw = 0, 0.0
        if trip_index >= 0:
            trip_bus = pick.choice(self.trip_buses)
            trip_mw, decrease_mw[trip_bus] = decrease_mw[trip_bus], 0.0
        net_mw = 0.0
        for index, time_s in enumerate(times):
            if index == trip_index:
                draft.events.append(trusted(scenario.LoadTrip, time_s=time_s, bus=trip_bus))
                net_mw -= trip_mw
                continue
            size = round(pick.between(self.size_mw), 2)
            sign = 1 if pick.chance(self.increase_probability) else -1
            if abs(net_mw + sign * size) > self.net_change_mw:
                sign = -sign
            left_mw = increase_mw if sign > 0 else decrease_mw
            able = [bus for bus, limit in left_mw.items() if limit >= size]
            bus = pick.choice(able) if able else max(left_mw, key=left_mw.__getitem__)
            size = min(size, left_mw[bus])
            left_mw[bus] = round(left_mw[bus] - size, 2)
            net_mw += sign * size
            step = {"time_s": time_s, "bus": bus, "power_mw": sign * size, "reactive_mvar": 0.0}
            if pick.chance(self.ramp_probability):
                draft.events.append(trusted(scenario.LoadRamp, **step, duration_s=round(pick.between(self.ramp_s), 1)))
            else:
                draft.events.append(trusted(scenario.LoadStep, **step))


@dataclass(frozen=True, kw_only=True)
class LoadNoise(Record):
    """Random load at one bus, an Ornstein-Uhlenbeck process that starts at zero."""

    standard_deviation_mw: float = design(1.0, "MW", "standard deviation, once its start has decayed", 0.0, 1e4)
    correlation_s: float = design(2.0, "s", "correlation time", 0.1, 60.0)
    bus: int = design(3, "-", "bus of the load")

    def check(self, case: grid.NetworkCase, records: Sequence[Record]) -> None:
        _require_buses("LoadNoise.bus", [self.bus], case.bus_numbers)


@dataclass(frozen=True, kw_only=True)
class Wind(Record):
    """Mean wind and turbulence of every group, and at most one gust or wind ramp."""

    mean_m_s: Span = design((6.5, 11.0), "m/s", "mean wind", 4.0, 20.0)
    mean_spread_m_s: float | None = design(
        None, "m/s", "largest difference of a group from a shared mean wind; None: independent means", 0.0, 5.0
    )
    turbulence_intensity: Span = design((0.12, 0.16), "-", "I_ref; classes C … A of IEC 61400-1", 0.0, 0.3)
    n_turbines: float = design(10.0, "-", "turbines per group that the wind is averaged over", 1e-3, 1e4)
    gust_probability: float = _chance(0.1, "chance of an extreme operating gust on one group")
    gust_m_s: Span = design((2.0, 5.0), "m/s", "size of a gust", 0.0, 15.0)
    gust_averaged: bool = design(False, "-", "whether a gust is at one turbine, and the group feels an average")
    ramp_probability: float = _chance(0.1, "chance of a wind ramp on all groups; excludes a gust")
    ramp_m_s: Span = design((1.0, 3.0), "m/s", "size of a wind ramp; both signs", 0.0, 10.0)
    ramp_s: Span = design((5.0, 20.0), "s", "length of a wind ramp", 0.1, 3600.0)
    penetration: Span | None = design(
        None, "-", "share of the load that turbines at nominal reserve cover in the mean winds; None: any", 0.0, 1.0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if (total := self.gust_probability + self.ramp_probability) > 1.0:
            raise ValueError(f"gust_probability + ramp_probability = {total:g}; they exclude each other: at most 1")

    def draw(self, pick: Picker, draft: Draft) -> None:
        draft.turbulence_intensity = pick.between(self.turbulence_intensity)
        draft.mean_winds_m_s = self._mean_winds(pick, draft.n_turbines, draft.load_mw)
        draft.wind_change = self._change(pick, draft)

    def _mean_winds(self, pick: Picker, n_turbines: Sequence[float], load_mw: float) -> list[float]:
        if self.penetration is None:
            return self._any_mean_winds(pick, len(n_turbines))
        low, high = self.penetration
        for _ in range(_MOST_DRAWS):
            winds = self._any_mean_winds(pick, len(n_turbines))
            if low <= wind.share_of_load(winds, n_turbines, load_mw) <= high:
                return winds
        raise ValueError(
            f"penetration: winds of {self.mean_m_s[0]:g} … {self.mean_m_s[1]:g} m/s hardly ever give these "
            f"{sum(n_turbines):g} turbines {100.0 * low:g} … {100.0 * high:g} % of the load"
        )

    def _any_mean_winds(self, pick: Picker, n_groups: int) -> list[float]:
        spread = self.mean_spread_m_s
        if spread is None:
            return [pick.between(self.mean_m_s) for _ in range(n_groups)]
        low, high = wind.DRAWN_WIND_RANGE
        shared = pick.between(self.mean_m_s)
        return [min(max(shared + pick.between((-spread, spread)), low), high) for _ in range(n_groups)]

    def _change(self, pick: Picker, draft: Draft) -> tuple[int | slice, Floats] | None:
        """The groups that a gust or ramp reaches, and its change of wind [m/s]; None for neither."""
        uniform = pick.uniform()
        if uniform >= self.gust_probability + self.ramp_probability:
            return None
        start_s = pick.instant(draft.window)
        time_s = SERIES_DT * np.arange(draft.n_samples, dtype=np.float64)
        if uniform < self.gust_probability:
            # A gust spans at most a few hundred metres; a front passes the whole plant.
            group = pick.whole(0, len(draft.n_turbines) - 1)
            size = pick.between(self.gust_m_s)
            if self.gust_averaged:
                size *= wind.gust_share(draft.mean_winds_m_s[group], draft.n_turbines[group])
            return group, wind.extreme_operating_gust(time_s, start_s, size)
        change = pick.between(self.ramp_m_s) * (1.0 if pick.chance(0.5) else -1.0)
        # It grows linearly, and stays.
        return slice(None), change * np.clip((time_s - start_s) / pick.between(self.ramp_s), 0.0, 1.0)

    def check_turbines(self, n_turbines: Sequence[float], load_mw: float) -> None:
        """Refuse turbines per group that hardly any mean winds let give the penetration of a load [MW]."""
        if self.penetration is None:
            return
        low, high = self.mean_m_s
        # A twentieth of the range at either end: that many draws at least must fit.
        ends = low + 0.05 * (high - low), high - 0.05 * (high - low)
        least, most = (wind.share_of_load([end] * len(n_turbines), n_turbines, load_mw) for end in ends)
        if most < self.penetration[0] or least > self.penetration[1]:
            raise ValueError(
                f"these groups, like {sum(n_turbines):g} turbines of {TurbineParameters().rated_power_mw:g} MW, give "
                f"{100.0 * least:.0f} … {100.0 * most:.0f} % of a load of {load_mw:.0f} MW; allowed is a penetration "
                f"of {100.0 * self.penetration[0]:g} … {100.0 * self.penetration[1]:g} %: give other groups in a list, "
                'as [{"bus": 2, "n_turbines": 52}], or another suite'
            )


@dataclass(frozen=True, kw_only=True)
class RareEvent(Record):
    """Something that happens once in a run, or not at all."""

    #: Field that says where it may happen, if it may not happen anywhere.
    WHERE: ClassVar[str] = ""
    probability: float = required("-", "design", "chance that it happens in a run", 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.probability and self.WHERE and not getattr(self, self.WHERE):
            raise ValueError(f"{type(self).__name__}.{self.WHERE} must not be empty at a probability above 0")

    def draw(self, pick: Picker, draft: Draft) -> None:
        # An event of probability 0 takes no number from the stream.
        if self.probability > 0.0 and pick.chance(self.probability):
            draft.events += self.events(pick, draft)

    def events(self, pick: Picker, draft: Draft) -> list[Event]:
        """Draw what happens, where it does."""
        raise NotImplementedError


def _check_lines(name: str, lines: Sequence[Line], case: grid.NetworkCase) -> None:
    if any(case.branch_index(*line) in case.bridges for line in lines):
        raise ValueError(f"{name} must be lines whose loss leaves the network connected, got {lines}")


def _line_trip(time_s: float, line: Line, recloses_after_s: float | None = None) -> Event:
    ends = {"from_bus": line[0], "to_bus": line[1]}
    return trusted(scenario.LineTrip, time_s=time_s, **ends, recloses_after_s=recloses_after_s, circuit=None)


@dataclass(frozen=True, kw_only=True)
class LineTrips(RareEvent):
    """A line opens."""

    WHERE = "lines"
    probability: float = _chance(0.15, "chance that one line trips")
    lines: tuple[Line, ...] = design(_SURVIVABLE_LINES, "-", "lines that may trip; no part of the network hangs on one")
    reclosing_s: Span | None = design(None, "s", "time after which the line closes again; None: never", 0.1, 3600.0)

    def check(self, case: grid.NetworkCase, records: Sequence[Record]) -> None:
        _check_lines("LineTrips.lines", self.lines, case)

    def draw(self, pick: Picker, draft: Draft) -> None:
        # Unlike others, it takes a number from the stream even at a probability of 0: frozen scenarios depend on it.
        if pick.chance(self.probability):
            draft.events += self.events(pick, draft)

    def events(self, pick: Picker, draft: Draft) -> list[Event]:
        line, time_s = pick.choice(self.lines), pick.instant(draft.window)
        after_s = None if self.reclosing_s is None else round(pick.between(self.reclosing_s), 1)
        return [_line_trip(time_s, line, after_s)]


@dataclass(frozen=True, kw_only=True)
class GovernorLosses(RareEvent):
    """A machine loses its governor, every other time from the start."""

    WHERE = "buses"
    buses: tuple[int, ...] = design((), "-", "buses of machines of which one loses its governor")

    def check(self, case: grid.NetworkCase, records: Sequence[Record]) -> None:
        governed = [machine.bus for machine in case.machines if machine.governor is not None]
        _require_buses("GovernorLosses.buses", self.buses, governed, "machine with a governor at bus")

    def events(self, pick: Picker, draft: Draft) -> list[Event]:
        time_s = 0.0 if pick.chance(0.5) else pick.instant(draft.window)
        # Of one there is nothing to draw.
        bus = self.buses[0] if len(self.buses) == 1 else pick.choice(self.buses)
        return [trusted(scenario.GovernorLoss, time_s=time_s, bus=bus)]


@dataclass(frozen=True, kw_only=True)
class GroupTrips(RareEvent):
    """A WTG group but the largest trips."""

    def events(self, pick: Picker, draft: Draft) -> list[Event]:
        by_size = sorted(range(len(draft.n_turbines)), key=draft.n_turbines.__getitem__)
        # The largest group stays, unless it is the only one.
        group = pick.choice(by_size[:-1] or [0])
        return [trusted(scenario.GroupTrip, time_s=pick.instant(draft.window), group=group)]


@dataclass(frozen=True, kw_only=True)
class MachineOutages(RareEvent):
    """A synchronous machine disconnects."""

    WHERE = "buses"
    buses: tuple[int, ...] = design((), "-", "buses whose machine may disconnect")

    def check(self, case: grid.NetworkCase, records: Sequence[Record]) -> None:
        _require_buses("MachineOutages.buses", self.buses, [machine.bus for machine in case.machines], "machine at bus")

    def events(self, pick: Picker, draft: Draft) -> list[Event]:
        time_s, bus = pick.instant(draft.window), pick.choice(self.buses)
        return [trusted(scenario.MachineOutage, time_s=time_s, bus=bus)]


@dataclass(frozen=True, kw_only=True)
class Faults(RareEvent):
    """A short circuit at a line's first bus, which opens the line."""

    WHERE = "lines"
    lines: tuple[Line, ...] = design((), "-", "lines, the bus of the fault first; no part of the network hangs on one")
    clearing_s: Span = design((0.1, 0.25), "s", "time until it is cleared; to a tenth of a second", 0.1, 1.0)

    def check(self, case: grid.NetworkCase, records: Sequence[Record]) -> None:
        _check_lines("Faults.lines", self.lines, case)

    def events(self, pick: Picker, draft: Draft) -> list[Event]:
        # A line that is open already cannot clear it.
        open_lines = [(event.from_bus, event.to_bus) for event in draft.events if isinstance(event, scenario.LineTrip)]
        able = [line for line in self.lines if (min(line), max(line)) not in open_lines]
        if not able:
            return []
        line = pick.choice(able)
        time_s, clears_after_s = pick.instant(draft.window), pick.instant(self.clearing_s)
        return [scenario.Fault(time_s=time_s, bus=line[0], clears_after_s=clears_after_s, opens=line)]


@dataclass(frozen=True, kw_only=True)
class Islandings(Record):
    """In every run, lines open at once and leave two parts of the network."""

    line_sets: tuple[tuple[Line, ...], ...] = design((), "-", "sets of lines of which one opens; none: no islanding")

    def check(self, case: grid.NetworkCase, records: Sequence[Record]) -> None:
        for lines in self.line_sets:
            if len(case.parts_without(tuple(case.branch_index(*line) for line in lines))) != 2:
                raise ValueError(f"line_sets of Islandings must each leave two parts of the network, got {lines}")
        others = [record for record in records if isinstance(record, (LineTrips, Faults)) and record.probability > 0.0]
        if self.line_sets and others:
            raise ValueError("Islandings exclude LineTrips and Faults, which open lines too")

    def draw(self, pick: Picker, draft: Draft) -> None:
        if self.line_sets:
            lines, time_s = pick.choice(self.line_sets), pick.instant(draft.window)
            draft.events += [_line_trip(time_s, line) for line in lines]


@dataclass(frozen=True, kw_only=True)
class UnitCommitment(Record):
    """The number of the generator's units on line follows from a loading."""

    generator_mva: float = required("MVA", "design", "rating of all units of the generator", 1.0, 1e5)
    loading: Span = required("-", "design", "load that the wind leaves, over the rating of units on line", 0.05, 1.0)
    constant_mw: float = design(0.0, "MW", "what machines without a governor give", 0.0, 1e6)

    def draw(self, pick: Picker, draft: Draft) -> None:
        draft.machine_loading = pick.between(self.loading)

    def committed(self, draft: Draft, first_winds: Sequence[float]) -> float:
        """Return the share of the generator's units on line, for the load that the wind leaves on average and at first.

        If all units are too few at the drawn loading, they are loaded more.
        """
        assert draft.machine_loading is not None
        winds = (draft.mean_winds_m_s, first_winds)
        least = min(wind.share_of_load(speeds, draft.n_turbines, draft.load_mw) for speeds in winds)
        needed_mw = (1.0 + LOSSES - least) * draft.load_mw - self.constant_mw
        return min(max(needed_mw / (draft.machine_loading * self.generator_mva), LEAST_COMMITTED), 1.0)


#: The delay is drawn from whole numbers of these [s].
DELAY_STEP_S = 0.1
#: A drawn bias lies within this many standard deviations.
_MOST_DEVIATIONS = 2.5


@dataclass(frozen=True, kw_only=True)
class SensorDistribution(Checked):
    """Distribution of the sensors' errors; a value without a meaning of its own is that of every run's `Sensors`."""

    delay_s: tuple[float, float] = design(
        (0.1, 0.3), "s", "whole numbers of 0.1 s; every one between is as likely", 0.0, DELAY_MAX_S
    )
    frequency_filter_s: float = 0.1
    frequency_noise_hz: float = 0.005
    rocof_filter_s: float = 0.2
    rocof_noise_hz_s: float = 0.05
    rotor_speed_noise_pu: float = 0.003
    power_noise_pu: float = 0.01
    wind_bias: float = design(0.01, "-", "standard deviation of each group's; at most 2.5 times this", 0.0, 0.2)
    wind_noise: float = 0.01
    wind_noise_correlation_s: float = 3.0
    wind_sensor: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if any(abs(delay / DELAY_STEP_S - round(delay / DELAY_STEP_S)) > 1e-6 for delay in self.delay_s):
            raise ValueError(f"delay_s must be whole numbers of {DELAY_STEP_S:g} s, got {self.delay_s} s")
        # Checks the values that are the same in every scenario.
        Sensors(**{**vars(self), "seed": 0, "delay_s": 0.0, "wind_bias": (0.0,)})

    def delays_s(self) -> list[float]:
        """Return every delay that may be drawn [s]."""
        shortest, longest = (round(delay / DELAY_STEP_S) for delay in self.delay_s)
        return [round(DELAY_STEP_S * steps, 9) for steps in range(shortest, longest + 1)]

    def draw_many(self, name: str, seeds: Sequence[int], n_wtg: int) -> list[Sensors]:
        """Draw the sensors of seeds; `name` is that of the scenarios' distribution. Biases scale with `wind_bias`."""
        streams = seed_streams(seeds, zlib.crc32(f"{name}/sensors".encode()))
        uniform = np.array([stream.random(2 + 12 * n_wtg) for stream in streams]).reshape(len(seeds), 2 + 12 * n_wtg)
        delays = self.delays_s()
        # The sum of twelve uniform numbers is nearly normal; platforms agree on its last bit.
        deviations = uniform[:, 2:].reshape(len(seeds), n_wtg, 12).sum(axis=2) - 6.0
        biases = self.wind_bias * np.clip(deviations, -_MOST_DEVIATIONS, _MOST_DEVIATIONS)
        shared = {name: value for name, value in vars(self).items() if name not in ("delay_s", "wind_bias")}
        return [
            trusted(
                Sensors,
                **shared,
                seed=int(numbers[0] * 2**31),
                delay_s=delays[int(numbers[1] * len(delays))],
                wind_bias=tuple(bias),
            )
            for numbers, bias in zip(uniform.tolist(), biases.tolist(), strict=True)
        ]
