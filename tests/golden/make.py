"""Make the golden traces anew with ANDES 2.0.0 (https://docs.andes.app), an independent implementation of the models.

`make golden` runs this file in an environment of its own, which makes the cases that are named, or all. It writes the
traces, the tolerance in each `params.json`, and `andes_convergence.json`. Power flow, initial state and integration are
ANDES' own.

ANDES integrates with the implicit trapezoidal rule, whose error falls with the square of the step. Every trace is made
with several fixed steps, which divide 1/16 s, so that all rows and events lie on their grids. The finest is kept, or
extrapolated to a step of zero. The two finest give the error that remains; where a limit binds within a step, which
makes the error irregular, it is what the finest step has changed in the extrapolated trace.

Where ANDES differs from the models that the cases state:

- Its short step away from each event lasts 0.1 ms, half of it with the rates from before, which moves speeds by up to
  7e-7 p.u. whatever the step size; here it lasts 1 ns.
- It adds 1e-8 p.u. to r and x of every line (subtracted beforehand), shortens a fixed step where Newton's method is
  slow, and accepts an unfinished iteration that oscillates (both switched off).
- It has no relay that sheds load: negative admittances are switched on instead. A line whose impedance grows is two
  parallel lines, of which one opens. An imposed source is a classical machine with a very large inertia.
- REGF1 and REGF2 with all gains at zero are a constant voltage behind a reactance. The droop of REGF1 on filtered power
  is a swing equation with M = T_r/m_p and D = 1/m_p; REGF2 without its power filter and its PLL is one as it stands.
- Its HYGOV works on the system base and scales with the rating in four places: T_w and D_t are divided by it, and the
  integral of the speed error, which lacks 1/(r T_r), gets that as its time constant. Its rate limit must not bind.
- It reads K_1 of IEESGO and the rate limits of IEEEG1 on the system base. It scales the limits of IEEEX1 by the
  voltage, so that none binds in that case. STAB1 is an IEEEST without a filter.
"""

import functools
import itertools
import json
import logging
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tests.golden.case import CONTROLS, EVENTS, GOLDEN, read_data

STEPS_PER_SECOND = (96, 192, 384, 768)
#: Spacing of the rows of a trace, and in the second after an event [s].
ROW_S, FINE_ROW_S, FINE_SPAN_S = 0.25, 0.0625, 1.0
#: Length of ANDES' steps on both sides of an event [s].
EVENT_STEP_S = 1e-9
#: What ANDES adds to the resistance and reactance of every line [p.u.].
LINE_OFFSET_PU = 1e-8
#: What ten significant digits of a trace leave open, and a little more [p.u.].
WRITTEN_PU = 1e-10
QUANTITIES = ("w", "Pe", "V")
#: Models that have a nominal voltage.
AT_A_BUS = ("Bus", "PQ", "Shunt", "Slack", "PV", "GENROU", "GENCLS")


class Run(NamedTuple):
    """What the parameter file of a case does not say about its traces."""

    duration_s: float = 60.0
    extrapolations: int = 0  # each combines two neighbouring steps, or two results of the extrapolation before
    forming: Mapping[str, str] = {}  # ANDES' model of each unit that is a converter


RUNS = {
    **dict.fromkeys(("genrou", "limits", "dead-band", "hydro", "shedding"), Run()),
    "grid-forming": Run(forming={"2a": "REGF1", "2b": "REGF2"}),
    **dict.fromkeys(("grid-events", "imposed-source"), Run(duration_s=20.0)),
    **dict.fromkeys((*EVENTS, "ieee39-no-limits"), Run(duration_s=10.0, extrapolations=2)),
    **dict.fromkeys(
        ("saturation", "stab1", "ieeest", "ieeet1", "ieeex1", "ieeeg1", "ieesgo", "gast"),
        Run(duration_s=6.0, extrapolations=1),
    ),
}


