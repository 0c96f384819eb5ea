"""Coordinated regulation with a prescribed reserve at nominal frequency: the reference, the paper's law.

    P_st = g(ω) ω_m³ + D_p x,    τ ẋ = (ω - ω_st) - x,    τ = 0.8 s
    g piecewise linear through (ω_min, K_opt), (ω_st, K_n), (ω_max, K_pr), constant outside

K_n is the coefficient of 5 % deloading, K_pr that of 10 %: 5 % of the available power are ready upwards and downwards.
Zero action of the environment, with its default strategy, is exactly this law. It is the score's hundred in version v0
and its zero in v1.
"""

from wtg_gym.evaluation import Entry
from wtg_gym.physics.tracking_law import coordinated_piecewise

from . import COORDINATED_SOURCE

ENTRY = Entry(
    name="coordinated-piecewise",
    strategy=coordinated_piecewise(),
    description="The reference: k passes through K_opt, K_n and K_pr; transient damping.",
    equation="P_st = g(ω) ω_m³ + D_p x, g piecewise linear in ω",
    source=f"{COORDINATED_SOURCE}, equation of the augmented g(ω)",
)
