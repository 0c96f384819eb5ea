"""PyTorch's way to the gradients: they are those of the tape, whole and truncated."""

import numpy as np
import pytest

from tests.gradients.test_gradients import NUM_ENVS, actions_of, drawn, tape_of
from wtg_gym.physics.scenario import Scenario

torch = pytest.importorskip("torch", reason="PyTorch is not installed here")
from wtg_gym.gradients.torch import TorchEpisodes  # noqa: E402


def episodes_of(**settings) -> TorchEpisodes:
    return TorchEpisodes(tape_of(**settings).batch.settings, NUM_ENVS, 1)


def has_slope(cost, parameter, gradient) -> None:
    """Check that the gradient of a cost with respect to a parameter is its slope along that gradient."""
    way, h, ends = gradient / gradient.norm(), 1e-3, []
    for sign in (1.0, -2.0, 1.0):
        with torch.no_grad():
            parameter += sign * h * way
        ends.append(cost().item())
    # Observations have 32 bits: the environment's answers are no smoother than that.
    assert (ends[0] - ends[1]) / (2.0 * h) == pytest.approx(float(gradient.norm()), rel=1e-3)


def segments(episodes, scenarios: list[Scenario], policy, cut: int, n_steps: int):
    """Return the costs of the steps before and from a cut on, each of every environment (num_envs,)."""
    observations, costs = episodes.start(scenarios), [0.0, 0.0]
    for step in range(n_steps):
        if step == cut:
            observations = episodes.detach()
        observations, terms = episodes.step(torch.tanh(policy[step](observations.double())))
        costs[step >= cut] = costs[step >= cut] + terms.sum(dim=1)
    return costs[0], costs[1]


def test_a_truncated_gradient_is_that_of_a_segment_from_where_it_began():
    episodes, cut, n_steps = episodes_of(), 30, 55
    batch = episodes.tape.batch
    scenarios = drawn(episodes.tape)
    torch.manual_seed(0)
    first, second = (torch.nn.Linear(batch.n_observation, batch.n_action).double() for _ in range(2))
    policy = [first] * cut + [second] * (n_steps - cut)
    before, after = segments(episodes, scenarios, policy, cut, n_steps)
    after.sum().backward()
    # Nothing leads back behind the cut, and the segment before it can still be gone through.
    assert first.weight.grad is None
    assert second.weight.grad.abs().max() > 1e-3
    before.sum().backward()
    assert first.weight.grad.abs().max() > 1e-3
    for own, i in ((first, 0), (second, 1)):
        has_slope(lambda i=i: segments(episodes, scenarios, policy, cut, n_steps)[i].sum(), own.weight, own.weight.grad)
    with pytest.raises(ValueError, match="start"):
        episodes_of().detach()


def test_a_policy_and_a_law_have_gradients_by_backward():
    episodes = episodes_of()
    scenarios = drawn(episodes.tape)
    episodes.start(scenarios)
    torch.manual_seed(0)
    policy = torch.nn.Linear(episodes.tape.batch.n_observation, episodes.tape.batch.n_action).double()
    law = torch.tensor(episodes.tape.law()[0], requires_grad=True)

    def cost():
        observations, total = episodes.start(scenarios, law), 0.0
        for _ in range(50):
            observations, terms = episodes.step(torch.tanh(policy(observations.double())))
            total = total + terms.sum()
        return total

    before = cost()
    before.backward()
    for parameter in (*policy.parameters(), law):
        has_slope(cost, parameter, parameter.grad)
    with pytest.raises(RuntimeError, match="before the next start"):
        before.backward()
    with pytest.raises(ValueError, match=r"law must have the shape \(2, 4\)"):
        episodes.start(scenarios, torch.ones(4))
    with pytest.raises(ValueError, match="start"):
        episodes_of().step(torch.zeros(NUM_ENVS, 4))


@pytest.mark.parametrize("settings", [{}, {"version": "v1"}])
def test_torch_and_numpy_agree_to_the_last_bit(settings):
    episodes = episodes_of(**settings)
    scenarios, actions = drawn(episodes.tape), actions_of(episodes.tape, 20)
    result = episodes.tape.gradient(scenarios, actions)
    episodes.start(scenarios)
    given = torch.tensor(actions, requires_grad=True)
    torch.stack([episodes.step(own)[1] for own in given]).sum().backward()
    assert np.array_equal(given.grad.numpy(), result.actions)
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


def test_episodes_go_on_from_a_snapshot_as_often_as_asked():
    episodes = episodes_of()
    before, after = np.split(actions_of(episodes.tape, 20), 2)
    episodes.start(drawn(episodes.tape))
    for actions in before:
        episodes.step(actions)
    snapshot = episodes.tape.batch.snapshot()
    results = []
    for resumed in (False, True, True):
        if resumed:
            episodes.resume(snapshot)
        taken = torch.tensor(after, requires_grad=True)
        terms = torch.stack([episodes.step(actions)[1] for actions in taken])
        terms.sum().backward()
        results.append((terms.detach().numpy(), taken.grad.numpy()))
    for terms, gradient in results[1:]:
        assert np.array_equal(terms, results[0][0]) and np.array_equal(gradient, results[0][1])