def devices(data, events, run: Run):
    made = [("Bus", {"idx": bus["bus"], "v0": _held_voltage(data, bus["bus"]), "a0": 0.0}) for bus in data["bus"]]
    made += _lines(data, events)
    for load in data["load"]:
        power = {"p0": load["P"], "q0": load["Q"], "vmin": 0.1, "vmax": 2.0}
        made.append(("PQ", {"idx": f"load {load['bus']}", "bus": load["bus"], **power}))
    made += [("Shunt", {"idx": f"shunt {shunt['bus']}", "Sn": data["Sbase"], **shunt}) for shunt in data["shunt"]]
    slack = next(str(b["bus"]) for b in data["bus"] if str(b["bus"]) in data["gen_static"] and abs(b["theta"]) < 1e-12)
    for bus, power in data["gen_static"].items():
        static = {"idx": f"static {bus}", "bus": int(bus), "v0": _held_voltage(data, int(bus))}
        held = {"a0": 0.0} if bus == slack else {"p0": round(power["P"], 12), "qmin": -9.0, "qmax": 9.0}
        made.append(("Slack" if bus == slack else "PV", {**static, **held}))
    for key, gen in data["gens"].items():
        model = run.forming.get(key, gen["model"])
        own = {name: value for name, value in gen.items() if name != "model"}
        if model == "GENROU":
            own = {"S10": 0.0, "S12": 1.0, **own}
        elif model in ("REGF1", "REGF2"):
            own = _converter(model, gen, data["Sbase"])
        common = {"idx": key, "gen": f"static {gen['bus']}", "fn": data["fn"]}
        made.append(("GENCLS" if model == "source" else model, {**common, **own}))
    for part, kind in ((part, kind) for part, kinds in CONTROLS.items() for kind in kinds):
        for control in data.get(kind, []):
            key = control["gen"]
            machine = {"avr": f"exciter {key}", "MODE": 1} if part == "stabiliser" else {"syn": key}
            own = {name: value for name, value in control.items() if name not in ("gen", "bus")}
            model, own = _control(kind, own, data["gens"][key]["Sn"] / data["Sbase"])
            made.append((model, {"idx": f"{part} {key}", **machine, **own}))
    for i, event in enumerate(events):
        made += _event(event, f"change {i}", data)
    return [(name, {**device, "Vn": data["bus"][0]["Vn"]} if name in AT_A_BUS else device) for name, device in made]


def _held_voltage(data, bus: int) -> float:
    """Return the set-point of a bus with machines, else the start of the power flow [p.u.]."""
    solved = next(entry["V"] for entry in data["bus"] if entry["bus"] == bus)
    return round(solved, 12) if str(bus) in data["gen_static"] else 1.0


def _lines(data, events):
    """Return all lines; two stand for one whose impedance will grow by a factor."""
    lines = {f"line {i}": dict(line) for i, line in enumerate(data["line"])}
    for event in events:
        if event.get("kind") == "reactance_step":
            name, factor = _line_name(data, event["from_bus"], event["to_bus"]), event["factor"]
            stays = lines[name]
            lost = {key: stays[key] * factor / (factor - 1.0) for key in ("r", "x")}
            lines[f"{name} lost"] = {**stays, **lost, "b": 0.0}
            stays |= {key: stays[key] * factor for key in ("r", "x")}
    voltage, made = data["bus"][0]["Vn"], []
    for name, line in lines.items():
        ends = {"bus1": line["f"], "bus2": line["t"], "Vn1": voltage, "Vn2": voltage}
        impedance = {key: line[key] - LINE_OFFSET_PU for key in ("r", "x")}
        rest = {"b": line["b"], "tap": line["tap"], "phi": line["phi"], "trans": int(line["tap"] != 1.0)}
        made.append(("Line", {"idx": name, "Sn": data["Sbase"], "fn": data["fn"], **ends, **impedance, **rest}))
    return made


def _line_name(data, from_bus: int, to_bus: int) -> str:
    ends = {from_bus, to_bus}
    return f"line {next(i for i, line in enumerate(data['line']) if {line['f'], line['t']} == ends)}"


def _converter(model: str, unit, base_mva: float):
    """Return a REGF1 or REGF2 with the swing equation of a unit; its droop is on the system base."""
    rating = unit["Sn"] / base_mva
    swing = {"Tr": 0.0, "mf": unit["M"] * rating, "dd": 0.0} if model == "REGF2" else {"Tr": unit["M"] / unit["D"]}
    return {
        **{key: unit[key] for key in ("bus", "Sn", "gammap", "gammaq")},
        **{"rf": unit["ra"], "xf": unit["xd1"], "wdrp": 1.0 / rating / unit["D"], **swing},
        **dict.fromkeys(("KPi", "KIi", "KPv", "KIv", "KPplim", "KIplim", "KPqlim", "KIqlim"), 0.0),
        **dict.fromkeys(("Pmax", "Qmax"), 99.0),
        **dict.fromkeys(("Pmin", "Qmin"), -99.0),
    }


