"""`python -m agents.shipped`: prints, for each policy that a learner trained, the line for a shell that makes it again.

To make one, `python -m agents.shipped | grep runs/ppo-k-0 | sh`; eight at a time, each on one thread,
`python -m agents.shipped | OMP_NUM_THREADS=1 xargs -d '\\n' -P 8 -n 1 sh -c`. They are exported to runs/policies.
"""

from __future__ import annotations

import shlex
from pathlib import Path

from wtg_gym.policies.load import ENTRY_FILE
from wtg_gym.policies.submission_folder import parse_submission

_POLICIES = Path(__file__).parent / "policies"
_V0 = "--suite standard"
#: In v1 agents modulate the law that is tuned to the grid.
_V1 = "--suite standard-v1 --strategy coordinated-tuned --validation-episodes 200"
#: What trains a set-up, by the name of its folders, and its number of training seeds.
SHIPPED = {
    "ppo-k+tau": (f"agents.train --algo ppo --action-mode k+tau {_V0}", 5),
    "ppo-k": (f"agents.train --algo ppo --action-mode k {_V0}", 5),
    "ppo-tau": (f"agents.train --algo ppo --action-mode tau --config agents/configs/ppo_tau.yml {_V0}", 5),
    "sac-k+tau": (f"agents.train --algo sac --action-mode k+tau {_V0}", 5),
    "ppo-v1": (f"agents.train --algo ppo {_V1}", 3),
    "recurrent-ppo-v1": (f"agents.train --algo recurrent_ppo {_V1}", 3),
    "sac-v1": (f"agents.train --algo sac {_V1}", 3),
    "gradient": (f"agents.gradient --validation-episodes 100 {_V0}", 5),
    "gradient-v1": (f"agents.gradient --lstm 32 --hidden 32 {_V1} --timesteps 2880000", 5),
}


def commands() -> dict[str, list[str]]:
    """Return what trains every policy, by the name of its folder."""
    return {
        f"{key}-{seed}": [*command.split(), "--seed", str(seed), "--output", f"runs/{key}-{seed}"]
        for key, (command, n_seeds) in SHIPPED.items()
        for seed in range(n_seeds)
    }


def main() -> None:
    """Print the lines."""
    for name, command in commands().items():
        entry = parse_submission((_POLICIES / name / ENTRY_FILE).read_bytes())
        texts = ["--name", entry.name, "--description", entry.description, "--authors", *entry.authors]
        export = ["agents.export", f"runs/{name}", "--output", f"runs/policies/{name}", *texts]
        print(" && ".join(shlex.join(["python", "-m", *words]) for words in (command, export)))


if __name__ == "__main__":
    main()
