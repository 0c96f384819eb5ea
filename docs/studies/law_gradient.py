"""`python docs/studies/law_gradient.py`: tunes the paper's law by gradients of whole episodes."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import NamedTuple

import numpy as np
from rollouts import Rollouts

from agents.command import (
    Parser,
    Progress,
    add_threads_option,
    check_page,
    print_table,
    run_command,
    say,
    suite_name,
    update_page,
)
from wtg_gym.analysis.influence_study import LAW_NAMES, MEASURES, measure_influences
from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.evaluation.score import COST_OFFSET, log_gains, mean_score, score_scale
from wtg_gym.files import markdown_table
from wtg_gym.gradients import Tape
from wtg_gym.physics.layout import Floats
from wtg_gym.physics.tracking_law import LARGEST_COEFFICIENT, TIME_CONSTANT_RANGE, TrackingLaw, get_law
from wtg_gym.scenarios import get_suite

Laws = tuple[TrackingLaw, ...]

#: Least coefficient and time constant that are tried [p.u., s]: at 0 a group would give nothing, and faster damping
#: than the integration step follows is refused.
_LEAST_COEFFICIENT, _LEAST_TAU_S = 0.05, 0.1
#: How much further than k [p.u.] a step of the optimiser takes ln τ.
_SCALE = np.array([1.0, 1.0, 1.0, 5.0])
#: Distance of the two runs that tell what k_nominal does [p.u.].
_H = 1e-4
#: Validation scenarios of which the effects of parameters are means.
_N_INFLUENCES = 20

_DESCRIPTION = """\
Tunes k_min, k_nominal, k_max and τ of the paper's law by Adam on the gradients of wtg_gym.gradients: the mean of
ln(J + J0) over random training scenarios, which decides the score, is lowered. What k_nominal does, which moves the
equilibrium before an episode too, a difference of two runs tells. The laws that come of it, one for all groups and one
for each, are played on the validation scenarios beside the paper's. The law of version v1 was found without gradients,
by docs/studies/tuned_law.py."""


class Tuned(NamedTuple):
    """Laws of the groups, the mean of ln(J + J0) of each batch before its step, and how long it took [s]."""

    laws: Laws
    losses: tuple[float, ...]
    seconds: float


class LawLoss:
    """Mean of ln(J + J0) over scenarios as a function of the laws' parameters, and its gradient."""

    def __init__(self, suite: str, n_lanes: int, n_threads: int | None = None) -> None:
        settings = EnvSettings(suite=suite)
        self.tape = Tape(settings, n_lanes, n_threads)
        self._lanes = TaskLanes(settings, n_lanes, n_threads)
        self.n_groups = self.tape.lanes.n_wtg
        self.n_steps = round(self.tape.lanes.duration_s / settings.control_dt)

    def laws(self, points: Floats) -> Laws:
        """Return the law of each group at a point (n_groups, 4) or (1, 4) for all: k_min, k_nominal, k_max, ln τ."""
        rows = np.broadcast_to(points, (self.n_groups, 4)).tolist()
        return tuple(
            TrackingLaw(name="tuned", k_min=low, k_nominal=nominal, k_max=high, damping_time_constant_s=math.exp(tau))
            for low, nominal, high, tau in rows
        )

    def __call__(self, points: Floats, seeds: Sequence[int]) -> tuple[float, Floats]:
        """Return the loss over the scenarios of seeds, one per lane, and its gradient in the form of the points."""
        lanes = self.tape.lanes
        lanes.laws = self.laws(points)
        scenarios = lanes.scenarios(seeds)
        found = self.tape.gradient(scenarios, np.zeros((self.n_steps, lanes.n_lanes, lanes.n_action)))
        costs = found.terms.sum(axis=1) + COST_OFFSET
        of_groups = np.einsum("l,lgp->gp", 1.0 / costs, found.law) / lanes.n_lanes
        # d(1/τ) / d ln τ = -1/τ.
        of_groups[:, 3] *= -np.array([law.inverse_time_constant for law in lanes.laws])
        gradient = of_groups if points.shape[0] > 1 else of_groups.sum(axis=0, keepdims=True)
        for place in range(points.shape[0]):
            ends = []
            for sign in (1.0, -1.0):
                moved = points.copy()
                moved[place, 1] += sign * _H
                ends.append(self._loss(self.laws(moved), scenarios))
            gradient[place, 1] = (ends[0] - ends[1]) / (2.0 * _H)
        return float(np.log(costs).mean()), gradient

    def _loss(self, laws: Laws, scenarios: Sequence[object]) -> float:
        lanes, idle = self._lanes, np.zeros((self._lanes.n_lanes, self._lanes.n_action))
        lanes.laws = laws
        lanes.start(list(range(lanes.n_lanes)), scenarios)  # type: ignore[arg-type]
        for _ in range(self.n_steps):
            lanes.step(idle)
        return float(np.log(lanes.cost_sums().sum(axis=1) + COST_OFFSET).mean())


