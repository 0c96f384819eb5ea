"""What happens in one run, as plain data: wind, events, load noise and grid strength.

The simulator consumes a :class:`Scenario`; nothing in it is random any more. Scenarios are drawn, read
from CSV and collected in suites by :mod:`wtg_gym.scenarios`.
"""

import dataclasses
import json
import re
import types
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar, get_args

import numpy as np

from wtg_gym.files import parse_json
from wtg_gym.physics.parameters import MOST_GROUPS
from wtg_gym.physics.sensors import Sensors
from wtg_gym.ranges import Checked, design, did_you_mean, require_count, require_items, require_known, required
from wtg_gym.systems.programs import Floats

R = TypeVar("R")

#: Wind speeds the turbine model covers: cut-in and cut-out of the NREL 5 MW machine [m/s].
WIND_SPEED_RANGE = (3.0, 25.0)
#: Changes of load that one event or the load noise may bring, in MW or Mvar.
LOAD_CHANGE_RANGE = (-1e4, 1e4)
#: Latest instant of an event, and longest run: a day [s].
LONGEST_RUN_S = 86400.0
#: Events of one run at most.
MOST_EVENTS = 200
#: Step of every random wind and load-noise series [s].
SERIES_DT = 0.1


def _series(name: str, values: Any) -> Floats:
    try:
        code = np.asarray(values).dtype.kind
        series = np.array(values, dtype=np.float64) if code != "c" else np.zeros(0)
        # numpy would convert "8" and drop imaginary parts without a word.
        if code in "USbc" and np.size(values):
            raise ValueError(f"got {np.ravel(values)[:3].tolist()}")
        series.setflags(write=False)
        return series
    except (OverflowError, TypeError, ValueError) as error:
        raise ValueError(f"{name} must be numbers in a regular array: {error}") from error


def _require_within(name: str, series: Floats, dt_s: float, allowed: tuple[float, float], unit: str) -> None:
    """Refuse a series with a value outside the allowed range; the first one is named with its instant."""
    low, high = allowed
    for sample in np.flatnonzero(~((series >= low) & (series <= high))):
        raise ValueError(
            f"{name} at t = {sample * dt_s:g} s is {series[sample]:g} {unit}, outside the allowed range "
            f"{low:g} … {high:g} {unit}"
        )


def _checked_wind(values: Any, dt_s: float) -> Floats:
    wind = _series("wind_speed", values)
    if wind.ndim == 2:
        require_count("wind_speed", len(wind), MOST_GROUPS)
    if wind.ndim != 2 or wind.shape[1] < 1:
        form = "wind_speed must have shape (n_wtg, n_samples)"
        raise ValueError(f"{form}, got shape {wind.shape}; for constant wind write [[11.0], [9.0]]")
    for group, series in enumerate(wind, start=1):
        _require_within(f"wind_speed of group {group}", series, dt_s, WIND_SPEED_RANGE, "m/s")
    return wind


def _checked_noise(values: Any) -> Floats:
    noise = _series("load_noise_mw", values)
    if noise.ndim != 1:
        raise ValueError(f"load_noise_mw must have shape (n_samples,), got shape {noise.shape}")
    _require_within("load_noise_mw", noise, SERIES_DT, LOAD_CHANGE_RANGE, "MW")
    if noise.size and noise[0] != 0.0:
        raise ValueError(f"load_noise_mw must start at 0 MW, got {noise[0]:g} MW")
    return noise


def trusted(record: type[R], **values: Any) -> R:
    """Return an event or a scenario made of all its values, unchecked and uncopied.

    For values drawn from ranges that were checked: checking each of them again takes longer than to draw it.
    """
    made = object.__new__(record)
    made.__dict__.update(values)
    return made


