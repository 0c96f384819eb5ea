"""Coordinated regulation on one straight line.

    P_st = g(ω) ω_m³ + D_p x,    τ ẋ = (ω - ω_st) - x,    τ = 0.8 s
    g(ω) = K_pr + (K_opt - K_pr) (ω_max - ω) / (ω_max - ω_min) in ω_min … ω_max, constant outside

At ω_min the turbine reaches its best point, at ω_max the deloading limit of 10 %, whatever the wind. How much reserve
it holds at ω_st follows from the line and is not prescribed. The droop acts on fast changes only (transient damping).
"""

from wtg_gym.evaluation import Entry
from wtg_gym.physics.tracking_law import coordinated_linear

from . import COORDINATED_SOURCE

ENTRY = Entry(
    name="coordinated-linear",
    strategy=coordinated_linear(),
    description="k falls on a straight line from K_opt at ω_min to K_pr at ω_max; transient damping.",
    equation="P_st = g(ω) ω_m³ + D_p x, g linear in ω",
    source=f"{COORDINATED_SOURCE}, equation of the linear g(ω)",
)
