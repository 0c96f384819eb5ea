"""Where every number of a simulation lies.

A block holds what `width` environments keep, as rows (n_rows, width), with a column per environment. The rows of a unit
are neighbours, and so are the units of a kind, kind after kind. Values that last for one control step only have such
rows in a scratch, which a thread shares between its blocks.
"""

import itertools
from collections import namedtuple
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from wtg_gym.physics.machine_models import HYDRO
from wtg_gym.physics.machine_unit import MACHINES
from wtg_gym.physics.network import Pattern
from wtg_gym.physics.units import ENV, UNITS
from wtg_gym.physics.wtg_unit import EXTENSIONS, GROUPS
from wtg_gym.ranges import did_you_mean, require_known
from wtg_gym.systems.compiled import allocating
from wtg_gym.systems.programs import Code, Complex
from wtg_gym.systems.systems import Kind, count, is_record, short_names, structured

Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Key = TypeVar("Key")


def offsets_of(kind: Kind, *, scratch: bool = False) -> Any:
    """Return at which of a unit's rows each part begins, as a NamedTuple of whole numbers with the parts' names.

    `scratch` asks for those in scratch.
    """
    parts = kind.scratch if scratch else kind.rows
    return namedtuple(f"{kind.name.title().replace(' ', '')}Rows", parts)(**_offsets(parts))


def _offsets(parts: Mapping[str, Any]) -> dict[str, int]:
    return _stacked({part: count(record) for part, record in parts.items()})[0]


def _stacked(sizes: Mapping[Key, int]) -> tuple[dict[Key, int], int]:
    """Return where each of some things begins that lie one behind the other, and where the last ends."""
    edges = [0, *itertools.accumulate(sizes.values())]
    return dict(zip(sizes, edges, strict=False)), edges[-1]


def n_rows_of(parts: Mapping[str, Any]) -> int:
    """Return how many rows parts take."""
    return sum(count(record) for record in parts.values())


def names_of(kind: Kind) -> list[str]:
    """Return the short name of each of a unit's rows."""
    names = (short_names(record) if is_record(record) else (part,) for part, record in kind.rows.items())
    return [*itertools.chain(*names)]


def place_of(kind: Kind, name: str) -> int:
    """Return which of a unit's rows has a number of a short name; a KeyError if none has, a ValueError if several."""
    names = names_of(kind)
    if name not in names:
        raise KeyError(f"{name!r} is no number of {kind.name}{did_you_mean(name, names)}")
    if names.count(name) > 1:
        raise ValueError(f"{names.count(name)} numbers of {kind.name} have the name {name!r}")
    return names.index(name)


class Span(NamedTuple):
    """Where the units of a kind lie in a block or in scratch."""

    first: int = 0  # row of the first unit
    n_units: int = 0
    n_rows: int = 0  # of each


@allocating
def units_of(rows: Floats, span: Span) -> Floats:
    """Return a view of each unit's rows (n_units, n_rows, width) in a block or a scratch (n, width)."""
    end = span.first + span.n_units * span.n_rows
    return rows[span.first : end].reshape(span.n_units, span.n_rows, rows.shape[1])


