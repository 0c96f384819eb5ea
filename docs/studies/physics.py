"""For docs/physics.md: the paper's conclusions in its own plant, and in plants that add what it leaves out.

Some ten minutes, most of which the plants take that are compiled for the first time.
"""

import dataclasses

import numpy as np
from numpy.polynomial import Polynomial
from output import folder
from small_signal import slope, synchronising_coefficients

from wtg_gym.envs.lanes import TERMINATION_REASONS
from wtg_gym.files import markdown_table, update_between_markers
from wtg_gym.physics.grid import get_grid
from wtg_gym.physics.machine_parameters import HydroGovernorParameters
from wtg_gym.physics.parameters import (
    ConverterLimitParameters,
    ProtectionParameters,
    TurbineParameters,
    VoltageControlParameters,
    nrel_5mw,
)
from wtg_gym.physics.plant import DEAD_BAND_PU, Plant
from wtg_gym.physics.protection import Status
from wtg_gym.physics.simulator import Simulator
from wtg_gym.physics.tracking_law import REFERENCE_STRATEGY, get_law, group_laws
from wtg_gym.physics.units import BUSES
from wtg_gym.plotting import style
from wtg_gym.plotting.trajectories import mark_end, mark_instants
from wtg_gym.scenarios import get_suite
from wtg_gym.single_wtg import PAPER_SYNCHRONISING_COEFFICIENT, equilibria, single_machine

STRATEGIES = (REFERENCE_STRATEGY, "mppt", "deloaded-5", "deloaded-10")  # the reference first
OTHERS = STRATEGIES[1:]
INCREASE, DECREASE = get_suite("paper").scenarios([0, 1])
N_SCENARIOS = 100
SUITES = ("standard", "low-wind")  # of every plant and strategy
FURTHER_SUITES = ("gust", "weak-grid")  # of the reference in the plants that the conclusions are checked in
SECOND_STEP_S = 30.0  # of the load increase; the claims on nadir and RoCoF are about the first step [s]
FAST, SLOW = 0, 1  # the paper's groups: at 11.4 m/s, whose current is largest, and at 8 m/s, which stalls

PAPER, TOGETHER, HYDRO = "the paper's", "all together", "all, hydro and shedding"
CHECKED = (PAPER, "extended", "nrel-5mw")


# --- plants and their runs --------------------------------------------------------------------------------------------


