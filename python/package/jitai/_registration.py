"""The registration of the environment, and the functions that make environments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from jitai._environment import StepCountEnv
    from jitai._vector import StepCountVectorEnv

#: The id of the environment in Gymnasium.
ENVIRONMENT_ID = "jitai/StepCount-v0"


def register() -> None:
    """Registers the environment with Gymnasium, once."""
    if ENVIRONMENT_ID in gymnasium.registry:
        return
    gymnasium.register(
        id=ENVIRONMENT_ID,
        entry_point="jitai._environment:StepCountEnv",
        vector_entry_point="jitai._vector:StepCountVectorEnv",
        # The environment itself rejects calls in the wrong order, and its tests replace the checker.
        order_enforce=False,
        disable_env_checker=True,
    )


def make(**keywords: Any) -> StepCountEnv:
    """A single environment, as ``gymnasium.make(jitai.ENVIRONMENT_ID, …)`` makes it."""
    return gymnasium.make(ENVIRONMENT_ID, **keywords)  # type: ignore[return-value]


def make_vec(num_envs: int = 1, **keywords: Any) -> StepCountVectorEnv:
    """A vector environment, as ``gymnasium.make_vec(jitai.ENVIRONMENT_ID, …)`` makes it."""
    return gymnasium.make_vec(  # type: ignore[return-value]
        ENVIRONMENT_ID, num_envs=num_envs, vectorization_mode="vector_entry_point", **keywords
    )