class Layout:
    """Rows of a block and of scratch, by kind of unit and by name.

    A ValueError says that a kind sees nothing by that label.

    Args:
        n_units: how many units of each kind there are, in the order of their rows.
        links: index of the unit that each unit of a kind sees, (n_units,), by kind and label; where it is left out, the
            environment, or the unit with the same number.
    """

    def __init__(self, n_units: Mapping[Kind, int], links: Mapping[tuple[Kind, str], Whole]) -> None:
        for kind, label in links:
            require_known(f"labels of what {kind.name} see", [label], kind.sees)
        self.counts, self._links = dict(n_units), dict(links)
        self.first, self.n_rows = _stacked({kind: n * n_rows_of(kind.rows) for kind, n in n_units.items()})
        sizes = {kind: n * n_rows_of(kind.scratch) for kind, n in n_units.items()}
        self.first_scratch, self.n_scratch = _stacked(sizes)
        #: Number of synchronous machines, WTG groups, units of the network, and extended WTG groups.
        self.n_sync, self.n_wtg, self.n_unit, self.n_extended = map(self.n_units, (MACHINES, GROUPS, UNITS, EXTENSIONS))
        self._cached_rows: dict[tuple[str, str], Whole] = {}
        #: Rows of the state vector, kind after kind, unit after unit; and of its time derivatives, in scratch.
        self.state_rows, self.rate_rows = self._states(""), self._states("_rates")

    def n_units(self, kind: Kind) -> int:
        """Return how many units of a kind there are."""
        return self.counts.get(kind, 0)

    def span(self, kind: Kind, *, scratch: bool = False) -> Span:
        """Return where the units of a kind lie in the block, or in scratch."""
        parts, first = (kind.scratch, self.first_scratch) if scratch else (kind.rows, self.first)
        return Span(first.get(kind, 0), self.n_units(kind), n_rows_of(parts))

    def first_rows(self, kind: Kind, part: str) -> Whole:
        """Return the first row of a part of each unit, (n_units,), in the block or in scratch."""
        if (kind.name, part) not in self._cached_rows:
            parts = kind.rows if part in kind.rows else kind.scratch
            span = self.span(kind, scratch=parts is kind.scratch)
            self._cached_rows[kind.name, part] = _every(span, _offsets(parts)[part])
        return self._cached_rows[kind.name, part]

    def number_rows(self, kind: Kind, part: str) -> Whole:
        """Return the rows of all numbers of a part, unit after unit, in the block or in scratch."""
        n = count(kind.rows[part] if part in kind.rows else kind.scratch[part])
        return (self.first_rows(kind, part)[:, np.newaxis] + np.arange(n)).ravel()

    def seen(self, kind: Kind, label: str) -> Whole:
        """Return the index of the unit that each unit of a kind sees by a label, (n_units,)."""
        n = self.n_units(kind)
        usual = np.zeros(n, dtype=np.int64) if self.n_units(kind.sees[label]) == 1 else np.arange(n)
        return self._links.get((kind, label), usual)

    def machine(self, name: str) -> Whole:
        """Return the row of each machine's number of this name (n_sync,), or of each hydro governor's (n_hydro,)."""
        return self._named(name, "synchronous machine", (MACHINES, HYDRO))

    def wtg(self, name: str) -> Whole:
        """Return the row of each WTG group's number of this name (n_wtg,)."""
        return self._named(name, "WTG group", (GROUPS, EXTENSIONS))

    def rows_of(self, kind: Kind, name: str) -> Whole:
        """Return the row of a number of each unit of a kind (n_units,)."""
        return _every(self.span(kind), place_of(kind, name))

    def env(self, name: str) -> int:
        """Return the row of an environment's number of this name."""
        return int(self._named(name, "run", (ENV,))[0])

    def _named(self, name: str, what: str, kinds: Sequence[Kind]) -> Whole:
        if (name, what) not in self._cached_rows:
            has = [kind for kind in kinds if name in names_of(kind) and (self.counts[kind] or kind is kinds[0])]
            if not has:
                known = itertools.chain(*(names_of(kind) for kind in kinds if self.counts[kind]))
                raise KeyError(f"{name!r} is no number of a {what} of this plant{did_you_mean(name, known)}")
            self._cached_rows[name, what] = self.rows_of(has[0], name)
        return self._cached_rows[name, what]

    def _states(self, ending: str) -> Whole:
        parts = [(kind, state) for kind in self.counts for state in kind.states]
        rows = [self.number_rows(kind, state + ending) for kind, state in parts]
        return np.concatenate(rows) if rows else np.zeros(0, dtype=np.int64)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state vector's entries."""
        names: list[str] = []
        short = {MACHINES: "sync", GROUPS: "wtg", EXTENSIONS: "wtg", HYDRO: "hydro", ENV: "env"}
        for kind, n in self.counts.items():
            for state in kind.states:
                record = kind.rows[state]
                entries = short_names(record) if is_record(record) else (state,)
                names += [f"{short.get(kind, kind.name)}{j}.{name}" for j in range(n) for name in entries]
        return tuple(names)


