"""The paper's claims, measured: texts are in reproduce.toml, figures in :mod:`wtg_gym.plotting.paper`."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from wtg_gym import single_wtg as wtg
from wtg_gym.files import read_toml
from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.parameters import GridFormingParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.scenarios import get_suite

#: The strategies that the paper compares; the reference comes first in all comparisons.
_COMPARED = (REFERENCE_STRATEGY, "deloaded-5", "deloaded-10")
#: Texts of every claim by its key.
TEXTS: dict[str, dict[str, Any]] = read_toml(Path(__file__).with_suffix(".toml"), "table of claims")
#: Recorded runs by strategy.
Runs = Mapping[str, Trajectory]


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
    target: float | None = None  # the expected number, where the claim is one number
    tolerance: float | None = None  # of that number


def _claim(key: str, holds: bool, values: Mapping[str, Any], **further: Any) -> Claim:
    """Return a claim as it was measured; its texts name `values`, and `further` numbers that are not kept."""
    texts = {name: TEXTS[key].get(name, "").format(**values, **further) for name in ("measured", "remark")}
    # The last digits depend on the machine.
    kept = {name: np.vectorize(lambda x: float(f"{x:.6g}"))(value).tolist() for name, value in values.items()}
    return Claim(key, **TEXTS[key] | texts, values=kept, holds=holds)


def _near(key: str, name: str, value: float) -> Claim:
    """Return the claim that a value is the paper's number within its tolerance; `name` ends in the unit."""
    return _claim(key, abs(value - TEXTS[key]["target"]) <= TEXTS[key]["tolerance"], {name: float(value)})


def _smaller(key: str, changes: Sequence[Floats], **further: Any) -> Claim:
    """Return the claim that the reference changes a quantity of both groups less than the deloaded strategies."""
    holds = bool((changes[0] < np.minimum(*changes[1:])).all())
    return _claim(key, holds, dict(zip(_COMPARED, map(np.ndarray.tolist, changes), strict=True)), **further)


def run_case(seed: int, on_progress: Callable[[str, float, int], None] = lambda *_: None) -> Runs:
    """Run a case study under every strategy: 0 is the load increase, 1 the load decrease."""
    scenario, runs = get_suite("paper").scenario(seed), dict[str, Trajectory]()
    for name, law in STRATEGIES.items():
        on_progress(f"{scenario.name}, {name}", len(runs), len(STRATEGIES))
        runs[name] = simulate(scenario, law)
    return runs


def paper_claims(increase: Runs, decrease: Runs) -> Iterator[Claim]:
    """Measure every claim of the paper, those on the case studies on their runs."""
    for name, deloading in (("opt", 0.0), ("n", 0.05), ("pr", 0.10)):
        yield _near(f"lambda-{name}", f"lambda_{name}", tracking_point(deloading).tip_speed_ratio)
    yield _near("cp-opt", "cp_opt", tracking_point(0.0).power_coefficient)
    yield from _fixed_strategies()
    yield from _coordination()
    yield from _stability()
    yield from load_increase(increase)
    yield _settling()
    yield from _load_decrease(decrease)


def _fixed_strategies() -> Iterator[Claim]:
    laws = (STRATEGIES[name] for name in ("mppt", *_COMPARED[1:]))
    mppt, five, ten = ([wtg.named_points(law, wind) for wind in wtg.WINDS] for law in laws)
    powers, limits = [p["B"].power_pu / p["A"].power_pu for p in mppt], [p["B"].frequency_pu for p in mppt]
    inverse = max(powers) < 1.0 and wtg.CONTROL.frequency_min_pu < limits[0] < limits[1]
    yield _claim("inverse-droop", inverse, {"power_ratio": powers, "critical_frequency_pu": limits})
    shares = [p["C"].power_pu / float(available_power_pu(wind)) for p, wind in zip(mppt, wtg.WINDS, strict=True)]
    falls = all(p["C"].power_pu < p["A"].power_pu and p["C"].rotor_speed_pu > p["A"].rotor_speed_pu for p in mppt)
    unequal = min(shares) < 1.0 - wtg.CONTROL.deloading_limit < max(shares)
    percent = [100.0 * share for share in shares]
    yield _claim("over-frequency", falls and unequal, {"share_at_frequency_max": shares}, percent=percent)
    rises = all(max(p["A"].power_pu, p["B"].power_pu) < p["M"].power_pu for p in five)
    lost, holds = five[1]["B"].frequency_pu, rises and five[1]["B"].frequency_pu > wtg.CONTROL.frequency_min_pu
    yield _claim("low-deloading", holds, {"critical_frequency_pu": lost}, high=five[0], low=five[1])
    ratio, crossing = ten[0]["B"].tip_speed_ratio, ten[0]["M"].frequency_pu if "M" in ten[0] else 0.0
    values = {"tip_speed_ratio": ratio, "crossing_frequency_pu": crossing}
    yield _claim("high-deloading-high-wind", ratio > tracking_point(0.0).tip_speed_ratio, values)
    lost, crossing = ten[1]["B"].frequency_pu, ten[1]["M"].frequency_pu
    values, holds = {"critical_frequency_pu": lost}, lost > wtg.CONTROL.frequency_min_pu
    yield _claim("high-deloading-low-wind", holds, values, crossing_frequency_pu=crossing)


