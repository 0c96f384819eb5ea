"""The paper's claims: what a claim is, those on statics and stability, and the table of all."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from wtg_gym.files import markdown_table
from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.modes import Side
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.physics.trajectory import simulate
from wtg_gym.reproduce.loops import LINEAR_UNDAMPED, ideal_source_loop, single_machine
from wtg_gym.reproduce.steady_states import OperatingPoint, named_points, stable_equilibrium
from wtg_gym.scenarios import get_suite

#: Winds of the two groups of the case studies [m/s].
WINDS = _HIGH, _LOW = 11.4, 8.0
#: Winds at which a statement "for every wind speed" is tried; above, the pitch protection sets in [m/s].
_ALL_WINDS = np.arange(4.0, 11.51, 0.5)
_SIDES: tuple[Side, ...] = ("under", "over")
#: Droop gains, 8 … 0.8 % of droop [p.u.], and virtual inertia constants [s] of other grid-forming controls.
_CONTROLS = tuple(itertools.product((12.5, 25.0, 62.5, 125.0), (0.5, 2.0, 5.0, 10.0)))
_UNITS = {"deg": "°", "pu": " p.u."}


@dataclass(frozen=True)
class Claim:
    """One statement of the paper and its measurement."""

    key: str  # short name
    source: str  # section, table or figure of the paper
    says: str  # the statement, in our words
    expected: str  # the result that confirms it, with its tolerance, in words
    measured: str  # the result, in words
    values: Mapping[str, float | list[float]]  # the numbers behind `measured`, units in their names
    holds: bool  # the verdict
    remark: str = ""  # a reader's footnote; empty for none
    fitted: str = ""  # the parameter that was chosen to meet this number; empty where none was
    #: target, tolerance: the expected number and its tolerance, where the claim is one number.
    target: float | None = None
    tolerance: float | None = None


def near(
    key: str, source: str, says: str, found: tuple[str, float, int], target: float, tolerance: float, fitted: str
) -> Claim:
    """Return the claim that a fitted value is `target` within `tolerance`.

    `found` is the name of the value, which ends in its unit, the value, and its digits in the text.
    """
    name, value, digits = found
    unit = _UNITS.get(name.rsplit("_", 1)[-1], "")
    expected, measured = f"{target:g}{unit} ± {tolerance:g}{unit}", f"{value:.{digits}f}{unit}"
    holds = abs(value - target) <= tolerance
    return Claim(key, source, says, expected, measured, {name: float(value)}, holds, "", fitted, target, tolerance)


def claims_table(claims: Iterable[Claim]) -> str:
    """Return the claims with their verdicts as Markdown, remarks below the table."""
    claims = list(claims)
    notes: list[str] = []
    rows: list[tuple[str, ...]] = []
    for source, section in itertools.groupby(claims, key=lambda claim: claim.source):
        rows.append((f"**{source}**", "", "", ""))
        for claim in section:
            verdict = ("holds" if claim.holds else "**does not hold**") + (", fitted" if claim.fitted else "")
            if claim.remark:
                notes.append(f"({len(notes) + 1}) {claim.remark}  ")
                verdict += f" ({len(notes)})"
            rows.append((claim.says, claim.expected, claim.measured, verdict))
    held = sum(claim.holds for claim in claims)
    fitted = [claim.fitted for claim in claims if claim.fitted and claim.holds]
    by = ", ".join(f"{name} to {fitted.count(name)}" for name in dict.fromkeys(fitted))
    count = (
        f"{held} of {len(claims)} claims hold: {held - len(fitted)} without a fit, and {len(fitted)} numbers that "
        f"parameters of this model were fitted to ({by})."
    )
    table = markdown_table(("the paper says", "expected", "measured", "verdict"), rows)
    return "\n\n".join([count, table, "\n".join(notes)]).strip()


def claims_of_theory() -> Iterable[Claim]:
    """Measure the claims on the C_p curve, steady states and stability."""
    for claims in (_power_coefficient(), _mppt(), _deloading(), _coordination(), _margins()):
        yield from claims
    yield _compatibility()


def _power_coefficient() -> Iterable[Claim]:
    optimum, nominal, limit = (tracking_point(d) for d in (0.0, 0.05, 0.10))
    source, fitted = "parameters", "c_1, c_2, c_5, c_6"
    for key, says, point, target in (
        ("lambda-opt", "λ_opt", optimum, 7.0),
        ("lambda-n", "λ_n at 5 % deloading", nominal, 7.92),
        ("lambda-pr", "λ_pr at 10 % deloading", limit, 8.32),
    ):
        found = (key.replace("-", "_"), point.tip_speed_ratio, 3)
        yield near(key, source, says, found, target, 0.005, fitted)
    best = ("cp_opt", optimum.power_coefficient, 4)
    yield near("cp-opt", source, "optimal power coefficient", best, 0.448, 0.0005, fitted)


def _mppt() -> Iterable[Claim]:
    points = [named_points(STRATEGIES["mppt"], wind) for wind in WINDS]
    powers = [each["B"].power_pu / each["A"].power_pu for each in points]
    limits = [each["B"].frequency_pu for each in points]
    yield Claim(
        "inverse-droop",
        "MPPT",
        "power falls with the frequency; no equilibrium below ω_b, which is higher in less wind",
        "p_B < p_A; ω_min < ω_b(11.4 m/s) < ω_b(8 m/s)",
        f"p_B/p_A = {powers[0]:.3f}, {powers[1]:.3f}; ω_b = {limits[0]:.5f}, {limits[1]:.5f} p.u.",
        {"power_ratio": powers, "critical_frequency_pu": limits},
        max(powers) < 1.0 and GridFormingParameters().frequency_min_pu < limits[0] < limits[1],
    )
    shares = [each["C"].power_pu / float(available_power_pu(wind)) for each, wind in zip(points, WINDS, strict=True)]
    asked = 1.0 - GridFormingParameters().deloading_limit
    falls = all(p["C"].power_pu < p["A"].power_pu and p["C"].rotor_speed_pu > p["A"].rotor_speed_pu for p in points)
    yield Claim(
        "over-frequency",
        "MPPT",
        "over-frequency: power falls too little or too much, the rotor speeds up",
        f"p_C < p_A, ω_m higher; at ω_max more than {100 * asked:g} % of the available power at one wind, "
        "less at the other",
        f"{100 * shares[0]:.1f} % at 11.4 m/s, {100 * shares[1]:.1f} % at 8 m/s",
        {"share_at_frequency_max": shares},
        falls and min(shares) < asked < max(shares),
    )


def _deloading() -> Iterable[Claim]:
    five, ten = ({wind: named_points(STRATEGIES[f"deloaded-{d}"], wind) for wind in WINDS} for d in (5, 10))
    lowest, lost = GridFormingParameters().frequency_min_pu, five[_LOW]["B"].frequency_pu
    yield Claim(
        "low-deloading",
        "low deloading",
        "5 %: power rises from A to M, then falls; at low wind the equilibrium is lost above ω_min",
        "p_M > p_A, p_B < p_M; ω_B(8 m/s) > 0.992 p.u.",
        f"p_A, p_M, p_B = {_powers(five[_HIGH])} (11.4 m/s), {_powers(five[_LOW])} (8 m/s); ω_B = {lost:.5f} p.u.",
        {"critical_frequency_pu": lost},
        all(max(p["A"].power_pu, p["B"].power_pu) < p["M"].power_pu for p in five.values()) and lost > lowest,
    )
    optimum, ratio = tracking_point(0.0).tip_speed_ratio, ten[_HIGH]["B"].tip_speed_ratio
    crossing = ten[_HIGH]["M"].frequency_pu if "M" in ten[_HIGH] else 0.0
    yield Claim(
        "high-deloading-high-wind",
        "high deloading",
        "10 %, high wind: λ may stay above λ_opt down to ω_min",
        f"λ at ω_min above {optimum:.3f}",
        f"λ = {ratio:.3f}; λ_opt at {crossing:.5f} p.u.",
        {"tip_speed_ratio": ratio, "crossing_frequency_pu": crossing},
        ratio > optimum,
        "The paper's figure is schematic. With its own numbers the droop asks for 0.5 p.u. at ω_min, slightly more "
        "than 10 % of reserve can give.",
    )
    lost = ten[_LOW]["B"].frequency_pu
    yield Claim(
        "high-deloading-low-wind",
        "high deloading",
        "10 %, low wind: below M power falls with the frequency again, above ω_min already",
        "M passed, equilibrium lost or left of M at ω_min",
        f"M at {ten[_LOW]['M'].frequency_pu:.5f} p.u., lost at {lost:.5f} p.u.",
        {"critical_frequency_pu": lost},
        "M" in ten[_LOW] and lost > lowest,
    )


def _powers(points: Mapping[str, OperatingPoint]) -> str:
    return ", ".join(f"{points[name].power_pu:.4f}" for name in "AMB")


def _coordination() -> Iterable[Claim]:
    control, law = GridFormingParameters(), STRATEGIES[REFERENCE_STRATEGY]
    worst = max(_share_error(control, float(wind)) for wind in _ALL_WINDS)
    yield Claim(
        "coordination",
        "control objective",
        "coordinated: 100, 95, 90 % of the available power at ω_min, ω_st, ω_max, at every wind",
        "within 0.01 percentage points, 4 … 11.5 m/s",
        f"largest deviation {100 * worst:.1e}",
        {"largest_deviation": worst},
        worst < 1e-4,
    )
    monotonic = True
    for wind in _ALL_WINDS:
        frequencies = np.linspace(control.frequency_min_pu, control.frequency_max_pu, 33)
        found = [stable_equilibrium(float(frequency), law, float(wind)) for frequency in frequencies]
        power, rotor = np.array([(np.nan, np.nan) if p is None else (p.power_pu, p.rotor_speed_pu) for p in found]).T
        # At ω_min itself p has its maximum, so that its slope is zero there.
        monotonic &= bool((np.diff(power) < 0.0).all() and (np.diff(rotor) > 0.0).all())
    yield Claim(
        "monotonic",
        "(18)-(20)",
        "coordinated: power falls and rotor speed rises with the frequency, at every wind",
        "strictly monotonic at 33 frequencies, 4 … 11.5 m/s",
        "strictly monotonic" if monotonic else "not monotonic",
        {"monotonic": float(monotonic)},
        monotonic,
    )


def _margins() -> Iterable[Claim]:
    laws = (*(STRATEGIES[name] for name in ("deloaded-5", "deloaded-10", "coordinated-linear")), LINEAR_UNDAMPED)
    ideal = ideal_source_loop().margins().phase_margin_deg
    *deloaded, damped, undamped = (single_machine(law, _HIGH).margins().phase_margin_deg for law in laws)
    for key, says, found, target, tolerance in (
        ("pm-ideal", "phase margin on an ideal DC source", ideal, 50.0, 2.0),
        ("pm-undamped", "phase margin of the linear g(ω) without transient damping", undamped, 28.0, 2.0),
        ("pm-damped", "phase margin of the linear g(ω), τ = 0.8 s", damped, 55.0, 1.0),
    ):
        yield near(key, "stability", says, ("pm_deg", found, 1), target, tolerance, "K_p")
        if key == "pm-ideal":
            yield Claim(
                "pm-deloaded",
                "stability",
                "phase margin of the deloaded strategies, close to the ideal source's",
                "within 3°",
                f"{deloaded[0]:.1f}° (5 %), {deloaded[1]:.1f}° (10 %)",
                {"pm_deg": deloaded},
                max(abs(pm - ideal) for pm in deloaded) <= 3.0,
                fitted="K_p",
            )


def _compatibility() -> Claim:
    """Put the coordinated law on other droops: its statics, its margins, and the paper's load increase."""
    law, scenario = STRATEGIES[REFERENCE_STRATEGY], get_suite("paper").scenario(0)
    differences, worst, n_completed, winds = [], 0.0, 0, (6.0, *WINDS)
    for gain, inertia in _CONTROLS:
        control = GridFormingParameters(droop_gain_pu=gain, inertia_constant_s=inertia)
        worst = max(worst, *(_share_error(control, wind) for wind in winds))
        ideal = ideal_source_loop(control=control).margins().phase_margin_deg
        for wind, side in itertools.product(winds, _SIDES):
            margins = single_machine(law, wind, side=side, control=control).margins()
            differences += [margins.phase_margin_deg - ideal] if margins.stable else []
        # The stiffest droop on the least inertia is too fast for steps of 25 ms.
        run = simulate(scenario, law, PlantSettings(control=control, simulation_dt=0.005))
        n_completed += run.status == Status.RUNNING
    n_loops, n_runs = len(_CONTROLS) * len(winds) * len(_SIDES), len(_CONTROLS)
    return Claim(
        "compatible",
        "stability",
        "coordinated: compatible with any grid-forming control with a droop",
        "D_p = 12.5 … 125 p.u., H = 0.5 … 10 s: the same shares, stable on both slopes at 6, 8, 11.4 m/s, no failure "
        "in the load increase",
        f"largest deviation {100 * worst:.1e}; {len(differences)} of {n_loops} loops stable; {n_completed} of {n_runs} "
        "runs complete",
        {"margin_difference_deg": differences, "largest_deviation": worst, "completed_runs": float(n_completed)},
        worst < 1e-4 and len(differences) == n_loops and n_completed == n_runs,
        f"The margin differs from the ideal source's by {min(differences):+.0f}° … {max(differences):+.0f}°, because τ "
        "stays at 0.8 s. Only droops with a virtual inertia are tried.",
    )


def _share_error(control: GridFormingParameters, wind_m_s: float) -> float:
    """Return how far the captured shares at ω_min, ω_st and ω_max are from 100, 95 and 90 % [-]."""
    wanted = {control.frequency_min_pu: 1.0, control.frequency_setpoint_pu: 0.95, control.frequency_max_pu: 0.90}
    errors = []
    for frequency, share in wanted.items():
        point = stable_equilibrium(frequency, STRATEGIES[REFERENCE_STRATEGY], wind_m_s, control=control)
        captured = 0.0 if point is None else point.power_pu
        errors.append(abs(captured / float(available_power_pu(wind_m_s)) - share))
    return max(errors)
