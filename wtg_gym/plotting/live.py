"""The page of `wtg-gym play`: your actions against the reference in one scenario, and the cost of both at the end."""

import html
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from wtg_gym.envs.batch import EnvBatch
from wtg_gym.envs.rendering import EVENT, INK, SOFT, group_colour
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, Results, evaluate
from wtg_gym.scenarios import SPLITS, Suite

if TYPE_CHECKING:
    from bokeh.document import Document

#: The two environments: you, and the reference.
OWN, REFERENCE = 0, 1
#: How often the page is brought up to date [ms]; a slow machine plays more slowly.
_TICK_MS = 50
_CHARTS = {
    "frequency": "frequency [Hz]",
    "rotor": "rotor speed [p.u.]",
    "power": "power of each group [p.u.]",
    "wind": "wind of each group [m/s]",
}
_INTRODUCTION = """<h2>Hold the frequency by hand</h2>
Keep {nominal:g} Hz with the wind turbines, and let no rotor stall. The reference (dashed), the published law
coordinated-piecewise, plays the same scenario beside you. The sliders are an agent's actions on that law, −1 … 1; at 0
it stays as it is. k up: the groups give more power and their rotors slow down; k down: they save. τ up: slower damping.
Events are not announced. The arrow keys move the slider that was clicked last."""


class Match:
    """You against the reference, which never acts, in one scenario of a suite; a ValueError if the seed is in no split.

    Both run the reference's law; your actions come on top of it, as an agent's do.
    """

    def __init__(self, suite: Suite, seed: int, duration_s: float | None = None) -> None:
        self.suite, self.seed = suite, seed
        settings = EnvSettings(suite=suite.name, duration_s=duration_s)
        self.duration_s = settings.episode_duration_s()
        self._batch = EnvBatch(settings, 2, 1)
        self._batch.start([OWN, REFERENCE], self._batch.scenarios([seed, seed]))
        self._split = next(split for split in SPLITS if seed in suite.seeds(split))
        self.n_groups, self.control_dt = self._batch.n_wtg, settings.step_s
        self.nominal_hz = self._batch.nominal_hz
        self._actions: list[npt.NDArray[np.float64]] = []

    def has_ended(self, env: int = OWN) -> bool:
        """Return whether the run of an environment has ended."""
        return bool(np.logical_or(*self._batch.ended())[env])

    @property
    def time_s(self) -> float:
        """Time since your start [s]; of a failure its instant."""
        return float(self._batch.simulator.env_values("step")[OWN]) * self._batch.simulator.settings.simulation_dt

    def step(self, k: float, tau: float) -> list[tuple[float, str]]:
        """Hold your action on k and τ of all groups for a control interval; return times [s] and words of events."""
        # An event at the very start is one too.
        before_s = self.time_s if self._actions else -1.0
        # Group after group, as the environment takes them.
        self._actions.append(np.tile([k, tau], self.n_groups))
        self._batch.step(np.stack([self._actions[-1], np.zeros(self._batch.n_action)]))
        events = sorted(self._batch.events[OWN], key=lambda event: event.time_s)
        return [(e.time_s, e.words) for e in events if before_s < e.time_s <= self.time_s]

    def sample(self) -> dict[str, npt.NDArray[np.float64]]:
        """Return where both stand: frequency (2,) [Hz]; rotor speed, power [p.u.] and wind [m/s] (2, n_groups)."""
        simulator = self._batch.simulator
        return {
            "frequency": self.nominal_hz * simulator.env_values("coi"),
            "rotor": simulator.wtg_values("rotor_speed"),
            "power": simulator.wtg_values("power"),
            "wind": simulator.wtg_values("wind"),
        }

    def results(self) -> Results:
        """Play your actions, as the entry "you", and the suite's references again."""
        you = Entry(name="you", policy=_Played(self._actions))
        options: dict[str, Any] = {"seeds": [self.seed], "duration_s": self.duration_s, "n_threads": 1}
        return evaluate([you], self.suite.name, self._split, **options)

    def next_seed(self) -> int:
        """Return the seed after this one in its split; after the last one the first."""
        seeds = self.suite.seeds(self._split)
        return seeds[(seeds.index(self.seed) + 1) % len(seeds)]


