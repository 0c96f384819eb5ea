"""Measurements of the paper's claims on the C_p curve, steady states and stability; the texts are in claims.toml."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.physics.trajectory import simulate
from wtg_gym.reproduce.claims import Claim, measured, near
from wtg_gym.reproduce.loops import LINEAR_UNDAMPED, SIDES, ideal_source_loop, single_machine
from wtg_gym.reproduce.steady_states import OperatingPoint, equilibria, named_points
from wtg_gym.scenarios import get_suite

#: Winds of the two groups of the case studies [m/s].
WINDS = _HIGH, _LOW = 11.4, 8.0
#: Winds at which a statement "for every wind speed" is tried; above, the pitch protection sets in [m/s].
_ALL_WINDS = np.arange(4.0, 11.51, 0.5)
#: Droop gains, 8 … 0.8 % of droop [p.u.], and virtual inertia constants [s] of other grid-forming controls.
_CONTROLS = tuple(itertools.product((12.5, 25.0, 62.5, 125.0), (0.5, 2.0, 5.0, 10.0)))


def claims_of_theory() -> Iterator[Claim]:
    """Measure the claims that need none of the case studies."""
    for section in (_power_coefficient, _mppt, _deloading, _coordination, _margins):
        yield from section()
    yield _compatibility()


def _power_coefficient() -> Iterator[Claim]:
    optimum, nominal, limit = (tracking_point(d) for d in (0.0, 0.05, 0.10))
    yield near("lambda-opt", "lambda_opt", optimum.tip_speed_ratio, 3)
    yield near("lambda-n", "lambda_n", nominal.tip_speed_ratio, 3)
    yield near("lambda-pr", "lambda_pr", limit.tip_speed_ratio, 3)
    yield near("cp-opt", "cp_opt", optimum.power_coefficient, 4)


def _mppt() -> Iterator[Claim]:
    control = GridFormingParameters()
    points = [named_points(STRATEGIES["mppt"], wind) for wind in WINDS]
    powers = [each["B"].power_pu / each["A"].power_pu for each in points]
    limits = [each["B"].frequency_pu for each in points]
    yield measured(
        "inverse-droop",
        f"p_B/p_A = {powers[0]:.3f}, {powers[1]:.3f}; ω_b = {limits[0]:.5f}, {limits[1]:.5f} p.u.",
        {"power_ratio": powers, "critical_frequency_pu": limits},
        max(powers) < 1.0 and control.frequency_min_pu < limits[0] < limits[1],
    )
    shares = [each["C"].power_pu / float(available_power_pu(wind)) for each, wind in zip(points, WINDS, strict=True)]
    falls = all(p["C"].power_pu < p["A"].power_pu and p["C"].rotor_speed_pu > p["A"].rotor_speed_pu for p in points)
    yield measured(
        "over-frequency",
        f"{100 * shares[0]:.1f} % at 11.4 m/s, {100 * shares[1]:.1f} % at 8 m/s",
        {"share_at_frequency_max": shares},
        falls and min(shares) < 1.0 - control.deloading_limit < max(shares),
    )


def _deloading() -> Iterator[Claim]:
    five, ten = ({wind: named_points(STRATEGIES[f"deloaded-{d}"], wind) for wind in WINDS} for d in (5, 10))
    lowest, lost = GridFormingParameters().frequency_min_pu, five[_LOW]["B"].frequency_pu

    def powers(points: dict[str, OperatingPoint]) -> str:
        return ", ".join(f"{points[name].power_pu:.4f}" for name in "AMB")

    yield measured(
        "low-deloading",
        f"p_A, p_M, p_B = {powers(five[_HIGH])} (11.4 m/s), {powers(five[_LOW])} (8 m/s); ω_B = {lost:.5f} p.u.",
        {"critical_frequency_pu": lost},
        all(max(p["A"].power_pu, p["B"].power_pu) < p["M"].power_pu for p in five.values()) and lost > lowest,
    )
    ratio = ten[_HIGH]["B"].tip_speed_ratio
    crossing = ten[_HIGH]["M"].frequency_pu if "M" in ten[_HIGH] else 0.0
    yield measured(
        "high-deloading-high-wind",
        f"λ = {ratio:.3f}; λ_opt at {crossing:.5f} p.u.",
        {"tip_speed_ratio": ratio, "crossing_frequency_pu": crossing},
        ratio > tracking_point(0.0).tip_speed_ratio,
    )
    lost = ten[_LOW]["B"].frequency_pu
    yield measured(
        "high-deloading-low-wind",
        f"M at {ten[_LOW]['M'].frequency_pu:.5f} p.u., lost at {lost:.5f} p.u.",
        {"critical_frequency_pu": lost},
        lost > lowest,
    )


def _coordination() -> Iterator[Claim]:
    control, law = GridFormingParameters(), STRATEGIES[REFERENCE_STRATEGY]
    worst = max(_share_error(control, float(wind)) for wind in _ALL_WINDS)
    yield measured("coordination", f"largest deviation {100 * worst:.1e}", {"largest_deviation": worst}, worst < 1e-4)
    monotonic = True
    for wind in _ALL_WINDS:
        frequencies = np.linspace(control.frequency_min_pu, control.frequency_max_pu, 33)
        points = [equilibria(float(frequency), law, float(wind))[-1] for frequency in frequencies]
        power, rotor = np.array([(point.power_pu, point.rotor_speed_pu) for point in points]).T
        # At ω_min itself p has its maximum, so that its slope is zero there.
        monotonic &= bool((np.diff(power) < 0.0).all() and (np.diff(rotor) > 0.0).all())
    text = "strictly monotonic" if monotonic else "not monotonic"
    yield measured("monotonic", text, {"monotonic": float(monotonic)}, monotonic)


def _margins() -> Iterator[Claim]:
    laws = (*(STRATEGIES[name] for name in ("deloaded-5", "deloaded-10", "coordinated-linear")), LINEAR_UNDAMPED)
    ideal = ideal_source_loop().margins().phase_margin_deg
    *deloaded, damped, undamped = (single_machine(law, _HIGH).margins().phase_margin_deg for law in laws)
    yield near("pm-ideal", "pm_deg", ideal, 1)
    text, close = f"{deloaded[0]:.1f}° (5 %), {deloaded[1]:.1f}° (10 %)", max(abs(pm - ideal) for pm in deloaded) <= 3.0
    yield measured("pm-deloaded", text, {"pm_deg": deloaded}, close)
    yield near("pm-undamped", "pm_deg", undamped, 1)
    yield near("pm-damped", "pm_deg", damped, 1)


def _compatibility() -> Claim:
    """Put the coordinated law on other droops: its statics, its margins, and the paper's load increase."""
    law, scenario = STRATEGIES[REFERENCE_STRATEGY], get_suite("paper").scenario(0)
    differences, worst, n_completed, winds = [], 0.0, 0, (6.0, *WINDS)
    for gain, inertia in _CONTROLS:
        control = GridFormingParameters(droop_gain_pu=gain, inertia_constant_s=inertia)
        worst = max(worst, *(_share_error(control, wind) for wind in winds))
        ideal = ideal_source_loop(control).margins().phase_margin_deg
        for wind, side in itertools.product(winds, SIDES):
            margins = single_machine(law, wind, side=side, control=control).margins()
            differences += [margins.phase_margin_deg - ideal] if margins.stable else []
        # The stiffest droop on the least inertia is too fast for steps of 25 ms.
        run = simulate(scenario, law, PlantSettings(control=control, simulation_dt=0.005))
        n_completed += run.status == Status.RUNNING
    n_loops, n_runs = len(_CONTROLS) * len(winds) * len(SIDES), len(_CONTROLS)
    return measured(
        "compatible",
        f"largest deviation {100 * worst:.1e}; {len(differences)} of {n_loops} loops stable; {n_completed} of {n_runs} "
        "runs complete",
        {"margin_difference_deg": differences, "largest_deviation": worst, "completed_runs": float(n_completed)},
        worst < 1e-4 and len(differences) == n_loops and n_completed == n_runs,
        f"{min(differences):+.0f}° … {max(differences):+.0f}°",
    )


def _share_error(control: GridFormingParameters, wind_m_s: float) -> float:
    """Return how far the captured shares at ω_min, ω_st and ω_max are from 100, 95 and 90 % [-]."""
    wanted = {control.frequency_min_pu: 1.0, control.frequency_setpoint_pu: 0.95, control.frequency_max_pu: 0.90}
    errors = []
    for frequency, share in wanted.items():
        point = equilibria(frequency, STRATEGIES[REFERENCE_STRATEGY], wind_m_s, control=control)[-1]
        errors.append(abs(point.power_pu / float(available_power_pu(wind_m_s)) - share))
    return max(errors)
