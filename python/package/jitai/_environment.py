"""The single environment."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from jitai._declaration import (
    checked_seed,
    chosen_seed,
    declare,
    known_render_mode,
    observation_space,
    with_longest_episode,
)
from jitai._jitai import Declaration, Lane


class Env(gymnasium.Env[npt.NDArray[np.float32], np.int64]):
    """One person of a family of environments, who can receive a message at each step.

    Every key of a manifest's ``[environment]`` is a keyword, ``family`` among them; ``scenario`` selects the
    observations, and ``extends`` names a preset. Alternatively, ``manifest`` names a file, and
    ``environment`` selects one of its environments, as ``--filter`` does. The reward is the outcome of a
    step, such as the steps walked, minus the cost of a message.
    """

    metadata: dict[str, Any] = {"render_modes": ["ansi", "human"], "render_fps": 10}
    action_space: spaces.Discrete
    observation_space: spaces.Box  # type: ignore[assignment]
    _spec: EnvSpec | None = None

    def __init__(
        self,
        *,
        scenario: str | Sequence[str] | None = None,
        extends: str | None = None,
        manifest: str | os.PathLike[str] | None = None,
        environment: str | Mapping[str, Any] | None = None,
        render_mode: str | None = None,
        state_in_info: bool = True,
        **keys: Any,
    ) -> None:
        #: The declaration of the environment: scenario, keys and entries of an observation.
        self.declaration: Declaration = declare(scenario, extends, manifest, environment, keys)
        self.observation_space = observation_space(self.declaration)
        self.action_space = spaces.Discrete(len(self.declaration.actions))
        self.render_mode = known_render_mode(render_mode, self.metadata["render_modes"])
        self._lane = Lane(self.declaration, bool(state_in_info))

    @property
    def spec(self) -> EnvSpec | None:  # type: ignore[override]
        """The specification by which Gymnasium made the environment, with its longest episode."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = with_longest_episode(spec, self.declaration)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Begins an episode, at the start of a seed's random stream or at its current position."""
        if options:
            raise ValueError(f"options: this environment has none, found {', '.join(options)}")
        if seed is not None:
            seed = checked_seed(seed)
        elif self._lane.needs_seed:
            seed = chosen_seed()
        if seed is not None:
            super().reset(seed=seed)
        result = self._lane.reset(seed)
        if self.render_mode == "human":
            print(self._lane.line())
        return result

    def step(
        self, action: Any
    ) -> tuple[npt.NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Takes a step: observation, reward, terminated, truncated and the true state."""
        result = self._lane.step(action)
        if self.render_mode == "human":
            print(self._lane.line())
        return result

    def action_masks(self) -> npt.NDArray[np.bool_]:
        """Whether each action can be taken now; ``MaskablePPO`` asks for it."""
        return np.array(self._lane.action_masks(), np.bool_)

    def render(self) -> str | None:
        """The current step as a line of text, in the mode ``ansi``."""
        return self._lane.line() if self.render_mode == "ansi" else None

    def close(self) -> None:
        """Closes the environment; later steps and resets raise an error."""
        self._lane.close()


#: The name of the class when ``step_count`` was the only family.
StepCountEnv = Env