@dataclass(frozen=True, kw_only=True)
class _At(Checked):
    """Something that happens at `time_s` [s]."""

    #: The event in words: of itself, of its circuit, and of how long it lasts.
    WORDS: ClassVar[str]
    #: The field that says after how long it is complete.
    LASTS: ClassVar[str] = ""

    time_s: float = required("s", "design", "instant of the event", 0.0, LONGEST_RUN_S)

    @property
    def end_s(self) -> float:
        """When the event is over, or the line closes again [s]."""
        return self.time_s + (getattr(self, self.LASTS, None) or 0.0)

    @property
    def words(self) -> str:
        """The event in words, with its units, without its instant; WTG groups count from 1."""
        circuit = getattr(self, "circuit", None)
        of_several = "" if circuit is None else f" (circuit {circuit})"
        lasts_s = getattr(self, self.LASTS, None)
        lasts = "" if lasts_s is None else f" for {lasts_s:g} s"
        return self.WORDS.format(self, of_several=of_several, lasts=lasts).replace("-", "−")


@dataclass(frozen=True, kw_only=True)
class _AtBus(_At):
    """Something that happens at a bus of the network, at `time_s` [s]."""

    bus: int


@dataclass(frozen=True, kw_only=True)
class LoadStep(_AtBus):
    """A constant-impedance load switched on at a bus (negative power: switched off).

    The admittance is (P - jQ)/V0² with V0 the bus voltage of the initial power flow.
    """

    power_mw: float = required("MW", "design", "active power at V0", *LOAD_CHANGE_RANGE)
    reactive_mvar: float = design(0.0, "Mvar", "reactive power at V0", *LOAD_CHANGE_RANGE)

    @property
    def words(self) -> str:
        reactive = f", {self.reactive_mvar:+g} Mvar" if self.reactive_mvar else ""
        return f"{self.power_mw:+g} MW{reactive}".replace("-", "−") + f" at bus {self.bus}"


@dataclass(frozen=True, kw_only=True)
class LoadRamp(LoadStep):
    """A :class:`LoadStep` that grows linearly over `duration_s` [s] from `time_s` on."""

    LASTS = "duration_s"

    duration_s: float = required("s", "design", "length of the ramp", 0.1, 3600.0)

    @property
    def words(self) -> str:
        return f"{super().words} over {self.duration_s:g} s"


@dataclass(frozen=True, kw_only=True)
class LoadTrip(_AtBus):
    """The whole initial load of a bus is disconnected at `time_s` [s]."""

    WORDS = "load of bus {0.bus} lost"


def _circuit() -> Any:
    doc = "which of parallel lines, counted from 1 in the order of the case; None: the first"
    return design(None, "-", doc, 1, 99)


@dataclass(frozen=True, kw_only=True)
class LineTrip(_At):
    """The branch between two buses opens at both ends at `time_s` [s]."""

    WORDS, LASTS = "line {0.from_bus}–{0.to_bus}{of_several} opens{lasts}", "recloses_after_s"

    from_bus: int
    to_bus: int
    recloses_after_s: float | None = design(
        None, "s", "time after which it closes again; None: never", 1e-3, LONGEST_RUN_S
    )
    circuit: int | None = _circuit()


@dataclass(frozen=True, kw_only=True)
class Fault(_AtBus):
    """A three-phase fault at a bus from `time_s` [s] on; a line that clears it opens then and stays open."""

    WORDS, LASTS = "fault at bus {0.bus}{lasts}", "clears_after_s"

    clears_after_s: float = required("s", "design", "time until it is cleared", 1e-3, 10.0)
    resistance_pu: float = design(0.0, "p.u.", "resistance to ground, on the system base", 0.0, 1e3)
    reactance_pu: float = design(1e-4, "p.u.", "reactance to ground, on the system base", 1e-5, 1e3)
    opens: tuple[int, int] | None = None  # both ends of the line that clears it
    circuit: int | None = _circuit()

    def __post_init__(self) -> None:
        ends = self.opens
        if ends is not None:
            pair = isinstance(ends, (tuple, list)) and len(ends) == 2
            if not pair or not all(isinstance(end, (int, np.integer)) and not isinstance(end, bool) for end in ends):
                raise ValueError(f"opens must be the two buses of a line, got {ends!r}")
            # Either way round, as for every other line; the check of all fields takes a pair for a span.
            object.__setattr__(self, "opens", (min(ends), max(ends)))
        super().__post_init__()

    @property
    def words(self) -> str:
        if self.opens is None:
            return super().words
        circuit = "" if self.circuit is None else f" (circuit {self.circuit})"
        return f"{super().words}, then line {self.opens[0]}–{self.opens[1]}{circuit} opens"


