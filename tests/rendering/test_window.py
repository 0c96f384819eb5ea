"""Facts about the window of `render_mode="human"`, on SDL's dummy display."""

from __future__ import annotations

import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from wtg_gym.envs import GFMWTGEnv
from wtg_gym.envs.rendering import LaneFrames

pygame = pytest.importorskip("pygame")


@pytest.fixture(autouse=True)
def dummy_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


def on_screen() -> np.ndarray:
    return pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)


def test_reset_and_step_show_the_frame_by_themselves():
    env, twin = (
        GFMWTGEnv(duration_s=2.0, render_mode="human", version="v0"),
        GFMWTGEnv(duration_s=2.0, render_mode="rgb_array", version="v0"),
    )
    assert pygame.display.get_surface() is None
    env.reset(seed=3), twin.reset(seed=3)
    assert np.array_equal(on_screen(), twin.render())
    env.step(np.ones(4)), twin.step(np.ones(4))
    assert np.array_equal(on_screen(), twin.render())
    assert env.render() is None
    env.close()
    assert pygame.display.get_surface() is None


def test_an_episode_goes_on_after_its_window_was_closed():
    env = gym.make("GFMWTG-14bus-v0", duration_s=1.0, render_mode="human")
    env.reset(seed=0)
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(10):
        *_, truncated, _ = env.step(np.zeros(4, dtype=np.float32))
    assert truncated and pygame.display.get_surface() is None
    env.reset()
    env.close()
    env.close()


def test_nothing_is_painted_for_a_window_that_was_closed(monkeypatch: pytest.MonkeyPatch):
    env = GFMWTGEnv(duration_s=1.0, render_mode="human", version="v0")
    env.reset(seed=0)
    painted = []
    paint = LaneFrames.paint
    monkeypatch.setattr(LaneFrames, "paint", lambda frames: painted.append(frames) or paint(frames))
    env.step(np.zeros(4))
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    for _ in range(5):
        env.step(np.zeros(4))
    # The last one, in which the window hears that it is closed, too.
    assert len(painted) == 2
    env.close()


@pytest.mark.parametrize(("module", "mode"), [("pygame", "human"), ("matplotlib", "rgb_array")])
def test_a_missing_library_is_named_with_what_to_install(monkeypatch: pytest.MonkeyPatch, module: str, mode: str):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DependencyNotInstalled, match=rf"{module}.*\[render\]"):
        GFMWTGEnv(duration_s=2.0, render_mode=mode, version="v0")


def test_a_missing_display_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "x11")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RuntimeError, match=r"display.*rgb_array"):
        GFMWTGEnv(duration_s=2.0, render_mode="human", version="v0").reset()
