"""Damping: the eigenvalues of the grid with a policy in the loop, over one decision.

From one decision to the next, the plant's state x, the observation o that the policy acts on, and its own memory h
change by a fixed map; near a rest of the loop it is linear,

    x' = Φ x + Γ a,   o' = C x + D a,   h' = F o + G h,   a = K o + M h

Φ, Γ, C and D are exact, by :class:`~wtg_gym.gradients.Tape`; the policy's K, M, F and G are differences. An eigenvalue
z is a mode s = ln(z) / T, T the time for which an action is held. That leaves whole turns within T open: a mode takes
those with which the frequencies of all units move most steadily within the step. Random errors of the sensors are left
out; their filters and their mean delay are in the loop.
"""

import contextlib
import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.gradients.tape import LAW_PARAMETERS, Tape
from wtg_gym.physics import linearisation, scenario, sensors
from wtg_gym.physics.layout import Floats, Layout, Whole
from wtg_gym.policies import Entry, OnnxPolicy, PolicyError
from wtg_gym.policies.play import answer
from wtg_gym.ranges import require_known, require_range
from wtg_gym.scenarios.suites import DEFAULT_SUITE
from wtg_gym.tasks import cost, measured_observation

Complex = npt.NDArray[np.complex128]
#: The operating point: wind of all groups [m/s], and the middle of what standard-v1 draws of the grid: governor droop
#: [p.u.], share of the machine's units on line [-], and factor on all loads [-].
POINT = MappingProxyType({"wind_m_s": 10.0, "governor_droop": 0.055, "committed": 0.6, "load_level": 0.95})
#: How long a loop may take to come to rest [s]; the slowest modes of v1 decay with 0.02/s.
_SETTLES_S = 600.0
#: At rest, the frequency moves less than this [Hz] in the last seconds.
_REST_HZ, _WATCHED_S = 1e-4, 10.0
#: The sides of the corner of g(ω), on which secondary control lets a loop rest.
SLOPES = ("below", "above")
#: Difference of observations and memories; policies compute with 32 bits.
_DIFFERENCE = 2e-3
#: Modes that decay faster than by this factor in a decision are not told apart from rounding.
_LEAST_FACTOR = 1e-4
#: Slower turns are none [rad/s].
_LEAST_RATE = 1e-6


class Rest(NamedTuple):
    """Where a loop comes to rest."""

    moves_hz: float  # by which the frequency still moved in the last ten seconds
    frequency_hz: float
    largest_action: float  # [-]

    @property
    def is_reached(self) -> bool:
        """Whether the loop came to rest; where not, it goes on to oscillate by itself."""
        return self.moves_hz < _REST_HZ


class Mode(NamedTuple):
    """An oscillation of the loop, and on which slope of the law."""

    eigenvalue: complex  # s, with a positive imaginary part [1/s]
    slope: str  # of g(ω): "below" or "above" the nominal frequency, or "both" where they are one

    @property
    def frequency_hz(self) -> float:
        """Its frequency [Hz]."""
        return self.eigenvalue.imag / (2.0 * np.pi)

    @property
    def damping_ratio(self) -> float:
        """Its damping ratio [-], negative where it grows."""
        return -self.eigenvalue.real / abs(self.eigenvalue)


class Damping(NamedTuple):
    """The oscillations of a loop at rest, the least damped first, and the rest itself."""

    modes: list[Mode]
    largest_rate: float  # largest real part of all eigenvalues, of what does not oscillate too [1/s]
    rest: Rest


def damping(entry: Entry, plant: Mapping[str, Any] | None = None, point: Mapping[str, float] | None = None) -> Damping:
    """Return the oscillations of the loop of an entry of version v1, in the grid of standard-v1.

    `plant` replaces parts of the plant, as in :class:`~wtg_gym.envs.settings.EnvSettings`, `point` values of the
    operating point :data:`POINT`, such as {"wind_m_s": 9.0}. A ValueError names what is unknown or out of range, a
    PolicyError says that the policy fails, that its memory is not arrays, or that the loop loses the grid.
    """
    require_known("values of the operating point", point or {}, POINT)
    loop = Loop(entry, plant, {**POINT, **(point or {})})
    modes, rates, rests = list[Mode](), list[float](), list[Rest]()
    has_corner = entry.law.k_min != entry.law.k_max
    with entry.policy if isinstance(entry.policy, OnnxPolicy) else contextlib.nullcontext():
        for slope in SLOPES if has_corner else SLOPES[:1]:
            rests.append(loop.settle(slope))
            values = loop.eigenvalues()
            label = slope if has_corner else "both"
            modes += [Mode(complex(value), label) for value in values if value.imag > _LEAST_RATE]
            rates.append(float(values.real.max()))
    modes.sort(key=lambda mode: mode.damping_ratio)
    return Damping(modes, max(rates), rest=max(rests, key=lambda rest: rest.moves_hz))


