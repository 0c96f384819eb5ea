"""Evaluation: entries are played on the suites, measured, scored and ranked."""

from wtg_gym.evaluation.evaluator import evaluate
from wtg_gym.evaluation.metrics import METRICS, Metric
from wtg_gym.evaluation.results import Results, leaderboard_rows
from wtg_gym.evaluation.score import NoScaleError
from wtg_gym.evaluation.statistics import Interval
from wtg_gym.evaluation.summary import EntrySummary
from wtg_gym.evaluation.table import markdown_table, table_cells
from wtg_gym.evaluation.workers import Workers
from wtg_gym.policies import Entry, OnnxPolicy, Policy, PolicyError, load_entries

__all__ = [
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
