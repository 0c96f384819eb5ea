"""`wtg-gym simulate`: one scenario under one or several laws."""

from wtg_gym.cli import options, output


def simulate_scenario(
    *,
    chosen: options.ScenarioOptions = options.ScenarioOptions(),
    strategy: options.Words = ("coordinated-piecewise",),
    example_law: options.Flag = False,
    plot: options.FigureFile | None = None,
    csv: options.CsvFile | None = None,
    json: options.Json = False,
) -> int:
    """Simulate one scenario under each of the given laws and print the key figures.

    These are the lowest and highest frequency, the largest rate of change of frequency over 500 ms, and the final
    frequency, rotor speeds and powers. The scenario is a seed of a suite or a file; its wind can be replaced. A run
    ends early at a frequency outside 0.95 … 1.03 p.u. (47.5 … 51.5 Hz), lost synchronism or a voltage collapse; in
    version v0 also at a stall, an over-speed or, in extended physics, an under-speed. In the paper's grid, of v0, the
    number of winds is the number of WTG groups at bus 2. Costs and scores are in 'wtg-gym evaluate --seeds'.

    examples:
      wtg-gym simulate --strategy mppt deloaded-5 coordinated-piecewise --plot run.png
      wtg-gym simulate --suite standard-v1 --seed 10003 --strategy coordinated-piecewise coordinated-tuned
      wtg-gym simulate --suite paper --seed 1 --wind 9 7.5 --duration 60
      wtg-gym simulate --wind-csv measured.csv --strategy my_law.toml
      wtg-gym suites weak-grid --seed 20010 --json > mine.json     write a scenario, edit it, then
      wtg-gym simulate --scenario mine.json --json                 simulate it

    Args:
        strategy: laws by name, 'all', or .toml files with one; default: the paper's coordinated-piecewise
        example_law: print a law file to start from, and do nothing else: --example-law > my_law.toml
        plot: write a figure of the runs: .png, .svg or .pdf
        csv: write every sample of the runs, units in the header: .csv
    """
    if example_law:
        from wtg_gym.policies.entry_folder import example_law as law_file

        output.say(*law_file().splitlines())
        return 0
    from wtg_gym.cli.simulation import run

    return run(chosen, strategy, plot=plot, csv=csv, json=json)
