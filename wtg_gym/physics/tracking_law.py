"""Laws by name: the numbers that each gives the tracking law of :mod:`wtg_gym.physics.converter`.

A law's coefficients are those of a turbine and its control: K_opt belongs to the rotor, deloadings and τ to the
control. Wherever a function takes a `turbine` or a `control`, None is the paper's.
"""

import dataclasses
import functools
import logging
import math
import numbers
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from wtg_gym.files import interpreting, read_toml
from wtg_gym.names import check_name, plain_name
from wtg_gym.physics.aerodynamics import tracking_point
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.ranges import Checked, did_you_mean, require_known, require_range

_Turbine = TurbineParameters | None
_Control = GridFormingParameters | None
#: Smallest and largest tracking coefficient a law may ask for [p.u.]: nearly no power, and three times K_opt.
LEAST_COEFFICIENT, LARGEST_COEFFICIENT = 1e-3, 3.0
#: Damping time constants of a law besides 0 and ∞ [s]; a slower filter is plain droop for as long as an episode takes.
TIME_CONSTANT_RANGE = (0.05, 1e5)


class Tuning(NamedTuple):
    """How far k lies beyond that of the piecewise law, as shares of K_opt - K_pr [-], and τ."""

    above_opt: float  # K_opt, at ω_min
    above_nominal: float  # K_n, at ω_st
    below_limit: float  # K_pr, at ω_max
    time_constant_s: float  # [s]


#: The laws tuned to a grid that needs the wind; docs/studies/policies.py finds them. A law that asks for more than
#: K_opt slows the rotor past the top of its power curve: in the end it gives less the lower the frequency is.
TUNED: Mapping[str, Tuning] = MappingProxyType(
    {"coordinated-tuned": Tuning(0.0, -0.05, 1.0, 0.2), "coordinated-free": Tuning(0.55, -0.06, 1.0, 0.25)}
)

#: A smaller deloading in a law file is taken for a fraction that was meant [%].
_LEAST_PERCENT = 0.5


@dataclass(frozen=True, kw_only=True)
class TrackingLaw(Checked):
    """A control law as data. A ValueError says that a coefficient or τ is outside its range, or the name is none."""

    name: str  # short, used in tables; see :func:`~wtg_gym.names.check_name`
    k_min: float  # tracking coefficient at ω_min and below [p.u.]
    k_nominal: float  # at ω_st [p.u.]
    k_max: float  # at ω_max and above [p.u.]
    damping_time_constant_s: float = math.inf  # τ [s], 0.05 … 100000; 0 cancels the droop, infinity keeps it

    def __post_init__(self) -> None:
        # In place of the check of fields as such: an error names the law.
        check_name("the name of a law", self.name)
        for key in ("k_min", "k_nominal", "k_max"):
            name, k = f"{key} of law {self.name!r}", getattr(self, key)
            object.__setattr__(self, key, require_range(name, k, LEAST_COEFFICIENT, LARGEST_COEFFICIENT, "p.u."))
        tau = self.damping_time_constant_s
        low, high = TIME_CONSTANT_RANGE
        is_number = isinstance(tau, numbers.Real) and not isinstance(tau, bool)
        if not is_number or not (tau in (0.0, math.inf) or low <= tau <= high):
            raise ValueError(
                f"damping_time_constant_s of law {self.name!r} must be {low:g} … {high:g} s, 0 s (cancels the droop) "
                f"or infinite (keeps it), got {tau!r} s"
            )

    def to_dict(self) -> dict[str, str | float]:
        """Return the law as JSON-ready data; an infinite time constant is the text "inf"."""
        tau = self.damping_time_constant_s
        return {**dataclasses.asdict(self), "damping_time_constant_s": "inf" if math.isinf(tau) else tau}

    @property
    def inverse_time_constant(self) -> float:
        """Return 1/τ [1/s], 0 where the filter does nothing (τ = 0 or ∞)."""
        tau = self.damping_time_constant_s
        return 0.0 if tau == 0.0 or math.isinf(tau) else 1.0 / tau

    @property
    def droop_cancelled(self) -> float:
        """Return 1.0 where τ = 0, so that x = ω - ω_st, else 0.0."""
        return 1.0 if self.damping_time_constant_s == 0.0 else 0.0


#: The reference policy's strategy: zero action is exactly this.
REFERENCE_LAW = "coordinated-piecewise"
#: Deloadings d of the laws with one coefficient and plain droop: maximum power point tracking, and fixed deloaded laws
#: K_d (paper, equations (9) and (12)) [-].
_FIXED = {"mppt": 0.0, "deloaded-5": 0.05, "deloaded-10": 0.10}
#: Every law of the paper, and every built-in one.
_PAPER_NAMES = (*_FIXED, "coordinated-linear", REFERENCE_LAW, "coordinated-undamped")
LAW_NAMES = (*_PAPER_NAMES, *TUNED)