def _control(kind: str, data: dict[str, float], rating: float):
    """Return ANDES' model and parameters of a control; `rating` is that of its machine in p.u. of the system base."""
    own = dict(data)
    if kind == "hygov":
        own |= {"Tw": own["Tw"] / rating, "Dt": own["Dt"] / rating, "VELM": 99.0}
    elif kind == "tgov1" and "db" in own:
        dead_band = own.pop("db")
        return "TGOV1DB", {**own, "dbL": -dead_band, "dbU": dead_band}
    elif kind == "ieeeg1":
        own |= {"K": 1.0 / own.pop("R"), "UO": rating * own["UO"], "UC": rating * own["UC"]}
    elif kind == "ieesgo":
        own["K1"] = rating / own.pop("R")
    elif kind == "ieeex1":
        own |= {"KF1": own.pop("KF"), "TF1": own.pop("TF")}
    elif kind == "stab1":
        filters = dict.fromkeys(("A1", "A2", "A3", "A4", "A5", "A6"), 0.0)
        leads = {"T1": own["T1"], "T2": own["T3"], "T3": own["T2"], "T4": own["T4"], "T5": own["T"], "T6": own["T"]}
        return "IEEEST", {**filters, **leads, "KS": own["K"], "LSMAX": own["HLIM"], "LSMIN": -own["HLIM"]}
    return kind.upper(), own


def _event(event, name: str, data):
    """Return the devices that stand for an event; an admittance among them gets the name."""
    start, *later = instants(event)
    match event.get("kind", "trip" if "trip_load_MW" in event else "admittance"):
        case "trip":
            return _toggles("PQ", f"load {event['bus']}", start)
        case "admittance":
            change = {"idx": name, "bus": event["bus"], "u": 0, "Sn": data["Sbase"]}
            change |= {"g": event["dG_pu"], "b": event.get("dB_pu", 0.0)}
            return [("Shunt", change), *_toggles("Shunt", name, start)]
        case "machine_outage":
            return _toggles("GENROU", str(event["bus"]), start)
        case "line_trip":
            return _toggles("Line", _line_name(data, event["from_bus"], event["to_bus"]), start, *later)
        case "reactance_step":
            return _toggles("Line", _line_name(data, event["from_bus"], event["to_bus"]) + " lost", start)
        case "fault":
            impedance = {"rf": event["resistance_pu"], "xf": event["reactance_pu"]}
            fault = ("Fault", {"bus": event["bus"], "tf": start, "tc": later[0], **impedance})
            return [fault, *(_toggles("Line", _line_name(data, *event["opens"]), *later) if "opens" in event else [])]
        case "phase_jump":
            return [_alteration(event, "delta", math.radians(event["angle_deg"]), start)]
        case "frequency_ramp":
            source = data["gens"][str(event["bus"])]
            torque = source["M"] * source["Sn"] / data["Sbase"] * event["rocof_hz_s"] / data["fn"]
            return [_alteration(event, "tm0", torque, start), _alteration(event, "tm0", -torque, later[0])]
        case kind:
            raise ValueError(f"ANDES has no device for the event {kind!r}")


def _toggles(model: str, device: str, *times_s: float):
    return [("Toggle", {"model": model, "dev": device, "t": time_s}) for time_s in times_s]


def _alteration(event, constant: str, amount: float, time_s: float):
    source = {"model": "GENCLS", "dev": str(event["bus"]), "src": constant}
    return "Alter", {"t": time_s, **source, "method": "+", "amount": amount}


def instants(event) -> list[float]:
    """Return when an event begins and, where it has an end, when it ends [s]."""
    start = event.get("time_s", event.get("t"))
    lasts = sum(event.get(name, 0.0) for name in ("clears_after_s", "recloses_after_s", "duration_s"))
    return sorted({start, start + lasts})


