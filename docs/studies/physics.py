"""For docs/physics.md: the paper's conclusions in its own plant, and in plants with more physics; some minutes."""

import dataclasses

import numpy as np
from output import folder

from wtg_gym.envs.lanes import TERMINATION_REASONS
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.parameters import ConverterLimitParameters, ProtectionParameters
from wtg_gym.physics.plant import Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, group_laws
from wtg_gym.plotting import style
from wtg_gym.plotting.trajectories import mark_end, mark_instants
from wtg_gym.scenarios import get_suite

STRATEGIES = (REFERENCE_STRATEGY, "mppt", "deloaded-5", "deloaded-10")  # the reference first
OTHERS = STRATEGIES[1:]
INCREASE, DECREASE = get_suite("paper").scenarios([0, 1])
N_SCENARIOS = 100
#: Suites of the reference in the plants that the conclusions are checked in.
SUITES = ("standard", "gust", "weak-grid", "low-wind")
SECOND_STEP_S = 30.0  # of the load increase; the claims on nadir and RoCoF are about the first step [s]
FAST, SLOW = 0, 1  # the paper's groups: at 11.4 m/s, whose current is largest, and at 8 m/s, which stalls

PAPER, TOGETHER = "the paper's", "all together"
CHECKED = (PAPER, "extended", "nrel-5mw")


# --- plants and their runs --------------------------------------------------------------------------------------------


def plants():
    """Return the plants by name.

    The paper's has limits out of reach: it does what the paper's plant does, and tells its currents too.
    """
    far = ConverterLimitParameters(
        current_max_pu=10.0,
        power_max_pu=10.0,
        torque_max_pu=10.0,
        power_min_pu=-10.0,
        power_gain=0.0,
        power_integral_gain=0.0,
    )
    together = Plant().replaced(physics="extended", protection=ProtectionParameters(), shedding=())
    users = {physics: Plant().replaced(physics=physics) for physics in CHECKED[1:]}
    return {PAPER: Plant(limits=far), TOGETHER: together, **users}


@dataclasses.dataclass
class Run:
    """A run until its end, with every simulation step."""

    status: Status
    end_s: float
    hertz: np.ndarray  # of the centre of inertia (n,)
    rotor: np.ndarray  # ω_m (n, n_wtg) [p.u.]
    current: np.ndarray  # (n, n_wtg) [p.u.]

    @property
    def failed(self):
        return self.status != Status.RUNNING

    @property
    def nadir(self):
        return self.hertz.min()

    @property
    def rocof(self):
        """Return the largest change of frequency within half a second, per second [Hz/s]."""
        n = round(0.5 / Plant().simulation_dt)
        return np.abs(self.hertz[n:] - self.hertz[:-n]).max() / 0.5

    def until(self, time_s):
        """Return the run cut off at a time [s]."""
        n = round(time_s / Plant().simulation_dt)
        return dataclasses.replace(self, hertz=self.hertz[:n], rotor=self.rotor[:n], current=self.current[:n])


def play(plant, scenarios, strategy):
    """Run scenarios side by side; each simulation step is a control interval, so that protections act after it."""
    step_s = plant.simulation_dt
    simulator = Simulator(
        dataclasses.replace(plant, control_dt=step_s), n_lanes=len(scenarios), duration_s=scenarios[0].duration_s
    )
    laws = group_laws(strategy, plant.turbines, plant.control)
    simulator.start(range(len(scenarios)), simulator.prepare(scenarios, laws))
    rows = []
    for interval in range(simulator.n_intervals + 1):
        if interval:
            simulator.advance()
        hertz = plant.case.frequency_hz * simulator.lane_values("coi")
        rows.append((hertz, simulator.wtg_values("rotor_speed"), simulator.wtg_values("current")))
    hertz, rotor, current = (np.array(values) for values in zip(*rows, strict=True))
    steps, statuses = simulator.lane_values("step").astype(int), simulator.lane_values("status").astype(int)
    simulator.close()
    return [
        Run(Status(status), n * step_s, hertz[: n + 1, lane], rotor[: n + 1, lane], current[: n + 1, lane])
        for lane, (n, status) in enumerate(zip(steps, statuses, strict=True))
    ]


def measure():
    """Return the runs of the paper's cases by plant and strategy, and why the reference's runs of suites fail."""
    increase, decrease, failures = {}, {}, {}
    for name, plant in plants().items():
        both = {strategy: play(plant, [INCREASE, DECREASE], strategy) for strategy in STRATEGIES}
        increase[name] = {strategy: runs[0] for strategy, runs in both.items()}
        decrease[name] = {strategy: runs[1] for strategy, runs in both.items()}
        for suite in SUITES if name in CHECKED else ():
            scenarios = get_suite(suite).scenarios(list(get_suite(suite).validation[:N_SCENARIOS]))
            runs = play(plant, scenarios, REFERENCE_STRATEGY)
            failures[name, suite] = [TERMINATION_REASONS[run.status] for run in runs if run.failed]
        print(f"{name}: done", flush=True)
    return increase, decrease, failures


# --- tables of the runs -----------------------------------------------------------------------------------------------