class Loop:
    """An entry in the loop with the grid, one measuring interval a step of the tape."""

    def __init__(self, entry: Entry, plant: Mapping[str, Any] | None, point: Mapping[str, Any] = POINT) -> None:
        settings = EnvSettings(suite=DEFAULT_SUITE, duration_s=_SETTLES_S, plant=plant, **entry.env_arguments)
        #: Intervals of a decision, and its length [s].
        self.n_held, self.step_s = settings.n_intervals, settings.step_s
        self.entry, self.tape = entry, Tape(dataclasses.replace(settings, control_dt=settings.interval_s), 1, 1)
        self.layout: Layout = self.tape.batch.simulator.layout
        self.nominal_hz = self.tape.batch.nominal_hz
        errors, n_wtg = settings.resolved_suite.sensors, self.tape.batch.n_wtg
        assert errors is not None
        delays = errors.delays_s()
        of_grid = dict(point)
        wind_m_s = require_range("wind_m_s", of_grid.pop("wind_m_s"), *scenario.WIND_SPEED_RANGE, "m/s")
        self.scenario = scenario.Scenario(
            name=f"rest at {wind_m_s:g} m/s",
            wind_speed=np.full((n_wtg, 1), wind_m_s),
            duration_s=_SETTLES_S,
            load_noise_bus=1,
            sensors=sensors.Sensors(
                seed=0,
                wind_bias=(0.0,) * n_wtg,
                # Within a decision, so that no older measurement is seen.
                delay_s=delays[len(delays) // 2],
                frequency_filter_s=errors.frequency_filter_s,
                rocof_filter_s=errors.rocof_filter_s,
                wind_sensor=errors.wind_sensor,
            ),
            **of_grid,
        )
        self._seen: Floats = np.zeros(0)
        self._memory: Any = None

    def settle(self, slope: str) -> Rest:
        """Play until the loop is at rest, with one slope of the law's g(ω) on both sides of its corner."""
        tape, entry = self.tape, self.entry
        tape.start([self.scenario])
        tape.set_law(self._smooth(tape.law(), slope))
        batch, state, actions = tape.batch, None, np.zeros((1, tape.batch.n_action))
        # A law starts at rest.
        running, length_s = np.ones(1, dtype=np.bool_), _SETTLES_S if entry.policy else 2.0 * _WATCHED_S
        frequencies, n_steps = [], round(length_s / self.step_s)
        for step in range(n_steps):
            # Inputs of the last decision, at which the loop is differentiated.
            self._seen, self._memory = batch.observations.astype(np.float64), state
            if entry.policy is not None:
                actions, state = answer(entry, batch, state, step, running)
            for _ in range(self.n_held):
                tape.step(actions)
            frequencies.append(self.nominal_hz * float(batch.simulator.env_values("coi")[0]))
            if batch.ended()[0].any():
                raise PolicyError(f"entry {entry.label!r} loses the grid at rest, {self.scenario.name}")
        moves_hz = float(np.ptp(frequencies[-round(_WATCHED_S / self.step_s) :]))
        return Rest(moves_hz, frequencies[-1], float(np.abs(actions).max(initial=0.0)))

    def _smooth(self, law: Floats, slope: str) -> Floats:
        """Return laws (1, n_wtg, 4) whose g(ω) goes on with its slope below, or above, beyond the corner."""
        control = self.tape.batch.simulator.settings.control
        below = control.frequency_setpoint_pu - control.frequency_min_pu
        above = control.frequency_max_pu - control.frequency_setpoint_pu
        k_min, k_nominal, k_max = (LAW_PARAMETERS.index(name) for name in ("k_min", "k_nominal", "k_max"))
        smooth = law.copy()
        if slope == "below":
            smooth[..., k_max] = law[..., k_nominal] - (law[..., k_min] - law[..., k_nominal]) * above / below
        else:
            smooth[..., k_min] = law[..., k_nominal] - (law[..., k_max] - law[..., k_nominal]) * below / above
        return smooth

    def eigenvalues(self) -> Complex:
        """Return s of every mode that does not vanish within a decision."""
        a, b, c, d = self._plant()
        k, m, f, g = self._policy()
        n, n_held = len(a), self.n_held
        powers = [np.linalg.matrix_power(a, j) for j in range(n_held + 1)]
        held = [sum(powers[:j], np.zeros_like(a)) @ b for j in range(n_held + 1)]
        moved = [powers[-1], held[-1] @ k, held[-1] @ m]
        matrix = np.block([moved, [c, d @ k, d @ m], [np.zeros((len(g), n)), f, g]])
        keep = _moving(matrix)
        values, vectors = np.linalg.eig(matrix[np.ix_(keep, keep)])
        whole = np.zeros((len(matrix), values.size), dtype=np.complex128)
        whole[keep] = vectors
        slow = np.abs(values) > _LEAST_FACTOR
        values, whole = values[slow], whole[:, slow]
        acted = k @ whole[n : n + len(c)] + m @ whole[n + len(c) :]
        # Frequencies of all units within the decision, (n_held, n_units, n_modes).
        speeds = np.isin(self._rows, np.concatenate([self.layout.wtg("speed"), self.layout.machine("speed")]))
        within = np.array([powers[j][speeds] @ whole[:n] + held[j][speeds] @ acted for j in range(n_held)])
        rates: Complex = np.log(values.astype(np.complex128)) / self.step_s
        # How many whole turns each mode makes in a decision besides those of its rate.
        instants = np.arange(n_held) * self.step_s / n_held
        steady = within * np.exp(-np.outer(instants, rates))[:, np.newaxis]
        shares = np.square(np.abs(np.fft.fft(steady, axis=0))).sum(axis=1)
        turns: Floats = np.fft.fftfreq(n_held, 1.0 / n_held)[shares.argmax(axis=0)]
        rates += 2j * np.pi / self.step_s * turns
        return rates

    @property
    def _rows(self) -> Whole:
        """The plant's rows: without old measurements, which are not seen, and limits at rest, which act one way."""
        layout, kept = self.layout, self.layout.span(measured_observation.KEPT)
        keep = np.ones(layout.n_rows, dtype=np.bool_)
        keep[kept.first : kept.first + kept.n_units * kept.n_rows] = False
        keep[linearisation.one_way_limits(self.tape.batch.simulator.blocks[0, :, 0], layout)] = False
        return np.flatnonzero(keep)

    def _plant(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return A and B of an interval, and C and D of what is observed at the end of a decision."""
        tape, rows, last = self.tape, self._rows, self.tape.n_steps - 1
        terms = np.zeros((1, len(cost.COST_TERMS)))
        pulls = [tape.pull(last, unit, terms) for unit in np.eye(tape.n_carried)[rows, np.newaxis]]
        states, actions = ([each.carried[0, rows] for each in pulls], [each.actions[0] for each in pulls])
        seen_states, seen_actions = [], []
        for shown in np.eye(tape.batch.n_observation)[:, np.newaxis]:
            carried, of_actions = np.zeros((1, tape.n_carried)), 0.0
            for step in range(last, last - self.n_held, -1):
                pulled = tape.pull(step, carried, terms, shown if step == last else None)
                carried, of_actions = pulled.carried, of_actions + pulled.actions[0]
            seen_states.append(carried[0, rows])
            seen_actions.append(of_actions)
        return np.array(states), np.array(actions), np.array(seen_states), np.array(seen_actions)

    def _policy(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return K, M, F and G of the policy; no rows or columns of memory where it has none, zeros for a law."""
        n_observation, n_action = self.tape.batch.n_observation, self.tape.batch.n_action
        memory = _flat(self._memory, self.entry)
        here = np.concatenate([self._seen.ravel(), memory])
        if self.entry.policy is None:
            answers = np.zeros((2 * here.size, n_action))
        else:
            moved = here + _DIFFERENCE * np.concatenate([np.eye(here.size), -np.eye(here.size)])
            answers = np.concatenate([self._answers(part) for part in np.array_split(moved, -(-len(moved) // 8))])
        jacobian = (answers[: here.size] - answers[here.size :]).T / (2.0 * _DIFFERENCE)
        of_actions, of_memory = jacobian[:n_action], jacobian[n_action:]
        (k, m), (f, g) = (np.split(part, [n_observation], axis=1) for part in (of_actions, of_memory))
        return k, m, f, g

    def _answers(self, inputs: Floats) -> Floats:
        """Return actions and next memories (n, any) for observations and memories (n, any)."""
        policy: Any = self.entry.policy
        n, arrays = len(inputs), self._memory or ()
        n_rows = n * (self.tape.batch.n_wtg if self.entry.per_group else 1)
        ends = np.cumsum([self.tape.batch.n_observation, *(array.size for array in arrays)])
        seen, *memories = (part.reshape(n_rows, -1) for part in np.split(inputs, ends[:-1], axis=1))
        state = tuple(memory.astype(array.dtype) for memory, array in zip(memories, arrays, strict=True)) or None
        starts = np.zeros(n_rows, dtype=np.bool_)
        actions, after = policy.predict(seen.astype(np.float32), state=state, episode_start=starts, deterministic=True)
        return np.concatenate([np.reshape(part, (n, -1)) for part in (actions, *(after or ()))], axis=1).astype(float)


def _flat(memory: Any, entry: Entry) -> Floats:
    """Return a policy's memory as one row of numbers; a PolicyError where it is not arrays."""
    if memory is None:
        return np.zeros(0)
    if not isinstance(memory, tuple) or not all(isinstance(array, np.ndarray) for array in memory):
        raise PolicyError(f"the memory of entry {entry.label!r} is no tuple of arrays, which damping needs")
    return np.concatenate([array.ravel() for array in memory]).astype(np.float64)


def _moving(matrix: Floats) -> npt.NDArray[np.bool_]:
    """Return which states move others and are moved by others, (n,): counters and sums take no part."""
    keep = np.ones(len(matrix), dtype=np.bool_)
    while True:
        rest = np.where(np.outer(keep, keep), matrix, 0.0)
        np.fill_diagonal(rest, 0.0)
        kept = keep & rest.any(axis=0) & rest.any(axis=1)
        if (kept == keep).all():
            return kept
        keep = kept
