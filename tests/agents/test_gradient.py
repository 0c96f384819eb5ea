"""Facts about training by gradients: it learns, repeats, goes on after an interruption, and is exported."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
import torch

from agents import gradient
from agents.export import export
from agents.folders import folders
from agents.gradient import Failures, GradientLearner, GradientPolicy, Hyperparameters, costs_of, descend, main
from agents.runs import Run
from tests.agents.small import largest_difference
from tests.interruption import interrupted
from wtg_gym.envs import EnvSettings
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.gradients.torch import TorchEpisodes
from wtg_gym.policies.load import load_entries
from wtg_gym.policies.torch_export import TorchPolicy

#: Two gradients, with a validation before, between and after them.
OPTIONS = ["--suite", "standard", "--timesteps", "2400", "--interval", "1200"]
OPTIONS += ["--n-envs", "2", "--validation-episodes", "2"]

#: As `tests/gradients` has it, whose machine code is shared.
V1: dict[str, Any] = {"version": "v1"}


@pytest.mark.parametrize(("hidden", "lstm", "settings"), [((8,), 0, V1), ((), 8, {})])
def test_loss_falls_on_the_scenarios_that_it_is_of(
    hidden: tuple[int, ...], lstm: int, settings: dict[str, Any]
) -> None:
    torch.manual_seed(0)
    episodes = TorchEpisodes(EnvSettings(**{"version": "v0", **settings}), 4, 1)
    lanes, failures, h = episodes.tape.lanes, Failures(episodes), Hyperparameters(hidden=hidden, lstm=lstm)
    policy = GradientPolicy(lanes.n_observation, lanes.n_action, hidden, lstm)
    optimizer = torch.optim.Adam(policy.parameters(), lr=h.learning_rate)
    scenarios = lanes.scenarios(range(1_000_000, 1_000_004))
    losses = [descend(policy, optimizer, costs_of(episodes, policy, scenarios, 100, failures), h) for _ in range(10)]
    assert losses[-1] < losses[0] - 0.01


def test_a_failure_comes_gradually_and_its_approach_has_a_gradient() -> None:
    settings = EnvSettings(**V1)
    episodes = TorchEpisodes(settings, 4, 1)
    failures, n_watched = Failures(episodes), 1 + episodes.tape.lanes.n_wtg
    limits = torch.tensor([0.97] + [0.5] * (n_watched - 1), dtype=torch.float64)
    alive, worst = torch.tensor([[40.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]], dtype=torch.float64), 15.0 * 61.0
    assert failures.costs(alive, limits[None] + 0.5).item() == pytest.approx(40.0)
    # A failure of another kind keeps its charge; in the one that comes gradually it is counted once.
    charged = alive + torch.tensor([0.0] * 6 + [1000.0], dtype=torch.float64)
    assert failures.costs(charged, limits[None] + 0.5).item() == pytest.approx(1040.0)
    one_at_its_limit = limits + 0.5
    one_at_its_limit[1] = 0.5
    share = 1.0 / (1.0 + math.exp(-1.0))
    for terms in (alive, charged):
        assert failures.costs(terms, one_at_its_limit[None]).item() == pytest.approx(40.0 + share * (worst - 40.0))
    least = (limits + 0.005).repeat(4, 1).requires_grad_()
    failures.costs(alive.repeat(4, 1), least).sum().backward()  # type: ignore[no-untyped-call]
    assert least.grad is not None and (least.grad < 0.0).all()


def test_run_repeats_also_after_an_interruption_and_is_exported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The last of the policies counts as the best.
    monkeypatch.setattr(Run, "best", property(lambda run: run.curve[-1]))
    one, two = tmp_path / "one", tmp_path / "two"
    options = [*OPTIONS, "--hidden", "8", "--lstm", "4"]
    assert main([*options, "--output", str(one)]) == 0

    with monkeypatch.context() as patch:
        stop = interrupted(descend, when=lambda *_: Run.read(two).curve[-1]["timesteps"] == 1200)
        patch.setattr(gradient, "descend", stop)
        assert main([*options, "--output", str(two)]) == 130
    for _ in range(2):
        assert main(["--resume", str(two)]) == 0
    runs, saved = [Run.read(folder) for folder in (one, two)], [folders(each / "checkpoints")[0] for each in (one, two)]
    states = [torch.load(path / "state.pt", weights_only=True)["policy"] for path in saved]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])
    curves = [[{**row, "wall_time_s": 0.0} for row in run.curve] for run in runs]
    assert curves[0] == curves[1] and len(curves[0]) == 3
    assert [(run.finished, len(run.resumptions)) for run in runs] == [(True, 0), (True, 1)]

    export(one, tmp_path / "entry", name="mine")
    (entry,), h = load_entries(tmp_path / "entry"), Hyperparameters(**runs[0].settings.hyperparameters)
    lanes = TaskLanes(EnvSettings(**runs[0].settings.env_arguments), 1, 1)
    learner = GradientLearner(GradientPolicy(lanes.n_observation, lanes.n_action, h.hidden, h.lstm), h)
    learner.load(saved[0])
    assert largest_difference(TorchPolicy(learner.policy), entry.policy, runs[0].settings) <= 1e-6


def test_layers_without_width_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for given in (["--hidden", "8", "0"], ["--lstm", "-1"]):
        assert main([*given, "--output", str(tmp_path / "run")]) == 2
        assert "layers must be 1 or more wide" in capsys.readouterr().err
