"""Facts about the configuration files: RL Zoo and this package mean the same by them, and no code in them is run."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from torch import nn

from agents.hyperparameters import ALGORITHMS, CONFIG_FOLDER, parse, parse_literal, read_config
from agents.networks import ACTIVATIONS
from tests.agents.small import ON_POLICY
from wtg_gym import ENV_ID


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_shipped_files_mean_what_rl_zoo_makes_of_them(algo: str) -> None:
    path = CONFIG_FOLDER / f"{algo}.yml"
    raw = yaml.safe_load(path.read_text())[ENV_ID]
    ours = parse(algo, read_config(path))
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
    assert {path.stem for path in CONFIG_FOLDER.glob("*")} == set(ALGORITHMS)


def test_texts_are_read_as_python_writes_them() -> None:
    text = "dict(log_std_init=-2, net_arch=dict(pi=[64, 64], vf={'a': (1, 2.5)}), activation_fn=nn.ReLU, ortho=True)"
    assert parse_literal("policy_kwargs", text) == eval(text, {"nn": nn, "dict": dict})
    assert all(parse_literal("key", f"dict(a={name})") == {"a": kind} for name, kind in ACTIVATIONS.items())


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "dict(a=open('f'))",
        "dict(a=nn.Module)",
        "[1]",
        "dict(**{})",
        "dict(a=b)",
        "(",
    ],
)
def test_texts_that_would_need_evaluation_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="policy_kwargs must be a dictionary"):
        parse_literal("policy_kwargs", text)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"frame_stack": 4}, r"unknown hyperparameters \['frame_stack'\]"),
        ({"policy": None}, "policy must be the name"),
        ({"n_envs": 0}, "n_envs must be a whole number of 1 or more, got 0"),
        ({"n_timesteps": 1.5}, "n_timesteps must be"),
        ({"learning_rate": "lin_x"}, "learning_rate must be a number above 0"),
        ({"learning_rate": "exp_0.1"}, "learning_rate must be"),
        ({"noise_type": "normal", "noise_std": -0.1}, "noise_std above 0"),
        ({"normalize": "exit()"}, "normalize must be a dictionary"),
        ({"normalize": "dict(norm_actions=True)"}, "normalize takes training, norm_obs"),
    ],
)
def test_bad_values_are_named(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        parse("ppo", {**ON_POLICY, **changes})


def test_unknown_algorithm_and_section_are_named(tmp_path: Any) -> None:
    with pytest.raises(ValueError, match="unknown algorithm 'dqn'; choose one of ppo"):
        parse("dqn", ON_POLICY)
    path = tmp_path / "a.yml"
    for content, text in (("Pendulum-v1: {}", "must have a section"), ("a: [", "is not yml")):
        path.write_text(content)
        with pytest.raises(ValueError, match=text):
            read_config(path)
