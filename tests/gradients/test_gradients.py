"""Gradients of an episode's cost: the kernels', checked by central differences of the environment."""

from __future__ import annotations

import functools
import math
import threading
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from wtg_gym.envs.lanes import TaskLanes
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.envs.task_records import COST_TERMS
from wtg_gym.gradients import expressions as ex
from wtg_gym.gradients.adjoint import replay
from wtg_gym.gradients.generated import build_rules
from wtg_gym.gradients.kernel_programs import programs_of
from wtg_gym.gradients.tape import Gradient, Tape
from wtg_gym.physics.elementary import exponential, fma, select, sine_cosine
from wtg_gym.physics.protection import Status
from wtg_gym.physics.scenario import GovernorLoss, LineTrip, LoadStep, MachineOutage, Scenario

Floats = npt.NDArray[np.float64]
N_LANES = 3
#: Version v1 with all that can be observed in it.
V1 = {"version": "v1", "observation_mode": "privileged"}


@functools.cache
def tape_of(cap: float = 50.0, **settings: Any) -> Tape:
    return Tape(EnvSettings(**{"version": "v0", "weights": {"cap": cap}, **settings}), N_LANES, 1)


def drawn(tape: Tape, first: int = 1_000_000) -> list[Scenario]:
    return tape.lanes.scenarios(list(range(first, first + N_LANES)))


def actions_of(tape: Tape, n_steps: int, scale: float = 0.4) -> Floats:
    shape = (n_steps, N_LANES, tape.lanes.n_action)
    return np.random.default_rng(1).uniform(-scale, scale, shape)


def played(tape: Tape, scenarios: list[Scenario], actions: Floats, law: Floats | None = None) -> Floats:
    """Terms of the cost of every lane (n_lanes, n_terms), by the environment alone."""
    tape.start(scenarios)
    if law is not None:
        tape.set_law(law)
    return np.sum([tape.step(own)[1] for own in actions], axis=0)


def slopes(tape: Tape, scenarios: list[Scenario], actions: Floats, way: Floats, h: float = 1e-5) -> Floats:
    """Central differences of the terms along a way through the actions (n_lanes, n_terms)."""
    up, down = (played(tape, scenarios, actions + sign * h * way) for sign in (1.0, -1.0))
    return (up - down) / (2.0 * h)


def along(found: Gradient, way: Floats) -> Floats:
    return np.einsum("kla,kla->l", found.actions, way)


def compiled_by_python(source: str) -> Any:
    space: dict[str, Any] = {"chosen": select, "fma": fma, "sine_cosine": sine_cosine, "exponential": exponential}
    exec(source, {**space, "math": math, "inf": math.inf}, space)
    return space["traced"]


