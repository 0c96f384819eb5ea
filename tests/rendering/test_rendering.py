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

from tests.envs.rollouts import actions_of, calm, eventful, sagging, single_steps, vector_steps
from wtg_gym.envs import GFMWTGEnv, GFMWTGVectorEnv
from wtg_gym.envs.rendering.colours import EVENT, GROUPS, INK, LIMIT, rgb
from wtg_gym.envs.rendering.diagram import EXTENT, draw_diagram
from wtg_gym.envs.rendering.frame import FRAME_SIZE, panel_box
from wtg_gym.envs.rendering.panels import MEASURED, PANELS, Episode, n_traces, panels_of_traces
from wtg_gym.physics.scenario import GovernorLoss, GroupTrip, LineTrip, MachineOutage
from wtg_gym.physics.sensors import SENSOR_RANGES

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


def panel(frame: np.ndarray, name: str) -> np.ndarray:
    """Return the inside of one panel of a frame."""
    left, top, right, bottom = panel_box([panel.name for panel in PANELS].index(name))
    return frame[top:bottom, left:right]


def coloured(picture: np.ndarray, colour: str) -> np.ndarray:
    """Return which pixels have a colour, except for the smoothing of a line between two rows."""
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
    narrow = GFMWTGEnv(render_mode="rgb_array", scenario=calm(9.0).to_dict(), version="v0")
    wide = GFMWTGEnv(render_mode="rgb_array", scenario=calm(20.0).to_dict(), version="v0")
    pictures = []
    for env in (narrow, wide):
        env.reset()
        left, top, _, bottom = panel_box([panel.name for panel in PANELS].index("wind"))
        pictures.append(env.render()[top - 5 : bottom + 5, left - 35 : left - 5])
    assert pictures[0].tobytes() != pictures[1].tobytes()


def test_an_early_stall_and_the_end_of_the_time_are_named():
    stalling = GFMWTGEnv(render_mode="rgb_array", strategy="mppt", scenario=sagging(7.0).to_dict(), version="v0")
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
    env = GFMWTGEnv(render_mode="rgb_array", groups=groups, duration_s=5.0, version="v0")
    env.reset(seed=1)
    for _ in range(30):
        env.step(np.zeros(2 * groups))
    frame = env.render()
    shown = [has_colour(panel(frame, "wind"), colour) for colour in GROUPS]
    assert shown == [True] * n_colours + [False] * (4 - n_colours)
    assert all(has_colour(frame[134:374, :328], colour) for colour in GROUPS[:n_colours])


def test_a_law_without_damping_leaves_its_panel_empty():
    env = GFMWTGEnv(render_mode="rgb_array", strategy="mppt", scenario=calm().to_dict(), version="v0")
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
    plain = single_steps(GFMWTGEnv(duration_s=3.0, version="v0"), actions, AutoresetMode.NEXT_STEP, seed=2)

    class Watched(GFMWTGEnv):
        def step(self, action: Any) -> Any:
            self.render()
            return super().step(action)

    env = Watched(duration_s=3.0, render_mode="rgb_array")
    assert single_steps(env, actions, AutoresetMode.NEXT_STEP, seed=2) == plain
    batch = GFMWTGVectorEnv(3, duration_s=3.0, render_mode="rgb_array", version="v0")
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
    assert GFMWTGEnv(duration_s=2.0, version="v0").snapshot()[-1] is None


def test_render_without_a_mode_warns_and_gives_nothing():
    for env in (playing(1, render_mode=None), GFMWTGVectorEnv(2, duration_s=2.0, version="v0")):
        env.reset()
        with pytest.warns(UserWarning, match="render_mode"):
            assert env.render() is None


def test_render_before_reset_says_so():
    for env in (
        GFMWTGEnv(render_mode="rgb_array", version="v0"),
        GFMWTGVectorEnv(2, render_mode="rgb_array", version="v0"),
    ):
        with pytest.raises(RuntimeError, match="reset"):
            env.render()


@pytest.mark.filterwarnings("error")
def test_lanes_may_be_started_one_after_the_other():
    batch = GFMWTGVectorEnv(2, duration_s=2.0, render_mode="rgb_array", version="v0")
    for lane in (1, 0):
        with pytest.raises(RuntimeError, match="reset"):
            batch.render()
        batch.reset(seed=0, options={"reset_mask": np.arange(2) == lane})
    assert len(batch.render()) == 2


