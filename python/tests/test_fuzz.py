"""Arbitrary arguments raise exceptions of Python or Gymnasium, with a message.

``JITAI_EXAMPLES=100000`` sets the number of examples.
"""

from __future__ import annotations

import gymnasium
import jitai
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import BASE, ORALYTICS, TEST_BEDS, of_any_family

EXPECTED = (
    TypeError, ValueError, KeyError, OSError, OverflowError, AttributeError, gymnasium.error.Error,
    gymnasium.error.ClosedEnvironmentError,
)  # fmt: skip

ODD = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.binary(max_size=8),
    st.complex_numbers(),
    st.lists(st.one_of(st.integers(), st.floats(), st.text(max_size=3)), max_size=4),
    st.dictionaries(st.text(max_size=5), st.integers(), max_size=3),
    st.integers(-(2**63), 2**63 - 1).map(np.int64),
    st.integers(0, 2**64 - 1).map(np.uint64),
    st.floats(width=32).map(np.float32),
    st.lists(st.integers(-3, 6), max_size=5).map(lambda numbers: np.array(numbers, np.int64)),
    st.lists(st.floats(), max_size=5).map(np.array),
    st.lists(st.lists(st.integers(0, 3), min_size=2, max_size=2), max_size=3).map(np.array),
    st.just(np.array(["a"])),
    st.just(np.arange(8)[::2]),
    st.just(object()),
)
FAMILY = ["sigma", "family", "people"]
NAMES = st.one_of(st.sampled_from(sorted({*BASE, *ORALYTICS, *FAMILY})), st.text(max_size=12))
OPTIONS = st.dictionaries(st.one_of(st.just("reset_mask"), st.text(max_size=4)), ODD, max_size=2)


def answers(use, *arguments, **keywords):
    """The result of a call, or None if it raises an expected exception with a message."""
    try:
        return use(*arguments, **keywords)
    except EXPECTED as error:
        assert str(error).strip(), type(error)
        return None


@given(
    odd=st.dictionaries(NAMES, ODD, max_size=4),
    scenario=st.one_of(ODD, st.just("P-H-D")),
    manifest=st.one_of(st.none(), ODD),
)
def test_keywords_of_any_kind(odd, scenario, manifest):
    keywords = {"sigma": 0.6} | odd
    for name in ("self", "num_envs"):
        keywords.pop(name, None)
    keywords = {"scenario": scenario, "manifest": manifest} | keywords
    env = answers(jitai.StepCountEnv, **keywords)
    if env is not None:
        env.reset(seed=1)
        assert env.step(0)[0] in env.observation_space


@given(
    keywords=of_any_family(),
    calls=st.lists(st.tuples(st.sampled_from(["step", "reset", "render", "close"]), ODD, OPTIONS)),
)
def test_a_single_environment_survives_any_call(keywords, calls):
    env = jitai.StepCountEnv(**keywords, render_mode="ansi")
    for name, odd, options in calls:
        match name:
            case "step":
                answers(env.step, odd)
            case "reset":
                answers(env.reset, seed=odd, options=options)
            case _:
                getattr(env, name)()


@given(
    keywords=of_any_family(),
    lanes=st.one_of(st.integers(1, 5), ODD),
    mode=st.one_of(st.sampled_from(["NextStep", "SameStep", "Disabled"]), ODD),
    calls=st.lists(st.tuples(st.sampled_from(["step", "reset", "close"]), ODD, OPTIONS)),
)
def test_a_vector_environment_survives_any_call(keywords, lanes, mode, calls):
    if isinstance(lanes, (int, np.integer)) and lanes > 10_000:
        return
    envs = answers(jitai.StepCountVectorEnv, lanes, autoreset_mode=mode, **keywords)
    if envs is None:
        return
    for name, odd, options in calls:
        match name:
            case "step":
                answers(envs.step, odd)
                answers(envs.step, [0] * lanes)
            case "reset":
                answers(envs.reset, seed=odd, options=options)
            case "close":
                envs.close()


@given(sql=st.one_of(st.text(max_size=40), st.sampled_from(["SELECT * FROM "]).flatmap(
    lambda begin: st.text(max_size=20).map(lambda end: begin + end))), name=st.text(max_size=20),
    key=st.one_of(st.text(max_size=5), ODD), observations=ODD)  # fmt: skip
def test_stores_and_policies_survive_any_argument(
    store, jobs_of_store, sql, name, key, observations
):
    results, policy = jobs_of_store
    answers(results.query, sql)
    answers(results.runs, name)
    answers(jitai.Policy.from_store, store, key)
    for use in (policy.act, policy.values, policy.probabilities):
        answers(use, observations)
    answers(policy.reset, observations)


@pytest.fixture(scope="module")
def jobs_of_store(store):
    results = jitai.open(store)
    runs = results.runs()
    return results, jitai.Policy.from_store(store, runs[runs.agent == "dqn"].job_key.iloc[0])


@given(state=st.binary(max_size=200), seeds=st.lists(st.integers(0, 2**64 - 1), max_size=4))
def test_states_that_nobody_saved_are_refused(state, seeds):
    from jitai._jitai import Declaration, Lane, Lanes

    for keys in ({"sigma": 0.6, "message_budget": 3}, {"family": "declared", **TEST_BEDS[0]}):
        declaration = Declaration.of_keys(None, None, keys)
        lane = Lane(declaration, True)
        with pytest.raises(RuntimeError, match="saved state"):
            Lane.restored(declaration, True, 1, False, state)
        with pytest.raises(RuntimeError, match="saved state"):
            Lanes.restored(declaration, 3, "NextStep", True, seeds, False, state)
        assert lane.needs_seed
