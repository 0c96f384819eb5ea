"""The paper's two case studies, run, and measurements of the claims on them; the texts are in claims.toml."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import numpy as np

from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.reproduce.claims import Claim, measured, near
from wtg_gym.reproduce.theory import WINDS, claims_of_theory
from wtg_gym.scenarios import get_suite

#: Recorded runs by strategy.
Runs = Mapping[str, Trajectory]

_DELOADED = ("deloaded-5", "deloaded-10")
#: The strategies that the paper compares; the reference comes first in all comparisons.
_COMPARED = (REFERENCE_STRATEGY, *_DELOADED)
_EVENT_S, _SECOND_EVENT_S = 5.0, 30.0


def run_case(seed: int, on_progress: Callable[[str, float, int], None] = lambda *_: None) -> Runs:
    """Run a case study under every strategy: 0 is the load increase, 1 the load decrease."""
    scenario = get_suite("paper").scenario(seed)
    runs: dict[str, Trajectory] = {}
    for name, law in STRATEGIES.items():
        on_progress(f"{scenario.name}, {name}", len(runs), len(STRATEGIES))
        runs[name] = simulate(scenario, law)
    return runs


def paper_claims(increase: Runs, decrease: Runs) -> tuple[Claim, ...]:
    """Measure every claim of the paper, those on the case studies on their runs."""
    return (*claims_of_theory(), *load_increase(increase), _settling(), *_load_decrease(decrease))


def load_increase(runs: Runs) -> Iterator[Claim]:
    """Measure the claims on the load increase, without the settling times."""
    reference = runs[REFERENCE_STRATEGY]
    yield near("settles", "frequency_pu", float(reference.frequency_hz[-1] / reference.nominal_frequency_hz), 5)
    rotors, ratios = reference.rotor_speed_pu[-1].tolist(), reference.tip_speed_ratio[-1].tolist()
    least, most = (tracking_point(d).tip_speed_ratio for d in (0.0, 0.10))
    drift = float(np.ptp(reference.rotor_speed_pu[-200:], axis=0).max())
    yield measured(
        "stays-stable",
        f"λ = {_texts(ratios)}, rotors at {_texts(rotors)} p.u., moving {drift:.0e} p.u. in the last 20 s",
        {"tip_speed_ratio": ratios, "rotor_speed_pu": rotors},
        reference.status == Status.RUNNING and all(least <= ratio <= most for ratio in ratios) and drift < 1e-4,
    )
    ended = {name: runs[name] for name in ("mppt", *_DELOADED)}
    stalls = {name: float(run.time_s[-1]) for name, run in ended.items()}
    second = all(run.status == Status.STALL and np.argmin(run.tip_speed_ratio[-1]) == 1 for run in ended.values())
    yield measured(
        "stalls",
        ", ".join(f"{name} {time:.1f} s" for name, time in stalls.items()),
        {f"{name}_s": time for name, time in stalls.items()},
        second and _SECOND_EVENT_S < stalls["mppt"] < stalls["deloaded-5"] < stalls["deloaded-10"],
    )
    high = [float(runs[name].rotor_speed_pu[-1, 0]) for name in _DELOADED]
    yield measured("right-of-mpp", f"{high[0]:.3f}, {high[1]:.3f} p.u.", {"rotor_speed_pu": high}, min(high) > 1.0)
    yield from _first_event([runs[name] for name in _COMPARED])


def _first_event(runs: Sequence[Trajectory]) -> Iterator[Claim]:
    """Measure the claims on the first event, on runs of the compared strategies."""
    first = [run.time_s < _SECOND_EVENT_S for run in runs]
    peak = [float(run.power_pu[seen, 0].max()) for run, seen in zip(runs, first, strict=True)]
    fall = [float(run.rotor_speed_pu[0, 0]) - _at(run, run.rotor_speed_pu[:, 0], _EVENT_S + 1.0) for run in runs]
    rocof = [-_at(run, run.rocof_hz_s(0.5), _EVENT_S + 0.5) for run in runs]
    nadir = [float(run.frequency_hz[seen].min()) for run, seen in zip(runs, first, strict=True)]
    slightly_lower = all(0.0 < other - nadir[0] < 0.01 for other in nadir[1:])
    yield measured("larger-step", f"{_against(peak)} p.u.", {"peak_power_pu": peak}, peak[0] > max(peak[1:]))
    yield measured("faster-rotor", f"{_against(fall, 4)} p.u.", {"fall_pu": fall}, fall[0] > max(fall[1:]))
    yield measured("rocof", f"{_against(rocof, 4)} Hz/s", {"rocof_hz_s": rocof}, rocof[0] < min(rocof[1:]))
    yield measured("nadir", f"{_against(nadir)} Hz", {"nadir_hz": nadir}, slightly_lower)
    settled = [(run.rotor_speed_pu[0] - run.rotor_speed_pu[seen][-1]) for run, seen in zip(runs, first, strict=True)]
    dip = [float(np.ptp(run.rotor_speed_pu[seen, 0])) for run, seen in zip(runs, first, strict=True)]
    yield _smaller_changes("narrow-range", settled, _against(dip))


def _settling() -> Claim:
    """Measure how long power and rotor of WTG 1 take to settle after the first event of the load increase."""
    scenario = get_suite("paper").scenario(0)
    scenario = dataclasses.replace(scenario, events=scenario.events[:1], duration_s=300.0)
    runs = [simulate(scenario, STRATEGIES[name]) for name in _COMPARED]
    power = [_settling_time(run, run.power_pu[:, 0]) for run in runs]
    rotor = [_settling_time(run, run.rotor_speed_pu[:, 0]) for run in runs]
    values = {f"{name}_power_pu_settling_s": time for name, time in zip(_COMPARED, power, strict=True)}
    values |= {f"{name}_rotor_speed_pu_settling_s": time for name, time in zip(_COMPARED, rotor, strict=True)}
    sooner = all(times[0] < min(times[1:]) for times in (power, rotor))
    return measured("settles-sooner", f"power {_against(power, 1)} s; rotor {_against(rotor, 1)} s", values, sooner)


def _settling_time(run: Trajectory, value: Floats) -> float:
    outside = np.flatnonzero(np.abs(value / value[-1] - 1.0) > 0.02)
    return float(run.time_s[outside[-1]]) - _EVENT_S if outside.size else 0.0


def _load_decrease(runs: Runs) -> Iterator[Claim]:
    """Measure the claims on the load decrease."""
    floor = [0.9 * float(available_power_pu(wind)) for wind in WINDS]
    own = [runs[name] for name in _COMPARED]
    yield _smaller_changes("rotor-rise", [run.rotor_speed_pu.max(axis=0) - run.rotor_speed_pu[0] for run in own])
    inside, five, ten = (run.power_pu[-1].tolist() for run in own)
    outside = all(end < limit for end, limit in zip(ten, floor, strict=True))
    yield measured("decrease-10", f"{_texts(ten)} p.u.", {"power_pu": ten}, outside)
    apart = five[0] > floor[0] and five[1] < 0.3
    yield measured("decrease-5", f"{_texts(five)} p.u.", {"power_pu": five}, apart)
    lowest = own[0].power_pu[-200:].min(axis=0)
    shares = [100 * inside[group] / (floor[group] / 0.9) for group in range(2)]
    yield measured(
        "decrease-coordinated",
        f"{_texts(inside)} p.u., {shares[0]:.2f} and {shares[1]:.2f} %",
        {"power_pu": inside},
        bool((lowest > floor).all()) and abs(inside[0] / floor[0] - inside[1] / floor[1]) < 1e-3,
    )


def _smaller_changes(key: str, changes: Sequence[Floats], in_remark: str = "") -> Claim:
    """Measure whether the reference changes a quantity of both groups less than the deloaded strategies."""
    ours, *others = changes
    text = f"{_texts(ours)} against {', '.join(map(_texts, others))} p.u."
    values = {name: change.tolist() for name, change in zip(_COMPARED, changes, strict=True)}
    return measured(key, text, values, bool((ours < np.minimum(*others)).all()), in_remark)


def _at(run: Trajectory, values: Floats, time_s: float) -> float:
    return float(np.interp(time_s, run.time_s, values))


def _against(values: Sequence[float], digits: int = 3) -> str:
    return f"{values[0]:.{digits}f} against {values[1]:.{digits}f}, {values[2]:.{digits}f}"


def _texts(values: Iterable[float]) -> str:
    return " / ".join(f"{value:.3f}" for value in values)
