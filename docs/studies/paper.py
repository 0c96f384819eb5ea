"""For docs/validation.md: every claim of the paper measured, steady states and case studies drawn; two minutes.

paper.toml has the texts and tolerances of the claims.

In steady state a rotor captures what its law delivers, p_w(ω_m) = g(ω) ω_m³ - D_p (ω - ω_st), the last term only where
the law keeps its droop (τ = ∞). Blades are at fine pitch. On an infinite bus the open loop is (paper, (31)-(34))

    G(s) = ω_n K_p (2H_m s + B1 - A) / (s [2H s - B2 + D(s)] (2H_m s - A)),    D(s) = D_p τ s/(τ s + 1)

with D = D_p for τ = ∞, D = 0 for τ = 0, and A = B1 = B2 = 0 on an ideal DC source.
"""

import dataclasses
import itertools
import math
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from output import DOCS
from scipy.optimize import brentq, minimize_scalar

from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.aerodynamics import available_power_pu, power_coefficient, tracking_point
from wtg_gym.physics.converter import converter_constants, tracking_coefficient
from wtg_gym.physics.parameters import GridFormingParameters, TurbineParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.tracking_law import LAWS, REFERENCE_LAW
from wtg_gym.physics.trajectory import simulate
from wtg_gym.plotting import plot_trajectories, save_figure, style
from wtg_gym.scenarios import get_suite

TURBINE, CONTROL = TurbineParameters(), GridFormingParameters()
CORNERS = (CONTROL.frequency_min_pu, CONTROL.frequency_setpoint_pu, CONTROL.frequency_max_pu)
WINDS = (11.4, 8.0)  # of the two groups of the case studies [m/s]
K_P = 1.45  # synchronising coefficient V V_g cos δ_0/X_g at which the paper's margins come out [p.u./rad]
LINEAR = LAWS["coordinated-linear"]
#: The loop whose margin the paper gives as about 28°.
UNDAMPED = dataclasses.replace(LINEAR, name="coordinated-linear-undamped", damping_time_constant_s=0.0)
COMPARED = (REFERENCE_LAW, "deloaded-5", "deloaded-10")
LEAST_RATIO, RATIO_STEP = 1.0, 0.1  # tip-speed ratios of the search for equilibria [-]
NOMINAL_HZ = 50.0
ANGULAR_FREQUENCY = 2.0 * math.pi * NOMINAL_HZ
TEXTS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


class OperatingPoint(NamedTuple):
    """A steady state of one WTG."""

    frequency_pu: float
    rotor_speed_pu: float
    tip_speed_ratio: float
    power_pu: float
    stable: bool  # a faster rotor captures less than it delivers, so that it comes back


class Balance:
    """Captured minus delivered power over the rotor speed, at one frequency, law and wind."""

    def __init__(self, frequency_pu, law, wind_m_s, control=CONTROL):
        self.frequency_pu = frequency_pu
        corners = converter_constants(control).corners
        self.k = tracking_coefficient(frequency_pu, law.k_min, law.k_nominal, law.k_max, corners)
        deviation = frequency_pu - control.frequency_setpoint_pu
        self.droop = control.droop_gain_pu * deviation if math.isinf(law.damping_time_constant_s) else 0.0
        self.in_wind = TURBINE.wind_power_pu_per_cubic_wind * wind_m_s**3
        self.ratio_per_speed = TURBINE.tip_speed_ratio_per_speed_m_s / wind_m_s
        # A rotor so fast that the law takes more than the wind holds leaves a deficit for certain.
        most = (max(self.droop, 0.0) + float(available_power_pu(wind_m_s))) / self.k
        self.slowest = LEAST_RATIO / self.ratio_per_speed
        self.fastest = max(self.slowest, 1.01 * most ** (1.0 / 3.0))

    def captured(self, speed):
        return self.in_wind * power_coefficient(self.ratio_per_speed * np.asarray(speed))

    def delivered(self, speed):
        return self.k * speed**3 - self.droop

    def surplus(self, speed):
        return self.captured(speed) - self.delivered(speed)

    def samples(self):
        """Return rotor speeds that tell all equilibria apart; without any surplus, that of the least deficit too."""
        n = 2 + int((self.fastest - self.slowest) * self.ratio_per_speed / RATIO_STEP)
        speeds = np.linspace(self.slowest, self.fastest, n)
        surplus = self.surplus(speeds)
        peak = int(np.argmax(surplus))
        if surplus[peak] > 0.0:
            return speeds
        bounds, options = (speeds[max(peak - 1, 0)], speeds[min(peak + 1, n - 1)]), {"xatol": 1e-11}
        best = minimize_scalar(lambda x: -float(self.surplus(x)), bounds=bounds, method="bounded", options=options)
        return np.unique(np.append(speeds, best.x))

    def at(self, speed, stable=True):
        return OperatingPoint(self.frequency_pu, speed, self.ratio_per_speed * speed, self.delivered(speed), stable)


