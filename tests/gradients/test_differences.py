"""Gradients on corners, and the check by differences that users call."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.gradients.test_gradients import N_LANES, actions_of, along, drawn, given, played, tape_of
from wtg_gym.gradients import LAW_PARAMETERS, Tape, check_by_differences
from wtg_gym.physics.scenario import LoadStep, Scenario

#: At rest at nominal frequency, on the middle corner of the law, for a second.
AT_REST = [given(2, LoadStep(time_s=1.0, bus=4, power_mw=power)) for power in (10.0, 20.0, 30.0)]


def test_a_plant_at_rest_has_the_slopes_of_the_law_whose_lower_part_goes_on_straight() -> None:
    tape = tape_of()
    actions = np.zeros((40, N_LANES, 4))
    way = np.random.default_rng(3).normal(size=actions.shape) * (np.arange(40) < 10)[:, np.newaxis, np.newaxis]
    found = along(tape.gradient(AT_REST, actions), way)
    tape.start(AT_REST)
    straight = tape.law()
    straight[:, :, 2] = 2.0 * straight[:, :, 1] - straight[:, :, 0]
    base = played(tape, AT_REST, actions)
    # The frequency never rises above its nominal value.
    assert np.array_equal(played(tape, AT_REST, actions, straight), base)
    h = 1e-5
    up, down = (played(tape, AT_REST, actions + sign * h * way, straight).sum(axis=1) for sign in (1.0, -1.0))
    assert found == pytest.approx((up - down) / (2.0 * h), rel=1e-5)
    # With its corner, the law has another slope on each side.
    checked = check_by_differences(tape, AT_REST, actions, direction=way)[0]
    assert (np.abs(checked.above - checked.below) > 0.01 * np.abs(checked.central)).all()


def test_the_check_moves_actions_laws_and_parameters_and_finds_the_gradient() -> None:
    parameters = ("control.droop_gain_pu", "machines.1.governor.turbine_damping_pu")
    tape = Tape(tape_of().lanes.settings, N_LANES, 1, parameters)
    scenarios, actions = drawn(tape), actions_of(tape, 60)
    values = tape.parameter_values()
    checked = check_by_differences(tape, scenarios, actions, {"frequency": 1.0, "duty": 0.5})
    assert [each.name for each in checked] == ["actions", *LAW_PARAMETERS, *parameters]
    for each in checked:
        assert each.gradient.shape == each.central.shape == each.above.shape == each.error.shape == (N_LANES,)
        # Below 0 there is no turbine damping: its slope is that of one side, with an error of the first order.
        one_sided = each.name == parameters[1]
        assert each.gradient.any()
        assert each.gradient == pytest.approx(each.central, rel=1e-3 if one_sided else 1e-5)
        assert np.isnan(each.below).all() == one_sided
    assert tape.parameter_values() == values
    table = str(checked).splitlines()
    assert table[0].startswith("| moved | lane | gradient | central difference |")
    assert [line.split(" | ")[0].strip("| ") for line in table[2:]] == [each.name for each in checked]


def test_the_check_shows_a_wrong_gradient(monkeypatch: pytest.MonkeyPatch) -> None:
    tape = tape_of()
    right = tape.gradient

    def wrong(*arguments: Any) -> Any:
        found = right(*arguments)
        return found._replace(actions=1.01 * found.actions)

    monkeypatch.setattr(tape, "gradient", wrong)
    checked = check_by_differences(tape, drawn(tape), actions_of(tape, 20))
    assert checked[0].error == pytest.approx(np.full(N_LANES, 0.01 / 1.01), rel=1e-2)
    assert (checked[1].error < 1e-5).all()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"step": 0.0}, r"step must be a number in 1e-9 … 0.1, got 0.0"),
        ({"step": "small"}, "step must be a number"),
        ({"direction": np.ones(3)}, r"direction must be finite numbers of the actions' shape \(2, 3, 4\), got \(3,\)"),
        ({"weights": {"power": 1.0}}, "unknown terms"),
        ({"actions": np.zeros((2, 4))}, "actions must have the shape"),
    ],
)
def test_bad_input_is_refused(arguments: dict[str, Any], reason: str) -> None:
    tape = tape_of()
    scenarios: list[Scenario] = drawn(tape)
    with pytest.raises(ValueError, match=reason):
        check_by_differences(**{"tape": tape, "scenarios": scenarios, "actions": np.zeros((2, N_LANES, 4))} | arguments)


def segments(episodes: Any, scenarios: list[Scenario], policy: Any, cut: int, n_steps: int) -> tuple[Any, Any]:
    """Return the costs of the steps before and from a cut on, each of every lane (n_lanes,)."""
    torch = pytest.importorskip("torch")
    observations, costs = episodes.start(scenarios), [0.0, 0.0]
    for step in range(n_steps):
        if step == cut:
            observations = episodes.detach()
        observations, terms = episodes.step(torch.tanh(policy[step](observations.double())))
        costs[step >= cut] = costs[step >= cut] + terms.sum(dim=1)
    return costs[0], costs[1]


def test_a_truncated_gradient_is_that_of_a_segment_from_where_it_began() -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed here")
    from wtg_gym.gradients.torch import TorchEpisodes

    episodes, cut, n_steps = TorchEpisodes(tape_of().lanes.settings, N_LANES, 1), 30, 55
    lanes = episodes.tape.lanes
    scenarios = drawn(episodes.tape)
    torch.manual_seed(0)
    first, second = (torch.nn.Linear(lanes.n_observation, lanes.n_action).double() for _ in range(2))
    policy = [first] * cut + [second] * (n_steps - cut)
    before, after = segments(episodes, scenarios, policy, cut, n_steps)
    after.sum().backward()
    # Nothing leads back behind the cut, and the segment before it can still be gone through.
    assert first.weight.grad is None
    assert second.weight.grad.abs().max() > 1e-3
    before.sum().backward()
    assert first.weight.grad.abs().max() > 1e-3
    for own, part in ((first, 0), (second, 1)):
        way, h, ends = own.weight.grad / own.weight.grad.norm(), 1e-3, []
        for sign in (1.0, -2.0, 1.0):
            with torch.no_grad():
                own.weight += sign * h * way
            ends.append(segments(episodes, scenarios, policy, cut, n_steps)[part].sum().item())
        # Observations have 32 bits: the environment's answers are no smoother than that.
        assert (ends[0] - ends[1]) / (2.0 * h) == pytest.approx(float(own.weight.grad.norm()), rel=1e-3)


def test_a_cut_takes_from_a_gradient_what_crosses_it_and_nothing_else() -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed here")
    from wtg_gym.gradients.torch import TorchEpisodes

    episodes, cut, n_steps = TorchEpisodes(tape_of().lanes.settings, N_LANES, 1), 45, 60
    # The first episode has ended before the cut.
    scenarios = [given(2, LoadStep(time_s=1.0, bus=4, power_mw=power)) for power in (600.0, 20.0, 30.0)]
    actions, found, costs = actions_of(episodes.tape, n_steps, 0.2), [], []
    for cuts in (False, True):
        episodes.start(scenarios)
        given_actions, total = torch.tensor(actions, requires_grad=True), 0.0
        for step, own in enumerate(given_actions):
            if cuts and step == cut:
                assert not episodes.detach().requires_grad and not episodes.outputs.requires_grad
            total = total + episodes.step(own)[1].sum()
        total.backward()
        found.append(given_actions.grad.numpy())
        costs.append(total.item())
    whole, truncated = found
    assert costs[0] == costs[1]
    assert whole[:cut, 0].any() and np.array_equal(truncated[:, 0], whole[:, 0])
    assert np.array_equal(truncated[cut:], whole[cut:])
    assert (np.abs(truncated[:cut, 1:] - whole[:cut, 1:]).max(axis=(0, 2)) > 1e-3).all()
    with pytest.raises(ValueError, match="start"):
        TorchEpisodes(tape_of().lanes.settings, N_LANES, 1).detach()


def test_gradcheck_cannot_work() -> None:
    """It plays again before it goes back: the documentation says so."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed here")
    from wtg_gym.gradients.torch import TorchEpisodes

    episodes = TorchEpisodes(tape_of().lanes.settings, N_LANES, 1)
    scenarios = drawn(episodes.tape)

    def cost(actions: Any) -> Any:
        episodes.start(scenarios)
        return episodes.step(actions)[1].sum()

    with pytest.raises(RuntimeError, match="before the next start"):
        torch.autograd.gradcheck(cost, torch.zeros(N_LANES, 4, dtype=torch.float64, requires_grad=True))
