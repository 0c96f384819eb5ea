"""The paper's claims: what a claim is, the two case studies, and the measurement of each claim.

The texts are in claims.toml.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym.files import read_toml
from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.reproduce.loops import LINEAR_UNDAMPED, SIDES, ideal_source_loop, single_machine
from wtg_gym.reproduce.steady_states import equilibria, named_points
from wtg_gym.scenarios import get_suite

#: Texts of every claim by its key.
TEXTS: dict[str, dict[str, Any]] = read_toml(Path(__file__).with_name("claims.toml"), "table of claims")
#: Winds of the two groups of the case studies [m/s].
WINDS = (11.4, 8.0)
#: Winds at which a statement "for every wind speed" is tried; above, the pitch protection sets in [m/s].
_ALL_WINDS = np.arange(4.0, 11.51, 0.5)
#: Droop gains, 8 … 0.8 % of droop [p.u.], and virtual inertia constants [s] of other grid-forming controls.
_CONTROLS = tuple(itertools.product((12.5, 25.0, 62.5, 125.0), (0.5, 2.0, 5.0, 10.0)))
#: Recorded runs by strategy.
Runs = Mapping[str, Trajectory]

_DELOADED = ("deloaded-5", "deloaded-10")
#: The strategies that the paper compares; the reference comes first in all comparisons.
_COMPARED = (REFERENCE_STRATEGY, *_DELOADED)
_EVENT_S, _SECOND_EVENT_S = 5.0, 30.0


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


def measured(key: str, holds: bool, values: Mapping[str, float | list[float]], **further: Any) -> Claim:
    """Return a claim as it was measured; its texts name `values`, and `further` numbers that are not kept."""
    words, numbers = TEXTS[key], {**values, **further}
    texts = {name: words[name].format(**numbers) for name in ("measured", "remark") if name in words}
    kept = {name: _six_digits(value) for name, value in values.items()}
    return Claim(key, **words | texts, values=kept, holds=holds)


def _six_digits(value: float | list[float]) -> float | list[float]:
    """Return a value, or several, without the last digits, which depend on the machine."""
    return [float(f"{each:.6g}") for each in value] if isinstance(value, list) else float(f"{value:.6g}")


def near(key: str, name: str, value: float) -> Claim:
    """Return the claim that a value is the paper's number within its tolerance; `name` ends in the unit."""
    words = TEXTS[key]
    return measured(key, abs(value - words["target"]) <= words["tolerance"], {name: float(value)})


def run_case(seed: int, on_progress: Callable[[str, float, int], None] = lambda *_: None) -> Runs:
    """Run a case study under every strategy: 0 is the load increase, 1 the load decrease."""
    scenario = get_suite("paper").scenario(seed)
    runs: dict[str, Trajectory] = {}
    for name, law in STRATEGIES.items():
        on_progress(f"{scenario.name}, {name}", len(runs), len(STRATEGIES))
        runs[name] = simulate(scenario, law)
    return runs


def paper_claims(increase: Runs, decrease: Runs) -> Iterator[Claim]:
    """Measure every claim of the paper, those on the case studies on their runs."""
    for section in (_power_coefficient, _mppt, _deloading, _coordination, _margins, _compatibility):
        yield from section()
    yield from load_increase(increase)
    yield _settling()
    yield from _load_decrease(decrease)


# --- the C_p curve, steady states and stability ----------------------------------------------------------------------


def _power_coefficient() -> Iterator[Claim]:
    optimum, nominal, limit = (tracking_point(d) for d in (0.0, 0.05, 0.10))
    yield near("lambda-opt", "lambda_opt", optimum.tip_speed_ratio)
    yield near("lambda-n", "lambda_n", nominal.tip_speed_ratio)
    yield near("lambda-pr", "lambda_pr", limit.tip_speed_ratio)
    yield near("cp-opt", "cp_opt", optimum.power_coefficient)


def _mppt() -> Iterator[Claim]:
    control = GridFormingParameters()
    points = [named_points(STRATEGIES["mppt"], wind) for wind in WINDS]
    powers = [each["B"].power_pu / each["A"].power_pu for each in points]
    limits = [each["B"].frequency_pu for each in points]
    inverse = max(powers) < 1.0 and control.frequency_min_pu < limits[0] < limits[1]
    yield measured("inverse-droop", inverse, {"power_ratio": powers, "critical_frequency_pu": limits})
    shares = [each["C"].power_pu / float(available_power_pu(wind)) for each, wind in zip(points, WINDS, strict=True)]
    falls = all(p["C"].power_pu < p["A"].power_pu and p["C"].rotor_speed_pu > p["A"].rotor_speed_pu for p in points)
    unequal = min(shares) < 1.0 - control.deloading_limit < max(shares)
    values, percent = {"share_at_frequency_max": shares}, [100.0 * share for share in shares]
    yield measured("over-frequency", falls and unequal, values, percent=percent)