def equilibria(frequency_pu, law, wind_m_s, control=CONTROL):
    """Return every steady state of a WTG by rising rotor speed; that of a running WTG is the last."""
    balance = Balance(frequency_pu, law, wind_m_s, control)
    speeds = balance.samples()
    positive = balance.surplus(speeds) > 0.0
    points = []
    for i in np.flatnonzero(positive[:-1] != positive[1:]):
        root = brentq(lambda x: float(balance.surplus(x)), speeds[i], speeds[i + 1], xtol=1e-14, rtol=1e-14)
        points.append(balance.at(float(root), bool(positive[i])))
    return points


def critical_frequency_pu(law, wind_m_s):
    """Return the frequency at which a WTG loses its equilibrium, from ω_st down to ω_min, or None."""

    def margin(frequency):
        balance = Balance(frequency, law, wind_m_s)
        return float(balance.surplus(balance.samples()).max())

    return None if margin(CORNERS[0]) >= 0.0 else float(brentq(margin, *CORNERS[:2], xtol=1e-13))


def named_points(law, wind_m_s):
    """Return the points that the paper names on a power-frequency characteristic, those that exist.

    A: at ω_st. B: at ω_min, or where the equilibrium is lost if that comes first. C: at ω_max. M: where the stable
    branch passes the maximum power point on the way from A to B.
    """
    lowest, nominal, highest = CORNERS
    corners = {"A": nominal, "B": lowest, "C": highest}
    points = {name: states[-1] for name, f in corners.items() if (states := equilibria(f, law, wind_m_s))}
    if (critical := critical_frequency_pu(law, wind_m_s)) is not None:
        # The two branches meet there, so that neither has a root; the surplus has its maximum at that speed.
        lost = Balance(critical, law, wind_m_s)
        points["B"] = lost.at(float(max(lost.samples(), key=lost.surplus)))
    best_speed = tracking_point().tip_speed_ratio * wind_m_s / TURBINE.tip_speed_ratio_per_speed_m_s

    def surplus(frequency):
        return float(Balance(frequency, law, wind_m_s).surplus(best_speed))

    # A rotor with a surplus at λ_opt stands above it, one with a deficit below.
    if surplus(nominal) > 1e-12 and surplus(lowest) <= -1e-12:
        crossing = float(brentq(surplus, lowest, nominal, xtol=1e-14))
        points["M"] = Balance(crossing, law, wind_m_s).at(best_speed)
    return points


