"""The vector-Jacobian products of the kernels, as compiled code of one plant and task.

A *work* block is a block with further rows. Behind the block's own come the actions; with sensors the measurements,
their random numbers and the control interval; and the constants of the plant that are differentiated with respect to.
As many rows follow again: the cotangent (the derivative of what is differentiated) of each row before. Every function
here pulls cotangents back through one kernel, in place: those of the rows that it wrote become those of the rows it
read.
"""

from __future__ import annotations

import hashlib
import linecache
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import intrinsic

from wtg_gym.envs.task_records import GROUP, N_GROUP_ROWS, TASK, CostTerms, parts_of, read_task
from wtg_gym.systems import expressions as ex
from wtg_gym.gradients.kernel_programs import ROW_OF_LEAF, Further, Indices, Programs, is_of_lane, programs_of
from wtg_gym.gradients.plant_parameters import Leaf
from wtg_gym.systems.tracing import Rows, retargeted
from wtg_gym.systems.compiled import compiled, source_hash
from wtg_gym.systems.elementary import exponential, fma, sine_cosine
from wtg_gym.physics.kernel_data import Plant
from wtg_gym.physics.layout import (
    EXTENSION,
    N_EXTENSION_STATES,
    N_MACHINE_ROWS,
    N_WTG_ROWS,
    N_WTG_STATES,
    Layout,
    extension_at,
    load_extension_state,
    load_machine_state,
    load_wtg_state,
    read_extension,
    read_machine,
    read_turbine,
    store_extension_state,
    store_machine_state,
    store_wtg_state,
    wtg_row,
)
from wtg_gym.physics.machine import machine_limited
from wtg_gym.systems.records import size
from wtg_gym.physics.wind_turbine import extension_limited, wtg_limited

Floats = npt.NDArray[np.float64]

#: Parameters of a tracking law that gradients are taken with respect to.
LAW_PARAMETERS = ("k_min", "k_nominal", "k_max", "inverse_time_constant")