def plants():
    """Return the plants by name: the paper's, it with one part more each, with parts together, and those of users.

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
    paper, extended = Plant(limits=far), Plant().replaced(physics="extended")
    limits = dataclasses.replace(ConverterLimitParameters(), power_min_pu=far.power_min_pu)
    hydro = get_grid("ieee14").case.with_governors(lambda steam: HydroGovernorParameters(droop_pu=steam.droop_pu))
    banded = get_grid("ieee14").case.with_governors(lambda steam: dataclasses.replace(steam, dead_band_pu=DEAD_BAND_PU))
    undamped = extended.case.with_governors(lambda steam: dataclasses.replace(steam, dead_band_pu=0.0))
    # The stages are there, and shed nothing: a plant without them would be compiled for itself.
    idle = tuple(dataclasses.replace(stage, share=0.0) for stage in extended.shedding)
    untripped = ProtectionParameters()
    return {
        PAPER: paper,
        "rotor energy": dataclasses.replace(paper, turbine=extended.turbine),
        "current and power limits": dataclasses.replace(paper, limits=limits),
        "chopper": dataclasses.replace(paper, limits=dataclasses.replace(far, power_min_pu=0.0)),
        "voltage control": dataclasses.replace(paper, voltage_control=extended.voltage_control),
        "dead band": dataclasses.replace(paper, case=banded),
        "condensers without D": dataclasses.replace(paper, case=undamped),
        TOGETHER: Plant().replaced(physics="extended", protection=untripped, shedding=()),
        "under-speed trip": dataclasses.replace(paper, protection=extended.protection),
        "NREL 5 MW rotor": dataclasses.replace(paper, turbine=nrel_5mw(conserves_energy=False)),
        "hydro governor": dataclasses.replace(paper, case=hydro, shedding=idle),
        HYDRO: Plant().replaced(physics="extended", protection=untripped, case=hydro),
        "extended": extended,
        "nrel-5mw": Plant().replaced(physics="nrel-5mw"),
    }


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
    """Return the runs of the paper's cases by plant and strategy, and why suites' runs fail by plant and those."""
    increase, decrease, failures = {}, {}, {}
    for name, plant in plants().items():
        both = {strategy: play(plant, [INCREASE, DECREASE], strategy) for strategy in STRATEGIES}
        increase[name] = {strategy: runs[0] for strategy, runs in both.items()}
        decrease[name] = {strategy: runs[1] for strategy, runs in both.items()}
        chosen = [(suite, strategy) for suite in SUITES for strategy in STRATEGIES]
        chosen += [(suite, REFERENCE_STRATEGY) for suite in FURTHER_SUITES] if name in CHECKED else []
        for suite, strategy in chosen:
            scenarios = get_suite(suite).scenarios(list(get_suite(suite).validation[:N_SCENARIOS]))
            runs = play(plant, scenarios, strategy)
            failures[name, suite, strategy] = [TERMINATION_REASONS[run.status] for run in runs if run.failed]
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
        lost = {suite: failures[plant, suite, REFERENCE_STRATEGY] for suite in (*SUITES, *FURTHER_SUITES)}
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


def parts_table(increase, failures):
    """Return what each part does to the load increase and to the failures in a suite."""
    suite = SUITES[-1]
    rows = [
        (
            plant,
            f"{runs[REFERENCE_STRATEGY].nadir:.3f}",
            ends_of([runs[strategy] for strategy in OTHERS]),
            "/".join(str(len(failures[plant, suite, strategy])) for strategy in STRATEGIES),
        )
        for plant, runs in increase.items()
    ]
    header = ("plant", "nadir [Hz]", "fail at [s]", suite)
    return markdown_table(header, rows, right=range(1, len(header)))


def rotor_energy(increase):
    """Return how much more energy the paper's rotor releases than a real one, at several winds, as a sentence."""
    settled_pu = increase[PAPER][REFERENCE_STRATEGY].hertz[-1] / get_grid("ieee14").case.frequency_hz
    winds, excess = (6.0, 8.0, 10.0, 11.4), []
    for wind in winds:
        law = get_law(REFERENCE_STRATEGY)
        before, after = (equilibria(pu, law, wind)[-1].rotor_speed_pu for pu in (1.0, settled_pu))
        excess.append(100.0 * (2.0 * (before - after) / (before**2 - after**2) - 1.0))
    shares = "/".join(f"{value:+.0f}" for value in excess).replace("-", "−")
    return (
        f"From nominal frequency to where the load increase settles the paper's rotor releases {shares} % more at "
        f"{'/'.join(f'{wind:g}' for wind in winds)} m/s."
    )


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


@style.printed
def draw_parts(increase, failures):
    """Draw, for each plant, when the load increase ends in a failure, and the failures in suites."""
    figure = style.new_figure(style.DOUBLE_COLUMN_MM, 112.0)
    left, right = figure.subplots(1, 2, sharey=True)
    places, duration_s = np.arange(len(increase)), INCREASE.duration_s
    for index, strategy in enumerate(STRATEGIES):
        look = {"color": style.STRATEGY_LOOKS[strategy].colour, "marker": style.MARKERS[index], "linestyle": "none"}
        at = places + 0.2 * (index - 1.5)
        runs = [increase[plant][strategy] for plant in increase]
        lasts = np.array([not run.failed for run in runs])
        left.plot([run.end_s for run in runs if run.failed], at[~lasts], label=strategy, **look)
        left.plot(np.full(lasts.sum(), duration_s), at[lasts], **{**look, "markerfacecolor": "none"})
        counts = [sum(len(failures[plant, suite, strategy]) for suite in SUITES) for plant in increase]
        right.plot(100.0 * np.array(counts) / (len(SUITES) * N_SCENARIOS), at, **look)
    titles = "failure in the load increase", f"failures in {' and '.join(SUITES)}"
    for panel, letter, title in zip((left, right), "ab", titles, strict=True):
        style.letter_panel(panel, letter, title)
        for place in places[:-1]:
            panel.axhline(place + 0.5, color="0.9", linewidth=0.5)
        panel.grid(axis="y", visible=False)
    left.set_yticks(places, list(increase))
    left.set_ylim(places.size - 0.5, -0.5)
    left.set_xlabel("time [s]; hollow: none")
    left.set_xlim(0.0, 1.06 * duration_s)
    right.set_xlabel("share of runs [%]")
    figure.legend(loc="outside lower center", ncols=len(STRATEGIES))
    return figure