@style.printed
def characteristic(law):
    """Draw what a WTG captures over its rotor speed, and power and rotor speed over the frequency, in steady state."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 62.0)
    over_speed, *over_frequency = figure.subplots(1, 3)
    frequencies, speeds = np.linspace(CORNERS[0], CORNERS[2], 41), np.linspace(0.05, 1.45, 141)
    for group, (wind, colour) in enumerate(zip(WINDS, style.PALETTE, strict=False), 1):
        balances = [Balance(frequency, law, wind) for frequency in CORNERS]
        for balance in balances:
            over_speed.plot(speeds, balance.delivered(speeds), color=style.REFERENCE_GREY, linewidth=0.7)
        over_speed.plot(speeds, balances[0].captured(speeds), color=colour, label=f"{group}: {wind:g} m/s")
        states = [equilibria(frequency, law, wind) for frequency in frequencies]
        named = named_points(law, wind)
        for dashes, at in (("-", -1), ("--", -2)):
            # Both branches meet in B where it is above ω_min.
            branch = [named["B"]] * (named["B"].frequency_pu > CORNERS[0])
            branch += [points[at] for points in states if len(points) >= -at]
            hz = [NOMINAL_HZ * point.frequency_pu for point in branch]
            for axes, quantity in zip(over_frequency, ("power_pu", "rotor_speed_pu"), strict=True):
                axes.plot(hz, [getattr(point, quantity) for point in branch], color=colour, linestyle=dashes)
        for name, point in named.items():
            hz, text = NOMINAL_HZ * point.frequency_pu, {"text": f"{name}$_{group}$", "textcoords": "offset points"}
            text["xytext"] = {"B": (-9.0, 4.0), "C": (2.0, -10.0)}.get(name, (2.0, 4.0))
            places = (point.rotor_speed_pu, point.power_pu), (hz, point.power_pu), (hz, point.rotor_speed_pu)
            for axes, place in zip(figure.axes, places, strict=True):
                axes.plot(*place, "o", color=colour, markersize=4.0)
                axes.annotate(xy=place, color=colour, fontsize=style.SMALL_PT, **text)
    over_speed.set(xlabel="rotor speed [p.u.]", ylim=(0.0, 1.4))
    titles = ("captured power [p.u.]", "power [p.u.]", "rotor speed [p.u.]")
    for letter, axes, title in zip("abc", figure.axes, titles, strict=True):
        style.letter_panel(axes, letter, title)
    for axes in over_frequency:
        axes.set(xlabel="frequency [Hz]", xlim=(49.5, 50.46), ylim=(0.0, None))
    figure.legend(loc="outside lower center", ncols=2)
    return figure


class Loop(NamedTuple):
    """An open loop G(s)."""

    numerator: Polynomial
    denominator: Polynomial

    def response(self, angular_frequency):
        """Return G(jΩ)."""
        s = 1j * np.asarray(angular_frequency, dtype=np.float64)
        return np.asarray(self.numerator(s) / self.denominator(s))

    def closed_loop_poles(self):
        """Return the zeros of 1 + G(s) [1/s]."""
        return (self.numerator + self.denominator).roots().astype(np.complex128)

    def phase_margin_deg(self):
        """Return the smallest phase margin over all gain crossovers; NaN where the closed loop is unstable.

        Crossovers are roots of a polynomial, so that none is missed.
        """
        if (self.closed_loop_poles().real >= 0.0).any():
            return math.nan
        roots = (squared(self.numerator) - squared(self.denominator)).trim().roots().astype(np.complex128)
        real = (np.abs(roots.imag) < 1e-7 * np.maximum(np.abs(roots), 1e-12)) & (roots.real > 1e-9)
        # The loop's phase lies between -90° and -270° there: measured from -180°, upwards.
        return float(np.degrees(np.angle(-self.response(roots.real[real]))).min(initial=math.inf))


def squared(part):
    """Return |P(jΩ)|² of a polynomial P(s), as a polynomial in Ω."""
    on_axis = np.asarray(part.coef, dtype=np.complex128) * 1j ** np.arange(part.coef.size)
    return Polynomial((Polynomial(on_axis) * Polynomial(on_axis.conj())).coef.real)


def single_machine(law, wind_m_s, k_p=K_P, side="under", control=CONTROL):
    """Return the linearised loop of a strategy at 50 Hz, where the pitch protection does not act."""
    setpoint = control.frequency_setpoint_pu
    point = equilibria(setpoint, law, wind_m_s, control)[-1]
    rotor, step = point.rotor_speed_pu, 1e-5
    low, high = power_coefficient(point.tip_speed_ratio * np.array([1.0 - step, 1.0 + step]))
    slopes = {
        "under": (law.k_nominal - law.k_min) / (setpoint - control.frequency_min_pu),
        "over": (law.k_max - law.k_nominal) / (control.frequency_max_pu - setpoint),
    }
    # A = ∂p_w/∂ω_m, B1 = ∂P_st/∂ω_m and B2 = ∂P_st/∂ω [p.u./p.u.].
    a = TURBINE.wind_power_pu_per_cubic_wind * wind_m_s**3 * float(high - low) / (2.0 * step * rotor)
    b1, b2 = 3.0 * law.k_nominal * rotor**2, slopes[side] * rotor**3
    s, tau = Polynomial([0.0, 1.0]), law.damping_time_constant_s
    rotor_dynamics = 2.0 * TURBINE.inertia_constant_s * s - a
    swing = 2.0 * control.inertia_constant_s * s - b2
    if math.isinf(tau):
        swing, filtered = swing + control.droop_gain_pu, Polynomial([1.0])
    else:
        filtered = tau * s + 1.0
        swing = swing * filtered + control.droop_gain_pu * tau * s
    numerator = ANGULAR_FREQUENCY * k_p * (rotor_dynamics + b1) * filtered
    return Loop(numerator.trim(), (s * swing * rotor_dynamics).trim())


def ideal_source_loop(control=CONTROL):
    """Return the loop of grid-forming control on an ideal DC source, without rotor and wind (paper, G_GFM)."""
    numerator = Polynomial([ANGULAR_FREQUENCY * K_P])
    return Loop(numerator, Polynomial([0.0, control.droop_gain_pu, 2.0 * control.inertia_constant_s]))


def claim(key, holds, **values):
    """Return a claim as it was measured; its texts name the values."""
    texts = {name: TEXTS[key].get(name, "").format(**values) for name in ("measured", "remark")}
    return {"key": key, "fitted": "", **TEXTS[key], **texts, "holds": bool(holds)}


def near(key, name, value):
    """Return the claim that a value is the paper's number within its tolerance; `name` ends in the unit."""
    return claim(key, abs(value - TEXTS[key]["target"]) <= TEXTS[key]["tolerance"], **{name: value})


