"""Trained policies."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from jitai._declaration import checked_seed
from jitai._jitai import TrainedPolicy


class Policy:
    """The agent of a completed job, for observations of its scenario.

    ``act`` takes the same actions as the program, to the bit: by default as the policy was trained,
    including exploration, or the best actions if ``greedy``. A bandit draws its coefficients for
    each decision, and learns by ``update`` alone. A network with a GRU remembers the observations that ``act`` saw
    since ``begin``: rows are the next observations of as many episodes. A rule that acts on the true
    state takes it from ``info``. Policies can be pickled.
    """

    def __init__(self, policy: TrainedPolicy) -> None:
        self._policy = policy

    @classmethod
    def from_store(cls, path: str | os.PathLike[str], key: str) -> Policy:
        """The policy of the only completed job whose key begins with ``key``."""
        if not isinstance(key, str):
            raise TypeError(f"key: expected the beginning of a job key, found {key!r}")
        return cls(TrainedPolicy.from_store(os.fspath(path), key))

    @property
    def job_key(self) -> str:
        """The job's key."""
        return self._policy.job_key

    @property
    def description(self) -> dict[str, Any]:
        """``policy.json``: observations and actions, and the architecture or the posterior; of a rule, its job."""
        return self._policy.describe()

    @property
    def weights(self) -> dict[str, npt.NDArray[np.float32] | npt.NDArray[np.float64]]:
        """Arrays by name: ``….weight`` is [inputs, outputs], ``….bias`` is [outputs].

        A bandit has ``mean``, ``precision`` and ``information``, the precision times the mean, with
        the regressions as the first axis.
        """
        return self._policy.weights

    @property
    def numbers(self) -> dict[str, float]:
        """Numbers that the policy needs in addition to the weights, such as ``epsilon``."""
        return self._policy.numbers

    def reset(self, seed: int | None = None) -> None:
        """Restarts the random stream of the actions, with a new seed or with the job's seed.

        New episodes begin.
        """
        self._policy.reset(None if seed is None else checked_seed(seed))

    def begin(self, mask: npt.ArrayLike | None = None) -> None:
        """Begins new episodes: where ``mask`` is true, or in all rows, whose number may change.

        This concerns networks with a GRU, which forget their episodes; the random stream continues.
        """
        self._policy.begin(None if mask is None else np.asarray(mask, np.bool_).ravel().tolist())

    def act(
        self,
        observations: npt.ArrayLike,
        *,
        greedy: bool = False,
        info: Mapping[str, Any] | None = None,
    ) -> npt.NDArray[np.int64] | int:
        """An action for each row of observations, or for a single one."""
        rows, is_single = _rows(observations)
        actions = self._policy.act(rows, greedy, self._states(rows, info))
        return int(actions[0]) if is_single else actions

    def values(self, observations: npt.ArrayLike) -> npt.NDArray[np.float32]:
        """The network's output for each action: values of a DQN, logits of a policy network.

        For a bandit, the mean of each action's reward with its bias; with action centring, the
        means of the effects.
        """
        rows, is_single = _rows(observations)
        values = self._policy.values(rows)
        return values[0] if is_single else values

    def probabilities(
        self, observations: npt.ArrayLike, *, info: Mapping[str, Any] | None = None
    ) -> npt.NDArray[np.float64]:
        """The probabilities of the actions, including exploration; a GRU does not remember these observations."""
        rows, is_single = _rows(observations)
        probabilities = self._policy.probabilities(rows, self._states(rows, info))
        return probabilities[0] if is_single else probabilities

    def update(
        self,
        observations: npt.ArrayLike,
        actions: npt.ArrayLike,
        rewards: npt.ArrayLike,
        probabilities: npt.ArrayLike | None = None,
        *,
        available: npt.ArrayLike | None = None,
        reached: npt.ArrayLike | None = None,
    ) -> Policy:
        """The bandit that has also learned from decisions, as a trial's update does; this one stays as it is.

        ``observations`` has a row for each decision, ``actions`` and ``rewards`` a number, and ``probabilities`` a row with
        the probabilities with which the actions were drawn, which bandits with action centring need. Decisions with
        ``available`` or ``reached`` 0 teach nothing, as in a replay; messages count the others alone, from 0. Its actions
        begin at the start of the random stream.
        """
        rows, _ = _rows(observations)
        taken = np.asarray(actions)
        if taken.dtype.kind not in "iu":
            raise TypeError(f"actions: expected whole numbers, found {taken.dtype}")
        taken, paid = taken.ravel(), np.asarray(rewards, np.float64).ravel()
        chances = None if probabilities is None else np.ascontiguousarray(np.atleast_2d(probabilities), np.float64)
        if available is not None or reached is not None:
            free, known = _flags("available", available, len(rows)), _flags("reached", reached, len(rows))
            for name, given in (("actions", taken), ("rewards", paid), ("probabilities", chances)):
                if given is not None and len(given) != len(rows):
                    raise ValueError(f"{name}: expected one for each of {len(rows)} observations, found {len(given)}")
            if np.any(taken[~free] != 0):
                row = np.flatnonzero(~free & (taken != 0))[0]
                raise ValueError(f"actions: row {row} has {taken[row]} where available is 0")
            teaches = free & known
            rows, taken, paid = rows[teaches], taken[teaches], paid[teaches]
            chances = None if chances is None else chances[teaches]
        return Policy(self._policy.updated(rows, taken.tolist(), paid.tolist(), chances))

    def _states(
        self, rows: npt.NDArray[np.float64], info: Mapping[str, Any] | None
    ) -> npt.NDArray[np.float64] | None:
        """The true states of the rows that a rule acts on."""
        names = self._policy.state_names
        if not names or info is None:
            return None
        missing = [name for name in names if name not in info]
        if missing:
            raise ValueError(f"info: {', '.join(missing)} missing; make the environment with state_in_info=True")
        columns = [np.broadcast_to(np.asarray(info[name], np.float64), len(rows)) for name in names]
        return np.ascontiguousarray(np.stack(columns, axis=1))

    def __repr__(self) -> str:
        names = ", ".join(feature["name"] for feature in self.description["features"])
        return f"<jitai.Policy of job {self.job_key}: {self._policy.algorithm} of {names}>"


def _flags(name: str, given: npt.ArrayLike | None, count: int) -> npt.NDArray[np.bool_]:
    """A flag for each decision, 0 or 1; all are 1 if none are given."""
    flags = np.ones(count) if given is None else np.asarray(given).ravel()
    if len(flags) != count or not np.isin(flags, (0, 1)).all():
        raise ValueError(f"{name}: expected 0 or 1 for each of {count} observations")
    return flags.astype(bool)


def _rows(observations: npt.ArrayLike) -> tuple[npt.NDArray[np.float64], bool]:
    """Observations as rows, and whether the input was a single observation."""
    given = np.asarray(observations)
    if given.dtype.kind not in "fiub":
        raise TypeError(f"observations: expected numbers, found {given.dtype}")
    rows = np.ascontiguousarray(given, np.float64)
    if given.ndim == 1:
        return rows[np.newaxis], True
    if given.ndim != 2:
        raise ValueError(f"observations: expected one or two axes, found {given.ndim}")
    return rows, False
