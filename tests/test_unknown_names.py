"""A misspelt name is refused with the nearest one that there is, by whatever it names."""

import pytest

from wtg_gym.envs import EnvSettings
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.tracking_law import get_law
from wtg_gym.policies.entry_folder import load_entries
from wtg_gym.ranges import ByName
from wtg_gym.scenarios import get_suite


@pytest.mark.parametrize(
    ("look_up", "nearest"),
    [
        (lambda: get_suite("standrad"), "standard"),
        (lambda: EnvSettings(version="v1", suite="wek-grid-v1"), "weak-grid-v1"),
        (lambda: get_suite("standard").seeds("tests"), "test"),
        (lambda: EnvSettings(version="V1"), "v1"),
        (lambda: EnvSettings(plant={"physics": "extented"}).resolved_plant, "extended"),
        (lambda: Plant().replaced(physics="nrel_5mw"), "nrel-5mw"),
        (lambda: EnvSettings(action_mode="k+taw"), "k+tau"),
        (lambda: EnvSettings(weights={"dutty": 0.0}).cost_weights(), "duty"),
        (lambda: get_grid("kundru"), "kundur"),
        (lambda: get_law("mptt"), "mppt"),
        (lambda: load_entries("Coordinated-Tunned"), "coordinated-tuned"),
        (lambda: load_entries("fast-drop"), "fast-droop"),
        (lambda: load_entries("polices"), "policies"),
        (lambda: ByName("agent", {"wtg0": 0})["wtg"], "wtg0"),
    ],
)
def test_a_misspelt_name_is_refused_with_the_nearest(look_up, nearest):
    with pytest.raises((ValueError, KeyError), match=f"; did you mean '{nearest.replace('+', '.')}'\\?"):
        look_up()