def smaller(key, changes, **further):
    """Return the claim that the reference changes a quantity of both groups less than the deloaded strategies."""
    values = dict(zip(COMPARED, changes, strict=True))
    return claim(key, (changes[0] < np.minimum(*changes[1:])).all(), **values, **further)


def run_case(seed):
    """Run a case study under every strategy: 0 is the load increase, 1 the load decrease."""
    return {name: simulate(get_suite("paper").scenario(seed), law) for name, law in LAWS.items()}


def paper_claims(increase, decrease):
    """Measure every claim of the paper, those on the case studies on their runs."""
    for name, deloading in (("opt", 0.0), ("n", 0.05), ("pr", 0.10)):
        yield near(f"lambda-{name}", f"lambda_{name}", tracking_point(deloading).tip_speed_ratio)
    yield near("cp-opt", "cp_opt", tracking_point(0.0).power_coefficient)
    yield from fixed_strategies()
    yield from coordination()
    yield from stability()
    yield from load_increase(increase)
    yield settling()
    yield from load_decrease(decrease)


def fixed_strategies():
    laws = (LAWS[name] for name in ("mppt", *COMPARED[1:]))
    mppt, five, ten = ([named_points(law, wind) for wind in WINDS] for law in laws)
    powers, limits = [p["B"].power_pu / p["A"].power_pu for p in mppt], [p["B"].frequency_pu for p in mppt]
    inverse = max(powers) < 1.0 and CORNERS[0] < limits[0] < limits[1]
    yield claim("inverse-droop", inverse, power_ratio=powers, critical_frequency_pu=limits)
    shares = [p["C"].power_pu / float(available_power_pu(wind)) for p, wind in zip(mppt, WINDS, strict=True)]
    falls = all(p["C"].power_pu < p["A"].power_pu and p["C"].rotor_speed_pu > p["A"].rotor_speed_pu for p in mppt)
    unequal = min(shares) < 1.0 - CONTROL.deloading_limit < max(shares)
    yield claim("over-frequency", falls and unequal, percent=[100.0 * share for share in shares])
    rises = all(max(p["A"].power_pu, p["B"].power_pu) < p["M"].power_pu for p in five)
    lost = five[1]["B"].frequency_pu
    holds = rises and lost > CORNERS[0]
    yield claim("low-deloading", holds, critical_frequency_pu=lost, high=five[0], low=five[1])
    ratio, crossing = ten[0]["B"].tip_speed_ratio, ten[0]["M"].frequency_pu if "M" in ten[0] else 0.0
    right = ratio > tracking_point(0.0).tip_speed_ratio
    yield claim("high-deloading-high-wind", right, tip_speed_ratio=ratio, crossing_frequency_pu=crossing)
    lost, crossing = ten[1]["B"].frequency_pu, ten[1]["M"].frequency_pu
    values = {"critical_frequency_pu": lost, "crossing_frequency_pu": crossing}
    yield claim("high-deloading-low-wind", lost > CORNERS[0], **values)


def coordination():
    # Above these winds the pitch protection sets in.
    law, winds = LAWS[REFERENCE_LAW], np.arange(4.0, 11.51, 0.5).tolist()
    worst = max(share_error(CONTROL, wind) for wind in winds)
    yield claim("coordination", worst < 1e-4, percent=100.0 * worst)
    monotonic, frequencies = True, np.linspace(CORNERS[0], CORNERS[2], 33).tolist()
    for wind in winds:
        points = [equilibria(frequency, law, wind)[-1] for frequency in frequencies]
        power, rotor = np.array([(point.power_pu, point.rotor_speed_pu) for point in points]).T
        # At ω_min itself p has its maximum, so that its slope is zero there.
        monotonic &= bool((np.diff(power) < 0.0).all() and (np.diff(rotor) > 0.0).all())
    yield claim("monotonic", monotonic, words="strictly monotonic" if monotonic else "not monotonic")


