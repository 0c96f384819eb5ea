"""Facts about frames: their form, that they follow the episode, and that nothing depends on them."""

from __future__ import annotations

import copy
import pickle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

from tests.envs.rollouts import actions_of, calm, eventful, sagging, single_steps, vector_steps
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.envs.rendering.colours import EVENT, INK
from wtg_gym.envs.rendering.diagram import draw_diagram
from wtg_gym.envs.rendering.frame import FRAME_SIZE
from wtg_gym.envs.rendering.panels import panels_of
from wtg_gym.physics.scenario import GovernorLoss, GroupTrip, MachineOutage

pytest.importorskip("matplotlib")

ENV_ID = "GFMWTG-14bus-v0"
SHAPE = (FRAME_SIZE[1], FRAME_SIZE[0], 3)


def playing(n_steps: int, **settings: Any) -> GFMWTGEnv:
    """Return an environment that renders, so many steps into the eventful scenario."""
    env = GFMWTGEnv(**{"version": "v0", "render_mode": "rgb_array", "scenario": eventful().to_dict(), **settings})
    env.reset(seed=0)
    for action in actions_of(3, n_steps, 1, env.action_space.shape[0]):
        env.step(action[0])
    return env


# --- form ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", ["v0", "v1"])
def test_every_step_gives_a_new_frame_of_the_same_size(version: str):
    env = GFMWTGEnv(version=version, render_mode="rgb_array", duration_s=6.0)
    env.reset(seed=4)
    frames = [env.render()]
    for _ in range(3):
        env.step(np.full(env.action_space.shape, 0.5))
        frames.append(env.render())
    assert {(frame.shape, frame.dtype) for frame in frames} == {(SHAPE, np.dtype(np.uint8))}
    assert len({frame.tobytes() for frame in frames}) == 4
    assert not np.shares_memory(frames[0], frames[1])
    assert env.render().tobytes() == frames[-1].tobytes()


@pytest.mark.parametrize("groups", [1, 3])
def test_plants_of_other_sizes_are_drawn(groups: int):
    env = GFMWTGEnv(version="v0", render_mode="rgb_array", groups=groups, duration_s=5.0)
    env.reset(seed=1)
    assert env.render().shape == SHAPE


def test_a_stall_and_the_papers_long_case_are_drawn_to_their_end():
    stalling = GFMWTGEnv(version="v0", render_mode="rgb_array", strategy="mppt", scenario=sagging(7.0).to_dict())
    stalling.reset()
    over = False
    while not over:
        *_, over, _, _ = stalling.step(np.zeros(4))
    assert stalling.render().shape == SHAPE
    env = GFMWTGEnv(render_mode="rgb_array", suite="paper", split="test")
    env.reset(seed=0)
    for _ in range(1199):
        env.step(np.zeros(4))
    before = env.render()
    assert env.step(np.zeros(4))[3]
    assert env.render().tobytes() != before.tobytes()


@pytest.mark.parametrize("control_dt", [0.1, 0.2])
def test_frames_come_in_real_time(control_dt: float):
    env = GFMWTGEnv(version="v0", control_dt=control_dt, simulation_dt=0.025, duration_s=2.0)
    assert env.metadata["render_fps"] == round(1.0 / control_dt) and GFMWTGEnv.metadata["render_fps"] == 10


@pytest.mark.filterwarnings("error", "ignore:.*is out of date:DeprecationWarning")
def test_both_checkers_have_no_complaint_about_rendering(monkeypatch: pytest.MonkeyPatch):
    from stable_baselines3.common.env_checker import check_env as check_sb3

    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    # The checker makes it with every render mode, so with a window too.
    env = gym.make(ENV_ID, duration_s=2.0, render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=False)
    check_sb3(GFMWTGEnv(version="v0", duration_s=2.0, render_mode="rgb_array"), warn=True)


# --- what is refused -------------------------------------------------------------------------------------------------