def _coordination() -> Iterator[Claim]:
    # Above these winds the pitch protection sets in.
    law, winds = STRATEGIES[REFERENCE_STRATEGY], np.arange(4.0, 11.51, 0.5).tolist()
    worst = max(_share_error(wtg.CONTROL, wind) for wind in winds)
    yield _claim("coordination", worst < 1e-4, {"largest_deviation": worst}, percent=100.0 * worst)
    monotonic, frequencies = True, np.linspace(wtg.CONTROL.frequency_min_pu, wtg.CONTROL.frequency_max_pu, 33).tolist()
    for wind in winds:
        points = [wtg.equilibria(frequency, law, wind)[-1] for frequency in frequencies]
        power, rotor = np.array([(point.power_pu, point.rotor_speed_pu) for point in points]).T
        # At ω_min itself p has its maximum, so that its slope is zero there.
        monotonic &= bool((np.diff(power) < 0.0).all() and (np.diff(rotor) > 0.0).all())
    words = "strictly monotonic" if monotonic else "not monotonic"
    yield _claim("monotonic", monotonic, {"monotonic": float(monotonic)}, words=words)


def _share_error(control: GridFormingParameters, wind_m_s: float) -> float:
    """Return how far the captured shares at ω_min, ω_st and ω_max are from 100, 95 and 90 % [-]."""
    law, available = STRATEGIES[REFERENCE_STRATEGY], float(available_power_pu(wind_m_s))
    wanted = {control.frequency_min_pu: 1.0, control.frequency_setpoint_pu: 0.95, control.frequency_max_pu: 0.90}
    powers = {frequency: wtg.equilibria(frequency, law, wind_m_s, control=control)[-1].power_pu for frequency in wanted}
    return max(abs(powers[frequency] / available - share) for frequency, share in wanted.items())


def _stability() -> Iterator[Claim]:
    laws = (*(STRATEGIES[name] for name in (*_COMPARED[1:], "coordinated-linear")), wtg.LINEAR_UNDAMPED)
    ideal = wtg.ideal_source_loop().margins().phase_margin_deg
    *deloaded, damped, undamped = (wtg.single_machine(law, wtg.WINDS[0]).margins().phase_margin_deg for law in laws)
    yield _near("pm-ideal", "pm_deg", ideal)
    yield _claim("pm-deloaded", max(abs(margin - ideal) for margin in deloaded) <= 3.0, {"pm_deg": deloaded})
    yield _near("pm-undamped", "pm_deg", undamped)
    yield _near("pm-damped", "pm_deg", damped)
    # The coordinated law on droops of 8 … 0.8 % with other virtual inertia: statics, margins, and the load increase.
    law, winds, differences, errors, completed = STRATEGIES[REFERENCE_STRATEGY], (6.0, *wtg.WINDS), [], [], []
    for gain, inertia in itertools.product((12.5, 25.0, 62.5, 125.0), (0.5, 2.0, 5.0, 10.0)):
        control = GridFormingParameters(droop_gain_pu=gain, inertia_constant_s=inertia)
        errors += [_share_error(control, wind) for wind in winds]
        ideal = wtg.ideal_source_loop(control).margins().phase_margin_deg
        for wind, side in itertools.product(winds, wtg.SIDES):
            differences.append(
                wtg.single_machine(law, wind, side=side, control=control).margins().phase_margin_deg - ideal
            )
        # The stiffest droop on the least inertia is too fast for steps of 25 ms.
        run = simulate(get_suite("paper").scenario(0), law, Plant(control=control, simulation_dt=0.005))
        completed.append(run.status == Status.RUNNING)
    stable, worst, n_loops = [each for each in differences if not math.isnan(each)], max(errors), len(differences)
    values = {"margin_difference_deg": stable, "largest_deviation": worst, "completed_runs": float(sum(completed))}
    counts = {"n_stable": len(stable), "n_loops": n_loops, "n_runs": len(completed), "percent": 100.0 * worst}
    holds = worst < 1e-4 and len(stable) == n_loops and all(completed)
    yield _claim("compatible", holds, values, **counts, least_deg=min(stable), most_deg=max(stable))