def share_error(control, wind_m_s):
    """Return how far the captured shares at ω_min, ω_st and ω_max are from 100, 95 and 90 %."""
    law, available = LAWS[REFERENCE_LAW], float(available_power_pu(wind_m_s))
    shares = [equilibria(frequency, law, wind_m_s, control)[-1].power_pu / available for frequency in CORNERS]
    return float(np.abs(np.subtract(shares, (1.0, 0.95, 0.90))).max())


def stability():
    laws = (*(LAWS[name] for name in COMPARED[1:]), LINEAR, UNDAMPED)
    ideal = ideal_source_loop().phase_margin_deg()
    *deloaded, damped, undamped = (single_machine(law, WINDS[0]).phase_margin_deg() for law in laws)
    yield near("pm-ideal", "pm_deg", ideal)
    yield claim("pm-deloaded", max(abs(margin - ideal) for margin in deloaded) <= 3.0, pm_deg=deloaded)
    yield near("pm-undamped", "pm_deg", undamped)
    yield near("pm-damped", "pm_deg", damped)
    # The coordinated law on droops of 8 … 0.8 % with other virtual inertia: statics, margins, and the load increase.
    law, winds, differences, errors, completed = LAWS[REFERENCE_LAW], (6.0, *WINDS), [], [], []
    for gain, inertia in itertools.product((12.5, 25.0, 62.5, 125.0), (0.5, 2.0, 5.0, 10.0)):
        control = GridFormingParameters(droop_gain_pu=gain, inertia_constant_s=inertia)
        errors += [share_error(control, wind) for wind in winds]
        ideal = ideal_source_loop(control).phase_margin_deg()
        for wind, side in itertools.product(winds, ("under", "over")):
            loop = single_machine(law, wind, side=side, control=control)
            differences.append(loop.phase_margin_deg() - ideal)
        # The stiffest droop on the least inertia is too fast for steps of 25 ms.
        run = simulate(get_suite("paper").scenario(0), law, Plant(control=control, simulation_dt=0.005))
        completed.append(run.status == Status.RUNNING)
    stable, worst, n_loops = [d for d in differences if not math.isnan(d)], max(errors), len(differences)
    counts = {"n_stable": len(stable), "n_loops": n_loops, "completed_runs": sum(completed), "n_runs": len(completed)}
    holds = worst < 1e-4 and len(stable) == n_loops and all(completed)
    percent = 100.0 * worst
    yield claim("compatible", holds, **counts, percent=percent, least_deg=min(stable), most_deg=max(stable))


def load_increase(runs):
    """Measure the claims on the load increase, without the settling times."""
    reference, compared, deloaded = runs[REFERENCE_LAW], [runs[name] for name in COMPARED], COMPARED[1:]
    yield near("settles", "frequency_pu", float(reference.frequency_hz[-1] / reference.nominal_frequency_hz))
    rotors, ratios = reference.rotor_speed_pu[-1], reference.tip_speed_ratio[-1]
    least, most = (tracking_point(d).tip_speed_ratio for d in (0.0, 0.10))
    drift = float(np.ptp(reference.rotor_speed_pu[-200:], axis=0).max())
    stays = reference.status == Status.RUNNING and ((least <= ratios) & (ratios <= most)).all() and drift < 1e-4
    yield claim("stays-stable", stays, tip_speed_ratio=ratios, rotor_speed_pu=rotors, drift_pu=drift)
    ended = {f"{name}_s": runs[name] for name in ("mppt", *deloaded)}
    times = {name: float(run.time_s[-1]) for name, run in ended.items()}
    second = all(run.status == Status.STALL and np.argmin(run.tip_speed_ratio[-1]) == 1 for run in ended.values())
    yield claim("stalls", second and (np.diff([30.0, *times.values()]) > 0.0).all(), **times)
    high = [float(runs[name].rotor_speed_pu[-1, 0]) for name in deloaded]
    yield claim("right-of-mpp", min(high) > 1.0, rotor_speed_pu=high)
    # The first event comes at 5 s, the second at 30 s.
    rotor = [run.rotor_speed_pu[run.time_s < 30.0] for run in compared]
    peak = [float(run.power_pu[run.time_s < 30.0, 0].max()) for run in compared]
    fall = [float(run.rotor_speed_pu[0, 0] - np.interp(6.0, run.time_s, run.rotor_speed_pu[:, 0])) for run in compared]
    rocof = [-float(np.interp(5.5, run.time_s, run.rocof_hz_s(0.5))) for run in compared]
    nadir = [float(run.frequency_hz[run.time_s < 30.0].min()) for run in compared]
    yield claim("larger-step", peak[0] > max(peak[1:]), peak_power_pu=peak)
    yield claim("faster-rotor", fall[0] > max(fall[1:]), fall_pu=fall)
    yield claim("rocof", rocof[0] < min(rocof[1:]), rocof_hz_s=rocof)
    yield claim("nadir", all(0.0 < other - nadir[0] < 0.01 for other in nadir[1:]), nadir_hz=nadir)
    dips = [float(np.ptp(speed[:, 0])) for speed in rotor]
    yield smaller("narrow-range", [speed[0] - speed[-1] for speed in rotor], dip_pu=dips)


