"""Results and runs as labelled data: tables of pandas, datasets of xarray; extra `data`."""

from __future__ import annotations

import dataclasses
import importlib
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.evaluation.episodes import COLUMNS, Episode
from wtg_gym.evaluation.metrics import METRICS
from wtg_gym.evaluation.recording import Recording
from wtg_gym.evaluation.score import pinned
from wtg_gym.extras import install_advice
from wtg_gym.physics.trajectory import Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

#: Units by the ends of names, the longest first.
_UNITS = {"_hz_s": "Hz/s", "_m_s": "m/s", "_hz": "Hz", "_pu": "p.u.", "_deg": "deg", "_s": "s"}
#: Axes of arrays by their number.
_AXES = {1: ("time",), 2: ("time", "group")}
#: Axes of a recording that are not (scenario, time, group).
_RECORDED_AXES = {
    "frequency_hz": ("scenario", "time"),
    "observations": ("scenario", "time", "observation"),
    "cost_terms": ("scenario", "cost_term"),
}


def _import(name: str, purpose: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f"{purpose} needs {name}; {install_advice('data')} ({error})") from error


def episodes_frame(episodes: Sequence[Episode], cap: float) -> DataFrame:
    """Return episodes with the largest cost rate `cap` [1/s] as a table, see :meth:`.Results.to_pandas`."""
    pandas = _import("pandas", "to_pandas()")
    table: dict[str, Any] = {
        column: [getattr(episode, column) for episode in episodes] for column in COLUMNS if column not in METRICS
    }
    # Most entries have no training seed.
    table["training_seed"] = pandas.array(table["training_seed"], dtype="Int64")
    for name in METRICS:
        values = (episode.metrics[name] for episode in episodes)
        table[name] = np.array([math.nan if value is None else value for value in values], dtype=np.float64)
    table["pinned_cost"] = [pinned(episode, cap) for episode in episodes]
    frame: DataFrame = pandas.DataFrame(table)
    return frame


def to_xarray(run: Trajectory | Recording) -> Dataset:
    """Return a run of `wtg_gym.simulate`, or recorded episodes, as a dataset of xarray.

    Variables have the names of the run's fields, and `units`. Axes are time [s] and group; recorded episodes have
    scenario before them, and observations their names.

    Args:
        run: a :class:`Trajectory` or a :class:`Recording`.

    Raises:
        ImportError: xarray is not installed.
        ValueError: it is neither.
    """
    if not isinstance(run, (Trajectory, Recording)):
        raise ValueError(f"to_xarray() takes a Trajectory or a Recording, got {type(run).__name__}")
    xarray = _import("xarray", "to_xarray()")
    arrays = {each.name: getattr(run, each.name) for each in dataclasses.fields(run)}
    coordinates: dict[str, Any] = {"time": ("time", arrays.pop("time_s"), {"units": "s"})}
    attributes: dict[str, Any] = {}
    if isinstance(run, Recording):
        axes = {name: _RECORDED_AXES.get(name, ("scenario", "time", "group")) for name in arrays}
        coordinates |= {"observation": list(arrays.pop("observation_names")), "cost_term": list(COST_TERMS)}
    else:
        axes = {name: _AXES[value.ndim] for name, value in arrays.items() if isinstance(value, np.ndarray)}
        attributes = {"status": arrays.pop("status").name, "nominal_frequency_hz": arrays.pop("nominal_frequency_hz")}
    variables = {name: (axes[name], value, _attributes(name)) for name, value in arrays.items()}
    dataset: Dataset = xarray.Dataset(variables, coordinates, attributes)
    return dataset


def _attributes(name: str) -> dict[str, str]:
    unit = next((unit for end, unit in _UNITS.items() if name.endswith(end)), None)
    return {} if unit is None else {"units": unit}
