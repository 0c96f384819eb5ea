"""Facts about frames and the window: their form, that they follow the episode, and that nothing depends on them."""

import copy
import sys

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import actions_of, calm, eventful, single_steps, started
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.envs.rendering import FRAME_SIZE

SHAPE = (FRAME_SIZE[1], FRAME_SIZE[0], 3)

pytest.importorskip("matplotlib")


@pytest.fixture(autouse=True)
def dummy_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def playing(n_steps: int, **settings) -> GFMWTGEnv:
    """Return an environment that renders, so many steps into the eventful scenario."""
    env = GFMWTGEnv(**{"version": "v0", "render_mode": "rgb_array", "scenario": eventful().to_dict(), **settings})
    env.reset(seed=0)
    for action in actions_of(3, n_steps, 1, env.action_space.shape[0]):
        env.step(action[0])
    return env


@pytest.mark.parametrize("settings", [{"version": "v0", "groups": 3}, {"version": "v1"}], ids=str)
def test_every_step_gives_a_new_frame_of_the_same_size(settings):
    env = started(GFMWTGEnv(render_mode="rgb_array", duration_s=6.0, **settings), seed=4)
    frames = [env.render()]
    for _ in range(2):
        env.step(np.full(env.action_space.shape, 0.5))
        frames.append(env.render())
    assert {(frame.shape, frame.dtype) for frame in frames} == {(SHAPE, np.dtype(np.uint8))}
    assert len({frame.tobytes() for frame in frames}) == 3
    assert env.render().tobytes() == frames[-1].tobytes()


def test_render_needs_a_mode_and_a_reset():
    with pytest.warns(UserWarning, match="render_mode"):
        assert playing(1, render_mode=None).render() is None
    batch = GFMWTGVectorEnv(2, version="v0", duration_s=2.0, render_mode="rgb_array")
    batch.reset(seed=0, options={"reset_mask": np.arange(2) == 1})
    for env in (GFMWTGEnv(version="v0", render_mode="rgb_array"), batch):
        with pytest.raises(RuntimeError, match="reset"):
            env.render()
    batch.reset(seed=0, options={"reset_mask": np.arange(2) == 0})
    assert len(batch.render()) == 2


def test_a_trajectory_is_the_same_with_and_without_rendering():
    actions = actions_of(5, 40)[:, 0]
    plain = single_steps(GFMWTGEnv(version="v0", duration_s=3.0), actions, AutoresetMode.NEXT_STEP, seed=2)

    class Watched(GFMWTGEnv):
        def step(self, action):
            self.render()
            return super().step(action)

    env = Watched(version="v0", duration_s=3.0, render_mode="rgb_array")
    assert single_steps(env, actions, AutoresetMode.NEXT_STEP, seed=2) == plain


def test_a_restored_or_copied_episode_shows_what_led_to_it():
    env = playing(20)
    at_20, kept = env.render(), env.snapshot()
    assert copy.deepcopy(env).render().tobytes() == at_20.tobytes()
    for _ in range(5):
        env.step(np.ones(4))
    env.reset(options={"scenario": calm()})
    env.restore(kept)
    assert env.render().tobytes() == at_20.tobytes()
    # From an environment that does not render, and into one.
    blind = playing(20, render_mode=None)
    env.restore(blind.snapshot())
    assert env.render().shape == SHAPE
    blind.restore(kept)


def test_a_batch_gives_the_frames_of_single_environments():
    batch = started(GFMWTGVectorEnv(2, duration_s=5.0, render_mode="rgb_array"), seed=5)
    singles = [started(GFMWTGEnv(duration_s=5.0, render_mode="rgb_array"), seed=seed) for seed in (5, 6)]
    for step, actions in enumerate(actions_of(1, 14, 2, 8)):
        batch.step(actions)
        for env_index, env in enumerate(singles):
            env.reset() if step == 10 else env.step(actions[env_index])
        if step in (4, 10, 13):
            assert [frame.tobytes() for frame in batch.render()] == [env.render().tobytes() for env in singles], step


def test_the_window_shows_each_frame_by_itself_and_an_episode_goes_on_after_it_was_closed():
    pygame = pytest.importorskip("pygame")

    def on_screen():
        return pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)

    modes = ("human", "rgb_array")
    env, twin = (started(GFMWTGEnv(duration_s=1.0, render_mode=mode, version="v0"), seed=3) for mode in modes)
    assert np.array_equal(on_screen(), twin.render())
    env.step(np.ones(4)), twin.step(np.ones(4))
    assert np.array_equal(on_screen(), twin.render()) and env.render() is None
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(9):
        *_, truncated, _ = env.step(np.zeros(4))
    assert truncated and pygame.display.get_surface() is None
    env.reset()
    env.close(), env.close()


@pytest.mark.parametrize(("module", "mode"), [("pygame", "human"), ("matplotlib", "rgb_array")])
def test_a_missing_library_is_named_with_what_to_install(monkeypatch, module, mode):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DependencyNotInstalled, match=rf"{module}.*\[render\]"):
        GFMWTGEnv(duration_s=2.0, render_mode=mode, version="v0")
