"""Back through one control step: play it again on a tape, then pull cotangents back through its programs in turn.

The programs are those of the step (:mod:`wtg_gym.physics.step`, :mod:`wtg_gym.envs.task`), the right-hand side in three
parts: flows, the sweeps that hold currents, motion. What is no system has its rule here: the fixed point of the sweeps,
a governor that an event takes away, the ring of measurements. Discrete events and the ends of runs do not move.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs import task as of_task
from wtg_gym.envs.actions import ACT
from wtg_gym.envs.charging import CHARGE
from wtg_gym.envs.measuring import MEASURE
from wtg_gym.envs.observation import N_MEASURED
from wtg_gym.envs.observing import OBSERVE
from wtg_gym.envs.task import TaskData, draw_noise, pass_ring, read_actions
from wtg_gym.physics import integration, protection, step
from wtg_gym.physics.extension_unit import EXTENSIONS
from wtg_gym.physics.integration import (
    apply_events,
    combine_load_noise,
    enter_interval,
    protect,
    protections_sample,
    stage_scalars,
)
from wtg_gym.physics.kernel_data import LaneData, Plant, structured
from wtg_gym.physics.layout import Floats, Lanes, Layout, Whole
from wtg_gym.physics.units import PAIRS, UNITS
from wtg_gym.systems.compiled import compiled, inlined
from wtg_gym.systems.programs import NONE, Arrangement, in_one_table

#: The way back through the sweeps that hold currents ends where no cotangent changes by more than this share of the
#: lane's largest. They come some thirty times at most; if ever this many were too few, not a number comes back.
_SWEEPS = 1000
_SETTLED = 1e-13
#: Scalars of the evaluation at an interval's end.
AT_END = (1.0, 0.0, 0.0, 0.0)

PROGRAMS = in_one_table(
    *integration.PROGRAMS,
    *of_task.PROGRAMS,
    ACTED=ACT,
    FLOWS=step.FLOWS,
    SWEEP=step.SWEEP,
    MOTION=step.MOTION,
    RATES=step.RATES,
    FINISHED=step.FINISH[:-2],
    CHARGED=CHARGE,
    MEASURED=MEASURE,
    OBSERVED=OBSERVE,
    LIMITS=step.LIMITS,
    REST=(protection.track_extremes, protection.shed_load),
)
_acted, _flows, _sweep, _motion, _rates, _finished, _charged, _measured, _observed, _limits, _rest = PROGRAMS
_act, _flow, _move, _rate, _finish, _charge, _measure, _observe = (
    program.taped() for program in (_acted, _flows, _motion, _rates, _finished, _charged, _measured, _observed)
)
_note_sweep, _hold, _end_step = _sweep.taped(runs=False), _limits.function(), _rest.function()


class TapePlaces(NamedTuple):
    """Rows that each program notes on the tape in one run, and what the rules look for in block and scratch."""

    acted: int
    flows: int
    sweep: int
    motion: int
    rates: int
    finished: int
    charged: int
    measured: int
    observed: int
    admittance_s: int  # first row in scratch, and how many
    n_admittance: int
    flows_s: int  # of the units' voltages and currents
    n_flows: int
    extensions_s: int
    n_extensions: int


class Rules(NamedTuple):
    """What the rules read besides a plant."""

    places: npt.NDArray[np.void]  # (1,), of TapePlaces
    reactances: Whole  # rows in scratch of each group whose current can be limited
    references: Whole  # rows of the machines' gates, which a lost governor holds where they are
    droops: Whole
    gates: Whole


def rules_of(layout: Layout, plant: Arrangement) -> Rules:
    """Return what the rules read, for a plant."""
    noted = {name: program.tape_rows(plant) for name, program in zip(TapePlaces._fields[:9], PROGRAMS[:9], strict=True)}
    places = TapePlaces(
        **noted,
        admittance_s=layout.first_scratch[PAIRS],
        n_admittance=layout.n_units(PAIRS) * sum(layout.sizes(PAIRS)),
        flows_s=layout.first_scratch[UNITS],
        n_flows=layout.n_unit * sum(layout.sizes(UNITS)),
        extensions_s=layout.first_scratch[EXTENSIONS],
        n_extensions=layout.n_extended * sum(layout.sizes(EXTENSIONS)),
    )
    return Rules(
        structured(TapePlaces, [places]),
        layout.first_rows(EXTENSIONS, "reactance"),
        layout.machine("gate_reference"),
        layout.machine("inv_droop"),
        layout.machine("gate"),
    )


def tape_size(rules: Rules, n_substeps: int) -> int:
    """Return how many rows a control step notes."""
    p = {name: int(rules.places[name][0]) for name in TapePlaces._fields}
    rhs = p["flows"] + p["sweep"]
    of_step = 4 * (rhs + p["motion"]) + p["finished"]
    return p["acted"] + n_substeps * of_step + rhs + p["rates"] + p["charged"] + p["measured"] + p["observed"]


class Work(NamedTuple):
    """What a thread needs to go back through a control step of a block."""

    scratch: Floats  # (n_scratch · width)
    scratch_bars: Floats
    tape: Floats  # (tape_size · width)
    admittances: Floats  # of every simulation step (n_substeps, n_admittance · width)
    limited: npt.NDArray[np.bool_]  # lanes with a limited current, at every evaluation (4 n_substeps + 1, width)
    lost: npt.NDArray[np.bool_]  # governors lost at the start of every simulation step (n_substeps, n_machines, width)


def work_of(rules: Rules, layout: Layout, n_substeps: int, width: int) -> Work:
    """Return room for a thread."""
    n_scratch = layout.n_scratch * width
    return Work(
        np.zeros(n_scratch),
        np.zeros(n_scratch),
        np.zeros(tape_size(rules, n_substeps) * width),
        np.zeros((n_substeps, int(rules.places["n_admittance"][0]) * width)),
        np.zeros((4 * n_substeps + 1, width), dtype=np.bool_),
        np.zeros((n_substeps, layout.n_sync, width), dtype=np.bool_),
    )


@inlined
def _flow_and_hold(
    block: Floats,
    scratch: Floats,
    plant: Plant,
    rules: Rules,
    tape: Floats,
    limited: npt.NDArray[np.bool_],
    lanes: Lanes,
) -> None:
    """Find voltages and currents, and hold the currents within their limits; note the fixed point that the sweeps find."""
    tables, width = plant.tables, len(lanes)
    _flow(block, scratch, tables, tape, NONE, lanes)
    _hold(block, scratch, tables, NONE, lanes)
    limited[:] = False
    for row in rules.reactances:
        for x in range(width):
            limited[x] |= scratch[row * width + x] > 0.0
    noted = tape[rules.places[0]["flows"] * width :]
    _note_sweep(block, scratch, tables, noted, NONE, lanes)


@inlined
def _replay_events(
    block: Floats,
    first_lane: int,
    plant: Plant,
    data: LaneData,
    rules: Rules,
    lost: npt.NDArray[np.bool_],
    lanes: Lanes,
) -> bool:
    """Let events strike like :func:`~wtg_gym.physics.integration.apply_events`; note which governors they take away."""
    width = len(lanes)
    for i in range(rules.droops.shape[0]):
        for x in range(width):
            lost[i, x] = block[rules.droops[i] * width + x] > 0.0
    changed = apply_events(block, first_lane, plant, data, lanes)
    for i in range(rules.droops.shape[0]):
        for x in range(width):
            lost[i, x] &= block[rules.droops[i] * width + x] == 0.0
    return changed


@inlined
def _replay(
    block: Floats, first_lane: int, plant: Plant, data: LaneData, rules: Rules, work: Work, at: int, lanes: Lanes
) -> int:
    """Advance a block by a control interval like :func:`~wtg_gym.physics.integration.advance_interval`, on tape.

    `at` is the row of the tape where its notes begin; returned is the row where they end.
    """
    tables, scratch, width = plant.tables, work.scratch, len(lanes)
    p = rules.places[0]
    admittance = scratch[p["admittance_s"] * width : (p["admittance_s"] + p["n_admittance"]) * width]
    enter_interval(block, first_lane, plant, data, lanes)
    combine_load_noise(block, scratch, plant, lanes)
    n_substeps = plant.facts[0]["n_substeps"]
    for step in range(n_substeps):
        if _replay_events(block, first_lane, plant, data, rules, work.lost[step], lanes):
            combine_load_noise(block, scratch, plant, lanes)
        work.admittances[step, :] = admittance
        for stage in range(4):
            _flow_and_hold(block, scratch, plant, rules, work.tape[at * width :], work.limited[4 * step + stage], lanes)
            at += p["flows"] + p["sweep"]
            _move(block, scratch, tables, work.tape[at * width :], stage_scalars(plant, step, stage), lanes)
            at += p["motion"]
        _finish(block, scratch, tables, work.tape[at * width :], NONE, lanes)
        at += p["finished"]
        _end_step(block, scratch, tables, NONE, lanes)
        if protections_sample(plant, step):
            protect(block, scratch, plant, lanes)
    _flow_and_hold(block, scratch, plant, rules, work.tape[at * width :], work.limited[4 * n_substeps], lanes)
    at += p["flows"] + p["sweep"]
    _rate(block, scratch, tables, work.tape[at * width :], AT_END, lanes)
    return at + p["rates"]


@inlined
def _pull_ring(block: Floats, bars: Floats, scratch_bars: Floats, task: TaskData, n_wtg: int, lanes: Lanes) -> None:
    """Go back through the ring of measurements: from what is shown to where it was copied from, then to what is seen."""
    places, width, n_delayed = task.places[0], len(lanes), task.places[0]["n_delayed"]
    for x in range(width):
        interval = block[places["interval"] * width + x]
        newest = int(interval) % n_delayed * n_wtg
        arrived = int(max(interval - block[places["delay"] * width + x], 0.0)) % n_delayed * n_wtg
        for j in range(n_wtg):
            for k in range(N_MEASURED):
                seen, shown = places["seen_s"] + j * places["seen_step"], places["shown_s"] + j * places["shown_step"]
                old = (places["ring"] + (arrived + j) * N_MEASURED + k) * width + x
                bars[old] += scratch_bars[(shown + k) * width + x]
                scratch_bars[(shown + k) * width + x] = 0.0
                kept = (places["ring"] + (newest + j) * N_MEASURED + k) * width + x
                scratch_bars[(seen + k) * width + x] += bars[kept]
                bars[kept] = 0.0


@inlined
def _pull_lost_governors(bars: Floats, rules: Rules, lost: npt.NDArray[np.bool_], lanes: Lanes) -> None:
    """The reference of a governor that is lost here is where its gate was; no droop acts from here on."""
    width = len(lanes)
    for i in range(rules.droops.shape[0]):
        for x in range(width):
            if lost[i, x]:
                bars[rules.droops[i] * width + x] = 0.0
                bars[rules.gates[i] * width + x] += bars[rules.references[i] * width + x]
                bars[rules.references[i] * width + x] = 0.0


@functools.cache
def build_pull(*, constants: bool) -> Any:
    """Return the compiled function that goes back through one control step; with cotangents of constants or without."""
    acted, flows, sweep, motion, rates, finished, charged, measured, observed = (
        program.back(constants=constants) for program in PROGRAMS[:9]
    )

    def named(function: Any) -> Any:
        # Machine code is kept by names.
        function.__qualname__ += "_constants" if constants else "_rows"
        return function

    @inlined
    @named
    def pull_limits(
        bars: Floats,
        constant_bars: Floats,
        plant: Plant,
        rules: Rules,
        work: Work,
        at: int,
        limited: npt.NDArray[np.bool_],
        lanes: Lanes,
    ) -> None:
        """Go back through the sweeps that held the currents of some lanes.

        As the sweeps end at a fixed point, each has the derivatives of the last: this is the adjoint of that point,
        approached as the sweeps approached it. Lanes without a limited current keep their bits.
        """
        if not limited.any():
            return
        p, width, found = rules.places[0], len(lanes), work.scratch_bars
        edges = ((p["flows_s"], p["n_flows"]), (p["extensions_s"], p["n_extensions"]))
        settled, before = ~limited, np.empty_like(found)
        for _ in range(_SWEEPS):
            before[:] = found
            sweep(bars, found, plant.tables, work.tape[at * width :], work.scratch, constant_bars, NONE, lanes)
            for x in range(width):
                largest, change = 0.0, 0.0
                for first, n in edges:
                    for row in range(first, first + n):
                        i = row * width + x
                        if settled[x]:
                            found[i] = before[i]
                        largest, change = max(largest, abs(found[i])), max(change, abs(found[i] - before[i]))
                settled[x] |= not change > _SETTLED * largest
            if settled.all():
                return
        for x in range(width):
            if not settled[x]:
                for row in range(p["flows_s"], p["flows_s"] + p["n_flows"]):
                    found[row * width + x] = np.nan

    @inlined
    @named
    def pull_flows(
        bars: Floats,
        constant_bars: Floats,
        plant: Plant,
        rules: Rules,
        work: Work,
        at: int,
        limited: npt.NDArray[np.bool_],
        lanes: Lanes,
    ) -> None:
        """Go back through the voltages and currents that a right-hand side begins with; `at` is their row on the tape."""
        width = len(lanes)
        pull_limits(bars, constant_bars, plant, rules, work, at + rules.places[0]["flows"], limited, lanes)
        tape, given = work.tape[at * width :], work.scratch_bars
        flows(bars, given, plant.tables, tape, work.scratch, constant_bars, NONE, lanes)

    @named
    def pull(
        blocks: Floats,
        bars: Floats,
        observation_bars: Floats,
        action_bars: Floats,
        constant_bars: Floats,
        first: int,
        last: int,
        plant: Plant,
        data: LaneData,
        task: TaskData,
        actions: Floats,
        rules: Rules,
        work: Work,
        lanes: Lanes,
    ) -> None:
        """Go back through one control step of the blocks first … last - 1.

        Args:
            blocks: as they stood before the step; as they stand after it on return (n_blocks, n_rows · width).
            bars: cotangents after the step; on return those before it.
            observation_bars: of the observations (n_lanes, n_observation).
            action_bars: takes those of the actions (n_lanes, n_action).
            constant_bars: those of the constants are added to (n_blocks, n_numbers · width).
            plant, data, task, lanes: as for :func:`~wtg_gym.envs.task.step_blocks`.
            actions: of the step (n_lanes, n_action).
            rules, work: see :func:`rules_of` and :func:`work_of`.
        """
        tables, scratch, given = plant.tables, work.scratch, work.scratch_bars
        p, places, width, n_wtg = rules.places[0], task.places[0], len(lanes), plant.share.shape[0]
        n_substeps, sensed = plant.facts[0]["n_substeps"], task.places[0]["n_delayed"] > 0
        n_action = actions.shape[1] // max(n_wtg, 1)
        for b in range(first, last):
            block, own, to = blocks[b], bars[b], constant_bars[b]
            read_actions(scratch, actions, b * width, task, lanes)
            _act(block, scratch, tables, work.tape, NONE, lanes)
            at = _replay(block, b * width, plant, data, rules, work, p["acted"], lanes)
            _charge(block, scratch, tables, work.tape[at * width :], NONE, lanes)
            at += p["charged"]
            if sensed:
                draw_noise(block, scratch, task, n_wtg, lanes)
                _measure(block, scratch, tables, work.tape[at * width :], NONE, lanes)
                pass_ring(block, scratch, task, n_wtg, lanes)
            at += p["measured"]
            _observe(block, scratch, tables, work.tape[at * width :], NONE, lanes)

            given[:] = 0.0
            for x in range(min(width, actions.shape[0] - b * width)):
                for k in range(task.observed.shape[0]):
                    given[task.observed[k] * width + x] += observation_bars[b * width + x, k]
            observed(own, given, tables, work.tape[at * width :], scratch, to, NONE, lanes)
            at -= p["measured"]
            if sensed:
                _pull_ring(block, own, given, task, n_wtg, lanes)
                measured(own, given, tables, work.tape[at * width :], scratch, to, NONE, lanes)
            at -= p["charged"]
            charged(own, given, tables, work.tape[at * width :], scratch, to, NONE, lanes)
            at -= p["rates"]
            rates(own, given, tables, work.tape[at * width :], scratch, to, AT_END, lanes)
            at -= p["flows"] + p["sweep"]
            pull_flows(own, to, plant, rules, work, at, work.limited[4 * n_substeps], lanes)
            for step in range(n_substeps - 1, -1, -1):
                start, end = p["admittance_s"] * width, (p["admittance_s"] + p["n_admittance"]) * width
                scratch[start:end] = work.admittances[step]
                at -= p["finished"]
                finished(own, given, tables, work.tape[at * width :], scratch, to, NONE, lanes)
                for stage in range(3, -1, -1):
                    at -= p["motion"]
                    scalars = stage_scalars(plant, step, stage)
                    motion(own, given, tables, work.tape[at * width :], scratch, to, scalars, lanes)
                    at -= p["flows"] + p["sweep"]
                    pull_flows(own, to, plant, rules, work, at, work.limited[4 * step + stage], lanes)
                _pull_lost_governors(own, rules, work.lost[step], lanes)
            acted(own, given, tables, work.tape, scratch, to, NONE, lanes)
            for x in range(min(width, actions.shape[0] - b * width)):
                for j in range(n_wtg):
                    row = places["wanted_s"] + j * places["wanted_step"]
                    if places["modulates_k"]:
                        action_bars[b * width + x, j * n_action] = given[row * width + x]
                    if places["modulates_tau"]:
                        action_bars[b * width + x, (j + 1) * n_action - 1] = given[(row + 1) * width + x]

    return compiled(pull)
