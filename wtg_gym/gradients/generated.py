"""The vector-Jacobian products of the kernels, as compiled code of one plant and task.

A *work* block is a block with further rows: behind the block's own come the actions, then the constants of the plant
that are differentiated with respect to, and behind these as many rows again, which hold the cotangent (the derivative
of what is differentiated) of each of those before. Every function here pulls cotangents back through one kernel, in
place: those of the rows that it wrote become those of the rows it read.
"""

from __future__ import annotations

import hashlib
import linecache
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import intrinsic

from wtg_gym.envs.task import apply_actions, charge, observe
from wtg_gym.envs.task_layout import rocof_window
from wtg_gym.envs.task_records import GROUP, N_GROUP_ROWS, N_TASK_ROWS, TASK, CostTerms, read_task
from wtg_gym.gradients import expressions as ex
from wtg_gym.gradients.parameters import Leaf
from wtg_gym.gradients.tracing import Actions, Rows, retargeted, traced
from wtg_gym.physics.compiled import cache_folder, compilation, source_hash
from wtg_gym.physics.dynamics import derivatives
from wtg_gym.physics.elementary import exponential, fma, sine_cosine
from wtg_gym.physics.layout import (
    N_MACHINE_ROWS,
    Layout,
    Plant,
    load_machine_state,
    load_wtg_state,
    read_machine,
    read_turbine,
    store_machine_state,
    store_wtg_state,
    wtg_row,
)
from wtg_gym.physics.machine import machine_limited
from wtg_gym.physics.machine_code import DiskCache
from wtg_gym.physics.protection import track_extremes
from wtg_gym.physics.records import size
from wtg_gym.physics.wind_turbine import wtg_limited

Indices = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

#: Parameters of a tracking law that gradients are taken with respect to.
LAW_PARAMETERS = ("k_min", "k_nominal", "k_max", "inverse_time_constant")
#: Constants of a machine that every lane has in a row of its own, since a scenario may replace them.
ROW_OF_LEAF = {"two_h": "inv_two_h", "governor.inv_droop": "inv_droop"}


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
    inputs: Indices  # other rows that the right-hand side reads
    references: Indices  # of the machines' gates, which a lost governor holds where they are
    droops: Indices
    gates: Indices


class Programs(NamedTuple):
    """The kernels of a control step, one lane wide: what each row holds that they write, from the rows they read."""

    act: dict[int, Any]
    rates: dict[int, Any]
    charge: dict[int, Any]


class Rules(NamedTuple):
    """Compiled vector-Jacobian products, and the rows they are about."""

    pull_act: Callable[..., None]
    pull_rates: Callable[..., None]
    pull_charge: Callable[..., None]
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


def require_known(plant: Plant, task: npt.NDArray[np.void]) -> None:
    """Raise a ValueError for a plant or a task that gradients are not known for."""
    c = plant.constants[0]
    reasons = {
        "extended WTG groups (physics='extended' or 'nrel-5mw')": c["extension"].shape[0] > 0,
        "a C_p table": c["cells"].shape[0] > 0,
        "hydro governors": c["hydro"].shape[0] > 0,
        "load shedding": c["shedding"].shape[0] > 0,
        "sensors (version v1)": task["sensed"].shape[1] > 0,
        "on_failure='trip'": bool(c["trips_groups"]),
    }
    if found := [reason for reason, there in reasons.items() if there]:
        raise ValueError(f"gradients are for the paper's physics (version v0); not known: {', '.join(found)}")


def _with_rows(c: Any, rows: Mapping[Leaf, int]) -> dict[str, Any]:
    """Return a plant's constants, some of which are what rows hold."""
    found: dict[str, Any] = {name: c[name] for name in c.dtype.names}
    machines = [{name: machine[name] for name in machine.dtype.names} for machine in c["machines"]]
    turbine = {name: c["turbine"][name] for name in c["turbine"].dtype.names}
    for leaf, row in rows.items():
        (machines[leaf.place] if leaf.part == "machines" else turbine)[leaf.name] = ex.row_of_block(row)
    return {**found, "machines": np.array(machines, dtype=object), "turbine": turbine}