def test_the_traced_right_hand_side_is_that_of_the_kernel() -> None:
    lanes = TaskLanes(EnvSettings(version="v0"), 1)
    lanes.start([0], lanes.scenarios([1_000_000]))
    simulator = lanes.simulator
    rng = np.random.default_rng(0)
    for _ in range(30):
        lanes.step(rng.uniform(-1.0, 1.0, (1, lanes.n_action)))
    program = programs_of(simulator.plant, lanes.task, simulator.layout.n_rows, lanes.n_action).rates
    block = simulator.blocks[0].copy()
    compiled_by_python(ex.function_source("traced", ("fraction",), program))(block, 0.0, (0,))
    simulator.evaluate()
    rates = simulator.rates()
    assert np.abs(rates).max() > 1e-3
    assert block[simulator.layout.rate_rows] == pytest.approx(rates, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("settings", [{}, {**V1, "suite": "faults"}])
def test_a_step_is_replayed_to_the_last_bit(settings: dict[str, Any]) -> None:
    tape = tape_of(**settings)
    scenarios = drawn(tape)
    tape.start(scenarios)
    for own in actions_of(tape, 60):
        tape.step(own)
    simulator, steps = tape.lanes.simulator, tape._rules.steps
    width, n = simulator.width, steps.states.size
    lane = [int(simulator.layout.lane(name)) for name in ("step", "active", "status", "coi", "least_squared_voltage")]
    blocks = [tape.before(step) for step in range(60)]
    for block, after in zip(blocks, [*blocks[1:], simulator.blocks], strict=True):
        # Actions and events have long been tested; the next step's rows hold those of this one.
        work = block[0].copy()
        for rows in (simulator.layout.wtg("k_offset"), simulator.layout.wtg("inv_tau")):
            for row in rows:
                work[row * width : (row + 1) * width] = after[0][row * width : (row + 1) * width]
        path, ran = np.empty((4, 5, n * width)), np.empty((4, width))
        inputs, held = np.empty((4, steps.inputs.size * width)), np.empty((4, steps.droops.size * width))
        replay(work, 0, simulator.plant, simulator.data, steps, path, inputs, held, ran, simulator.lanes)
        for row in (*steps.states.tolist(), *lane, *steps.outputs.tolist()):
            ours = work.reshape(-1, width)[row, :N_LANES]
            assert np.array_equal(ours, after[0].reshape(-1, width)[row, :N_LANES]), row


@pytest.mark.parametrize("term", [*COST_TERMS[:-1], None])
def test_the_gradient_is_that_of_central_differences(term: str | None) -> None:
    tape = tape_of()
    scenarios, actions = drawn(tape), actions_of(tape, 300)
    way = np.random.default_rng(2).normal(size=actions.shape)
    found = tape.gradient(scenarios, actions, None if term is None else {term: 1.0})
    measured = _measured_slopes()
    expected = measured.sum(axis=1) if term is None else measured[:, COST_TERMS.index(term)]
    assert along(found, way) == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


@functools.cache
def _measured_slopes() -> Floats:
    tape = tape_of()
    actions = actions_of(tape, 300)
    return slopes(tape, drawn(tape), actions, np.random.default_rng(2).normal(size=actions.shape))


def given(n_wtg: int, *events: Any, wind: float = 9.0) -> Scenario:
    return Scenario(name="given", wind_speed=np.full((n_wtg, 1), wind), events=events, load_noise_bus=3)


def agrees(tape: Tape, scenarios: list[Scenario], actions: Floats, tolerance: float = 1e-5) -> Gradient:
    """Check the gradient of the cost with respect to the actions, along some way; return it."""
    found = tape.gradient(scenarios, actions)
    way = np.random.default_rng(3).normal(size=actions.shape)
    expected = slopes(tape, scenarios, actions, way).sum(axis=1)
    assert np.abs(expected).max() > 1e-3
    assert along(found, way) == pytest.approx(expected, rel=tolerance, abs=tolerance * np.abs(expected).max())
    return found


def test_the_gradient_with_respect_to_the_law_is_that_of_central_differences() -> None:
    tape = tape_of()
    scenarios, actions, h = drawn(tape), actions_of(tape, 200), 1e-5
    found = tape.gradient(scenarios, actions)
    tape.start(scenarios)
    law = tape.law()
    assert np.array_equal(
        law[0, 0, :3], [getattr(tape.lanes.laws[0], name) for name in ("k_min", "k_nominal", "k_max")]
    )
    for place in np.ndindex(law.shape[1:]):
        step = np.zeros_like(law)
        step[:, *place] = h
        up, down = (played(tape, scenarios, actions, law + sign * step).sum(axis=1) for sign in (1.0, -1.0))
        expected = (up - down) / (2.0 * h)
        assert found.law[:, *place] == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


def test_the_gradient_goes_through_outages_and_lost_governors() -> None:
    tape = tape_of()
    buses = [machine.bus for machine in tape.lanes.simulator.settings.case.machines if machine.governor is not None]
    step = LoadStep(time_s=0.525, bus=4, power_mw=15.0)
    scenarios = [
        given(2, step, GovernorLoss(time_s=2.35, bus=buses[0])),
        given(2, step, MachineOutage(time_s=1.05, bus=3)),
        given(2, step, LineTrip(time_s=1.075, from_bus=4, to_bus=5, recloses_after_s=0.225)),
    ]
    agrees(tape, scenarios, actions_of(tape, 80))


def test_a_lost_governor_holds_a_gate_that_actions_have_moved() -> None:
    tape = tape_of()
    buses = [machine.bus for machine in tape.lanes.simulator.settings.case.machines if machine.governor is not None]
    step = LoadStep(time_s=0.5, bus=4, power_mw=15.0)
    scenarios = [given(2, step, GovernorLoss(time_s=4.0, bus=buses[0]))] * N_LANES
    actions = actions_of(tape, 80)
    found = tape.gradient(scenarios, actions)
    # Only actions before the loss act on the gate, and only frequencies after it tell of the reference.
    way = np.random.default_rng(4).normal(size=actions.shape) * (np.arange(80) < 40)[:, np.newaxis, np.newaxis]
    expected = slopes(tape, scenarios, actions, way).sum(axis=1)
    assert along(found, way) == pytest.approx(expected, rel=1e-5)


def test_the_gradient_goes_through_the_limits_of_the_pitch() -> None:
    tape = tape_of()
    time = np.arange(0.0, 31.0, 0.1)
    step = LoadStep(time_s=1.0, bus=4, power_mw=60.0)
    scenarios = [
        Scenario(name="gusts", wind_speed=np.tile(mean + 5.0 * np.sin(0.5 * time), (2, 1)), events=(step,))
        for mean in (9.5, 10.0, 10.5)
    ]
    actions = actions_of(tape, 300, 0.3)
    way = np.random.default_rng(3).normal(size=actions.shape)
    found, expected = tape.gradient(scenarios, actions), slopes(tape, scenarios, actions, way, 1e-6).sum(axis=1)
    row = tape.lanes.simulator.layout.wtg("pitch_integral")
    turned = np.array([tape._take(block.reshape(1, -1, 16), row) > 0.0 for block in map(tape.before, range(300))]).any(
        axis=(1, 2)
    )
    # The controller acts, comes to rest at its limit, and acts again.
    assert np.count_nonzero(np.diff(turned.astype(int))) >= 3
    assert along(found, way) == pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max())


