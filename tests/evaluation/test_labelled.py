"""Facts about results as tables and runs as labelled arrays."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from wtg_gym import LoadStep, Scenario, simulate, to_xarray
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.evaluation import METRICS, Entry, Results, record
from wtg_gym.evaluation.episodes import COLUMNS

MINE = Scenario(
    name="mine", wind_speed=[[11.0], [9.0]], duration_s=2.0, events=(LoadStep(time_s=1.0, bus=3, power_mw=30.0),)
)


def test_table_of_pandas_has_every_episode_and_metric(results: Results) -> None:
    pytest.importorskip("pandas")
    table = results.to_pandas()
    assert tuple(table.columns) == (*COLUMNS, "pinned_cost") and len(table) == len(results.episodes)
    for row, episode in zip(table.itertuples(), results.episodes, strict=True):
        assert (row.entry, row.seed, row.failure) == (episode.entry, episode.seed, episode.failure)
        for name in METRICS:
            value, expected = getattr(row, name), episode.metrics[name]
            assert np.isnan(value) if expected is None else value == expected
    assert table["training_seed"].isna().all() and table["training_seed"].dtype == "Int64"
    means = table.groupby("entry")["cost"].mean()
    assert means["mppt"] == np.mean([episode.metrics["cost"] for episode in results.episodes_of("mppt")])


@pytest.mark.parametrize("package", ["pandas", "xarray"])
def test_error_without_the_package_names_the_extra(
    package: str, results: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"needs {package}; in a checkout: pip install '\.\[data\]'"):
        results.to_pandas() if package == "pandas" else to_xarray(simulate(MINE, "mppt"))


def test_run_as_a_dataset_has_time_groups_and_units() -> None:
    pytest.importorskip("xarray")
    run = simulate(MINE, "coordinated-piecewise")
    data = to_xarray(run)
    assert data.sizes == {"time": 21, "group": 2}
    assert data["rotor_speed_pu"].dims == ("time", "group") and data["frequency_hz"].dims == ("time",)
    assert np.array_equal(data["rotor_speed_pu"], run.rotor_speed_pu)
    units = {name: data[name].attrs.get("units") for name in data}
    assert units["wind_m_s"] == "m/s" and units["frequency_hz"] == "Hz" and units["tip_speed_ratio"] is None
    assert data.sel(time=1.5, method="nearest")["frequency_hz"] == run.frequency_hz[15]
    assert data.attrs == {"status": "RUNNING", "nominal_frequency_hz": 50.0}


def test_recorded_episodes_as_a_dataset_name_observations_and_cost_terms() -> None:
    pytest.importorskip("xarray")
    recording = record(Entry(name="law", strategy="mppt"), EnvSettings(duration_s=2.0, version="v0"), [MINE, MINE])
    data = to_xarray(recording)
    assert data.sizes == {"scenario": 2, "time": 21, "group": 2, "observation": 20, "cost_term": len(COST_TERMS)}
    assert np.array_equal(data["observations"].sel(observation="wtg1.rocof [Hz/s]"), recording.rocof_hz_s[:, :, 1])
    assert data["rocof_hz_s"].attrs == {"units": "Hz/s"}
    assert data["cost_terms"].sel(cost_term="frequency").shape == (2,)


def test_results_show_themselves_short_and_as_a_table(results: Results) -> None:
    assert repr(results).startswith("<Results of standard, test, 3 scenarios: coordinated-piecewise 100.0, ")
    assert results._repr_html_().count("<tr>") == 1 + len(results.summaries)
    worse = [e for e in results.episodes if e.entry == "coordinated-piecewise"]
    others = [e for e in results.episodes if e.entry == "deloaded-10"]
    without = replace(results, episodes=(*(replace(e, entry="mppt") for e in worse), *others, *worse))
    assert "without a score" in repr(without) and "as there is no score" in without._repr_html_()
