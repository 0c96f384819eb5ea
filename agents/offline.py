"""`python -m agents.offline`: policies learned from a dataset alone, by d3rlpy, as entries with their scores.

d3rlpy comes with no extra: it goes into an environment of its own, as docs/integrations.md shows.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from agents.command import (
    KEPT,
    Parser,
    add_comparison_options,
    compare,
    note,
    require_package,
    require_range,
    run_command,
)
from agents.datasets import VERSIONS
from agents.onnx_graph import normalized
from wtg_gym.policies.load import load_entries
from wtg_gym.policies.torch_export import export_onnx
from wtg_gym.scenarios import get_suite

#: Names of the algorithms and of their configurations in d3rlpy.
ALGORITHMS = {"bc": ("BC", "BCConfig"), "td3_bc": ("TD3+BC", "TD3PlusBCConfig"), "iql": ("IQL", "IQLConfig")}
_CLIP = 10.0
_GAMMA = 0.99
#: Weight of the value against cloning in TD3+BC.
_ALPHA = 0.4
_HIDDEN = (64, 64)

_DESCRIPTION = """\
Trains policies on a dataset that python -m agents.datasets made, without a step in the environment, exports each as an
entry and scores them on validation scenarios. It needs d3rlpy 2.8 and the extra data."""
_EXAMPLES = """\
examples:
  python -m agents.datasets --versions v1 --policies ppo mixed
  python -m agents.offline gfmwtg/v1/ppo-v0 gfmwtg/v1/mixed-v0 --output runs/offline
  wtg-gym evaluate --suite standard-v1 --entries runs/offline/*"""


class Actor(nn.Module):
    """A policy of d3rlpy behind the normalisation and the choice of its observations."""

    def __init__(
        self, policy: nn.Module, columns: Sequence[int], mean: npt.NDArray[np.float32], std: npt.NDArray[np.float32]
    ) -> None:
        super().__init__()
        self.policy = policy
        self.register_buffer("columns", torch.as_tensor(columns))
        self.register_buffer("mean", torch.as_tensor(mean))
        self.register_buffer("std", torch.as_tensor(std))

    def forward(self, observation: Tensor) -> Tensor:
        """Return the deterministic actions (batch, n_action)."""
        columns: Any = self.columns
        mean: Any = self.mean
        std: Any = self.std
        seen = observation.index_select(1, columns)
        answer: Tensor = self.policy(normalized(seen, mean, std, _CLIP)).squashed_mu
        return answer


def seen_columns(dataset: Any) -> list[int]:
    """Return the entries of a dataset's observations that policies learn from: all but the last actions.

    Noise is held for seconds, so that the last action tells the next one. What learns that repeats itself when it plays
    (de Haan, Jayaraman and Levine, "Causal Confusion in Imitation Learning", 2019).
    """
    with contextlib.closing(dataset.recover_environment()) as env:
        names = env.unwrapped.observation_names
    return [index for index, name in enumerate(names) if "last_action" not in name]


def train(dataset: Any, algorithm: str, n_steps: int, seed: int) -> Actor:
    """Return what an algorithm of :data:`ALGORITHMS` learns from a dataset of Minari in a number of gradient steps."""
    import d3rlpy

    d3rlpy.seed(seed)
    torch.set_num_threads(1)
    episodes = list(dataset.iterate_episodes())
    observations, actions, rewards, terminals, timeouts = (
        np.concatenate(column)
        for column in zip(
            # No step starts from the last observation.
            *((e.observations[:-1], e.actions, e.rewards, e.terminations, e.truncations) for e in episodes),
            strict=True,
        )
    )
    columns = seen_columns(dataset)
    observations = observations[:, columns]
    mean, std = observations.mean(axis=0), observations.std(axis=0) + 1e-6
    data = d3rlpy.dataset.MDPDataset(
        observations=normalized(
            torch.as_tensor(observations), torch.as_tensor(mean), torch.as_tensor(std), _CLIP
        ).numpy(),
        actions=actions,
        # A failure costs as much as minutes of life.
        rewards=(rewards / rewards.std()).clip(-_CLIP, _CLIP).astype(np.float32),
        terminals=terminals,
        timeouts=timeouts,
        # Zero actions look like numbers of discrete ones.
        action_space=d3rlpy.constants.ActionSpace.CONTINUOUS,
    )
    encoder = d3rlpy.models.VectorEncoderFactory(list(_HIDDEN), activation="tanh")
    named = "encoder_factory" if algorithm == "bc" else "actor_encoder_factory"
    arguments: dict[str, Any] = {"batch_size": 256, named: encoder}
    if algorithm != "bc":
        arguments |= {"critic_encoder_factory": encoder, "gamma": _GAMMA}
    if algorithm == "td3_bc":
        arguments["alpha"] = _ALPHA
    if algorithm == "iql":
        arguments["value_encoder_factory"] = encoder
    learner = getattr(d3rlpy.algos, ALGORITHMS[algorithm][1])(**arguments).create()
    silent = d3rlpy.logging.NoopAdapterFactory()
    learner.fit(data, n_steps=n_steps, n_steps_per_epoch=n_steps, logger_adapter=silent, show_progress=False)
    return Actor(learner.impl.policy, columns, mean.astype(np.float32), std.astype(np.float32))


def _exported(dataset: Any, algorithm: str, n_steps: int, seed: int, output: Path) -> Path:
    """Train on a dataset and return the folder of the entry, in `output`."""
    name, said = dataset.spec.dataset_name, dataset.storage.metadata
    began = time.monotonic()
    actor = train(dataset, algorithm, n_steps, seed)
    note(f"{algorithm} on {name}: {n_steps} steps in {time.monotonic() - began:.0f} s")
    return export_onnx(
        actor,
        output / f"{algorithm}-{name}",
        name=f"{ALGORITHMS[algorithm][0]} ({name})",
        environment=dataset.spec.env_spec.id,
        strategy=said["strategy"],
        training_seed=seed,
        description=f"Learned from {dataset.spec.dataset_id}, sha256 {said['data_sha256'][:12]}.",
        trained_on=f"{said['suite']}, split train, {n_steps} gradient steps",
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python -m agents.offline", description=_DESCRIPTION, epilog=_EXAMPLES)
    parser.add_argument("ids", nargs="+", metavar="DATASET", help="id, such as gfmwtg/v1/mixed-v0; all of one version")
    parser.add_argument("--datasets", metavar="FOLDER", help="folder of the datasets (default: Minari's own)")
    parser.add_argument("--algos", nargs="+", choices=list(ALGORITHMS), default=list(ALGORITHMS), help="who learns")
    parser.add_argument("--steps", type=int, default=20_000, metavar="N", help="gradient steps (default: 20000)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the training (default: 0)")
    add_comparison_options(parser, scenarios=200)

    def work() -> None:
        given = parser.parse_args(argv)
        require_range("--steps", given.steps, 1, 10**9, "gradient steps")
        require_range("--seed", given.seed, 0, 2**31 - 1, "")
        if given.datasets is not None:
            os.environ["MINARI_DATASETS_PATH"] = str(Path(given.datasets).resolve())
        require_package("d3rlpy", "d3rlpy==2.8.0")
        require_package("minari", "'minari[hdf5]'")
        import minari

        ids, algorithms = dict.fromkeys(given.ids), dict.fromkeys(given.algos)
        if missing := [name for name in ids if name not in minari.list_local_datasets()]:
            raise ValueError(f"there is no dataset {missing[0]}; python -m agents.datasets makes it")
        datasets = [minari.load_dataset(name) for name in ids]
        suites = {each.storage.metadata.get("suite") for each in datasets}
        if len(suites) > 1 or None in suites:
            raise ValueError(
                f"the datasets must be of one version and made by python -m agents.datasets, got {', '.join(ids)}"
            )
        (suite,) = suites
        # All seeds of the policy that plays in them.
        (policy,) = load_entries(VERSIONS[get_suite(suite).benchmark.version].policy)

        def trained(output: Path) -> list[str | Path]:
            pairs = itertools.product(datasets, algorithms)
            return [*(_exported(each, name, given.steps, given.seed, output) for each, name in pairs), policy.name]

        compare(given, trained, suite, f"{given.steps} gradient steps, seed {given.seed}", "offline")

    return run_command(work, KEPT)


if __name__ == "__main__":
    sys.exit(main())
