"""The conventional control laws, in the order of the paper, and feedbacks designed by hand.

A law is P_st = k ω_m³ + D_p x with k = g(ω), see :mod:`wtg_gym.physics.tracking_law`; zero action leaves it unchanged.
Each law is an entry here; a feedback is a module with an `ENTRY`. `wtg_gym.evaluation.load_entries("baselines")` finds
them. Your own law needs no module but a TOML file (`wtg-gym simulate --example-law`).
"""

from wtg_gym.evaluation import Entry
from wtg_gym.physics.tracking_law import get_law

#: The source of the coordinated laws.
COORDINATED_SOURCE = (
    "M. Chen, Y. Xi, L. Cheng, F. Dörfler, I. Lestas, "
    '"Coordinated Primary Frequency Regulation and Grid-Forming Control for Wind Turbine Generators"'
)
#: The source of deloaded operation with grid-forming control.
DELOADED_SOURCE = "X. Lyu, D. Groß, IEEE Trans. Sustain. Energy 15(1), 2024"


def _baseline(name: str, description: str, source: str) -> Entry:
    return Entry(name=name, strategy=get_law(name), description=description, source=source)


#: The reference at 0 in version v0: P_st = K_opt ω_m³ in 2H ω̇ = P_st - p - D_p (ω - ω_st). At K_opt the rotor sits on
#: the top of the power curve. When the frequency falls, the droop takes energy from the rotor, the slower rotor
#: captures less, and in the end the turbine gives less than before, or stalls.
MPPT = _baseline(
    "mppt",
    "Maximum power point tracking with plain droop; no reserve.",
    f"{COORDINATED_SOURCE}, frequency dynamics with maximum power point tracking",
)
#: λ_d > λ_opt is the tip-speed ratio of an over-speeding rotor that captures the share 1 - d of the available power.
#: With 5 % little power is given up, and little is in reserve: a large fall of the frequency takes the rotor past the
#: top of the power curve, where it behaves as with maximum power point tracking.
DELOADED_5 = _baseline(
    "deloaded-5",
    "5 % below the available power at nominal frequency, with plain droop.",
    f"{DELOADED_SOURCE}; {COORDINATED_SOURCE}, frequency dynamics with deloading",
)
#: The reserve lasts longer than with 5 %, at the price of energy: in calm operation twice as much is given up, and a
#: rise of the frequency drives the rotor faster than need be.
DELOADED_10 = _baseline(
    "deloaded-10",
    "10 % below the available power at nominal frequency, with plain droop.",
    f"{DELOADED_SOURCE}; {COORDINATED_SOURCE}, frequency dynamics with deloading",
)
#: The droop of this law and the next acts on fast changes only (transient damping): τ ẋ = (ω - ω_st) - x, τ = 0.8 s.
#: At ω_min the turbine reaches its best point, at ω_max the deloading limit of 10 %, whatever the wind. How much
#: reserve it holds at ω_st follows from the line and is not prescribed.
COORDINATED_LINEAR = _baseline(
    "coordinated-linear",
    "k falls on a straight line from K_opt at ω_min to K_pr at ω_max; transient damping.",
    f"{COORDINATED_SOURCE}, equation of the linear g(ω)",
)
#: The paper's law: g through (ω_min, K_opt), (ω_st, K_n), (ω_max, K_pr), constant outside. K_n is the coefficient of
#: 5 % deloading, K_pr that of 10 %: 5 % of the available power are ready upwards and downwards. Zero action of the
#: environment, with its default `strategy`, is exactly this law. It scores 100 in v0 and 0 in v1.
COORDINATED_PIECEWISE = _baseline(
    "coordinated-piecewise",
    "The reference: k passes through K_opt, K_n and K_pr; transient damping.",
    f"{COORDINATED_SOURCE}, equation of the augmented g(ω)",
)
#: The droop cancels altogether, 2H ω̇ = g(ω) ω_m³ - p, so that only g(ω) regulates. That leaves little damping of fast
#: swings: the reason for the filter in the reference.
COORDINATED_UNDAMPED = _baseline(
    "coordinated-undamped",
    "The reference's g(ω) without any droop: fast swings are hardly damped.",
    f"{COORDINATED_SOURCE}, open loop of the proposed law",
)
#: The reference at 100 in version v1: the piecewise law tuned to a grid that needs the wind, on training scenarios. g
#: still begins at K_opt, so that no steady state gives less power at a lower frequency. It ends far below K_pr, and the
#: filter is faster, so that g takes over from the droop sooner.
COORDINATED_TUNED = _baseline(
    "coordinated-tuned",
    "The piecewise law tuned to a grid that needs the wind; k is never beyond K_opt.",
    f"{COORDINATED_SOURCE}, equation of the augmented g(ω), with other numbers",
)
#: The same, tuned without the bound at K_opt: below ω_st it soon asks for more than the turbine captures for long, and
#: takes the rest from the rotor.
COORDINATED_FREE = _baseline(
    "coordinated-free",
    "The tuned law without the bound: k passes beyond K_opt.",
    f"{COORDINATED_SOURCE}, equation of the augmented g(ω), with other numbers",
)

_LAWS = (MPPT, DELOADED_5, DELOADED_10, COORDINATED_LINEAR, COORDINATED_PIECEWISE)
#: Baselines of each version, in the order of tables: entries, and names of modules with one. A law plays in every
#: version. The effects that v1's show:
#:
#: - mppt, deloaded-5, deloaded-10: plain droop;
#: - coordinated-linear, coordinated-piecewise: the published law;
#: - coordinated-tuned: three numbers of that law;
#: - coordinated-free: kinetic energy borrowed beyond K_opt;
#: - fast-droop: one gain on a group's own frequency;
#: - distilled-law: six numbers of what a planner does.
ORDER = {
    "v0": (*_LAWS, COORDINATED_UNDAMPED, "tip_speed_feedback"),
    "v1": (*_LAWS, COORDINATED_TUNED, COORDINATED_FREE, "fast_droop", "distilled_law"),
}
