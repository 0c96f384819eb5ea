"""`python docs/studies/tuned_law.py`: tunes the paper's law to the grid of a suite."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from contextlib import closing

import cma
import numpy as np
from rollouts import Rollouts

from agents.command import Parser, Progress, add_threads_option, print_table, run_command, say, suite_name
from wtg_gym.evaluation.score import COST_OFFSET
from wtg_gym.physics.tracking_law import LARGEST_COEFFICIENT, TIME_CONSTANT_RANGE, TrackingLaw, coordinated_piecewise
from wtg_gym.scenarios import get_suite

POPULATION = 16
#: Least coefficient that is tried [p.u.]: at 0 a group would give nothing.
_LEAST_COEFFICIENT = 0.05

_DESCRIPTION = """\
Tunes any monotone piecewise g(ω) with the paper's corners, and its τ, on training scenarios by CMA-ES: the mean of
ln(J + J0), which decides the score, is lowered. Printed are the numbers of `coordinated-tuned`: how far k lies above
K_opt at ω_min, above K_n at ω_st and below K_pr at ω_max, as shares of K_opt - K_pr, and τ."""


def law_of(x: Sequence[float]) -> TrackingLaw:
    """Return the law of a point: three shares of K_opt - K_pr, and ln(τ / 0.8 s); made monotone, and held in range."""
    paper = coordinated_piecewise()
    span = paper.k_min - paper.k_max
    nominal = paper.k_nominal + x[1] * span
    corners = max(paper.k_min + x[0] * span, nominal), nominal, min(paper.k_max - x[2] * span, nominal)
    k_min, k_nominal, k_max = (min(max(k, _LEAST_COEFFICIENT), LARGEST_COEFFICIENT) for k in corners)
    low, high = TIME_CONSTANT_RANGE
    tau = min(max(paper.damping_time_constant_s * math.exp(x[3]), low), high)
    return TrackingLaw(name="tuned", k_min=k_min, k_nominal=k_nominal, k_max=k_max, damping_time_constant_s=tau)


def tune_law(
    suite: str,
    n_scenarios: int,
    generations: int,
    seed: int,
    on_generation: Callable[[int, float], None],
    n_threads: int | None = None,
) -> tuple[list[float], TrackingLaw]:
    """Return the point that was found, as of :func:`law_of`, and its law; the seed of the search is 1 or more."""
    seeds = list(get_suite(suite).train[:n_scenarios])
    options = {"popsize": POPULATION, "seed": seed, "verbose": -9}
    search = cma.CMAEvolutionStrategy([1.2, 0.0, 1.0, 0.0], 0.5, options)
    least = math.inf
    with closing(Rollouts(suite, "train", seeds, POPULATION, n_threads)) as rollouts:
        for generation in range(generations):
            asked = search.ask()
            terms = rollouts.play(rollouts.no_action, [law_of(x) for x in asked])
            costs = np.log(rollouts.pinned(terms) + COST_OFFSET).mean(axis=0)
            search.tell(asked, costs.tolist())
            least = min(least, float(costs.min()))
            on_generation(generation + 1, least)
    found = [float(value) for value in search.result.xfavorite]
    return found, law_of(found)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python docs/studies/tuned_law.py", description=_DESCRIPTION)
    parser.add_argument(
        "--suite", type=suite_name, default="standard-v1", metavar="NAME", help="(default: standard-v1)"
    )
    parser.add_argument("--scenarios", type=int, default=192, metavar="N", help="training scenarios (default: 192)")
    parser.add_argument("--generations", type=int, default=45, metavar="N", help="of the search (default: 45)")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of the search (default: 1)")
    add_threads_option(parser)

    def work() -> None:
        given = parser.parse_args(argv)
        get_suite(given.suite)
        with Progress("generations") as progress:

            def tell(done: int, cost: float) -> None:
                progress.update(f"least mean ln(J + J0) {cost:.4f}", done, given.generations)

            found, law = tune_law(given.suite, given.scenarios, given.generations, given.seed, tell, given.threads)
        say(f"tuned on {given.scenarios} training scenarios of {given.suite}", "")
        print_table(
            ("number", "value", "k [p.u.]"),
            [
                ("above K_opt at ω_min", f"{found[0]:.2f}", f"{law.k_min:.3f}"),
                ("above K_n at ω_st", f"{found[1]:.3f}", f"{law.k_nominal:.3f}"),
                ("below K_pr at ω_max", f"{found[2]:.2f}", f"{law.k_max:.3f}"),
                ("τ [s]", f"{law.damping_time_constant_s:.2f}", ""),
            ],
        )

    return run_command(work)


if __name__ == "__main__":
    sys.exit(main())