def _deloading() -> Iterator[Claim]:
    five, ten = ([named_points(STRATEGIES[f"deloaded-{d}"], wind) for wind in WINDS] for d in (5, 10))
    lowest, lost = GridFormingParameters().frequency_min_pu, five[1]["B"].frequency_pu
    rises = all(max(p["A"].power_pu, p["B"].power_pu) < p["M"].power_pu for p in five)
    values: dict[str, float | list[float]] = {"critical_frequency_pu": lost}
    yield measured("low-deloading", rises and lost > lowest, values, high=five[0], low=five[1])
    ratio = ten[0]["B"].tip_speed_ratio
    crossing = ten[0]["M"].frequency_pu if "M" in ten[0] else 0.0
    values = {"tip_speed_ratio": ratio, "crossing_frequency_pu": crossing}
    yield measured("high-deloading-high-wind", ratio > tracking_point(0.0).tip_speed_ratio, values)
    lost, crossing = ten[1]["B"].frequency_pu, ten[1]["M"].frequency_pu
    yield measured(
        "high-deloading-low-wind", lost > lowest, {"critical_frequency_pu": lost}, crossing_frequency_pu=crossing
    )


def _coordination() -> Iterator[Claim]:
    control, law = GridFormingParameters(), STRATEGIES[REFERENCE_STRATEGY]
    worst = max(_share_error(control, float(wind)) for wind in _ALL_WINDS)
    yield measured("coordination", worst < 1e-4, {"largest_deviation": worst}, percent=100.0 * worst)
    monotonic = True
    for wind in _ALL_WINDS:
        frequencies = np.linspace(control.frequency_min_pu, control.frequency_max_pu, 33)
        points = [equilibria(float(frequency), law, float(wind))[-1] for frequency in frequencies]
        power, rotor = np.array([(point.power_pu, point.rotor_speed_pu) for point in points]).T
        # At ω_min itself p has its maximum, so that its slope is zero there.
        monotonic &= bool((np.diff(power) < 0.0).all() and (np.diff(rotor) > 0.0).all())
    words = "strictly monotonic" if monotonic else "not monotonic"
    yield measured("monotonic", monotonic, {"monotonic": float(monotonic)}, words=words)


def _margins() -> Iterator[Claim]:
    laws = (*(STRATEGIES[name] for name in ("deloaded-5", "deloaded-10", "coordinated-linear")), LINEAR_UNDAMPED)
    ideal = ideal_source_loop().margins().phase_margin_deg
    *deloaded, damped, undamped = (single_machine(law, WINDS[0]).margins().phase_margin_deg for law in laws)
    yield near("pm-ideal", "pm_deg", ideal)
    yield measured("pm-deloaded", max(abs(margin - ideal) for margin in deloaded) <= 3.0, {"pm_deg": deloaded})
    yield near("pm-undamped", "pm_deg", undamped)
    yield near("pm-damped", "pm_deg", damped)


def _compatibility() -> Iterator[Claim]:
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
        run = simulate(scenario, law, Plant(control=control, simulation_dt=0.005))
        n_completed += run.status == Status.RUNNING
    n_loops, n_runs = len(_CONTROLS) * len(winds) * len(SIDES), len(_CONTROLS)
    holds = worst < 1e-4 and len(differences) == n_loops and n_completed == n_runs
    values: dict[str, float | list[float]] = {"margin_difference_deg": differences, "largest_deviation": worst}
    values["completed_runs"] = float(n_completed)
    counts = {"n_stable": len(differences), "n_loops": n_loops, "n_runs": n_runs}
    margins_deg = {"least_deg": min(differences), "most_deg": max(differences)}
    yield measured("compatible", holds, values, percent=100.0 * worst, **counts, **margins_deg)


def _share_error(control: GridFormingParameters, wind_m_s: float) -> float:
    """Return how far the captured shares at ω_min, ω_st and ω_max are from 100, 95 and 90 % [-]."""
    wanted = {control.frequency_min_pu: 1.0, control.frequency_setpoint_pu: 0.95, control.frequency_max_pu: 0.90}
    errors = []
    for frequency, share in wanted.items():
        point = equilibria(frequency, STRATEGIES[REFERENCE_STRATEGY], wind_m_s, control=control)[-1]
        errors.append(abs(point.power_pu / float(available_power_pu(wind_m_s)) - share))
    return max(errors)


# --- the case studies ------------------------------------------------------------------------------------------------


