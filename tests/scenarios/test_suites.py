"""Facts about the frozen suites."""

import dataclasses
import math
import pickle

import gymnasium as gym
import pytest

from wtg_gym import LineTrip, evaluate, get_suite
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.scenarios import FROZEN_HASHES, SUITES, ScenarioDistribution, Suite
from wtg_gym.scenarios.draws import Draft, LoadEvents, LoadNoise, Picker, Record, SensorDistribution, Wind
from wtg_gym.scenarios.margin import ReserveMargin
from wtg_gym.tasks import V1

FIRST = [name for name, suite in SUITES.items() if suite.task.version == "v0"]
SECOND = [suite for suite in SUITES.values() if suite.task.version == "v1"]
STANDARD, STANDARD_V1 = (
    dataclasses.replace(get_suite(name), validation=range(10_000, 10_002), test=range(20_000, 20_002))
    for name in ("standard", "standard-v1")
)


def test_suites_are_those_of_the_benchmark():
    assert FIRST == ["paper", "standard", "low-wind", "gust", "weak-grid"]
    drawn = ["standard", "low-share", "high-share", "gusty", "no-wind-sensor", "faults", "weak-grid", "paper"]
    assert [suite.name for suite in SECOND] == [f"{name}-v1" for name in (*drawn, "ieee39", "kundur", "nordic45")]


@pytest.fixture(scope="module", params=FROZEN_HASHES)
def drawn(request):
    """A suite of the benchmark, its hash, and the scenarios of validation and test that the hash was computed of."""
    suite, scenarios, real = dataclasses.replace(get_suite(request.param)), [], Suite.scenarios

    def kept(*arguments):
        scenarios.extend(found := real(*arguments))
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Suite, "scenarios", kept)
        return suite, suite.hash, scenarios


def test_hash_is_the_frozen_one(drawn):
    suite, found, _ = drawn
    assert found == FROZEN_HASHES[suite.name], "a changed suite is a new version of the benchmark"


def test_scenarios_of_a_drawn_suite_of_v1_have_the_margin_of_their_stratum_in_any_order_and_start(drawn):
    suite, _, scenarios = drawn
    if suite.task is not V1 or not suite.distributions:
        assert suite.strata == () and suite.stratum(0) == ""
        return
    assert suite.strata == ("ample", "tight", "short")
    seeds = [*suite.validation, *suite.test]
    assert [scenario.seed for scenario in scenarios] == list(seeds)
    assert [suite.stratum(seed) for seed in seeds] == [suite.strata[seed % 3] for seed in seeds]
    named = "standard-v1" if suite.name == "no-wind-sensor-v1" else suite.name
    parts = [scenario.name.split("/") for scenario in scenarios]
    assert all(own == named and int(seed) in seeds for own, _, seed in parts)
    for stratum, (low, high) in zip(suite.strata, ((0.1, math.inf), (0.0, 0.1), (-0.1, 0.0)), strict=True):
        of_stratum = [scenario for scenario in scenarios if suite.stratum(scenario.seed) == stratum]
        assert all(low <= scenario.reserve_margin < high for scenario in of_stratum)
    for scenario in scenarios[::30]:
        assert scenario.reserve_margin == ReserveMargin(suite.plant).of(scenario)
    assert [own.to_json() for own in suite.scenarios(seeds[::-70])] == [own.to_json() for own in scenarios[::-70]]
    assert [suite.scenario(seed).to_json() for seed in seeds[:3]] == [own.to_json() for own in scenarios[:3]]
    for law in ("mppt", "deloaded-10", "coordinated-piecewise"):
        TaskLanes(EnvSettings(suite=suite.name, strategy=law, reward="cost")).prepare(scenarios)


@pytest.mark.parametrize(
    ("suite", "change"),
    [
        (
            STANDARD,
            {"drawn_from": {"": (STANDARD.distributions[0].changed({LoadNoise: {"standard_deviation_mw": 1.01}}),)}},
        ),
        (STANDARD, {"test": range(9, 99)}),
        (STANDARD_V1, {"drawn_from": dict(reversed(STANDARD_V1.drawn_from.items()))}),
        (STANDARD_V1, {"plant": dataclasses.replace(STANDARD_V1.plant, secondary_time_s=31.0)}),
        (STANDARD_V1, {"sensors": SensorDistribution(delay_s=(0.1, 0.2))}),
        (STANDARD_V1, {"sensors": None}),
        (STANDARD_V1, {"task": dataclasses.replace(V1, weights=V1.weights._replace(rotor=21.0))}),
        (STANDARD_V1, {"task": dataclasses.replace(V1, duty_time_s=20.0)}),
    ],
    ids=str,
)
def test_hash_sees_scenarios_plant_sensors_and_task_but_not_words_and_copies(suite, change):
    assert dataclasses.replace(suite, **change).hash != suite.hash
    assert dataclasses.replace(suite, description="other words").hash == suite.hash
    assert pickle.loads(pickle.dumps(suite)).hash == suite.hash


@dataclasses.dataclass(frozen=True, kw_only=True)
class Blinks(Record):
    """A kind of event that the package does not draw: a line is open for some time."""

    away_s: tuple[float, float] = (1.0, 2.0)

    def draw(self, pick: Picker, draft: Draft) -> None:
        away_s, time_s = pick.instant(self.away_s), pick.instant(draft.window)
        draft.events.append(LineTrip(time_s=time_s, from_bus=4, to_bus=5, recloses_after_s=away_s))


def test_a_suite_of_ones_own_records_is_played_without_a_file():
    drawn = ScenarioDistribution(name="mine", records=(LoadEvents(number=(2, 2)), Wind(), Blinks()))
    suite = dataclasses.replace(STANDARD_V1, name="mine", drawn_from={"": (drawn,)})
    other = dataclasses.replace(suite, drawn_from={"": (drawn.changed({Blinks: {"away_s": (1.0, 3.0)}}),)})
    assert other.hash != suite.hash and drawn.to_dict()["records"]["Blinks"] == {"away_s": (1.0, 2.0)}
    env = gym.make("wtg_gym:GFMWTG-14bus-v1", suite=suite)
    env.reset(seed=1)
    assert env.unwrapped.settings.resolved_suite is suite and env.unwrapped.settings.suite_name == "mine"
    for scenario in suite.scenarios(range(10_000, 10_002)):
        assert [type(event) for event in scenario.events[2:]] == [LineTrip]
        # Nothing else is drawn: droop, inertia, load and commitment are those of the grid.
        assert (scenario.governor_droop, scenario.inertia_scale, scenario.load_level) == (None, 1.0, 1.0)
        assert scenario.committed == 1.0 and scenario.load_noise_mw.size == 0
    with pytest.raises(ValueError, match=r"suite must be a name or the path of a file, .*Suite"):
        evaluate([], suite)