def programs_of(
    plant: Plant, task: npt.NDArray[np.void], n_rows: int, n_action: int, constants: Mapping[Leaf, int] | None = None
) -> Programs:
    """Trace the kernels of a control step; actions are in rows n_rows … of a work block, `constants` in those given."""
    ex.begin()
    c, lanes = _with_rows(plant.constants[0], constants or {}), (0,)
    t = retargeted(read_task)(task[0])
    act, rates, extremes = retargeted(apply_actions), retargeted(derivatives), retargeted(track_extremes)
    charged, observed = retargeted(charge), retargeted(observe)

    def at_end(block: Rows) -> None:
        # For the frequency of the centre of inertia: that of the states at the interval's end.
        extremes(block, c, lanes)
        charged(block, c, t, False, lanes)
        observed(block, c, t, False, lanes)

    return Programs(
        act=traced(lambda block: act(block, c, t, Actions(n_rows, n_action, ex.row_of_block), lanes)),
        rates=traced(lambda block: rates(block, c, ex.argument(0), lanes)),
        charge=traced(at_end),
    )


def build_rules(
    plant: Plant,
    task: npt.NDArray[np.void],
    layout: Layout,
    n_action: int,
    n_observation: int,
    leaves: Sequence[Leaf] = (),
) -> Rules:
    """Differentiate the kernels of a known plant and task; what comes of it is compiled when it is first called."""
    own = layout.n_rows
    first_constant = own + n_action
    constants = {leaf: first_constant + i for i, leaf in enumerate(leaf for leaf in leaves if not _of_lane(leaf))}
    n_rows = first_constant + len(constants)
    programs = programs_of(plant, task, own, n_action, constants)
    of_leaves = [
        int(layout.machine(ROW_OF_LEAF[leaf.name])[leaf.place]) if _of_lane(leaf) else constants[leaf]
        for leaf in leaves
    ]
    groups = layout.rows.extra + N_TASK_ROWS + rocof_window(float(task["control_dt"][0])) + 1
    # Where actions scale 1/τ, the law's own is kept beside them.
    inv_tau = groups + np.arange(layout.n_wtg) * N_GROUP_ROWS + GROUP.base_inv_tau
    if not task["modulates_tau"][0]:
        inv_tau = layout.wtg("inv_tau")
    law = np.stack([*(layout.wtg(name) for name in LAW_PARAMETERS[:3]), inv_tau], axis=1)
    terms = layout.rows.extra + TASK.terms + np.arange(size(CostTerms))
    observation = np.arange(own - n_observation, own)
    rate_of = dict(zip(layout.state_rows.tolist(), layout.rate_rows.tolist(), strict=True))
    references = layout.machine("gate_reference")
    held = {int(row) for row in (*law.ravel(), *layout.wtg("inv_tau"), *layout.wtg("k_offset"), *references)}
    held |= set(of_leaves)
    speeds = (*layout.wtg("rotor_speed").tolist(), *layout.machine("speed").tolist())
    shown = [int(layout.lane("coi")), layout.rows.extra + TASK.rocof, *speeds]

    def back(program: dict[int, Any], outputs: Iterable[int], rows: Iterable[int]) -> dict[int, Any]:
        pairs = [(program[row], ex.row_of_block(n_rows + row)) for row in sorted(outputs)]
        return ex.pulled_back(pairs, rows)

    # What the cost and the observations depend on: found from the end, until nothing is added.
    moved = set(rate_of) | set(programs.rates) | set(programs.charge) | set(programs.act) | held
    seeds, states, outputs, before = {int(row) for row in (*terms, *observation)}, set[int](), set[int](), -1
    seeds |= set(shown) & set(programs.charge)
    states |= set(shown) & set(rate_of)
    while len(seeds) + len(states) + len(outputs) > before:
        before = len(seeds) + len(states) + len(outputs)
        of_charge = back(programs.charge, seeds, moved)
        outputs |= set(of_charge) & set(programs.rates)
        of_rates = back(programs.rates, {*(rate_of[row] for row in states), *outputs}, {*rate_of, *held})
        states |= (set(of_charge) | set(of_rates)) & set(rate_of)
        seeds |= set(of_charge) & set(programs.charge)
    moving = np.array(sorted(states))
    of_act = back(programs.act, programs.act, {*range(own, n_rows), *held})
    read = ex.rows_read(programs.rates[row] for row in (*(rate_of[row] for row in states), *outputs))
    low, high = (_limited(plant, bound) for bound in (-math.inf, math.inf))
    steps = Steps(
        states=moving,
        rates=np.array([rate_of[row] for row in moving.tolist()]),
        low=np.array([low[row] for row in moving.tolist()]),
        high=np.array([high[row] for row in moving.tolist()]),
        outputs=np.array(sorted(outputs)),
        inputs=np.array(sorted(read - states)),
        references=references,
        droops=layout.machine("inv_droop"),
        gates=layout.machine("gate"),
    )

    # What a kernel writes loses its cotangent to what it reads. The method wants those of the states for themselves.
    sources = (
        _source("pull_act", (), of_act, programs.act, n_rows),
        _source("pull_rates", ("fraction",), of_rates, states, n_rows),
        _source("pull_charge", (), of_charge, seeds, n_rows),
    )
    carried = states | (set(of_charge) & seeds) | set(references.tolist())
    carried -= {*programs.act, *law.ravel().tolist(), *terms.tolist(), *observation.tolist()}
    digest = hashlib.sha256("".join((source_hash(), str((own, n_rows)), *sources)).encode()).hexdigest()
    pull_act, pull_rates, pull_charge = (_compiled(source, digest) for source in sources)
    return Rules(
        pull_act=pull_act,
        pull_rates=pull_rates,
        pull_charge=pull_charge,
        steps=steps,
        carried=np.array(sorted(carried)),
        terms=terms,
        observation=observation,
        actions=np.arange(own, first_constant),
        law=law,
        leaves=np.array(of_leaves, dtype=np.int64),
        outputs=np.array(shown),
        n_rows=n_rows,
        digest=digest,
    )


