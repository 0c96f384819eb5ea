"""Coordinated regulation tuned to a grid that needs the wind: the score's hundred in version v1.

    P_st = g(ω) ω_m³ + D_p x,    τ ẋ = (ω - ω_st) - x,    τ = 0.6 s
    g piecewise linear through (ω_min, K_opt + a S), (ω_st, K_n + b S), (ω_max, K_pr - c S), constant outside
    S = K_opt - K_pr,    a = 1.52,    b = 0.017,    c = 1.05

The law of the paper with the benchmark's own numbers, tuned on training scenarios. g is steeper: below ω_min it asks
for more than the turbine captures for long, and takes the rest from the rotor. The filter is faster, so that the droop
leaves the steady state to g sooner.
"""

from wtg_gym.evaluation import Entry
from wtg_gym.physics.tracking_law import coordinated_tuned

from . import COORDINATED_SOURCE

ENTRY = Entry(
    name="coordinated-tuned",
    strategy=coordinated_tuned(),
    description="The piecewise law with steeper slopes and a faster filter, tuned to a grid that needs the wind.",
    equation="P_st = g(ω) ω_m³ + D_p x, g piecewise linear in ω",
    source=f"{COORDINATED_SOURCE}, equation of the augmented g(ω), with other numbers",
)