@dataclass(frozen=True, kw_only=True)
class ReactanceStep(_At):
    """The impedance of the branch between two buses becomes `factor` times that of the case at `time_s` [s]."""

    WORDS = "impedance {0.from_bus}–{0.to_bus} × {0.factor:g}"

    from_bus: int
    to_bus: int
    factor: float = required("-", "design", "on resistance and reactance of the case", 1e-2, 1e3)
    circuit: int | None = _circuit()


@dataclass(frozen=True, kw_only=True)
class PhaseJump(_AtBus):
    """The angle of the imposed source at a bus jumps at `time_s` [s]."""

    WORDS = "source at bus {0.bus} jumps by {0.angle_deg:+g}°"

    angle_deg: float = required("deg", "design", "size, positive ahead", -180.0, 180.0)


@dataclass(frozen=True, kw_only=True)
class FrequencyRamp(_AtBus):
    """The frequency of the imposed source at a bus moves for `duration_s` [s] from `time_s` on, and stays there."""

    WORDS, LASTS = "source at bus {0.bus} moves at {0.rocof_hz_s:+g} Hz/s{lasts}", "duration_s"

    rocof_hz_s: float = required("Hz/s", "design", "rate of change", -100.0, 100.0)
    duration_s: float = required("s", "design", "length of the ramp", 1e-3, 3600.0)


@dataclass(frozen=True, kw_only=True)
class GovernorLoss(_AtBus):
    """The governors at a bus stop acting at `time_s` [s]: gates stay where they are, and droop no longer acts."""

    WORDS = "governor at bus {0.bus} lost"


@dataclass(frozen=True, kw_only=True)
class MachineOutage(_AtBus):
    """All synchronous machines, or else the imposed source, at a bus are disconnected at `time_s` [s]."""

    WORDS = "machine at bus {0.bus} disconnected"


@dataclass(frozen=True, kw_only=True)
class GroupTrip(_At):
    """A WTG group is disconnected at `time_s` [s]; the run goes on."""

    WORDS = "WTG group {0.number} disconnected"

    group: int = required("-", "design", "its index, the row of the scenario's wind", 0)

    @property
    def number(self) -> int:
        """Number of the group, counted from 1."""
        return self.group + 1


Event = (
    LoadStep
    | LoadRamp
    | LoadTrip
    | LineTrip
    | GovernorLoss
    | MachineOutage
    | GroupTrip
    | Fault
    | ReactanceStep
    | PhaseJump
    | FrequencyRamp
)
#: Events by the names of their kinds in data: LoadStep is "load_step".
EVENT_KINDS: dict[str, type[Any]] = {re.sub(r"\B(?=[A-Z])", "_", e.__name__).lower(): e for e in get_args(Event)}
_KIND_OF = {cls: kind for kind, cls in EVENT_KINDS.items()}


