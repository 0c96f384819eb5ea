"""The page of `wtg-gym play`: sliders and keys for your actions, and both runs as they go."""

from __future__ import annotations

import html
import time
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Button, ColumnDataSource, CustomJS, Div, RadioButtonGroup, Range1d, Slider
from bokeh.plotting import figure

from wtg_gym.envs.rendering.colours import EVENT, INK, SOFT, group_colour
from wtg_gym.plotting.live.match import OWN, REFERENCE, Match, Scale, Verdict

#: How often the page is brought up to date [ms].
_TICK_MS = 50
#: Most control steps between two of these: a slow machine plays more slowly instead of falling behind.
_MOST_STEPS = 40
#: What one press of a key adds to the sliders on k and on τ.
_KEY_STEPS = {"ArrowUp": (0.1, 0.0), "ArrowDown": (-0.1, 0.0), "ArrowRight": (0.0, 0.25), "ArrowLeft": (0.0, -0.25)}
_CHARTS = {"frequency": "frequency [Hz]", "rotor": "rotor speed [p.u.]", "power": "power of each group [p.u.]"}
_INTRODUCTION = """<h2>Hold the frequency by hand</h2>
Keep {nominal:g} Hz with the wind turbines, and let no rotor stall. The reference (dashed) plays the same scenario
beside you and never acts. k up: a group gives more power and its rotor slows down; k down: it saves. τ up: slower
damping.
Events are not announced.<br>Keys: <b>space</b> start or pause, <b>↑ ↓</b> k, <b>→ ←</b> τ, <b>0</b> all groups,
<b>1 … {n}</b> one, <b>z</b> all back to zero, <b>a</b> again, <b>n</b> next scenario."""
#: Keys are taken before a widget sees them, and reach the server as the tags of the status.
_ON_KEY = """
let count = 0;
addEventListener("keydown", (event) => {
  const ours = event.key.startsWith("Arrow") || " anz0123456789".includes(event.key);
  if (!ours || event.ctrlKey || event.altKey || event.metaKey) return;
  event.preventDefault();
  event.stopPropagation();
  if (!event.repeat || event.key.startsWith("Arrow")) status.tags = [event.key, ++count];
}, true);
"""


