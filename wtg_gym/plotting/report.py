"""The page of a report about an entry: HTML with its pictures inside, or Markdown with them beside.

Both have the same sections, each of a sentence, a table and pictures.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.evaluation.damping import GRID, WIND_M_S, Damping
from wtg_gym.evaluation.grid_tests import GRID_TESTS
from wtg_gym.evaluation.report import N_OF_ENERGY, SUITE, DrawnScenario, Recorded, Report
from wtg_gym.evaluation.statistics import Interval
from wtg_gym.evaluation.table import signed_interval
from wtg_gym.files import markdown_table
from wtg_gym.plotting import style
from wtg_gym.plotting.margin import by_entry, plot_over_margin
from wtg_gym.plotting.trajectories import mark_end, mark_instants

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Oscillations that are listed of a loop.
_N_MODES = 5
#: Damping ratio below which an oscillation is weakly damped.
_WEAK = 0.05
_MARGIN_CAPTION = "Cost (J + J0, relative) and share of bad runs over the reserve margin"
#: What is drawn of a scenario, by its label.
_PANELS: Mapping[str, Callable[[Recorded], np.ndarray]] = {
    "frequency [Hz]": lambda run: run.frequency_hz,
    "wind, mean [m/s]": lambda run: run.wind_m_s,
    "power of all turbines [MW]": lambda run: run.power_mw,
    "slowest rotor [p.u.]": lambda run: run.rotor_speed_pu,
}
#: Text of a page, without anything from elsewhere.
_PAGE = """\
<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title><style>
body {{ font: 16px/1.5 system-ui, sans-serif; color: #1b1b1b; background: #fff; margin: 0 auto; padding: 1rem;
  max-width: 76rem; }}
h1 {{ font-size: 1.6rem; overflow-wrap: anywhere; }} h2 {{ font-size: 1.2rem; margin: 2.2rem 0 .3rem; }}
p {{ max-width: 48rem; }} code {{ overflow-wrap: anywhere; }}
.wide {{ overflow-x: auto; }} table {{ border-collapse: collapse; font-size: .9rem; }}
th, td {{ padding: .3rem .7rem .3rem 0; text-align: left; vertical-align: top; border-bottom: 1px solid #ddd; }}
.number {{ text-align: right; white-space: nowrap; }}
.pictures {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 21rem), 1fr)); gap: 1rem; }}
figure {{ margin: 0; max-width: 28rem; }} img {{ width: 100%; height: auto; }} figcaption {{ font-size: .9rem; }}
</style></head><body>
{body}
</body></html>
"""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure, its name among files, and a caption with a command, if any."""

    name: str
    figure: Figure
    caption: str = ""
    command: str = ""


@dataclass(frozen=True, kw_only=True)
class Section:
    """A heading, a sentence, and a table or pictures; `numbers` are the columns of numbers."""

    heading: str
    sentence: str
    header: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    numbers: Sequence[int] = ()
    note: str = ""
    pictures: Sequence[Picture] = field(default=())


def report_html(report: Report) -> str:
    """Return the page as one HTML file, which loads nothing."""
    head = f"<h1>{escape(_title(report))}</h1>\n<p>{escape(_subtitle(report))}</p>"
    body = "\n".join([head, *map(_html, sections(report))])
    return _PAGE.format(title=escape(_title(report)), body=body)


def report_markdown(report: Report, stem: str) -> dict[str, bytes | str]:
    """Return the files of the page in Markdown by their names; pictures are called after the page's stem."""
    found = sections(report)
    pictures = {f"{stem}-{each.name}.svg": each for section in found for each in section.pictures}
    files: dict[str, bytes | str] = {name: style.figure_bytes(each.figure, "svg") for name, each in pictures.items()}
    text = [f"# {_plain(_title(report))}", _plain(_subtitle(report)), *(_markdown(each, stem) for each in found)]
    return {**files, f"{stem}.md": "\n\n".join(text) + "\n"}