@dataclass(frozen=True, kw_only=True, eq=False)
class Scenario(Checked):
    """One run as data. A ValueError names a value that is missing, not finite or outside its range."""

    MOST = types.MappingProxyType({"events": MOST_EVENTS})

    name: str  # free text, used in tables and plots
    #: Rotor-effective wind per WTG group and sample, shape (n_wtg, n_samples) [m/s], n_wtg = 0 for a grid without any;
    #: linear between samples, the last one holds.
    wind_speed: Floats
    wind_dt_s: float = design(SERIES_DT, "s", "sampling step of wind_speed", 1e-3, 3600.0)
    duration_s: float = design(60.0, "s", "length of the run", 0.1, LONGEST_RUN_S)
    events: tuple[Event, ...] = ()  # in any order; those after the end of the run do not happen
    #: Extra resistive load at `load_noise_bus`, one value per `SERIES_DT` [MW], 0 after the last. The first value must
    #: be zero, so that the run starts in equilibrium.
    load_noise_mw: Floats = field(default_factory=lambda: np.zeros(0))
    load_noise_bus: int = 3
    load_level: float = design(1.0, "-", "factor on every load of the case in the initial power flow", 0.3, 1.5)
    governor_droop: float | None = design(None, "p.u.", "droop of every governor; None: the case's", 0.005, 1.0)
    inertia_scale: float = design(1.0, "-", "factor on the inertia of every synchronous machine", 0.05, 5.0)
    committed: float = design(1.0, "-", "share on line of the units of machines with a governor", 0.05, 1.0)
    sensors: Sensors | None = None  # errors of the WTG groups' measurements; None: exact and immediate
    #: The margin that it was drawn with; None for one that was made or changed, whose margin is computed.
    reserve_margin: float | None = field(default=None, init=False)
    seed: int | None = design(None, "-", "seed it was drawn from, if any", 0, 2**63 - 1)

    def __post_init__(self) -> None:
        super().__post_init__()
        for event in self.events:
            if type(event) not in _KIND_OF:
                raise ValueError(f"unknown event {event!r}; known kinds: {', '.join(EVENT_KINDS)}")
        wind = _checked_wind(self.wind_speed, self.wind_dt_s)
        if self.sensors is not None and len(self.sensors.wind_bias) != wind.shape[0]:
            raise ValueError(
                f"wind_bias of the sensors must have one number per WTG group ({wind.shape[0]}), "
                f"got {len(self.sensors.wind_bias)}"
            )
        object.__setattr__(self, "wind_speed", wind)
        object.__setattr__(self, "load_noise_mw", _checked_noise(self.load_noise_mw))

    @property
    def n_wtg(self) -> int:
        """Number of WTG groups the wind is given for."""
        return int(self.wind_speed.shape[0])

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as JSON-ready data; :meth:`from_dict` turns it back, without its reserve margin."""
        data = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        data["wind_speed"], data["load_noise_mw"] = self.wind_speed.tolist(), self.load_noise_mw.tolist()
        data["events"] = [
            {"kind": _KIND_OF[type(e)], **{key: value for key, value in vars(e).items() if value is not None}}
            for e in self.events
        ]
        if self.sensors is not None:
            data["sensors"] = {**vars(self.sensors), "wind_bias": list(self.sensors.wind_bias)}
        # Older scenarios know neither sensors nor commitment nor margin: their form, and its hash, stay.
        defaults = {"committed": 1.0, "reserve_margin": None, "sensors": None}
        return {key: value for key, value in data.items() if key not in defaults or value != defaults[key]}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "Scenario":
        """Build a scenario from :meth:`to_dict`'s form. A ValueError names unknown keys, event kinds or values."""
        fields = _known(cls, data, "scenario")
        # Of a scenario that was edited it would be another's.
        fields.pop("reserve_margin", None)
        if not isinstance(fields.get("events", ()), (list, tuple)):
            raise ValueError(f"events must be a list, got {data['events']!r:.80}")
        require_items(cls, "events", fields.get("events", ()))
        try:
            fields["events"] = tuple(_event_from_dict(event) for event in fields.get("events", ()))
            if fields.get("sensors") is not None:
                fields["sensors"] = Sensors(**_known(Sensors, fields["sensors"], "sensors"))
            return cls(**fields)
        except TypeError as error:
            raise ValueError(f"not a scenario: {error}") from error

    def to_json(self) -> str:
        """Return :meth:`to_dict` as one line of JSON."""
        return json.dumps(self.to_dict(), allow_nan=False)

    @classmethod
    def from_json(cls, text: str) -> "Scenario":
        """Read :meth:`to_json`'s form; a ValueError says what is wrong with the text."""
        return cls.from_dict(parse_json(text, "the text"))


def _known(record: Any, data: Any, what: str) -> dict[str, Any]:
    """Return the values of a record as a new dictionary, or raise a ValueError that names unknown ones."""
    if not isinstance(data, dict):
        raise ValueError(f"{what} must be an object with named values, got {data!r:.80}")
    require_known(f"{what} keys", data, [f.name for f in dataclasses.fields(record)])
    return dict(data)


def _event_from_dict(data: Any) -> Event:
    kind = data.get("kind") if isinstance(data, dict) else None
    if not isinstance(kind, str) or kind not in EVENT_KINDS:
        near = did_you_mean(kind, EVENT_KINDS) if kind else ""
        raise ValueError(f"an event needs a kind out of {', '.join(EVENT_KINDS)}, got {data!r:.80}{near}")
    fields = {key: value for key, value in data.items() if key != "kind"}
    event: Event = EVENT_KINDS[kind](**_known(EVENT_KINDS[kind], fields, kind))
    return event
