"""The registration of the environments, and the functions that make environments."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium

from jitai._keywords import Keywords, VectorKeywords, signature

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from jitai._environment import Env
    from jitai._vector import VectorEnv

#: The ids in Gymnasium by family. A list here, because the import of jitai does not load the compiled module.
IDS = {
    "step_count": "jitai/StepCount-v0",
    "declared": "jitai/Declared-v0",
}
#: The id of the family of manifests that name none.
ENVIRONMENT_ID = IDS["step_count"]
#: The ids of models that come with jitai. Each is the model where no manifest or preset names another.
MODELS = {"jitai/Oralytics-v0": {"family": "declared", "usual_model": "oralytics_v2"}}
#: The noise of the context feature where an environment is made by its id alone, as Stable-Baselines3 makes
#: the environment of ``PPO("MlpPolicy", id)``: the value with which StepCountJITAI's code makes its own.
SIGMA = 0.4


def register() -> None:
    """Registers the environments with Gymnasium, once."""
    families = {name: {} if name == ENVIRONMENT_ID else {"family": family} for family, name in IDS.items()}
    for name, keywords in (families | MODELS).items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="jitai._registration:single",
                vector_entry_point="jitai._registration:vector",
                # The environment itself rejects calls in the wrong order, and its tests replace the checker.
                order_enforce=False,
                disable_env_checker=True,
                kwargs=keywords,
            )


def single(**keywords: Any) -> Env:
    """The entry point of ``gymnasium.make``."""
    from jitai._environment import Env

    return Env(**_declared(keywords))


def vector(max_episode_steps: int | None = None, **keywords: Any) -> VectorEnv:
    """The entry point of ``gymnasium.make_vec``, which passes the ``max_episode_steps`` of a spec."""
    from jitai._vector import VectorEnv

    envs = VectorEnv(**_declared(keywords))
    longest = envs.declaration.longest_episode
    if max_episode_steps not in (None, longest):
        key = "horizon" if "horizon" in envs.declaration.keys else "a key of the environment"
        raise ValueError(
            f"max_episode_steps: the episodes of lanes have {longest} steps; set {key} instead"
        )
    return envs


def _declared(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords; with the model of the id, or with a sigma, if none of them declares an environment."""
    keywords = dict(keywords)
    usual = keywords.pop("usual_model", None)
    if usual is not None and not any(keywords.get(name) for name in ("model", "manifest", "extends")):
        keywords["model"] = usual
    without_effect = ("family", "render_mode", "num_envs", "autoreset_mode", "state_in_info")
    is_bare = all(name in without_effect for name in keywords)
    is_bare &= _id(keywords) == ENVIRONMENT_ID
    return {"sigma": SIGMA, **keywords} if is_bare else keywords


def _id(keywords: Mapping[str, Any]) -> str:
    """The id of the family that the keywords name."""
    return IDS.get(str(keywords.get("family")), ENVIRONMENT_ID)


def make(**keywords: Unpack[Keywords]) -> Env:
    """A single environment, as ``gymnasium.make`` makes it from the id of its ``family``."""
    return gymnasium.make(_id(keywords), **keywords)  # type: ignore[return-value]


def make_vec(num_envs: int = 1, **keywords: Unpack[VectorKeywords]) -> VectorEnv:
    """A vector environment, as ``gymnasium.make_vec`` makes it from the id of its ``family``."""
    return gymnasium.make_vec(  # type: ignore[return-value]
        _id(keywords), num_envs=num_envs, vectorization_mode="vector_entry_point", **keywords
    )


_LANES = inspect.Parameter("num_envs", inspect.Parameter.POSITIONAL_OR_KEYWORD, default=1)
make.__signature__ = signature(Keywords)  # type: ignore[attr-defined]
make_vec.__signature__ = signature(VectorKeywords, _LANES)  # type: ignore[attr-defined]