def _html(section: Section) -> str:
    parts = [f"<section><h2>{escape(section.heading)}</h2>", f"<p>{escape(section.sentence)}</p>"]
    if section.rows:
        cells = [
            "".join(
                f"<{tag}{' class=number' if column in section.numbers else ''}>{escape(cell)}</{tag}>"
                for column, cell in enumerate(row)
            )
            for tag, row in (("th", section.header), *(("td", row) for row in section.rows))
        ]
        parts.append(f'<div class="wide"><table>{"".join(f"<tr>{row}</tr>" for row in cells)}</table></div>')
    if section.note:
        parts.append(f"<p>{escape(section.note)}</p>")
    figures = []
    for each in section.pictures:
        data = base64.b64encode(style.figure_bytes(each.figure, "svg")).decode()
        caption = escape(each.caption) + (f"<br><code>{escape(each.command)}</code>" if each.command else "")
        image = f'<img alt="{escape(each.caption)}" src="data:image/svg+xml;base64,{data}">'
        figures.append(f"<figure>{image}<figcaption>{caption}</figcaption></figure>")
    if figures:
        parts.append(f'<div class="pictures">{"".join(figures)}</div>')
    return "\n".join([*parts, "</section>"])


def _plain(text: str) -> str:
    """Return text without what Markdown takes for HTML or a command."""
    return "".join(f"\\{sign}" if sign in "\\`*_[]<>#|" else sign for sign in text)


def _markdown(section: Section, stem: str) -> str:
    parts = [f"## {section.heading}", _plain(section.sentence)]
    if section.rows:
        cells = [[_plain(cell) for cell in row] for row in section.rows]
        parts.append(markdown_table(section.header, cells, right=section.numbers))
    parts += [_plain(section.note)] * bool(section.note)
    for each in section.pictures:
        parts.append(f"![{_plain(each.caption)}]({stem}-{each.name}.svg)")
        parts += [f"{_plain(each.caption)}:\n\n```sh\n{each.command}\n```"] * bool(each.command)
    return "\n\n".join(parts)


# --- sections --------------------------------------------------------------------------------------------------------


def sections(report: Report) -> list[Section]:
    """Return the sections of the page in their order."""
    parts = (_score, _over_margin, _bad_runs, _scenarios, _grid_tests, _faults, _energy, _damping)
    return [part(report) for part in parts]


def _title(report: Report) -> str:
    return f"Report: {report.entry.label}"


def _subtitle(report: Report) -> str:
    entry, versions = report.entry, report.results.versions
    parts = [entry.description, f"Kind: {entry.kind}, on top of the law {entry.law.name}."]
    parts.append(f"Source: {entry.source}." if entry.source else "")
    origin = "stored results" if report.stored else "played for this page"
    parts.append(f"Scores: {origin}, wtg_gym {versions['wtg_gym']}.")
    return " ".join(part for part in parts if part)


def _hundred(report: Report) -> str:
    return report.results.task.hundred


def _percent(count: float, n: int) -> str:
    return f"{100.0 * count / n:.1f}"


def _interval(value: Interval, digits: int = 1) -> tuple[str, str]:
    """Return a value and its interval, empty where there is no spread."""
    texts = [f"{round(each, digits) + 0.0:.{digits}f}" for each in (value.value, value.low, value.high)]
    return texts[0], "" if value.low == value.high else f"{texts[1]} … {texts[2]}"


def _chance(value: float) -> str:
    return f"{value:.2g}" if value >= 0.001 else "below 0.001"


def _score(report: Report) -> Section:
    row, results = report.row, report.results
    assert row.score is not None
    counts = {name: at.size for name, at in results.groups.items()}
    values = {"all, strata count alike": row.score, **row.strata}
    rows = [(name, str(counts.get(name, len(results.seeds))), *_interval(each)) for name, each in values.items()]
    zero, hundred = results.task.anchors
    if row.marked:
        mark = f"✓: no less reliable than {hundred}: the chance test below finds no more bad or lost runs."
    else:
        bad = report.bad
        mark = (
            f"No ✓: less reliable than {hundred}: were both equally prone, so many more bad runs had a chance of "
            f"{_chance(bad.chance)}, and so many more lost runs one of {_chance(bad.chance_lost)}; "
            "below 0.05 the mark is withheld."
        )
    return Section(
        heading="Score",
        sentence=f"Points on {len(results.seeds)} test scenarios of {SUITE}, by how much power the grid has in "
        f"reserve: 0 is the published law ({zero}), 100 that law tuned to this grid ({hundred}); more is better.",
        header=("reserve", "scenarios", "score [points]", "95 % interval"),
        rows=rows,
        numbers=(1, 2, 3),
        note=" ".join([mark, f"{results.unadjusted.capitalize()}." if results.unadjusted else ""]).strip(),
    )


