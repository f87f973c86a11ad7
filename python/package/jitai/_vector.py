"""The vector environment."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from jitai._declaration import (
    MOST_SEED,
    checked_seed,
    chosen_seed,
    declare,
    known_render_mode,
    observation_space,
    with_longest_episode,
)
from jitai._jitai import Declaration, Lanes

Observations = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]


class VectorEnv(gymnasium.vector.VectorEnv[Observations, Any, npt.NDArray[Any]]):
    """Many environments in one: lane i takes the same steps as an :class:`Env` with its seed.

    The keywords are those of :class:`Env`. ``reset(seed=s)`` gives lane i the seed s + i. Every
    call returns new arrays, which later calls do not change.
    """

    metadata: dict[str, Any] = {
        "render_modes": [],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    single_action_space: spaces.Discrete
    single_observation_space: spaces.Box
    _spec: EnvSpec | None = None
    # Gymnasium also closes environments whose construction failed.
    _lanes: Lanes = None  # type: ignore[assignment]

    def __init__(
        self,
        num_envs: int = 1,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        scenario: str | Sequence[str] | None = None,
        extends: str | None = None,
        manifest: str | os.PathLike[str] | None = None,
        environment: str | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        state_in_info: bool = True,
        **keys: Any,
    ) -> None:
        known_render_mode(render_mode, self.metadata["render_modes"])
        try:
            mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = ", ".join(mode.value for mode in AutoresetMode)
            raise ValueError(
                f"autoreset_mode: expected one of {modes}, found {autoreset_mode!r}"
            ) from None
        #: The declaration of the environment: scenario, keys and entries of an observation.
        self.declaration: Declaration = declare(scenario, extends, manifest, environment, keys)
        self.num_envs = num_envs
        self._lanes = Lanes(self.declaration, num_envs, mode.value, bool(state_in_info))
        self.metadata = {**type(self).metadata, "autoreset_mode": mode}
        self.single_observation_space = observation_space(self.declaration)
        self.single_action_space = spaces.Discrete(len(self.declaration.actions))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    @property
    def spec(self) -> EnvSpec | None:  # type: ignore[override]
        """The specification by which Gymnasium made the environment, with its longest episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = with_longest_episode(spec, self.declaration)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begins episodes in all lanes, or in the lanes of ``options["reset_mask"]``."""
        mask = self._mask(options or {})
        seeds: list[int | None] | None = None
        if isinstance(seed, Sequence) and not isinstance(seed, str):
            if len(seed) != self.num_envs:
                raise ValueError(f"seed: expected {self.num_envs} seeds, found {len(seed)}")
            seeds = [None if one is None else checked_seed(one) for one in seed]
        elif seed is not None:
            first = checked_seed(seed)
            seeds = [(first + lane) & MOST_SEED for lane in range(self.num_envs)]
            super().reset(seed=first)
        if self._lanes.needs_seed:
            first = chosen_seed()
            if seeds is None:
                super().reset(seed=first)
            given = seeds or [None] * self.num_envs
            seeds = [first + lane if one is None else one for lane, one in enumerate(given)]
        return self._lanes.reset(seeds, mask)

    def _mask(self, options: dict[str, Any]) -> Flags | None:
        unknown = [name for name in options if name != "reset_mask"]
        if unknown:
            raise ValueError(f"options: expected only reset_mask, found {', '.join(unknown)}")
        if "reset_mask" not in options:
            return None
        mask = options["reset_mask"]
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError("options['reset_mask']: expected an array of booleans")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"options['reset_mask']: expected {self.num_envs} entries, at least one true"
            )
        return mask

    def step(
        self, actions: Any
    ) -> tuple[Observations, npt.NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Takes a step in every lane: observations, rewards, terminated, truncated and true states."""
        return self._lanes.step(actions)

    def render(self) -> None:
        """Returns ``None``: a vector environment has no render mode."""
        return None

    def close_extras(self, **keywords: Any) -> None:
        """Closes the environment; later steps and resets raise an error."""
        if self._lanes is not None:
            self._lanes.close()


#: The name of the class when ``step_count`` was the only family.
StepCountVectorEnv = VectorEnv
