"""Facts about what is measured in an episode."""

import gymnasium as gym
import numpy as np
import pytest

from wtg_gym import Plant, evaluate, get_law, get_suite, simulate
from wtg_gym.evaluation.metrics import quasi_steady_deviation

DT = 0.1


def test_metrics_agree_with_the_recorded_run():
    results = evaluate([], "paper", "test", duration_s=60.0)
    for episode in results.episodes_of("coordinated-piecewise"):
        scenario = get_suite("paper").scenario(episode.seed, duration_s=60.0)
        run = simulate(scenario, get_law("coordinated-piecewise"))
        m = episode.metrics
        assert m["nadir_hz"] == pytest.approx(run.frequency_hz.min(), abs=2e-3)
        assert m["zenith_hz"] == pytest.approx(run.frequency_hz.max(), abs=2e-3)
        assert m["largest_rocof_hz_s"] == pytest.approx(np.abs(run.rocof_hz_s()).max(), rel=1e-9)
        assert m["peak_power_pu"] == pytest.approx(run.power_pu.max(), rel=0.02)
        assert m["least_tip_speed_ratio"] == pytest.approx(run.tip_speed_ratio.min(), rel=1e-3)
        # Two groups of ten turbines of 5 MW each.
        energy = np.trapezoid(run.captured_power_pu, dx=DT, axis=0).sum() * 50.0 / 3600.0
        assert m["energy_mwh"] == pytest.approx(energy, rel=1e-4)
        assert m["survived_s"] == pytest.approx(60.0)
        assert 90.0 < m["energy_share_percent"] < 100.0


def test_worst_frequency_and_shed_energy_are_those_of_info_and_none_in_the_papers_physics(results):
    law, seeds = "coordinated-tuned", range(10_000, 10_006)
    env = gym.make("GFMWTG-14bus-v1", strategy=law, duration_s=20.0, disable_env_checker=True).unwrapped
    for episode in evaluate([], "standard-v1", "validation", seeds=seeds, duration_s=20.0).episodes_of(law):
        scenario = get_suite("standard-v1").scenario(episode.seed, duration_s=20.0)
        infos = [env.reset(options={"scenario": scenario})[1]]
        over = False
        while not over:
            _, _, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
            infos.append(info)
            over = terminated or truncated
        worst = [info["worst_frequency_hz"] for info in infos]
        m = episode.metrics
        assert 45.0 < m["worst_nadir_hz"] <= min(worst) and max(worst) <= m["worst_zenith_hz"] < 55.0
        assert m["worst_nadir_hz"] < m["nadir_hz"] and m["worst_zenith_hz"] > m["zenith_hz"]
        assert m["shed_energy_mwh"] == pytest.approx(infos[-1]["shed_energy_mws"] / 3600.0)
    names = ("worst_nadir_hz", "worst_zenith_hz", "shed_energy_mwh")
    assert {episode.metrics[name] for episode in results.episodes for name in names} == {None}


def test_deloading_shows_in_the_share_of_energy():
    calm = evaluate("deloaded-10", "paper", "test", seeds=[0], duration_s=5.0)
    shares = {e.entry: e.metrics["energy_share_percent"] for e in calm.episodes}
    assert shares["mppt"] == pytest.approx(100.0, abs=0.01)
    assert shares["deloaded-10"] == pytest.approx(90.0, abs=0.01)
    assert shares["coordinated-piecewise"] == pytest.approx(95.0, abs=0.01)
    errors = {e.entry: e.metrics["duty_error_percent"] for e in calm.episodes}
    assert errors["mppt"] == pytest.approx(5.0, abs=0.01)
    assert errors["coordinated-piecewise"] == pytest.approx(0.0, abs=0.01)


def test_quasi_steady_deviation_is_the_mean_of_the_last_five_seconds():
    frequency = np.concatenate([np.full(551, 49.0), np.full(50, 49.8)])
    assert quasi_steady_deviation(frequency, DT, 50.0) == pytest.approx(-0.2)
    assert quasi_steady_deviation(np.array([50.0, 50.1, 50.2]), DT, 50.0) == pytest.approx(0.15)


def test_tripped_groups_are_counted_where_the_run_goes_on():
    results = evaluate([], "low-wind", "test", seeds=range(20_000, 20_040), on_failure="trip")
    tripped = [e for e in results.episodes_of("mppt") if e.metrics["tripped_groups"] > 0.0]
    assert tripped and all(e.failure == "" and e.metrics["survived_s"] == pytest.approx(60.0) for e in tripped)
    assert Plant().trips_groups is False