class _Played:
    """A policy that repeats the actions of one episode; its state is the number of steps."""

    def __init__(self, actions: list[npt.NDArray[np.float64]]) -> None:
        self._actions = actions

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Any, Any]:
        step = state or 0
        return self._actions[step][np.newaxis], step + 1


class PlayPage:
    """One visitor's page: sliders for your actions, and both runs as they go; it needs Bokeh."""

    def __init__(self, document: "Document", match: Match, speed: float) -> None:
        from bokeh.layouts import column, row
        from bokeh.models import Button, ColumnDataSource, Div, Slider

        def text(name: str, content: str = "") -> Div:
            return Div(name=name, text=content, sizing_mode="stretch_width", styles={"font-size": "14px"})

        def button(name: str, label: str, act: Any) -> Button:
            made = Button(name=name, label=label, width=110)
            made.on_click(act)
            return made

        self._match, self._speed = match, speed
        self._traces, self._strikes = ColumnDataSource(name="traces"), ColumnDataSource(name="strikes")
        self._start = button("start", "Start", self._toggle)
        self._status, self._verdict, self._events = (text(name) for name in ("status", "verdict", "events"))
        self._sliders = [
            Slider(name=name, title=name, start=-1.0, end=1.0, step=0.05, value=0.0, width=300) for name in ("k", "τ")
        ]
        self._play(match.seed)
        buttons = (
            self._start,
            button("again", "Again", lambda: self._play(self._match.seed)),
            button("next", "Next scenario", lambda: self._play(self._match.next_seed())),
            button("zero", "All to zero", self._zero),
        )
        charts = column(*(self._chart(name) for name in _CHARTS), sizing_mode="stretch_width")
        main = row(charts, column(*self._sliders, self._events), sizing_mode="stretch_width")
        introduction = text("introduction", _INTRODUCTION.format(nominal=self._match.nominal_hz))
        whole = column(introduction, row(*buttons), self._status, self._verdict, main, sizing_mode="stretch_width")
        whole.styles = {"padding": "0 1rem"}
        document.title = "wtg_gym: hold the frequency by hand"
        document.add_root(whole)
        document.add_periodic_callback(self._tick, _TICK_MS)

    def _chart(self, name: str) -> Any:
        from bokeh.models import Range1d
        from bokeh.plotting import figure

        span = Range1d(0.0, self._match.duration_s)
        made = figure(name=name, title=_CHARTS[name], height=190, x_range=span, tools="")
        made.update(toolbar_location=None, sizing_mode="stretch_width", lod_threshold=None)
        made.update(min_border_left=60, min_border_right=20)
        made.axis.minor_tick_line_color = None
        made.xaxis.axis_label = "time [s]" if name == "wind" else None
        if name == "frequency":
            nominal = self._match.nominal_hz
            # Keeps this range in view.
            made.scatter([0.0, 0.0], [nominal - 0.25, nominal + 0.25], alpha=0.0)
            made.hspan([nominal - 0.2, nominal + 0.2], line_color=SOFT, line_dash="dotted")
        made.vspan("x", source=self._strikes, line_color=EVENT, line_dash="dashed")
        for j in range(1 if name == "frequency" else self._match.n_groups):
            colour = INK if name == "frequency" else group_colour(j)
            yours = {"line_width": 2.2, **({"legend_label": f"group {j + 1}"} if name == "rotor" else {})}
            for env, style in ((REFERENCE, {"line_dash": [6, 3]}), (OWN, yours)):
                made.line("t", f"{name}-{env}-{j}", source=self._traces, color=colour, **style)
        if name == "rotor":
            made.legend.update(location="bottom_right", orientation="horizontal", padding=2, background_fill_alpha=0.7)
        return made

    def _zero(self) -> None:
        for slider in self._sliders:
            slider.value = 0.0

    def _play(self, seed: int) -> None:
        """Put a scenario at its start, paused."""
        self._match = Match(self._match.suite, seed, self._match.duration_s)
        self._running = False
        #: Control steps that are still to be made, a fraction of one between two ticks.
        self._due, self._seen = 0.0, list[tuple[float, str]]()
        self._zero()
        self._traces.data = {name: [value] for name, value in self._now().items()}
        self._strikes.data = {"x": []}
        self._verdict.text = ""
        self._show()

    def _toggle(self) -> None:
        if self._match.has_ended():
            self._play(self._match.seed)
        self._running = not self._running
        self._show()

    def _now(self) -> dict[str, float]:
        """Return where both stand, as a row of the traces; the line of a reference that failed ends."""
        gone = self._match.has_ended(REFERENCE) and not self._match.has_ended()
        now = {"t": self._match.time_s}
        for name, values in self._match.sample().items():
            for (env, j), value in np.ndenumerate(values.reshape(2, -1)):
                now[f"{name}-{env}-{j}"] = np.nan if gone and env == REFERENCE else float(value)
        return now

    def _tick(self) -> None:
        if not self._running:
            return
        self._due += self._speed * _TICK_MS / 1000.0 / self._match.control_dt
        rows, struck = list[dict[str, float]](), list[tuple[float, str]]()
        while self._due >= 1.0 and not self._match.has_ended():
            self._due -= 1.0
            struck += self._match.step(*(slider.value for slider in self._sliders))
            rows.append(self._now())
        if rows:
            self._traces.stream({name: [row[name] for row in rows] for name in rows[0]})
        if struck:
            self._seen += struck
            self._strikes.stream({"x": [time_s for time_s, _ in struck]})
        if self._match.has_ended():
            self._running = False
            self._verdict.text = verdict_text(self._match)
        self._show()

    def _show(self) -> None:
        match = self._match
        state = "over" if match.has_ended() else "running" if self._running else "paused" if match.time_s else "ready"
        self._start.label = "Pause" if self._running else "Start"
        frequency = match.sample()["frequency"][OWN]
        lost = "" if match.has_ended() or not match.has_ended(REFERENCE) else " The reference has failed."
        self._status.text = (
            f"<b>{match.time_s:.1f} s</b> of {self._match.duration_s:g} s, <b>{frequency:.2f} Hz</b>, {state}. "
            f"{match.suite.name}, scenario {match.seed}.{lost}"
        )
        lines = (f"<b>{time_s:.1f} s</b> {html.escape(words)}" for time_s, words in reversed(self._seen))
        self._events.text = "<br>".join(lines) or "Nothing has happened yet."


def verdict_text(match: Match) -> str:
    """Return the end of a run as HTML: your cost, failure, and a table of everybody's, in v1 with scores."""
    results = match.results()
    scores = results.scores if results.task.scale else {}
    deviations = {row.name: f"{row.median_deviation_mhz:.0f} mHz" for row in results.ranking}
    rows = [("", "cost", "largest deviation", "failure", *(["score in this scenario"] if scores else []))]
    for name in ("you", *results.task.anchors):
        (episode,) = results.episodes_of(name)
        score = [f"{scores[name].value:.0f}"] if scores else []
        rows.append((name, f"{episode.metrics['cost']:.1f}", deviations[name], episode.failure, *score))
    (you,) = results.episodes_of("you")
    failed = f"<h2>Your run failed after {match.time_s:.1f} s: {you.failure}</h2>" if you.failure else ""
    table = "".join("<tr><td>" + "<td style='padding-left:2em'>".join(row) for row in rows)
    return f"{failed}<h2>Your cost: {you.metrics['cost']:.1f}</h2><table>{table}</table>"
