"""Episodes that remember their steps, and the way back through them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.actions import as_actions
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.stepping import Outputs, bind, step_blocks
from wtg_gym.gradients.adjoint import N_TAPED, Work, pull, routines_of, rules_of, work_of
from wtg_gym.gradients.adjoint import programs_of as taped_programs
from wtg_gym.gradients.plant_parameters import (
    Leaf,
    Moved,
    known_parameters,
    moved_by,
    require_known_parameters,
    with_parameters,
)
from wtg_gym.physics import integration
from wtg_gym.physics.layout import Whole
from wtg_gym.physics.plant import PlantMap, PlantTables, plant_tables, programs_of, with_places
from wtg_gym.physics.scenario import Scenario
from wtg_gym.signals import undivided
from wtg_gym.systems.programs import Program, constant_places
from wtg_gym.systems.routines import code_of
from wtg_gym.tasks.cost import COST, COST_TERMS
from wtg_gym.tasks.episode import ACTING, ACTION_MODES, TASK

Floats = npt.NDArray[np.float64]
#: Parameters of a tracking law that gradients are taken with respect to.
LAW_PARAMETERS = ("k_min", "k_nominal", "k_max", "inverse_time_constant")
#: Constants of a machine that every lane has in a row of its own, since a scenario may replace them.
_ROW_OF_LEAF = {"two_h": "inv_two_h", "governor.inv_droop": "inv_droop"}
#: A copy of all blocks takes 3 kB a lane, 5 in v1: kept at every step of a long run it would fill the memory.
_STEPS_PER_CHECKPOINT = 25


class Pulled(NamedTuple):
    """Cotangents before a control step."""

    carried: Floats  # of what the step began from (n_lanes, n_carried)
    actions: Floats  # (n_lanes, n_action)
    law: Floats  # what the step adds to those of each group's law (n_lanes, n_wtg, 4), of LAW_PARAMETERS
    parameters: Floats  # and to those of the plant's parameters (n_lanes, n_parameters)


class Played(NamedTuple):
    """What episodes came to, step by step."""

    terms: Floats  # of the cost (n_steps, n_lanes, n_terms), in the order of COST_TERMS
    outputs: Floats  # at the end of each step (n_steps, n_lanes, n_outputs), see Tape.output_names


class Gradient(NamedTuple):
    """What episodes cost, and how that follows their actions, laws and plant."""

    terms: Floats  # terms of the cost, sums over the steps (n_lanes, n_terms), in the order of COST_TERMS
    actions: Floats  # of the weighted sum of the terms, with respect to the actions (n_steps, n_lanes, n_action)
    law: Floats  # with respect to each group's law (n_lanes, n_wtg, 4), in the order of LAW_PARAMETERS
    parameters: Floats  # with respect to the plant's parameters that the tape was asked for (n_lanes, n_parameters)


def _shaped(name: str, given: Any, *shapes: tuple[int, ...]) -> Floats:
    array: Floats = np.asarray(given, dtype=np.float64)
    if array.shape not in shapes:
        raise ValueError(f"{name} must have the shape {' or '.join(map(str, shapes))}, got {array.shape}")
    return array


def term_weights(weights: Mapping[str, float] | None) -> Floats:
    """Return weights of the terms of the cost in their order (n_terms,), given by name; None for the cost itself."""
    weights = dict.fromkeys(COST_TERMS, 1.0) if weights is None else weights
    if not isinstance(weights, Mapping) or not np.isfinite(list(weights.values())).all():
        raise ValueError(f"weights must be finite numbers by the names of terms, got {weights!r:.60}")
    if unknown := [term for term in weights if term not in COST_TERMS]:
        raise ValueError(f"unknown terms {unknown} of the cost; known: {', '.join(COST_TERMS)}")
    return np.array([weights.get(term, 0.0) for term in COST_TERMS])


def _meant(leaf: Leaf) -> tuple[str, str, int | None]:
    """Return what systems call a constant, an argument and its number there, and whose it is."""
    return ("machine", leaf.name, leaf.place) if leaf.part == "machines" else ("turbine", leaf.name, None)


class Tape:
    """Episodes side by side that can be differentiated, step by step in reverse.

    :meth:`step` is that of the environment, to the last bit. :meth:`pull` is the vector–Jacobian product of one step.
    Discrete times are constants: the end of an episode does not move, even where a protection brings it forward. The
    gradient of an episode that ends early is that of its cost until then; the cost of its failure is constant. At a
    corner of a law, a limit or a cost it is that of one of the branches that meet there.

    Args:
        settings: of the environment.
        n_lanes: episodes side by side.
        n_threads: threads to step with; None for one per processor.
        parameters: of the plant that gradients are wanted for as well, by name; see :func:`known_parameters`.

    Raises:
        ValueError: gradients are not known for the settings, or a parameter is unknown.
    """

    def __init__(
        self,
        settings: EnvSettings,
        n_lanes: int = 1,
        n_threads: int | None = None,
        parameters: Sequence[str] = (),
    ) -> None:
        parameters = (parameters,) if isinstance(parameters, str) else tuple(parameters)
        plant = settings.resolved_plant
        built = plant_tables(plant)
        if built.controls or built.saturates:
            models = [*built.controls, *["saturation of machines"] * built.saturates]
            raise ValueError(f"gradients do not know these models of machines: {', '.join(models)}")
        require_known_parameters(plant, parameters)
        if plant.load_frequency_dependence:
            raise ValueError("gradients do not know loads that depend on the frequency: load_frequency_dependence")
        #: Names of the plant's parameters that gradients are taken with respect to.
        self.parameters = parameters
        self._open(TaskLanes(settings, n_lanes, n_threads))
        #: Counts what makes the tape forget its steps: starts, and other values of parameters.
        self.n_starts = 0
        #: Blocks as they stood before every so many steps, and before each step from the latest of these asked for.
        self._checkpoints: list[Floats]
        self._replayed: tuple[int, list[Floats]]
        self._actions: list[Floats]
        self._begin(started=False)

    def _open(self, lanes: TaskLanes) -> None:
        """Take lanes whose steps are to be differentiated."""
        self.lanes = lanes
        simulator, settings, layout = lanes.simulator, lanes.settings, lanes.simulator.layout
        task, built = settings.task, plant_tables(simulator.settings)
        units = task.units(settings.choices)
        programs = self._programs(built)
        taped = programs[-len(taped_programs(task)) :][:N_TAPED]
        #: The plant, with the table of the programs that go back.
        self._plant = with_places(built, layout, programs, units, taped)
        self._link(programs)
        arrangement = PlantMap(built, layout, units)
        self._rules = rules_of(layout, arrangement, taped)
        self._works: dict[int, Work] = {}
        moved = moved_by(simulator.settings, self.parameters)
        self._moved = moved
        #: Places of each moved constant among those of the table; none where every lane has it in a row of its own.
        self._places = [
            []
            if leaf.name in _ROW_OF_LEAF
            else constant_places(programs, arrangement, self._plant.network.tables, *_meant(leaf))
            for leaf in moved.leaves
        ]
        inv_tau = layout.wtg("inv_tau")
        if ACTION_MODES[settings.action_mode][1]:
            # Where actions scale 1/τ, the law's own is kept beside them.
            inv_tau = layout.first_rows(ACTING, "group")
        self._law_rows = np.stack([*(layout.wtg(name) for name in LAW_PARAMETERS[:3]), inv_tau], axis=1)
        terms = layout.first_rows(COST, "terms")[0] + np.arange(len(COST_TERMS))
        outputs = [layout.lane("coi"), layout.first_rows(TASK, "rocof")[0]]
        outputs += [*layout.wtg("rotor_speed"), *layout.machine("speed")]
        #: Rows of a block: of the terms of a step's cost, and of what `output_names` names.
        self._term_rows, self._output_rows = terms, np.array(outputs, dtype=np.int64)
        self._scratch_outputs = Outputs._make(np.zeros_like(array) for array in lanes.outputs)

    def _programs(self, plant: PlantTables) -> tuple[Program, ...]:
        """Return the programs of the physics, of the task and of the tape."""
        task = self.lanes.settings.task
        return programs_of(plant, *integration.PROGRAMS, *task.programs, *taped_programs(task))

    def _link(self, programs: Sequence[Program]) -> None:
        """Let the plant know where the machine code is in this process."""
        simulator = self.lanes.simulator
        routines = (*routines_of(constants=bool(self.parameters)), *integration.STEPPING)
        code = code_of(programs, {simulator.width: routines}, simulator.functions())
        self._plant = self._plant.with_tables(self._plant.network.tables._replace(code=code))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._link(self._programs(self._plant))

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs at the end of each step, with their units."""
        rotors = (f"rotor_{j}_speed_pu" for j in range(self.lanes.n_wtg))
        machines = (f"machine_{i}_speed_pu" for i in range(self.lanes.simulator.layout.n_sync))
        return ("frequency_pu", "rocof_hz_s", *rotors, *machines)

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Give the plant other values of some of the tape's parameters; episodes need to be started again.

        Raises:
            ValueError: a parameter is none of the tape's, or its value is not allowed.
        """
        if unknown := sorted(set(values) - set(self.parameters)):
            raise ValueError(f"the tape has no parameters {unknown}; it has: {', '.join(self.parameters) or 'none'}")
        plant = with_parameters(self.lanes.simulator.settings, values)
        settings = dataclasses.replace(self.lanes.settings, plant=plant)
        self._open(TaskLanes(settings, self.lanes.n_lanes, self.lanes.simulator.threads.n_threads))
        self._begin(started=False)

    def parameter_values(self) -> dict[str, float]:
        """Return the plant's values of the tape's parameters."""
        values = known_parameters(self.lanes.simulator.settings)
        return {name: values[name] for name in self.parameters}

    @property
    def n_steps(self) -> int:
        """Steps taken since the start."""
        return len(self._actions)

    @property
    def n_carried(self) -> int:
        """How many numbers a lane carries from one step to the next, as far as cost and observations depend on them."""
        return self.lanes.simulator.layout.n_rows

    @undivided
    def start(self, scenarios: Sequence[Scenario]) -> npt.NDArray[np.float32]:
        """Start an episode in every lane, of one scenario each, and return the first observations."""
        n_lanes = self.lanes.n_lanes
        if len(scenarios) != n_lanes or not all(isinstance(scenario, Scenario) for scenario in scenarios):
            raise ValueError(f"episodes need {n_lanes} scenarios, one per lane, got {scenarios!r:.60}")
        for event in (event for scenario in scenarios for event in scenario.events):
            if getattr(event, "returns_after_s", None) is not None:
                raise ValueError(f"gradients do not go through the return of a unit: {event}")
        self.lanes.start(list(range(n_lanes)), scenarios)
        self._begin(started=True)
        return self.lanes.observations.copy()

    def _begin(self, *, started: bool) -> None:
        self._checkpoints, self._actions, self._replayed, self._started = [], [], (-1, []), started
        self.n_starts += 1

    def require_started(self) -> None:
        """Raise a ValueError before the first start."""
        if not self._started:
            raise ValueError("there are no episodes yet: call start() first")

    def set_law(self, law: Floats) -> None:
        """Replace the parameters of each group's law (n_lanes, n_wtg, 4) before the first step.

        The episodes start where they would have started: a k_nominal other than the law's own is a change at time 0.
        """
        self.require_started()
        if self._actions:
            raise ValueError("the law can be replaced before the first step only")
        law = _shaped("law", law, (self.lanes.n_lanes, *self._law_rows.shape))
        if not np.isfinite(law).all():
            raise ValueError("the parameters of laws must be finite numbers")
        self._put(self.lanes.simulator.blocks, self._law_rows, law)

    def law(self) -> Floats:
        """Return the parameters of each group's law (n_lanes, n_wtg, 4), in the order of LAW_PARAMETERS."""
        self.require_started()
        return self._take(self.lanes.simulator.blocks, self._law_rows)

    def _take(self, view: Floats, rows: npt.NDArray[np.int64]) -> Floats:
        """Return rows of every lane (n_lanes, …) of a view (n_blocks, n_rows, width)."""
        found = view[:, rows.ravel(), :].transpose(0, 2, 1)
        return found.reshape(view.shape[0] * view.shape[2], *rows.shape)[: self.lanes.n_lanes]

    def _put(self, view: Floats, rows: npt.NDArray[np.int64], values: Floats) -> None:
        own = np.arange(self.lanes.n_lanes)
        width = view.shape[2]
        view[(own // width)[:, np.newaxis], rows.ravel(), (own % width)[:, np.newaxis]] = values.reshape(own.size, -1)

    @undivided
    def step(self, actions: Floats) -> tuple[npt.NDArray[np.float32], Floats]:
        """Step every running lane.

        Args:
            actions: (n_lanes, n_action); clipped to [-1, 1].

        Returns:
            observations (n_lanes, n_observation) and the terms of the step's cost (n_lanes, n_terms), in the order of
            `COST_TERMS`; zero for lanes that had ended.
        """
        self.require_started()
        simulator, actions = self.lanes.simulator, as_actions(actions, (self.lanes.n_lanes, self.lanes.n_action))
        running = simulator.lane_values("active") > 0.5
        before = simulator.blocks.copy() if self.n_steps % _STEPS_PER_CHECKPOINT == 0 else None
        self.lanes.step(actions)
        if before is not None:
            self._checkpoints.append(before)
        self._actions.append(actions.copy())
        self._replayed = (-1, [])
        terms = self._take(self.lanes.simulator.blocks, self._term_rows)
        return self.lanes.observations.copy(), np.where(running[:, np.newaxis], terms, 0.0)

    def before(self, step: int) -> Floats:
        """Return the simulator's blocks as they stood before a step, from the nearest checkpoint on."""
        if not 0 <= step < self.n_steps:
            raise ValueError(f"there is no step {step}: since start() {self.n_steps} have been taken, the first is 0")
        place, offset = divmod(step, _STEPS_PER_CHECKPOINT)
        if self._replayed[0] != place:
            blocks, found = self._checkpoints[place].copy(), []
            first = place * _STEPS_PER_CHECKPOINT
            for own in self._actions[first : first + _STEPS_PER_CHECKPOINT]:
                found.append(blocks.copy())
                self._again(blocks, own)
            self._replayed = place, found
        return self._replayed[1][offset]

    @undivided
    def _again(self, blocks: Floats, actions: Floats) -> None:
        own = self.lanes.simulator
        bound = bind(blocks, own.scratches, own.plant.network, own.data, self.lanes.task_data, self._scratch_outputs)
        own.threads.run(lambda first, last, worker: step_blocks(bound, actions, first, last, worker, False))

    def outputs(self) -> Floats:
        """Return the outputs at the end of the latest step (n_lanes, n_outputs), in the order of `output_names`."""
        self.require_started()
        return self._take(self.lanes.simulator.blocks, self._output_rows)

    def pull(
        self,
        step: int,
        carried: Floats,
        terms: Floats,
        observations: Floats | None = None,
        outputs: Floats | None = None,
    ) -> Pulled:
        """Go back through a step.

        Args:
            step: its number, 0 for the first; steps are best gone through in turn.
            carried: derivatives with respect to what the step left behind (n_lanes, n_carried): those that the pull
                through the following step has returned, zeros for the last.
            terms: with respect to the terms of the step's cost (n_lanes, n_terms).
            observations: with respect to the observations after the step (n_lanes, n_observation); None for zeros.
            outputs: with respect to the outputs after the step (n_lanes, n_outputs); None for zeros.

        Raises:
            ValueError: the step does not exist, or derivatives have another shape.
        """
        simulator, n_lanes = self.lanes.simulator, self.lanes.n_lanes
        blocks = self.before(step).copy()
        running = self._take(blocks, np.array([simulator.layout.lane("active")])) > 0.5
        in_force = self._in_force(blocks, self._moved)
        bars = np.zeros_like(blocks)
        given = {"carried": carried, "terms": terms, "outputs": outputs}
        all_rows = np.arange(self.n_carried)
        for (name, values), rows in zip(given.items(), (all_rows, self._term_rows, self._output_rows), strict=True):
            if values is not None:
                values = _shaped(name, values, (n_lanes, rows.size))
                # Some rows are carried and shown too.
                self._put(bars, rows, self._take(bars, rows) + values * running)
        n_observation = self.lanes.n_observation
        seen = np.zeros((n_lanes, n_observation))
        if observations is not None:
            seen = _shaped("observations", observations, (n_lanes, n_observation)) * running
        of_actions = np.zeros((n_lanes, self.lanes.n_action))
        n_constants = self._plant.network.tables.numbers.size if self.parameters else 0
        constants = np.zeros((len(blocks), n_constants, simulator.width))
        simulator.threads.run(
            lambda first, last, worker: pull(
                blocks,
                bars,
                seen,
                of_actions,
                constants,
                first,
                last,
                self._plant.network,
                simulator.data,
                self.lanes.task_data,
                self._actions[step],
                self._rules,
                self._work(worker),
            )
        )
        leaves = self._leaves(bars, constants)
        law = self._take(bars, self._law_rows)
        # The law's own are what each step adds, and are not carried.
        bars[:, self._law_rows.ravel()] = 0.0
        # Of a lane that had ended nothing depends on anything, whatever its numbers.
        carried, of_actions, law, leaves = (
            np.where(running.reshape(-1, *(1,) * (own.ndim - 1)), own, 0.0)
            for own in (self._take(bars, all_rows), of_actions, law, leaves)
        )
        return Pulled(carried, of_actions, law, leaves * in_force @ self._moved.slopes)

    def _work(self, worker: int) -> Work:
        if worker not in self._works:
            simulator = self.lanes.simulator
            self._works[worker] = work_of(self._rules, simulator.layout, self._plant.n_substeps, simulator.width)
        return self._works[worker]

    def _leaves(self, bars: Floats, constants: Floats) -> Floats:
        """Return cotangents of the moved constants (n_lanes, n_leaves); those of rows are taken out of `bars`."""
        found = np.zeros((self.lanes.n_lanes, len(self._places)))
        for i, (leaf, places) in enumerate(zip(self._moved.leaves, self._places, strict=True)):
            if leaf.name in _ROW_OF_LEAF:
                row = self._row_of(leaf)
                found[:, i] = self._take(bars, row)[:, 0]
                bars[:, row] = 0.0
            else:
                found[:, i] = self._take(constants, np.array(places, dtype=np.int64)).sum(axis=1)
        return found

    def _row_of(self, leaf: Leaf) -> Whole:
        """Return the row (1,) in which every lane has a constant of a machine."""
        return self.lanes.simulator.layout.machine(_ROW_OF_LEAF[leaf.name])[leaf.place : leaf.place + 1]

    def _in_force(self, blocks: Floats, moved: Moved) -> Floats:
        """Return how far a lane's own row follows each constant of the plant (n_lanes, n_leaves); 1 for the others.

        A scenario scales inertias, 1/2H = 1/(scale · 2H). Its droop takes the place of the plant's, which then means
        the droop in force; a lost governor has none.
        """
        found = np.ones((self.lanes.n_lanes, len(moved.leaves)))
        for i, leaf in enumerate(moved.leaves):
            if leaf.name in _ROW_OF_LEAF:
                row = self._take(blocks, self._row_of(leaf))[:, 0]
                square = _ROW_OF_LEAF[leaf.name] == "inv_droop"
                found[:, i] = (row / moved.values[i]) ** 2 if square else -row / moved.values[i]
        return found

    def play(self, scenarios: Sequence[Scenario], actions: Floats) -> Played:
        """Start episodes and step them with given actions (n_steps, n_lanes, n_action)."""
        self.start(scenarios)
        terms, outputs = [], []
        for own in actions:
            terms.append(self.step(own)[1])
            outputs.append(self.outputs())
        return Played(np.array(terms), np.array(outputs))

    def back(self, terms: Floats | None = None, outputs: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Go back through all steps.

        Args:
            terms: derivatives of what is differentiated with respect to the terms of each step's cost (n_terms) or
                (n_steps, n_lanes, n_terms); None for zeros.
            outputs: with respect to the outputs at each step's end (n_steps, n_lanes, n_outputs); None for zeros. Those
                after the end of an episode, where its outputs stay as they were, count nothing.

        Returns:
            those with respect to actions, laws and parameters, as :class:`Gradient` has them.
        """
        n_lanes, n_steps = self.lanes.n_lanes, self.n_steps
        self.require_started()
        shape = (n_steps, n_lanes, len(COST_TERMS))
        seeds = np.zeros(shape) if terms is None else np.broadcast_to(_shaped("terms", terms, shape, shape[2:]), shape)
        if outputs is not None:
            outputs = _shaped("outputs", outputs, (n_steps, n_lanes, len(self.output_names)))
        actions, law = np.empty((n_steps, n_lanes, self.lanes.n_action)), np.zeros((n_lanes, *self._law_rows.shape))
        parameters, carried = np.zeros((n_lanes, len(self.parameters))), np.zeros((n_lanes, self.n_carried))
        for step in range(n_steps - 1, -1, -1):
            shown = None if outputs is None else outputs[step]
            carried, actions[step], of_law, of_parameters = self.pull(step, carried, seeds[step], outputs=shown)
            law += of_law
            parameters += of_parameters
        return actions, law, parameters

    def gradient(
        self, scenarios: Sequence[Scenario], actions: Floats, weights: Mapping[str, float] | None = None
    ) -> Gradient:
        """Play episodes with given actions and return their costs and the gradients of these.

        Args:
            scenarios: one per lane.
            actions: of as many steps as are to count (n_steps, n_lanes, n_action).
            weights: of the terms of the cost by name, those left out count nothing; None for the cost itself.

        Raises:
            ValueError: a term is unknown, a weight not finite, or there are no actions.
        """
        weight = term_weights(weights)
        actions = np.asarray(actions, dtype=np.float64)
        if actions.ndim != 3 or not actions.size:
            raise ValueError(f"actions must have the shape (n_steps, n_lanes, n_action), got {actions.shape}")
        terms = self.play(scenarios, actions).terms.sum(axis=0)
        return Gradient(terms, *self.back(weight))
