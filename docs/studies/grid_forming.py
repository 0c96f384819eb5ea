"""For docs/grid-forming.md: the tests that operators ask of grid-forming plants, entries × tests, and a picture."""

from matplotlib.lines import Line2D
from output import DOCS

from wtg_gym.evaluation.grid_tests import GRID_TESTS, SOURCES, run_grid_test
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.protection import Status
from wtg_gym.plotting import save_figure, style
from wtg_gym.policies.entry_folder import load_entries

LAWS = ("mppt", "deloaded-5", "deloaded-10", "coordinated-linear", "coordinated-undamped", "coordinated-piecewise")
TUNED = ("coordinated-tuned", "coordinated-free", "fast-droop", "distilled-law", "ppo-v1-0")
#: The end of every criterion, which the page says once.
STAY = "; all groups stay"
#: Controllers and the tests of theirs whose figures the page shows.
SHOWN = {
    "coordinated-piecewise": ("angle-step", "island-surplus", "current-limit"),
    "coordinated-tuned": ("current-limit",),
}
DRAWN = ("deloaded-10", "coordinated-piecewise", "coordinated-tuned")


def described():
    """Return the table of tests, those with one criterion in a row, and the sources."""
    tests_of, sources_of = {}, {}
    for test in GRID_TESTS.values():
        criterion = test.criterion.removesuffix(STAY)
        tests_of.setdefault(criterion, []).append(f"`{test.name}`")
        sources_of.setdefault(criterion, {}).update(dict.fromkeys(test.source.split(", ")))
    rows = [(", ".join(tests), criterion, ", ".join(sources_of[criterion])) for criterion, tests in tests_of.items()]
    keys = "\n".join(f"- **{key}**: {text}" for key, text in SOURCES.items())
    table = markdown_table(("test", "passed if", "source"), rows)
    return f"In every test all groups stay connected.\n\n{table}\n\n{keys}"


def verdicts(runs):
    """Return the table of verdicts, controllers with equal ones in a row, and figures of some."""
    alike = {}
    for label, results in runs.items():
        failed = tuple(f"`{name}`" for name, (_, (passed, _)) in results.items() if not passed)
        alike.setdefault(failed, []).append(label)
    n = len(GRID_TESTS)
    rows = [(", ".join(labels), f"{n - len(failed)} of {n}", ", ".join(failed)) for failed, labels in alike.items()]
    table = markdown_table(("controllers", "passed", "failed"), rows)
    shown = [(label, test) for label, tests in SHOWN.items() for test in tests]
    figures = [f"- `{test}`, `{label}`: {runs[label][test][1][1]}" for label, test in shown]
    return "\n".join([table, "", *figures])


@style.printed
def picture(runs):
    """Draw the mean power of all groups and the frequency in every test."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 230.0)
    looks = style.law_looks(runs)
    axes = figure.subplots(2 * -(-len(GRID_TESTS) // 3), 3)
    for name, of_frequency, of_power in zip(GRID_TESTS, axes[0::2].flat, axes[1::2].flat, strict=False):
        for label, results in runs.items():
            response, _ = results[name]
            look = {"color": looks[label].colour, "linestyle": looks[label].dashes}
            of_frequency.plot(response.time_s, response.frequency_hz, **look)
            of_power.plot(response.time_s, response.total(), **look)
            if response.status is not Status.RUNNING or not response.connected[-1].all():
                of_frequency.plot(response.time_s[-1], response.frequency_hz[-1], "x", color=look["color"])
        of_frequency.set_title(name, fontsize="small")
        for own_axes, limits in ((of_frequency, (47.3, 51.7)), (of_power, (-0.7, 1.3))):
            low, high = own_axes.get_ylim()
            own_axes.set_ylim(max(low, limits[0]), min(high, limits[1]))
        of_frequency.set_xticklabels([])
    for k, panel in enumerate(axes[:, 0]):
        panel.set_ylabel(("f [Hz]", "p [p.u.]")[k % 2])
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    for unused in (panel for panel in axes.flat if not panel.lines):
        unused.set_axis_off()
    handles = [Line2D([], [], color=looks[n].colour, linestyle=looks[n].dashes, label=n) for n in runs]
    handles.append(Line2D([], [], color="0.4", marker="x", linestyle="", label="lost, or a group tripped"))
    figure.legend(handles=handles, loc="outside upper center", ncols=4)
    return figure


if __name__ == "__main__":
    runs = {}
    for spec in (*LAWS, *TUNED):
        entry = load_entries(spec)[0]
        runs[entry.name] = {test.name: run_grid_test(test, entry) for test in GRID_TESTS.values()}
        print(entry.name, *(verdict for _, verdict in runs[entry.name].values()), sep="\n  ", flush=True)
    page = DOCS / "grid-forming.md"
    update_between_markers(page, described(), "tests")
    update_between_markers(page, verdicts(runs), "verdicts")
    save_figure(picture({name: runs[name] for name in DRAWN}), DOCS / "physics" / "grid-forming.svg")
