"""Records of parameters that check themselves: unit, source, meaning and range are data of each field."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from typing import Any, get_args, get_origin, get_type_hints

from wtg_gym.ranges import require_bus, require_range

#: What the short keys in each field's `source` stand for.
SOURCES = {
    "paper": "Chen, Xi, Cheng, Dörfler, Lestas: Coordinated Primary Frequency Regulation and Grid-Forming Control "
    "for Wind Turbine Generators (2026): table of parameters, equation of C_p, case studies",
    "inferred": "the only round set found that meets λ_opt, C_popt, λ_n and λ_pr of the paper's table to every "
    "printed digit; the paper prints no c_1 … c_6",
    "Heier": "S. Heier: Grid Integration of Wind Energy, the exponential C_p form and its pitch term",
    "Milano": "F. Milano: IEEE 14-bus dynamic data as distributed with PSAT (d_014_dyn_l14)",
    "IEEE 14": "IEEE 14-bus power-flow test case, University of Washington archive; the same numbers as MATPOWER's "
    "case14. Voltages of machine buses are its scheduled ones",
    "NREL 5 MW": "J. Jonkman et al.: Definition of a 5-MW Reference Wind Turbine, NREL/TP-500-38060 (2009)",
    "calibrated": "chosen so that the paper's settled frequency (0.996 p.u.) and the final power of WTG 2 below 0.3 "
    "p.u. both come out",
    "ENTSO-E": "Commission Regulation (EU) 2016/631 (requirements for generators), article 13, continental Europe; "
    "voltages: article 16",
    "REGFM_A1": "W. Du et al.: Model Specification of Droop-Controlled, Grid-Forming Inverters (REGFM_A1), Pacific "
    "Northwest National Laboratory, PNNL-32278 (2021), approved by WECC",
    "ENTSO-E defence": "Commission Regulation (EU) 2017/2196 (emergency and restoration), annex: automatic low "
    "frequency demand disconnection, continental Europe",
    "FERC 827": "Federal Energy Regulatory Commission, Order 827 (2016): reactive power requirements for "
    "non-synchronous generation",
    "HYGOV": "typical data of the hydro governor HYGOV of PSS/E; P. Kundur: Power System Stability and Control, 9.1",
    "design": "a design value of this benchmark",
}


def describe(unit: str, source: str, doc: str) -> dict[str, Any]:
    """Return a field's metadata: its unit, the key of its source in SOURCES, and what it is."""
    return {"unit": unit, "source": source, "doc": doc}


def parameter(default: Any, unit: str, source: str, doc: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """Return a dataclass field with a default value, :func:`describe`'s metadata and its allowed range."""
    return dataclasses.field(default=default, metadata={**describe(unit, source, doc), "low": low, "high": high})


def required(unit: str, source: str, doc: str, low: float = -math.inf, high: float = math.inf) -> Any:
    """Return a dataclass field like that of :func:`parameter`, without a default value."""
    return dataclasses.field(metadata={**describe(unit, source, doc), "low": low, "high": high})


@functools.cache
def _kinds(record: Any) -> dict[str, Any]:
    return get_type_hints(record)


class Checked:
    """A dataclass whose fields are checked when it is made: their types, and the ranges that :func:`parameter` gives.

    Whole numbers are bus numbers.

    Raises:
        ValueError: the message names field, value, unit and allowed range.
    """

    def __post_init__(self) -> None:
        record: Any = type(self)
        for field in dataclasses.fields(record):
            name, value = f"{record.__name__}.{field.name}", getattr(self, field.name)
            kind = _kinds(record)[field.name]
            if kind is float or (kind == float | None and value is not None):
                if "low" in field.metadata:
                    unit = field.metadata["unit"].removeprefix("-")
                    require_range(name, value, field.metadata["low"], field.metadata["high"], unit)
            elif kind is int:
                require_bus(name, value)
            elif get_origin(kind) is tuple:
                entry = get_args(kind)[0]
                if not isinstance(value, (tuple, list)) or not all(isinstance(item, entry) for item in value):
                    raise ValueError(f"{name} must be a tuple of {entry.__name__}, got {value!r}")
            elif not isinstance(value, kind):
                raise ValueError(f"{name} must be {field.type}, got {value!r}")

    def _require_order(self, *names: str) -> None:
        """Refuse fields whose values do not rise from each one to the next."""
        values = [getattr(self, name) for name in names]
        if any(not first < second for first, second in itertools.pairwise(values)):
            given = ", ".join(f"{value:g}" for value in values)
            raise ValueError(f"{type(self).__name__}: {' < '.join(names)} must hold, got {given}")