def columns(data, events) -> tuple[str, ...]:
    """Return the columns of a trace: machines that stay in service, then buses; an imposed source is no machine."""
    lost = [str(event["bus"]) for event in events if event.get("kind") == "machine_outage"]
    keys = [key for key, gen in data["gens"].items() if gen["model"] != "source" and key not in lost]
    machines = [f"{quantity}{key}" for key in keys for quantity in ("w", "Pe")]
    return ("t", *machines, *(f"V{bus['bus']}" for bus in data["bus"]))


def row_times(events, duration_s: float) -> np.ndarray:
    """Return the times of a trace's rows; none lies at an event [s]."""
    coarse = np.arange(round(duration_s / ROW_S) + 1) * ROW_S
    changes = [time_s for event in events for time_s in instants(event)]
    fine = [time_s + np.arange(1, round(FINE_SPAN_S / FINE_ROW_S) + 1) * FINE_ROW_S for time_s in changes]
    return np.setdiff1d(np.concatenate([coarse, *fine]), changes)


def build_system(data, events, run: Run):
    """Return an ANDES system after its power flow, which must be that of the parameter file."""
    import andes

    system = andes.System(default_config=True, no_output=True)
    system.config.freq = data["fn"]
    for model, device in devices(data, events, run):
        system.add(model, device)
    # Its integral of the speed error lacks 1/(r T_r).
    system.HYGOV.gtpos.t_const = system.HYGOV.tr
    # Constant impedances: no share of constant power or current.
    system.PQ.config.update(p2p=0.0, p2i=0.0, p2z=1.0, q2q=0.0, q2i=0.0, q2z=1.0)
    system.setup()
    system.PFlow.config.update(tol=1e-12)
    if not system.PFlow.run():
        raise RuntimeError("ANDES' power flow did not converge")
    for name, values in (("V", system.Bus.v.v), ("theta", system.Bus.a.v)):
        gap = np.abs(values - [bus[name] for bus in data["bus"]]).max()
        if gap > 1e-10:
            raise RuntimeError(f"{name} of ANDES' power flow differs from the parameter file by {gap:.1e}")
    return system


def simulate(data, events, run: Run, steps_per_second: int) -> np.ndarray:
    """Integrate one event list with a fixed step and return the rows of its trace (n, columns)."""
    system = build_system(data, events, run)
    system.store_switch_times = functools.partial(system.store_switch_times, eps=EVENT_STEP_S)
    # Residuals are not scaled by the step: beside 1 ns of the torque that moves a source ANDES takes its step for lost.
    fixed = {"fixt": 1, "shrinkt": 0, "method": _fixed_step(), "chatter_iter": 1000, "linesearch": 0, "g_scale": 0}
    quiet = {"max_iter": 100, "reset_tiny": 0, "criteria": 0, "no_tqdm": 1}
    system.TDS.config.update(tf=run.duration_s, tstep=1.0 / steps_per_second, tol=1e-11, **fixed, **quiet)
    if not (system.TDS.run(no_summary=True) and system.TDS.test_ok and system.exit_code == 0):
        raise RuntimeError("ANDES' time-domain simulation failed")
    series = system.dae.ts
    t, x, y = np.asarray(series.t), np.asarray(series.x), np.asarray(series.y)
    before = t < min(instants(event)[0] for event in events) - 0.5 * EVENT_STEP_S
    drift = np.abs(x[before] - x[0]).max()
    if drift > 1e-9:
        raise RuntimeError(f"ANDES does not start in equilibrium: a state drifts by {drift:.1e} before the first event")
    wanted = row_times(events, run.duration_s)
    rows = np.array([np.argmin(np.abs(t - time_s)) for time_s in wanted])
    if np.abs(t[rows] - wanted).max() > 10.0 * EVENT_STEP_S:
        raise RuntimeError("a row does not lie on the grid of time steps")

    values = {"t": t} | {f"V{bus}": y[:, at] for bus, at in zip(system.Bus.idx.v, system.Bus.v.a, strict=True)}
    for name in ("GENROU", "GENCLS", "REGF1", "REGF2"):
        model = getattr(system, name)
        for i, key in enumerate(model.idx.v):
            values[f"Pe{key}"] = y[:, model.Pe.a[i]]
            # A converter's speed is in the rate of its angle [rad/s], here before limits that are out of reach.
            forming = name.startswith("REGF")
            values[f"w{key}"] = 1.0 + y[:, model.dw_x.a[i]] / model.w0.v[i] if forming else x[:, model.omega.a[i]]
    return np.column_stack([wanted, *(values[name][rows] for name in columns(data, events)[1:])])