# --- how stiffly a group holds to the grid ----------------------------------------------------------------------------


def start_at(bus_voltage_pu, turbine=None, voltage_control=None):
    """Return the load increase's start with bus 2 held at a voltage: E, K_p, slow K_p and margin of each group.

    With voltage control E is a state, and the angle moves power with K_p(s) = K_p + K_1/(s + a): a constant E at high
    frequencies, a held terminal voltage at low ones.
    """
    turbine = turbine or TurbineParameters()
    case, law = get_grid("ieee14").case, get_law(REFERENCE_STRATEGY, turbine)
    buses = tuple(dataclasses.replace(bus, voltage_pu=bus_voltage_pu) if bus.number == 2 else bus for bus in case.buses)
    plant = Plant(case=dataclasses.replace(case, buses=buses), turbine=turbine, voltage_control=voltage_control)
    simulator = Simulator(plant, duration_s=INCREASE.duration_s)
    simulator.start(0, INCREASE, (law,) * len(plant.groups))
    simulator.evaluate()
    emf = simulator.wtg_values("emf")[0]
    k_p = np.diag(synchronising_coefficients(INCREASE, law, plant))
    slow, margins = [], []
    for group, wind in enumerate(INCREASE.wind_speed[:, 0]):
        effect, decay = voltage_feedback(simulator, group) if voltage_control else (0.0, 1.0)
        slow.append(k_p[group] + effect / decay)
        try:
            loop = single_machine(law, float(wind), float(k_p[group]), turbine=turbine)
        except ValueError:
            # The pitch protection holds this rotor, which the loop does not know.
            margins.append(np.nan)
        else:
            margins.append(with_moving_voltage(loop, effect, decay).margins().phase_margin_deg)
    return emf, k_p, slow, margins


def with_moving_voltage(loop, effect, decay):
    """Return a loop with K_p + K_1/(s + a) in the place of K_p; effect K_1 [p.u./(rad s)], decay a [1/s]."""
    numerator = loop.numerator * Polynomial([decay + effect / loop.synchronising_coefficient, 1.0])
    return dataclasses.replace(loop, numerator=numerator, denominator=loop.denominator * Polynomial([decay, 1.0]))


def voltage_feedback(simulator, group):
    """Return K_1 [p.u./(rad s)] and a [1/s] of a group at rest, everybody else's states held."""
    names, here = simulator.layout.state_names, simulator.state()
    internal = names.index(f"wtg{group}.internal_voltage")

    def read():
        return np.array([simulator.wtg_values("power")[0, group], simulator.rates()[internal]])

    places = names.index(f"wtg{group}.angle"), internal
    (_, rate_by_angle), (power_by_voltage, rate_by_voltage) = (slope(simulator, here, at, read) for at in places)
    simulator.set_state(here)
    simulator.evaluate()
    return power_by_voltage * rate_by_angle, -rate_by_voltage


