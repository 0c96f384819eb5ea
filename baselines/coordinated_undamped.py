"""Coordinated regulation without transient damping.

    P_st = g(ω) ω_m³ + D_p (ω - ω_st),    2H ω̇ = P_st - p - D_p (ω - ω_st) = g(ω) ω_m³ - p

The droop cancels altogether, so that only g(ω) regulates. That leaves little damping of fast swings: the reason for
the filter in the reference.
"""

from wtg_gym.evaluation import Entry
from wtg_gym.physics.tracking_law import coordinated_undamped

from . import COORDINATED_SOURCE

ENTRY = Entry(
    name="coordinated-undamped",
    strategy=coordinated_undamped(),
    description="The reference's g(ω) without any droop: fast swings are hardly damped.",
    equation="P_st = g(ω) ω_m³ + D_p (ω - ω_st), g piecewise linear in ω",
    source=f"{COORDINATED_SOURCE}, open loop of the proposed law",
)
