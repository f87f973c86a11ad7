"""Outside agents as Python programs; ``docs/external.md`` describes the protocol.

``connect()`` returns the :class:`Job` for which jitai started the program. Afterwards, ``print`` writes to
standard error, because standard output belongs to the protocol, and standard input is empty. Texts are
UTF-8, whatever the locale.
"""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

__all__ = ["PROTOCOL", "Job", "ProtocolError", "connect"]

#: The version of the protocol.
PROTOCOL = 1
#: Maximum number of episodes in a message; their line stays below the limit of the protocol.
_REPORTED_TOGETHER = 8192

Observations = npt.NDArray[np.float32]
#: Maps observations, one row per lane, to one action or one row of probabilities of all actions per lane.
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
        #: Number of steps after which an episode ends; see :attr:`longest_episode`.
        self.horizon: int = message["horizon"]
        #: Maximum number of steps of an episode: one more than the horizon with ``unpaid_last_step``.
        self.longest_episode: int = message.get("longest_episode", self.horizon)
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
        columns = {
            "returns": np.atleast_1d(np.asarray(returns, np.float64)),
            "lengths": np.atleast_1d(np.asarray(lengths)),
            "terminated": np.atleast_1d(np.asarray(terminated, np.bool_)),
        }
        shapes = {name: column.shape for name, column in columns.items()}
        if len(set(shapes.values())) != 1 or columns["returns"].ndim != 1:
            raise ValueError(f"expected one entry per episode of each, found the shapes {shapes}")
        count = len(columns["returns"])
        for first in range(0, count, _REPORTED_TOGETHER):
            part = slice(first, first + _REPORTED_TOGETHER)
            rows = {name: column[part].tolist() for name, column in columns.items()}
            self._send({"type": "episodes", **rows})
        self.begun += count

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
        keywords = {name: self.message[name] for name in ("family", "scenario") if name in self.message}
        # A key of a file takes the text of the file in place of its name.
        keywords |= {**self.message["environment"], **self.message.get("files", {})}
        # Parameters of a model are one keyword.
        parameters = {name: value for name, value in keywords.items() if name.startswith("parameters.")}
        if parameters:
            keywords = {name: value for name, value in keywords.items() if name not in parameters}
            keywords["parameters"] = {name.removeprefix("parameters."): value for name, value in parameters.items()}
        population = self.message["population"]
        if population and population.get("phases", "all") == "all":
            keywords["population"] = population
        return keywords

    def test(self, policy: Policy, begin: Callable[[int], None] | None = None) -> None:
        """Ends the training, and chooses the actions of the test until its end.

        A job that is a trial has no test: see :meth:`trial`.

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
            self._choose(policy(self._observations(message)))

    def trial(self, agent: Any) -> None:
        """Acts in the trial of the job until its end; the program has declared ``connect(trials=True)``.

        ``agent.act(people, observations)`` returns an action, or a row of probabilities, for each of these people;
        :attr:`day` and :attr:`decision` say when. Two methods are optional. ``agent.observe(people, actions, rewards)``
        receives the actions that were taken, and their rewards: NaN where the outcome does not reach the agent.
        ``agent.update(day, people, before, agent)`` is called when an agent learns: from the data of these people
        from calendar days before ``before``. The argument ``agent`` is the person whose own agent learns, or None for
        the agent of everybody.
        """
        if "trial" not in self.message:
            raise ValueError("the job is no trial: train, and call test()")
        while True:
            message = self._receive("act", "rewards", "update", "end")
            if message["type"] == "end":
                return
            if message["type"] == "act":
                #: The calendar day of a trial, and the decision of the day; both from 0.
                self.day, self.decision = message["day"], message["decision"]
                people = np.array(message["lanes"], np.int64)
                self._choose(agent.act(people, self._observations(message)))
            elif message["type"] == "update":
                if hasattr(agent, "update"):
                    people = np.array(message["people"], np.int64)
                    agent.update(message["day"], people, message["before"], message["agent"])
            elif hasattr(agent, "observe"):
                columns = ("lanes", np.int64), ("actions", np.int64), ("rewards", np.float64)
                agent.observe(*(np.array(message[name], kind) for name, kind in columns))

    def _choose(self, chosen: Any) -> None:
        chosen = np.asarray(chosen)
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


def connect(lanes: int = 1, trials: bool = False) -> Job:
    """The job for which jitai started this program; it trains in this number of lanes.

    ``trials`` says that the program acts in trials, with :meth:`Job.trial`.
    """
    global _is_connected
    if _is_connected:
        raise ProtocolError("connect() was called before; a program has one job")
    if sys.stdin is None or sys.stdin.isatty():
        raise ProtocolError("this program is an outside agent: name it as `command` in a manifest")
    _is_connected = True
    read, write = _own_pipes()
    message = _receive(read, ("job",))
    if message["protocol"] != PROTOCOL:
        raise ProtocolError(f"expected protocol {PROTOCOL}, found {message['protocol']}")
    job = Job(message, lanes, read, write)
    ready = {"type": "ready", "protocol": PROTOCOL, "lanes": lanes}
    job._send({**ready, "trials": True} if trials else ready)
    return job


#: Whether the pipes of the protocol are taken.
_is_connected = False


def _own_pipes() -> tuple[io.BufferedReader, io.TextIOWrapper]:
    """The pipes from and to jitai, which nothing else reads or writes any more.

    Children and native libraries of the program read an empty standard input, and write to standard error.
    """
    sys.stdout.flush()
    read, write = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "w", encoding="utf-8", newline="\n")
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    os.dup2(2, 1)
    # jitai reads standard error as UTF-8; a locale without a letter must not end the program.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8", errors="backslashreplace")
    return read, write


def _receive(read: io.BufferedReader, expected: Sequence[str]) -> dict[str, Any]:
    line = read.readline()
    if not line:
        # End of input: jitai or this job was stopped.
        raise SystemExit(1)
    message: dict[str, Any] = json.loads(line)
    if message["type"] not in expected:
        raise ProtocolError(f"expected {' or '.join(expected)}, found {message['type']}")
    return message
