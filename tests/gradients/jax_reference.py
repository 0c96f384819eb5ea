"""An episode's cost by JAX: the kernels' own source over its arrays, and a Runge-Kutta method of its own.

Where currents are limited JAX goes back through every one of a given number of sweeps.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from wtg_gym.envs.actions import apply_actions
from wtg_gym.envs.charging import charge
from wtg_gym.envs.task_records import TASK, read_task
from wtg_gym.gradients.generated import _bases
from wtg_gym.gradients.tape import Tape
from wtg_gym.gradients.tracing import Actions, Rows, retargeted
from wtg_gym.physics.currents import limit_group_current
from wtg_gym.physics.dynamics import derivatives, keep_energy
from wtg_gym.physics.layout import EXTENSION, read_turbine
from wtg_gym.physics.protection import track_extremes

#: Sweeps over the groups whose currents are limited; each brings the currents some ten times closer.
N_SWEEPS = 40

jax.config.update("jax_enable_x64", True)


def _either(traced: Any, plain: Any) -> Any:
    """Sizes and row numbers stay Python's."""

    def call(*given: Any) -> Any:
        return traced(*given) if any(isinstance(one, jax.Array | np.ndarray) for one in given) else plain(*given)

    return call


ARITHMETIC: dict[str, Any] = {
    "min": _either(jnp.minimum, min),
    "max": _either(jnp.maximum, max),
    "abs": jnp.abs,
    "select": jnp.where,
    "fma": lambda a, b, c: a * b + c,
    "sine_cosine": lambda angle: (jnp.sin(angle), jnp.cos(angle)),
    "exponential": jnp.exp,
    "math": SimpleNamespace(sqrt=jnp.sqrt, floor=jnp.floor, ceil=jnp.ceil, inf=math.inf),
}


class JaxEpisode:
    """The steps that a tape has taken, as functions of actions and law.

    Wind, networks and clocks are those of the tape; states, actions and what the task keeps are worked out again.
    """

    def __init__(self, tape: Tape) -> None:
        lanes, simulator = tape.lanes, tape.lanes.simulator
        self.tape, self.c, self.layout = tape, simulator.plant.constants[0], simulator.layout
        self.task = retargeted(read_task)(lanes.task[0])
        self.n_rows = self.layout.n_rows
        sensed = lanes.task["sensed"].shape[1] > 0
        self._rates = self._kernel(
            derivatives, lambda f, rows, fraction: f(rows, self.c, fraction, (0,)), limit_currents=self.limit_currents
        )
        turbine = read_turbine(self.c["turbine"])
        self._energies = self._kernel(
            keep_energy, lambda f, rows: [f(rows, self.c, j, 0, turbine, 1) for j in range(self.layout.n_wtg)]
        )
        self._extremes = self._kernel(track_extremes, lambda f, rows: f(rows, self.c, (0,)))
        self._charge = self._kernel(charge, lambda f, rows: f(rows, self.c, self.task, sensed, (0,)))

    def limit_currents(self, block: Rows, c: Any, lanes: Any) -> None:
        names = {"SETTLED": -1.0, "np": SimpleNamespace(int64=lambda _: 0)}
        limit_group = retargeted(limit_group_current, {**ARITHMETIC, **names}, {})
        largest = float(c["extension"][0]["limits.current_max"])
        sources = self.layout.wtg("over_power") + EXTENSION.source
        voltages = self.layout.rows.voltage + 2 * (self.layout.n_sync + np.arange(self.layout.n_wtg))
        for part in range(2):
            for source, voltage in zip(sources.tolist(), voltages.tolist(), strict=True):
                block[source + part] = block[voltage + part]

        def swept(held: dict[int, Any]) -> dict[int, Any]:
            rows = Rows(lambda row: held[row] if row in held else block[row])
            for j in range(self.layout.n_wtg):
                limit_group(rows, c, j, largest * float(c["share"][j]), lanes)
            return {int(row): rows[row] for row in rows}

        first = swept({})
        last, _ = jax.lax.scan(lambda held, _: (swept(held), None), first, None, length=N_SWEEPS)
        block.update(last)

    def _kernel(self, kernel: Any, call: Any, **names: Any) -> Any:
        function = retargeted(kernel, {**ARITHMETIC, **names}, {})

        def over(values: Any, *given: Any) -> Any:
            rows = Rows(lambda row: values[row])
            call(function, rows, *given)
            at = np.array([int(row) for row in rows])
            return values.at[at].set(jnp.stack([jnp.broadcast_to(one, values.shape[1:]) for one in rows.values()]))

        return jax.jit(over)

    def _before(self, step: int) -> npt.NDArray[np.float64]:
        blocks = self.tape.before(step) if step < self.tape.n_steps else self.tape.lanes.simulator.blocks
        view = blocks.reshape(blocks.shape[0], -1, self.tape.lanes.simulator.width)
        return view.transpose(1, 0, 2).reshape(view.shape[1], -1)[:, : self.tape.lanes.n_lanes]

    def terms(self, actions: Any, law: Any) -> Any:
        """Return the terms of every step's cost (n_steps, n_terms, n_lanes); arguments as for `Tape.gradient`."""
        rules, layout, h = self.tape._rules, self.layout, float(self.c["simulation_dt"])
        values = jnp.array(self._before(0)).at[rules.law].set(jnp.transpose(law, (1, 2, 0)))
        act = retargeted(apply_actions, {**ARITHMETIC, "abs": abs}, {})
        given = np.r_[
            layout.wtg("wind_start"), layout.wtg("wind_end"), layout.machine("connected"), layout.wtg("connected")
        ]
        given = np.r_[given, layout.rows.admittance : layout.rows.lane, layout.lane("status")]
        found = []
        for step in range(self.tape.n_steps):
            after = self._before(step + 1)
            rows = Rows(lambda row, v=values, k=step: v[row] if row < self.n_rows else actions[k, :, row - self.n_rows])
            act(rows, self.c, self.task, Actions(self.n_rows, actions.shape[2], rows.__missing__), (0,))
            at = np.array(list(rows))
            values = values.at[at].set(jnp.stack(list(rows.values())))
            values = values.at[given].set(after[given]).at[layout.rows.extra + TASK.was_active].set(1.0)
            n = int(self.c["n_substeps"])
            for k in range(n):
                values = self._runge_kutta(values, k, 1.0 / n, h)
            values = values.at[layout.lane("step")].set(after[layout.lane("step")])
            values = self._charge(self._rates(self._extremes(values), 1.0))
            found.append(values[rules.terms])
        return jnp.stack(found)

    def _runge_kutta(self, values: Any, step: int, part: float, h: float) -> Any:
        y, rates = self.layout.state_rows, self.layout.rate_rows
        start, steps = values[y], self.tape._rules.steps
        k1 = self._rates(values, step * part)[rates]
        k2 = self._rates(values.at[y].set(start + 0.5 * h * k1), (step + 0.5) * part)[rates]
        k3 = self._rates(values.at[y].set(start + 0.5 * h * k2), (step + 0.5) * part)[rates]
        last = self._rates(values.at[y].set(start + h * k3), (step + 1.0) * part)
        values = last.at[y].set(start + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + last[rates]))
        limited = jnp.clip(values[steps.states], steps.low[:, np.newaxis], steps.high[:, np.newaxis])
        values = values.at[steps.states].set(limited)
        if not self.layout.n_extended:
            return values
        bases = _bases(self.layout)
        began = np.array([y.tolist().index(row) for row in bases])
        return self._energies(values.at[np.array(list(bases.values()))].set(start[began]))
