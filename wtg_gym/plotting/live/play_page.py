"""The page of `wtg-gym play`: sliders and keys for your actions, and both runs as they go."""

from __future__ import annotations

import html
import time
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import Button, ColumnDataSource, RadioButtonGroup, Slider

from wtg_gym.envs.actions import TIME_CONSTANT_RATIO
from wtg_gym.envs.rendering.colours import group_colour
from wtg_gym.evaluation.summary import POINTS, REST
from wtg_gym.plotting.live import look
from wtg_gym.plotting.live.match import Match, Scale, Verdict
from wtg_gym.plotting.page.data import limits

#: How often the page is brought up to date [ms].
_TICK_MS = 50
#: Most control steps between two of these: a slow machine plays more slowly instead of falling behind.
_MOST_STEPS = 40
#: What one press of a key adds.
_KEY_STEPS = {"ArrowUp": ("k", 0.1), "ArrowDown": ("k", -0.1), "ArrowRight": ("tau", 0.25), "ArrowLeft": ("tau", -0.25)}
#: Heads of the points in the table of scores.
_HEADS = {"frequency_rocof": "f, RoCoF", "duty": "duty", "overload": "overload", REST: "rest"}


class PlayPage:
    """One visitor's page."""

    def __init__(self, document: Document, scale: Scale, seed: int, speed: float) -> None:
        self._document, self._scale, self._speed = document, scale, speed
        self._match = Match(scale, seed)
        n = self._match.n_groups
        self._running = False
        self._linking = False
        self._seen: list[tuple[float, str]] = []
        #: The clock when the run was started or went on, and the control steps that were done then.
        self._since, self._done = 0.0, 0
        self._traces = ColumnDataSource(name="traces", data={name: [] for name in self._columns()})
        self._strikes = ColumnDataSource(name="strikes", data={"x": []})
        self._start = Button(name="start", label="Start", button_type="primary", width=110)
        self._start.on_click(self._toggle)
        again, following = Button(name="again", label="Again", width=90), Button(name="next", label="Next scenario")
        again.on_click(lambda: self._play(self._match.seed))
        following.on_click(lambda: self._play(self._match.next_seed()))
        self._status, self._verdict, self._events = (look.text(name) for name in ("status", "verdict", "events"))
        self._status.on_change("tags", self._key)
        self._chosen = RadioButtonGroup(
            name="chosen", labels=["all groups", *(str(1 + j) for j in range(n))], active=0, sizing_mode="stretch_width"
        )
        self._k = [self._slider("k", j) for j in range(n)]
        self._tau = [self._slider("tau", j) for j in range(n)]
        zero = Button(name="zero", label="All to zero", width=110)
        zero.on_click(self._zero)
        legend = look.text(
            "legend",
            f"<span class=soft>Solid: <b style='color:{look.YOURS}'>you</b>; "
            f"dashed: <b style='color:{look.OTHER}'>the reference</b>. Below: {look.groups_in_colour(n)}.</span>",
        )
        for root in (self._start, again, following, self._status, self._verdict, self._events, self._chosen, zero):
            document.add_root(root)
        for root in (legend, *self._k, *self._tau, *self._charts()):
            document.add_root(root)
        nominal = f"{self._match.you.lanes.nominal_hz:g}"
        look.frame(document, "play", "wtg_gym: hold the frequency by hand", {"n_groups": n, "nominal": nominal})
        self._play(seed)
        document.add_periodic_callback(self._tick, _TICK_MS)

    def _columns(self) -> list[str]:
        groups = range(self._match.n_groups)
        names = [f"{side}-{name}-{j}" for side in "ab" for name in ("rotor", "power") for j in groups]
        return ["t", "a-frequency", "b-frequency", *names, *(f"{name}-{j}" for name in ("k", "tau") for j in groups)]

    def _slider(self, name: str, group: int) -> Slider:
        title = f"{'τ' if name == 'tau' else name}, group {1 + group}"
        slider = Slider(
            name=f"{name}{group}",
            title=title,
            start=-1.0,
            end=1.0,
            step=0.05,
            value=0.0,
            bar_color=group_colour(group),
            sizing_mode="stretch_width",
        )
        slider.on_change("value", lambda _attribute, _old, new: self._moved(name, group, float(new)))
        return slider

    def _charts(self) -> list[Any]:
        duration, nominal = self._scale.duration_s, self._match.you.lanes.nominal_hz
        own = limits(self._scale.suite.name)
        frequency = look.chart("frequency", "frequency [Hz]", 210, duration)
        look.show_at_least(frequency, nominal - 0.25, nominal + 0.25)
        look.mark(frequency, *own["frequency"].values())
        rotor = look.chart("rotor", "rotor speed [p.u.]", 165, duration)
        power = look.chart("power", "power of each group [p.u.]", 165, duration)
        k = look.chart("on_k", "your action on k", 130, duration, time_axis=True)
        ratio = TIME_CONSTANT_RATIO
        tau = look.chart("on_tau", f"your action on τ (1: τ × {ratio:g})", 130, duration, time_axis=True)
        for made in (k, tau):
            look.show_at_least(made, -1.0, 1.0)
        for made in (frequency, rotor, power, k, tau):
            look.mark_events(made, self._strikes)
        frequency.line(
            "t", "b-frequency", source=self._traces, color=look.OTHER, line_width=1.6, line_dash=[6, 3], name="b"
        )
        frequency.line("t", "a-frequency", source=self._traces, color=look.YOURS, line_width=2.6, name="a")
        for j in range(self._match.n_groups):
            colour = group_colour(j)
            for made, name in ((rotor, "rotor"), (power, "power")):
                made.line("t", f"b-{name}-{j}", source=self._traces, color=colour, line_width=1.2, line_dash=[6, 3])
                made.line("t", f"a-{name}-{j}", source=self._traces, color=colour, line_width=2.2)
            for made, name in ((k, "k"), (tau, "tau")):
                made.step("t", f"{name}-{j}", source=self._traces, color=colour, line_width=2, mode="before")
        return [frequency, rotor, power, k, tau]

    # --- what you do -------------------------------------------------------------------------------------------------

    def _moved(self, name: str, group: int, value: float) -> None:
        """Move the other groups' sliders too where all are chosen."""
        if self._linking or self._chosen.active != 0:
            return
        self._set_all(self._k if name == "k" else self._tau, value)

    def _set_all(self, sliders: list[Slider], value: float) -> None:
        self._linking = True
        for slider in sliders:
            slider.value = value
        self._linking = False

    def _zero(self) -> None:
        self._set_all(self._k + self._tau, 0.0)

    def _key(self, _attribute: str, _old: Any, new: Any) -> None:
        key = str(new[0]) if new else ""
        if key in _KEY_STEPS:
            name, change = _KEY_STEPS[key]
            sliders = self._k if name == "k" else self._tau
            chosen = self._chosen.active or 0
            self._linking = True
            for slider in sliders if chosen == 0 else [sliders[chosen - 1]]:
                slider.value = float(np.clip(round(slider.value + change, 6), -1.0, 1.0))
            self._linking = False
        elif key.isdigit() and int(key) <= self._match.n_groups:
            self._chosen.active = int(key)
        elif key == " ":
            self._toggle()
        elif key == "a":
            self._play(self._match.seed)
        elif key == "n":
            self._play(self._match.next_seed())
        elif key == "z":
            self._zero()

    def _toggle(self) -> None:
        if self._match.over:
            self._play(self._match.seed)
        self._running = not self._running
        self._go_on()
        self._say()

    def _go_on(self) -> None:
        self._since, self._done = time.monotonic(), len(self._traces.data["t"]) - 1

    # --- what goes on ------------------------------------------------------------------------------------------------

    def _play(self, seed: int) -> None:
        """Put a scenario at its start, paused."""
        if seed != self._match.seed or self._match.you.time_s > 0.0:
            self._match = Match(self._scale, seed)
        self._running, self._seen = False, []
        self._zero()
        self._traces.data = {name: [value] for name, value in self._row().items()}
        self._strikes.data = {"x": []}
        self._verdict.text = ""
        self._say()

    def _row(self) -> dict[str, float]:
        """Return where both stand and what you ask for, as a row of the traces."""
        row = {"t": self._match.you.time_s}
        for side, run in (("a", self._match.you), ("b", self._match.reference)):
            now = run.sample()
            # One that has failed before stands still: its line ends.
            gone = side == "b" and run.over and not self._match.over
            row[f"{side}-frequency"] = np.nan if gone else now.frequency_hz
            for name, values in (("rotor", now.rotor_speed_pu), ("power", now.power_pu)):
                row.update({f"{side}-{name}-{j}": np.nan if gone else float(v) for j, v in enumerate(values)})
        row.update({f"k-{j}": float(slider.value) for j, slider in enumerate(self._k)})
        row.update({f"tau-{j}": float(slider.value) for j, slider in enumerate(self._tau)})
        return row

    def _tick(self) -> None:
        """Bring the match up to the clock."""
        if not self._running:
            return
        passed = (time.monotonic() - self._since) * self._speed
        due = self._done + int(passed / self._match.control_dt) - (len(self._traces.data["t"]) - 1)
        if due <= 0:
            return
        new: dict[str, list[float]] = {name: [] for name in self._columns()}
        struck = []
        for _ in range(min(due, _MOST_STEPS)):
            struck += self._match.step([s.value for s in self._k], [s.value for s in self._tau])
            for name, value in self._row().items():
                new[name].append(value)
            if self._match.over:
                break
        self._traces.stream(new)
        if struck:
            self._seen += struck
            self._strikes.stream({"x": [time_s for time_s, _ in struck]})
        if due > _MOST_STEPS:
            self._go_on()
        if self._match.over:
            self._running = False
            self._verdict.text = verdict_text(self._match.verdicts(), self._match.you.failure(), self._scale)
        self._say()

    def _say(self) -> None:
        match = self._match
        state = "over" if match.over else "running" if self._running else "paused" if match.you.time_s else "ready"
        self._start.label, self._start.disabled = "Pause" if self._running else "Start", match.over
        now = match.you.sample()
        behind = "" if not match.reference.over or match.over else " The reference has failed."
        self._status.text = (
            f"<b>{now.time_s:.1f} s</b> of {self._scale.duration_s:g} s, <b>{now.frequency_hz:.2f} Hz</b>, {state}. "
            f"<span class=soft>{html.escape(self._scale.suite.name)}, scenario {match.seed}.{behind}</span>"
        )
        lines = [f"<p><b>{time_s:.1f} s</b> {html.escape(words)}</p>" for time_s, words in reversed(self._seen)]
        self._events.text = "".join(lines) or "<p class=soft>Nothing yet. Events are not announced.</p>"