@functools.lru_cache(maxsize=64)
def _law(name: str, turbine: _Turbine, control: _Control) -> TrackingLaw:
    """Return a built-in law for a turbine and its control.

    The reference is K_opt / K_n / K_pr with transient damping (paper, equations (35)-(37)). "coordinated-linear" has
    the straight g(ω) from K_opt to K_pr (equation (21)), "coordinated-undamped" cancels the droop (equation (33)).
    Those of :data:`TUNED` were tuned with the paper's turbine: on one with a flatter power curve k ends where a law's
    range does.
    """
    if name in _FIXED:
        k = tracking_point(_FIXED[name], turbine).coefficient
        return TrackingLaw(name=name, k_min=k, k_nominal=k, k_max=k)
    p = control or GridFormingParameters()
    deloadings, tau = (0.0, p.deloading_nominal, p.deloading_limit), p.damping_time_constant_s
    low, nominal, high = (tracking_point(deloading, turbine).coefficient for deloading in deloadings)
    if name == "coordinated-linear":
        share = (p.frequency_setpoint_pu - p.frequency_min_pu) / (p.frequency_max_pu - p.frequency_min_pu)
        nominal = low + share * (high - low)
    elif name == "coordinated-undamped":
        tau = 0.0
    elif name in TUNED:
        tuning, span = TUNED[name], low - high
        moved = low + tuning.above_opt * span, nominal + tuning.above_nominal * span, high - tuning.below_limit * span
        low, nominal, high = (min(max(k, LEAST_COEFFICIENT), LARGEST_COEFFICIENT) for k in moved)
        tau = tuning.time_constant_s
    return TrackingLaw(name=name, k_min=low, k_nominal=nominal, k_max=high, damping_time_constant_s=tau)


#: The paper's laws for the paper's turbine; :func:`get_law` makes any built-in one, for any turbine.
LAWS: Mapping[str, TrackingLaw] = MappingProxyType({name: _law(name, None, None) for name in _PAPER_NAMES})


def get_law(strategy: str | Path | TrackingLaw, turbine: _Turbine = None, control: _Control = None) -> TrackingLaw:
    """Return a law by name, for a turbine and its control, or from a TOML file, or as given.

    A ValueError says that none has that name, and lists the known ones.
    """
    if isinstance(strategy, TrackingLaw):
        return strategy
    if str(strategy).endswith(".toml"):
        return read_law(Path(strategy), turbine)
    if not isinstance(strategy, str) or strategy not in LAW_NAMES:
        raise ValueError(
            f"unknown strategy {str(strategy)!r}; known laws: {', '.join(LAW_NAMES)}, or a .toml file with "
            f"a law; other entries play in `wtg-gym evaluate`{did_you_mean(strategy, LAW_NAMES)}"
        )
    return _law(strategy, turbine, control)


def group_laws(
    strategies: str | Path | TrackingLaw | Sequence[str | Path | TrackingLaw],
    turbines: Sequence[TurbineParameters],
    control: _Control = None,
) -> tuple[TrackingLaw, ...]:
    """Return one law per WTG group, (n_groups,), for its turbine: the given one for all, or the one given for each.

    A ValueError says that a law is unknown, or there are not as many as groups.
    """
    if isinstance(strategies, (str, Path, TrackingLaw)):
        return tuple(get_law(strategies, turbine, control) for turbine in turbines)
    if not isinstance(strategies, Sequence):
        raise ValueError(f"strategy must be a name or a list of names, got {strategies!r}")
    if len(strategies) != len(turbines):
        raise ValueError(
            f"strategy must name one law, or one for each of the {len(turbines)} groups, got {len(strategies)}"
        )
    return tuple(get_law(strategy, turbine, control) for strategy, turbine in zip(strategies, turbines, strict=True))


def read_law(path: Path, turbine: _Turbine = None) -> TrackingLaw:
    """Read a law from TOML: `name`, then either k_min, k_nominal, k_max [p.u.] or deloading_min, … [%], and tau_s [s].

    Deloadings are those of the turbine. A ValueError says that the file is missing, not TOML, or a key or value is not
    allowed.
    """
    data = read_toml(path, "law file")
    corners = ("min", "nominal", "max")
    known = ["name", "tau_s", *(f"{quantity}_{corner}" for quantity in ("k", "deloading") for corner in corners)]
    with interpreting(path, "law file"):
        require_known("keys", data, known)
        coefficients = {f"k_{corner}": _coefficient(data, corner, turbine) for corner in corners}
        name = data.get("name", path.stem)
        if isinstance(name, str) and plain_name(name) in map(plain_name, LAW_NAMES):
            raise ValueError(f"name {name!r} is, or looks like, that of a built-in law; choose another")
        law = TrackingLaw(name=name, damping_time_constant_s=data.get("tau_s", math.inf), **coefficients)
    # Laws with one k may differ by rounding.
    if max(law.k_nominal - law.k_min, law.k_max - law.k_nominal) > 1e-6:
        shown = ", ".join(f"{key} = {k:g} p.u." for key, k in coefficients.items())
        message = "%s: k rises with the frequency (%s); k_min is that at the lowest, the largest of a usual law"
        logging.getLogger("wtg_gym").warning(message, path, shown)
    return law


def _coefficient(data: Mapping[str, Any], corner: str, turbine: _Turbine) -> float:
    """Return the tracking coefficient that a law file gives at a corner, itself or by a deloading [p.u.]."""
    keys = [key for key in (f"k_{corner}", f"deloading_{corner}") if key in data]
    if len(keys) != 1:
        raise ValueError(
            f"it must give exactly one of k_{corner} [p.u.] and deloading_{corner} [%], got {keys or 'neither'}"
        )
    value: float = data[keys[0]]
    if keys[0].startswith("k"):
        return value
    percent = require_range(keys[0], value, 0.0, 90.0, "%")
    if 0.0 < percent < _LEAST_PERCENT:
        raise ValueError(
            f"{keys[0]} = {percent:g} is in percent: write {100.0 * percent:g} for {100.0 * percent:g} %; "
            f"allowed: 0, or {_LEAST_PERCENT:g} … 90 %"
        )
    return tracking_point(percent / 100.0, turbine).coefficient