def load_increase(runs: Runs) -> Iterator[Claim]:
    """Measure the claims on the load increase, without the settling times."""
    reference = runs[REFERENCE_STRATEGY]
    yield near("settles", "frequency_pu", float(reference.frequency_hz[-1] / reference.nominal_frequency_hz))
    rotors, ratios = reference.rotor_speed_pu[-1].tolist(), reference.tip_speed_ratio[-1].tolist()
    least, most = (tracking_point(d).tip_speed_ratio for d in (0.0, 0.10))
    drift = float(np.ptp(reference.rotor_speed_pu[-200:], axis=0).max())
    stays = reference.status == Status.RUNNING and all(least <= ratio <= most for ratio in ratios) and drift < 1e-4
    yield measured("stays-stable", stays, {"tip_speed_ratio": ratios, "rotor_speed_pu": rotors}, drift_pu=drift)
    ended = {name: runs[name] for name in ("mppt", *_DELOADED)}
    times = [float(run.time_s[-1]) for run in ended.values()]
    second = all(run.status == Status.STALL and np.argmin(run.tip_speed_ratio[-1]) == 1 for run in ended.values())
    in_order = _SECOND_EVENT_S < times[0] < times[1] < times[2]
    yield measured("stalls", second and in_order, {f"{name}_s": time for name, time in zip(ended, times, strict=True)})
    high = [float(runs[name].rotor_speed_pu[-1, 0]) for name in _DELOADED]
    yield measured("right-of-mpp", min(high) > 1.0, {"rotor_speed_pu": high})
    yield from _first_event([runs[name] for name in _COMPARED])


def _first_event(runs: Sequence[Trajectory]) -> Iterator[Claim]:
    """Measure the claims on the first event, on runs of the compared strategies."""
    first = [run.time_s < _SECOND_EVENT_S for run in runs]
    peak = [float(run.power_pu[seen, 0].max()) for run, seen in zip(runs, first, strict=True)]
    fall = [float(run.rotor_speed_pu[0, 0]) - _at(run, run.rotor_speed_pu[:, 0], _EVENT_S + 1.0) for run in runs]
    rocof = [-_at(run, run.rocof_hz_s(0.5), _EVENT_S + 0.5) for run in runs]
    nadir = [float(run.frequency_hz[seen].min()) for run, seen in zip(runs, first, strict=True)]
    slightly_lower = all(0.0 < other - nadir[0] < 0.01 for other in nadir[1:])
    yield measured("larger-step", peak[0] > max(peak[1:]), {"peak_power_pu": peak})
    yield measured("faster-rotor", fall[0] > max(fall[1:]), {"fall_pu": fall})
    yield measured("rocof", rocof[0] < min(rocof[1:]), {"rocof_hz_s": rocof})
    yield measured("nadir", slightly_lower, {"nadir_hz": nadir})
    settled = [(run.rotor_speed_pu[0] - run.rotor_speed_pu[seen][-1]) for run, seen in zip(runs, first, strict=True)]
    dip = [float(np.ptp(run.rotor_speed_pu[seen, 0])) for run, seen in zip(runs, first, strict=True)]
    yield _smaller_changes("narrow-range", settled, dip_pu=dip)


def _settling() -> Claim:
    """Measure how long power and rotor of WTG 1 take to settle after the first event of the load increase."""
    scenario = get_suite("paper").scenario(0)
    scenario = dataclasses.replace(scenario, events=scenario.events[:1], duration_s=300.0)
    runs = {name: simulate(scenario, STRATEGIES[name]) for name in _COMPARED}
    values, sooner = dict[str, float | list[float]](), True
    for quantity in ("power_pu", "rotor_speed_pu"):
        times = [_settling_time(run, getattr(run, quantity)[:, 0]) for run in runs.values()]
        values |= {f"{name}_{quantity}_settling_s": time for name, time in zip(runs, times, strict=True)}
        sooner &= times[0] < min(times[1:])
    return measured("settles-sooner", sooner, values)


def _settling_time(run: Trajectory, value: Floats) -> float:
    outside = np.flatnonzero(np.abs(value / value[-1] - 1.0) > 0.02)
    return float(run.time_s[outside[-1]]) - _EVENT_S if outside.size else 0.0


def _load_decrease(runs: Runs) -> Iterator[Claim]:
    """Measure the claims on the load decrease."""
    available = np.array([float(available_power_pu(wind)) for wind in WINDS])
    floor, own = 0.9 * available, [runs[name] for name in _COMPARED]
    yield _smaller_changes("rotor-rise", [run.rotor_speed_pu.max(axis=0) - run.rotor_speed_pu[0] for run in own])
    inside, five, ten = (run.power_pu[-1] for run in own)
    yield measured("decrease-10", bool((ten < floor).all()), {"power_pu": ten.tolist()})
    yield measured("decrease-5", bool(five[0] > floor[0] and five[1] < 0.3), {"power_pu": five.tolist()})
    stays = own[0].power_pu[-200:].min(axis=0) > floor
    together = bool(stays.all() and np.ptp(inside / floor) < 1e-3)
    yield measured("decrease-coordinated", together, {"power_pu": inside.tolist()}, percent=100.0 * inside / available)


def _smaller_changes(key: str, changes: Sequence[Floats], **further: Any) -> Claim:
    """Measure whether the reference changes a quantity of both groups less than the deloaded strategies."""
    ours, *others = changes
    values = {name: change.tolist() for name, change in zip(_COMPARED, changes, strict=True)}
    return measured(key, bool((ours < np.minimum(*others)).all()), values, **further)


def _at(run: Trajectory, values: Floats, time_s: float) -> float:
    return float(np.interp(time_s, run.time_s, values))
