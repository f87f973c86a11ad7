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

_DECLARED = """
    SELECT name, value FROM parameter WHERE job_key = ? AND name IN ('environment.family', 'environment.message_cost',
        'environment.cost_scale', 'environment.cost_of_good_brushing', 'environment.cost_of_frequent_prompts')
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
    costs = _costs(reader, job, phase, episode.values, state.values, action.values > 0)
    # A training may end within an episode.
    ends = np.append(np.diff(episode.values) != 0, True)
    return {
        "observations": _observations(state.values, observations),
        "actions": action.values,
        "rewards": (reward.values - costs).astype(np.float32),
        "terminals": terminated.values.astype(np.float32),
        "timeouts": (ends & (terminated.values == 0)).astype(np.float32),
    }


def _costs(
    reader: StoreReader,
    job: str,
    phase: str,
    episodes: npt.NDArray[Any],
    states: list[str],
    is_message: npt.NDArray[Any],
) -> npt.NDArray[np.float64]:
    """The cost of each decision, which the recorded reward does not count."""
    names, values = (Column(*column).values for column in reader.columns(_DECLARED, [(None, job)]))
    declared = {name.removeprefix("environment."): value for name, value in zip(names, values, strict=True)}
    if declared.get("family") == "oralytics":
        return _of_retired_oralytics(declared, states, is_message)
    if declared.get("family") == "declared":
        rows = json.loads(f"[{','.join(states)}]")
        if "cost" in rows[0]:
            return np.array([row["cost"] for row in rows], float)
        [returns] = (Column(*column).values for column in reader.columns(_RETURNS, [(None, job)]))
        if len(set(returns)) > 1:
            raise ValueError("rewards less costs are not known: name a variable `cost` in the `state` of the model")
        return np.zeros(len(episodes))
    costs = np.full(len(episodes), float(declared.get("message_cost", 0.0)))
    columns = reader.columns(_COSTS_OF_PEOPLE, [(None, job), (None, phase)])
    of_people = [Column(*column).values for column in columns]
    if len(of_people[0]):
        by_episode = dict(zip(*of_people, strict=True))
        costs = np.array([by_episode[episode] for episode in episodes])
    return np.asarray(costs * is_message)


def _of_retired_oralytics(declared: dict[str, Any], states: list[str], is_message: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """The costs of prompts in jobs of the family that models have replaced."""
    good, frequent = (float(declared[f"cost_of_{name}"]) for name in ("good_brushing", "frequent_prompts"))
    rows = json.loads(f"[{','.join(states)}]")
    if good and any(row.get("reported") == 0 for row in rows):
        raise ValueError("rewards less costs are not known: the costs follow from states that were not reported")
    brushing = np.array([row["average_brushing"] for row in rows])
    prompts = np.array([row["average_prompts"] for row in rows])
    if declared["cost_scale"] == "normalised":
        brushing, prompts = (brushing - 90.5) / 89.5, 2 * (prompts - 0.5)
    return np.asarray(is_message * (good * ((brushing > 111) & (prompts > 0.5)) + frequent * (prompts > 0.8)))


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
    before = [name for name in known if name != "cost"] or known
    chosen = before if names is None else [names] if isinstance(names, str) else list(names)
    unknown = [name for name in chosen if name not in known]
    if unknown:
        raise ValueError(f"observations: the recorded state has {', '.join(known)}; found {unknown[0]}")
    return np.array([[row[name] for name in chosen] for row in rows], np.float32)
