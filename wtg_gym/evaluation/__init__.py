"""Entries, their evaluation on the suites, metrics, scores and the leaderboard."""

from wtg_gym.evaluation.entries import ANCHORS, Entry, Policy, load_entries
from wtg_gym.evaluation.evaluator import evaluate
from wtg_gym.evaluation.leaderboard import leaderboard_rows, markdown_table, table_cells
from wtg_gym.evaluation.metrics import METRICS, Metric
from wtg_gym.evaluation.onnx_policy import OnnxPolicy
from wtg_gym.evaluation.policy_process import PolicyError
from wtg_gym.evaluation.results import Results
from wtg_gym.evaluation.statistics import Interval, NoScaleError
from wtg_gym.evaluation.summary import EntrySummary
from wtg_gym.evaluation.workers import Workers

__all__ = [
    "ANCHORS",
    "METRICS",
    "Entry",
    "EntrySummary",
    "Interval",
    "Metric",
    "NoScaleError",
    "OnnxPolicy",
    "Policy",
    "PolicyError",
    "Results",
    "Workers",
    "evaluate",
    "leaderboard_rows",
    "load_entries",
    "markdown_table",
    "table_cells",
]
