"""The conventional strategies, one small module each, in the order in which the paper leads from one to the next, and
feedbacks made by hand.

Every module holds an `ENTRY`; `wtg_gym.evaluation.load_entries("baselines")` finds them. A strategy is a tracking law
P_st = k ω_m³ + D_p x with k = g(ω), see :mod:`wtg_gym.physics.tracking_law`; zero action leaves it as it is.
A law of one's own needs no module: `example_law.toml` shows the file that does.
"""

_LAWS = ("mppt", "deloaded_5", "deloaded_10", "coordinated_linear", "coordinated_piecewise")
#: Modules with an entry by the version of the benchmark whose baseline it is, in the order of tables. A law plays in
#: every version.
ORDER = {
    "v0": (*_LAWS, "coordinated_undamped", "tip_speed_feedback"),
    "v1": (*_LAWS, "coordinated_tuned", "fast_droop"),
}
#: The source of the coordinated laws.
COORDINATED_SOURCE = (
    "M. Chen, Y. Xi, L. Cheng, F. Dörfler, I. Lestas, "
    '"Coordinated Primary Frequency Regulation and Grid-Forming Control for Wind Turbine Generators"'
)
#: The source of deloaded operation with grid-forming control.
DELOADED_SOURCE = "X. Lyu, D. Groß, IEEE Trans. Sustain. Energy 15(1), 2024"
