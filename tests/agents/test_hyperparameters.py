"""Facts about the configuration files: RL Zoo and this package mean the same by them, and no code in them is run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from torch import nn

from agents.hyperparameters import ACTIVATIONS, ALGORITHMS, CONFIG_FOLDER, parse, parse_literal, read_config
from tests.agents.small import CONFIGS, ENV_ID

FILES = [*ALGORITHMS, "ppo_tau", "ippo"]


@pytest.mark.parametrize("name", FILES)
def test_shipped_files_mean_what_rl_zoo_makes_of_them(name: str) -> None:
    path = CONFIG_FOLDER / f"{name}.yml"
    raw = yaml.safe_load(path.read_text())[ENV_ID]
    ours = parse(read_config(path, ENV_ID))
    # RL Zoo's own way: eval for dictionaries, the part after "lin_" for a schedule that falls to zero.
    assert ours.arguments["policy_kwargs"] == eval(raw["policy_kwargs"], {"nn": nn, "dict": dict})
    start = float(raw["learning_rate"].removeprefix("lin_"))
    schedule = ours.arguments["learning_rate"]
    assert [schedule(left) for left in (1.0, 0.5, 0.0)] == pytest.approx([start, start / 2, 0.0])
    assert (ours.n_timesteps, ours.n_envs) == (raw["n_timesteps"], raw["n_envs"])
    assert ours.normalize == {"gamma": raw["gamma"]}


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
    ("changes", "text"),
    [
        ({"n_timesteps": None}, "n_timesteps must be a whole number, got None"),
        ({"n_envs": "x"}, "n_envs must be a whole number, got 'x'"),
        ({"learning_rate": "exp_0.1"}, "could not convert"),
        ({"normalize": "exit()"}, "normalize must be a dictionary"),
    ],
)
def test_bad_values_are_named(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        parse({**CONFIGS["ppo"], **changes})


def test_unknown_section_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.yml"
    for content, text in (("Pendulum-v1: {}", "must have a section"), ("a: [", "is not yml")):
        path.write_text(content)
        with pytest.raises(ValueError, match=text):
            read_config(path, ENV_ID)
