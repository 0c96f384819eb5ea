"""The environment as pure functions, for JAX. Experimental; it needs the `jax` extra.

branches        branches of a kernel as choices between numbers
programs        the kernels of a control step, traced from their own source
bank            scenarios as arrays
functional_env  the environment: the only module that imports JAX
"""

from typing import TYPE_CHECKING, Any

from wtg_gym.extras import install_advice

if TYPE_CHECKING:
    from wtg_gym.functional.functional_env import EnvParams, EnvState, FunctionalEnv


def __getattr__(name: str) -> Any:
    # JAX takes seconds to import.
    if name in __all__:
        try:
            from wtg_gym.functional import functional_env
        except ImportError as error:
            raise ImportError(f"wtg_gym.functional needs JAX; {install_advice('jax')}") from error
        return getattr(functional_env, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = ["EnvParams", "EnvState", "FunctionalEnv"]