def _over_margin(report: Report) -> Section:
    entries, hundred = by_entry(report.results), _hundred(report)
    return Section(
        heading="Where control decides",
        sentence="Cost and bad runs over the reserve margin, the power that turbines and machines could still add in "
        f"per cent of the load: below 1, an entry pays less than {hundred}.",
        pictures=[
            Picture(name="margin", figure=plot_over_margin(entries, hundred, stacked=True), caption=_MARGIN_CAPTION)
        ],
    )


def _bad_runs(report: Report) -> Section:
    bad, name, hundred = report.bad, report.entry.name, _hundred(report)
    neither = bad.n - bad.both - bad.entry_alone - bad.anchor_alone
    counts = {
        "both": bad.both,
        f"{name} only": bad.entry_alone,
        f"{hundred} only": bad.anchor_alone,
        "neither": neither,
    }
    return Section(
        heading="Bad runs",
        sentence="A run is bad if the grid is lost or its frequency deviates by more than 0.8 Hz, where customers are "
        f"disconnected; here the entry and {hundred} meet the same scenarios.",
        header=("bad under", "runs", "of all [%]"),
        rows=[(who, str(count), _percent(count, bad.n)) for who, count in counts.items()],
        numbers=(1, 2),
        note=f"Difference to {hundred}: {signed_interval(bad.difference)} percentage points, strata counting alike. "
        f"Were both equally prone, so many more bad runs than {hundred}'s had a chance of {_chance(bad.chance)} "
        "(McNemar's paired exact test, one side).",
    )


def _scenarios(report: Report) -> Section:
    worst = report.drawn_are_worst
    what = f"The {len(report.drawn)} scenarios that cost the entry most" if worst else "Scenarios that were asked for"
    return Section(
        heading="Worst scenarios" if worst else "Scenarios",
        sentence=f"{what}, beside {_hundred(report)} in the same scenario; dotted lines are events, a cross is the "
        "loss of the grid, and each command plays its scenario again.",
        pictures=[_scenario_picture(report, each) for each in report.drawn],
    )


def _scenario_picture(report: Report, drawn: DrawnScenario) -> Picture:
    paid = [f"{name} {run.costs[0]:.0f}{_ended(run)}" for name, run in drawn.runs.items()]
    events = sorted(drawn.scenario.events, key=lambda event: event.time_s)
    happened = "; ".join(f"{event.time_s:g} s: {event.words}" for event in events) or "no events"
    return Picture(
        name=f"seed-{drawn.seed}",
        figure=_plot_scenario(drawn),
        caption=f"{drawn.scenario.name}. Cost [-]: {', '.join(paid)}. {happened}.",
        command=f"wtg-gym evaluate --suite {SUITE} --split test --seeds {drawn.seed} --entries {report.spec}",
    )


def _ended(run: Recorded) -> str:
    return f" (lost: {run.failures[0]})" if run.failures[0] else ""


@style.printed
def _plot_scenario(drawn: DrawnScenario) -> Figure:
    """Draw a scenario's runs in a column of panels, readable on a phone."""
    figure = style.new_figure(style.SINGLE_COLUMN_MM, 125.0)
    looks = style.strategy_looks(drawn.runs)
    panels = figure.subplots(len(_PANELS), 1, sharex=True)
    for axes, (label, values) in zip(panels, _PANELS.items(), strict=True):
        for name, run in drawn.runs.items():
            series = values(run)[:, 0]
            axes.plot(run.time_s, series, color=looks[name].colour, linestyle=looks[name].dashes, label=name)
            if run.failures[0]:
                last = int(np.flatnonzero(np.isfinite(series))[-1])
                mark_end(axes, float(run.time_s[last]), float(series[last]), looks[name].colour)
        mark_instants(axes, drawn.scenario, numbered=False)
        axes.set_title(label, loc="left")
    panels[-1].set_xlabel("time [s]")
    panels[0].set_xlim(0.0, drawn.scenario.duration_s)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _grid_tests(report: Report) -> Section:
    verdicts = report.grid_tests
    rows, note = [], ""
    if isinstance(verdicts, str):
        note = f"The entry cannot play them: {verdicts}"
    else:
        for name, (passed, figure) in verdicts.items():
            rows.append((name, "passed" if passed else "failed", figure, GRID_TESTS[name].criterion))
        note = f"Passed: {sum(passed for passed, _ in verdicts.values())} of {len(verdicts)}."
    return Section(
        heading="Operators' tests",
        sentence="Tests that grid operators ask of grid-forming plants, each in a grid of its own with exact sensors; "
        "p.u. of power are of the turbines' rating, those of voltage of the nominal one.",
        header=("test", "verdict", "measured", "limit"),
        rows=rows,
        note=note,
    )