@intrinsic
def _chosen(typing_context: Any, condition: Any, value: Any, other: Any) -> Any:
    """`select` as an instruction: a branch apiece would take the compiler twice as long."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.select(*arguments)

    return types.float64(types.boolean, types.float64, types.float64), code


class Steps(NamedTuple):
    """Which rows the Runge-Kutta method moves, and what it reads besides them."""

    states: Indices  # those that the cost or an observation depends on
    rates: Indices  # of each of them
    low: Floats  # its limits
    high: Floats
    outputs: Indices  # of the right-hand side, that cost and observations read at the end of an interval
    inputs: Indices  # other rows that the right-hand side and the centre of inertia read
    references: Indices  # of the machines' gates, which a lost governor holds where they are
    droops: Indices
    gates: Indices
    ends: Indices  # places in `states` of those whose value at the start of a step also enters at its end
    bases: Indices  # and the row that holds that value
    limited: Indices  # voltages and currents that limits of the current change
    sources: Indices  # voltages before they do
    reactances: Indices  # of each WTG group whose current can be limited
    measured: Indices  # first row of each WTG group in the observation, where sensors show it
    seen: Indices  # rows of a work block with what each group measures now (n_wtg, N_MEASURED)
    noise: Indices  # with its random numbers (n_wtg, N_CHANNELS)
    interval: Indices  # with the control interval that ends (1,)


class Rules(NamedTuple):
    """Compiled vector-Jacobian products, and the rows they are about."""

    pull_act: Callable[..., None]
    pull_network: Callable[..., None]
    pull_sweep: Callable[..., None]
    pull_rates: Callable[..., None]
    pull_finish: Callable[..., None]
    pull_coi: Callable[..., None]
    pull_charge: Callable[..., None]
    find_interval: Callable[..., None]  # no rule: computes the number of the control interval that ends
    steps: Steps
    carried: Indices  # rows whose cotangent goes from one control step to the one before
    terms: Indices  # of the cost of a step
    observation: Indices
    actions: Indices
    law: Indices  # (n_wtg, 4), of LAW_PARAMETERS
    leaves: Indices  # of the constants that are differentiated with respect to
    outputs: Indices  # that Tape.output_names names
    n_rows: int  # of the block with the actions; the cotangents follow
    digest: str  # of the generated code


class _KnownRows(NamedTuple):
    """Rows that are known before the kernels are traced."""

    further: Further
    leaves: list[int]  # of the constants that are differentiated with respect to
    law: Indices
    terms: Indices
    observation: Indices
    outputs: list[int]  # that Tape.output_names names
    held: set[int]  # that actions, laws and lost governors set
    rate_of: dict[int, int]  # by the row of its state
    base_of: dict[int, int]  # the row with the value at a step's start, by that of the state

    @classmethod
    def of(
        cls, parts: Any, task: npt.NDArray[np.void], layout: Layout, further: Further, leaves: Sequence[Leaf]
    ) -> _KnownRows:
        """Return them for a task, whose rows in a block are `parts`."""
        of_leaves = [
            int(layout.machine(ROW_OF_LEAF[leaf.name])[leaf.place]) if is_of_lane(leaf) else further.constants[leaf]
            for leaf in leaves
        ]
        # Where actions scale 1/τ, the law's own is kept beside them.
        inv_tau = parts.groups + np.arange(layout.n_wtg) * N_GROUP_ROWS + GROUP.base_inv_tau
        if not task["modulates_tau"][0]:
            inv_tau = layout.wtg("inv_tau")
        law = np.stack([*(layout.wtg(name) for name in LAW_PARAMETERS[:3]), inv_tau], axis=1)
        held = (*law.ravel(), *layout.wtg("inv_tau"), *layout.wtg("k_offset"), *layout.machine("gate_reference"))
        speeds = (*layout.wtg("rotor_speed").tolist(), *layout.machine("speed").tolist())
        return cls(
            further=further,
            leaves=of_leaves,
            law=law,
            terms=layout.rows.extra + TASK.terms + np.arange(size(CostTerms)),
            observation=np.arange(parts.observation, layout.n_rows),
            outputs=[int(layout.lane("coi")), layout.rows.extra + TASK.rocof, *speeds],
            held={*map(int, held), *of_leaves},
            rate_of=dict(zip(layout.state_rows.tolist(), layout.rate_rows.tolist(), strict=True)),
            base_of=_bases(layout),
        )


class _Followed(NamedTuple):
    """What cost and observations depend on, and what comes back from each kernel, by the rows that it read."""

    states: set[int]
    outputs: set[int]  # of the right-hand side
    seeds: set[int]  # rows that the end of the interval writes
    limited: list[int]  # voltages and currents that limits of the current change
    sources: set[int]  # voltages before they do
    act: dict[int, Any]
    network: dict[int, Any]
    sweep: dict[int, Any]
    rates: dict[int, Any]
    finish: dict[int, Any]
    coi: dict[int, Any]
    charge: dict[int, Any]

    @classmethod
    def of(cls, programs: Programs, known: _KnownRows, extensions: Indices) -> _Followed:
        """Go back through the programs; `extensions` are first rows of groups whose current can be limited."""

        def back(program: dict[int, Any], outputs: Iterable[int], rows: Iterable[int]) -> dict[int, Any]:
            pairs = [(program[row], ex.row_of_block(further.end + row)) for row in sorted(outputs)]
            return ex.pulled_back(pairs, rows)

        further, rate_of, held, charge = known.further, known.rate_of, known.held, programs.charge
        limited = sorted({*programs.network} & {*programs.sweep})
        sources = {int(first) + EXTENSION.source + part for first in extensions for part in range(2)}
        of_finish = back(programs.finish, programs.finish, {*rate_of, *known.base_of.values(), *known.leaves})
        of_sweep = back(programs.sweep, limited, {*limited, *sources})
        of_network = back(programs.network, programs.network, {*rate_of, *held})
        of_coi = back(programs.coi, programs.coi, {*rate_of, *held})
        moved = {*rate_of, *programs.rates, *programs.coi, *charge, *programs.act, *held}
        seeds = {*known.terms.tolist(), *further.seen.ravel().tolist()}
        seeds |= {*known.observation.tolist(), *known.outputs} & {*charge}
        states, outputs, before = {*known.outputs} & {*rate_of}, set[int](), -1
        # Found from the end, until nothing is added.
        while len(seeds) + len(states) + len(outputs) > before:
            before = len(seeds) + len(states) + len(outputs)
            of_charge = back(charge, seeds, moved)
            outputs |= {*of_charge} & {*programs.rates}
            wanted = {*(rate_of[row] for row in states), *outputs}
            of_rates = back(programs.rates, wanted, {*rate_of, *held, *programs.network})
            states |= {*of_charge, *of_coi, *of_rates, *of_network, *of_finish} & {*rate_of}
            seeds |= {*of_charge} & {*charge}
        return cls(
            states,
            outputs,
            seeds,
            limited,
            sources,
            act=back(programs.act, programs.act, {*further.actions.tolist(), *held}),
            network=of_network,
            sweep=of_sweep,
            rates=of_rates,
            finish=of_finish,
            coi=of_coi,
            charge=of_charge,
        )


def _steps_of(
    plant: Plant, layout: Layout, programs: Programs, known: _KnownRows, found: _Followed, extensions: Indices
) -> Steps:
    moving, further = sorted(found.states), known.further
    read = ex.rows_read(programs.rates[row] for row in (*(known.rate_of[row] for row in moving), *found.outputs))
    read |= ex.rows_read((*programs.network.values(), *programs.sweep.values(), *programs.coi.values()))
    read -= {*programs.network, *programs.sweep, *found.sources}
    low, high = (_limited(plant, bound) for bound in (-math.inf, math.inf))
    ends = [i for i, row in enumerate(moving) if known.base_of.get(row) in found.finish]
    return Steps(
        states=np.array(moving),
        rates=np.array([known.rate_of[row] for row in moving]),
        low=np.array([low[row] for row in moving]),
        high=np.array([high[row] for row in moving]),
        outputs=np.array(sorted(found.outputs), dtype=np.int64),
        inputs=np.array(sorted(read - found.states)),
        references=layout.machine("gate_reference"),
        droops=layout.machine("inv_droop"),
        gates=layout.machine("gate"),
        ends=np.array(ends, dtype=np.int64),
        bases=np.array([known.base_of[moving[i]] for i in ends], dtype=np.int64),
        limited=np.array(found.limited, dtype=np.int64),
        sources=np.array(sorted(found.sources), dtype=np.int64),
        reactances=extensions + EXTENSION.output,
        measured=np.array(list(programs.measured.values()), dtype=np.int64),
        seen=further.seen,
        noise=further.noise,
        interval=further.interval,
    )


@ex.making()
def build_rules(
    plant: Plant, task: npt.NDArray[np.void], layout: Layout, n_action: int, leaves: Sequence[Leaf] = ()
) -> Rules:
    """Differentiate the kernels of a known plant and task; the derivatives are compiled when first called.

    Args:
        plant, task, layout: of the environment.
        n_action: number of actions.
        leaves: constants of the plant that are differentiated with respect to.
    """
    parts = retargeted(parts_of, {})(plant.constants[0], retargeted(read_task)(task[0]))
    further = Further.of(layout.n_rows, n_action, layout.n_wtg * (task["sensed"].shape[1] > 0), leaves)
    n_rows, known = further.end, _KnownRows.of(parts, task, layout, further, leaves)
    programs = programs_of(plant, task, layout.n_rows, n_action, leaves)
    extensions = layout.wtg("over_power") if programs.sweep else np.zeros(0, dtype=np.int64)
    found = _Followed.of(programs, known, extensions)
    steps = _steps_of(plant, layout, programs, known, found, extensions)
    # A row that a kernel writes passes its cotangent on to the rows that the kernel reads. The integration method needs
    # those of the states separately.
    interval, of_states = layout.rows.extra + TASK.interval, {*found.states, *programs.network}
    code = {
        "pull_act": _source("pull_act", (), found.act, programs.act, n_rows),
        "pull_network": _source("pull_network", (), found.network, (), n_rows),
        "pull_sweep": _source("pull_sweep", (), found.sweep, found.limited, n_rows),
        "pull_rates": _source("pull_rates", ("fraction", "cells"), found.rates, of_states, n_rows),
        "pull_finish": _source("pull_finish", (), found.finish, {*programs.finish, *steps.bases.tolist()}, n_rows),
        "pull_coi": _source("pull_coi", (), found.coi, programs.coi, n_rows),
        "pull_charge": _source("pull_charge", (), found.charge, found.seeds, n_rows),
        "find_interval": ex.function_source(
            "find_interval", (), {int(row): programs.charge[interval] for row in further.interval}
        ),
    }
    ring = range(parts.delayed, parts.observation) if further.seen.size else range(0)
    carried = {*found.states, *({*found.charge} & found.seeds), *steps.references.tolist(), *ring}
    carried -= {*programs.act, *known.law.ravel().tolist(), *known.terms.tolist(), *known.observation.tolist()}
    digest = hashlib.sha256("".join((source_hash(), str((layout.n_rows, n_rows)), *code.values())).encode()).hexdigest()
    return Rules(
        **{name: _compiled(source, digest) for name, source in code.items()},
        steps=steps,
        carried=np.array(sorted(carried)),
        terms=known.terms,
        observation=known.observation,
        actions=further.actions,
        law=known.law,
        leaves=np.array(known.leaves, dtype=np.int64),
        outputs=np.array(known.outputs),
        n_rows=n_rows,
        digest=digest,
    )


def _source(name: str, arguments: Sequence[str], pulled: dict[int, Any], replaced: Iterable[int], n_rows: int) -> str:
    """Return the source of a rule that replaces the cotangents of some rows and adds to those of others."""
    stores = {n_rows + row: pulled.get(row, 0.0) for row in sorted(replaced)}
    for row, value in pulled.items():
        stores.setdefault(n_rows + row, ex.row_of_block(n_rows + row) + value)
    return ex.function_source(name, arguments, stores)


def _bases(layout: Layout) -> dict[int, int]:
    """Return the rows that hold the states of WTG groups at a step's start, by those of the states."""
    found: dict[int, int] = {}
    for j in range(layout.n_wtg):
        first = layout.rows.wtg + j * layout.rows.wtg_stride
        found |= {first + k: first + N_WTG_STATES + k for k in range(N_WTG_STATES)}
        if layout.n_extended:
            first += N_WTG_ROWS
            found |= {first + k: first + N_EXTENSION_STATES + k for k in range(N_EXTENSION_STATES)}
    return found