def test_unknown_modes_are_refused_and_a_batch_has_no_window():
    for kind in (GFMWTGEnv, lambda **settings: GFMWTGVectorEnv(2, **settings)):
        with pytest.raises(ValueError, match="unknown render_mode 'ansi'"):
            kind(render_mode="ansi")
    with pytest.raises(ValueError, match="unknown render_mode 'human'"):
        GFMWTGVectorEnv(2, version="v0", render_mode="human")


def test_render_without_a_mode_warns_and_gives_nothing():
    for env in (playing(1, render_mode=None), GFMWTGVectorEnv(2, version="v0", duration_s=2.0)):
        env.reset()
        with pytest.warns(UserWarning, match="render_mode"):
            assert env.render() is None
    assert GFMWTGEnv(version="v0", duration_s=2.0).snapshot()[-1] is None


def test_render_before_reset_says_so():
    batch = GFMWTGVectorEnv(2, version="v0", duration_s=2.0, render_mode="rgb_array")
    for env in (GFMWTGEnv(version="v0", render_mode="rgb_array"), batch):
        with pytest.raises(RuntimeError, match="reset"):
            env.render()
    batch.reset(seed=0, options={"reset_mask": np.arange(2) == 1})
    with pytest.raises(RuntimeError, match="reset"):
        batch.render()
    batch.reset(seed=0, options={"reset_mask": np.arange(2) == 0})
    assert len(batch.render()) == 2


# --- nothing depends on them, and they follow the episode ------------------------------------------------------------


def test_a_trajectory_is_the_same_with_and_without_rendering():
    actions = actions_of(5, 40)[:, 0]
    plain = single_steps(GFMWTGEnv(version="v0", duration_s=3.0), actions, AutoresetMode.NEXT_STEP, seed=2)

    class Watched(GFMWTGEnv):
        def step(self, action: Any) -> Any:
            self.render()
            return super().step(action)

    env = Watched(version="v0", duration_s=3.0, render_mode="rgb_array")
    assert single_steps(env, actions, AutoresetMode.NEXT_STEP, seed=2) == plain
    batch = GFMWTGVectorEnv(3, version="v0", duration_s=3.0, render_mode="rgb_array")
    assert vector_steps(batch, np.stack([actions] * 3, axis=1), seed=2)[0] == plain


def test_a_restored_episode_shows_what_led_to_it():
    env = playing(20)
    at_20, kept = env.render(), env.snapshot()
    for _ in range(15):
        env.step(np.ones(4))
    at_35, later = env.render(), env.snapshot()
    env.restore(kept)
    assert env.render().tobytes() == at_20.tobytes()
    env.step(-np.ones(4))
    env.reset(options={"scenario": calm()})
    env.restore(later)
    assert env.render().tobytes() == at_35.tobytes()


def test_snapshots_pass_between_environments_that_render_and_those_that_do_not():
    blind, env = playing(20, render_mode=None), playing(0)
    env.restore(blind.snapshot())
    assert env.render().shape == SHAPE
    blind.restore(env.snapshot())


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"])
def test_a_copy_draws_on_as_its_original(copied: Any):
    env = playing(15)
    env.render()
    twin = copied(env)
    for each in (env, twin):
        for _ in range(5):
            each.step(np.full(4, 0.3))
    assert env.render().tobytes() == twin.render().tobytes()


@pytest.mark.parametrize("version", ["v0", "v1"])
def test_a_batch_gives_the_frames_of_single_environments(version: str):
    batch = GFMWTGVectorEnv(2, version=version, duration_s=1.0, render_mode="rgb_array")
    singles = [GFMWTGEnv(version=version, duration_s=1.0, render_mode="rgb_array") for _ in range(2)]
    n_action = batch.single_action_space.shape[0]
    batch.reset(seed=5)
    for lane, env in enumerate(singles):
        env.reset(seed=5 + lane)
    for step, actions in enumerate(np.clip(actions_of(1, 14, 2, n_action), -1, 1).astype(np.float32)):
        batch.step(actions)
        for lane, env in enumerate(singles):
            env.reset() if step == 10 else env.step(actions[lane])
        if step in (4, 9, 10, 13):
            assert [frame.tobytes() for frame in batch.render()] == [env.render().tobytes() for env in singles], step