def held(points: Floats) -> Floats:
    """Return points within the ranges that laws have."""
    low = [_LEAST_COEFFICIENT] * 3 + [math.log(_LEAST_TAU_S)]
    return np.clip(points, low, [LARGEST_COEFFICIENT] * 3 + [math.log(TIME_CONSTANT_RANGE[1]) - 1e-9])


def tune(
    suite: str,
    *,
    per_group: bool,
    n_batches: int,
    n_scenarios: int,
    seed: int,
    learning_rate: float = 0.02,
    on_batch: Callable[[int, float], None] = lambda _done, _loss: None,
    n_threads: int | None = None,
) -> Tuned:
    """Lower the loss by Adam, whose learning rate falls along half a cosine, from the paper's law on."""
    began = time.monotonic()
    loss_of = LawLoss(suite, n_scenarios, n_threads)
    paper, train = get_law("coordinated-piecewise"), get_suite(suite).train
    point = np.array([[paper.k_min, paper.k_nominal, paper.k_max, math.log(paper.damping_time_constant_s)]])
    points = np.repeat(point, loss_of.n_groups if per_group else 1, axis=0)
    mean, square, losses = np.zeros_like(points), np.zeros_like(points), []
    for batch in range(n_batches):
        rng = np.random.default_rng((seed, batch))
        loss, gradient = loss_of(points, rng.integers(train.start, train.stop, n_scenarios).tolist())
        losses.append(loss)
        gradient = gradient * _SCALE
        mean, square = 0.9 * mean + 0.1 * gradient, 0.98 * square + 0.02 * gradient**2
        rate = learning_rate * (0.5 + 0.5 * math.cos(math.pi * batch / n_batches))
        step = (mean / (1.0 - 0.9 ** (batch + 1))) / (np.sqrt(square / (1.0 - 0.98 ** (batch + 1))) + 1e-12)
        points = held(points - rate * _SCALE * step)
        on_batch(batch + 1, loss)
    return Tuned(loss_of.laws(points), tuple(losses), time.monotonic() - began)