def rows_of_envs(blocks: Floats, rows: Whole, num_envs: int) -> Floats:
    """Return rows of every environment (num_envs, …) of blocks (n_blocks, n_rows, width)."""
    selected = blocks[:, rows.ravel(), :].transpose(0, 2, 1)
    return selected.reshape(len(blocks) * blocks.shape[2], *rows.shape)[:num_envs]


def put_rows(blocks: Floats, rows: Whole, values: Floats) -> None:
    """Write rows of every environment, as :func:`rows_of_envs` returns them."""
    block, column = np.divmod(np.arange(len(values))[:, np.newaxis], blocks.shape[2])
    blocks[block, rows.ravel(), column] = values.reshape(len(values), -1)


def _every(span: Span, offset: int) -> Whole:
    rows: Whole = span.first + offset + np.arange(span.n_units, dtype=np.int64) * span.n_rows
    # Everybody who asks gets the same array.
    rows.setflags(write=False)
    return rows


OF_ENV = offsets_of(ENV)


class Facts(NamedTuple):
    """Numbers of a plant, and where its kinds of unit lie."""

    slack: int  # bus index
    base_mva: float
    simulation_dt: float  # [s]
    n_substeps: int  # simulation steps per control interval
    n_balances: int  # power flows after which machines share what the slack bus lacks
    is_large: bool  # whether the power flow is solved by sparse elimination
    curtails: bool  # whether WTG groups alone balance the power
    shifts_phases: bool  # whether a branch does, so that the admittance matrix is not symmetric
    load_frequency_dependence: float  # change of a load's conductance with the frequency [p.u./p.u.]
    # In a block:
    env: Span = Span()
    machines: Span = Span()
    groups: Span = Span()
    units: Span = Span()
    pairs: Span = Span()
    stages: Span = Span()  # of shedding; those of an island are its rows
    buses: Span = Span()
    islands: Span = Span()
    transfers: Span = Span()
    sources: Span = Span()
    # In scratch:
    starting: Span = Span()  # of the environment
    planning: Span = Span()  # of the buses


class Network(NamedTuple):
    """A plant as compiled functions read it; the types are the same for every plant.

    Programs are called with `code`: see :mod:`wtg_gym.systems`.
    """

    facts: Facts
    branch_ends: Whole  # bus indices of each branch (n_branch, 2)
    branch_y: Complex  # its admittances ff, ft, tf, tt (n_branch, 4) [p.u.]
    branch_series: Complex  # the part of its series impedance in them (n_branch, 4) [p.u.]
    shunts: Complex  # admittance at each bus (n_bus,) [p.u.]
    unit_bus: Whole  # bus index of each unit, machines first (n_unit,)
    unit_y: Complex  # internal admittance of each unit (n_unit,) [p.u.]
    connected: Whole  # the row that says whether each unit is connected (n_unit,)
    angles: Whole  # the row of each unit's angle, -1 for none (n_unit,)
    shed_shares: Floats  # of the load, by each stage of shedding (n_stages,)
    pattern: Pattern  # of the power flow of a large network
    code: Code


class NetworkEvent(NamedTuple):
    """A change of the network; times in simulation steps, indices -1 for none."""

    start: float
    end: float  # later than start for a ramp, a fault, and a line that closes again
    bus: int = -1  # of a load
    active: float = 0.0  # the load's P and Q until the run's start, then its admittance; a fault's admittance [p.u.]
    reactive: float = 0.0
    branch: int = -1  # that opens, or whose impedance changes
    unit: int = -1  # that is disconnected; machines first
    governor: int = -1  # that stops acting: its machine
    fault: int = -1  # bus of a fault
    factor: float = 0.0  # on the branch's series impedance; 0: it opens
    source: int = -1  # that an event moves
    jump: float = 0.0  # of its angle [rad]
    ramp: float = 0.0  # of its frequency [p.u./s]


NO_EVENT = structured(NetworkEvent, [NetworkEvent(np.inf, np.inf)])


class BatchData(NamedTuple):
    """Series and events of each environment, constant while it runs."""

    wind: Floats  # at the ends of control intervals (num_envs, n_wtg, n_intervals + 1) [m/s]
    noise: Floats  # load noise per control interval (num_envs, n_intervals) [MW]
    events: npt.NDArray[Any]  # (num_envs, n_events), of NetworkEvent
