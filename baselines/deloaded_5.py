"""Fixed deloading by 5 % with plain droop.

    P_st = K_d ω_m³,    K_d = K_opt (λ_opt / λ_d)³ (1 - d),    d = 0.05

λ_d > λ_opt is the tip-speed ratio of an over-speeding rotor that captures the share 1 - d of the available power.
Little power is given up, and little is in reserve: a large fall of the frequency takes the rotor past the top of the
power curve, where it behaves as with maximum power point tracking.
"""

from wtg_gym.evaluation import Entry
from wtg_gym.physics.tracking_law import deloaded

from . import COORDINATED_SOURCE, DELOADED_SOURCE

ENTRY = Entry(
    name="deloaded-5",
    strategy=deloaded(0.05),
    description="5 % below the available power at nominal frequency, with plain droop.",
    equation="P_st = K_d ω_m³, K_d = K_opt (λ_opt/λ_d)³ (1 - 0.05)",
    source=f"{DELOADED_SOURCE}; {COORDINATED_SOURCE}, frequency dynamics with deloading",
)
