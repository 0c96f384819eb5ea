"""The page of `wtg-gym play`: sliders for your actions, and both runs as they go."""

from __future__ import annotations

import html
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.layouts import column, row
from bokeh.models import Button, ColumnDataSource, Div, Range1d, Slider
from bokeh.plotting import figure

from wtg_gym.envs.rendering.colours import EVENT, INK, SOFT, group_colour
from wtg_gym.plotting.live.match import OWN, REFERENCE, Match, Verdict

#: How often the page is brought up to date [ms]; a slow machine plays more slowly.
_TICK_MS = 50
_CHARTS = {"frequency": "frequency [Hz]", "rotor": "rotor speed [p.u.]", "power": "power of each group [p.u.]"}
_INTRODUCTION = """<h2>Hold the frequency by hand</h2>
Keep {nominal:g} Hz with the wind turbines, and let no rotor stall. The reference (dashed) plays the same scenario
beside you and never acts. k up: the groups give more power and their rotors slow down; k down: they save. τ up: slower
damping. Events are not announced. The arrow keys move the slider that was clicked last."""


class PlayPage:
    """One visitor's page."""

    def __init__(self, document: Document, match: Match, speed: float) -> None:
        self._match, self._speed = match, speed
        self._running = False
        #: Control steps that are still to be made, a fraction of one between two ticks.
        self._due = 0.0
        self._traces, self._strikes = ColumnDataSource(name="traces"), ColumnDataSource(name="strikes")
        self._start = _button("start", "Start", self._toggle)
        self._status, self._verdict, self._events = (_text(name) for name in ("status", "verdict", "events"))
        self._sliders = [
            Slider(name=name, title=name, start=-1.0, end=1.0, step=0.05, value=0.0, width=300) for name in ("k", "τ")
        ]
        self._play(match.seed)
        buttons = (
            self._start,
            _button("again", "Again", lambda: self._play(self._match.seed)),
            _button("next", "Next scenario", lambda: self._play(self._match.next_seed())),
            _button("zero", "All to zero", self._zero),
        )
        actions = column(*self._sliders, self._events)
        charts = column(*(self._chart(name) for name in _CHARTS), sizing_mode="stretch_width")
        introduction = _text("introduction", _INTRODUCTION.format(nominal=self._match.nominal_hz))
        main = row(charts, actions, sizing_mode="stretch_width")
        whole = column(introduction, row(*buttons), self._status, self._verdict, main, sizing_mode="stretch_width")
        whole.styles = {"padding": "0 1rem"}
        document.title = "wtg_gym: hold the frequency by hand"
        document.add_root(whole)
        document.add_periodic_callback(self._tick, _TICK_MS)

    def _chart(self, name: str) -> Any:
        span = Range1d(0.0, self._match.duration_s)
        made = figure(name=name, title=_CHARTS[name], height=190, x_range=span, tools="")
        made.update(toolbar_location=None, sizing_mode="stretch_width", lod_threshold=None)
        made.update(min_border_left=60, min_border_right=20)
        made.axis.minor_tick_line_color = None
        made.xaxis.axis_label = "time [s]" if name == "power" else None
        if name == "frequency":
            nominal = self._match.nominal_hz
            # Keeps this range in view.
            made.scatter([0.0, 0.0], [nominal - 0.25, nominal + 0.25], alpha=0.0)
            made.hspan([nominal - 0.2, nominal + 0.2], line_color=SOFT, line_dash="dotted")
        made.vspan("x", source=self._strikes, line_color=EVENT, line_dash="dashed")
        for j in range(1 if name == "frequency" else self._match.n_groups):
            colour = INK if name == "frequency" else group_colour(j)
            own = {"line_width": 2.2, **({"legend_label": f"group {j + 1}"} if name == "rotor" else {})}
            for lane, style in ((REFERENCE, {"line_dash": [6, 3]}), (OWN, own)):
                made.line("t", f"{name}-{lane}-{j}", source=self._traces, color=colour, **style)
        if name == "rotor":
            made.legend.update(location="bottom_right", orientation="horizontal", padding=2, background_fill_alpha=0.7)
        return made

    # --- what you do -------------------------------------------------------------------------------------------------

    def _zero(self) -> None:
        for slider in self._sliders:
            slider.value = 0.0

    def _toggle(self) -> None:
        if self._match.over:
            self._play(self._match.seed)
        self._running = not self._running
        self._say()

    # --- what goes on ------------------------------------------------------------------------------------------------

    def _play(self, seed: int) -> None:
        """Put a scenario at its start, paused."""
        self._match = Match(self._match.suite, seed, self._match.duration_s)
        self._running, self._due, self._seen = False, 0.0, list[tuple[float, str]]()
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
        """Make the control steps that are due."""
        if not self._running:
            return
        self._due += self._speed * _TICK_MS / 1000.0 / self._match.control_dt
        rows, struck = list[dict[str, float]](), list[tuple[float, str]]()
        while self._due >= 1.0 and not self._match.over:
            self._due -= 1.0
            struck += self._match.step(*(slider.value for slider in self._sliders))
            rows.append(self._now())
        if rows:
            self._traces.stream({name: [each[name] for each in rows] for name in rows[0]})
        if struck:
            self._seen += struck
            self._strikes.stream({"x": [time_s for time_s, _ in struck]})
        if self._match.over:
            self._running = False
            self._verdict.text = verdict_text(self._match.verdicts(), self._match)
        self._say()

    def _say(self) -> None:
        match = self._match
        state = "over" if match.over else "running" if self._running else "paused" if match.time_s else "ready"
        self._start.label = "Pause" if self._running else "Start"
        frequency = match.sample()["frequency"][OWN]
        lost = "" if match.over or not match.has_ended(REFERENCE) else " The reference has failed."
        self._status.text = (
            f"<b>{match.time_s:.1f} s</b> of {self._match.duration_s:g} s, <b>{frequency:.2f} Hz</b>, {state}. "
            f"{match.suite.name}, scenario {match.seed}.{lost}"
        )
        lines = (f"<b>{time_s:.1f} s</b> {html.escape(words)}" for time_s, words in reversed(self._seen))
        self._events.text = "<br>".join(lines) or "Nothing has happened yet."


def _text(name: str, text: str = "") -> Div:
    return Div(name=name, text=text, sizing_mode="stretch_width", styles={"font-size": "14px"})


def _button(name: str, label: str, act: Any) -> Button:
    button = Button(name=name, label=label, width=110)
    button.on_click(act)
    return button


def verdict_text(verdicts: list[Verdict], match: Match) -> str:
    """Return the end of a run as HTML: your cost, failure, and a table of everybody's."""
    you = verdicts[0]
    head = f"<h2>Your cost: {you.cost:.1f}</h2>"
    if you.failure:
        head = f"<h2>Your run failed after {match.time_s:.1f} s: {you.failure}</h2>{head}"
    cells = [("", "cost", "largest deviation", "failure")]
    cells += [
        (each.name, f"{each.cost:.1f}", f"{1000.0 * each.deviation_hz:.0f} mHz", each.failure) for each in verdicts
    ]
    rows = "".join("<tr><td>" + "<td style='padding-left:2em'>".join(line) for line in cells)
    return f"{head}<table>{rows}</table>"
