"""What gradients, evolution and the planner's pupil have in common: runs repeat, and wrong options are refused."""

from pathlib import Path

import pytest
import torch

from agents import dagger, evolution, gradient, planner
from agents.export import export
from agents.run import Run, folders
from tests.agents.small import actions_of
from tests.interruption import interrupted
from wtg_gym import load_entries
from wtg_gym.policies.torch_export import TorchPolicy

POLICIES = Path(__file__).parents[2] / "agents" / "policies"
SHIPPED = ["--start", str(POLICIES / "dagger-v1-0")]
ACTS = ["--action-mode", "k", "--strategy", "coordinated-free"]
#: Runs with a validation before, between and after their rounds, and in which function they are interrupted.
RUNS = {
    gradient: (
        "--suite standard --timesteps 2400 --interval 1200 --n-envs 2 --validation-episodes 2 --hidden 8 --lstm 4",
        *(gradient, "descend"),
    ),
    evolution: (
        "--suite standard --timesteps 19200 --interval 9600 --n-envs 2 --validation-episodes 2 --hidden 3 "
        "--population 4 --spread 0.2",
        *(evolution.EvolutionLearner, "tell"),
    ),
    # Its plans are made by then, and numbers drawn.
    dagger: (
        "--action-mode k --strategy coordinated-free --timesteps 2160 --interval 1080 --n-envs 3 "
        "--validation-episodes 3 --hidden 4 --lstm 4 --updates 2 --horizon-s 60 --interval-s 60 --iterations 1",
        *(dagger.DaggerLearner, "fit"),
    ),
}
WRONG = [
    (gradient, ["--hidden", "8", "0"], "hidden must be a whole number"),
    (gradient, ["--lstm", "-1"], "lstm must"),
    (planner, ["--episodes", "3", "--interval-s", "0.1"], "interval_s"),
    (planner, ["--episodes", "3", "--horizon-s", "5"], "horizon_s = 5 s must reach to the next plan, in 10 s"),
    (evolution, ["--population", "3"], "population must be a whole number in 4 … 10000, got 3"),
    (evolution, [*SHIPPED, *ACTS[:2]], "has strategy = 'coordinated-free', not 'coordinated-piecewise'"),
    (
        evolution,
        ["--start", str(POLICIES / "ppo-v1-0"), *ACTS[2:]],
        "has per_group = false: its policy sees all",
    ),
    (evolution, ["--start", "no-such-folder", *ACTS], "no-such-folder"),
    (evolution, [*SHIPPED, "--hidden", "8", *ACTS], "leave out --hidden and --lstm"),
    (evolution, ["--observation-mode", "privileged"], "leave out --observation-mode"),
]


def name_of(value) -> str:
    return getattr(value, "__name__", str(value))


@pytest.mark.parametrize("module", RUNS, ids=name_of)
def test_run_repeats_also_after_an_interruption_and_is_exported(module, tmp_path, monkeypatch):
    (words, owner, step), one, two = RUNS[module], tmp_path / "one", tmp_path / "two"
    # The last policies count: the first are the law itself.
    monkeypatch.setattr(Run, "best", property(lambda run: run.curve[-1]))
    assert module.main([*words.split(), "--output", str(one)]) == 0
    with monkeypatch.context() as patch:
        # After the second validation.
        stop = interrupted(getattr(owner, step), lambda *_: len(Run.read(two).curve) == 2)
        patch.setattr(owner, step, stop)
        assert module.main([*words.split(), "--output", str(two)]) == 130
    for _ in range(2):
        assert module.main(["--resume", str(two)]) == 0
    run, resumed = Run.read(one), Run.read(two)
    curves = [[{**row, "wall_time_s": 0.0} for row in each.curve] for each in (run, resumed)]
    assert curves[0] == curves[1] and len(curves[0]) == 3
    assert [(each.finished, len(each.resumptions)) for each in (run, resumed)] == [(True, 0), (True, 1)]
    networks = []
    for folder in (one, two):
        learner = module.rounds(run.settings, module.Hyperparameters(**run.settings.hyperparameters)).learner
        learner.load(folders(folder / "checkpoints")[0])
        networks.append(learner.network)
    states = [network.state_dict() for network in networks]
    assert all(torch.equal(states[0][key], states[1][key]) for key in states[0])
    files = [(folders(folder / "best")[-1] / "policy.onnx").read_bytes() for folder in (one, two)]
    assert files[0] == files[1]
    export(one, tmp_path / "entry", name="mine")
    (entry,) = load_entries(tmp_path / "entry")
    n = entry.policy.widths[0]
    assert actions_of(TorchPolicy(networks[0]), n) == pytest.approx(actions_of(entry.policy, n), abs=1e-6)
    assert actions_of(entry.policy, n).any() and entry.per_group == (module is not gradient)


@pytest.mark.parametrize(("module", "words", "message"), WRONG, ids=name_of)
def test_wrong_options_are_refused(module, words, message, tmp_path, capsys):
    output = [] if module is planner else ["--output", str(tmp_path / "run")]
    assert module.main([*words, *output]) == 2
    assert message in capsys.readouterr().err
