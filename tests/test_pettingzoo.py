"""Facts about the environment for many agents."""

import functools
import itertools
import warnings

import numpy as np
import pytest

pytest.importorskip("pettingzoo")

from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
from pettingzoo.utils import parallel_to_aec

from tests.envs.rollouts import VERSIONS, actions_of, calm, eventful, sagging
from wtg_gym import GFMWTGEnv, GroupTrip, Scenario
from wtg_gym.pettingzoo import parallel_env

#: The first group stalls and is disconnected, the second goes on.
HALF = {
    "scenario": Scenario(name="half", wind_speed=np.array([[8.0], [12.0]]), duration_s=60.0, events=sagging().events),
    **{"version": "v0", "strategy": ["mppt", "coordinated-piecewise"], "on_failure": "trip"},
}
#: Wind, load events and what takes groups away, by their version.
CASES = {
    "v0": {"version": "v0", "suite": "gust"},
    "v0, one action": {"version": "v0", "action_mode": "tau", "duration_s": 20.0},
    "v0, a rotor stalls": HALF,
    "v1": {"version": "v1", "strategy": "coordinated-tuned"},
    "v1, faults": {"version": "v1", "suite": "faults", "on_failure": "trip", "strategy": "mppt"},
    "v1, a group trips": {"version": "v1", "scenario": eventful(n_wtg=4)},
}
ZERO = np.zeros(2)
BAD_ACTIONS = [
    ({"wtg0": ZERO}, "actions are missing of wtg1; needed: wtg0, wtg1"),
    ({"wtg0": ZERO, "wtg1": ZERO, "wtg2": ZERO}, r"unknown agents \['wtg2'\]; known agents: wtg0"),
    ({"wtg0": ZERO, "wtg1": np.zeros(4)}, r"wtg1: the action must be .* shape \(2,\), got shape \(4,\)"),
    ({"wtg0": ZERO, "wtg1": "up"}, "wtg1: the action must be real numbers"),
    ({"wtg0": ZERO, "wtg1": [0.0, np.nan]}, r"wtg1: the action \[0.0, nan\] is not finite"),
    (np.zeros(4), "actions must be a dictionary by agent, got ndarray"),
]


@pytest.mark.parametrize("name", CASES)
def test_joint_run_is_that_of_the_single_environment_bit_for_bit(name):
    env = parallel_env(**CASES[name])
    local, privileged = (GFMWTGEnv(observation_mode=mode, **CASES[name]) for mode in ("local", "privileged"))
    observations, infos = env.reset(seed=3)
    expected, info = local.reset(seed=3)
    seen, _ = privileged.reset(seed=3)
    n_local = expected.size // len(env.possible_agents)
    for (joint,) in actions_of(4, 1800, n_action=local.action_space.shape[0]):
        for agent in env.agents:
            block = env.possible_agents.index(agent) * n_local
            assert observations[agent].tobytes() == expected[block : block + n_local].tobytes()
            assert env.observation_space(agent).contains(observations[agent])
            assert infos[agent] == info and infos[agent] is not info
        assert env.state().tobytes() == seen.tobytes() and env.state_space.contains(env.state())
        parts = dict(zip(env.possible_agents, joint.reshape(len(env.possible_agents), -1), strict=True))
        actions = {agent: parts[agent] for agent in env.agents}
        # A group that has left has no effect.
        for agent in parts.keys() - actions.keys():
            parts[agent][:] = 0.0
        observations, rewards, terminations, truncations, infos = env.step(actions)
        expected, value, terminated, truncated, info = local.step(joint)
        seen, *_ = privileged.step(joint)
        assert set(observations) == set(rewards) == set(terminations) == set(truncations) == set(infos) == set(actions)
        assert set(rewards.values()) == {value}
        if terminated or truncated:
            assert not env.agents
            assert all(terminations[a] or truncations[a] for a in actions)
        if not env.agents:
            break
    assert not env.agents


def test_agents_leave_one_by_one_as_events_take_their_groups_away_and_come_back_with_the_next_episode():
    events = tuple(GroupTrip(time_s=0.5 + 0.3 * group, group=group) for group in (2, 0))
    env = parallel_env(version="v1", control_dt=0.1, scenario=calm(n_wtg=4, events=events))
    for _ in range(2):
        env.reset()
        there = []
        while env.agents:
            there.append(list(env.agents))
            env.step({agent: np.ones(2) for agent in env.agents})
        # An event at 0.5 s is seen after the step that begins then.
        changes = [agents for agents, _ in itertools.groupby(there)]
        assert changes == [["wtg0", "wtg1", "wtg2", "wtg3"], ["wtg1", "wtg2", "wtg3"], ["wtg1", "wtg3"]]
        assert len(there) == 40


@pytest.mark.parametrize("version", VERSIONS)
def test_official_tests_of_pettingzoo_pass(version):
    make = functools.partial(parallel_env, version=version, duration_s=10.0, on_failure="trip", strategy="mppt")
    with warnings.catch_warnings():
        # Every other warning of theirs is a failure here.
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*unknown reset options \\['options'\\] are ignored")
        warnings.filterwarnings("ignore", message=".*agents to be named in the format")
        parallel_api_test(make(), num_cycles=300)
        parallel_seed_test(make, num_cycles=150)
        api_test(parallel_to_aec(make()), num_cycles=150)


def test_bad_arguments_and_calls_are_named_and_change_nothing():
    for argument, text in (("observation_mode", "cannot be chosen"), ("wind", "known settings")):
        with pytest.raises(TypeError, match=f"{argument}.* {text}"):
            parallel_env(**{argument: "local"})
    env = parallel_env(version="v0")
    for call in (env.state, lambda: env.step({})):
        with pytest.raises(RuntimeError, match=r"call reset\(\)"):
            call()
    env.reset(seed=1)
    before = env.state()
    for actions, text in BAD_ACTIONS:
        with pytest.raises(ValueError, match=text):
            env.step(actions)
        assert env.state().tobytes() == before.tobytes() and env.agents == ["wtg0", "wtg1"]
    with pytest.raises(KeyError, match="unknown agent 'wtg9'; choose one of wtg0, wtg1"):
        env.action_space("wtg9")
