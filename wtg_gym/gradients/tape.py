"""Episodes that remember their steps, and the way back through them."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.batch import BatchSnapshot, EnvBatch
from wtg_gym.envs.interface import as_actions
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.stepping import Outputs, bind, step_blocks
from wtg_gym.gradients.adjoint import N_TAPED, Bars, Work, pull, routines_of, rules_of, work_of
from wtg_gym.gradients.adjoint import programs_of as taped_programs
from wtg_gym.gradients.plant_parameters import Moved, known_parameters, require_known_parameters, with_parameters
from wtg_gym.physics import integration
from wtg_gym.physics.layout import Floats, Whole, put_rows, rows_of_envs
from wtg_gym.physics.plant import PlantTables, memory_map, plant_tables, programs_of, with_places
from wtg_gym.physics.scenario import Scenario
from wtg_gym.ranges import require_known
from wtg_gym.signals import undivided
from wtg_gym.systems.programs import Program, constant_places
from wtg_gym.systems.routines import addresses_of
from wtg_gym.tasks.cost import COST, COST_TERMS
from wtg_gym.tasks.episode import ACTING, ACTION_MODES, TASK

#: Parameters of a tracking law that gradients are taken with respect to.
LAW_PARAMETERS = ("k_min", "k_nominal", "k_max", "inverse_time_constant")
#: A copy of all blocks takes 3 kB an environment, 5 in v1: kept at every interval it would fill the memory.
_INTERVALS_PER_CHECKPOINT = 25


class Pulled(NamedTuple):
    """Cotangents before a control step."""

    carried: Floats  # of what the step began from (num_envs, n_carried)
    actions: Floats  # (num_envs, n_action)
    law: Floats  # what the step adds to those of each group's law (num_envs, n_wtg, 4), of LAW_PARAMETERS
    parameters: Floats  # and to those of the plant's parameters (num_envs, n_parameters)


class Played(NamedTuple):
    """What episodes came to, step by step."""

    terms: Floats  # of the cost (n_steps, num_envs, n_terms), in the order of COST_TERMS
    outputs: Floats  # at the end of each step (n_steps, num_envs, n_outputs), see Tape.output_names


class Gradient(NamedTuple):
    """What episodes cost, and how that follows their actions, laws and plant."""

    terms: Floats  # terms of the cost, sums over the steps (num_envs, n_terms), in the order of COST_TERMS
    actions: Floats  # of the weighted sum of the terms, with respect to the actions (n_steps, num_envs, n_action)
    law: Floats  # with respect to each group's law (num_envs, n_wtg, 4), in the order of LAW_PARAMETERS
    parameters: Floats  # with respect to the plant's parameters that the tape was asked for (num_envs, n_parameters)


def _shaped(name: str, values: Any, *shapes: tuple[int, ...]) -> Floats:
    """Return values as an array of one of some shapes, or raise a ValueError; None gives zeros of the first."""
    array: Floats = np.zeros(shapes[0]) if values is None else np.asarray(values, dtype=np.float64)
    if array.shape not in shapes:
        raise ValueError(f"{name} must have the shape {' or '.join(map(str, shapes))}, got {array.shape}")
    return array


def term_weights(weights: Mapping[str, float] | None) -> Floats:
    """Return weights of the terms of the cost in their order (n_terms,), given by name; None for the cost itself."""
    weights = dict.fromkeys(COST_TERMS, 1.0) if weights is None else weights
    if not isinstance(weights, Mapping) or not np.isfinite(list(weights.values())).all():
        raise ValueError(f"weights must be finite numbers by the names of terms, got {weights!r:.60}")
    require_known("terms of the cost", weights, COST_TERMS)
    return np.array([weights.get(term, 0.0) for term in COST_TERMS])


class Tape:
    """Episodes side by side that can be differentiated, step by step in reverse.

    :meth:`step` is that of the environment, to the last bit. :meth:`pull` is the vector–Jacobian product of one step.
    Discrete times are constants: the end of an episode does not move, even where a protection brings it forward. The
    gradient of an episode that ends early is that of its cost until then; the cost of its failure is constant. At a
    corner of a law, a limit or a cost it is that of one of the branches that meet there.

    Args:
        settings: of the environment.
        num_envs: number of environments, side by side.
        n_threads: threads to step with; None for one per processor.
        parameters: of the plant that gradients are wanted for as well, by name; see :func:`known_parameters`.

    Raises:
        ValueError: gradients are not known for the settings, or a parameter is unknown.
    """

    def __init__(
        self, settings: EnvSettings, num_envs: int = 1, n_threads: int | None = None, parameters: Sequence[str] = ()
    ) -> None:
        parameters = (parameters,) if isinstance(parameters, str) else tuple(parameters)
        plant = settings.resolved_plant
        require_known_parameters(plant, parameters)
        if plant.load_frequency_dependence:
            raise ValueError("gradients do not know loads that depend on the frequency: load_frequency_dependence")
        #: Names of the plant's parameters that gradients are taken with respect to.
        self.parameters = parameters
        self._open(EnvBatch(dataclasses.replace(settings, reward="cost"), num_envs, n_threads))
        #: Counts what makes the tape forget its steps: starts, and other values of parameters.
        self.n_starts = 0
        self._begin(started=False)

    def _open(self, batch: EnvBatch) -> None:
        """Take environments whose steps are to be differentiated."""
        self.batch = batch
        # A step goes through its intervals one by one: each is recorded, and gone back through.
        batch.task_data = batch.task_data._replace(n_intervals=1)
        simulator, settings, layout = batch.simulator, batch.settings, batch.simulator.layout
        task, built = settings.task, plant_tables(simulator.settings)
        units = task.units(settings.choices)
        programs = self._programs(built)
        taped = programs[-len(taped_programs(task)) :][:N_TAPED]
        #: The plant, with the code of the programs that go back.
        self._plant = with_places(built, layout, programs, units, taped)
        self._link(programs)
        plant_map, code = memory_map(built, layout, units), self._plant.network.code
        self._rules = rules_of(layout, plant_map, taped)
        self._works: dict[int, Work] = {}
        places_of = functools.partial(constant_places, programs, plant_map, code)
        self._moved = Moved(simulator.settings, self.parameters, layout, places_of)
        inv_tau = layout.wtg("inv_tau")
        if ACTION_MODES[settings.action_mode][1]:
            # Where actions scale 1/τ, the law's own is kept beside them.
            inv_tau = layout.first_rows(ACTING, "group")
        self._law_rows = np.stack([*(layout.wtg(name) for name in LAW_PARAMETERS[:3]), inv_tau], axis=1)
        terms = layout.first_rows(COST, "terms")[0] + np.arange(len(COST_TERMS))
        outputs = [layout.env("coi"), layout.first_rows(TASK, "rocof")[0]]
        outputs += [*layout.wtg("rotor_speed"), *layout.machine("speed")]
        #: Rows of a block: of the terms of a step's cost, and of what `output_names` names.
        self._term_rows, self._output_rows = terms, np.array(outputs, dtype=np.int64)
        self._scratch_outputs = Outputs._make(np.zeros_like(array) for array in batch.outputs)

    def _programs(self, plant: PlantTables) -> tuple[Program, ...]:
        task = self.batch.settings.task
        return programs_of(plant, *integration.PROGRAMS, *task.programs, *taped_programs(task))

    def _link(self, programs: Sequence[Program]) -> None:
        simulator = self.batch.simulator
        routines = {simulator.width: (*routines_of(constants=bool(self.parameters)), *integration.STEPPING)}
        self._plant = self._plant.with_addresses(addresses_of(programs, routines, simulator.functions()))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._link(self._programs(self._plant))

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the outputs at the end of each step, with their units."""
        rotors = (f"rotor_{j}_speed_pu" for j in range(self.batch.n_wtg))
        machines = (f"machine_{i}_speed_pu" for i in range(self.batch.simulator.layout.n_sync))
        return ("frequency_pu", "rocof_hz_s", *rotors, *machines)

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Give the plant other values of some of the tape's parameters; episodes need to be started again.

        Raises:
            ValueError: a parameter is none of the tape's, or its value is not allowed.
        """
        if unknown := sorted(set(values) - set(self.parameters)):
            raise ValueError(f"the tape has no parameters {unknown}; it has: {', '.join(self.parameters) or 'none'}")
        plant = with_parameters(self.batch.simulator.settings, values)
        settings = dataclasses.replace(self.batch.settings, plant=plant)
        self._open(EnvBatch(settings, self.batch.num_envs, self.batch.simulator.threads.n_threads))
        self._begin(started=False)

    def parameter_values(self) -> dict[str, float]:
        """Return the plant's values of the tape's parameters."""
        values = known_parameters(self.batch.simulator.settings)
        return {name: values[name] for name in self.parameters}

    @property
    def n_steps(self) -> int:
        """Steps taken since the start."""
        return len(self._actions) // self.batch.settings.n_intervals

    @property
    def n_carried(self) -> int:
        """How many numbers each environment carries to the next step, of those that cost and observations depend on."""
        return self.batch.simulator.layout.n_rows

    @undivided
    def start(self, scenarios: Sequence[Scenario]) -> npt.NDArray[np.float32]:
        """Start an episode in every environment, of one scenario each, and return the first observations."""
        num_envs = self.batch.num_envs
        if len(scenarios) != num_envs or not all(isinstance(scenario, Scenario) for scenario in scenarios):
            raise ValueError(f"episodes need {num_envs} scenarios, one per environment, got {scenarios!r:.60}")
        self.batch.start(list(range(num_envs)), scenarios)
        self._begin(started=True)
        return self.batch.observations.copy()

    @undivided
    def resume(self, snapshot: BatchSnapshot) -> npt.NDArray[np.float32]:
        """Go on from a snapshot of `batch` as if episodes started there, and return its observations."""
        self.batch.restore(snapshot)
        self._begin(started=True)
        return self.batch.observations.copy()

    def _begin(self, *, started: bool) -> None:
        self._started = started
        self.n_starts += 1
        #: Actions of each interval since the start (num_envs, n_action).
        self._actions: list[Floats] = []
        #: Blocks before every so many intervals, and before each interval from the latest of these asked for.
        self._checkpoints: list[Floats] = []
        self._replayed: tuple[int, list[Floats]] = -1, []

    def require_started(self) -> None:
        """Raise a ValueError before the first start."""
        if not self._started:
            raise ValueError("there are no episodes yet: call start() first")

    def set_law(self, law: Floats) -> None:
        """Replace the parameters of each group's law (num_envs, n_wtg, 4) before the first step.

        The episodes start where they would have started: a k_nominal other than the law's own is a change at time 0.
        """
        self.require_started()
        if self.n_steps:
            raise ValueError("the law can be replaced before the first step only")
        law = _shaped("law", law, (self.batch.num_envs, *self._law_rows.shape))
        if not np.isfinite(law).all():
            raise ValueError("the parameters of laws must be finite numbers")
        put_rows(self.batch.simulator.blocks, self._law_rows, law)

    def law(self) -> Floats:
        """Return the parameters of each group's law (num_envs, n_wtg, 4), in the order of LAW_PARAMETERS."""
        self.require_started()
        return self._rows(self._law_rows)

    @undivided
    def step(self, actions: Floats) -> tuple[npt.NDArray[np.float32], Floats]:
        """Step every running environment.

        Args:
            actions: (num_envs, n_action); clipped to [-1, 1].

        Returns:
            observations (num_envs, n_observation) and the terms of the step's cost (num_envs, n_terms), in the order of
            `COST_TERMS`; zero for those that had ended.
        """
        self.require_started()
        simulator, actions = self.batch.simulator, as_actions(actions, (self.batch.num_envs, self.batch.n_action))
        terms = np.zeros((self.batch.num_envs, len(COST_TERMS)))
        for _ in range(self.batch.settings.n_intervals):
            running = simulator.env_values("active") > 0.5
            before = [] if len(self._actions) % _INTERVALS_PER_CHECKPOINT else [simulator.blocks.copy()]
            self.batch.step(actions)
            self._checkpoints += before
            self._actions.append(actions.copy())
            self._replayed = -1, []
            terms += np.where(running[:, np.newaxis], self._rows(self._term_rows), 0.0)
        return self.batch.observations.copy(), terms

    def before(self, step: int) -> Floats:
        """Return the simulator's blocks as they stood before a step."""
        return self._before(step * self.batch.settings.n_intervals)

    def _before(self, interval: int) -> Floats:
        """Return the blocks before an interval, from the nearest checkpoint on."""
        if not 0 <= interval < len(self._actions):
            step, taken = interval // self.batch.settings.n_intervals, self.n_steps
            raise ValueError(f"there is no step {step}: since start() {taken} have been taken, the first is 0")
        index, offset = divmod(interval, _INTERVALS_PER_CHECKPOINT)
        if self._replayed[0] != index:
            blocks, replayed = self._checkpoints[index].copy(), []
            first = index * _INTERVALS_PER_CHECKPOINT
            for actions in self._actions[first : first + _INTERVALS_PER_CHECKPOINT]:
                replayed.append(blocks.copy())
                self._again(blocks, actions)
            self._replayed = index, replayed
        return self._replayed[1][offset]

    @undivided
    def _again(self, blocks: Floats, actions: Floats) -> None:
        sim = self.batch.simulator
        bound = bind(blocks, sim.scratches, sim.plant.network, sim.data, self.batch.task_data, self._scratch_outputs)
        sim.threads.run(lambda first, last, worker: step_blocks(bound, actions, first, last, worker, False))

    def _rows(self, rows: Whole, blocks: Floats | None = None) -> Floats:
        """Return rows of every environment (num_envs, …), in blocks like those of the simulator; None for these."""
        return rows_of_envs(self.batch.simulator.blocks if blocks is None else blocks, rows, self.batch.num_envs)

    def outputs(self) -> Floats:
        """Return the outputs at the end of the latest step (num_envs, n_outputs), in the order of `output_names`."""
        self.require_started()
        return self._rows(self._output_rows)

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
            carried: derivatives with respect to what the step left behind (num_envs, n_carried): those that the pull
                through the following step has returned, zeros for the last.
            terms: with respect to the terms of the step's cost (num_envs, n_terms).
            observations: with respect to the observations after the step (num_envs, n_observation); None for zeros.
            outputs: with respect to the outputs after the step (num_envs, n_outputs); None for zeros.

        Raises:
            ValueError: the step does not exist, or derivatives have another shape.
        """
        batch, n = self.batch, self.batch.settings.n_intervals
        bars, all_rows = np.zeros_like(self.before(step)), np.arange(self.n_carried)
        put_rows(bars, all_rows, _shaped("carried", carried, (batch.num_envs, self.n_carried)))
        terms = _shaped("terms", terms, (batch.num_envs, self._term_rows.size))
        shown = _shaped("outputs", outputs, (batch.num_envs, self._output_rows.size))
        seen = _shaped("observations", observations, (batch.num_envs, batch.n_observation))
        sums: list[Floats] = []
        for interval in range(n * (step + 1) - 1, n * step - 1, -1):
            bars, running, added = self._pull_interval(interval, bars, terms, seen, shown)
            sums = [total + now for total, now in zip(sums, added, strict=True)] if sums else added
            # An episode that ends within the step leaves and shows what it did in its last interval.
            seen, shown = (np.where(running, 0.0, array) for array in (seen, shown))
        return Pulled(np.where(running, self._rows(all_rows, bars), 0.0), *sums)

    def _pull_interval(
        self, interval: int, after: Floats, terms: Floats, seen: Floats, shown: Floats
    ) -> tuple[Floats, npt.NDArray[np.bool_], list[Floats]]:
        """Go back through an interval of a step.

        Returns:
            cotangents before it, in blocks like those after it; those of environments that had ended are unchanged;
            which environments ran in it (num_envs, 1); and what it adds to cotangents of actions, laws and parameters.
        """
        batch, blocks = self.batch, self._before(interval).copy()
        in_blocks = blocks[:, batch.simulator.layout.env("active"), np.newaxis] > 0.5
        running = in_blocks.reshape(-1, 1)[: batch.num_envs]
        in_force, bars = self._moved.in_force(blocks, batch.num_envs), np.where(in_blocks, after, 0.0)
        for values, rows in ((terms, self._term_rows), (shown, self._output_rows)):
            # Some rows are carried and shown too.
            put_rows(bars, rows, self._rows(rows, bars) + values * running)
        actions, constants = self._pull_blocks(interval, blocks, bars, seen * running)
        parameters = self._moved.pull(bars, constants, in_force)
        law = self._rows(self._law_rows, bars)
        # The law's own are what each step adds, and are not carried.
        bars[:, self._law_rows.ravel()] = 0.0
        # Of an environment that had ended nothing depends on anything, whatever its numbers.
        added = [np.where(running.reshape(-1, *(1,) * (a.ndim - 1)), a, 0.0) for a in (actions, law, parameters)]
        return np.where(in_blocks, bars, after), running, added

    def _pull_blocks(self, interval: int, blocks: Floats, blocks_bars: Floats, seen: Floats) -> tuple[Floats, Floats]:
        """Go back through an interval in all blocks; return cotangents of the actions and of the constants.

        `blocks_bars` and `seen` are those of the blocks and the observations.
        """
        simulator, network = self.batch.simulator, self._plant.network
        actions = np.zeros((self.batch.num_envs, self.batch.n_action))
        n_constants = network.code.constants.size if self.parameters else 0
        constants = np.zeros((len(blocks), n_constants, simulator.width))
        bars, data, task = Bars(blocks_bars, seen, actions, constants), simulator.data, self.batch.task_data
        taken = self._actions[interval]
        simulator.threads.run(
            lambda first, last, worker: pull(
                blocks, bars, first, last, network, data, task, taken, (self._rules, self._work(worker))
            )
        )
        return actions, constants

    def _work(self, worker: int) -> Work:
        if worker not in self._works:
            simulator = self.batch.simulator
            self._works[worker] = work_of(self._rules, simulator.layout, self._plant.network, simulator.width)
        return self._works[worker]

    def play(self, scenarios: Sequence[Scenario], actions: Floats) -> Played:
        """Start episodes and step them with given actions (n_steps, num_envs, n_action)."""
        self.start(scenarios)
        terms, outputs = [], []
        for action in actions:
            terms.append(self.step(action)[1])
            outputs.append(self.outputs())
        return Played(np.array(terms), np.array(outputs))

    def back(self, terms: Floats | None = None, outputs: Floats | None = None) -> tuple[Floats, Floats, Floats]:
        """Go back through all steps.

        Args:
            terms: derivatives of what is differentiated with respect to the terms of each step's cost (n_terms) or
                (n_steps, num_envs, n_terms); None for zeros.
            outputs: with respect to those at each step's end (n_steps, num_envs, n_outputs); None for zeros. Those
                after the end of an episode are ignored.

        Returns:
            those with respect to actions, laws and parameters, as :class:`Gradient` has them.
        """
        num_envs, n_steps = self.batch.num_envs, self.n_steps
        self.require_started()
        shape = (n_steps, num_envs, len(COST_TERMS))
        seeds = np.broadcast_to(_shaped("terms", terms, shape, shape[2:]), shape)
        shown = _shaped("outputs", outputs, (n_steps, num_envs, len(self.output_names)))
        actions, law = np.empty((n_steps, num_envs, self.batch.n_action)), np.zeros((num_envs, *self._law_rows.shape))
        parameters, carried = np.zeros((num_envs, len(self.parameters))), np.zeros((num_envs, self.n_carried))
        for step in range(n_steps - 1, -1, -1):
            pulled = self.pull(step, carried, seeds[step], outputs=shown[step])
            carried, actions[step], of_law, of_parameters = pulled
            law += of_law
            parameters += of_parameters
        return actions, law, parameters

    def gradient(
        self, scenarios: Sequence[Scenario], actions: Floats, weights: Mapping[str, float] | None = None
    ) -> Gradient:
        """Play episodes with given actions and return their costs and the gradients of these.

        Args:
            scenarios: one per environment.
            actions: of as many steps as are to count (n_steps, num_envs, n_action).
            weights: of the terms of the cost by name, those left out count nothing; None for the cost itself.

        Raises:
            ValueError: a term is unknown, a weight not finite, or there are no actions.
        """
        weight = term_weights(weights)
        actions = np.asarray(actions, dtype=np.float64)
        if actions.ndim != 3 or not actions.size:
            raise ValueError(f"actions must have the shape (n_steps, num_envs, n_action), got {actions.shape}")
        terms = self.play(scenarios, actions).terms.sum(axis=0)
        return Gradient(terms, *self.back(weight))
