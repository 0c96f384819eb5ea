"""The report on one entry of version v1, on scenarios of its standard suite: what it does, where it fails.

A page of sections, in Markdown with its pictures beside, or made HTML of, with its pictures inside.
"""

import base64
import functools
import itertools
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

import numpy as np

from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import damping, faults, grid_tests, recording, score, statistics, table
from wtg_gym.evaluation.results import Results, score_difference
from wtg_gym.evaluation.summary import EntrySummary, Runs, lost, lost_or_beyond
from wtg_gym.files import markdown_table
from wtg_gym.physics.scenario import Scenario
from wtg_gym.plotting import style, trajectories
from wtg_gym.policies import Entry, entry_folder
from wtg_gym.progress import Progress
from wtg_gym.scenarios.suites import DEFAULT_SUITE, get_suite

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUITE = DEFAULT_SUITE
SETTINGS = EnvSettings(suite=SUITE)
#: The yardstick of energy, which captures what the wind gives.
_MOST_ENERGY = "mppt"
#: Test scenarios that sensors fail in, and that energy is counted in; scenarios that are drawn.
N_WITH_FAULTS, N_OF_ENERGY, N_DRAWN = 60, 60, 3
#: Oscillations that are listed of a loop, and the damping ratio below which one is weakly damped.
_N_MODES, _WEAK = 5, 0.05
#: What is drawn of a scenario, by its label.
_PANELS: Mapping[str, Callable[[recording.Recorded], statistics.Floats]] = {
    "frequency [Hz]": lambda run: run.frequency_hz,
    "wind, mean [m/s]": lambda run: run.wind_m_s,
    "power of all turbines [MW]": lambda run: run.power_mw,
    "slowest rotor [p.u.]": lambda run: run.rotor_speed_pu,
    "load not served [MW]": lambda run: run.unserved_mw,
}
#: Margin, J + J0 and whether the run is bad, of each scenario, (n_scenarios,) each.
OverMargin = tuple[statistics.Floats, statistics.Floats, statistics.Floats]
#: Edges of the bins of the margin [-]; the last one holds all beyond.
_EDGES = (-0.10, -0.05, 0.0, 0.05, 0.10, 0.15, 0.20, 0.30, 0.50)
#: A page with its $title and $body, without anything from elsewhere.
_PAGE = Path(__file__).with_name("page.html")


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A figure, its name among files, and a caption with a command, if any."""

    name: str
    figure: "Figure"
    caption: str
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
    pictures: Sequence[Picture] = ()

    def markdown(self, stem: str) -> str:
        """Return the section as Markdown, with pictures in files that are called after the page's stem."""
        cells = [[_plain(cell) for cell in row] for row in self.rows]
        rows = markdown_table(self.header, cells, right=self.numbers) if cells else ""
        parts = [f"## {self.heading}", _plain(self.sentence), rows, _plain(self.note)]
        for picture in self.pictures:
            if picture.command:
                parts.append(f"{_plain(picture.caption)}\n\n```sh\n{picture.command}\n```")
            parts.append(f"![{_plain(picture.caption)}]({stem}-{picture.name}.svg)")
        return "\n\n".join(filter(None, parts))


def _plain(text: str) -> str:
    """Return text without what Markdown takes for HTML or a command."""
    return "".join(f"\\{sign}" if sign in "\\`*_[]<>#&" else sign for sign in text)


@dataclass(frozen=True, kw_only=True)
class Report:
    """An entry of version v1 with its results."""

    entry: Entry
    spec: str  # by which commands name the entry
    results: Results  # with those of the version's references
    stored: bool  # whether the results were read, not played
    drawn: Sequence[int] = ()  # seeds of the scenarios to draw; empty for those that cost the entry most
    n_threads: int | None = None  # to step with

    @property
    def hundred(self) -> str:
        """Name of the law that scores 100."""
        return self.results.task.hundred

    @property
    def row(self) -> EntrySummary:
        """The entry's row in the ranking."""
        return next(row for row in self.results.ranking if row.name == self.entry.name)

    def chance(self, event: Callable[[Runs], statistics.Floats]) -> str:
        """Return the chance of so many more events than under the law at 100, were both equally prone."""
        chance = statistics.sign_test(*(event(self.results.runs[name]) for name in (self.entry.name, self.hundred)))
        return f"{chance:.2g}" if chance >= 0.001 else "below 0.001"


