"""Other projects' environments of power systems, drives and fast batches, where they are installed."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import gymnasium as gym

from wtg_gym.analysis.benchmarks.timing import Case, Stepper, step_batch, step_single


class _Peer(NamedTuple):
    """Another project's environment."""

    module: str
    package: str
    name: str
    n_envs: int
    make: Callable[[], Stepper]


def peer_cases() -> Iterator[Case]:
    """Yield the peers that are installed."""
    for peer in _PEERS:
        if _is_installed(peer):
            yield Case("peers", peer.name, peer.n_envs, peer.make, preparation_s=5.0)


def missing_packages() -> list[str]:
    """Return the names, for pip, of the packages whose environments were left out."""
    return list(dict.fromkeys(peer.package for peer in _PEERS if not _is_installed(peer)))


def peer_packages() -> list[str]:
    """Return the names, for pip, of the packages that the peers come in."""
    return list(dict.fromkeys(peer.package for peer in _PEERS))


def _is_installed(peer: _Peer) -> bool:
    try:
        importlib.import_module(peer.module)
    except Exception:
        # A broken package of another project must not stop the benchmark.
        return False
    return True


def _electric_motor() -> Stepper:
    import gym_electric_motor

    with warnings.catch_warnings():
        # It reports observations out of its own space.
        warnings.simplefilter("ignore")
        return step_single(gym_electric_motor.make("Cont-CC-PMSM-v0"))


class _DoNothing:
    """Grid2Op with Gymnasium's methods and without actions: random topologies would end episodes at once."""

    def __init__(self, env: Any) -> None:
        self._env = env
        self.action_space = self
        self._action = env.action_space({})

    def sample(self) -> Any:
        return self._action

    def reset(self, **arguments: Any) -> Any:
        return self._env.reset(**arguments)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, reward, done, info = self._env.step(action)
        return observation, reward, done, False, info


def _grid2op(**settings: Any) -> Stepper:
    import grid2op

    with warnings.catch_warnings():
        # `test=True` takes the copy of the data that comes with the package, and says so.
        warnings.simplefilter("ignore")
        env = grid2op.make("l2rpn_case14_sandbox", test=True, **settings)
        return step_single(_DoNothing(env))


def _grid2op_light() -> Stepper:
    from lightsim2grid import LightSimBackend

    return _grid2op(backend=LightSimBackend())


def _envpool(name: str, n_envs: int) -> Stepper:
    import envpool

    envs = envpool.make(name, env_type="gymnasium", num_envs=n_envs)
    envs.reset()
    return step_batch(envs, envs.action_space, n_envs)


_PEERS = (
    _Peer("gym_electric_motor", "gym-electric-motor", "Gym Electric Motor Cont-CC-PMSM-v0", 1, _electric_motor),
    _Peer("gym_anm", "gym-anm", "Gym-ANM ANM6Easy-v0", 1, lambda: step_single(gym.make("gym_anm:ANM6Easy-v0"))),
    _Peer("grid2op", "grid2op", "Grid2Op l2rpn_case14_sandbox, default backend", 1, _grid2op),
    _Peer("lightsim2grid", "lightsim2grid", "Grid2Op l2rpn_case14_sandbox, lightsim2grid", 1, _grid2op_light),
    _Peer("envpool", "envpool", "EnvPool CartPole-v1, batch of 1024", 1024, lambda: _envpool("CartPole-v1", 1024)),
    _Peer("envpool", "envpool", "EnvPool Pendulum-v1, batch of 1024", 1024, lambda: _envpool("Pendulum-v1", 1024)),
)