def _of_lane(leaf: Leaf) -> bool:
    return leaf.part == "machines" and leaf.name in ROW_OF_LEAF


def _source(name: str, arguments: Sequence[str], pulled: dict[int, Any], replaced: Iterable[int], n_rows: int) -> str:
    """Return the source of a rule that replaces the cotangents of some rows and adds to those of others."""
    stores = {n_rows + row: pulled.get(row, 0.0) for row in sorted(replaced)}
    for row, value in pulled.items():
        stores.setdefault(n_rows + row, ex.row_of_block(n_rows + row) + value)
    return ex.function_source(name, arguments, stores)


def _limited(plant: Plant, bound: float) -> Rows:
    """Return what the limits leave of states that are all at one bound: the limits themselves."""
    c, rows = plant.constants[0], Rows(lambda _: bound)
    load_machine, load_wtg = retargeted(load_machine_state), retargeted(load_wtg_state)
    limited_machine, limited_wtg = retargeted(machine_limited), retargeted(wtg_limited)
    for i in range(c["machines"].size):
        o = i * N_MACHINE_ROWS
        limited = limited_machine(load_machine(rows, o, 1), retargeted(read_machine)(c["machines"][i]))
        retargeted(store_machine_state)(limited, rows, o, 1)
    for j in range(c["share"].size):
        o = retargeted(wtg_row)(c, j)
        limited = limited_wtg(load_wtg(rows, o, 1), retargeted(read_turbine)(c["turbine"]))
        retargeted(store_wtg_state)(limited, rows, o, 1)
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
    compilation()
    # Machine code is linked by names: of two functions with one name, loaded from disk, the first would be called.
    function.__qualname__ = f"{function.__qualname__}_{digest[:16]}"
    result = numba.njit(nogil=True, error_model="numpy")(function)
    if result is not function:
        result._cache = DiskCache(function, cache_folder(), digest)
    return result