@functools.cache
def _fixed_step() -> str:
    """Return the name of ANDES' trapezoidal rule with a step that stays fixed, and that gives up where one fails."""
    from andes.routines.daeint import Trapezoid, method_map

    def calc_h(tds) -> None:
        tds.deltat = tds.config.tstep if tds.converged else 0.0
        tds.busted = not tds.converged

    method_map["fixed_trapezoid"] = type("FixedTrapezoid", (Trapezoid,), {"calc_h": staticmethod(calc_h)})
    return "fixed_trapezoid"


def difference(names: Sequence[str], trace: np.ndarray, other: np.ndarray) -> dict[str, float]:
    gaps = dict(zip(names, np.abs(trace - other).max(axis=0).tolist(), strict=True))
    return {quantity: max(gaps[name] for name in names if name.startswith(quantity)) for quantity in QUANTITIES}


def extrapolated(traces: Sequence[np.ndarray], steps: Sequence[int], times: int) -> np.ndarray:
    """Return the finest trace, extrapolated so often to a step of zero: errors are a series of even powers of it."""
    for order in range(1, times + 1):
        ratios = [(fine / coarse) ** 2 for coarse, fine in zip(steps[:-order], steps[order:], strict=True)]
        pairs = zip(itertools.pairwise(traces), ratios, strict=True)
        traces = [fine + (fine - coarse) / (ratio - 1.0) for (coarse, fine), ratio in pairs]
    return traces[-1]


def make_case(name: str):
    """Write the traces and the tolerance of a case; return the convergence of each trace."""
    data, run = read_data(name), RUNS[name]
    steps, worst, convergence = STEPS_PER_SECOND, dict.fromkeys(QUANTITIES, 0.0), {}
    for key, events in data["events"].items():
        names = columns(data, events)
        traces = [simulate(data, events, run, n) for n in steps]
        to_finest = [difference(names, trace, traces[-1]) for trace in traces[:-1]]
        remaining = {q: value / 3.0 for q, value in to_finest[-1].items()}
        kept = extrapolated(traces, steps, run.extrapolations)
        if run.extrapolations:
            remaining = difference(names, extrapolated(traces[:-1], steps[:-1], run.extrapolations), kept)
        worst = {q: max(worst[q], remaining[q]) for q in QUANTITIES}
        # Adding zero turns a negative zero into a positive one.
        digits = 12 if name in EVENTS else 10
        lines = [",".join(f"{value:.{digits}g}" for value in row) for row in np.round(kept, 12) + 0.0]
        (GOLDEN / name / f"{key}.csv").write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
        convergence[f"{name}/{key}.csv"] = {
            "step_s": f"1/{steps[-1]}",
            "largest_difference_to_it_pu": {f"1/{n}": _short(d) for n, d in zip(steps[:-1], to_finest, strict=True)},
            "estimated_remaining_error_pu": _short(remaining),
        }
        print(f"{name}/{key}.csv: remaining error {_short(remaining)}", flush=True)
    if name in EVENTS:  # theirs are in `case.py`
        return convergence
    data["tolerance"] = {q: _one_digit_up(max(3.0 * worst[q], WRITTEN_PU)) for q in QUANTITIES}
    _write_json(GOLDEN / name / "params.json", data)
    return convergence


def _write_json(path: Path, data) -> None:
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def _short(values: Mapping[str, float]) -> dict[str, float]:
    return {key: float(f"{value:.3g}") for key, value in values.items()}


def _one_digit_up(value: float) -> float:
    exponent = math.floor(math.log10(value))
    return float(f"{math.ceil(value / 10.0**exponent)}e{exponent}")


def main() -> None:
    logging.getLogger("andes").setLevel(logging.WARNING)
    path = GOLDEN / "andes_convergence.json"
    convergence = json.loads(path.read_text(encoding="utf-8"))
    for name in sys.argv[1:] or RUNS:
        convergence["traces"] |= make_case(name)
    _write_json(path, convergence)


if __name__ == "__main__":
    main()
