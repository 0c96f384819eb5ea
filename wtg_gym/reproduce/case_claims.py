"""The paper's claims on its two case studies, measured on the runs of this simulator."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

import numpy as np

from wtg_gym.physics.aerodynamics import available_power_pu, tracking_point
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGIES
from wtg_gym.physics.trajectory import Trajectory, simulate
from wtg_gym.reproduce.case_studies import CaseStudies
from wtg_gym.reproduce.claim import Claim, near

Runs = Mapping[str, Trajectory]

_INCREASE, _DECREASE = "load increase", "load decrease"
_of_increase, _of_decrease = (partial(Claim, source=source) for source in (_INCREASE, _DECREASE))
_DELOADED = ("deloaded-5", "deloaded-10")
#: The strategies that the paper compares; the reference comes first in all comparisons.
_COMPARED = (REFERENCE_STRATEGY, *_DELOADED)
#: Winds of the two groups [m/s].
_WINDS = (11.4, 8.0)
_EVENT_S, _SECOND_EVENT_S = 5.0, 30.0


def load_increase(runs: Runs) -> Iterable[Claim]:
    """Measure the claims on the load increase, without the settling times; `runs` by strategy."""
    reference = runs[REFERENCE_STRATEGY]
    end = float(reference.frequency_hz[-1] / reference.nominal_frequency_hz)
    says = "frequency settles at about 0.996"
    yield near("settles", _INCREASE, says, ("frequency_pu", end, 5), 0.996, 0.0005, "R")
    rotors, ratios = reference.rotor_speed_pu[-1].tolist(), reference.tip_speed_ratio[-1].tolist()
    least, most = (tracking_point(d).tip_speed_ratio for d in (0.0, 0.10))
    drift = float(np.ptp(reference.rotor_speed_pu[-200:], axis=0).max())
    yield _of_increase(
        key="stays-stable",
        says="coordinated: both groups stable, within their operating region",
        expected=f"λ_opt ≤ λ ≤ λ_pr ({least:.3f} … {most:.3f}), at rest in the end",
        measured=f"λ = {_texts(ratios)}, rotors at {_texts(rotors)} p.u., moving {drift:.0e} p.u. in the last 20 s",
        values={"tip_speed_ratio": ratios, "rotor_speed_pu": rotors},
        holds=reference.status == Status.RUNNING and all(least <= ratio <= most for ratio in ratios) and drift < 1e-4,
    )
    stalls = {name: float(runs[name].time_s[-1]) for name in ("mppt", *_DELOADED)}
    second_stalls = all(
        runs[name].status == Status.STALL and int(np.argmin(runs[name].tip_speed_ratio[-1])) == 1 for name in stalls
    )
    yield _of_increase(
        key="stalls",
        says="WTG 2 (8 m/s) stalls under MPPT, later under 5 %, last under 10 %",
        expected="30 s < t(mppt) < t(5 %) < t(10 %)",
        measured=", ".join(f"{name} {time:.1f} s" for name, time in stalls.items()),
        values={f"{name}_s": time for name, time in stalls.items()},
        holds=second_stalls and 30.0 < stalls["mppt"] < stalls["deloaded-5"] < stalls["deloaded-10"],
    )
    high = [float(runs[name].rotor_speed_pu[-1, 0]) for name in _DELOADED]
    yield _of_increase(
        key="right-of-mpp",
        says="WTG 1 (11.4 m/s) is then still right of its maximum power point",
        expected="ω_m > 1 p.u. under 5 and 10 %",
        measured=f"{high[0]:.3f}, {high[1]:.3f} p.u.",
        values={"rotor_speed_pu": high},
        holds=min(high) > 1.0,
    )
    yield from _first_event(runs)


def _first_event(runs: Runs) -> Iterable[Claim]:
    own = [runs[name] for name in _COMPARED]
    first = [run.time_s < _SECOND_EVENT_S for run in own]
    peak = [float(run.power_pu[seen, 0].max()) for run, seen in zip(own, first, strict=True)]
    yield _of_increase(
        key="larger-step",
        says="WTG 1: coordinated gives more power at first",
        expected="higher peak than both deloaded strategies",
        measured=f"{_against(peak)} p.u.",
        values={"peak_power_pu": peak},
        holds=peak[0] > max(peak[1:]),
    )
    falls = [float(run.rotor_speed_pu[0, 0]) - _at(run, run.rotor_speed_pu[:, 0], _EVENT_S + 1.0) for run in own]
    yield _of_increase(
        key="faster-rotor",
        says="WTG 1: coordinated slows its rotor down faster at first",
        expected="larger fall of ω_m in the first second",
        measured=f"{_against(falls, 4)} p.u.",
        values={"fall_pu": falls},
        holds=falls[0] > max(falls[1:]),
    )
    rocof = [-_at(run, run.rocof_hz_s(0.5), _EVENT_S + 0.5) for run in own]
    yield _of_increase(
        key="rocof",
        says="coordinated: the initial RoCoF is smaller",
        expected="smaller fall over 500 ms",
        measured=f"{_against(rocof, 4)} Hz/s",
        values={"rocof_hz_s": rocof},
        holds=rocof[0] < min(rocof[1:]),
        remark="Of the frequency of the centre of inertia.",
    )
    nadir = [float(run.frequency_hz[seen].min()) for run, seen in zip(own, first, strict=True)]
    yield _of_increase(
        key="nadir",
        says="coordinated: the nadir is slightly lower",
        expected="by less than 10 mHz",
        measured=f"{_against(nadir)} Hz",
        values={"nadir_hz": nadir},
        holds=all(0.0 < other - nadir[0] < 0.01 for other in nadir[1:]),
    )
    settled = [
        (run.rotor_speed_pu[0] - run.rotor_speed_pu[seen][-1]).tolist() for run, seen in zip(own, first, strict=True)
    ]
    dip = [float(np.ptp(run.rotor_speed_pu[seen, 0])) for run, seen in zip(own, first, strict=True)]
    yield _of_increase(
        key="narrow-range",
        says="coordinated: ω_m of both groups changes less from equilibrium to equilibrium",
        expected="smaller change after 25 s",
        measured=f"{_pairs_against(settled)} p.u.",
        values=dict(zip(_COMPARED, settled, strict=True)),
        holds=_both_smaller(settled),
        remark=f"On the way the rotor of WTG 1 dips a little deeper: {_against(dip)} p.u.",
    )


def settling(studies: CaseStudies) -> Claim:
    """Measure how long power and rotor of WTG 1 take to settle after the first event of the load increase."""
    scenario = dataclasses.replace(studies.increase, events=studies.increase.events[:1], duration_s=300.0)
    runs = [simulate(scenario, STRATEGIES[name]) for name in _COMPARED]
    power, rotor = (
        [_settling_time(run, getattr(run, quantity)[:, 0]) for run in runs]
        for quantity in ("power_pu", "rotor_speed_pu")
    )
    values = {f"{name}_power_pu_settling_s": time for name, time in zip(_COMPARED, power, strict=True)}
    values |= {f"{name}_rotor_speed_pu_settling_s": time for name, time in zip(_COMPARED, rotor, strict=True)}
    return _of_increase(
        key="settles-sooner",
        says="coordinated: power and rotor speed of WTG 1 settle sooner",
        expected="into 2 % of the final value, first event alone",
        measured=f"power {_against(power, 1)} s; rotor {_against(rotor, 1)} s",
        values=values,
        holds=all(times[0] < min(times[1:]) for times in (power, rotor)),
        remark="In a 1 % band the coordinated power, which follows the governor, takes longer than deloaded-5's.",
    )


def _settling_time(run: Trajectory, value: Floats) -> float:
    outside = np.flatnonzero(np.abs(value / value[-1] - 1.0) > 0.02)
    return float(run.time_s[outside[-1]]) - _EVENT_S if outside.size else 0.0


def load_decrease(runs: Runs) -> Iterable[Claim]:
    """Measure the claims on the load decrease; `runs` by strategy."""
    available = [float(available_power_pu(wind)) for wind in _WINDS]
    floor = [0.9 * power for power in available]
    own = [runs[name] for name in _COMPARED]
    inside, five, ten = (run.power_pu[-1].tolist() for run in own)
    rise = [(run.rotor_speed_pu.max(axis=0) - run.rotor_speed_pu[0]).tolist() for run in own]
    yield _of_decrease(
        key="rotor-rise",
        says="the deloaded strategies let the rotors accelerate much more",
        expected="larger rise of ω_m, both groups",
        measured=f"{_pairs_against(rise)} p.u.",
        values=dict(zip(_COMPARED, rise, strict=True)),
        holds=_both_smaller(rise),
        remark="The paper finds this most evident at 10 %. Here both rises are alike, but at 10 % they start at the "
        "edge of the range.",
    )
    yield _of_decrease(
        key="decrease-10",
        says="10 %: both groups end outside the regulation range",
        expected=f"below {floor[0]:.3f}, {floor[1]:.3f} p.u.",
        measured=f"{_texts(ten)} p.u.",
        values={"power_pu": ten},
        holds=all(end < limit for end, limit in zip(ten, floor, strict=True)),
    )
    yield _of_decrease(
        key="decrease-5",
        says="5 %: WTG 1 stays inside, WTG 2 ends below 0.3 p.u.",
        expected=f"above {floor[0]:.3f}, below 0.3 p.u.",
        measured=f"{_texts(five)} p.u.",
        values={"power_pu": five},
        holds=five[0] > floor[0] and five[1] < 0.3,
        fitted="R",
    )
    lowest = own[0].power_pu[-200:].min(axis=0)
    shares = [100 * inside[group] / (floor[group] / 0.9) for group in range(2)]
    yield _of_decrease(
        key="decrease-coordinated",
        says="coordinated: both groups end inside and share the regulation",
        expected=f"above {floor[0]:.3f}, {floor[1]:.3f} p.u., equal shares of the available power within 0.1 %",
        measured=f"{_texts(inside)} p.u., {shares[0]:.2f} and {shares[1]:.2f} %",
        values={"power_pu": inside},
        holds=bool((lowest > floor).all()) and abs(inside[0] / floor[0] - inside[1] / floor[1]) < 1e-3,
    )


def _at(run: Trajectory, values: Floats, time_s: float) -> float:
    return float(np.interp(time_s, run.time_s, values))


def _both_smaller(values: Sequence[Sequence[float]]) -> bool:
    """Whether the reference's value is the smallest in both groups."""
    return all(values[0][group] < min(values[1][group], values[2][group]) for group in range(2))


def _against(values: Sequence[float], digits: int = 3) -> str:
    return f"{values[0]:.{digits}f} against {values[1]:.{digits}f}, {values[2]:.{digits}f}"


def _pairs_against(values: Sequence[Sequence[float]]) -> str:
    return f"{_texts(values[0])} against {_texts(values[1])}, {_texts(values[2])}"


def _texts(values: Sequence[float]) -> str:
    return " / ".join(f"{value:.3f}" for value in values)
