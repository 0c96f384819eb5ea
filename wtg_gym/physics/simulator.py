"""Many runs of one plant side by side: start, advance, read, copy."""

import dataclasses
import functools
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, NamedTuple

import numpy as np

from wtg_gym.physics import equilibrium, integration, linearisation, network_events
from wtg_gym.physics.layout import NO_EVENT, BatchData, Floats, rows_of_envs
from wtg_gym.physics.plant import NO_TASK, Plant, TaskUnits, placed, programs_of
from wtg_gym.physics.scenario import LONGEST_RUN_S, SERIES_DT, Scenario
from wtg_gym.physics.tracking_law import REFERENCE_LAW, TrackingLaw, group_laws
from wtg_gym.physics.units import UNITS, StartFailure
from wtg_gym.ranges import require_memory, require_range, require_whole, whole_steps
from wtg_gym.signals import undivided
from wtg_gym.systems.programs import Complex, Whole
from wtg_gym.systems.routines import WIDE, Function, Routine, addresses_of

#: A thread is worth its start only for this many blocks that advance by one control interval.
_BLOCKS_PER_THREAD = 4


class BlockThreads:
    """Threads that work on blocks, some control intervals at a time.

    There are at most `n_threads`, None for one per processor.
    """

    def __init__(self, n_blocks: int, n_threads: int | None = None, n_intervals: int = 1) -> None:
        self.n_blocks, self.n_threads, self._n_intervals = n_blocks, n_threads, n_intervals
        self._pool: ThreadPoolExecutor | None = None
        self._pool_process = 0
        self._count_workers()

    def _count_workers(self) -> None:
        #: Threads that work on blocks at once; each has memory of its own.
        most = min(self.n_blocks, self.n_blocks * self._n_intervals // _BLOCKS_PER_THREAD)
        self.n_workers = max(1, min(most, self.n_threads or os.cpu_count() or 1))

    @undivided
    def run(
        self,
        work: Callable[[int, int, int], Any],
        meanwhile: Callable[[], Any] | None = None,
        meanwhile_blocks: int = 0,
    ) -> None:
        """Call `work(first, last, worker)` for ranges that cover all blocks, each with a worker's number of its own.

        It is compiled with nogil, so that it releases the interpreter's lock. `meanwhile`, which takes as long as so
        many blocks, is called once, by this thread, while others work.
        """
        n_blocks, n_threads = self.n_blocks, self.n_workers
        futures, main_end = [], n_blocks
        if n_threads > 1:
            main_end = max(0, (n_blocks + meanwhile_blocks) // n_threads - meanwhile_blocks)
            edges = [main_end + (n_blocks - main_end) * i // (n_threads - 1) for i in range(n_threads)]
            # A forked process inherits the pool, but not its threads.
            if self._pool is None or self._pool_process != os.getpid():
                self._pool = ThreadPoolExecutor(n_threads, thread_name_prefix="wtg_gym")
                self._pool_process = os.getpid()
            futures = [self._pool.submit(work, edges[i], edges[i + 1], i + 1) for i in range(n_threads - 1)]
        # Whatever happens meanwhile, no block may be left a step behind the others.
        try:
            if meanwhile is not None:
                meanwhile()
        finally:
            try:
                work(0, main_end, 0)
            finally:
                wait(futures)
        for done in futures:
            done.result()

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        # A thread pool cannot be copied.
        return {**self.__dict__, "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        # It may be on another machine.
        self.__dict__.update(state)
        self._count_workers()


#: Winds at which the integration step is checked when a simulator is built: blades at rest, and turned by the pitch
#: protection [m/s].
_CHECKED_WINDS = (8.0, 16.0)


@functools.lru_cache(maxsize=64)
def _checked_inertias(settings: Plant) -> dict[tuple[TrackingLaw, ...], float]:
    """Return, for the laws of a plant, the smallest inertia scale at which its integration step was checked."""
    return {}


@functools.lru_cache(maxsize=16)
def _code(*dependencies: Any) -> list[Whole]:
    """Return the list that keeps the addresses of machine code; the code outlives it, and simulators keep addresses."""
    return []


#: Numbers of a group that are those of its law.
_OF_LAW = {name: name for name in ("k_min", "k_nominal", "k_max", "droop_cancelled")}
_OF_LAW["inv_tau"] = "inverse_time_constant"


@functools.lru_cache(maxsize=64)
def _law_numbers(laws: tuple[TrackingLaw, ...]) -> Floats:
    """Return the numbers of laws, (n_numbers, n_wtg) in the order of :data:`_OF_LAW`."""
    return np.array([[getattr(law, name) for law in laws] for name in _OF_LAW.values()], dtype=np.float64)


class PreparedBatch(NamedTuple):
    """Runs that are ready to start: the rows of each, (n, n_rows), and the data they read."""

    rows: Floats
    data: BatchData


def _aligned_zeros(*shape: int) -> Floats:
    """Return zeros that start at a cache line: a vector that straddles two of them costs two accesses."""
    line, size = 64 // 8, math.prod(shape)
    buffer = np.zeros(size + line)
    start = -(buffer.ctypes.data // 8) % line
    return buffer[start : start + size].reshape(shape)


class Simulator:
    """Runs of one plant, side by side.

    The integration step must suit the plant's fastest mode (:func:`~wtg_gym.physics.linearisation.check_step`). The
    constructor checks it with nominal load and inertia under the reference law, at 8 and 16 m/s. :meth:`prepare` checks
    every new law, and every inertia below those checked before: a lighter machine swings faster. Load level, line trips
    and governor droop hardly matter, and with fewer units the modes are slower. A ValueError says that a setting is
    outside its range, or the step too long for the plant.

    It holds runs of `duration_s` [s] at most. `task` has kinds of unit and programs of a task. Blocks are advanced by
    `n_threads`, None for one per processor, by `intervals_at_once`; results depend on neither.
    """

    def __init__(
        self,
        settings: Plant,
        *,
        num_envs: int = 1,
        duration_s: float = 60.0,
        task: TaskUnits = NO_TASK,
        n_threads: int | None = None,
        intervals_at_once: int = 1,
    ) -> None:
        self.num_envs = require_whole("num_envs", num_envs, 1, 1_000_000)
        if n_threads is not None:
            n_threads = require_whole("the number of threads", n_threads, 1)
        self.settings = settings
        self.plant, self.layout = placed(settings, task)
        duration_s = require_range("duration_s", duration_s, 0.0, LONGEST_RUN_S, "s")
        self.n_intervals = whole_steps("duration_s", duration_s, settings.interval_s, "control interval")
        samples = np.arange(self.n_intervals) * settings.interval_s / SERIES_DT + 1e-9
        self._noise_samples = samples.astype(np.int64)
        self._law_rows = np.stack([self.layout.wtg(name) for name in _OF_LAW])
        self._committed_rows = np.stack([self.layout.rows_of(UNITS, name) for name in ("committed", "inv_committed")])
        self._wind_rows = np.stack([self.layout.wtg(name) for name in ("wind_start", "wind_end")])
        self.width = 1 if num_envs == 1 else WIDE
        self.link(task)
        n_blocks = -(-self.num_envs // self.width)
        of_env = self.layout.n_rows + (self.layout.n_wtg + 1) * self.n_intervals
        require_memory(f"{self.num_envs} environments of {duration_s:g} s", 8 * n_blocks * self.width * of_env)
        #: Rows of all environments (n_blocks, n_rows, width).
        self.blocks = _aligned_zeros(n_blocks, self.layout.n_rows, self.width)
        # A padded or not yet started environment must hold finite values: it is computed along with its neighbours.
        self.data = self._allocate_data(n_blocks * self.width, 4)
        self.threads = BlockThreads(n_blocks, n_threads, intervals_at_once)
        #: Scratch of each worker (n_workers, n_scratch, width).
        self.scratches = self.new_scratches(self.threads.n_workers, self.width)
        self._rates = np.zeros((0, 0, 0))
        for env in range(self.num_envs, n_blocks * self.width):
            rows = self._env_view(env)
            padding = Scenario(name="padding", wind_speed=np.full((self.layout.n_wtg, 1), 8.0))
            self._write_machine_inputs(rows[None, :], [padding])
            for name in ("wind", "wind_start"):
                rows[self.layout.wtg(name)] = 8.0
            rows[self.layout.env("next_change")] = math.inf
        self._checked = _checked_inertias(settings)
        reference = group_laws(REFERENCE_LAW, settings.turbines, settings.control)
        if reference not in self._checked and self._check_nominal(reference):
            self._checked[reference] = 1.0

    def functions(self) -> dict[Function, tuple[Any, ...]]:
        """Return the functions that are called at an address, with arguments like those they are given."""
        network, some = self.plant.network, np.zeros((1, 1))
        of_env = (some, 0, 0, network, self._allocate_data(1, 1))
        arguments: dict[Function, tuple[Any, ...]] = {
            integration.REFRESH: of_env,
            equilibrium.POWER_FLOW: (self.plant.bus_y, 0, some, equilibrium.FLOW_COLUMNS),
        }
        if network.facts.islands.n_units > 1:
            arguments[network_events.FIND_ISLANDS] = of_env
        if network.facts.is_large:
            arguments[equilibrium.SPARSE_FLOW] = (self.plant.bus_y, 0, some, equilibrium.FLOW_COLUMNS, network.pattern)
        return arguments

    def link(self, task: TaskUnits) -> None:
        """Let the plant know where the machine code is in this process; a copy in another one needs it.

        `task` is what the simulator was made with.
        """
        programs = programs_of(self.plant, *integration.PROGRAMS, *task.programs)
        functions = self.functions()
        code = _code(programs, task.stepping, task.starting, self.width, tuple(functions))
        if not code:
            routines: dict[int, tuple[Routine, ...]] = {1: (*integration.STARTING, *task.starting)}
            routines[self.width] = (*integration.STEPPING, *task.stepping, *routines.get(self.width, ()))
            code.append(addresses_of(programs, routines, functions))
        self.plant = self.plant.with_addresses(code[0])

    def _check_nominal(self, laws: tuple[TrackingLaw, ...], inertia_scale: float = 1.0, committed: float = 1.0) -> bool:
        """Check laws at nominal operating points; return whether the plant has an equilibrium at any of them."""
        has_equilibrium = False
        for wind in _CHECKED_WINDS:
            nominal = Scenario(
                name=f"{equilibrium.NOMINAL}{wind:g} m/s and nominal load",
                wind_speed=np.full((self.layout.n_wtg, 1), wind),
                duration_s=self.n_intervals * self.settings.interval_s,
                load_noise_bus=self.settings.case.slack_bus,
                inertia_scale=inertia_scale,
                committed=committed,
            )
            try:
                rows = self._equilibria([nominal], laws).rows
            except ValueError:
                continue
            equilibrium.check_internal_voltages(rows, [nominal], self.settings, self.layout)
            self._check_step(rows[0], nominal)
            has_equilibrium = True
        return has_equilibrium

    def _check_step(self, rows: Floats, scenario: Scenario) -> None:
        try:
            linearisation.check_step(rows, self.plant, self.layout)
        except ValueError as error:
            name = equilibrium.scenario_name(scenario)
            raise ValueError(f"{name}, inertia_scale = {scenario.inertia_scale:g}: {error}") from None

    def _allocate_data(self, n: int, n_events: int) -> BatchData:
        return BatchData(
            wind=np.full((n, self.layout.n_wtg, self.n_intervals + 1), 8.0),
            noise=np.zeros((n, self.n_intervals)),
            events=np.full((n, n_events), NO_EVENT),
        )

    def new_scratches(self, n: int, width: int) -> Floats:
        """Return scratches for blocks of a width (n, n_scratch, width)."""
        return _aligned_zeros(n, self.layout.n_scratch, width)

    def _env_view(self, env: int) -> Floats:
        view: Floats = self.blocks[env // self.width, :, env % self.width]
        return view

    def values(self, row: int | np.int64) -> Floats:
        """Return one row for every environment, shape (num_envs,): a copy."""
        return self.blocks[:, row, :].ravel()[: self.num_envs].copy()

    def machine_values(self, name: str) -> Floats:
        """Return a number of every environment and synchronous machine by its name, shape (num_envs, n_sync)."""
        return self._of_units(self.layout.machine(name))

    def wtg_values(self, name: str) -> Floats:
        """Return a number of every environment and WTG group by its name, shape (num_envs, n_wtg)."""
        return self._of_units(self.layout.wtg(name))

    def _of_units(self, rows: Whole) -> Floats:
        return np.ascontiguousarray(rows_of_envs(self.blocks, rows, self.num_envs))

    def env_values(self, name: str) -> Floats:
        """Return a number of every environment by its name, shape (num_envs,)."""
        return self.values(self.layout.env(name))

    def prepare(
        self, scenarios: Sequence[Scenario], laws: Sequence[TrackingLaw], *, turning: bool = False
    ) -> PreparedBatch:
        """Find the exact equilibria that scenarios start from, with one law per WTG group; no running one is touched.

        `turning` refuses a rotor that would start below the under-speed trip: its run would end at once. A ValueError
        says that a scenario does not fit the plant or has no equilibrium, that the integration step is too long there,
        that a unit would need a larger internal voltage than allowed, or that a rotor would not turn.
        """
        prepared = self._equilibria(scenarios, laws)
        equilibrium.check_internal_voltages(prepared.rows, scenarios, self.settings, self.layout)
        scales = ((scenario.inertia_scale * scenario.committed, env) for env, scenario in enumerate(scenarios))
        (scale, lightest), of_laws = min(scales, default=(math.inf, 0)), tuple(laws)
        if scale < self._checked.get(of_laws, math.inf):
            self._check_step(prepared.rows[lightest], scenarios[lightest])
            # The wind may rise: under a steep law the step suits a slow rotor and not a fast one.
            self._check_nominal(of_laws, scenarios[lightest].inertia_scale, scenarios[lightest].committed)
            self._checked[of_laws] = scale
        if turning:
            equilibrium.check_rotor_speeds(prepared.rows, scenarios, self.settings, self.layout)
        return prepared

    def _equilibria(self, scenarios: Sequence[Scenario], laws: Sequence[TrackingLaw]) -> PreparedBatch:
        counts = [(f"scenario {scenario.name!r} has wind for", scenario.n_wtg) for scenario in scenarios]
        for what, count in (*counts, ("there are laws for", len(laws))):
            if count != self.layout.n_wtg:
                raise ValueError(f"{what} {count} WTG groups, the plant has {self.layout.n_wtg} groups")
        n = len(scenarios)
        events = [equilibrium.network_events(scenario, self.settings, self.plant) for scenario in scenarios]
        data = self._allocate_data(n, max([1, *map(len, events)]))
        for env, scenario in enumerate(scenarios):
            self._write_series(data, env, scenario)
        for env, changes in enumerate(events):
            data.events[env, : len(changes)] = np.array(changes, dtype=NO_EVENT.dtype)
        rows = np.zeros((n, self.layout.n_rows))
        self._write_machine_inputs(rows, scenarios)
        rows[:, self._law_rows] = _law_numbers(tuple(laws))
        rows[:, self._wind_rows] = data.wind[:, np.newaxis, :, 0]
        rows[:, self.layout.env("noise_bus")] = [self.settings.case.bus_index(s.load_noise_bus) for s in scenarios]
        failures = np.zeros((n, 2), dtype=np.int64)
        levels = np.array([scenario.load_level for scenario in scenarios])
        plant, blocks, scratch = self.plant, rows[:, :, np.newaxis], self.new_scratches(1, 1)[0]
        equilibrium.prepare_envs(blocks, scratch, plant.bus_y, plant.network, data, levels, failures)
        for scenario, (failure, unit), row in zip(scenarios, failures.tolist(), rows, strict=True):
            if failure:
                reason = equilibrium.start_failure(
                    StartFailure(failure), unit, row, scenario, self.settings, self.layout
                )
                raise equilibrium.StartError(f"scenario {scenario.name!r} cannot start: {reason}")
        return PreparedBatch(rows, data)

    def start(
        self,
        envs: int | Sequence[int] | Whole,
        runs: Scenario | PreparedBatch,
        laws: Sequence[TrackingLaw] = (),
        places: Whole | None = None,
    ) -> None:
        """Start one run in each: those of some `places` that :meth:`prepare` returned, or one scenario."""
        prepared = runs if isinstance(runs, PreparedBatch) else self.prepare([runs], laws)
        n_events = prepared.data.events.shape[1]
        if n_events > self.data.events.shape[1]:
            more = self._allocate_data(self.data.wind.shape[0], 2 * n_events).events
            more[:, : self.data.events.shape[1]] = self.data.events
            self.data = self.data._replace(events=more)
        index = np.array(envs, dtype=np.int64).reshape(-1)
        if places is None:
            places = np.arange(len(prepared.rows))
        self.blocks[index // self.width, :, index % self.width] = prepared.rows[places]
        wind, noise, events = self.data
        wind[index], noise[index] = prepared.data.wind[places], prepared.data.noise[places]
        events[index] = NO_EVENT
        events[index, :n_events] = prepared.data.events[places]

    def _write_series(self, data: BatchData, env: int, scenario: Scenario) -> None:
        dt, n = self.settings.interval_s, self.n_intervals
        if scenario.duration_s > n * dt * (1.0 + 1e-9):
            raise ValueError(
                f"scenario {scenario.name!r} lasts {scenario.duration_s:g} s, longer than the {n * dt:g} s held here; "
                f"make it shorter, such as suite.scenario(seed, duration_s={n * dt:g})"
            )
        wind, target = scenario.wind_speed, data.wind[env]
        if abs(scenario.wind_dt_s - dt) < 1e-12:
            # The last sample holds.
            wind.take(np.arange(n + 1), axis=1, out=target, mode="clip")
        else:
            instants, times_s = np.arange(wind.shape[1]) * scenario.wind_dt_s, np.arange(n + 1) * dt
            for j in range(wind.shape[0]):
                target[j] = np.interp(times_s, instants, wind[j])
        noise = scenario.load_noise_mw
        if noise.size:
            samples = self._noise_samples
            if samples.size and samples[-1] >= noise.size:
                samples = samples[: np.searchsorted(samples, noise.size)]
            # Another mode than "raise" writes without a buffer.
            noise.take(samples, out=data.noise[env, : samples.size], mode="clip")

    def _write_machine_inputs(self, rows: Floats, scenarios: Sequence[Scenario]) -> None:
        machines = self.plant.machines
        scale = np.array([[scenario.inertia_scale] for scenario in scenarios])
        # Units of a machine that are not committed are not there; a condenser has no units to commit.
        committed = np.array([[scenario.committed] for scenario in scenarios])
        committed = np.where(machines["governor.inv_droop"] > 0.0, committed, 1.0)
        rows[:, self._committed_rows] = 1.0
        rows[:, self._committed_rows[0, : self.layout.n_sync]] = committed
        rows[:, self._committed_rows[1, : self.layout.n_sync]] = 1.0 / committed
        rows[:, self.layout.machine("connected")] = 1.0
        rows[:, self.layout.machine("inv_two_h")] = 1.0 / (machines["two_h"] * scale)
        inv_droop = np.array([[np.nan if s.governor_droop is None else 1.0 / s.governor_droop] for s in scenarios])
        nominal = machines["governor.inv_droop"]
        # A scenario's droop is that of the machines with a governor.
        rows[:, self.layout.machine("inv_droop")] = np.where(np.isnan(inv_droop) | (nominal <= 0.0), nominal, inv_droop)

    def stop(self, env: int) -> None:
        """Let an environment stand still from now on."""
        self._env_view(env)[self.layout.env("active")] = 0.0

    def advance(self) -> None:
        """Advance every running environment by one control interval."""
        self.threads.run(
            lambda first, last, worker: integration.advance_blocks(
                self.blocks, self.scratches[worker], first, last, self.plant.network, self.data
            )
        )

    def evaluate(self) -> None:
        """Evaluate rates, powers and coefficients of all environments at their present states, in place."""
        self._rates = self._evaluated(self.blocks)

    def _evaluated(self, blocks: Floats) -> Floats:
        scratches = self.new_scratches(blocks.shape[0], self.width)
        integration.evaluate_blocks(blocks, scratches, self.plant.network)
        return scratches

    def bus_voltages(self) -> Complex:
        """Return the bus voltages at the present state of the first environment, shape (n_bus,) [p.u.].

        Angles count from the rotor of the first machine, which goes on at its last speed after an outage.
        """
        scratch = self._evaluated(self.blocks[:1].copy())[0, :, 0]
        first = self.layout.first_rows(UNITS, "voltage")
        internal = scratch[first] + 1j * scratch[first + 1]
        network, noise_bus = self.plant.network, int(self.env_values("noise_bus")[0])
        y, unit_y = np.zeros((network.shunts.size,) * 2, dtype=np.complex128), np.zeros_like(network.unit_y)
        network_events.assemble(y, unit_y, self.blocks[0], network, self.data)
        y[noise_bus, noise_bus] += self.env_values("noise_y")[0]
        injected = np.zeros(len(y), dtype=np.complex128)
        np.add.at(injected, network.unit_bus, unit_y * internal)
        voltages: Complex = np.linalg.solve(y, injected).astype(np.complex128)
        return voltages

    def state(self, env: int = 0) -> Floats:
        """Return a copy of an environment's state vector; `layout.state_names` names its entries."""
        return self._env_view(env)[self.layout.state_rows]

    def rates(self, env: int = 0) -> Floats:
        """Return a copy of an environment's time derivatives, as last evaluated."""
        rates: Floats = self._rates[env // self.width, self.layout.rate_rows, env % self.width]
        return rates

    def snapshot(self) -> tuple[Floats, BatchData]:
        """Return a copy of everything that changes; :meth:`restore` goes back to it."""
        return self.blocks.copy(), BatchData(*map(np.copy, self.data))

    def restore(self, snapshot: tuple[Floats, BatchData]) -> None:
        """Go back to a :meth:`snapshot` of a simulator of the same size; it can be used again."""
        blocks, data = snapshot
        self.blocks[:] = blocks
        self.data = BatchData(*map(np.copy, data))

    def close(self) -> None:
        """Stop the worker threads."""
        self.threads.close()

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        # The copy is not aligned.
        self.blocks = _aligned_zeros(*state["blocks"].shape)
        self.blocks[:] = state["blocks"]
        self.scratches = self.new_scratches(self.threads.n_workers, self.width)
        # Addresses hold in one process only.
        self.link(NO_TASK)


#: Steps of the integration that are tried, the longest first [s].
STEPS_S = (0.025, 0.0125, 0.01, 0.005, 0.0025, 0.001)


def longest_step(plant: Plant) -> float:
    """Return the longest of :data:`STEPS_S` that suits a plant's fastest mode; a StepError where none does."""
    refusal: linearisation.StepError | None = None
    for step in STEPS_S:
        try:
            Simulator(dataclasses.replace(plant, simulation_dt=step)).close()
        except linearisation.StepError as error:
            refusal = error
            continue
        return step
    raise linearisation.StepError(f"no step of {STEPS_S[-1]:g} s or more suits this grid: {refusal}")