def stored_results(folder: Path, split: str, entry: Entry) -> Results | None:
    """Return the :func:`part_of_entry` of a folder's results of the suite, if it has some of the same policy."""
    path = folder / f"{SUITE}-{split}.json"
    if not path.exists():
        return None
    results = Results.read(path)
    results.check_suite()
    return part_of_entry(results, entry)


def part_of_entry(results: Results, entry: Entry) -> Results | None:
    """Return what results hold of an entry and the version's references; None without episodes of the same policy."""
    run, rows = (entry.name, entry.training_seed), {(row["name"], row["training_seed"]): row for row in results.entries}
    if entry.identity is None or run not in rows or rows[run]["sha256"] != entry.identity:
        return None
    kept = {name: row for name, row in rows.items() if name == run or name[0] in {*results.task.references} - {run[0]}}
    episodes = tuple(episode for episode in results.episodes if episode.run in kept)
    return replace(results, entries=tuple(kept.values()), episodes=episodes, failed=())


def report_files(report: Report, stem: str) -> dict[str, bytes | str]:
    """Play what the sections show, and return the page as `stem`.md, its pictures, and all in one as `stem`.html.

    Progress is shown on stderr. HTML needs markdown-it-py. A PolicyError says that the entry's policy fails.
    """
    entry, versions = report.entry, report.results.versions
    source = f"Source: {entry.source}." if entry.source else ""
    origin = "stored results" if report.stored else "played for this page"
    scores = f"Scores: {origin}, wtg_gym {versions['wtg_gym']}."
    beneath = "" if entry.policy is None else f", on top of the law {entry.law.name}"
    subtitle = [entry.description, f"Kind: {entry.kind}{beneath}.", source, scores]
    title, pictures = f"Report: {entry.label}", dict[str, bytes]()
    parts = [f"# {_plain(title)}", _plain(" ".join(filter(None, subtitle)))]
    with Progress("sections") as progress:
        for done, section_of in enumerate(_SECTIONS):
            progress.update(section_of.__name__.strip("_").replace("_", " "), done, len(_SECTIONS))
            section = section_of(report)
            parts.append(section.markdown(stem))
            for picture in section.pictures:
                pictures[f"{stem}-{picture.name}.svg"] = style.figure_bytes(picture.figure, "svg")
    page = "\n\n".join(parts) + "\n"
    return {**pictures, f"{stem}.md": page, f"{stem}.html": _html(title, page, pictures)}


def _html(title: str, page: str, pictures: Mapping[str, bytes]) -> str:
    """Return a page of Markdown as one of HTML, which loads nothing."""
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark", {"html": False, "xhtmlOut": False}).enable("table").render(page)
    for name, picture in pictures.items():
        data = base64.b64encode(picture).decode()
        body = body.replace(f'src="{name}"', f'src="data:image/svg+xml;base64,{data}"')
    return Template(_PAGE.read_text(encoding="utf-8")).substitute(title=escape(title), body=body)


def _interval(value: statistics.Interval) -> tuple[str, str]:
    text, low, high = (f"{round(number, 1) + 0.0:.1f}" for number in (value.value, value.low, value.high))
    return text, "" if value.low == value.high else f"{low} … {high}"


def _bad(runs: Runs) -> statistics.Floats:
    return lost_or_beyond(runs, get_suite(SUITE).nominal_hz)


def _score(report: Report) -> Section:
    row, results = report.row, report.results
    assert row.score is not None
    counts = {name: at.size for name, at in results.groups.items()}
    values = {"all, strata count alike": row.score, **row.strata}
    rows = [(name, str(counts.get(name, len(results.seeds))), *_interval(value)) for name, value in values.items()]
    zero, hundred = results.task.anchors
    if row.marked:
        mark = f"This entry has the mark ✓: the chance test below finds no more bad or lost runs than {hundred} has."
    else:
        mark = (
            f"No ✓: less reliable than {hundred}. If both were equally reliable, so many more bad runs would come with "
            f"a probability of {report.chance(_bad)}, so many more lost runs with {report.chance(lost)}; below 0.05 "
            "there is no mark."
        )
    return Section(
        heading="Score",
        sentence=f"Points on {len(results.seeds)} {results.split} scenarios of {SUITE}, by the power that the grid has "
        f"in reserve: 0 is the published law ({zero}), 100 that law tuned to this grid ({hundred}); more is better.",
        header=("reserve", "scenarios", "score [points]", "95 % interval"),
        rows=rows,
        numbers=(1, 2, 3),
        note=" ".join([mark, f"{results.unadjusted.capitalize()}." if results.unadjusted else ""]).strip(),
    )


