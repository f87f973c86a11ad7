"""The keywords of the environments, for type checkers and for completion."""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict


class Keywords(TypedDict, total=False):
    """The keywords of :func:`jitai.make`."""

    family: str
    scenario: str | Sequence[str]
    extends: str
    manifest: str | os.PathLike[str]
    environment: str | Mapping[str, Any]
    render_mode: str | None
    state_in_info: bool
    population: Mapping[str, Any]
    # Keys of step_count.
    availability: float
    belief_particles: int
    context_persistence: float
    context_probability: float
    delta_d: float
    delta_h: float
    disengagement_reward: Literal["paid", "zero"]
    disengagement_threshold: float
    epsilon_d: float
    epsilon_h: float
    first_context: Literal["fixed", "sampled"]
    horizon: int
    initial_disengagement: float
    initial_habituation: float
    kappa_d: float
    kappa_h: float
    message_budget: int
    message_cost: float
    mu: Sequence[float]
    observed_probability: int
    parameter_spread: float
    reward_habituation: Literal["expected", "drawn"]
    rho_1: float
    rho_2: float
    rho_3: float
    sigma: float
    sigma_s: float
    state_noise: Literal["none", "uniform", "beta"]
    state_spread: float
    step_noise: Literal["none", "gamma"]
    steps_cut_at_zero: bool
    time_indicator: Literal["lagged", "exact"]
    time_indicator_period: int
    time_one_hot: bool
    unpaid_last_step: bool
    # Keys of declared.
    days: int
    model: str | os.PathLike[str]
    parameters: Mapping[str, float]
    people: str | os.PathLike[str]
    replay: str | os.PathLike[str]


class VectorKeywords(Keywords, total=False):
    """The keywords of :func:`jitai.make_vec` besides the number of lanes."""

    autoreset_mode: Any


def signature(keywords: type, *first: inspect.Parameter) -> inspect.Signature:
    """A signature with the keywords, by which notebooks complete them."""
    names = keywords.__annotations__
    named = [inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=...) for name in names]
    return inspect.Signature([*first, *named])