def scores(
    suite: str, laws: Sequence[Laws], n_scenarios: int, n_threads: int | None = None
) -> list[tuple[float, float]]:
    """Return score and mean cost of laws on the first validation scenarios of a suite."""
    benchmark, seeds = get_suite(suite).benchmark, list(get_suite(suite).validation[:n_scenarios])
    with closing(Rollouts(suite, "validation", seeds, 1, n_threads)) as rollouts:

        def costs_of(own: TrackingLaw | Laws) -> Floats:
            return rollouts.pinned(rollouts.play(rollouts.no_action, [own]))[:, 0]

        zero, hundred = (costs_of(get_law(name)) for name in (benchmark.zero, benchmark.hundred))
        scale, found = score_scale(zero, hundred), []
        for own in laws:
            costs = costs_of(own)
            found.append((mean_score(log_gains(costs[np.newaxis], hundred), scale), float(costs.mean())))
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = Parser(prog="python docs/studies/law_gradient.py", description=_DESCRIPTION)
    parser.add_argument("--suite", type=suite_name, default="standard", metavar="NAME", help="(default: standard)")
    parser.add_argument("--batches", type=int, default=100, metavar="N", help="steps of Adam (default: 100)")
    parser.add_argument("--scenarios", type=int, default=32, metavar="N", help="per batch (default: 32)")
    parser.add_argument("--validation", type=int, default=100, metavar="N", help="validation scenarios (default: 100)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the training scenarios (default: 0)")
    add_threads_option(parser)
    parser.add_argument("--page", metavar="FILE", help="Markdown file with markers 'law' to put the tables between")

    def work() -> None:
        given = parser.parse_args(argv)
        page = check_page("--page", given.page, "law")
        for name, least in (("batches", 1), ("scenarios", 1), ("validation", 1), ("seed", 0)):
            if getattr(given, name) < least:
                raise ValueError(f"--{name} = {getattr(given, name)} is outside the allowed range: {least} or more")
        found = {}
        with Progress("batches") as progress:
            for number, per_group in enumerate((False, True)):
                found[per_group] = tune(
                    given.suite,
                    per_group=per_group,
                    n_batches=given.batches,
                    n_scenarios=given.scenarios,
                    seed=given.seed,
                    on_batch=lambda done, loss, number=number: progress.update(  # type: ignore[misc]
                        f"mean ln(J + J0) {loss:.4f}", number * given.batches + done, 2 * given.batches
                    ),
                    n_threads=given.threads,
                )
        paper = (get_law("coordinated-piecewise"),) * len(found[False].laws)
        rows = _rows(given.suite, paper, found, given.validation, given.threads)
        effects = _effects(given.suite, {"paper": paper, "tuned": found[False].laws}, given.validation, given.threads)
        if page is not None:
            tables = (markdown_table(*rows, right=range(1, 8)), markdown_table(*effects, right=range(1, 7)))
            update_page(page, {"law": "\n\n".join(tables)})
            return
        say(f"{given.batches} batches of {given.scenarios} training scenarios of {given.suite}, seed {given.seed}", "")
        print_table(*rows)
        say("", "one per cent more, means over validation scenarios:")
        print_table(*effects)

    return run_command(work)


Table = tuple[tuple[str, ...], list[tuple[str, ...]]]


def _rows(suite: str, paper: Laws, found: dict[bool, Tuned], n_validation: int, n_threads: int | None) -> Table:
    """Return the laws with their scores."""
    entries = [("the paper's", paper, "")]
    entries += [
        ("one for each group" if per_group else "one for all groups", own.laws, f"{own.seconds:.0f}")
        for per_group, own in found.items()
    ]
    rows = []
    for (name, laws, seconds), (score, cost) in zip(
        entries, scores(suite, [laws for _, laws, _ in entries], n_validation, n_threads), strict=True
    ):
        texts = [_each(laws, key) for key in ("k_min", "k_nominal", "k_max", "damping_time_constant_s")]
        rows.append((name, *texts, f"{score:.1f}", f"{cost:.2f}", seconds))
    return ("law", "k_min", "k_nominal", "k_max", "τ [s]", "score", "mean cost", "seconds"), rows


def _each(laws: Laws, key: str) -> str:
    values = [f"{getattr(law, key):.3f}" for law in laws]
    return values[0] if len(set(values)) == 1 else " / ".join(values)


def _effects(suite: str, laws: dict[str, Laws], n_validation: int, n_threads: int | None) -> Table:
    """Return what one per cent more of each parameter does to nadir and rotor speed under each of some laws."""
    own = get_suite(suite)
    measures = [name for name in MEASURES if name != "rocof"]
    columns: list[list[str]] = []
    heads = ["1 % more of"]
    for label, groups in laws.items():
        settings = EnvSettings(suite=suite, strategy=groups)
        lanes = TaskLanes(settings, 1, n_threads)
        seeds = list(own.validation[: min(n_validation, _N_INFLUENCES)])
        found = measure_influences(settings, lanes.scenarios(seeds), n_threads=n_threads)
        means = found.effects.mean(axis=0)
        for name in measures:
            heads.append(f"{name.replace('_', ' ')} [{MEASURES[name][0]}], {label}")
            place = list(MEASURES).index(name)
            columns.append([f"{means[found.parameters.index(own), place]:+.3g}" for own in LAW_NAMES])
    return tuple(heads), [tuple(row) for row in zip(LAW_NAMES, *columns, strict=True)]


if __name__ == "__main__":
    sys.exit(main())