def _where_control_decides(report: Report) -> Section:
    figure = plot_over_margin(over_margin(report.results), report.hundred, stacked=True)
    caption = "Cost (J + J0, relative) and share of bad runs over the reserve margin"
    return Section(
        heading="Where control decides",
        sentence="Cost and bad runs over the reserve margin, the power that turbines and machines could still add in "
        f"per cent of the load. Below 1 in (a) an entry pays less than {report.hundred}; J: cost, J0: a constant of "
        "the stratum; grey lines: limits of the strata.",
        pictures=[Picture(name="margin", figure=figure, caption=caption)],
    )


def over_margin(results: Results) -> dict[str, OverMargin]:
    """Return margin, J + J0 and whether the run is bad of each scenario, by entry, of the first training seed."""
    offsets, nominal_hz = score.cost_offsets(results.groups, results.task), get_suite(results.suite).nominal_hz
    by_entry = {}
    for name, runs in results.runs.items():
        margins, costs = (np.array([row.metrics[key] for row in runs[0]]) for key in ("reserve_margin", "cost"))
        by_entry[name] = margins, costs + offsets, lost_or_beyond(runs[:1], nominal_hz)[0]
    return by_entry


@style.printed
def plot_over_margin(entries: Mapping[str, OverMargin], hundred: str, *, stacked: bool = False) -> "Figure":
    """Draw cost relative to the law that scores 100, and the share of bad runs, over the reserve margin.

    The panels stand side by side, or `stacked` in a single column.
    """
    figure = style.new_figure(*((style.SINGLE_COLUMN_MM, 120.0) if stacked else (style.DOUBLE_COLUMN_MM, 70.0)))
    looks = style.law_looks(entries)
    panels = figure.subplots(*((2, 1) if stacked else (1, 2)))
    style.letter_panel(panels[0], "a", "(J + J0) over that of the law at 100 [-]")
    style.letter_panel(panels[1], "b", "runs lost or beyond 0.8 Hz [%]")
    for name, (margins, costs, bad) in entries.items():
        bins = [(margins >= low) & (margins < high) for low, high in itertools.pairwise(_EDGES)]
        bins = [chosen for chosen in bins if chosen.any()]
        middles = [100.0 * margins[chosen].mean() for chosen in bins]
        ratios = [np.exp(np.log(costs[chosen] / entries[hundred][1][chosen]).mean()) for chosen in bins]
        shares = [100.0 * bad[chosen].mean() for chosen in bins]
        for axes, values in zip(panels, (ratios, shares), strict=True):
            axes.plot(middles, values, color=looks[name].colour, linestyle=looks[name].dashes, label=name, marker=".")
    panels[0].set_yscale("log")
    largest = max(5.0, panels[0].get_ylim()[1])
    ticks = [tick for tick in (0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0) if tick <= largest]
    panels[0].set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    panels[0].minorticks_off()
    for axes in panels:
        for edge in (0.0, 10.0):
            axes.axvline(edge, color="0.8", linewidth=0.8, zorder=0)
        axes.set_xlabel("reserve margin [% of the load]")
    legend = panels[0].get_legend_handles_labels()
    figure.legend(*legend, loc="outside lower center", ncols=2 if stacked else len(entries))
    return figure


def _bad_runs(report: Report) -> Section:
    name, hundred = report.entry.name, report.hundred
    bad, of_hundred = (_bad(report.results.runs[label])[0] for label in (name, hundred))
    counts = {
        "both": bad * of_hundred,
        f"{name} only": bad * (1.0 - of_hundred),
        f"{hundred} only": of_hundred * (1.0 - bad),
        "neither": (1.0 - bad) * (1.0 - of_hundred),
    }
    difference, chance = report.row.lost_or_beyond_to_hundred, ""
    if difference is not None and difference.value > 0.0:
        chance = (
            f" By chance alone so many more would come with a probability of {report.chance(_bad)} (McNemar's paired "
            "exact test, one side)."
        )
    return Section(
        heading="Bad runs",
        sentence="A run is bad if the grid is lost or its frequency deviates by more than 0.8 Hz, where customers are "
        f"disconnected; here the entry and {hundred} meet the same scenarios.",
        header=("bad under", "runs", "of all [%]"),
        rows=[(under, f"{n.sum():.0f}", f"{100.0 * n.sum() / bad.size:.1f}") for under, n in counts.items()],
        numbers=(1, 2),
        note=f"Difference to {hundred}: {table.signed_interval(difference)} percentage points, strata counting alike."
        f"{chance}",
    )


