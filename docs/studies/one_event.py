"""The README's picture, images/one-event.svg: laws and a trained policy side by side in one extreme scenario.

For docs/agents.md, images/energy.svg: what energy rotors lend there and on average, with the law that scores 100 and
with the policy.

These are plain droop on a reserve of 5 %, the published law, that law tuned and the agent with the best score. Of the
first validation scenarios in which droop loses the grid, the tuned law leaves 50 ± 0.8 Hz somewhere and the agent loses
nothing and does not, it is that in which the tuned law lets the frequency fall lowest. Prints the load that each sheds.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from output import DOCS

from wtg_gym.cli.scoring import chosen_entries
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation import Entry, evaluate
from wtg_gym.evaluation.episodes import Episode
from wtg_gym.evaluation.recording import Recorded, recorded
from wtg_gym.evaluation.summary import DESIGN_DEVIATION_MHZ
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.scenario import Scenario
from wtg_gym.plotting import save_figure, style
from wtg_gym.plotting.trajectories import draw_run, explain_events, mark_instants
from wtg_gym.scenarios import get_suite

SUITE, N_SCENARIOS = "standard-v1", 150
#: A law whose support ends where its rotor stalls.
DROOP = "deloaded-5"
Runs = Mapping[str, Recorded]


@style.printed
def plot_one_event(scenario: Scenario, runs: Runs, plant: Plant) -> Figure:
    """Draw the worst unit's frequency, power of all turbines, slowest rotor and load not served over time.

    A cross marks where the grid was lost, if it lies in the panel. Grey lines: limits, and where load is shed first.
    """
    looks, nominal_hz, protection = style.law_looks(runs), plant.case.frequency_hz, plant.protection
    design_hz = DESIGN_DEVIATION_MHZ / 1000.0
    limits_hz = {
        "grid lost": nominal_hz * protection.frequency_min_pu,
        "load shed": nominal_hz * max(stage.frequency_pu for stage in plant.shedding),
        "−0.8 Hz": nominal_hz - design_hz,
        "+0.8 Hz": nominal_hz + design_hz,
        "grid lost ": nominal_hz * protection.frequency_max_pu,
    }
    panels = {
        "frequency of the worst bus or unit [Hz]": ("worst_hz", limits_hz),
        "power of all turbines [MW]": ("power_mw", {}),
        "slowest rotor [p.u.]": ("rotor_speed_pu", {"group trips": protection.rotor_speed_min_pu}),
        "load not served [MW]": ("unserved_mw", {}),
    }
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 110.0)
    for letter, axes, (label, (quantity, limits)) in zip(
        "abcd", figure.subplots(2, 2, sharex=True).flat, panels.items(), strict=True
    ):
        style.letter_panel(axes, letter, label)
        for name, run in runs.items():
            values, failed = getattr(run, quantity)[:, 0], bool(run.failures[0])
            draw_run(axes, run.time_s, values, looks[name], failed=failed, label=name)
        # A run that fails ends a step before the limit.
        axes.margins(y=0.12)
        if quantity == "worst_hz":
            # Where the runs that go on are told apart; the one that fails leaves the panel.
            axes.set_ylim(bottom=min(np.nanmin(run.worst_hz) for run in runs.values() if not run.failures[0]) - 0.2)
        low, high = axes.get_ylim()
        for words, limit in limits.items():
            if low < limit < high:
                axes.axhline(limit, linewidth=0.7, zorder=1, color=style.REFERENCE_GREY, linestyle=(0.0, (5.0, 2.0)))
                at_right, side = axes.get_yaxis_transform(), "top" if words == "load shed" else "center"
                look = {"fontsize": style.SMALL_PT, "color": "0.3", "va": side, "clip_on": False}
                axes.text(1.01, limit, words.strip(), transform=at_right, **look)
        mark_instants(axes, scenario, numbered=True)
        axes.set_xlim(0.0, scenario.duration_s)
        axes.set_xlabel("time [s]")
    handles, labels = axes.get_legend_handles_labels()
    legend = figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), handlelength=3.0)
    for line in legend.get_lines():
        line.set_linewidth(1.6)
    explain_events(figure, scenario)
    return figure


@style.printed
def plot_energy(scenario: Scenario, runs: Runs, of_strata: Mapping[str, Runs]) -> Figure:
    """Draw the energy that the rotors of each group have lent in a scenario, and all of them on average in strata."""
    figure, looks = style.new_figure(style.DOUBLE_COLUMN_MM, 110.0), style.law_looks(runs)
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    for letter, axes, (name, run) in zip("ab", panels[0], runs.items(), strict=True):
        style.letter_panel(axes, letter, f"{name}: energy lent by each group [MJ]")
        for group, values in enumerate((run.stored_mj[0] - run.stored_mj)[:, 0].T):
            axes.plot(run.time_s, values, label=f"group {group + 1}")
        mark_instants(axes, scenario, numbered=True)
        axes.set_xlim(0.0, scenario.duration_s)
    panels[0, 0].legend(loc="upper right", ncols=2)
    for letter, axes, (stratum, played) in zip("cd", panels[1], of_strata.items(), strict=True):
        style.letter_panel(axes, letter, f"{stratum}: energy lent by all groups, mean [MJ]")
        for name, run in played.items():
            stored = run.stored_mj.sum(axis=2)
            draw_run(axes, run.time_s, np.nanmean(stored[0] - stored, axis=1), looks[name], failed=False, label=name)
        axes.set_xlabel("time [s]")
    panels[1, 1].legend(loc="lower right")
    explain_events(figure, scenario)
    return figure


def chosen() -> tuple[int, list[Entry]]:
    """Return the seed of the scenario, and who plays it."""
    suite, entries = get_suite(SUITE), chosen_entries(("baselines", "policies"), SUITE)
    seeds = suite.validation[:N_SCENARIOS]
    results = evaluate(entries, SUITE, "validation", seeds=list(seeds), keep_going=True)
    learned = (row for row in results.ranking if row.kind == "learned" and not row.privileged)
    agent = max(learned, key=lambda row: row.score.value).name
    zero, hundred = suite.task.anchors
    names = [DROOP, zero, hundred, agent]
    droop, _, tuned, learner = [results.episodes_of(name)[: len(seeds)] for name in names]

    def held(episode: Episode) -> bool:
        lost = episode.metrics["tripped_groups"], episode.metrics["shed_energy_mwh"]
        fallen_hz = suite.nominal_hz - episode.metrics["worst_nadir_hz"]
        return not (episode.failed or any(lost)) and fallen_hz <= DESIGN_DEVIATION_MHZ / 1000.0

    def shows(at: int) -> bool:
        return bool(droop[at].failed) and held(learner[at]) and not held(tuned[at])

    if not (shown := [at for at in range(len(seeds)) if shows(at)]):
        raise ValueError(f"in none of {len(seeds)} scenarios {agent} alone holds, and {DROOP} loses the grid")
    clearest = min(shown, key=lambda at: tuned[at].metrics["worst_nadir_hz"])
    played = {entry.name: entry for entry in reversed(entries)}
    return seeds[clearest], [played[name] for name in names]


if __name__ == "__main__":
    seed, entries = chosen()
    settings, scenarios = EnvSettings(suite=SUITE, split="validation"), get_suite(SUITE).scenarios([seed])
    runs = {entry.name: recorded(entry, settings, scenarios) for entry in entries}
    for name, run in runs.items():
        print(f"{name}: {np.nanmax(run.unserved_mw):.0f} MW not served at most")
    # The list of events fills the line: without the suite's name.
    scenario = replace(scenarios[0], name=scenarios[0].name.partition("/")[2])
    save_figure(plot_one_event(scenario, runs, settings.resolved_plant), DOCS / "images" / "one-event.svg")
    suite, compared = get_suite(SUITE), entries[2:]
    of_strata = {}
    for stratum in suite.strata[1:]:
        drawn = suite.scenarios([each for each in suite.validation[:60] if suite.stratum(each) == stratum])
        of_strata[stratum] = {entry.name: recorded(entry, settings, drawn) for entry in compared}
    lenders = {entry.name: runs[entry.name] for entry in compared}
    save_figure(plot_energy(scenario, lenders, of_strata), DOCS / "images" / "energy.svg")
