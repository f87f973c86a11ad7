"""Declarations from keywords or manifests, checked by the code for manifests."""

from __future__ import annotations

import copy
import operator
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import logger, spaces
from gymnasium.envs.registration import EnvSpec

from jitai._jitai import Declaration

#: Seeds are 64-bit numbers, like the seeds of a manifest.
MOST_SEED = 2**64 - 1


def declare(
    scenario: str | Sequence[str] | None,
    extends: str | None,
    manifest: str | os.PathLike[str] | None,
    environment: str | Mapping[str, Any] | None,
    keys: dict[str, Any],
) -> Declaration:
    """The declaration with these keywords, which are the keywords of the environments."""
    if manifest is None:
        if environment is not None:
            raise TypeError("environment=… chooses from a manifest; add manifest=…")
        if scenario is not None and not isinstance(scenario, Sequence):
            raise TypeError(f"`scenario`: expected a word or a list of words, found {scenario!r}")
        if extends is not None and not isinstance(extends, str):
            raise TypeError(f"`extends`: expected a word, found {extends!r}")
        return Declaration.of_keys(scenario, extends, keys)
    # The id in Gymnasium has a family too.
    family = keys.pop("family", None)
    given = [name for name, value in (("scenario", scenario), ("extends", extends)) if value]
    given += keys
    if given:
        raise TypeError(f"the manifest declares {', '.join(given)}; choose by environment=…")
    if isinstance(environment, Mapping):
        environment = ",".join(f"{name}={_written(value)}" for name, value in environment.items())
    declaration = Declaration.of_manifest(os.fspath(manifest), environment)
    if family not in (None, declaration.family):
        raise ValueError(f"family: the manifest declares {declaration.family}, found {family!r}")
    return declaration


def _written(value: Any) -> str:
    """A value in the notation of filters."""
    return str(value).lower() if isinstance(value, (bool, np.bool_)) else str(value)


def observation_space(declaration: Declaration) -> spaces.Box:
    """The space of one observation."""
    _, low, high = zip(*declaration.entries, strict=True)
    return spaces.Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)


def known_render_mode(render_mode: Any, known: Sequence[str]) -> str | None:
    """The render mode; ``None``, with a warning, if it is not among the known ones.

    Stable-Baselines3 asks every environment for ``rgb_array``.
    """
    if render_mode is None or render_mode in known:
        return render_mode
    modes = " and ".join(known) or "no render modes"
    logger.warn("render_mode=%r: the environment has %s, and renders nothing", render_mode, modes)
    return None


def with_longest_episode(spec: EnvSpec | None, declaration: Declaration) -> EnvSpec | None:
    """The spec of an environment, with the maximum number of steps of its episodes."""
    if spec is not None:
        spec = copy.copy(spec)
        spec.max_episode_steps = declaration.longest_episode
    return spec


def checked_seed(seed: Any) -> int:
    """The seed, after a check of its type and range."""
    try:
        number = operator.index(seed)
    except TypeError:
        raise TypeError(f"seed: expected a whole number, found {seed!r}") from None
    if not 0 <= number <= MOST_SEED:
        raise ValueError(f"seed: expected a whole number from 0 to {MOST_SEED}, found {number}")
    return number


def chosen_seed() -> int:
    """A random seed from the operating system."""
    return int.from_bytes(os.urandom(4), "little")