def settling():
    """Measure how long power and rotor of WTG 1 take to settle after the first event, at 5 s, of the load increase."""
    scenario = get_suite("paper").scenario(0)
    scenario = dataclasses.replace(scenario, events=scenario.events[:1], duration_s=300.0)
    runs, values, sooner = {name: simulate(scenario, LAWS[name]) for name in COMPARED}, {}, True
    for quantity in ("power_pu", "rotor_speed_pu"):
        times = []
        for name, run in runs.items():
            series = getattr(run, quantity)[:, 0]
            outside = run.time_s[np.abs(series / series[-1] - 1.0) > 0.02]
            times.append(float(outside.max(initial=5.0)) - 5.0)
            values[f"{name}_{quantity}_settling_s"] = times[-1]
        sooner &= times[0] < min(times[1:])
    return claim("settles-sooner", sooner, **values)


def load_decrease(runs):
    available = np.array([float(available_power_pu(wind)) for wind in WINDS])
    floor, compared = 0.9 * available, [runs[name] for name in COMPARED]
    yield smaller("rotor-rise", [run.rotor_speed_pu.max(axis=0) - run.rotor_speed_pu[0] for run in compared])
    inside, five, ten = (run.power_pu[-1] for run in compared)
    yield claim("decrease-10", (ten < floor).all(), power_pu=ten)
    yield claim("decrease-5", five[0] > floor[0] and five[1] < 0.3, power_pu=five)
    stays = compared[0].power_pu[-200:].min(axis=0) > floor
    together = stays.all() and np.ptp(inside / floor) < 1e-3
    yield claim("decrease-coordinated", together, power_pu=inside, percent=100.0 * inside / available)


def claims_table(claims):
    """Return the claims, marked where they do not hold or were fitted, with remarks below the table."""
    notes, rows = [], []
    for source, section in itertools.groupby(claims, key=lambda claim: claim["source"]):
        rows.append((f"**{source}**", "", ""))
        for claim in section:
            measured = claim["measured"] + ("" if claim["holds"] else ", **does not hold**")
            measured += ", *fitted*" if claim["fitted"] else ""
            if claim["remark"]:
                notes.append(f"({len(notes) + 1}) {claim['remark']}  ")
                measured += f" ({len(notes)})"
            rows.append((claim["says"], claim["expected"], measured))
    n_held = sum(claim["holds"] for claim in claims)
    fitted = [claim["fitted"] for claim in claims if claim["fitted"] and claim["holds"]]
    by = ", ".join(f"{name} to {fitted.count(name)}" for name in dict.fromkeys(fitted))
    count = (
        f"{n_held} of {len(claims)} claims hold, {n_held - len(fitted)} without a fit. Parameters of this model were "
        f"fitted to {len(fitted)} numbers ({by})."
    )
    table = markdown_table(("the paper says", "expected", "measured"), rows)
    return "\n\n".join((count, table, "\n".join(notes)))


def draw(cases, folder):
    """Draw the case studies and the steady states."""
    for seed, name in enumerate(("load-increase", "load-decrease")):
        save_figure(plot_trajectories(cases[seed], get_suite("paper").scenario(seed)), folder / f"{name}.svg")
    for name in ("mppt", *COMPARED):
        save_figure(characteristic(LAWS[name]), folder / f"characteristic-{name}.svg")


if __name__ == "__main__":
    cases = [run_case(seed) for seed in range(2)]
    claims = list(paper_claims(*cases))
    draw(cases, DOCS / "validation" / "figures")
    update_between_markers(DOCS / "validation.md", claims_table(claims), "claims")
