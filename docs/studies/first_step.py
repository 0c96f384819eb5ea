"""For docs/performance.md: core time to the first step and the first score, from an empty cache of machine code.

Two minutes on a machine that does nothing else. Each case runs in a process of its own; numpy uses one thread.
"""

import os
import subprocess
import sys
import tempfile

from output import folder

from wtg_gym.files import markdown_table, update_between_markers

PROGRAM = """
import sys, time
import gymnasium as gym, numpy as np
version, n_envs, groups, what, grid = [*sys.argv[1:], ""][:5]
n_envs = int(n_envs)
name, given = f"wtg_gym:GFMWTG-14bus-{version}", {"groups": int(groups)} if groups else {}
if grid:
    name, given = "wtg_gym:GFMWTG-v1", {"grid": grid}
env = gym.make(name, **given) if n_envs == 1 else gym.make_vec(name, num_envs=n_envs, **given)
env.reset(seed=0)
action = np.zeros(env.action_space.shape, np.float32)
env.step(action)
if what == "score":
    from wtg_gym.evaluation import evaluate
    evaluate(["baselines"], "standard" if version == "v0" else "standard-v1", "validation")
if what == "gradient":
    from wtg_gym.envs.settings import EnvSettings
    from wtg_gym.gradients import Tape
    tape = Tape(EnvSettings(version=version), n_envs)
    scenarios = tape.lanes.scenarios(list(tape.lanes.suite.validation)[:n_envs])
    tape.gradient(scenarios, np.zeros((1, n_envs, tape.lanes.n_action)))
print(time.process_time())
"""
# What is timed, and its version, environments, groups and what comes after the first step; indented: with the cache of
# the case before.
CASES = (
    ("v0, first step", ("v0", "1", "", "step")),
    ("  again", ("v0", "1", "", "step")),
    ("  three groups", ("v0", "1", "3", "step")),
    ("  first score", ("v0", "1", "", "score")),
    ("v1, vector of 64, first step", ("v1", "64", "", "step")),
    ("  first score", ("v1", "64", "", "score")),
    ("  first gradient", ("v1", "64", "", "gradient")),
    ("  IEEE 39", ("v1", "64", "", "step", "ieee39")),
)


def core_time(arguments, cache):
    """Return the core time of a process [s]."""
    environment = {**os.environ, "XDG_CACHE_HOME": cache, "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", PROGRAM, *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


def main(docs):
    """Renew the table."""
    rows, caches = [], []
    for name, arguments in CASES:
        if not name.startswith(" "):
            caches.append(tempfile.TemporaryDirectory())
        rows.append((name.replace("  ", "… "), f"{core_time(arguments, caches[-1].name):.1f}"))
        print(*rows[-1], sep=": ", flush=True)
    for cache in caches:
        cache.cleanup()
    update_between_markers(
        docs / "performance.md", markdown_table(("case", "core time [s]"), rows, right=(1,)), "first"
    )


if __name__ == "__main__":
    main(folder(__doc__))
