"""The vector environment for Stable-Baselines3."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv as BaseVecEnv

from jitai._declaration import MOST_SEED
from jitai._environment import Env
from jitai._vector import VectorEnv

if TYPE_CHECKING:
    from jitai.external import Job

__all__ = ["JobVecEnv", "VecEnv"]


class VecEnv(BaseVecEnv):
    """Many lanes of the simulation, as a ``VecEnv`` of Stable-Baselines3.

    The keywords are those of :class:`jitai.Env`. The infos of lanes whose episode ended have
    ``terminal_observation``, ``TimeLimit.truncated`` and, as a ``Monitor`` writes it, ``episode`` with
    the sum of rewards, the length and the time. With ``state_in_info``, the infos of all lanes also have
    the true state, like the infos of single environments; this takes a dict per lane and step.
    ``env_method("action_masks")`` gives the masks that ``MaskablePPO`` asks for.
    """

    def __init__(self, num_envs: int = 1, *, state_in_info: bool = False, **keywords: Any) -> None:
        keywords.update(autoreset_mode=AutoresetMode.SAME_STEP, state_in_info=state_in_info)
        self.env = VectorEnv(num_envs, **keywords)
        self._shows_state = bool(state_in_info)
        super().__init__(num_envs, self.env.single_observation_space, self.env.single_action_space)
        self.metadata = self.env.metadata
        self._actions = np.zeros(num_envs, np.int64)
        self._masks = np.ones((num_envs, int(self.env.single_action_space.n)), np.int8)
        self._returns = np.zeros(num_envs)
        self._lengths = np.zeros(num_envs, np.int64)
        self._began = time.time()

    def reset(self) -> np.ndarray:
        """Begins episodes in all lanes, with the seeds that ``seed`` set."""
        seeds = None if all(seed is None for seed in self._seeds) else self._seeds
        observations, infos = self.env.reset(seed=seeds)
        self._reset_seeds()
        self._reset_options()
        self._masks = infos.get("action_mask", self._masks)
        self._returns[:] = 0.0
        self._lengths[:] = 0
        self.reset_infos: list[dict[str, Any]] = self._infos(infos)
        return observations

    def _infos(self, states: dict[str, Any]) -> list[dict[str, Any]]:
        """An info for each lane, with the state if it is shown."""
        return _lane_by_lane(states if self._shows_state else {}, self.num_envs)

    def step_async(self, actions: np.ndarray) -> None:
        """Takes the actions of the next step."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Takes the step."""
        observations, rewards, terminated, truncated, states = self.env.step(self._actions)
        self._states = states
        self._masks = states.get("action_mask", self._masks)
        self._returns += rewards
        self._lengths += 1
        infos = self._infos(states)
        done = terminated | truncated
        if done.any():
            elapsed = round(time.time() - self._began, 6)
            last = self._infos(states["final_info"])
            for lane in np.flatnonzero(done):
                self.reset_infos[lane] = infos[lane]
                infos[lane] = last[lane] | {
                    "terminal_observation": states["final_obs"][lane],
                    "TimeLimit.truncated": bool(truncated[lane]),
                    "episode": {
                        "r": float(self._returns[lane]),
                        "l": int(self._lengths[lane]),
                        "t": elapsed,
                    },
                }
            self._returns[done] = 0.0
            self._lengths[done] = 0
        return observations, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Closes the environment."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector environment, for each requested lane.

        ``MaskablePPO`` looks for the method ``action_masks`` to detect masks.
        """
        if attr_name == "action_masks":
            lanes = self._get_indices(indices)
            return [lambda lane=lane: self._masks[lane].astype(bool) for lane in lanes]
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raises an error: lanes do not have their own attributes."""
        raise AttributeError(
            f"lanes have no attribute {attr_name!r} of their own; make another VecEnv"
        )

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """``action_masks``, the only method of lanes."""
        if method_name != "action_masks":
            raise AttributeError(f"lanes have only the method action_masks, not {method_name!r}")
        return [self._masks[lane].astype(bool) for lane in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Whether lanes have a wrapper: true for ``Monitor``, because lanes report episodes as it does."""
        is_monitor = issubclass(wrapper_class, Monitor)
        return [is_monitor for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """No images: the environment only renders text."""
        return [None] * self.num_envs


def _lane_by_lane(states: dict[str, Any], lanes: int) -> list[dict[str, Any]]:
    """The states of a vector environment as the infos of single environments."""
    columns: dict[str, Any] = {}
    for name, values in states.items():
        # `_name` marks the lanes that have a value; all of them do.
        if name.startswith("_") or name in ("final_obs", "final_info"):
            continue
        if isinstance(values, dict):
            columns[name] = _lane_by_lane(values, lanes)
        else:
            columns[name] = list(values) if values.ndim > 1 else values.tolist()
    return [{name: column[lane] for name, column in columns.items()} for lane in range(lanes)]


class _Budget(BaseCallback):
    """Ends the training when the episodes of a job are used up."""

    def __init__(self, job: Job) -> None:
        super().__init__()
        self._job = job

    def _on_step(self) -> bool:
        return self._job.left > 0


class JobVecEnv(VecEnv):
    """The training of an outside agent's job; reports its episodes, up to the budget.

    The seeds of the lanes are derived from the job's seed. Pass :attr:`callback` to ``learn`` to end the
    training when the budget is used up.
    """

    def __init__(self, job: Job, num_envs: int) -> None:
        keywords = job.environment()
        has_costs = Env(**keywords).declaration.has_costs
        # Rewards are outcomes minus costs; reported returns are outcomes.
        super().__init__(num_envs, state_in_info=has_costs, **keywords)
        self._shows_state = False
        self._job, self._has_costs = job, has_costs
        self._outcomes = np.zeros(num_envs)
        self.callback: BaseCallback = _Budget(job)
        self.seed()

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """The seeds of the lanes, derived from the job's seed; ``seed`` is ignored."""
        # Never the seed itself, whose stream is that of the test.
        first = (self._job.seed << 16) & MOST_SEED or 1 << 63
        self._seeds = [(first + lane) & MOST_SEED for lane in range(self.num_envs)]
        return self._seeds

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Takes the step, and reports the episodes that ended."""
        observations, rewards, done, infos = super().step_wait()
        if self._has_costs:
            name = self.env.declaration.outcome
            outcomes = self._states[name].copy()
            if done.any():
                outcomes[done] = self._states["final_info"][name][done]
            self._outcomes += outcomes
        ended = np.flatnonzero(done)
        reported = ended[: self._job.left]
        if len(reported):
            of_rewards = [infos[lane]["episode"]["r"] for lane in reported]
            self._job.report(
                self._outcomes[reported] if self._has_costs else of_rewards,
                [infos[lane]["episode"]["l"] for lane in reported],
                [not infos[lane]["TimeLimit.truncated"] for lane in reported],
            )
        self._outcomes[ended] = 0.0
        return observations, rewards, done, infos
