"""Facts about the configuration files: RL Zoo and this package mean the same by them, and no code in them is run."""

import pytest
import yaml

from agents.train import CONFIG_FOLDER, TRAINED, algorithm_arguments, normalization_arguments, read_config
from tests.agents.small import ENV_ID


@pytest.mark.parametrize("name", [*TRAINED, "ppo_tau"])
def test_shipped_files_mean_what_rl_zoo_makes_of_them(name):
    path = CONFIG_FOLDER / f"{name}.yml"
    raw, read = yaml.safe_load(path.read_text())[ENV_ID], read_config(path, ENV_ID)
    arguments = algorithm_arguments(read)
    # RL Zoo evaluates texts, takes dictionaries as they are, and the part after "lin_" for a schedule that falls to 0.
    assert arguments["policy_kwargs"] == raw["policy_kwargs"] and isinstance(raw["policy_kwargs"], dict)
    start, schedule = float(raw["learning_rate"].removeprefix("lin_")), arguments["learning_rate"]
    assert [schedule(left) for left in (1.0, 0.5, 0.0)] == pytest.approx([start, start / 2, 0.0])
    assert raw["normalize"] is True and normalization_arguments(read) == {"gamma": raw["gamma"]}


#: Names of names, nine of each: a billion values of a few hundred characters.
ALIASES = "a0: &a0 [x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 11))


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (ALIASES, "values on one level"),
        (f"{ENV_ID}: {{1: 2}}", "holds a key that is no text"),
        ("Pendulum-v1: {}", "must have a section"),
        ("a: [", "is not yml"),
        (f"{ENV_ID}: {{policy_kwargs: !!python/object/apply:os.abort []}}", "is not yml"),
    ],
)
def test_files_without_a_section_in_plain_yml_are_refused(content, text, tmp_path):
    path = tmp_path / "a.yml"
    path.write_text(content)
    with pytest.raises(ValueError, match=text):
        read_config(path, ENV_ID)
