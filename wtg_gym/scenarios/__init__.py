"""What happens in a run: random wind, load events and grid strength, frozen suites, and measured wind.

Fresh seeds and wind from files, which no environment needs, are imported when they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from wtg_gym.scenarios.distribution import TRIPPABLE_LINES, ScenarioDistribution
from wtg_gym.scenarios.suite import FRESH, SPLITS, FixedCase, Suite
from wtg_gym.scenarios.suites import DEFAULT_SUITE, FROZEN_HASHES, SUITES, get_suite
from wtg_gym.scenarios.wind import DRAWN_WIND_RANGE, TURBULENCE_CLASSES

if TYPE_CHECKING:
    from wtg_gym.scenarios.fresh import FreshDraw, draw_seeds
    from wtg_gym.scenarios.wind_csv import read_wind_csv

__all__ = [
    "DEFAULT_SUITE",
    "DRAWN_WIND_RANGE",
    "FRESH",
    "FROZEN_HASHES",
    "SPLITS",
    "SUITES",
    "TRIPPABLE_LINES",
    "TURBULENCE_CLASSES",
    "FixedCase",
    "FreshDraw",
    "ScenarioDistribution",
    "Suite",
    "draw_seeds",
    "get_suite",
    "read_wind_csv",
]

_PLACES = {"FreshDraw": "fresh", "draw_seeds": "fresh", "read_wind_csv": "wind_csv"}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"wtg_gym.scenarios.{_PLACES[name]}"), name)