def test_an_episode_that_ends_early_has_the_gradient_of_what_it_paid() -> None:
    tape = tape_of()
    scenarios = [given(2, LoadStep(time_s=1.0, bus=4, power_mw=power)) for power in (600.0, -300.0, 20.0)]
    actions = actions_of(tape, 60, 0.2)
    found = agrees(tape, scenarios, actions)
    played(tape, scenarios, actions)
    ended = tape.lanes.simulator.lane_values("step") / tape.lanes.simulator.plant.n_substeps
    statuses = tape.lanes.statuses()
    assert (statuses[:2] != Status.RUNNING).all() and (ended[:2] < 50).all()
    assert statuses[2] == Status.RUNNING
    # The cost of the failure is constant, and steps after it have no effect.
    assert found.terms[0, COST_TERMS.index("failure")] > 0.0
    failure = tape.gradient(scenarios, actions, {"failure": 1.0})
    assert not failure.actions.any() and not failure.law.any()
    last = math.ceil(ended[0]) - 1
    assert found.actions[last, 0].any() and not found.actions[last + 1 :, 0].any()


@pytest.mark.parametrize("settings", [{}, V1])
def test_observations_have_gradients(settings: dict[str, Any]) -> None:
    tape = tape_of(**settings)
    scenarios, actions = drawn(tape), actions_of(tape, 60)
    rng = np.random.default_rng(5)
    way, weights = rng.normal(size=actions.shape), rng.normal(size=(60, N_LANES, tape.lanes.n_observation))

    def weighed(given: Floats) -> Floats:
        # As the kernels know them, before they are rounded to 32 bits.
        tape.start(scenarios)
        found = []
        for own in given:
            tape.step(own)
            found.append(tape._take(tape._values(), tape._rules.observation))
        return np.einsum("klo,klo->l", weights, np.array(found))

    h = 1e-6
    expected = (weighed(actions + h * way) - weighed(actions - h * way)) / (2.0 * h)
    carried, terms, total = np.zeros((N_LANES, tape.n_carried)), np.zeros((N_LANES, len(COST_TERMS))), np.zeros(N_LANES)
    for step in range(59, -1, -1):
        carried, own, *_ = tape.pull(step, carried, terms, weights[step])
        total += np.einsum("la,la->l", own, way[step])
    assert total == pytest.approx(expected, rel=1e-5)


