"""The registration of the environment, and the functions that make environments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium

if TYPE_CHECKING:
    from jitai._environment import StepCountEnv
    from jitai._vector import StepCountVectorEnv

#: The id of the environment in Gymnasium.
ENVIRONMENT_ID = "jitai/StepCount-v0"
#: The noise of the context feature where an environment is made by its id alone, as Stable-Baselines3 makes
#: the environment of ``PPO("MlpPolicy", id)``: the value with which StepCountJITAI's code makes its own.
SIGMA = 0.4


def register() -> None:
    """Registers the environment with Gymnasium, once."""
    if ENVIRONMENT_ID in gymnasium.registry:
        return
    gymnasium.register(
        id=ENVIRONMENT_ID,
        entry_point="jitai._registration:single",
        vector_entry_point="jitai._registration:vector",
        # The environment itself rejects calls in the wrong order, and its tests replace the checker.
        order_enforce=False,
        disable_env_checker=True,
    )


def single(**keywords: Any) -> StepCountEnv:
    """The entry point of ``gymnasium.make``."""
    from jitai._environment import StepCountEnv

    return StepCountEnv(**_declared(keywords))


def vector(max_episode_steps: int | None = None, **keywords: Any) -> StepCountVectorEnv:
    """The entry point of ``gymnasium.make_vec``, which passes the ``max_episode_steps`` of a spec."""
    from jitai._vector import StepCountVectorEnv

    envs = StepCountVectorEnv(**_declared(keywords))
    longest = envs.declaration.longest_episode
    if max_episode_steps not in (None, longest):
        raise ValueError(
            f"max_episode_steps: the episodes of lanes have {longest} steps; set horizon instead"
        )
    return envs


def _declared(keywords: dict[str, Any]) -> dict[str, Any]:
    """The keywords; with a sigma if none of them declares an environment."""
    without_effect = ("family", "render_mode", "num_envs", "autoreset_mode", "state_in_info")
    is_bare = all(name in without_effect for name in keywords)
    return {"sigma": SIGMA, **keywords} if is_bare else keywords


def make(**keywords: Any) -> StepCountEnv:
    """A single environment, as ``gymnasium.make(jitai.ENVIRONMENT_ID, …)`` makes it."""
    return gymnasium.make(ENVIRONMENT_ID, **keywords)  # type: ignore[return-value]


def make_vec(num_envs: int = 1, **keywords: Any) -> StepCountVectorEnv:
    """A vector environment, as ``gymnasium.make_vec(jitai.ENVIRONMENT_ID, …)`` makes it."""
    return gymnasium.make_vec(  # type: ignore[return-value]
        ENVIRONMENT_ID, num_envs=num_envs, vectorization_mode="vector_entry_point", **keywords
    )
