"""The share of the load of the modified IEEE 14-bus system that turbines cover in a wind."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

from wtg_gym.physics.aerodynamics import available_power_pu
from wtg_gym.physics.ieee14 import modified_ieee14
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters


def share_of_load(mean_winds: Sequence[float], turbines: Sequence[float], load_level: float) -> float:
    """Return the share of the nominal load times `load_level` that turbines at nominal reserve cover.

    Args:
        mean_winds: of each WTG group [m/s].
        turbines: number in each group.
        load_level: factor on the loads of the modified IEEE 14-bus system.
    """
    turbine_mw, per_cubic_wind, load_mw = _share_constants()
    given_mw = (
        n * turbine_mw * min(per_cubic_wind * wind**3, 1.0) for n, wind in zip(turbines, mean_winds, strict=True)
    )
    return sum(given_mw) / (load_level * load_mw)


@lru_cache(maxsize=1)
def _share_constants() -> tuple[float, float, float]:
    """Return a turbine's power at nominal reserve [MW], its available power at 1 m/s [p.u.] and the load [MW]."""
    full, rated_mw = 1.0 - GridFormingParameters().deloading_nominal, TurbineParameters().rated_power_mw
    return rated_mw * full, float(available_power_pu(1.0)), sum(bus.load_mw for bus in modified_ieee14().buses)
