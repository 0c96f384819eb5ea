"""The paper's claims on statics and stability, and the list of all claims."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping

import numpy as np

from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.modes import Side
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.plant import PlantSettings
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.physics.trajectory import simulate
from wtg_gym.reproduce.case_claims import load_decrease, load_increase, settling
from wtg_gym.reproduce.case_studies import CaseStudies, linear_undamped
from wtg_gym.reproduce.claim import Claim, near
from wtg_gym.reproduce.loops import ideal_source_loop, single_machine
from wtg_gym.reproduce.power_frequency import named_points
from wtg_gym.reproduce.steady_states import OperatingPoint, stable_equilibrium
from wtg_gym.scenarios import get_suite

_DELOADED = ("deloaded-5", "deloaded-10")
#: Winds of the two groups of the case studies [m/s].
_HIGH, _LOW = _WINDS = (11.4, 8.0)
_OMEGA_MIN = GridFormingParameters().frequency_min_pu
#: Winds at which a statement "for every wind speed" is tried; above, the pitch protection sets in [m/s].
_ALL_WINDS = np.arange(4.0, 11.51, 0.5)
_SIDES: tuple[Side, ...] = ("under", "over")
#: Droop gains, 8 … 0.8 % of droop [p.u.], and virtual inertia constants [s] of other grid-forming controls.
_DROOP_GAINS, _INERTIA_CONSTANTS = (12.5, 25.0, 62.5, 125.0), (0.5, 2.0, 5.0, 10.0)


def paper_claims(studies: CaseStudies) -> tuple[Claim, ...]:
    """Measure every claim of the paper; `studies` are its case studies as run here."""
    return (
        *_power_coefficient(),
        *_mppt(),
        *_deloading(),
        *_coordination(),
        *_margins(),
        _compatibility(),
        *load_increase(studies.increase_runs),
        settling(studies),
        *load_decrease(studies.decrease_runs),
    )


def _power_coefficient() -> Iterable[Claim]:
    optimum, nominal, limit = (tracking_point(d) for d in (0.0, 0.05, 0.10))
    fitted = "c_1, c_2, c_5, c_6"
    for key, says, name, value, target in (
        ("lambda-opt", "λ_opt", "lambda_opt", optimum.tip_speed_ratio, 7.0),
        ("lambda-n", "λ_n at 5 % deloading", "lambda_n", nominal.tip_speed_ratio, 7.92),
        ("lambda-pr", "λ_pr at 10 % deloading", "lambda_pr", limit.tip_speed_ratio, 8.32),
    ):
        yield near(key, "parameters", says, (name, value, 3), target, 0.005, fitted)
    best = ("cp_opt", optimum.power_coefficient, 4)
    yield near("cp-opt", "parameters", "optimal power coefficient", best, 0.448, 0.0005, fitted)


def _mppt() -> Iterable[Claim]:
    points = [named_points(STRATEGIES["mppt"], wind) for wind in _WINDS]
    powers = [each["B"].power_pu / each["A"].power_pu for each in points]
    limits = [each["B"].frequency_pu for each in points]
    yield Claim(
        key="inverse-droop",
        source="MPPT",
        says="power falls with the frequency; no equilibrium below ω_b, which is higher in less wind",
        expected="p_B < p_A; ω_min < ω_b(11.4 m/s) < ω_b(8 m/s)",
        measured=f"p_B/p_A = {powers[0]:.3f}, {powers[1]:.3f}; ω_b = {limits[0]:.5f}, {limits[1]:.5f} p.u.",
        values={"power_ratio": powers, "critical_frequency_pu": limits},
        holds=max(powers) < 1.0 and _OMEGA_MIN < limits[0] < limits[1],
    )
    shares = [each["C"].power_pu / float(available_power_pu(wind)) for each, wind in zip(points, _WINDS, strict=True)]
    asked = 1.0 - GridFormingParameters().deloading_limit
    yield Claim(
        key="over-frequency",
        source="MPPT",
        says="over-frequency: power falls too little or too much, the rotor speeds up",
        expected=f"p_C < p_A, ω_m higher; at ω_max more than {100 * asked:g} % of the available power at one wind, "
        "less at the other",
        measured=f"{100 * shares[0]:.1f} % at 11.4 m/s, {100 * shares[1]:.1f} % at 8 m/s",
        values={"share_at_frequency_max": shares},
        holds=all(
            each["C"].power_pu < each["A"].power_pu and each["C"].rotor_speed_pu > each["A"].rotor_speed_pu
            for each in points
        )
        and min(shares) < asked < max(shares),
    )


def _deloading() -> Iterable[Claim]:
    five, ten = ({wind: named_points(STRATEGIES[name], wind) for wind in _WINDS} for name in _DELOADED)
    lost = five[_LOW]["B"].frequency_pu
    yield Claim(
        key="low-deloading",
        source="low deloading",
        says="5 %: power rises from A to M, then falls; at low wind the equilibrium is lost above ω_min",
        expected="p_M > p_A, p_B < p_M; ω_B(8 m/s) > 0.992 p.u.",
        measured=f"p_A, p_M, p_B = {_powers(five[_HIGH])} (11.4 m/s), {_powers(five[_LOW])} (8 m/s); "
        f"ω_B = {lost:.5f} p.u.",
        values={"critical_frequency_pu": lost},
        holds=all(max(each["A"].power_pu, each["B"].power_pu) < each["M"].power_pu for each in five.values())
        and lost > _OMEGA_MIN,
    )
    optimum, ratio = tracking_point(0.0).tip_speed_ratio, ten[_HIGH]["B"].tip_speed_ratio
    crossing = ten[_HIGH]["M"].frequency_pu if "M" in ten[_HIGH] else 0.0
    yield Claim(
        key="high-deloading-high-wind",
        source="high deloading",
        says="10 %, high wind: λ may stay above λ_opt down to ω_min",
        expected=f"λ at ω_min above {optimum:.3f}",
        measured=f"λ = {ratio:.3f}; λ_opt at {crossing:.5f} p.u.",
        values={"tip_speed_ratio": ratio, "crossing_frequency_pu": crossing},
        holds=ratio > optimum,
        remark="The paper's figure is schematic. With its own numbers the droop asks for 0.5 p.u. at ω_min, slightly "
        "more than 10 % of reserve can give.",
    )
    lost = ten[_LOW]["B"].frequency_pu
    yield Claim(
        key="high-deloading-low-wind",
        source="high deloading",
        says="10 %, low wind: below M power falls with the frequency again, above ω_min already",
        expected="M passed, equilibrium lost or left of M at ω_min",
        measured=f"M at {ten[_LOW]['M'].frequency_pu:.5f} p.u., lost at {lost:.5f} p.u.",
        values={"critical_frequency_pu": lost},
        holds="M" in ten[_LOW] and lost > _OMEGA_MIN,
    )


def _powers(points: Mapping[str, OperatingPoint]) -> str:
    return ", ".join(f"{points[name].power_pu:.4f}" for name in "AMB")


def _coordination() -> Iterable[Claim]:
    control = GridFormingParameters()
    worst = max(_share_error(control, float(wind)) for wind in _ALL_WINDS)
    yield Claim(
        key="coordination",
        source="control objective",
        says="coordinated: 100, 95, 90 % of the available power at ω_min, ω_st, ω_max, at every wind",
        expected="within 0.01 percentage points, 4 … 11.5 m/s",
        measured=f"largest deviation {100 * worst:.1e}",
        values={"largest_deviation": worst},
        holds=worst < 1e-4,
    )
    monotonic = True
    for wind in _ALL_WINDS:
        frequencies = np.linspace(control.frequency_min_pu, control.frequency_max_pu, 33)
        found = [stable_equilibrium(float(f), STRATEGIES[REFERENCE_STRATEGY], float(wind)) for f in frequencies]
        power = np.array([np.nan if point is None else point.power_pu for point in found])
        rotor = np.array([np.nan if point is None else point.rotor_speed_pu for point in found])
        # At ω_min itself p has its maximum, so that its slope is zero there.
        monotonic &= bool((np.diff(power) < 0.0).all() and (np.diff(rotor) > 0.0).all())
    yield Claim(
        key="monotonic",
        source="(18)-(20)",
        says="coordinated: power falls and rotor speed rises with the frequency, at every wind",
        expected="strictly monotonic at 33 frequencies, 4 … 11.5 m/s",
        measured="strictly monotonic" if monotonic else "not monotonic",
        values={"monotonic": float(monotonic)},
        holds=monotonic,
    )


def _margins() -> Iterable[Claim]:
    where = "stability"

    def margin(key: str, says: str, found: float, target: float, tolerance: float) -> Claim:
        return near(key, where, says, ("pm_deg", found, 1), target, tolerance, "K_p")

    ideal = ideal_source_loop().margins().phase_margin_deg
    yield margin("pm-ideal", "phase margin on an ideal DC source", ideal, 50.0, 2.0)
    deloaded = [single_machine(STRATEGIES[name], _HIGH).margins().phase_margin_deg for name in _DELOADED]
    yield Claim(
        key="pm-deloaded",
        source=where,
        says="phase margin of the deloaded strategies, close to the ideal source's",
        expected="within 3°",
        measured=f"{deloaded[0]:.1f}° (5 %), {deloaded[1]:.1f}° (10 %)",
        values={"pm_deg": deloaded},
        holds=max(abs(pm - ideal) for pm in deloaded) <= 3.0,
        fitted="K_p",
    )
    undamped, damped = (
        single_machine(law, _HIGH).margins().phase_margin_deg
        for law in (linear_undamped(), STRATEGIES["coordinated-linear"])
    )
    yield margin("pm-undamped", "phase margin of the linear g(ω) without transient damping", undamped, 28.0, 2.0)
    yield margin("pm-damped", "phase margin of the linear g(ω), τ = 0.8 s", damped, 55.0, 1.0)


def _compatibility() -> Claim:
    """Put the coordinated law on other droops: its statics, its margins, and the paper's load increase."""
    law, scenario = STRATEGIES[REFERENCE_STRATEGY], get_suite("paper").scenario(0)
    differences, n_loops, n_runs, completed, worst = [], 0, 0, 0, 0.0
    for gain, inertia in itertools.product(_DROOP_GAINS, _INERTIA_CONSTANTS):
        control = GridFormingParameters(droop_gain_pu=gain, inertia_constant_s=inertia)
        ideal = ideal_source_loop(control=control).margins().phase_margin_deg
        for wind, side in itertools.product((6.0, *_WINDS), _SIDES):
            worst = max(worst, _share_error(control, wind))
            margins = single_machine(law, wind, side=side, control=control).margins()
            n_loops += 1
            if margins.stable:
                differences.append(margins.phase_margin_deg - ideal)
        # The stiffest droop on the least inertia is too fast for steps of 25 ms.
        run = simulate(scenario, law, PlantSettings(control=control, simulation_dt=0.005))
        n_runs += 1
        completed += run.status == Status.RUNNING
    return Claim(
        key="compatible",
        source="stability",
        says="coordinated: compatible with any grid-forming control with a droop",
        expected=f"D_p = {_DROOP_GAINS[0]:g} … {_DROOP_GAINS[-1]:g} p.u., H = {_INERTIA_CONSTANTS[0]:g} … "
        f"{_INERTIA_CONSTANTS[-1]:g} s: the same shares, stable on both slopes at 6, 8, 11.4 m/s, no failure in the "
        "load increase",
        measured=f"largest deviation {100 * worst:.1e}; {len(differences)} of {n_loops} loops stable; {completed} of "
        f"{n_runs} runs complete",
        values={"margin_difference_deg": differences, "largest_deviation": worst, "completed_runs": float(completed)},
        holds=worst < 1e-4 and len(differences) == n_loops and completed == n_runs,
        remark=f"The margin differs from the ideal source's by {min(differences):+.0f}° … {max(differences):+.0f}°, "
        "because τ stays at 0.8 s. Only droops with a virtual inertia are tried.",
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