class PlayPage:
    """One visitor's page."""

    def __init__(self, document: Document, scale: Scale, seed: int, speed: float) -> None:
        self._scale, self._speed = scale, speed
        self._match = Match(scale, seed)
        n = self._match.n_groups
        self._running = self._linking = False
        #: The clock when the run would have started without pauses.
        self._since = 0.0
        self._traces, self._strikes = ColumnDataSource(name="traces"), ColumnDataSource(name="strikes")
        self._start = _button("start", "Start", self._toggle)
        self._status, self._verdict, self._events = (_text(name) for name in ("status", "verdict", "events"))
        self._status.on_change("tags", lambda _attribute, _old, new: self._key(str(new[0])))
        self._chosen = RadioButtonGroup(name="chosen", labels=["all groups", *(str(1 + j) for j in range(n))], active=0)
        self._sliders = [[self._slider(name, j) for j in range(n)] for name in ("k", "τ")]
        self._play(seed)
        buttons = (
            self._start,
            _button("again", "Again", lambda: self._play(self._match.seed)),
            _button("next", "Next scenario", lambda: self._play(self._match.next_seed())),
            _button("zero", "All to zero", self._zero),
        )
        pairs = (row(*pair) for pair in zip(*self._sliders, strict=True))
        actions = column(self._chosen, *pairs, self._events)
        charts = column(*(self._chart(name) for name in _CHARTS), sizing_mode="stretch_width")
        introduction = _text("introduction", _INTRODUCTION.format(nominal=self._match.nominal_hz, n=n))
        main = row(charts, actions, sizing_mode="stretch_width")
        whole = column(introduction, row(*buttons), self._status, self._verdict, main, sizing_mode="stretch_width")
        whole.styles = {"padding": "0 1rem"}
        document.title = "wtg_gym: hold the frequency by hand"
        document.add_root(whole)
        document.js_on_event("document_ready", CustomJS(args={"status": self._status}, code=_ON_KEY))
        document.add_periodic_callback(self._tick, _TICK_MS)

    def _slider(self, name: str, group: int) -> Slider:
        slider = Slider(name=f"{name}{group}", start=-1.0, end=1.0, step=0.05, value=0.0, width=190)
        slider.update(title=f"{name}, group {1 + group}", bar_color=group_colour(group))
        slider.on_change("value", lambda _attribute, _old, new: self._moved(name == "τ", float(new)))
        return slider

    def _chart(self, name: str) -> Any:
        span = Range1d(0.0, self._scale.duration_s)
        made = figure(name=name, title=_CHARTS[name], height=190, x_range=span, tools="")
        made.update(toolbar_location=None, sizing_mode="stretch_width", lod_threshold=None)
        made.update(min_border_left=60, min_border_right=20)
        made.axis.minor_tick_line_color = None
        if name == "frequency":
            nominal = self._match.nominal_hz
            # Keeps this range in view.
            made.scatter([0.0, 0.0], [nominal - 0.25, nominal + 0.25], alpha=0.0)
            made.hspan([nominal - 0.2, nominal + 0.2], line_color=SOFT, line_dash="dotted")
        made.vspan("x", source=self._strikes, line_color=EVENT, line_dash="dashed")
        for j in range(1 if name == "frequency" else self._match.n_groups):
            colour = INK if name == "frequency" else group_colour(j)
            for lane, style in ((REFERENCE, {"line_dash": [6, 3]}), (OWN, {"line_width": 2.2})):
                made.line("t", f"{name}-{lane}-{j}", source=self._traces, color=colour, **style)
        return made

    # --- what you do -------------------------------------------------------------------------------------------------

    def _moved(self, is_tau: bool, value: float) -> None:
        """Move the other groups' sliders too where all are chosen."""
        if not self._linking and self._chosen.active == 0:
            self._set(self._sliders[is_tau], value)

    def _set(self, sliders: list[Slider], value: float | None = None, change: float = 0.0) -> None:
        """Set sliders to a value, or change theirs."""
        self._linking = True
        for slider in sliders:
            wanted = slider.value + change if value is None else value
            slider.value = float(np.clip(round(wanted, 6), -1.0, 1.0))
        self._linking = False

    def _zero(self) -> None:
        for sliders in self._sliders:
            self._set(sliders, 0.0)

    def _key(self, key: str) -> None:
        plain = {" ": self._toggle, "z": self._zero}
        if key in _KEY_STEPS:
            chosen = self._chosen.active or 0
            for sliders, change in zip(self._sliders, _KEY_STEPS[key], strict=True):
                self._set(sliders if chosen == 0 else [sliders[chosen - 1]], change=change)
        elif key.isdigit() and int(key) <= self._match.n_groups:
            self._chosen.active = int(key)
        elif key in plain:
            plain[key]()
        elif key in ("a", "n"):
            self._play(self._match.seed if key == "a" else self._match.next_seed())

    def _toggle(self) -> None:
        if self._match.over:
            self._play(self._match.seed)
        self._running = not self._running
        self._go_on()
        self._say()

    def _go_on(self) -> None:
        self._since = time.monotonic() - self._match.time_s / self._speed

    # --- what goes on ------------------------------------------------------------------------------------------------

    def _play(self, seed: int) -> None:
        """Put a scenario at its start, paused."""
        self._match = Match(self._scale, seed)
        self._running, self._seen = False, list[tuple[float, str]]()
        self._zero()
        self._traces.data = {name: [value] for name, value in self._now().items()}
        self._strikes.data = {"x": []}
        self._verdict.text = ""
        self._say()

    def _now(self) -> dict[str, float]:
        """Return where both stand, as a row of the traces; the line of a reference that failed ends."""
        gone = self._match.has_ended(REFERENCE) and not self._match.over
        now = {"t": self._match.time_s}
        for name, values in self._match.sample().items():
            for lane, own in enumerate(values.reshape(2, -1).tolist()):
                for j, value in enumerate(own):
                    now[f"{name}-{lane}-{j}"] = np.nan if gone and lane == REFERENCE else value
        return now

    def _tick(self) -> None:
        """Bring the match up to the clock."""
        if not self._running:
            return
        behind_s = (time.monotonic() - self._since) * self._speed - self._match.time_s
        due = int(behind_s / self._match.control_dt)
        rows, struck = list[dict[str, float]](), list[tuple[float, str]]()
        while len(rows) < min(due, _MOST_STEPS) and not self._match.over:
            struck += self._match.step(*([slider.value for slider in sliders] for sliders in self._sliders))
            rows.append(self._now())
        if rows:
            self._traces.stream({name: [each[name] for each in rows] for name in rows[0]})
        if struck:
            self._seen += struck
            self._strikes.stream({"x": [time_s for time_s, _ in struck]})
        if due > _MOST_STEPS:
            self._go_on()
        if self._match.over:
            self._running = False
            self._verdict.text = verdict_text(self._match.verdicts(), self._match, self._scale)
        self._say()

    def _say(self) -> None:
        match = self._match
        state = "over" if match.over else "running" if self._running else "paused" if match.time_s else "ready"
        self._start.label = "Pause" if self._running else "Start"
        frequency = match.sample()["frequency"][OWN]
        lost = "" if match.over or not match.has_ended(REFERENCE) else " The reference has failed."
        self._status.text = (
            f"<b>{match.time_s:.1f} s</b> of {self._scale.duration_s:g} s, <b>{frequency:.2f} Hz</b>, {state}. "
            f"{self._scale.suite.name}, scenario {match.seed}.{lost}"
        )
        lines = (f"<b>{time_s:.1f} s</b> {html.escape(words)}" for time_s, words in reversed(self._seen))
        self._events.text = "<br>".join(lines) or "Nothing has happened yet."


def _text(name: str, text: str = "") -> Div:
    return Div(name=name, text=text, sizing_mode="stretch_width", styles={"font-size": "14px"})


def _button(name: str, label: str, act: Any) -> Button:
    button = Button(name=name, label=label, width=110)
    button.on_click(act)
    return button


def verdict_text(verdicts: list[Verdict], match: Match, scale: Scale) -> str:
    """Return the end of a run as HTML: score, failure, and a table of everybody's."""
    you, (zero, hundred) = verdicts[0], scale.suite.benchmark.anchors
    head = f"<h2>Score {you.score:.1f}</h2>{zero} has 0 on average over the suite, {hundred} 100 everywhere."
    if you.failure:
        head = f"<h2>Your run failed after {match.time_s:.1f} s: {you.failure}</h2>{head}"
    cells = [("", "score", "cost", "largest deviation", "failure")]
    for each in verdicts:
        numbers = f"{each.score:.1f}", f"{each.cost:.1f}", f"{1000.0 * each.deviation_hz:.0f} mHz"
        cells.append((each.name, *numbers, each.failure))
    rows = "".join("<tr><td>" + "<td style='padding-left:2em'>".join(line) for line in cells)
    return f"{head}<table>{rows}</table>"
