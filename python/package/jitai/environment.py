"""Environments of one's own, as Python programs; ``docs/outside-environments.md`` describes the protocol.

``serve(make)`` answers jitai with any Gymnasium environment, ``serve_lanes(make)`` with a class that steps many
lanes at once. Both return when the job is done. Meanwhile ``print`` writes to standard error, because
standard output belongs to the protocol.
"""

from __future__ import annotations

import binascii
import hashlib
import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from jitai.external import ProtocolError, _own_pipes, _receive

if TYPE_CHECKING:
    import gymnasium

__all__ = ["PROTOCOL", "Lanes", "serve", "serve_lanes"]

#: The version of the protocol.
PROTOCOL = 1
#: The size of jitai's seeds.
_SEED_BITS = 53

Rows = npt.NDArray[Any]
#: A name, or a dict with ``name`` and optionally ``low``, ``high``, ``unit`` and ``meaning``.
Feature = str | dict[str, Any]


class Lanes(Protocol):
    """Many episodes, one per lane. Arrays have a row or an entry for each of the given lanes, in their order.

    ``infos`` maps names to arrays: the names of the recorded state, and ``available``. All randomness of an
    episode must come from its seed, and a lane must not depend on the others.
    """

    def reset(self, lanes: npt.NDArray[np.int64], seeds: Sequence[int]) -> tuple[Rows, dict[str, Any]]:
        """Begins episodes in these lanes: observations and infos."""

    def step(
        self, lanes: npt.NDArray[np.int64], actions: npt.NDArray[np.int64]
    ) -> tuple[Rows, Rows, Rows, Rows, dict[str, Any]]:
        """Takes a step in these lanes: observations, rewards, terminated, truncated and infos."""


def serve(
    make: str | gymnasium.Env[Any, Any] | Callable[..., gymnasium.Env[Any, Any]],
    *,
    features: Sequence[Feature] | None = None,
    actions: Sequence[str] | None = None,
    horizon: int | None = None,
    seed_bits: int = _SEED_BITS,
    **description: Any,
) -> None:
    """Serves a Gymnasium environment to jitai, until the end of the job.

    ``make`` is a function that takes the parameters of the manifest as keywords and returns an environment,
    the id of an environment, or an environment, which is copied. Observations are flattened, as
    :func:`gymnasium.spaces.flatten` does it, which gives a ``Discrete`` one entry per value; entries of a
    ``Dict`` are matched by name where ``features`` has their names; actions must be ``Discrete``.
    ``features`` and ``actions`` name their entries. ``horizon`` is the maximum number of steps, if the
    environment has no limit of its own. ``seed_bits`` is the size of the seeds that the environment takes, such
    as 32 where it calls ``numpy.random.seed``: jitai's seeds, below 2^53, are hashed to it.
    ``description`` are ``nothing``, ``reward``, ``unit``, ``state`` and ``availability``, as in the
    protocol; names of the state, and ``available``, are those of infos.
    """

    def probed(parameters: dict[str, Any]) -> tuple[dict[str, Any], Callable[[int], Any]]:
        env = _made(make, parameters)
        limit = horizon or _limit(env)
        declared = {
            "features": _features(env.observation_space, features),
            "actions": _actions(env.action_space, actions),
            "horizon": limit,
        }
        spare = [env]

        def singles(lanes: int) -> _Singles:
            envs = [spare.pop() if spare else _made(make, parameters) for _ in range(lanes)]
            return _Singles(envs, limit, spare)

        return declared, singles

    _serve(probed, description, seed_bits)


def serve_lanes(
    make: Callable[..., Lanes],
    *,
    features: Sequence[Feature],
    actions: Sequence[str],
    horizon: int | Callable[..., int],
    seed_bits: int = _SEED_BITS,
    **description: Any,
) -> None:
    """Serves a class that steps many lanes at once, until the end of the job.

    ``make`` takes the number of lanes and the parameters of the manifest as keywords, and returns
    :class:`Lanes`. ``features``, ``actions``, ``horizon`` and ``description`` are those of the protocol;
    ``horizon`` may be a function of the parameters. ``seed_bits`` is that of :func:`serve`.
    """

    def probed(parameters: dict[str, Any]) -> tuple[dict[str, Any], Callable[[int], Any]]:
        limit = horizon(**parameters) if callable(horizon) else horizon
        declared = {"features": _declared(features), "actions": list(actions), "horizon": limit}
        return declared, lambda lanes: _Arrays(make(lanes, **parameters))

    _serve(probed, description, seed_bits)


