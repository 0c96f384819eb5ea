"""Facts about the configuration files: RL Zoo and this package mean the same by them, and no code in them is run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from torch import nn

from agents.hyperparameters import ACTIVATIONS, ALGORITHMS, CONFIG_FOLDER, parse, parse_literal, read_config
from agents.train import main as train
from tests.agents.small import CONFIGS, ENV_ID
from wtg_gym.scenarios.benchmark import V0, V1

#: The files that are not named after their algorithm.
OTHER_FILES = {"ppo_tau": "ppo", "ippo": "ppo"}


@pytest.mark.parametrize("name", [*ALGORITHMS, *OTHER_FILES])
def test_shipped_files_mean_what_rl_zoo_makes_of_them(name: str) -> None:
    path, algo = CONFIG_FOLDER / f"{name}.yml", OTHER_FILES.get(name, name)
    raw = yaml.safe_load(path.read_text())[ENV_ID]
    ours = parse(algo, read_config(path, ENV_ID))
    # RL Zoo's own way: eval for dictionaries, the part after "lin_" for a schedule that falls to zero.
    assert ours.arguments["policy_kwargs"] == eval(raw["policy_kwargs"], {"nn": nn, "dict": dict})
    rate = raw["learning_rate"]
    if isinstance(rate, str):
        schedule = ours.arguments["learning_rate"]
        assert rate.startswith("lin_")
        assert [schedule(left) for left in (1.0, 0.5, 0.0)] == pytest.approx([float(rate[4:]) * x for x in (1, 0.5, 0)])
    assert (ours.n_timesteps, ours.n_envs) == (raw["n_timesteps"], raw["n_envs"])
    assert ours.normalize == {"gamma": raw["gamma"]}


def test_there_are_no_other_files() -> None:
    assert {path.stem for path in CONFIG_FOLDER.glob("*")} == {*ALGORITHMS, *OTHER_FILES}


def test_texts_are_read_as_python_writes_them() -> None:
    text = "dict(log_std_init=-2, net_arch=dict(pi=[64, 64], vf={'a': (1, 2.5)}), activation_fn=nn.ReLU, ortho=True)"
    assert parse_literal("policy_kwargs", text) == eval(text, {"nn": nn, "dict": dict})
    assert all(parse_literal("key", f"dict(a={name})") == {"a": kind} for name, kind in ACTIVATIONS.items())


@pytest.mark.parametrize(
    "text", ["__import__('os').system('true')", "dict(a=nn.Module)", "[1]", "dict(**{})", "dict(a=b)", "("]
)
def test_texts_that_would_need_evaluation_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="policy_kwargs must be a dictionary"):
        parse_literal("policy_kwargs", text)


@pytest.mark.parametrize(
    ("algo", "changes", "text"),
    [
        ("ppo", {"frame_stack": 4}, r"unknown hyperparameters \['frame_stack'\]"),
        ("ppo", {"policy": None}, "policy must be the name"),
        ("ppo", {"n_envs": 0}, "n_envs must be a whole number of 1 or more, got 0"),
        ("ppo", {"n_timesteps": 1.5}, "n_timesteps must be"),
        ("ppo", {"learning_rate": "exp_0.1"}, "learning_rate must be a number above 0"),
        ("ppo", {"learning_rate": 0}, "learning_rate must be a number above 0, got 0"),
        ("ppo", {"noise_type": "normal", "noise_std": -0.1}, "noise_std above 0"),
        ("ppo", {"normalize": "exit()"}, "normalize must be a dictionary"),
        ("ppo", {"normalize": "dict(norm_actions=True)"}, "normalize takes training, norm_obs"),
        ("ppo", {"normalize": "dict(clip_obs=-1)"}, "clip_obs must be a number above 0, got -1"),
        ("ppo", {"n_epochs": "x"}, "n_epochs must be a whole number of 1 or more, got 'x'"),
        ("ppo", {"n_epochs": True}, "n_epochs must be"),
        ("ppo", {"sde_sample_freq": 0}, "sde_sample_freq must be a whole number of 1 or more, or -1, got 0"),
        ("ppo", {"gamma": 2.0}, "gamma must be a number from 0 to 1, got 2.0"),
    ],
)
def test_bad_values_are_named(algo: str, changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text) as caught:
        parse(algo, {**CONFIGS[algo], **changes})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("algo", "changes"),
    [
        ("ppo", {"target_kl": None, "clip_range_vf": None, "clip_range": "lin_0.2", "gamma": 1}),
        ("sac", {"ent_coef": "auto", "gradient_steps": -1, "train_freq": [2, "step"]}),
        ("tqc", {"ent_coef": 0.1, "target_entropy": "auto"}),
    ],
)
def test_values_that_the_algorithms_take_are_taken(algo: str, changes: dict[str, Any]) -> None:
    parse(algo, {**CONFIGS[algo], **changes})


def test_unknown_section_is_named(tmp_path: Any) -> None:
    path = tmp_path / "a.yml"
    for content, text in (("Pendulum-v1: {}", "must have a section"), ("a: [", "is not yml")):
        path.write_text(content)
        with pytest.raises(ValueError, match=text):
            read_config(path, ENV_ID)


def test_help_and_error_name_the_algorithms_without_hyperparameters_for_v1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    without = [algo for algo in ALGORITHMS if V1.env_id not in (CONFIG_FOLDER / f"{algo}.yml").read_text()]
    with pytest.raises(SystemExit):
        train(["--help"])
    assert f"of {' and '.join(without)} for v0 only" in " ".join(capsys.readouterr().out.split())
    for algo in without:
        assert train(["--algo", algo, "--output", str(tmp_path / "run")]) == 2
        expected = (
            f"{algo}.yml must have a section '{V1.env_id}' with keys and values; it has one for {V0.env_id}: give"
        )
        assert expected in capsys.readouterr().err