def _faults(report: Report) -> Section:
    rows = [
        (each.fault, *_interval(each.change), f"{each.bad_before} → {each.bad_after}") for each in report.with_faults
    ]
    return Section(
        heading="Faults of sensors",
        sentence="Change of the score, in points, where measurements are worse or those of the largest group fail, on "
        f"the first {report.n_with_faults} scenarios alone.",
        header=("fault", "change [points]", "95 % interval", "bad runs"),
        rows=rows,
        numbers=(1, 2, 3),
        note="" if rows else "A law has no sensors: nothing changes.",
    )


def _energy(report: Report) -> Section:
    most, n = report.energy.get("mppt"), min(N_OF_ENERGY, len(report.results.seeds))
    rows = [
        (
            name,
            f"{each.power_mw:.1f}",
            f"{each.energy_mwh:.3f}",
            f"{100.0 * (each.energy_mwh / most.energy_mwh - 1.0):+.1f}" if most else "",
            f"{each.borrowed_mj:.0f}",
            f"{each.repaid_mj:.0f}",
        )
        for name, each in report.energy.items()
    ]
    return Section(
        heading="Energy",
        sentence="Power and energy of all turbines into the grid, and the kinetic energy that their rotors lent and "
        f"got back, means over the {report.n_of_energy} of the first {n} scenarios, of three minutes each, "
        "in which all kept all groups.",
        header=("entry", "power [MW]", "energy [MWh]", "against mppt [%]", "borrowed [MJ]", "repaid [MJ]"),
        rows=rows,
        numbers=(1, 2, 3, 4, 5),
        note="mppt takes the most from the wind in steady operation. Gusts move rotors too: compare the rows."
        if rows
        else "In none of the first scenarios did the entry, the anchor and mppt all keep all groups.",
    )


def _damping(report: Report) -> Section:
    sentence = (
        f"Oscillations of the grid with the entry in the loop, at rest at {WIND_M_S:g} m/s with a governor droop of "
        f"{GRID['governor_droop']:g} p.u., {100.0 * GRID['committed']:g} % of the machine's units and "
        f"{100.0 * GRID['load_level']:g} % of the load: a damping ratio below 0 grows, below {_WEAK:g} is weak."
    )
    if isinstance(report.damping, str):
        return Section(heading="Damping", sentence=sentence, note=f"There is none: {report.damping}")
    rows = [
        (name, f"{mode.frequency_hz:.2f}", f"{mode.damping_ratio:.3f}", f"{mode.eigenvalue.real:.3f}", mode.slope)
        for name, found in report.damping.items()
        for mode in found.modes[:_N_MODES]
    ]
    return Section(
        heading="Damping",
        sentence=sentence,
        header=("in the loop", "frequency [Hz]", "damping ratio [-]", "rate [1/s]", "slope of the law"),
        rows=rows,
        numbers=(1, 2, 3),
        note=" ".join(_rest(name, found) for name, found in report.damping.items())
        + " The least damped are listed, of an action that is held for 0.5 s; the law has one slope below nominal "
        "frequency and another above. Sensors have their filters and mean delay, and no noise.",
    )


def _rest(name: str, found: Damping) -> str:
    """Return where a loop rests, and whether it does."""
    if not found.rests:
        return f"{name} does not come to rest: the frequency moves by {1000.0 * found.moves_hz:.1f} mHz by itself."
    where = f"{name} rests at {found.frequency_hz:.3f} Hz with actions of {found.largest_action:.3f} at most"
    return f"{where}, and is {'stable' if found.largest_rate < 1e-6 else 'not stable'}."