class _Arrays:
    """Lanes that receive arrays instead of lists."""

    def __init__(self, lanes: Lanes) -> None:
        self._lanes = lanes
        self.close: Callable[[], None] = getattr(lanes, "close", lambda: None)

    def reset(self, lanes: list[int], seeds: list[int]) -> tuple[Any, dict[str, Any]]:
        return self._lanes.reset(np.array(lanes, np.int64), seeds)

    def step(self, lanes: list[int], actions: list[int]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        return self._lanes.step(np.array(lanes, np.int64), np.array(actions, np.int64))


class _Singles:
    """Gymnasium environments as lanes."""

    def __init__(
        self, envs: list[gymnasium.Env[Any, Any]], horizon: int, spare: list[gymnasium.Env[Any, Any]]
    ) -> None:
        self._envs, self._horizon, self._spare = envs, horizon, spare
        self._steps = [0] * len(envs)
        space = envs[0].observation_space
        self._flat: Callable[[Any], Any] = lambda observation: observation
        if not _is_vector(space):
            from gymnasium.spaces.utils import flatten

            self._flat = lambda observation: flatten(space, observation)
        self._first = int(getattr(envs[0].action_space, "start", 0))

    def reset(self, lanes: list[int], seeds: list[int]) -> tuple[Any, dict[str, Any]]:
        rows, infos = [], []
        for lane, seed in zip(lanes, seeds):
            observation, info = self._envs[lane].reset(seed=seed)
            self._steps[lane] = 0
            rows.append(self._flat(observation))
            infos.append(info)
        return rows, _columns(infos)

    def step(self, lanes: list[int], actions: list[int]) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        results = []
        for lane, action in zip(lanes, actions):
            observation, reward, terminated, truncated, info = self._envs[lane].step(action + self._first)
            self._steps[lane] += 1
            truncated = truncated or self._steps[lane] >= self._horizon
            results.append((self._flat(observation), reward, terminated, truncated, info))
        rows, rewards, terminated, truncated, infos = zip(*results)
        return rows, rewards, terminated, truncated, _columns(infos)


    def close(self) -> None:
        """Leaves the environments to later lanes."""
        self._spare.extend(self._envs)


def _columns(infos: Iterable[dict[str, Any]]) -> dict[str, Any]:
    """Infos of single environments as lists, of the names that all of them have."""
    first, *others = infos
    names = set(first).intersection(*others) if first else ()
    return {name: [info[name] for info in (first, *others)] for name in names}


def _made(make: Any, parameters: dict[str, Any]) -> gymnasium.Env[Any, Any]:
    if isinstance(make, str):
        import gymnasium

        return gymnasium.make(make, disable_env_checker=True, **parameters)
    if callable(make):
        return make(**parameters)
    if parameters:
        names = ", ".join(sorted(parameters))
        raise TypeError(f"expected a function that makes environments from the parameters {names}")
    import copy

    return copy.deepcopy(make)


def _limit(env: gymnasium.Env[Any, Any]) -> int:
    """Maximum number of steps of an episode."""
    limit = getattr(env.spec, "max_episode_steps", None)
    if limit is None:
        raise ValueError("the environment has no max_episode_steps; pass horizon=… to serve")
    return int(limit)


def _is_vector(space: Any) -> bool:
    from gymnasium.spaces import Box

    return isinstance(space, Box) and len(space.shape) == 1


def _features(space: Any, names: Sequence[Feature] | None) -> list[dict[str, Any]]:
    from gymnasium.spaces.utils import flatten_space

    flat = flatten_space(space)
    default = _names(space, "")
    given = _declared(default if names is None else names)
    if len(given) != flat.shape[0]:
        raise ValueError(f"expected {flat.shape[0]} features, {', '.join(default)}; found {len(given)}")
    by_name = {feature["name"]: feature for feature in given}
    if by_name.keys() == set(default):
        # The entries have names of their own, such as the keys of a Dict, which may have been sorted.
        given = [by_name[name] for name in default]
    elif any(feature["name"] in default and feature["name"] != own for feature, own in zip(given, default)):
        raise ValueError(f"the entries of observations are, in this order, {', '.join(default)}")
    bounds = zip(flat.low.tolist(), flat.high.tolist())
    return [
        {"low": low if np.isfinite(low) else None, "high": high if np.isfinite(high) else None} | feature
        for feature, (low, high) in zip(given, bounds)
    ]


def _names(space: Any, prefix: str) -> list[str]:
    """Names of the entries of a flattened space: keys of dicts, with numbers where there are several."""
    from gymnasium.spaces import Dict, Tuple
    from gymnasium.spaces.utils import flatdim

    if isinstance(space, (Dict, Tuple)):
        parts = space.spaces.items() if isinstance(space, Dict) else enumerate(space.spaces)
        joined = [(re.sub(r"\W", "_", f"{prefix}{key}", flags=re.ASCII), part) for key, part in parts]
        return [name for key, part in joined for name in _names(part, f"{key}_")]
    count = flatdim(space)
    return [prefix.rstrip("_")] if count == 1 and prefix else [f"{prefix or 'x'}{i}" for i in range(count)]


def _declared(features: Sequence[Feature]) -> list[dict[str, Any]]:
    return [{"name": feature} if isinstance(feature, str) else dict(feature) for feature in features]


def _actions(space: Any, names: Sequence[str] | None) -> list[str]:
    from gymnasium.spaces import Discrete

    if not isinstance(space, Discrete):
        raise TypeError(f"expected a Discrete action space, found {space}")
    count = int(space.n)
    if names is not None and len(names) != count:
        raise ValueError(f"expected {count} names of actions, found {len(names)}")
    return list(names) if names is not None else [f"a{action}" for action in range(count)]


class _Set:
    """A set of lanes, and what is reported about them."""

    def __init__(self, lanes: Any, names: Sequence[str], availability: bool) -> None:
        self._lanes, self._names, self._availability = lanes, names, availability
        self.close: Callable[[], None] = getattr(lanes, "close", lambda: None)

    def reset(self, message: dict[str, Any]) -> str:
        rows, infos = self._lanes.reset(message["lanes"], message["seeds"])
        return f'{{"type":"began","observations":"{_packed(rows)}"{self._more(infos)}}}\n'

    def step(self, message: dict[str, Any]) -> str:
        rows, rewards, terminated, truncated, infos = self._lanes.step(message["lanes"], message["actions"])
        ends = ""
        for name, values in (("terminated", terminated), ("truncated", truncated)):
            if any(values):
                ends += f',"{name}":"{_packed(values)}"'
        numbers = f'"observations":"{_packed(rows)}","rewards":"{_packed(rewards)}"'
        return f'{{"type":"stepped",{numbers}{ends}{self._more(infos)}}}\n'

    def _more(self, infos: dict[str, Any]) -> str:
        more = ""
        if self._names:
            try:
                columns = [np.asarray(infos[name], np.float64) for name in self._names]
            except KeyError as error:
                raise KeyError(f"the state has {error}, but infos have only {sorted(infos)}") from None
            more += f',"state":"{_packed(np.stack(columns, axis=1))}"'
        if self._availability:
            if "available" not in infos:
                raise KeyError(f"infos need `available`, but have only {sorted(infos)}")
            more += f',"available":"{_packed(infos["available"])}"'
        return more


def _hashed(seed: int, bits: int) -> int:
    """A seed of so many bits that depends on all bits of this one."""
    digest = hashlib.sha256(seed.to_bytes(8, "little")).digest()
    return int.from_bytes(digest[:8], "little") % (1 << bits)


def _packed(values: Any) -> str:
    """Numbers as the base64 of little-endian 64-bit floating-point numbers."""
    data = np.asarray(values, "<f8").tobytes()
    return binascii.b2a_base64(data, newline=False).decode("ascii")


def _serve(
    probed: Callable[[dict[str, Any]], tuple[dict[str, Any], Callable[[int], Any]]],
    more: dict[str, Any],
    seed_bits: int,
) -> None:
    """Answers jitai until the job is done."""
    if not 1 <= seed_bits <= 64:
        raise ValueError(f"expected seed_bits from 1 to 64, found {seed_bits}")
    if sys.stdin is None or sys.stdin.isatty():
        raise ProtocolError("this program is an environment: name it as `command` in a manifest")
    read, write = _own_pipes()
    message = _receive(read, ("describe",))
    if message["protocol"] != PROTOCOL:
        raise ProtocolError(f"expected protocol {PROTOCOL}, found {message['protocol']}")
    declared, make = probed(message["parameters"])
    answer = {"type": "description", "protocol": PROTOCOL, **declared, **more}
    write.write(json.dumps(answer, allow_nan=False) + "\n")
    write.flush()
    names, availability = list(more.get("state", ())), bool(more.get("availability", False))
    sets: dict[int, _Set] = {}
    while True:
        message = _receive(read, ("begin", "reset", "step", "close", "end"))
        kind = message["type"]
        if kind == "end":
            return
        instance = message["instance"]
        if kind == "begin":
            sets[instance] = _Set(make(message["lanes"]), names if message["state"] else (), availability)
        elif kind == "close":
            sets.pop(instance).close()
        else:
            if kind == "reset" and seed_bits < _SEED_BITS:
                message["seeds"] = [_hashed(seed, seed_bits) for seed in message["seeds"]]
            write.write(sets[instance].reset(message) if kind == "reset" else sets[instance].step(message))
            write.flush()
