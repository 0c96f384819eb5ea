# /// script
# requires-python = ">=3.11"
# dependencies = ["wandb==0.31.0"]
# ///
import wandb

from wtg_gym import evaluate, leaderboard_rows

results = evaluate("fast-droop", "standard-v1", seeds=range(10_000, 10_010))
played = {"suite": results.suite, "source": results.source_hash}
with wandb.init(project="wtg_gym", mode="offline", config=played) as run:
    for row in leaderboard_rows(results):
        run.log({f"{row.name}/score": row.score.value, f"{row.name}/failures_percent": row.failures_percent})
