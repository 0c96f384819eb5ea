"""What happens in a run: random wind, load events and grid strength, frozen suites, and measured wind."""

from wtg_gym.scenarios.distribution import ScenarioDistribution
from wtg_gym.scenarios.suite import SPLITS, FixedCase, Suite
from wtg_gym.scenarios.suites import DEFAULT_SUITE, FROZEN_HASHES, SUITES, get_suite, suite_of_grid
from wtg_gym.scenarios.wind import read_wind_csv

__all__ = [
    "DEFAULT_SUITE",
    "FROZEN_HASHES",
    "SPLITS",
    "SUITES",
    "FixedCase",
    "ScenarioDistribution",
    "Suite",
    "get_suite",
    "read_wind_csv",
    "suite_of_grid",
]