def load_increase(runs: Runs) -> Iterator[Claim]:
    """Measure the claims on the load increase, without the settling times."""
    reference, compared, deloaded = runs[REFERENCE_STRATEGY], [runs[name] for name in _COMPARED], _COMPARED[1:]
    yield _near("settles", "frequency_pu", float(reference.frequency_hz[-1] / reference.nominal_frequency_hz))
    rotors, ratios = reference.rotor_speed_pu[-1], reference.tip_speed_ratio[-1]
    least, most = (tracking_point(d).tip_speed_ratio for d in (0.0, 0.10))
    drift = float(np.ptp(reference.rotor_speed_pu[-200:], axis=0).max())
    stays = reference.status == Status.RUNNING and bool(((least <= ratios) & (ratios <= most)).all()) and drift < 1e-4
    yield _claim("stays-stable", stays, {"tip_speed_ratio": ratios, "rotor_speed_pu": rotors}, drift_pu=drift)
    ended = {f"{name}_s": runs[name] for name in ("mppt", *deloaded)}
    times = {name: float(run.time_s[-1]) for name, run in ended.items()}
    second = all(run.status == Status.STALL and np.argmin(run.tip_speed_ratio[-1]) == 1 for run in ended.values())
    yield _claim("stalls", second and bool((np.diff([30.0, *times.values()]) > 0.0).all()), times)
    high = [float(runs[name].rotor_speed_pu[-1, 0]) for name in deloaded]
    yield _claim("right-of-mpp", min(high) > 1.0, {"rotor_speed_pu": high})
    # The first event comes at 5 s, the second at 30 s.
    n = [int((run.time_s < 30.0).sum()) for run in compared]
    rotor = [run.rotor_speed_pu[:end] for run, end in zip(compared, n, strict=True)]
    peak = [float(run.power_pu[:end, 0].max()) for run, end in zip(compared, n, strict=True)]
    fall = [float(run.rotor_speed_pu[0, 0] - np.interp(6.0, run.time_s, run.rotor_speed_pu[:, 0])) for run in compared]
    rocof = [-float(np.interp(5.5, run.time_s, run.rocof_hz_s(0.5))) for run in compared]
    nadir = [float(run.frequency_hz[:end].min()) for run, end in zip(compared, n, strict=True)]
    yield _claim("larger-step", peak[0] > max(peak[1:]), {"peak_power_pu": peak})
    yield _claim("faster-rotor", fall[0] > max(fall[1:]), {"fall_pu": fall})
    yield _claim("rocof", rocof[0] < min(rocof[1:]), {"rocof_hz_s": rocof})
    yield _claim("nadir", all(0.0 < other - nadir[0] < 0.01 for other in nadir[1:]), {"nadir_hz": nadir})
    dips = [float(np.ptp(speed[:, 0])) for speed in rotor]
    yield _smaller("narrow-range", [speed[0] - speed[-1] for speed in rotor], dip_pu=dips)


def _settling() -> Claim:
    """Measure how long power and rotor of WTG 1 take to settle after the first event, at 5 s, of the load increase."""
    scenario = get_suite("paper").scenario(0)
    scenario = dataclasses.replace(scenario, events=scenario.events[:1], duration_s=300.0)
    runs, values, sooner = {name: simulate(scenario, STRATEGIES[name]) for name in _COMPARED}, dict[str, float](), True
    for quantity in ("power_pu", "rotor_speed_pu"):
        times = []
        for name, run in runs.items():
            series = getattr(run, quantity)[:, 0]
            outside = run.time_s[np.abs(series / series[-1] - 1.0) > 0.02]
            times.append(float(outside.max(initial=5.0)) - 5.0)
            values[f"{name}_{quantity}_settling_s"] = times[-1]
        sooner &= times[0] < min(times[1:])
    return _claim("settles-sooner", sooner, values)


def _load_decrease(runs: Runs) -> Iterator[Claim]:
    available = np.array([float(available_power_pu(wind)) for wind in wtg.WINDS])
    floor, compared = 0.9 * available, [runs[name] for name in _COMPARED]
    yield _smaller("rotor-rise", [run.rotor_speed_pu.max(axis=0) - run.rotor_speed_pu[0] for run in compared])
    inside, five, ten = (run.power_pu[-1] for run in compared)
    yield _claim("decrease-10", bool((ten < floor).all()), {"power_pu": ten})
    yield _claim("decrease-5", bool(five[0] > floor[0] and five[1] < 0.3), {"power_pu": five})
    stays = compared[0].power_pu[-200:].min(axis=0) > floor
    together = bool(stays.all() and np.ptp(inside / floor) < 1e-3)
    yield _claim("decrease-coordinated", together, {"power_pu": inside}, percent=100.0 * inside / available)