def test_other_settings_have_gradients_of_their_own() -> None:
    """Ends within a control interval too: this one is longer than that of the protections."""
    tape = tape_of(
        machine_model="classical",
        action_mode="tau",
        observation_mode="privileged",
        strategy="coordinated-piecewise",
        control_dt=0.5,
        # So high that the failing lanes' last costs are not cut.
        cap=5000.0,
    )
    scenarios = [given(2, LoadStep(time_s=1.0, bus=4, power_mw=power)) for power in (600.0, -300.0, 20.0)]
    actions = actions_of(tape, 40)
    found = tape.gradient(scenarios, actions)
    way = np.random.default_rng(3).normal(size=actions.shape)
    assert along(found, way) == pytest.approx(slopes(tape, scenarios, actions, way).sum(axis=1), rel=1e-5)
    played(tape, scenarios, actions)
    ended = tape.lanes.simulator.lane_values("step") / tape.lanes.simulator.plant.n_substeps
    assert (ended[:2] < 40).all() and (ended[:2] % 1.0 > 0.0).all()


def test_generated_code_does_not_depend_on_what_was_traced_before() -> None:
    """Its machine code would not be found on disk again."""
    lanes = tape_of().lanes
    simulator = lanes.simulator
    given = (simulator.plant, lanes.task, simulator.layout, lanes.n_action)
    ex.exponential(ex.row_of_block(400) * ex.row_of_block(0) + 1.0)
    assert build_rules(*given).digest == build_rules(*given).digest == tape_of()._rules.digest


def test_threads_may_make_their_tapes_at_once() -> None:
    lanes = tape_of().lanes
    simulator, digests = lanes.simulator, list[str]()

    def build() -> None:
        rules = build_rules(simulator.plant, lanes.task, simulator.layout, lanes.n_action)
        digests.append(rules.digest)

    threads = [threading.Thread(target=build) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert digests == [tape_of()._rules.digest] * 3


def test_an_episode_alone_has_the_bits_of_one_in_a_batch() -> None:
    batch, alone = tape_of(), Tape(EnvSettings(version="v0"), 1, 1)
    scenarios, actions = drawn(batch), actions_of(batch, 40)
    found, single = batch.gradient(scenarios, actions), alone.gradient(scenarios[1:2], actions[:, 1:2])
    assert np.array_equal(single.actions, found.actions[:, 1:2])
    assert np.array_equal(single.law, found.law[1:2])


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda tape, scenarios: tape.gradient(scenarios, np.zeros((5, N_LANES, 9))), "shape"),
        (lambda tape, scenarios: tape.gradient(scenarios, np.zeros((5, 4))), "n_steps"),
        (lambda tape, scenarios: tape.gradient(scenarios, np.zeros((5, N_LANES, 4)), {"noise": 1.0}), "noise"),
        (lambda tape, scenarios: tape.gradient(scenarios, np.zeros((5, N_LANES, 4)), {"duty": np.nan}), "finite"),
        (lambda tape, scenarios: tape.gradient(scenarios, np.zeros((5, N_LANES, 4)), np.ones(7)), "names of terms"),
        # One would have been played in all lanes.
        (lambda tape, scenarios: tape.start(scenarios[:1]), "3 scenarios, one per lane"),
        (lambda tape, scenarios: tape.start([1_000_000] * N_LANES), "scenarios"),
        (lambda tape, scenarios: Tape(EnvSettings(version="v0"), N_LANES, 1).step(np.zeros((N_LANES, 4))), "start"),
        (lambda tape, scenarios: Tape(EnvSettings(version="v0"), N_LANES, 1).law(), "start"),
        (lambda tape, scenarios: Tape(EnvSettings(version="v0"), N_LANES, 1).outputs(), "start"),
        (lambda tape, scenarios: Tape(EnvSettings(version="v0"), N_LANES, 1).back(), "start"),
        (lambda tape, scenarios: tape.set_law(tape.law()), "first step"),
        (
            lambda tape, scenarios: restarted(tape, scenarios).set_law(tape.law()[:, :, :3]),
            r"law must have the shape \(3, 2, 4\), got",
        ),
        (lambda tape, scenarios: restarted(tape, scenarios).set_law(tape.law() * np.nan), "finite"),
        (lambda tape, scenarios: pulled(tape, 1), "no step 1: since start.. 1 have"),
        (lambda tape, scenarios: pulled(tape, -1), "no step -1"),
        (lambda tape, scenarios: pulled(tape, 0, carried=0.0), "carried must have the shape"),
        (lambda tape, scenarios: pulled(tape, 0, terms=np.zeros(7)), "terms must have the shape"),
        (lambda tape, scenarios: pulled(tape, 0, observations=np.zeros(3)), "observations must have the shape"),
        (lambda tape, scenarios: pulled(tape, 0, outputs=np.zeros(3)), "outputs must have the shape"),
        # More steps than were taken, the last of which would have counted nothing.
        (lambda tape, scenarios: tape.back(outputs=np.zeros((2, N_LANES, 8))), r"\(1, 3, 8\), got \(2, 3, 8\)"),
        (lambda tape, scenarios: tape.back(np.ones(3)), r"or \(7,\), got \(3,\)"),
    ],
)
def test_bad_input_is_refused(call: Any, reason: str) -> None:
    tape = tape_of()
    scenarios = drawn(tape)
    tape.gradient(scenarios, np.zeros((1, N_LANES, 4)))
    with pytest.raises(ValueError, match=reason):
        call(tape, scenarios)


