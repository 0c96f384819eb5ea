"""Maximum power point tracking with plain droop: the score's zero in version v0.

    P_st = K_opt ω_m³,    2H ω̇ = P_st - p - D_p (ω - ω_st)

At K_opt the rotor sits on the top of the power curve and holds no reserve. When the frequency falls, the droop takes
energy from the rotor, the slower rotor captures less, and in the end the turbine gives less than before, or stalls.
"""

from wtg_gym.evaluation import Entry
from wtg_gym.physics.tracking_law import mppt

from . import COORDINATED_SOURCE

ENTRY = Entry(
    name="mppt",
    strategy=mppt(),
    description="Maximum power point tracking with plain droop; no reserve.",
    equation="P_st = K_opt ω_m³",
    source=f"{COORDINATED_SOURCE}, frequency dynamics with maximum power point tracking",
)
