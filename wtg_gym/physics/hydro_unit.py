"""The governor HYGOV, whose equations are in :mod:`wtg_gym.physics.governor`, as a unit."""

from __future__ import annotations

from wtg_gym.physics.governor import HydroState, hydro_constants, hydro_limited, hydro_rates, hydro_start
from wtg_gym.physics.machine_controls import governor

HYGOV = governor(hydro_constants, HydroState, hydro_rates, hydro_start, "hydro_gate", hydro_limited)
HYDRO = HYGOV.kind