# --- what they show --------------------------------------------------------------------------------------------------


def test_limits_of_the_plant_are_drawn_in_v1_alone():
    plant = GFMWTGEnv(version="v1", duration_s=2.0).settings.plant()
    panels = {panel.name: panel for panel in panels_of(plant, limited=True)}
    assert panels["frequency"].limits == pytest.approx((48.5, 51.5))
    assert panels["rotor"].limits == (0.5, 1.4) and panels["power"].limits == (1.1,)
    assert panels["power"].rules == (1.05,)
    for version, drawn in (("v0", False), ("v1", True)):
        frames = GFMWTGEnv(version=version, duration_s=2.0, render_mode="rgb_array")._frames
        assert frames is not None and any(panel.limits for panel in frames._panels) == drawn


def test_units_of_a_bus_stand_apart_and_what_is_out_is_marked():
    from matplotlib.figure import Figure

    lost = GroupTrip(time_s=1.0, group=2), MachineOutage(time_s=1.0, bus=6), GovernorLoss(time_s=1.0, bus=1)
    drawn = [Figure().add_axes((0, 0, 1, 1)) for _ in range(2)]
    for axes, events in zip(drawn, ((), lost), strict=True):
        draw_diagram(axes, (2, 3, 6, 8), events)
        units = [(text.get_text(), text.get_position()) for text in axes.texts if text.get_text()[0] in "GCW"]
        assert sorted(name for name, _ in units) == ["C", "C", "C", "G", "W1", "W2", "W3", "W4"]
        places = np.array([place for _, place in units])
        apart = np.hypot(*(places[:, None] - places[None]).T)[~np.eye(len(units), dtype=bool)]
        # A unit's circle has a radius of 0.3.
        assert apart.min() > 0.6
    assert [sum(line.get_linestyle() == "--" for line in axes.lines) for axes in drawn] == [0, 2]
    assert [next(t.get_color() for t in axes.texts if t.get_text() == "G") for axes in drawn] == [INK, EVENT]


# --- videos ----------------------------------------------------------------------------------------------------------


def video_frames(path: Path) -> tuple[int, tuple[int, int]]:
    """Return the number of frames of a video and their size."""
    import imageio_ffmpeg

    reader = imageio_ffmpeg.read_frames(str(path))
    size = next(reader)["size"]
    return sum(1 for _ in reader), size


def test_record_video_writes_every_frame_of_an_episode(tmp_path: Path):
    pytest.importorskip("moviepy")
    env = gym.make(ENV_ID, duration_s=2.0, render_mode="rgb_array")
    env = gym.wrappers.RecordVideo(env, str(tmp_path), disable_logger=True)
    env.reset(seed=0)
    for _ in range(20):
        env.step(env.action_space.sample())
    env.close()
    (path,) = tmp_path.glob("*.mp4")
    assert video_frames(path) == (21, FRAME_SIZE)


def test_video_recorder_of_stable_baselines3_writes_the_batch(tmp_path: Path):
    pytest.importorskip("moviepy")
    from stable_baselines3.common.vec_env import VecVideoRecorder

    from wtg_gym.sb3 import SB3VecEnv

    envs = SB3VecEnv(2, version="v0", duration_s=1.0, render_mode="rgb_array")
    envs = VecVideoRecorder(envs, str(tmp_path), record_video_trigger=lambda step: step == 0, video_length=5)
    envs.reset()
    for _ in range(6):
        envs.step(np.zeros((2, 4), dtype=np.float32))
    envs.close()
    (path,) = tmp_path.glob("*.mp4")
    # The start and five steps, in real time.
    assert envs.frames_per_sec == 10
    assert video_frames(path)[0] == 6