def restarted(tape: Tape, scenarios: list[Scenario]) -> Tape:
    tape.start(scenarios)
    return tape


def pulled(tape: Tape, step: int, **other: Any) -> Any:
    given = {"carried": np.zeros((N_LANES, tape.n_carried)), "terms": np.zeros((N_LANES, len(COST_TERMS)))}
    return tape.pull(step, **given | other)


def test_a_policy_trains_by_backward() -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed here")
    from wtg_gym.gradients.torch import TorchEpisodes

    episodes = TorchEpisodes(EnvSettings(version="v0"), N_LANES, 1)
    scenarios = drawn(episodes.tape)
    episodes.start(scenarios)
    torch.manual_seed(0)
    policy = torch.nn.Linear(episodes.tape.lanes.n_observation, episodes.tape.lanes.n_action).double()
    law = torch.tensor(episodes.tape.law()[0], requires_grad=True)

    def cost() -> Any:
        observations, total = episodes.start(scenarios, law), 0.0
        for _ in range(50):
            observations, terms = episodes.step(torch.tanh(policy(observations.double())))
            total = total + terms.sum()
        return total

    parameters = [*policy.parameters(), law]
    before = cost()
    before.backward()
    found = [parameter.grad.clone() for parameter in parameters]
    for parameter, gradient in zip(parameters, found, strict=True):
        way, h, ends = gradient / gradient.norm(), 1e-3, []
        for sign in (1.0, -2.0, 1.0):
            with torch.no_grad():
                parameter += sign * h * way
            ends.append(cost().item())
        # Observations have 32 bits: the environment's answers are no smoother than that.
        assert (ends[0] - ends[1]) / (2.0 * h) == pytest.approx(float(gradient.norm()), rel=1e-3)
    with torch.no_grad():
        for parameter, gradient in zip(policy.parameters(), found[:-1], strict=True):
            parameter -= 0.01 * gradient
    assert cost() < before
    with pytest.raises(RuntimeError, match="before the next start"):
        before.backward()
    with pytest.raises(ValueError, match=r"law must have the shape \(2, 4\)"):
        episodes.start(scenarios, torch.ones(4))
    with pytest.raises(ValueError, match="start"):
        TorchEpisodes(EnvSettings(version="v0"), N_LANES, 1).step(torch.zeros(N_LANES, 4))


@pytest.mark.parametrize("settings", [{}, V1])
def test_torch_and_numpy_agree_to_the_last_bit(settings: dict[str, Any]) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed here")
    from wtg_gym.gradients.torch import TorchEpisodes

    episodes = TorchEpisodes(EnvSettings(**{"version": "v0", "weights": {"cap": 50.0}, **settings}), N_LANES, 1)
    scenarios, actions = drawn(episodes.tape), actions_of(episodes.tape, 20)
    found = episodes.tape.gradient(scenarios, actions)
    episodes.start(scenarios)
    given = torch.tensor(actions, requires_grad=True)
    torch.stack([episodes.step(own)[1] for own in given]).sum().backward()
    assert np.array_equal(given.grad.numpy(), found.actions)

    played = episodes.tape.play(scenarios, actions)
    of_actions, _, _ = episodes.tape.back(outputs=np.ones_like(played.outputs))
    episodes.start(scenarios)
    given, outputs = torch.tensor(actions, requires_grad=True), []
    for own in given:
        episodes.step(own)
        outputs.append(episodes.outputs)
    torch.stack(outputs).sum().backward()
    assert np.array_equal(torch.stack(outputs).detach().numpy(), played.outputs)
    assert np.array_equal(given.grad.numpy(), of_actions)
