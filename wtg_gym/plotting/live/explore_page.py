"""The page of `wtg-gym explore`: wind, events, law and grid by widgets, and the run that they make."""

from __future__ import annotations

import contextlib
import html
import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.models import (
    Button,
    CategoricalSlider,
    Checkbox,
    ColumnDataSource,
    CustomJS,
    RadioButtonGroup,
    Select,
    Slider,
    TextAreaInput,
)

from wtg_gym.envs.rendering.colours import SOFT, group_colour
from wtg_gym.envs.rendering.diagram import describe_event
from wtg_gym.evaluation.recording import Recording
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, STRATEGY_NAMES, TrackingLaw, get_law
from wtg_gym.plotting.live import look
from wtg_gym.plotting.live.experiment import (
    KINDS,
    MOST_GROUPS,
    PLANTS,
    Experiment,
    Explored,
    Strike,
    default_experiment,
    places,
)
from wtg_gym.plotting.page.data import limits

N_STRIKES, N_PINS = 3, 2
#: While widgets are moved the page is brought up to date this long after the first change [ms].
_DELAY_MS = 30
_PANELS = (("rotor", "rotor speed [p.u.]"), ("power", "power [p.u.]"), ("ratio", "tip-speed ratio [–]"))
#: Of the run, and of the pinned ones: dashes and width.
_LOOKS: tuple[tuple[list[int], float], ...] = (([], 2.4), ([7, 4], 1.4), ([2, 3], 1.4))
#: A law whose numbers have been changed.
_OWN = "my-law"
_PINS = "A", "B"


def _tau_text(tau: float) -> str:
    return "∞" if math.isinf(tau) else f"{tau:g}"


#: Time constants of the damping to choose from [s]: those of every strategy, and a good many others.
_TAUS = {
    _tau_text(tau): tau
    for tau in sorted(
        {0.0, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0, 20.0, 50.0, math.inf}
        | {get_law(name).damping_time_constant_s for name in STRATEGY_NAMES}
    )
}