def verdict_text(verdicts: list[Verdict], failure: str, scale: Scale) -> str:
    """Return the end of a run as HTML: score, failure in words, and the table of everybody's cost and points."""
    you = verdicts[0]
    benchmark = scale.suite.benchmark
    if you.score is None:
        head = (
            f"<p class=big>Cost {you.cost:.1f}</p><p class=soft>There is no score: {look.sentence(scale.missing)}</p>"
        )
    else:
        head = (
            f"<p class=big>Score {_number(you.score)}</p>"
            f"<p class=soft>On average over the suite {benchmark.zero} has 0; in every scenario {benchmark.hundred} "
            "has 100. Points by terms add up to the score − 100; Δf is the largest deviation. A failure costs as much "
            "as if it had come at once.</p>"
        )
    if failure:
        head = f"<p class=bad><b>Your run failed</b> {look.sentence(failure)}</p>{head}"
    rows = []
    for each in verdicts:
        score = ["–"] * (2 + len(POINTS))
        if each.score is not None:
            score = [_number(each.score), *(_signed(each.points[name]) for name in (*POINTS, REST))]
        end = each.failure or "none"
        rows.append([each.name, score[0], f"{each.cost:.1f}", *score[1:], f"{1000.0 * each.deviation_hz:.0f}", end])
    header = ["", "score", "cost", *(_HEADS[name] for name in (*POINTS, REST)), "Δf [mHz]", "failure"]
    return head + look.table(header, rows)


def _signed(points: float) -> str:
    return f"{points:+.1f}".replace("-", "−") if abs(points) >= 0.05 else "0.0"


def _number(score: float) -> str:
    return f"{score:.1f}".replace("-", "−")