def _scenarios(report: Report) -> Section:
    seeds, heading, chosen = report.drawn, "Scenarios", "Scenarios that were asked for"
    if not seeds:
        order = np.argsort(-report.results.pinned_costs[report.entry.name][0], kind="stable")
        seeds = [report.results.seeds[index] for index in order[:N_DRAWN]]
        heading, chosen = "Worst scenarios", f"The {len(seeds)} scenarios that cost the entry most"
    return Section(
        heading=heading,
        sentence=f"{chosen}, beside {report.hundred} in the same scenario; dotted lines are events, a cross is the "
        "loss of the grid, and each command plays its scenario again.",
        pictures=[_scenario_picture(report, int(seed)) for seed in seeds],
    )


def _scenario_picture(report: Report, seed: int) -> Picture:
    scenario = get_suite(SUITE).scenario(seed)
    entries = (report.entry, *entry_folder.load_entries(report.hundred))
    runs = {entry.name: recording.recorded(entry, SETTINGS, [scenario]) for entry in entries}
    failures = {name: f" (lost: {run.failures[0]})" if run.failures[0] else "" for name, run in runs.items()}
    paid = [f"{name} {run.costs[0]:.0f}{failures[name]}" for name, run in runs.items()]
    events = sorted(scenario.events, key=lambda event: event.time_s)
    happened = "; ".join(f"{event.time_s:g} s: {event.words}" for event in events) or "no events"
    return Picture(
        name=f"seed-{seed}",
        figure=_plot_scenario(scenario, runs),
        caption=f"{scenario.name}. Cost [-]: {', '.join(paid)}. {happened}.",
        command=f"wtg-gym evaluate --suite {SUITE} --split {report.results.split} --seeds {seed} "
        f"--entries {shlex.quote(report.spec)}",
    )


@style.printed
def _plot_scenario(scenario: Scenario, runs: Mapping[str, recording.Recorded]) -> "Figure":
    figure = style.new_figure(style.SINGLE_COLUMN_MM, 150.0)
    looks = style.law_looks(runs)
    panels = figure.subplots(len(_PANELS), 1, sharex=True)
    for axes, (label, values) in zip(panels, _PANELS.items(), strict=True):
        for name, run in runs.items():
            series, failed = values(run)[:, 0], bool(run.failures[0])
            trajectories.draw_run(axes, run.time_s, series, looks[name], failed=failed, label=name)
        trajectories.mark_instants(axes, scenario, numbered=False)
        axes.set_title(label, loc="left")
    panels[-1].set_xlabel("time [s]")
    panels[0].set_xlim(0.0, scenario.duration_s)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _verdict(test: grid_tests.GridTest, entry: Entry) -> tuple[str, str]:
    passed, measured = grid_tests.run_grid_test(test, entry)[1]
    return "passed" if passed else "failed", measured


@functools.cache
def _verdicts_on(law: str) -> tuple[str, ...]:
    """Return the verdicts of operators' tests on a law, which every page shows for the reference."""
    (entry,) = entry_folder.load_entries(law)
    return tuple(_verdict(test, entry)[0] for test in grid_tests.GRID_TESTS.values())


def _operators_tests(report: Report) -> Section:
    rows, note = [], ""
    try:
        for test, of_hundred in zip(grid_tests.GRID_TESTS.values(), _verdicts_on(report.hundred), strict=True):
            rows.append((test.name, *_verdict(test, report.entry), of_hundred, test.criterion))
        n_passed, n_of_hundred = (sum(row[at] == "passed" for row in rows) for at in (1, 3))
        note = f"Passed: {n_passed} of {len(rows)}, {n_of_hundred} by {report.hundred}."
    except ValueError as error:
        rows, note = [], f"The entry cannot play them: {error}"
    return Section(
        heading="Operators' tests",
        sentence="Tests that grid operators ask of grid-forming plants, each in a grid of its own with exact sensors; "
        "p.u. of power are of the turbines' rating, those of voltage of the nominal one.",
        header=("test", "verdict", "measured", report.hundred, "limit"),
        rows=rows,
        note=note,
    )


