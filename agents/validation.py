"""The benchmark's score of a policy on held-out validation scenarios."""

from __future__ import annotations

from agents.runs import RunSettings
from wtg_gym.evaluation import Entry, Policy, evaluate
from wtg_gym.scenarios import get_suite


def validate(policy: Policy, settings: RunSettings) -> dict[str, float]:
    """Play the validation scenarios and return score and metrics of the policy, deterministic actions throughout.

    Args:
        policy: what to score, for raw observations.
        settings: of the run: suite, modes and number of scenarios.

    Raises:
        NoScaleError: MPPT is not worse than the reference on these scenarios.
    """
    entry = Entry(
        name="policy", policy=policy, action_mode=settings.action_mode, observation_mode=settings.observation_mode
    )
    seeds = get_suite(settings.suite).seeds("validation")[: settings.validation_episodes]
    results = evaluate([entry], settings.suite, "validation", seeds=seeds)
    (summary,) = (summary for summary in results.summaries if summary.name == entry.name)
    return {
        "score": summary.score.value,
        "cost": summary.mean_cost,
        "failures_percent": summary.failures_percent,
        "nadir_hz": summary.median_nadir_hz,
        "rocof_hz_s": summary.p95_rocof_hz_s,
        "duty_error_percent": summary.mean_duty_error_percent,
        "energy_share_percent": summary.mean_energy_share_percent,
    }


__all__ = ["validate"]
