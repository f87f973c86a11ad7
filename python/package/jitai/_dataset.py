"""Recorded decisions as arrays for offline reinforcement learning."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from jitai._jitai import StoreReader
from jitai._store import Column

_DECISIONS = """
    SELECT episode, state, action, reward, terminated FROM decision
    WHERE job_key = ? AND phase = ? ORDER BY episode, step
"""

_COST = """
    SELECT CAST(value AS REAL) FROM parameter WHERE job_key = ? AND name = 'environment.message_cost'
"""

_RETURNS = """
    SELECT value FROM metric WHERE job_key = ? AND name IN ('mean_return', 'mean_net_return')
"""

_COSTS_OF_PEOPLE = """
    SELECT episode, CAST(value AS REAL) FROM participant WHERE job_key = ? AND phase = ? AND name = 'message_cost'
"""


def of_decisions(
    reader: StoreReader, key: str, phase: str, observations: Sequence[str] | None
) -> dict[str, npt.NDArray[Any]]:
    """The decisions of a phase of the job whose key begins with ``key``."""
    if phase not in ("test", "train"):
        raise ValueError(f"phase: expected test or train, found {phase!r}")
    job = _job(reader, key)
    episode, state, action, reward, terminated = (
        Column(*column) for column in reader.columns(_DECISIONS, [(None, job), (None, phase)])
    )
    if len(action.values) == 0:
        word = {"test": '"test" or "all"', "train": '"all"'}[phase]
        raise ValueError(
            f"job {job} has no decisions of its {phase}; they are recorded with record_decisions = {word}"
        )
    if terminated.nulls is not None:
        raise ValueError(
            f"job {job}: an earlier version recorded the decisions of the training, without the endings of episodes"
        )
    costs = _costs(reader, job, phase, episode.values, state.values)
    # A training may end within an episode.
    ends = np.append(np.diff(episode.values) != 0, True)
    return {
        "observations": _observations(state.values, observations),
        "actions": action.values,
        "rewards": (reward.values - costs * (action.values > 0)).astype(np.float32),
        "terminals": terminated.values.astype(np.float32),
        "timeouts": (ends & (terminated.values == 0)).astype(np.float32),
    }


def _costs(
    reader: StoreReader, job: str, phase: str, episodes: npt.NDArray[Any], states: list[str]
) -> npt.NDArray[np.float64]:
    """The cost of a message at each decision, which the recorded reward does not count."""
    [cost] = (Column(*column).values for column in reader.columns(_COST, [(None, job)]))
    if len(cost) == 0:
        [returns] = (Column(*column).values for column in reader.columns(_RETURNS, [(None, job)]))
        if len(set(returns)) < 2:
            return np.zeros(len(episodes))
        # The cost of each decision stands in its state, if anywhere.
        rows = json.loads(f"[{','.join(states)}]")
        if any("cost" not in row or row.get("reported") == 0 for row in rows):
            raise ValueError(
                "rewards less costs are not known: the recorded state has no `cost`, or was not reported; "
                "a model names the variable in its `state`"
            )
        return np.array([row["cost"] for row in rows])
    costs = np.full(len(episodes), cost[0])
    columns = reader.columns(_COSTS_OF_PEOPLE, [(None, job), (None, phase)])
    of_people = [Column(*column).values for column in columns]
    if len(of_people[0]):
        by_episode = dict(zip(*of_people, strict=True))
        costs = np.array([by_episode[episode] for episode in episodes])
    return costs


def _job(reader: StoreReader, key: str) -> str:
    """The key of the only completed job whose key begins with ``key``."""
    if not isinstance(key, str):
        raise TypeError(f"key: expected the beginning of a job key, found {key!r}")
    sql = """
        SELECT DISTINCT job_key FROM run_summary
        WHERE status = 'completed' AND substr(job_key, 1, length(:key)) = lower(:key) ORDER BY job_key LIMIT 2
    """
    [found] = (Column(*column).values for column in reader.columns(sql, [("key", key)]))
    if len(found) != 1:
        which = "no completed job" if len(found) == 0 else "several completed jobs"
        raise KeyError(f"{which} with a key that begins with {key!r}")
    return str(found[0])


def _observations(states: list[str], names: Sequence[str] | None) -> npt.NDArray[np.float32]:
    """Entries of states, which are JSON objects with the same names."""
    rows = json.loads(f"[{','.join(states)}]")
    known = list(rows[0])
    if not known:
        raise ValueError("observations: the environment declares no `state`, so that its decisions record none")
    # What a decision cost is known after it.
    known_before = [name for name in known if name != "cost"]
    chosen = known_before if names is None else [names] if isinstance(names, str) else list(names)
    unknown = [name for name in chosen if name not in known]
    if unknown:
        raise ValueError(f"observations: the recorded state has {', '.join(known)}; found {unknown[0]}")
    return np.array([[row[name] for name in chosen] for row in rows], np.float32)