def slashed(values, digits):
    """Return numbers with slashes between them, a dash for one that is none."""
    return "/".join("–" if np.isnan(value) else f"{value:.{digits}f}" for value in values)


def ends_of(runs):
    """Return when runs fail, and why unless they stall."""
    times = "/".join(f"{run.end_s:.1f}" if run.failed else "none" for run in runs)
    reasons = {TERMINATION_REASONS[run.status] for run in runs if run.status not in (Status.RUNNING, Status.STALL)}
    return f"{times} ({', '.join(reasons)})" if reasons else times


def survival_table(increase, decrease, failures):
    """Return which of the paper's conclusions hold in which plant."""
    rows = {
        "coordinated never fails": [],
        "MPPT, 5, 10 % fail in turn [s]": [],
        "its nadir is lower, by < 10 mHz": [],
        "its RoCoF is smaller [Hz/s]": [],
        "its rotors rise less, load decrease [p.u.]": [],
    }
    never, order, nadir, rocof, rise = rows.values()

    def together(runs, limit_s):
        """Cut runs off where the first one ends."""
        end_s = min(limit_s, *(run.end_s for run in runs.values()))
        note = f" until {end_s:.1f} s" if end_s < limit_s else ""
        return {strategy: run.until(end_s) for strategy, run in runs.items()}, note

    for plant in CHECKED:
        lost = {suite: failures[plant, suite] for suite in SUITES}
        assert not increase[plant][REFERENCE_STRATEGY].failed and not decrease[plant][REFERENCE_STRATEGY].failed
        n_lost = sum(len(reasons) for reasons in lost.values())
        where = [f"{suite}: {len(reasons)} {reasons[0]}" for suite, reasons in lost.items() if reasons]
        text = f"{n_lost}/{N_SCENARIOS * len(lost) + 2}" + (f" ({', '.join(where)})" if where else "")
        never.append((n_lost == 0, text))

        others = [increase[plant][strategy] for strategy in OTHERS]
        ends = [run.end_s for run in others]
        order.append((all(run.failed for run in others) and ends == sorted(set(ends)), ends_of(others)))

        runs, note = together(increase[plant], SECOND_STEP_S)
        own = runs.pop(REFERENCE_STRATEGY)
        below = [1e3 * (run.nadir - own.nadir) for run in runs.values()]
        nadir.append((min(below) > 0.0 and max(below) < 10.0, f"{min(below):.0f}…{max(below):.0f}{note}"))
        least = min(run.rocof for run in runs.values())
        rocof.append((own.rocof < least, f"{own.rocof:.3f} to {least:.3f}"))

        runs, note = together(decrease[plant], DECREASE.duration_s)
        rises = {strategy: run.rotor.max(axis=0) - run.rotor[0] for strategy, run in runs.items()}
        own, least = rises[REFERENCE_STRATEGY], np.minimum(rises["deloaded-5"], rises["deloaded-10"])
        rise.append((bool((own < least).all()), f"{slashed(own, 2)} to {slashed(least, 2)}{note}"))
    cells = [
        (conclusion, *(f"{'yes' if holds else '**no**'}: {text}" for holds, text in verdicts))
        for conclusion, verdicts in rows.items()
    ]
    return markdown_table(("the paper concludes", *CHECKED), cells)


# --- pictures ---------------------------------------------------------------------------------------------------------


@style.printed
def draw_increase(increase):
    """Draw the load increase in the paper's plant and with all parts: frequency, rotor speed and current."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 118.0)
    axes = figure.subplots(3, 2, sharex=True)
    for column, (plant, title) in enumerate(((PAPER, "the paper's plant"), (TOGETHER, "all parts together"))):
        for strategy, run in increase[plant].items():
            look, times = style.STRATEGY_LOOKS[strategy], np.linspace(0.0, run.end_s, run.hertz.size)
            for panel, values in zip(
                axes[:, column], (run.hertz, run.rotor[:, SLOW], run.current[:, FAST]), strict=True
            ):
                panel.plot(times, values, color=look.colour, linestyle=look.dashes, label=strategy)
                if run.failed:
                    mark_end(panel, run.end_s, float(values[-1]), look.colour)
        style.letter_panel(axes[0, column], "ab"[column], title)
        axes[2, column].set_xlabel("time [s]")
        for panel in axes[:, column]:
            mark_instants(panel, INCREASE, numbered=False)
            panel.set_xlim(0.0, INCREASE.duration_s)
    labels = "frequency [Hz]", "rotor speed at 8 m/s\n[p.u.]", "current at 11.4 m/s\n[p.u.]"
    for row, label in zip(axes, labels, strict=True):
        row[0].set_ylabel(label)
        style.share_limits(row)
    handles, names = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names))
    return figure


def main(docs):
    """Renew the page and its pictures."""
    increase, decrease, failures = measure()
    style.save_figure(draw_increase(increase), docs / "physics" / "load-increase", ["svg"])
    update_between_markers(docs / "physics.md", survival_table(increase, decrease, failures), "survival")


if __name__ == "__main__":
    main(folder(__doc__))