@pytest.mark.parametrize("control_dt", [0.1, 0.2])
def test_frames_come_in_real_time(control_dt: float):
    env = GFMWTGEnv(control_dt=control_dt, simulation_dt=0.025, duration_s=2.0, version="v0")
    assert env.metadata["render_fps"] == round(1.0 / control_dt) and GFMWTGEnv.metadata["render_fps"] == 10


@pytest.mark.filterwarnings("error", "ignore:.*is out of date:DeprecationWarning")
def test_both_checkers_have_no_complaint_about_rendering(monkeypatch: pytest.MonkeyPatch):
    from stable_baselines3.common.env_checker import check_env as check_sb3

    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    # The checker makes it with every render mode, so with a window too.
    env = gym.make(ENV_ID, duration_s=2.0, render_mode="rgb_array")
    check_env(env.unwrapped, skip_render_check=False)
    check_sb3(GFMWTGEnv(duration_s=2.0, render_mode="rgb_array", version="v0"), warn=True)


def test_a_batch_gives_the_frames_of_single_environments():
    batch = gym.make_vec(ENV_ID, num_envs=3, duration_s=2.0, render_mode="rgb_array")
    singles = [GFMWTGEnv(duration_s=2.0, render_mode="rgb_array", version="v0") for _ in range(3)]
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

    envs = SB3VecEnv(2, duration_s=1.0, render_mode="rgb_array", version="v0")
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


# --- what version v1 adds --------------------------------------------------------------------------------------------

#: Sensors whose only error is their delay.
LATE = {
    "delay_s": (0.2, 0.2),
    "wind_bias": 0.0,
    **{name: 0.0 for name, (low, _, _) in SENSOR_RANGES.items() if name != "delay_s" and low == 0.0},
}


def of_v1(n_steps: int, **settings: Any) -> GFMWTGEnv:
    """Return an environment of v1 that renders, so many steps into an episode."""
    env = GFMWTGEnv(version="v1", render_mode="rgb_array", duration_s=6.0, **settings)
    env.reset(seed=4)
    for action in actions_of(2, n_steps, 1, env.action_space.shape[0]):
        env.step(np.clip(action[0], -1.0, 1.0))
    return env


def shown(env: GFMWTGEnv) -> Episode:
    assert env._frames is not None
    return env._frames._episode(0)


@pytest.mark.parametrize("action_mode", ["k", "k+tau"])
def test_pale_lines_are_the_true_ones_as_late_as_the_sensors(action_mode: str):
    env = of_v1(0, sensors=LATE, action_mode=action_mode, observation_mode="privileged")
    exact = [env.reset(seed=4)[0]]
    for action in actions_of(2, 40, 1, env.action_space.shape[0]):
        exact.append(env.step(np.clip(action[0], -1.0, 1.0))[0])
    own = {
        name: [i for i, text in enumerate(env.observation_names) if f".{name} " in text and text.startswith("exact")]
        for name in ("frequency_deviation", "rocof")
    }
    episode, expected = shown(env), np.array(exact, dtype=np.float64)
    owners = panels_of_traces(4, measured=True)[: n_traces(4)]
    true, seen = episode.traces[:, : n_traces(4)], episode.traces[:, n_traces(4) :]
    lines = {panel.name: true[:, owners == index] for index, panel in enumerate(PANELS) if panel.name in MEASURED}
    # A group measures its own frequency, not that of the centre of inertia.
    lines["frequency"] = 50.0 + 0.5 * expected[:, own["frequency_deviation"]]
    lines["rocof"] = expected[:, own["rocof"]]
    for place, name in enumerate(MEASURED):
        late = seen[2:, 4 * place : 4 * place + 4]
        np.testing.assert_allclose(late, lines[name][:-2], atol=1e-5, err_msg=name)
    assert episode.note == "pale lines: measured, 0.2 s late"


def test_sensors_err_about_the_true_lines():
    episode = shown(of_v1(40))
    true, seen = (
        episode.traces[:, panels_of_traces(4, measured=True) == 7][:, part] for part in (slice(4), slice(4, 8))
    )
    assert 0.01 < np.abs(seen / true - 1.0).mean() < 0.25


