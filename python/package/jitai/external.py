"""Outside agents as Python programs; ``docs/external.md`` describes the protocol.

``connect()`` returns the :class:`Job` for which jitai started the program. Afterwards, ``print`` writes to
standard error, because standard output belongs to the protocol.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from jitai.sb3 import JobVecEnv

__all__ = ["PROTOCOL", "Job", "ProtocolError", "connect"]

#: The version of the protocol.
PROTOCOL = 1

Observations = npt.NDArray[np.float32]
#: Maps observations, one row per lane, to one action or one row of four probabilities per lane.
Policy = Callable[[Observations], Any]


class ProtocolError(RuntimeError):
    """jitai did not start this program, sent an unexpected message, or speaks another protocol version."""


class Job:
    """A job of a manifest with this program as its agent."""

    def __init__(self, message: dict[str, Any], lanes: int, read: Any, write: Any) -> None:
        self._read, self._write = read, write
        #: The first message, which describes the job.
        self.message = message
        #: Identity of the job.
        self.key: str = message["job_key"]
        #: Seed for the program's own random numbers.
        self.seed: int = message["seed"]
        #: The program's parameters, as in the manifest.
        self.parameters: dict[str, Any] = message["parameters"]
        #: The budget: the maximum number of training episodes.
        self.episodes: int = message["episodes"]
        #: Number of training episodes that have begun or were reported.
        self.begun = 0
        #: The scenario, such as ``P-H-D``.
        self.scenario: str = message["scenario"]
        #: Names of the entries of an observation.
        self.names: list[str] = [entry["name"] for entry in message["observation"]]
        #: Number of actions.
        self.actions: int = message["actions"]
        #: Maximum number of steps of an episode.
        self.horizon: int = message["horizon"]
        #: Number of lanes of training.
        self.lanes = lanes
        #: Whether a message can be sent, for each lane of the last observations.
        self.available: npt.NDArray[np.bool_] = np.ones(lanes, np.bool_)

    @property
    def left(self) -> int:
        """Number of training episodes that remain in the budget."""
        return self.episodes - self.begun

    def reset(self, lanes: Sequence[int] | None = None) -> Observations:
        """Begins training episodes in these lanes, or in all lanes that are not running; a row for each."""
        message: dict[str, Any] = {"type": "reset"}
        if lanes is not None:
            message["lanes"] = [int(lane) for lane in lanes]
        self._send(message)
        answer = self._receive("began")
        self.begun += len(answer["lanes"])
        return self._observations(answer)

    def step(
        self, actions: Any, probabilities: Any = None
    ) -> tuple[Observations, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """Takes a step in all running lanes: observations, rewards, terminated and truncated."""
        message = {"type": "step", "actions": np.atleast_1d(actions).tolist()}
        if probabilities is not None:
            message["probabilities"] = np.atleast_1d(probabilities).tolist()
        self._send(message)
        answer = self._receive("stepped")
        rewards = np.array(answer["rewards"], np.float64)
        terminated = np.array(answer["terminated"], np.bool_)
        return self._observations(answer), rewards, terminated, np.array(answer["truncated"], np.bool_)

    def report(self, returns: Any, lengths: Any, terminated: Any) -> None:
        """Reports training episodes that the program simulated itself, with returns in steps walked."""
        message = {
            "type": "episodes",
            "returns": np.asarray(returns, np.float64).tolist(),
            "lengths": np.asarray(lengths).tolist(),
            "terminated": np.asarray(terminated, np.bool_).tolist(),
        }
        self._send(message)
        self.begun += len(message["returns"])

    def update(self, loss: float | None = None, epsilon: float | None = None) -> None:
        """Reports the loss of an update, or the exploration rate, for the learning curve."""
        values = {"loss": loss, "epsilon": epsilon}
        given = {name: float(value) for name, value in values.items() if value is not None}
        self._send({"type": "update", **given})

    def environment(self) -> dict[str, Any]:
        """Keywords of :func:`jitai.make` and :func:`jitai.make_vec` for the job's training.

        The program must report the episodes that it simulates there with :meth:`report`.
        """
        if self.message["history"] != 1:
            raise ValueError("history: the environments show one observation; train by reset and step")
        keywords = {"scenario": self.scenario, **self.message["environment"]}
        population = self.message["population"]
        if population and population.get("phases", "all") == "all":
            keywords["population"] = population
        return keywords

    def vec_env(self, lanes: int) -> JobVecEnv:
        """The job's training for Stable-Baselines3, which reports its episodes."""
        from jitai.sb3 import JobVecEnv

        return JobVecEnv(self, lanes)

    def test(self, policy: Policy, begin: Callable[[int], None] | None = None) -> None:
        """Ends the training, and chooses the actions of the test until its end.

        ``policy`` receives an array with a row for each running lane; :attr:`running` has the lanes of the
        rows. ``begin`` is called with the number of lanes whenever episodes of the test begin.
        """
        self._send({"type": "trained"})
        while True:
            message = self._receive("test", "act", "end")
            if message["type"] == "end":
                return
            if message["type"] == "test":
                if begin is not None:
                    begin(message["lanes"])
                continue
            #: The lanes of the rows that the policy receives.
            self.running = np.array(message["lanes"], np.int64)
            chosen = np.asarray(policy(self._observations(message)))
            name = "probabilities" if chosen.ndim == 2 else "actions"
            self._send({"type": "choices", name: chosen.tolist()})

    def _observations(self, message: dict[str, Any]) -> Observations:
        observations = np.array(message["observations"], np.float32)
        self.available = np.array(message.get("available", [True] * len(observations)), np.bool_)
        return observations

    def _send(self, message: dict[str, Any]) -> None:
        line = json.dumps(message, separators=(",", ":"), allow_nan=False)
        self._write.write(line + "\n")
        self._write.flush()

    def _receive(self, *expected: str) -> dict[str, Any]:
        return _receive(self._read, expected)


def connect(lanes: int = 1) -> Job:
    """The job for which jitai started this program; it trains in this number of lanes."""
    if sys.stdin.isatty():
        raise ProtocolError("this program is an outside agent: name it as `command` in a manifest")
    # From here on, standard output goes to standard error, even output of native libraries.
    sys.stdout.flush()
    own = os.dup(1)
    os.dup2(2, 1)
    write = os.fdopen(own, "w", encoding="utf-8", newline="\n")
    read = sys.stdin
    message = _receive(read, ("job",))
    if message["protocol"] != PROTOCOL:
        raise ProtocolError(f"expected protocol {PROTOCOL}, found {message['protocol']}")
    job = Job(message, lanes, read, write)
    job._send({"type": "ready", "protocol": PROTOCOL, "lanes": lanes})
    return job


def _receive(read: Any, expected: Sequence[str]) -> dict[str, Any]:
    line = read.readline()
    if not line:
        # End of input: jitai or this job was stopped.
        raise SystemExit(1)
    message: dict[str, Any] = json.loads(line)
    if message["type"] not in expected:
        raise ProtocolError(f"expected {' or '.join(expected)}, found {message['type']}")
    return message