def margins_table():
    """Return starts with constant E at the scheduled voltage, and with voltage control."""
    # Bus 2 here keeps the groups clear of their reactive limit, which would be a corner of the right-hand side.
    control = {"bus_voltage_pu": 1.04, "voltage_control": VoltageControlParameters()}
    forms = {
        "constant E": {"bus_voltage_pu": get_grid("ieee14").case.buses[1].voltage_pu},
        "voltage control": control,
        "and NREL 5 MW": {**control, "turbine": nrel_5mw()},
    }
    law = get_law(REFERENCE_STRATEGY)
    margins = [
        single_machine(law, float(wind), PAPER_SYNCHRONISING_COEFFICIENT).margins().phase_margin_deg
        for wind in INCREASE.wind_speed[:, 0]
    ]
    rows = [("the paper's", "–", f"{PAPER_SYNCHRONISING_COEFFICIENT:g}", "–", slashed(margins, 0))]
    for name, form in forms.items():
        emf, k_p, slow, margins = start_at(**form)
        rows.append(
            (
                name,
                *(slashed(values, 2) for values in (emf, k_p)),
                slashed(slow, 2) if "voltage_control" in form else "–",
                slashed(margins, 0),
            )
        )
    header = ("groups", "E", "K_p", "slow K_p", "margin [°]")
    return markdown_table(header, rows, right=range(1, 5))


# --- loads ------------------------------------------------------------------------------------------------------------


def play_with_loads(exponent, strategy):
    """Run the load increase in the paper's plant with loads whose power goes with a power of the voltage.

    The simulator has admittances only. After every step those of all loads, and of those that an event has switched on,
    are set to Y_0 (V_0/V)^n until they fit the voltages that they cause; the next step runs with them. Below 0.7 p.u. a
    load is an impedance again, as usual: a constant power has no solution at a low voltage.

    Returns:
        end [s], lowest and last frequency [Hz].
    """
    step_s = Plant().simulation_dt
    plant = Plant(control_dt=step_s)
    simulator = Simulator(plant, duration_s=INCREASE.duration_s)
    simulator.start(0, INCREASE, group_laws(strategy, plant.turbines))
    simulator.evaluate()
    rows, layout, data = simulator.blocks[0, :, 0], simulator.layout, simulator.data
    # A copy: both are written below.
    first = layout.first_rows(BUSES, "load")
    loads, events = rows[[first, first + 1]], data.events[0].copy()
    start, hertz = np.abs(simulator.bus_voltages()), []
    while len(hertz) < simulator.n_intervals and simulator.lane_values("status")[0] == Status.RUNNING:
        simulator.advance()
        voltage = np.abs(simulator.bus_voltages())
        for _ in range(20):
            before, factor = voltage, np.maximum(voltage / start, 0.7) ** -exponent
            rows[first], rows[first + 1] = loads * factor
            for power in ("active", "reactive"):
                data.events[power][0] = events[power] * factor[events["bus"]]
            voltage = np.abs(simulator.bus_voltages())
            if np.abs(voltage - before).max() < 1e-10:
                break
        # The network is reduced again before the next step.
        rows[layout.lane("next_change")] = rows[layout.lane("step")]
        hertz.append(plant.case.frequency_hz * simulator.lane_values("coi")[0])
    ended = "none" if simulator.lane_values("status")[0] == Status.RUNNING else f"{len(hertz) * step_s:.1f}"
    return ended, min(hertz), hertz[-1]


def loads_summary():
    """Return the load increase with each kind of load, in words."""
    lines = []
    for exponent, kind in enumerate(("impedance", "current", "power")):
        found = {strategy: play_with_loads(exponent, strategy) for strategy in STRATEGIES}
        _, nadir, last = found[REFERENCE_STRATEGY]
        ends = "/".join(found[strategy][0] for strategy in OTHERS)
        lines.append(f"- constant {kind}: nadir {nadir:.3f} Hz, settles at {last:.3f} Hz, fail at {ends} s")
    return "\n".join(lines)


def main(docs):
    """Renew the page and its pictures."""
    increase, decrease, failures = measure()
    style.save_figure(draw_increase(increase), docs / "physics" / "load-increase", ["svg"])
    style.save_figure(draw_parts(increase, failures), docs / "physics" / "parts", ["svg"])
    sections = {
        "survival": survival_table(increase, decrease, failures),
        "parts": parts_table(increase, failures),
        "rotor-energy": rotor_energy(increase),
        "margins": margins_table(),
        "loads": loads_summary(),
    }
    for name, text in sections.items():
        update_between_markers(docs / "physics.md", text, name)


if __name__ == "__main__":
    main(folder(__doc__))
