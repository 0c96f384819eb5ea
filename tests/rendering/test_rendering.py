"""Facts about frames: their form, what they show, and that nothing depends on them."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import wtg_gym
from tests.envs.rollouts import actions_of, calm, eventful, sagging, single_steps, vector_steps
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.envs.rendering.colours import EVENT, GROUPS, rgb
from wtg_gym.envs.rendering.frame import FRAME_SIZE, panel_box
from wtg_gym.envs.rendering.panels import PANELS
from wtg_gym.physics.scenario import LineTrip

pytest.importorskip("matplotlib")

ENV_ID = wtg_gym.ENV_ID
SHAPE = (FRAME_SIZE[1], FRAME_SIZE[0], 3)


def playing(n_steps: int, **settings: Any) -> GFMWTGEnv:
    """Return an environment that renders, so many steps into the eventful scenario."""
    env = GFMWTGEnv(**{"render_mode": "rgb_array", "scenario": eventful().to_dict(), **settings})
    env.reset(seed=0)
    for action in actions_of(3, n_steps, 1, env.action_space.shape[0]):
        env.step(action[0])
    return env


def panel(frame: np.ndarray, name: str) -> np.ndarray:
    """Return the inside of one panel of a frame."""
    left, top, right, bottom = panel_box([panel.name for panel in PANELS].index(name))
    return frame[top:bottom, left:right]


def coloured(picture: np.ndarray, colour: str) -> np.ndarray:
    """Return which pixels have a colour, but for the smoothing of a line that lies between two rows."""
    return np.abs(picture.astype(int) - rgb(colour)).max(axis=-1) < 45


def has_colour(picture: np.ndarray, colour: str) -> bool:
    return bool(coloured(picture, colour).any())


def test_every_frame_is_a_new_picture_of_the_same_size():
    env = playing(0)
    frames = [env.render()]
    for _ in range(5):
        env.step(np.full(4, 0.5))
        frames.append(env.render())
    assert {(frame.shape, frame.dtype) for frame in frames} == {(SHAPE, np.dtype(np.uint8))}
    assert len({frame.tobytes() for frame in frames}) == 6
    assert not np.shares_memory(frames[0], frames[1])


def test_a_frame_drawn_again_is_the_same():
    env = playing(7)
    assert env.render().tobytes() == env.render().tobytes()


def test_axes_and_heading_stay_while_lines_grow():
    env = playing(0)
    first = env.render()
    env.step(np.zeros(4))
    second = env.render()
    changed = (first != second).any(axis=-1)
    inside = np.zeros_like(changed)
    for index in range(len(PANELS)):
        left, top, right, bottom = panel_box(index)
        # The dot at a line's end reaches beyond the axis at the start.
        inside[top - 4 : bottom + 4, left - 4 : right + 4] = True
    inside[56:126, 16:328] = True
    assert changed.any() and not (changed & ~inside).any()


def test_lines_reach_as_far_as_the_episode():
    env = playing(20)  # half of it
    wind = panel(env.render(), "wind")
    drawn = np.flatnonzero(coloured(wind, GROUPS[0]).any(axis=0))
    assert drawn[0] <= 1 and abs(drawn[-1] - wind.shape[1] / 2) <= 4


def test_events_are_shown_once_they_have_struck():
    diagram = slice(134, 374), slice(8, 328)
    assert not has_colour(playing(5).render(), EVENT)
    struck = playing(6).render()
    assert has_colour(struck[diagram], EVENT) and has_colour(panel(struck, "frequency"), EVENT)
    # Two lines' worth of pixels more: the third event opens a line.
    n_pixels = [int(coloured(playing(n).render()[diagram], EVENT).sum()) for n in (12, 13)]
    assert n_pixels[1] > n_pixels[0] + 20


def test_a_line_that_closes_again_is_drawn_as_before():
    line = LineTrip(time_s=0.5, from_bus=5, to_bus=4, recloses_after_s=0.45)
    stays = dataclasses.replace(line, recloses_after_s=None)
    frames = {
        event: [playing(n, scenario=calm(events=(event,)).to_dict()).render()[134:374, 8:328] for n in (9, 10)]
        for event in (line, stays)
    }
    open_and_closed = [int(coloured(frame, EVENT).sum()) for frame in frames[line]]
    assert open_and_closed[1] < open_and_closed[0] - 20
    assert (frames[stays][0] == frames[stays][1]).all()


def test_an_axis_widens_when_a_value_leaves_it():
    narrow = GFMWTGEnv(render_mode="rgb_array", scenario=calm(9.0).to_dict())
    wide = GFMWTGEnv(render_mode="rgb_array", scenario=calm(20.0).to_dict())
    pictures = []
    for env in (narrow, wide):
        env.reset()
        left, top, _, bottom = panel_box([panel.name for panel in PANELS].index("wind"))
        pictures.append(env.render()[top - 5 : bottom + 5, left - 35 : left - 5])
    assert pictures[0].tobytes() != pictures[1].tobytes()


def test_an_early_stall_and_the_end_of_the_time_are_named():
    stalling = GFMWTGEnv(render_mode="rgb_array", strategy="mppt", scenario=sagging(7.0).to_dict())
    stalling.reset()
    over = False
    while not over:
        before = stalling.render()
        *_, terminated, truncated, info = stalling.step(np.zeros(4))
        over = terminated or truncated
    assert terminated and info["termination_reason"] == "stall" and info["time_s"] < 60.0
    words = slice(60, 82), slice(112, 328)
    assert not has_colour(before[words], EVENT) and has_colour(stalling.render()[words], EVENT)
    env = playing(39)
    before = env.render()
    assert env.step(np.zeros(4))[3]
    after = env.render()
    assert before[words].tobytes() != after[words].tobytes() and not has_colour(after[words], EVENT)


@pytest.mark.parametrize(("groups", "n_colours"), [(1, 1), (3, 3)])
def test_every_group_has_a_line_and_a_sign_in_the_diagram(groups: int, n_colours: int):
    env = GFMWTGEnv(render_mode="rgb_array", groups=groups, duration_s=5.0)
    env.reset(seed=1)
    for _ in range(30):
        env.step(np.zeros(2 * groups))
    frame = env.render()
    shown = [has_colour(panel(frame, "wind"), colour) for colour in GROUPS]
    assert shown == [True] * n_colours + [False] * (4 - n_colours)
    assert all(has_colour(frame[134:374, :328], colour) for colour in GROUPS[:n_colours])


def test_a_law_without_damping_leaves_its_panel_empty():
    env = GFMWTGEnv(render_mode="rgb_array", strategy="mppt", scenario=calm().to_dict())
    env.reset()
    env.step(np.zeros(4))
    assert not has_colour(panel(env.render(), "tau"), GROUPS[1])


def test_the_papers_long_case_is_drawn_to_its_end():
    env = GFMWTGEnv(render_mode="rgb_array", suite="paper", split="test")
    env.reset(seed=0)
    for _ in range(1199):
        assert env.step(np.zeros(4))[2:4] == (False, False)
    before = env.render()
    assert env.step(np.zeros(4))[3]
    frame = env.render()
    assert has_colour(panel(frame, "rotor")[:, -3:], GROUPS[0]) and frame.tobytes() != before.tobytes()


def test_a_trajectory_is_the_same_with_and_without_rendering():
    actions = actions_of(5, 100)[:, 0]
    plain = single_steps(GFMWTGEnv(duration_s=3.0), actions, AutoresetMode.NEXT_STEP, seed=2)

    class Watched(GFMWTGEnv):
        def step(self, action: Any) -> Any:
            self.render()
            return super().step(action)

    env = Watched(duration_s=3.0, render_mode="rgb_array")
    assert single_steps(env, actions, AutoresetMode.NEXT_STEP, seed=2) == plain
    batch = GFMWTGVectorEnv(3, duration_s=3.0, render_mode="rgb_array")
    assert vector_steps(batch, np.stack([actions] * 3, axis=1), seed=2)[0] == plain


def test_a_restored_episode_shows_what_led_to_it():
    env = playing(20)
    at_20, kept = env.render(), env.snapshot()
    for _ in range(15):
        env.step(np.ones(4))
    at_35, later = env.render(), env.snapshot()
    env.restore(kept)
    assert env.render().tobytes() == at_20.tobytes()
    for _ in range(5):
        env.step(-np.ones(4))
    env.reset(options={"scenario": calm()})
    env.restore(later)
    assert env.render().tobytes() == at_35.tobytes()
    assert playing(20).render().tobytes() == at_20.tobytes()


def test_a_snapshot_of_an_environment_that_does_not_render_is_drawn_from_there_on():
    blind = playing(20, render_mode=None)
    env = playing(0)
    env.restore(blind.snapshot())
    wind = panel(env.render(), "wind")
    assert np.flatnonzero(coloured(wind, GROUPS[0]).any(axis=0))[0] > wind.shape[1] // 2 - 6
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


def test_nothing_is_kept_for_frames_without_a_render_mode():
    assert GFMWTGEnv(duration_s=2.0).snapshot()[-1] is None


def test_render_without_a_mode_warns_and_gives_nothing():
    for env in (playing(1, render_mode=None), GFMWTGVectorEnv(2, duration_s=2.0)):
        env.reset()
        with pytest.warns(UserWarning, match="render_mode"):
            assert env.render() is None


def test_render_before_reset_says_so():
    for env in (GFMWTGEnv(render_mode="rgb_array"), GFMWTGVectorEnv(2, render_mode="rgb_array")):
        with pytest.raises(RuntimeError, match="reset"):
            env.render()


@pytest.mark.filterwarnings("error")
def test_lanes_may_be_started_one_after_the_other():
    batch = GFMWTGVectorEnv(2, duration_s=2.0, render_mode="rgb_array")
    for lane in (1, 0):
        with pytest.raises(RuntimeError, match="reset"):
            batch.render()
        batch.reset(seed=0, options={"reset_mask": np.arange(2) == lane})
    assert len(batch.render()) == 2


@pytest.mark.parametrize("control_dt", [0.1, 0.2])
def test_frames_come_in_real_time(control_dt: float):
    env = GFMWTGEnv(control_dt=control_dt, simulation_dt=0.025, duration_s=2.0)
    assert env.metadata["render_fps"] == round(1.0 / control_dt) and GFMWTGEnv.metadata["render_fps"] == 10


@pytest.mark.filterwarnings("error", "ignore:.*is out of date:DeprecationWarning")
def test_both_checkers_have_no_complaint_about_rendering(monkeypatch: pytest.MonkeyPatch):
    from stable_baselines3.common.env_checker import check_env as check_sb3

    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    # The checker makes it with every render mode, so with a window too.
    env = gym.make(ENV_ID, duration_s=2.0, render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=False)
    check_sb3(GFMWTGEnv(duration_s=2.0, render_mode="rgb_array"), warn=True)


def test_a_batch_gives_the_frames_of_single_environments():
    batch = gym.make_vec(ENV_ID, num_envs=3, duration_s=2.0, render_mode="rgb_array")
    singles = [GFMWTGEnv(duration_s=2.0, render_mode="rgb_array") for _ in range(3)]
    batch.reset(seed=5)
    for lane, env in enumerate(singles):
        env.reset(seed=5 + lane)
    for step, actions in enumerate(np.clip(actions_of(1, 25, 3), -1, 1).astype(np.float32)):
        batch.step(actions)
        for lane, env in enumerate(singles):
            env.reset() if step == 20 else env.step(actions[lane])
        if step in (4, 19, 20, 24):
            assert [frame.tobytes() for frame in batch.render()] == [env.render().tobytes() for env in singles], step


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


def test_record_video_of_a_batch_puts_its_lanes_side_by_side(tmp_path: Path):
    pytest.importorskip("moviepy")
    envs = gym.make_vec(ENV_ID, num_envs=2, duration_s=1.0, render_mode="rgb_array")
    envs = gym.wrappers.vector.RecordVideo(envs, str(tmp_path), video_aspect_ratio=(1, 1))
    envs.reset(seed=0)
    for _ in range(11):
        envs.step(envs.action_space.sample())
    envs.close()
    (path, *_) = sorted(tmp_path.glob("*.mp4"))
    n_frames, size = video_frames(path)
    assert n_frames >= 10 and size == (2 * FRAME_SIZE[0], FRAME_SIZE[1])


def test_video_recorder_of_stable_baselines3_writes_the_batch(tmp_path: Path):
    pytest.importorskip("moviepy")
    from stable_baselines3.common.vec_env import VecVideoRecorder

    from wtg_gym.sb3 import SB3VecEnv

    envs = SB3VecEnv(2, duration_s=1.0, render_mode="rgb_array")
    envs = VecVideoRecorder(envs, str(tmp_path), record_video_trigger=lambda step: step == 0, video_length=5)
    envs.reset()
    for _ in range(6):
        envs.step(np.zeros((2, 4), dtype=np.float32))
    envs.close()
    (path,) = tmp_path.glob("*.mp4")
    # The start and five steps, in real time.
    assert envs.frames_per_sec == 10
    assert video_frames(path)[0] == 6


def test_render_collection_gives_all_frames_since_the_last_call():
    env = gym.make(ENV_ID, duration_s=2.0, render_mode="rgb_array_list")
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(4, dtype=np.float32))
    assert [frame.shape for frame in env.render()] == [SHAPE] * 4


def test_frames_of_the_versions_name_their_environment():
    frames = []
    for version in ("v0", "v1"):
        env = GFMWTGEnv(version=version, duration_s=2.0, render_mode="rgb_array")
        env.reset(seed=1)
        frames.append(env.render())
        assert env._frames is not None and env._frames._episode(0).env_id == f"GFMWTG-14bus-{version}"
    heading = np.s_[10:34, 16:320]
    assert (frames[0][heading] != frames[1][heading]).any()