def _limited(plant: Plant, bound: float) -> Rows:
    """Return what the limits leave of states that are all at one bound: the limits themselves."""
    c, rows = plant.constants[0], Rows(lambda _: bound)
    load_machine, load_wtg = retargeted(load_machine_state), retargeted(load_wtg_state)
    limited_machine, limited_wtg = retargeted(machine_limited), retargeted(wtg_limited)
    load_extension, limited_extension = retargeted(load_extension_state), retargeted(extension_limited)
    for i in range(c["machines"].size):
        o = i * N_MACHINE_ROWS
        limited = limited_machine(load_machine(rows, o, 1), retargeted(read_machine)(c["machines"][i]))
        retargeted(store_machine_state)(limited, rows, o, 1)
    for j in range(c["share"].size):
        o = retargeted(wtg_row)(c, j)
        limited = limited_wtg(load_wtg(rows, o, 1), retargeted(read_turbine)(c["turbine"]))
        retargeted(store_wtg_state)(limited, rows, o, 1)
        if c["extension"].shape[0] > 0:
            at, extension = retargeted(extension_at)(c, j, 1), retargeted(read_extension)(c["extension"][0])
            limited = limited_extension(load_extension(rows, at, 1), extension)
            retargeted(store_extension_state)(limited, rows, at, 1)
    return rows


def _compiled(source: str, digest: str) -> Any:
    name = source[4 : source.index("(")]
    file = f"<{__name__}.{name}-{hashlib.sha256(source.encode()).hexdigest()[:16]}>"
    linecache.cache[file] = (len(source), None, source.splitlines(keepends=True), file)
    space: dict[str, Any] = {
        "__name__": __name__,
        "chosen": _chosen,
        "exponential": exponential,
        "fma": fma,
        "inf": math.inf,
        "math": math,
        "sine_cosine": sine_cosine,
    }
    exec(compile(source, file, "exec"), space)
    return compiled_with(space[name], digest)


def compiled_with(function: Callable[..., Any], digest: str) -> Any:
    """Compile a function like those of the kernels; `digest` names the generated code that it calls."""
    # Machine code is linked by names: of two functions with one name, loaded from disk, the first would be called.
    function.__qualname__ = f"{function.__qualname__}_{digest[:16]}"
    return compiled(function, digest=digest)
