"""Episodes that PyTorch differentiates: a policy trains by `loss.backward()`.

episodes = TorchEpisodes(EnvSettings(), num_envs=64)
observations, cost = episodes.start(scenarios), 0.0
for _ in range(600):
    observations, terms = episodes.step(policy(observations))
    cost = cost + terms.sum(dim=1)
cost.mean().backward()
"""

from collections.abc import Sequence
from typing import Any

from wtg_gym.extras import install_advice

try:
    import torch
    from torch.autograd.function import once_differentiable
except ImportError as error:
    raise ImportError(f"wtg_gym.gradients.torch needs PyTorch; {install_advice('train')}") from error

from wtg_gym.envs.batch import BatchSnapshot
from wtg_gym.envs.settings import EnvSettings
from wtg_gym.gradients.tape import Tape
from wtg_gym.physics.scenario import Scenario


class _Step(torch.autograd.Function):
    """A step of a tape. One step hands the next a tensor of zeros, whose gradient alone has a meaning."""

    @staticmethod
    def forward(ctx: Any, tape: Tape, carried: Any, law: Any, actions: Any) -> tuple[Any, ...]:
        ctx.tape, ctx.step, ctx.start, ctx.dtypes = tape, tape.n_steps, tape.n_starts, (law.dtype, actions.dtype)
        observations, terms = tape.step(actions.detach().to("cpu", torch.float64).contiguous().numpy())
        shown = (torch.from_numpy(array) for array in (observations, terms, tape.outputs()))
        return torch.zeros_like(carried), *shown

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, carried: Any, observations: Any, terms: Any, outputs: Any) -> tuple[Any, Any, Any, Any]:
        if ctx.start != ctx.tape.n_starts:
            raise RuntimeError("backward() must come before the next start(): the steps of these episodes are gone")
        seeds = (seed.to(torch.float64).numpy() for seed in (carried, terms, observations, outputs))
        pulled = ctx.tape.pull(ctx.step, *seeds)
        of_law, of_actions = ctx.dtypes
        return (
            None,
            torch.from_numpy(pulled.carried),
            torch.from_numpy(pulled.law).to(of_law),
            torch.from_numpy(pulled.actions).to(of_actions),
        )


_apply: Any = _Step.apply


class TorchEpisodes:
    """A :class:`~wtg_gym.gradients.tape.Tape` of tensors, on the CPU; its arguments and errors are the tape's.

    Parameters of the plant are the tape's alone.
    """

    def __init__(self, settings: EnvSettings, num_envs: int = 1, n_threads: int | None = None) -> None:
        self.tape = Tape(settings, num_envs, n_threads)
        self._left: Any = None
        self._law: Any = None
        self._observations: Any = None
        #: Those of the tape at the end of the latest step (num_envs, n_outputs), in the order of its `output_names`;
        #: None before the first.
        self.outputs: Any = None

    def start(self, scenarios: Sequence[Scenario], law: Any = None) -> Any:
        """Start an episode in every environment and return the first observations.

        Args:
            scenarios: one per environment.
            law: parameters of the groups' laws to differentiate with respect to (n_wtg, 4) or (num_envs, n_wtg, 4), in
                the order of `LAW_PARAMETERS`; None for those of the settings.
        """
        observations = self._begin(self.tape.start(scenarios))
        if law is not None:
            law, laws = torch.as_tensor(law), self._law
            if law.shape not in (laws.shape, laws.shape[1:]):
                raise ValueError(
                    f"law must have the shape {tuple(laws.shape[1:])}, or one per environment, got {tuple(law.shape)}"
                )
            self._law = law.expand(laws.shape)
            self.tape.set_law(self._law.detach().to("cpu", torch.float64).numpy())
        return observations

    def resume(self, snapshot: BatchSnapshot) -> Any:
        """Go on from a snapshot of the tape's environments, with their laws, as if episodes started there.

        Returns:
            its observations (num_envs, n_observation), floats of 32 bits.
        """
        return self._begin(self.tape.resume(snapshot))

    def _begin(self, observations: Any) -> Any:
        self._law, self.outputs = torch.from_numpy(self.tape.law()), None
        self._left = torch.zeros((self.tape.batch.num_envs, self.tape.n_carried), dtype=torch.float64)
        self._observations = torch.from_numpy(observations)
        return self._observations

    def detach(self) -> Any:
        """Cut the episodes here: no later `backward()` goes back through the steps taken so far. They go on as before.

        A training by segments calls it between two of them, and goes on with the observations that it returns. Those
        of the segment before still lead back through it. The law stays the same tensor: each segment adds to its
        gradient what its own steps add. A policy's own memory is to be detached by its owner.

        Returns:
            the latest observations (num_envs, n_observation), floats of 32 bits, without a history.
        """
        self.tape.require_started()
        self._left, self._observations = self._left.detach(), self._observations.detach()
        self.outputs = None if self.outputs is None else self.outputs.detach()
        return self._observations

    def step(self, actions: Any) -> tuple[Any, Any]:
        """Step every running environment with actions (num_envs, n_action).

        Returns:
            observations (num_envs, n_observation), floats of 32 bits, and terms of the cost (num_envs, n_terms), of 64.
        """
        self.tape.require_started()
        actions = torch.as_tensor(actions)
        self._left, self._observations, terms, self.outputs = _apply(self.tape, self._left, self._law, actions)
        return self._observations, terms


__all__ = ["TorchEpisodes"]
