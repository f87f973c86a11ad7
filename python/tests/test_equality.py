"""Lane i of a vector environment, the single environment and ``jitai simulate`` are equal to the bit."""

from __future__ import annotations

import json

import jitai
import numpy as np
from conftest import run
from gymnasium.vector import AutoresetMode
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import environments, populations

SEEDS = st.integers(0, 2**64 - 1)


def bits(values) -> list:
    """The bits of numbers, so that -0 differs from 0 and NaN equals itself."""
    return [np.asarray(value).tobytes() for value in values]


def entries(info) -> dict:
    """The entries of an info without the masks; entries of nested dictionaries have dotted names."""
    flat = {}
    for name, value in info.items():
        nested = entries(value) if isinstance(value, dict) else {"": value}
        flat |= {f"{name}.{inner}": entry for inner, entry in nested.items() if name[0] != "_"}
    return flat


def assert_same_entries(info, infos, lane):
    """The info of a single environment equals the lane's info."""
    single, ours = entries(info), entries(infos)
    assert bits(single.values()) == bits(ours[name][lane] for name in single)


@given(
    keywords=environments(),
    people=populations(),
    seeds=st.lists(SEEDS, min_size=1, max_size=9),
    mode=st.sampled_from(AutoresetMode),
    choice=SEEDS,
    calls=st.integers(1, 40),
)
def test_a_lane_is_the_single_environment(keywords, people, seeds, mode, choice, calls):
    keywords = keywords | people
    lanes = len(seeds)
    chance = np.random.default_rng(choice)
    envs = jitai.StepCountVectorEnv(lanes, autoreset_mode=mode, **keywords)
    singles = [jitai.StepCountEnv(**keywords) for _ in seeds]
    observations, _ = envs.reset(seed=seeds)
    for lane, (single, seed) in enumerate(zip(singles, seeds, strict=True)):
        observation, _ = single.reset(seed=seed)
        assert bits([observation]) == bits([observations[lane]])
        assert observation in single.observation_space
    pending = np.zeros(lanes, bool)
    for _ in range(calls):
        if chance.random() < 0.1:
            # A reset of some lanes during their episodes, sometimes with new seeds.
            mask = chance.random(lanes) < 0.5
            mask[chance.integers(lanes)] = True
            again = [int(chance.integers(2**63)) if chance.random() < 0.5 else None for _ in seeds]
            observations, infos = envs.reset(seed=again, options={"reset_mask": mask})
            for lane in np.flatnonzero(mask):
                observation, info = singles[lane].reset(seed=again[lane])
                assert bits([observation]) == bits([observations[lane]])
                assert_same_entries(info, infos, lane)
            pending &= ~mask
        if mode == AutoresetMode.DISABLED and pending.any():
            observations, _ = envs.reset(options={"reset_mask": pending})
            for lane in np.flatnonzero(pending):
                assert bits([singles[lane].reset()[0]]) == bits([observations[lane]])
            pending[:] = False
        actions = chance.integers(0, 4, lanes)
        observations, rewards, terminated, truncated, infos = envs.step(actions)
        for lane, single in enumerate(singles):
            if mode == AutoresetMode.NEXT_STEP and pending[lane]:
                expected = (single.reset()[0], 0.0, False, False)
            else:
                *expected, info = single.step(actions[lane])
                if mode == AutoresetMode.SAME_STEP and (expected[2] or expected[3]):
                    assert bits([expected[0]]) == bits([infos["final_obs"][lane]])
                    assert_same_entries(info, infos["final_info"], lane)
                    expected[0], _ = single.reset()
            found = (observations[lane], rewards[lane], terminated[lane], truncated[lane])
            assert bits(expected) == bits(found)
        pending = terminated | truncated if mode != AutoresetMode.SAME_STEP else pending


@settings(max_examples=25)
@given(keywords=environments(), seed=SEEDS, action=st.integers(0, 3))
@example(keywords={"sigma": 0.6, "scenario": "P-H-D"}, seed=1, action=3)
def test_the_single_environment_is_what_simulate_prints(keywords, seed, action):
    keys = {name: value for name, value in keywords.items() if name != "scenario"}
    words = [f"--set={name}={json.dumps(value)}" for name, value in keys.items()]
    simulated = run(
        "simulate", f"--policy=fixed:{action}", f"--scenario={keywords['scenario']}",
        f"--seed={seed}", "--episodes=3", "--format=json", *words,
    )  # fmt: skip
    assert simulated.returncode == 0, simulated.stderr
    rows = json.loads(simulated.stdout)
    env = jitai.StepCountEnv(**keywords)
    _, info = env.reset(seed=seed)
    total = 0.0
    for place, row in enumerate(rows):
        state = ["step", "context", "probability_0", "likely", "habituation", "disengagement"]
        assert [info[name] for name in state] == [row[name] for name in state]
        assert int(info["available"]) == row["available"]
        _, _, terminated, truncated, info = env.step(action)
        total += info["steps_walked"]
        assert info["steps_walked"] == row["reward"] and total == row["return"]
        ending = "disengaged" if terminated else "horizon" if truncated else "running"
        assert ending == row["ending"]
        if terminated or truncated:
            assert place + 1 == len(rows) or rows[place + 1]["step"] == 0
            _, info = env.reset()
            total = 0.0
    assert {row["episode"] for row in rows} == {1, 2, 3}
