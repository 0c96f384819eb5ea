"""Classical machines with TGOV1, written a second time from the equations, with numpy and scipy only.

Shares nothing with the package: loads and events by bus, the whole network solved at each evaluation, limits of the
gate as a hybrid system whose mode changes are located by the integrator. Local frequencies are the turns of the bus
voltages between samples behind a filter; machines come back with them. Slow, and good to about 1e-10.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

#: Distance of the samples of the local frequencies, and time constant of their filter [s].
SAMPLE_S, FILTER_S = 1.0 / 16.0, 0.1


class Independent:
    """A parameter file's system, from the file's own data."""

    def __init__(self, data: dict[str, Any]) -> None:
        self.buses = [bus["bus"] for bus in data["bus"]]
        self.index = {bus: i for i, bus in enumerate(self.buses)}
        self.keys = list(data["gens"])
        gens = [data["gens"][key] for key in self.keys]
        start = np.array([bus["V"] * np.exp(1j * bus["theta"]) for bus in data["bus"]])
        scale = np.array([gen["Sn"] / data["Sbase"] for gen in gens])
        self.scale, self.omega_n = scale, 2.0 * np.pi * data["fn"]
        self.inertia = np.array([gen["M"] for gen in gens]) * scale
        self.damping = np.array([gen["D"] for gen in gens]) * scale
        self.impedance = np.array([complex(gen["ra"], gen["xd1"]) for gen in gens]) / scale
        self.at = np.array([self.index[gen["bus"]] for gen in gens])
        static = [data["gen_static"][str(gen["bus"])] for gen in gens]
        power = np.array(
            [complex(s["P"] * g["gammap"], s["Q"] * g["gammaq"]) for s, g in zip(static, gens, strict=True)]
        )
        current = np.conj(power / start[self.at])
        emf = start[self.at] + self.impedance * current
        self.emf, self.delta = np.abs(emf), np.angle(emf)
        self.torque = power.real + self.impedance.real * np.abs(current) ** 2
        self.loads = {bus: 0j for bus in self.buses}
        for load in data["load"]:
            self.loads[load["bus"]] += complex(load["P"], -load["Q"]) / abs(start[self.index[load["bus"]]]) ** 2
        self.y = self._network(data)
        governors = data["tgov1"] if isinstance(data["tgov1"], list) else [data["tgov1"]]
        self.governed = np.array([self.keys.index(str(g["gen"])) for g in governors])
        for name in ("R", "T1", "T2", "T3", "VMIN", "VMAX", "Dt"):
            setattr(self, name, np.array([g[name] for g in governors]))
        self.reference = self.torque[self.governed] / scale[self.governed]
        self.lines = {(line["f"], line["t"]): line for line in data["line"]}
        self.connected = np.ones(len(gens))
        self.local, self.seen = np.ones(len(self.buses)), start

    def _network(self, data: dict[str, Any]) -> np.ndarray:
        n = len(self.buses)
        y = np.zeros((n, n), dtype=complex)
        for line in data["line"]:
            self._add_line(y, line, 1.0)
        for shunt in data["shunt"]:
            y[self.index[shunt["bus"]], self.index[shunt["bus"]]] += complex(shunt["g"], shunt["b"])
        for bus, load in self.loads.items():
            y[self.index[bus], self.index[bus]] += load
        np.add.at(y, (self.at, self.at), 1.0 / self.impedance)
        return y

    def _add_line(self, y: np.ndarray, line: dict[str, float], sign: float) -> None:
        f, t = self.index[int(line["f"])], self.index[int(line["t"])]
        series, half = 1.0 / complex(line["r"], line["x"]), 0.5j * line["b"]
        tap = line["tap"] * np.exp(1j * line["phi"])
        y[f, f] += sign * (series + half) / abs(tap) ** 2
        y[t, t] += sign * (series + half)
        y[f, t] -= sign * series / np.conj(tap)
        y[t, f] -= sign * series / tap

    def solve(self, y: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return bus voltages, machine currents and voltages behind the impedances."""
        m = len(self.keys)
        emf = self.emf * np.exp(1j * state[:m])
        injected = np.zeros(len(self.buses), dtype=complex)
        np.add.at(injected, self.at, self.connected * emf / self.impedance)
        voltage = np.linalg.solve(y, injected)
        return voltage, self.connected * (emf - voltage[self.at]) / self.impedance, emf

    def rates(self, y: np.ndarray, held: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Return the time derivatives; `held` marks gates at a limit."""
        m, g = len(self.keys), len(self.governed)
        _, current, emf = self.solve(y, state)
        speed, gate, lag = state[m : 2 * m], state[2 * m : 2 * m + g], state[2 * m + g :]
        torque = self.torque.copy()
        own = lag + self.T2 / self.T3 * (gate - lag) - self.Dt * (speed[self.governed] - 1.0)
        torque[self.governed] = self.scale[self.governed] * own
        demand = self.reference - (speed[self.governed] - 1.0) / self.R
        return np.concatenate(
            [
                self.omega_n * (speed - 1.0),
                (torque - (emf * current.conj()).real - self.damping * (speed - 1.0)) / self.inertia,
                np.where(held != 0, 0.0, (demand - gate) / self.T1),
                (gate - lag) / self.T3,
            ]
        )

    def columns(self, y: np.ndarray, state: np.ndarray) -> dict[str, float]:
        """Return speeds, powers and voltages as a trace has them."""
        voltage, current, _ = self.solve(y, state)
        power = (voltage[self.at] * current.conj()).real
        found = {f"V{bus}": abs(voltage[i]) for i, bus in enumerate(self.buses)}
        for i, key in enumerate(self.keys):
            found |= {f"w{key}": state[len(self.keys) + i], f"Pe{key}": power[i]}
        return found

    def _sample(self, y: np.ndarray, state: np.ndarray) -> None:
        """Find the local frequency of every bus."""
        voltage, _, _ = self.solve(y, state)
        measured = 1.0 + np.angle(voltage / self.seen) / (self.omega_n * SAMPLE_S)
        self.local = self.local + (1.0 - np.exp(-SAMPLE_S / FILTER_S)) * (measured - self.local)
        self.seen = voltage

    def _bring_back(self, k: int, y: np.ndarray, held: np.ndarray, state: np.ndarray) -> None:
        """Synchronise a machine: in phase with its bus, at the frequency there, its gate closed."""
        m, i = len(self.keys), self.at[k]
        voltage = self.solve(y, state)[0][i]
        self.emf[k], state[k], state[m + k] = abs(voltage), np.angle(voltage), self.local[i]
        for j in np.flatnonzero(self.governed == k):
            held[j], state[2 * m + j], state[2 * m + len(self.governed) + j] = 0.0, 0.0, 0.0
        y[i, i] += 1.0 / self.impedance[k]
        self.connected[k] = 1.0

    def _strike(self, event: dict[str, Any], y: np.ndarray, held: np.ndarray, state: np.ndarray) -> None:
        """Change network, machines and gates; a gate that is held with NaN is so for good."""
        if "opens" in event or "closes" in event:
            sign, ends = (-1.0, event["opens"]) if "opens" in event else (1.0, event["closes"])
            self._add_line(y, self.lines[ends], sign)
            return
        i = self.index[int(event["bus"])]
        if event.get("outage"):
            for k in np.flatnonzero(self.at == i):
                y[i, i] -= 1.0 / self.impedance[k]
                self.connected[k] = 0.0
        elif event.get("returns"):
            for k in np.flatnonzero(self.at == i):
                self._bring_back(k, y, held, state)
        elif event.get("governor_loss"):
            held[self.at[self.governed] == i] = np.nan
        else:
            y[i, i] += event["dG_pu"] if "dG_pu" in event else -self.loads[int(event["bus"])]

    def run(self, events: list[dict[str, Any]], times: list[float]) -> dict[str, np.ndarray]:
        """Return the columns at the times [s], and how often a gate has met or left a limit as `switches`."""
        m, g = len(self.keys), len(self.governed)
        state = np.concatenate([self.delta, np.ones(m), self.reference, self.reference])
        y, held, clock, rows, switches, samples = self.y.copy(), np.zeros(g), 0.0, [], 0, 0
        for stop in sorted({event["t"] for event in events} | {times[-1]}):
            while clock < stop:
                watched = [
                    self._watch(j, held[j], limit)
                    for j in range(g)
                    if not np.isnan(held[j])
                    for limit in ((1, -1) if not held[j] else (0,))
                ]
                done = solve_ivp(
                    lambda _t, x, y=y, held=held: self.rates(y, held, x),
                    (clock, stop),
                    state,
                    method="DOP853",
                    rtol=1e-11,
                    atol=1e-13,
                    dense_output=True,
                    events=[event for _, _, event in watched],
                )
                while len(rows) < len(times) and times[len(rows)] <= done.t[-1]:
                    rows.append(self.columns(y, done.sol(times[len(rows)])))
                while (samples + 1) * SAMPLE_S <= done.t[-1]:
                    samples += 1
                    self._sample(y, done.sol(samples * SAMPLE_S))
                clock, state = float(done.t[-1]), done.y[:, -1].copy()
                for (j, mode, _), hits in zip(watched, done.t_events, strict=True):
                    if len(hits):
                        held[j] = mode
                        switches += 1
            for event in events:
                if event["t"] == stop:
                    self._strike(event, y, held, state)
        found = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return found | {"switches": np.array([switches])}

    def _watch(self, j: int, held: float, limit: int) -> tuple[int, int, Any]:
        m = len(self.keys)

        def to_limit(_t: float, x: np.ndarray) -> float:
            return float(x[2 * m + j] - (self.VMAX[j] if limit > 0 else self.VMIN[j]))

        def off_limit(_t: float, x: np.ndarray) -> float:
            return float(self.reference[j] - (x[m + self.governed[j]] - 1.0) / self.R[j] - x[2 * m + j])

        watch: Any = to_limit if limit else off_limit
        watch.terminal, watch.direction = True, limit if limit else -held
        return j, limit, watch


class IndependentConverter:
    """A group of turbines with power and torque limits and a chopper, at a voltage whose frequency is imposed.

    On the base of the group but for `reactances`: of the converter, of the line and of the source, in p.u. of one base,
    with 1 p.u. of voltage at both ends of the line. Blades at rest, constant voltage behind the reactance.
    """

    OMEGA_N, H, DROOP, TAU = 2.0 * np.pi * 50.0, 5.0, 62.5, 0.8
    H_ROTOR, TIP_M_S, WIND_POWER = 6.5, 1.27 * 63.0, 0.5 * 1.23 * np.pi * 63.0**2 / 5e6
    P_MAX, T_MAX, P_MIN, K_P, K_I, COOLING_S = 1.1, 1.1, 0.0, 0.01, 0.1, 60.0

    def __init__(self, k: tuple[float, float, float], wind: float, reactances: tuple[float, float, float]) -> None:
        self.k, self.wind = k, wind
        own, line, source = reactances
        rotor = brentq(lambda w: self.captured(w) - k[1] * w**3, 7.0 * wind / self.TIP_M_S, 14.0 * wind / self.TIP_M_S)
        power = k[1] * rotor**3
        far, near = 1.0, np.exp(1j * np.arcsin(power * line))
        current = (near - far) / (1j * line)
        emf, stiff = near + 1j * own * current, far - 1j * source * current
        self.most = abs(emf) * abs(stiff) / sum(reactances)
        # Angle of the voltage, ω, filter, rotor speed, both limiters, energies delivered and burnt, heat, source.
        self.start = np.array([np.angle(emf), 1.0, 0.0, rotor, 0.0, 0.0, 0.0, 0.0, 0.0, np.angle(stiff), 1.0])

    def captured(self, rotor: float) -> float:
        """Return the power from the wind."""
        inverse = self.wind / (self.TIP_M_S * rotor) - 0.035
        return float(self.WIND_POWER * self.wind**3 * 0.5 * (100.0 * inverse - 5.0) * np.exp(-17.3 * inverse))

    def seen(self, x: np.ndarray) -> tuple[float, float, float]:
        """Return power, the most that is held, and the shift of the frequency."""
        power, most = self.most * np.sin(x[0] - x[9]), min(self.P_MAX, self.T_MAX * x[3])
        over, under = self.K_P * (most - power) + x[4], self.K_P * (self.P_MIN - power) + x[5]
        return power, most, min(over, 0.0) + max(under, 0.0)

    def rates(self, x: np.ndarray, ramp: float) -> np.ndarray:
        """Return the time derivatives."""
        power, most, shift = self.seen(x)
        deviation, rotor, drawn = x[1] - 1.0, x[3], max(power, self.P_MIN)
        tracked = min(np.interp(x[1] + shift, (0.992, 1.0, 1.008), self.k) * rotor**3, most)
        over, under = self.K_I * (most - power), self.K_I * (self.P_MIN - power)
        return np.array(
            [
                self.OMEGA_N * (deviation + shift),
                (tracked - power + self.DROOP * (x[2] - deviation)) / (2.0 * self.H),
                (deviation - x[2]) / self.TAU,
                (self.captured(rotor) - drawn) / (2.0 * self.H_ROTOR * rotor),
                0.0 if x[4] >= 0.0 and over > 0.0 else over,
                0.0 if x[5] <= 0.0 and under < 0.0 else under,
                power,
                drawn - power,
                drawn - power - x[8] / self.COOLING_S,
                self.OMEGA_N * (x[10] - 1.0),
                ramp,
            ]
        )

    def run(self, changes: list[tuple[float, float, float]], times: np.ndarray) -> dict[str, np.ndarray]:
        """Return numbers at times [s]; a change is an instant [s], a jump [rad] and the ramp from then on [p.u./s]."""
        state, ramp, rows = self.start.copy(), 0.0, []
        edges = [0.0, *(t for t, _, _ in changes), float(times[-1])]
        for place, (begin, end) in enumerate(itertools.pairwise(edges)):
            if place:
                state[9] += changes[place - 1][1]
                ramp = changes[place - 1][2]
            wanted = times[(times > begin) & (times <= end)]
            done = solve_ivp(
                lambda _t, x, r=ramp: self.rates(x, r),
                (begin, end),
                state,
                t_eval=np.unique(np.append(wanted, end)),
                max_step=0.01,
                rtol=1e-9,
                atol=1e-11,
            )
            rows += [[*x, *self.seen(x)] for t, x in zip(done.t, done.y.T, strict=True) if t in wanted]
            state = done.y[:, -1].copy()
        found = np.array(rows)
        names = ("speed", "filter", "rotor_speed", "over_power", "under_power", "energy_delivered", "energy_chopped")
        numbers = dict(zip((*names, "heat"), found.T[1:9], strict=True))
        return numbers | {"power": found[:, 11], "shift": found[:, 13]}
