"""The NREL 5 MW reference turbine as data: a rotor from its C_p table instead of the paper's curve."""

from __future__ import annotations

import functools
from pathlib import Path

from wtg_gym.physics.parameters import TurbineParameters
from wtg_gym.physics.rotor_table import read_rotor_table

#: C_p(λ, β); source and licence stand in the file.
ROTOR_TABLE = Path(__file__).with_name("tables") / "Cp.NREL5MW.txt"
#: Rotor with its hub and, on the low-speed side, generator: 38 759 228 + 97² · 534.116 kg m². The rotor's is that of
#: its blades about the shaft, 3 cos² 2.5° (11 776 047 + 2 · 1.5 · 363 231 + 1.5² · 17 740), and of the hub, 115 926.
#: Source: J. Jonkman et al., NREL/TP-500-38060, tables 1-1, 2-2, 4-1 and 5-1.
_INERTIA_KG_M2 = 38_759_228.0 + 97.0**2 * 534.116
_RATED_SPEED_RAD_S = 12.1 * 2.0 * 3.141592653589793 / 60.0


@functools.cache
def nrel_5mw(*, conserves_energy: bool = True) -> TurbineParameters:
    """Return the turbine: 5 MW, R = 63 m, 12.1 rpm, with its C_p table. Source: NREL/TP-500-38060."""
    return TurbineParameters(
        rated_power_mw=5.0,
        blade_radius_m=63.0,
        air_density_kg_m3=1.225,
        nominal_rotor_speed_rad_s=_RATED_SPEED_RAD_S,
        inertia_constant_s=0.5 * _INERTIA_KG_M2 * _RATED_SPEED_RAD_S**2 / 5e6,
        conserves_energy=conserves_energy,
        power_coefficient=read_rotor_table(ROTOR_TABLE),
    )