def test_without_a_wind_sensor_the_frame_says_so_and_has_no_pale_wind():
    blind, seeing = (of_v1(40, suite=suite) for suite in ("no-wind-sensor-v1", "standard-v1"))
    titles = [[panel.title for panel in shown(env).panels if "not measured" in panel.title] for env in (blind, seeing)]
    assert titles == [["tip-speed ratio [–], not measured", "wind speed [m/s], not measured"], []]
    assert shown(blind).note.endswith(", no wind sensor") and "wind" not in shown(seeing).note
    owners = panels_of_traces(4, measured=True)[n_traces(4) :]
    unseen = np.isnan(shown(blind).traces[:, n_traces(4) :]).all(axis=0)
    assert sorted(set(owners[unseen])) == [3, 7] and not np.isnan(shown(seeing).traces[:, n_traces(4) :]).any()
    assert blind.render().shape == SHAPE


def test_limits_of_the_plant_are_drawn_in_v1_alone():
    panels = {panel.name: panel for panel in shown(of_v1(1)).panels}
    assert panels["frequency"].limits == pytest.approx((48.5, 51.5))
    assert panels["rotor"].limits == (0.5, 1.4) and panels["power"].limits == (1.1,)
    assert panels["power"].rules == (1.05,)
    for env, drawn in ((of_v1(1), True), (playing(1), False)):
        frame = env.render()
        assert [has_colour(panel(frame, name)[:, 150:], LIMIT) for name in ("rotor", "power")] == [drawn, drawn]


def test_units_of_a_bus_stand_apart_and_what_is_out_is_marked():
    from matplotlib.figure import Figure

    trip, outage, loss = (
        GroupTrip(time_s=1.0, group=2),
        MachineOutage(time_s=1.0, bus=6),
        GovernorLoss(time_s=1.0, bus=1),
    )
    buses = (2, 3, 6, 8)
    drawn = {}
    for events in ((), (trip, outage, loss)):
        axes = Figure().add_axes((0, 0, 1, 1))
        draw_diagram(axes, buses, events)
        drawn[events] = axes
    for axes in drawn.values():
        names = [(text.get_text(), text.get_position()) for text in axes.texts if text.get_text()[0] in "GCW"]
        assert sorted(name for name, _ in names) == ["C", "C", "C", "G", "W1", "W2", "W3", "W4"]
        places = np.array([place for _, place in names])
        apart = np.hypot(*(places[:, None] - places[None]).T)[~np.eye(len(names), dtype=bool)]
        # A unit's circle has a radius of 0.3.
        assert apart.min() > 0.6
        assert all(abs(x - EXTENT[0][0]) > 0.3 and abs(x - EXTENT[0][1]) > 0.3 for x, _ in places)
    dashed = [sum(line.get_linestyle() == "--" for line in axes.lines) for axes in drawn.values()]
    assert dashed == [0, 2]
    colours = [next(text.get_color() for text in axes.texts if text.get_text() == "G") for axes in drawn.values()]
    assert colours == [INK, EVENT]


def test_where_a_line_closes_again_a_dotted_line_stands():
    line = LineTrip(time_s=0.5, from_bus=5, to_bus=4, recloses_after_s=1.5)
    frames = [playing(n, scenario=calm(events=(line,)).to_dict()).render() for n in (19, 20)]
    n_pixels = [int(coloured(panel(frame, "tau"), EVENT).sum()) for frame in frames]
    # Half of the panel's rows, less those under its lines; a dotted line has as many.
    assert 40 <= n_pixels[0] <= 48 and 80 <= n_pixels[1] <= 96


def test_a_restored_episode_of_v1_shows_what_was_measured():
    env = of_v1(20)
    at_20, kept = env.render(), env.snapshot()
    for _ in range(15):
        env.step(np.ones(8))
    assert env.render().tobytes() != at_20.tobytes()
    env.restore(kept)
    assert env.render().tobytes() == at_20.tobytes()


def test_a_batch_of_v1_gives_the_frames_of_single_environments():
    batch = GFMWTGVectorEnv(2, version="v1", duration_s=2.0, render_mode="rgb_array")
    batch.reset(seed=5)
    singles = [GFMWTGEnv(version="v1", duration_s=2.0, render_mode="rgb_array") for _ in range(2)]
    for lane, env in enumerate(singles):
        env.reset(seed=5 + lane)
    for actions in np.clip(actions_of(1, 8, 2, 8), -1, 1).astype(np.float32):
        batch.step(actions)
        for lane, env in enumerate(singles):
            env.step(actions[lane])
    assert [frame.tobytes() for frame in batch.render()] == [env.render().tobytes() for env in singles]