def _faults_of_sensors(report: Report) -> Section:
    seeds, rows = report.results.seeds[:N_WITH_FAULTS], []
    episodes = tuple(episode for episode in report.results.episodes if episode.seed in seeds)
    before, name = replace(report.results, seeds=seeds, episodes=episodes), report.entry.name
    for fault, after in faults.with_faults(before, report.entry, SETTINGS, report.n_threads):
        n_bad = (f"{_bad(results.runs[name]).sum():.0f}" for results in (before, after))
        rows.append((fault, *_interval(score_difference(after, before, name)), " → ".join(n_bad)))
    return Section(
        heading="Faults of sensors",
        sentence="Change of the score, in points, where measurements are worse or those of the largest group fail, on "
        f"the first {len(seeds)} scenarios alone."
        if rows
        else "A law has no sensors: nothing changes.",
        header=("fault", "change [points]", "95 % interval", "bad runs"),
        rows=rows,
        numbers=(1, 2, 3),
    )


def _energy(report: Report) -> Section:
    scenarios = get_suite(SUITE).scenarios(report.results.seeds[:N_OF_ENERGY])
    entries = (report.entry, *entry_folder.load_entries((report.hundred, _MOST_ENERGY)))
    runs = {entry.name: recording.recorded(entry, SETTINGS, scenarios, report.n_threads) for entry in entries}
    whole = np.logical_and.reduce([run.whole for run in runs.values()])
    energies = {name: run.energy(whole) for name, run in runs.items() if whole.any()}
    rows = []
    for name, (power_mw, energy_mwh, borrowed_mj, repaid_mj) in energies.items():
        against = 100.0 * (power_mw / energies[_MOST_ENERGY].power_mw - 1.0)
        texts = (f"{power_mw:.1f}", f"{energy_mwh:.3f}", f"{against:+.1f}", f"{borrowed_mj:.0f}", f"{repaid_mj:.0f}")
        rows.append((name, *texts))
    return Section(
        heading="Energy",
        sentence="Power and energy of all turbines into the grid, and the kinetic energy that their rotors lent and "
        f"got back, means over the {whole.sum()} of the first {len(scenarios)} scenarios, of three minutes each, "
        "in which all kept all groups.",
        header=("entry", "power [MW]", "energy [MWh]", "against mppt [%]", "borrowed [MJ]", "repaid [MJ]"),
        rows=rows,
        numbers=(1, 2, 3, 4, 5),
        note="mppt takes the most from the wind in steady operation. Gusts move rotors too, so that more can be repaid "
        "than lent: compare the rows."
        if rows
        else "In none of the first scenarios did the entry, the anchor and mppt all keep all groups.",
    )


def _damping(report: Report) -> Section:
    point, law = damping.POINT, report.entry.law
    sentence = (
        f"Oscillations of the grid with the entry in the loop, at rest at {point['wind_m_s']:g} m/s with a governor "
        f"droop of {point['governor_droop']:g} p.u., {100.0 * point['committed']:g} % of the machine's units and "
        f"{100.0 * point['load_level']:g} % of the load: a damping ratio below 0 grows, below {_WEAK:g} is weak."
    )
    entries = [report.entry]
    if report.entry.policy is not None:
        entries.append(Entry(name=f"{law.name} alone", strategy=law))
    try:
        loops = {entry.name: damping.damping(entry) for entry in entries}
    except ValueError as error:
        return Section(heading="Damping", sentence=sentence, note=f"There is none: {error}")
    rows = [
        (name, f"{mode.frequency_hz:.2f}", f"{mode.damping_ratio:.3f}", f"{mode.eigenvalue.real:.3f}", mode.slope)
        for name, loop in loops.items()
        for mode in loop.modes[:_N_MODES]
    ]
    return Section(
        heading="Damping",
        sentence=sentence,
        header=("in the loop", "frequency [Hz]", "damping ratio [-]", "rate [1/s]", "slope of the law"),
        rows=rows,
        numbers=(1, 2, 3),
        note=" ".join(_rest(name, loop) for name, loop in loops.items())
        + " The least damped are listed, of an action that is held for 0.5 s; the law has one slope below nominal "
        "frequency and another above. Sensors have their filters and mean delay, and no noise.",
    )


def _rest(name: str, loop: damping.Damping) -> str:
    rest = loop.rest
    if not rest.is_reached:
        return f"{name} does not come to rest: the frequency moves by {1000.0 * rest.moves_hz:.1f} mHz by itself."
    where = f"{name} rests at {rest.frequency_hz:.3f} Hz with actions of {rest.largest_action:.3f} at most"
    return f"{where}, and is {'stable' if loop.largest_rate < 1e-6 else 'not stable'}."


#: The page's sections in their order.
_SECTIONS: tuple[Callable[[Report], Section], ...] = (
    _score,
    _where_control_decides,
    _bad_runs,
    _scenarios,
    _operators_tests,
    _faults_of_sensors,
    _energy,
    _damping,
)
