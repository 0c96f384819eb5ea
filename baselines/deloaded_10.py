"""Fixed deloading by 10 % with plain droop.

    P_st = K_d ω_m³,    K_d = K_opt (λ_opt / λ_d)³ (1 - d),    d = 0.10

λ_d > λ_opt is the tip-speed ratio of an over-speeding rotor that captures the share 1 - d of the available power.
The reserve lasts longer than with 5 %, at the price of energy: in calm operation twice as much is given up, and a rise
of the frequency drives the rotor faster than need be.
"""

from wtg_gym.evaluation import Entry
from wtg_gym.physics.tracking_law import deloaded

from . import COORDINATED_SOURCE, DELOADED_SOURCE

ENTRY = Entry(
    name="deloaded-10",
    strategy=deloaded(0.10),
    description="10 % below the available power at nominal frequency, with plain droop.",
    equation="P_st = K_d ω_m³, K_d = K_opt (λ_opt/λ_d)³ (1 - 0.10)",
    source=f"{DELOADED_SOURCE}; {COORDINATED_SOURCE}, frequency dynamics with deloading",
)