class ExplorePage:
    """One visitor's page; `document` is empty."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._waits, self._quiet = False, False
        self._shown: Explored | None = None
        self._pinned: list[Explored] = []
        start = default_experiment(next(iter(PLANTS)))
        self._make_widgets(start)
        self._sources = [
            ColumnDataSource(name=name, data={column: [] for column in self._columns()})
            for name in ("run", "pin-A", "pin-B")
        ]
        self._strikes = ColumnDataSource(name="strikes", data={"x": []})
        self._curve = ColumnDataSource(name="curve", data={"f": [], "p": []})
        self._path = ColumnDataSource(name="path", data={"f": [], "p": []})
        self._point = ColumnDataSource(name="point", data={"f": [], "p": []})
        self._charts = self._make_charts()
        self._texts = {name: look.text(name) for name in ("problem", "numbers", "pins", "command")}
        legend = look.text(
            "legend", f"{look.groups_in_colour(MOST_GROUPS)}; pinned runs are dashed (A) and dotted (B)."
        )
        for root in (*self._widgets.values(), *self._charts.values(), *self._texts.values(), legend):
            document.add_root(root)
        variables = {"n_groups": MOST_GROUPS, "n_strikes": N_STRIKES}
        look.frame(document, "explore", "wtg_gym: try out wind, events, laws and grids", variables)
        self._put(start)
        self._draw()

    # --- widgets -----------------------------------------------------------------------------------------------------

    def _make_widgets(self, start: Experiment) -> None:
        self._widgets: dict[str, Any] = {}
        wide = {"sizing_mode": "stretch_width"}

        def add(
            name: str, widget: Any, change: Callable[[Any], None] = lambda _: None, attribute: str = "value"
        ) -> None:
            self._widgets[name] = widget
            widget.on_change(attribute, self._then_drawn(change))

        def slider(name: str, title: str, low: float, high: float, step: float, *change: Any, **more: Any) -> None:
            own = Slider(name=name, title=title, start=low, end=high, step=step, value=low, **wide, **more)
            add(name, own, *change)

        plants = Select(name="plant", options=list(PLANTS.items()), value=start.plant, **wide)
        add("plant", plants, lambda name: self._put(default_experiment(name)))
        slider("inertia", "inertia, factor", 0.1, 2.0, 0.05)
        slider("droop", "droop [p.u.]", 0.01, 0.15, 0.005, format="0.000")
        slider("groups", "WTG groups", 1, MOST_GROUPS, 1, self._other_groups)
        slider("duration", "length [s]", 20, 120, 10)
        add("common", Checkbox(name="common", label="one wind for all groups", active=True), attribute="active")
        for j in range(MOST_GROUPS):
            slider(f"wind{j}", f"group {1 + j} [m/s]", 3.0, 25.0, 0.1, self._other_wind, bar_color=group_colour(j))
        options = [*STRATEGY_NAMES, (_OWN, "changed by hand")]
        add("law", Select(name="law", options=options, value=REFERENCE_STRATEGY, **wide), self._other_law)
        for corner in ("min", "nominal", "max"):
            slider(f"k_{corner}", f"k_{corner}", 0.0, 2.0, 0.005, self._changed_law, format="0.000")
        tau = CategoricalSlider(name="tau", title="τ [s]", categories=list(_TAUS), value="∞", **wide)
        add("tau", tau, self._changed_law)
        for i in range(N_STRIKES):
            kinds = Select(name=f"kind{i}", title=f"event {1 + i}", options=list(KINDS.items()), **wide)
            add(f"kind{i}", kinds, partial(self._other_kind, i))
            add(f"place{i}", Select(name=f"place{i}", title="where", options=[], **wide))
            slider(f"time{i}", "when [s]", 0.0, 60.0, 0.5)
            slider(f"power_mw{i}", "size [MW]", -100.0, 100.0, 1.0)
        which = RadioButtonGroup(name="which", labels=["1"], active=0)
        which.on_change("active", lambda _attribute, _old, _new: self._draw_characteristic())
        self._widgets["which"] = which
        for name, label, act in (("pin", "Pin this run", self._pin), ("unpin", "Remove pins", self._unpin)):
            self._widgets[name] = Button(name=name, label=label)
            self._widgets[name].on_click(act)
        area = TextAreaInput(name="json", title="scenario", rows=3, max_length=None, **wide)
        self._widgets["json"] = area
        copy = Button(name="copy", label="Copy as JSON", button_type="primary")
        copy.js_on_click(
            CustomJS(
                args={"area": area, "button": copy},
                code="""navigator.clipboard.writeText(area.value).then(
                    () => { button.label = "Copied" }, () => { button.label = "Copy it from below" });
                    setTimeout(() => { button.label = "Copy as JSON" }, 2000)""",
            )
        )
        self._widgets["copy"] = copy

    @contextlib.contextmanager
    def _quietly(self) -> Iterator[None]:
        """Set widgets without a run for each of them."""
        before, self._quiet = self._quiet, True
        try:
            yield
        finally:
            self._quiet = before

    def _put(self, experiment: Experiment) -> None:
        """Set every widget."""
        w, n = self._widgets, len(experiment.wind_m_s)
        with self._quietly():
            w["plant"].value, w["groups"].value, w["duration"].value = experiment.plant, n, experiment.duration_s
            w["groups"].disabled = experiment.plant != "paper"
            w["inertia"].value, w["droop"].value = experiment.inertia_scale, experiment.governor_droop
            w["common"].active = len(set(experiment.wind_m_s)) == 1
            for j in range(MOST_GROUPS):
                w[f"wind{j}"].value = experiment.wind_m_s[min(j, n - 1)]
            self._put_law(experiment.law)
            for i in range(N_STRIKES):
                strike = experiment.strikes[i] if i < len(experiment.strikes) else Strike()
                w[f"kind{i}"].value, w[f"time{i}"].value = strike.kind, strike.time_s
                w[f"power_mw{i}"].value = strike.power_mw
                self._offer_places(i, strike.place)
            self._offer_groups(n)

    def _put_law(self, law: TrackingLaw) -> None:
        w = self._widgets
        w["law"].value = law.name
        w["k_min"].value, w["k_nominal"].value, w["k_max"].value = law.k_min, law.k_nominal, law.k_max
        w["tau"].value = _tau_text(law.damping_time_constant_s)

    def _offer_places(self, i: int, place: str = "") -> None:
        """Offer where an event of the chosen kind may strike, and hide what it does not have."""
        w = self._widgets
        options = places(w[f"kind{i}"].value, round(w["groups"].value))
        w[f"place{i}"].options = options
        w[f"place{i}"].value = place if place in options else next(iter(options), "")
        w[f"place{i}"].visible = w[f"time{i}"].visible = bool(options)
        w[f"power_mw{i}"].visible = w[f"kind{i}"].value == "load_step"

    def _offer_groups(self, n: int) -> None:
        w = self._widgets
        w["which"].labels = [f"group {1 + j}" for j in range(n)]
        w["which"].active = min(w["which"].active or 0, n - 1)
        for j in range(MOST_GROUPS):
            w[f"wind{j}"].visible = j < n

    def _law(self) -> TrackingLaw:
        w = self._widgets
        name = w["law"].value
        if name != _OWN:
            return get_law(name)
        k = {corner: float(w[corner].value) for corner in ("k_min", "k_nominal", "k_max")}
        return TrackingLaw(name=_OWN, damping_time_constant_s=_TAUS[w["tau"].value], **k)

    def _experiment(self) -> Experiment:
        w = self._widgets
        strikes = [
            Strike(
                kind=w[f"kind{i}"].value or "",
                time_s=float(w[f"time{i}"].value),
                place=w[f"place{i}"].value or "",
                power_mw=float(w[f"power_mw{i}"].value),
            )
            for i in range(N_STRIKES)
        ]
        return Experiment(
            plant=w["plant"].value,
            wind_m_s=tuple(float(w[f"wind{j}"].value) for j in range(round(w["groups"].value))),
            strikes=tuple(strike for strike in strikes if strike.kind),
            law=self._law(),
            inertia_scale=float(w["inertia"].value),
            governor_droop=float(w["droop"].value),
            duration_s=float(w["duration"].value),
        )

    # --- changes -----------------------------------------------------------------------------------------------------

    def _then_drawn(self, change: Callable[[Any], None]) -> Any:
        """Return what a widget calls at a change by hand: others follow its new value, and the run is drawn anew."""

        def changed(_attribute: str, _old: Any, new: Any) -> None:
            if self._quiet:
                return
            with self._quietly():
                change(new)
            self._draw_soon()

        return changed

    def _draw_soon(self) -> None:
        """Draw in a moment; many changes that come together are one."""
        if not self._waits:
            self._waits = True
            self._document.add_timeout_callback(self._draw, _DELAY_MS)

    def _other_groups(self, n: float) -> None:
        self._offer_groups(round(n))
        for i in range(N_STRIKES):
            self._offer_places(i, self._widgets[f"place{i}"].value)

    def _other_wind(self, wind_m_s: float) -> None:
        if self._widgets["common"].active:
            for j in range(MOST_GROUPS):
                self._widgets[f"wind{j}"].value = wind_m_s

    def _other_kind(self, i: int, _kind: str) -> None:
        self._offer_places(i)

    def _other_law(self, name: str) -> None:
        if name != _OWN:
            self._put_law(get_law(name))

    def _changed_law(self, _value: Any) -> None:
        self._widgets["law"].value = _OWN

    def _pin(self) -> None:
        if self._shown is not None and len(self._pinned) < N_PINS:
            self._pinned.append(self._shown)
            self._show()

    def _unpin(self) -> None:
        self._pinned = []
        self._show()

    # --- pictures ----------------------------------------------------------------------------------------------------

    def _columns(self) -> list[str]:
        return ["t", "frequency", *(f"{name}-{j}" for name, _ in _PANELS for j in range(MOST_GROUPS))]

    def _make_charts(self) -> dict[str, Any]:
        charts = {"frequency": look.chart("frequency", "frequency [Hz]", 200, 60.0)}
        look.show_at_least(charts["frequency"], 49.8, 50.1)
        look.mark(charts["frequency"], *limits("standard")["frequency"].values())
        for place, (name, title) in enumerate(_PANELS):
            charts[name] = look.chart(name, title, 160, 60.0, time_axis=place == len(_PANELS) - 1)
        for name, made in charts.items():
            made.x_range = charts["frequency"].x_range
            look.mark_events(made, self._strikes)
            # The run itself on top.
            for source, (dash, width) in reversed(list(zip(self._sources, _LOOKS, strict=True))):
                if name == "frequency":
                    made.line("t", name, source=source, color=look.YOURS, line_dash=dash, line_width=width)
                    continue
                for j in range(MOST_GROUPS):
                    look_of_line = {"color": group_colour(j), "line_dash": dash, "line_width": width}
                    made.line("t", f"{name}-{j}", source=source, **look_of_line)
        title = "power over frequency: steady states, path"
        made = look.plain_chart("characteristic", title, 240, x_axis_label="frequency [Hz]")
        made.yaxis.axis_label = "power [p.u.]"
        made.line("f", "p", source=self._curve, color=SOFT, line_width=2)
        self._path_line = made.line("f", "p", source=self._path, line_width=2)
        self._point_mark = made.scatter("f", "p", source=self._point, size=10)
        charts["characteristic"] = made
        return charts

    def _draw(self) -> None:
        """Run what the widgets say, or say why it cannot be run."""
        self._waits = False
        try:
            self._shown = self._experiment().run()
        except ValueError as error:
            before = " Shown is the last run that was possible." if self._shown is not None else ""
            words = f"<p class=bad><b>This cannot be run:</b> {look.sentence(str(error))}{before}</p>"
            self._texts["problem"].text = words
            return
        failure = self._shown.failure
        self._texts["problem"].text = (
            f"<p class=bad><b>The run failed</b> {look.sentence(failure)}</p>" if failure else ""
        )
        self._show()

    def _show(self) -> None:
        """Draw the run and the pinned ones."""
        shown = self._shown
        if shown is None:
            return
        runs: list[Explored | None] = [shown, *self._pinned, *[None] * (N_PINS - len(self._pinned))]
        for source, run in zip(self._sources, runs, strict=True):
            source.data = self._data(None if run is None else run.recording)
        self._charts["frequency"].x_range.end = max(run.experiment.duration_s for run in runs if run is not None)
        self._strikes.data = {"x": [event.time_s for event in shown.experiment.scenario().events]}
        pinned = list(zip(_PINS, self._pinned, strict=False))
        rows = [["this run", *shown.numbers().values()]]
        rows += [[f"pin {name}", *run.numbers().values()] for name, run in pinned]
        self._texts["numbers"].text = look.table(["", *shown.numbers()], rows)
        pins = [f"{name}: {describe(run.experiment)}" for name, run in pinned]
        self._texts["pins"].text = "<br>".join(f"<span class=soft>{html.escape(pin)}</span>" for pin in pins)
        self._widgets["pin"].disabled = len(self._pinned) == N_PINS
        self._widgets["unpin"].disabled = not self._pinned
        self._widgets["json"].value = shown.experiment.to_json()
        law = shown.experiment.law_toml()
        saved = "with the scenario in explored.json"
        self._texts["command"].text = (
            f"<p class=soft>The same run in a terminal, {saved}{' and this in law.toml' if law else ''}:</p>"
            f"<p><code>{html.escape(shown.experiment.command())}</code></p>"
            + (f"<p><code>{html.escape(law).strip().replace(chr(10), '<br>')}</code></p>" if law else "")
        )
        self._draw_characteristic()

    def _data(self, recording: Recording | None) -> dict[str, Any]:
        if recording is None:
            return {name: [] for name in self._columns()}
        data: dict[str, Any] = {"t": recording.time_s, "frequency": recording.frequency_hz[0]}
        values = {
            "rotor": recording.rotor_speed_pu[0],
            "power": recording.power_pu[0],
            "ratio": recording.tip_speed_ratio[0],
        }
        for name, _ in _PANELS:
            for j in range(MOST_GROUPS):
                own = values[name][:, j] if j < recording.n_wtg else np.full(recording.time_s.size, np.nan)
                data[f"{name}-{j}"] = own
        return data

    def _draw_characteristic(self) -> None:
        shown, group = self._shown, self._widgets["which"].active or 0
        if shown is None or group >= shown.recording.n_wtg:
            return
        curve, recording = shown.group_characteristic(group), shown.recording
        self._curve.data = {"f": shown.nominal_hz * curve.frequency_pu, "p": curve.power_pu}
        frequency, power = recording.frequency_hz[0], recording.power_pu[0][:, group]
        there = np.flatnonzero(np.isfinite(frequency))
        self._path.data = {"f": frequency[there], "p": power[there]}
        self._point.data = {"f": frequency[there[-1:]], "p": power[there[-1:]]}
        for drawn in (self._path_line, self._point_mark):
            drawn.glyph.line_color = group_colour(group)
        self._point_mark.glyph.fill_color = group_colour(group)


def describe(experiment: Experiment) -> str:
    """Return an experiment in one line."""
    wind = "/".join(f"{v:g}" for v in dict.fromkeys(experiment.wind_m_s))
    strikes = ", ".join(f"{describe_event(event)} at {event.time_s:g} s" for event in experiment.scenario().events)
    return (
        f"{experiment.law.name}, {wind} m/s, inertia {experiment.inertia_scale:g}, "
        f"droop {experiment.governor_droop:g}; {strikes or 'no event'}"
    )
