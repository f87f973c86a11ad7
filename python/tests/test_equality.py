"""Lane i of a vector environment, the single environment and the program's simulation are equal to the bit."""

from __future__ import annotations

import json

import jitai
import numpy as np
import pytest
from conftest import PEOPLE, run
from gymnasium.vector import AutoresetMode
from hypothesis import example, given, settings
from hypothesis import strategies as st
from strategies import environments, of_any_family

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
    keywords=of_any_family(),
    seeds=st.lists(SEEDS, min_size=1, max_size=9),
    mode=st.sampled_from(AutoresetMode),
    choice=SEEDS,
    calls=st.integers(1, 40),
)
def test_a_lane_is_the_single_environment(keywords, seeds, mode, choice, calls):
    lanes = len(seeds)
    chance = np.random.default_rng(choice)
    envs = jitai.VectorEnv(lanes, autoreset_mode=mode, **keywords)
    singles = [jitai.Env(**keywords) for _ in seeds]
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
        actions = chance.integers(0, envs.single_action_space.n, lanes)
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


@pytest.mark.parametrize(
    ("keywords", "state"),
    [
        (
            {"sigma": 0.6, "message_cost": 3.0, "availability": 0.7},
            ["context", "habituation", "disengagement"],
        ),
        (
            {
                "family": "declared",
                "model": "oralytics_v2",
                "people": "synthetic_v2.csv",
                "parameters": {"habituation_factor": 0.5},
            },
            ["average_brushing", "average_prompts", "responsiveness", "app_today", "app_before"],
        ),
    ],
)
def test_the_single_environment_is_the_test_of_a_job(keywords, state, tmp_path, monkeypatch):
    """Seeds of a job with one test episode, and the actions that its rule chose."""
    monkeypatch.chdir(PEOPLE)
    scenario = "P-H-D" if "sigma" in keywords else "all"
    parameters = keywords.get("parameters", {})
    given = {name: value for name, value in keywords.items() if name != "parameters"}
    given |= {f"parameters.{name}": value for name, value in parameters.items()}
    keys = "".join(f"environment.{name} = {json.dumps(value)}\n" for name, value in given.items())
    manifest = tmp_path / "rules.toml"
    manifest.write_text(
        f'format = 1\nname = "rules"\nscenarios = ["{scenario}"]\nseeds = 5\n{keys}'
        '[evaluation]\ntest_episodes = 1\nrecord_decisions = "test"\n'
        '[[agent]]\nname = "random"\nalgorithm = "rule"\nrule = "random"\n'
    )
    (tmp_path / "synthetic_v2.csv").symlink_to(PEOPLE / "synthetic_v2.csv")
    store = tmp_path / "rules.sqlite"
    ran = run("run", str(manifest), f"--store={store}", "--quiet")
    assert ran.returncode == 0, ran.stderr
    sql = """SELECT s.seed, s.mean_return, d.* FROM decision AS d JOIN run_summary AS s
             ON s.job_key = d.job_key ORDER BY s.seed, d.step"""
    answer = run("query", sql, f"--store={store}", "--format=json")
    assert answer.returncode == 0, answer.stderr
    rows = json.loads(answer.stdout)
    env = jitai.make(**keywords)
    outcome = env.unwrapped.declaration.outcome
    for seed in range(1, 6):
        _, info = env.reset(seed=seed)
        total, done = 0.0, False
        for row in [row for row in rows if row["seed"] == seed]:
            assert not done
            recorded = json.loads(row["state"])
            assert info["step"] == row["step"]
            assert [info[name] for name in state] == [recorded[name] for name in state]
            _, _, terminated, truncated, info = env.step(row["chosen_action"])
            assert info[outcome] == row["reward"]
            total += info[outcome]
            done = terminated or truncated
        assert done and total == row["mean_return"]
