"""Whatever a user holds can be pickled and copied, and the copies do the same to the last bit."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import MODES, actions_of, bits, calm, eventful, n_resets, single_steps, started, vector_steps
from wtg_gym import GFMWTGEnv, GFMWTGVectorEnv, LoadStep, Plant, Scenario, evaluate, get_law, get_suite, load_entries
from wtg_gym.envs import EnvSettings
from wtg_gym.gradients import Tape
from wtg_gym.sb3 import make_sb3_vec_env
from wtg_gym.tasks.cost import COST_TERMS

SHORT, V1_ID = {"version": "v0", "duration_s": 2.0}, "wtg_gym:GFMWTG-14bus-v1"
#: For the four groups of version v1; v0 takes the first four columns.
BEFORE, AFTER, OTHER = (actions_of(seed, n, 17, 8) for seed, n in ((20, 13), (21, 60), (22, 25)))
DELAYED = {"version": "v1", "sensors": {"delay_s": (0.3, 0.9)}}
SETTINGS = [{"version": "v0", "suite": "gust"}, {**DELAYED, "suite": "faults", "observation_mode": "privileged"}]
MANY_EVENTS = calm(events=tuple(LoadStep(time_s=0.1 * n, bus=3, power_mw=2.0) for n in range(1, 31))).to_dict()


def copies(original):
    return [copy.deepcopy(original), pickle.loads(pickle.dumps(original))]


def batch_steps(env):
    # The last value of a step of Stable-Baselines3 has the time that an episode took.
    return [env.step(actions)[:3] for actions in actions_of(0, 25, env.num_envs).astype(np.float32)]


def steps_and_reset(env):
    return [*(env.step(actions[0]) for actions in actions_of(0, 15)), env.reset()]


def joint_steps(env):
    actions = actions_of(0, 15, len(env.possible_agents), 2)
    return [*(env.step(dict(zip(env.possible_agents, each, strict=True))) for each in actions), env.reset()]


def gradient(tape: Tape):
    tape.play([eventful()] * 2, actions_of(0, 5, 2))
    return tape.pull(4, np.zeros((2, tape.n_carried)), np.ones((2, len(COST_TERMS))))


STANDARD = get_suite("standard")
SEED = STANDARD.seeds("validation").start
KINDS = {
    "gym.make": (lambda: started(gym.make(V1_ID, duration_s=10.0, action_mode="k"), seed=0), steps_and_reset),
    "agents": (lambda: started(pytest.importorskip("wtg_gym.pettingzoo").parallel_env(**SHORT), seed=0), joint_steps),
    "Stable-Baselines3": (lambda: started(make_sb3_vec_env(3, seed=0, reward="score", **SHORT)), batch_steps),
    "entry": (lambda: load_entries("linear-feedback")[0], lambda entry: entry.to_dict()),
    "policy": (lambda: load_entries("linear-feedback")[0].policy, lambda policy: policy.predict(np.ones((2, 20)))),
    "results": (
        lambda: evaluate("mppt", "standard", seeds=[SEED], duration_s=2.0),
        lambda results: (results.entries, results.episodes, results.scores),
    ),
    "scenario": (eventful, Scenario.to_dict),
    "suite": (lambda: STANDARD, lambda suite: (suite.hash, suite.scenario(SEED).to_dict())),
    "settings": (lambda: EnvSettings(**SHORT), repr),
    "plant": (Plant, repr),
    "law": (lambda: get_law("coordinated-tuned"), repr),
    "tape": (lambda: Tape(EnvSettings(version="v0", duration_s=4.0), 2), gradient),
}


@pytest.mark.parametrize("kind", KINDS)
def test_pickles_and_copies_do_the_same_to_the_last_bit(kind):
    make, outcome = KINDS[kind]
    original = make()
    twins = copies(original)
    expected = bits(outcome(original))
    assert [bits(outcome(twin)) for twin in twins] == [expected, expected]


def steps_of(env, actions: np.ndarray, mode: AutoresetMode = AutoresetMode.NEXT_STEP, **reset):
    """Return the steps of a single environment in a list of one, or of every environment of a batch."""
    if isinstance(env, GFMWTGEnv):
        return [single_steps(env, actions[:, 0, : env.action_space.shape[0]], mode, **reset)]
    return vector_steps(env, actions[:, : env.num_envs, : env.single_action_space.shape[0]], **reset)


@pytest.mark.parametrize("mode", [None, *MODES])
@pytest.mark.parametrize("settings", SETTINGS, ids=str)
def test_copies_of_a_running_environment_go_on_alike_through_later_resets(settings, mode):
    given = {"duration_s": 2.0, **settings}
    env = GFMWTGEnv(**given) if mode is None else GFMWTGVectorEnv(17, autoreset_mode=mode, **given)
    steps_of(env, BEFORE, seed=3)
    twins = copies(env)
    one = steps_of(env, AFTER)
    assert min(n_resets(steps) for steps in one) >= 2
    for twin in twins:
        assert one == steps_of(twin, AFTER)
        assert mode is None or twin.batch.simulator.blocks.ctypes.data % 64 == 0, "blocks begin at a cache line"


@pytest.mark.parametrize("num_envs", [None, 17])
def test_snapshot_branches_as_often_as_asked_whatever_is_played_between(num_envs):
    # With a fixed scenario a branch may cross its end: nothing is drawn.
    given = {"scenario": eventful().to_dict(), "version": "v0"}
    env, twin = (GFMWTGEnv(**given) if num_envs is None else GFMWTGVectorEnv(num_envs, **given) for _ in range(2))
    for each in (env, twin):
        steps_of(each, BEFORE, seed=3)
    start, branches = pickle.loads(pickle.dumps(env.snapshot())), []
    for actions in (AFTER, OTHER, AFTER, OTHER):
        env.restore(start)
        branches.append(steps_of(env, actions))
        env.reset(options={"scenario": MANY_EVENTS} if num_envs is None else {"scenarios": [MANY_EVENTS] * num_envs})
    assert branches[0] == branches[2] and branches[1] == branches[3] and branches[0][0][:25] != branches[1][0]
    assert branches[0] == steps_of(twin, AFTER)
    twin.restore(start)
    assert branches[0] == steps_of(twin, AFTER)


def test_snapshot_leaves_the_stream_of_scenarios_alone_and_keeps_what_is_on_its_way_to_the_controllers():
    env, twin = (GFMWTGEnv(**DELAYED, control_dt=0.1, duration_s=4.0, suite="faults") for _ in range(2))
    for each in (env, twin):
        steps_of(each, BEFORE, seed=3)
    start = env.snapshot()
    expected = steps_of(env, AFTER[:27])
    env.reset()
    env.restore(start)
    assert steps_of(env, AFTER[:27]) == expected == steps_of(twin, AFTER[:27])
    twin.reset()
    assert env.reset()[1]["scenario_seed"] == twin.reset()[1]["scenario_seed"]


def test_batch_snapshot_keeps_envs_that_wait_for_their_reset():
    env = GFMWTGVectorEnv(3, duration_s=4.0, version="v0")
    start = {"scenarios": [eventful(duration_s=1.0), calm(), calm()]}
    vector_steps(env, BEFORE[:10, :3, :4], seed=3, start=start)
    snapshot = env.snapshot()
    for _ in range(2):
        _, rewards, *_, infos = env.step(np.ones((3, 4)))
        assert rewards[0] == 0.0 and infos["time_s"].tolist() == pytest.approx([0.0, 1.1, 1.1])
        env.restore(snapshot)
