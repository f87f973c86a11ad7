"""Trained policies, and their files."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import jitai
import numpy as np
import onnxruntime
import pytest
from conftest import ROOT, run
from safetensors.numpy import load_file


@pytest.fixture(scope="session")
def jobs(store):
    """The rows of the trained agents."""
    with jitai.open(store) as results:
        runs = results.runs()
    return runs[runs.agent != "tailored"].to_dict("records")


def key_of(jobs, agent, scenario="P-H-D", place=0):
    matching = [j for j in jobs if (j["agent"], j["scenario"]) == (agent, scenario)]
    return matching[place]["job_key"]


def observations(policy, rows, seed=1):
    """Random observations within the ranges of the features."""
    features = policy.description["features"]
    low = np.array([feature["low"] for feature in features], np.float32)
    high = np.array([feature["high"] for feature in features], np.float32)
    chance = np.random.default_rng(seed)
    return (low + (high - low) * chance.random((rows, len(low)))).astype(np.float32)


@pytest.mark.parametrize("scenario", ["P-H-D", "L-T"])
@pytest.mark.parametrize(("agent", "place"), [("dqn", 0), ("dqn", 2), ("reinforce", 0)])
def test_files_act_as_the_policy_does(store, jobs, tmp_path, agent, place, scenario):
    key = key_of(jobs, agent, scenario, place)
    policy = jitai.Policy.from_store(store, key)
    out = tmp_path / "policy"
    exported = run("export", "--policy", key[:10], "--out", str(out), "--store", str(store))
    assert exported.returncode == 0, exported.stderr
    assert sorted(p.name for p in out.iterdir()) == [
        "policy.json", "policy.onnx", "weights.safetensors",
    ]  # fmt: skip
    description = json.loads((out / "policy.json").read_text())
    assert description == policy.description
    assert description["job_key"] == key and description["scenario"] == scenario
    for file in description["files"].values():
        digest = hashlib.sha256((out / file["name"]).read_bytes()).hexdigest()
        assert digest == file["sha256"]
    weights = load_file(out / "weights.safetensors")
    assert set(weights) == set(policy.weights)
    assert all(np.array_equal(weights[name], policy.weights[name]) for name in weights)

    rows = observations(policy, 100_000)
    values = policy.values(rows)
    ordered = np.sort(values, axis=1)
    clear = ordered[:, 3] - ordered[:, 2] > 1e-4 * (1 + np.abs(ordered[:, 3]))
    assert clear.mean() > 0.9
    best = policy.act(rows, greedy=True)
    assert np.array_equal(best, values.argmax(axis=1))
    probabilities = policy.probabilities(rows)
    assert np.allclose(probabilities.sum(axis=1), 1)

    session = onnxruntime.InferenceSession(out / "policy.onnx", providers=["CPUExecutionProvider"])
    outputs = session.run(["values", "probabilities", "best"], {"observations": rows})
    assert np.allclose(outputs[0], values, rtol=1e-4, atol=1e-4)
    assert np.allclose(outputs[1][clear], probabilities[clear], atol=1e-5)
    assert np.array_equal(outputs[2][clear], best[clear])

    reader = reader_of_the_manual()
    theirs = reader["Reader"](out).values(rows)
    assert np.allclose(theirs, values, rtol=1e-4, atol=1e-4)
    assert np.array_equal(theirs.argmax(axis=1)[clear], best[clear])
    assert np.allclose(
        reader["Reader"](out).probabilities(rows)[clear], probabilities[clear], atol=1e-5
    )


def reader_of_the_manual():
    """The names that the reader of docs/python.md defines."""
    manual = (ROOT / "docs" / "python.md").read_text()
    [code] = re.findall(r"```python\n(# A reader without jitai.*?)```", manual, re.DOTALL)
    assert len(code.strip().splitlines()) <= 40
    names: dict = {}
    exec(compile(code, "docs/python.md", "exec"), names)
    return names


@pytest.mark.parametrize("agent", ["dqn", "reinforce"])
def test_actions_are_those_of_simulate(store, jobs, agent):
    """Including exploration: the policy draws from the same random stream as the program."""
    key = key_of(jobs, agent)
    simulated = run(
        "simulate", f"--policy=run:{key}", "--seed=5", "--episodes=20", "--format=json",
        f"--store={store}",
    )  # fmt: skip
    assert simulated.returncode == 0, simulated.stderr
    rows = json.loads(simulated.stdout)
    policy = jitai.Policy.from_store(store, key)
    policy.reset(5)
    env = jitai.StepCountEnv(
        sigma=0.6, horizon=10, population={"epsilon_d": {"uniform": [0.2, 0.6]}}
    )
    observation, _ = env.reset(seed=5)
    for row in rows:
        probability = policy.probabilities(observation)
        action = policy.act(observation)
        assert (action, row["action_probability"]) == (row["action"], probability[action])
        observation, _, terminated, truncated, _ = env.step(action)
        if terminated or truncated:
            observation, _ = env.reset()


def test_chance_follows_the_probabilities(store, jobs):
    policy = jitai.Policy.from_store(store, key_of(jobs, "reinforce"))
    row = observations(policy, 1)
    actions = policy.act(np.repeat(row, 40_000, axis=0))
    shares = np.bincount(actions, minlength=4) / len(actions)
    expected = policy.probabilities(row[0])
    # Five standard deviations.
    assert (
        np.abs(shares - expected) < 5 * np.sqrt(expected * (1 - expected) / 40_000) + 1e-9
    ).all()
    policy.reset()
    first = policy.act(np.repeat(row, 100, axis=0))
    policy.reset()
    assert np.array_equal(first, policy.act(np.repeat(row, 100, axis=0)))


def test_a_policy_refuses_what_it_cannot_use(store, jobs, tmp_path):
    policy = jitai.Policy.from_store(store, key_of(jobs, "dqn"))
    for wrong, error in [
        (np.zeros((2, 4)), ValueError),
        (np.zeros((2, 2, 3)), ValueError),
        (np.zeros(()), ValueError),
        ([[np.nan, 0, 0]], ValueError),
        ([[0, 0, np.inf]], ValueError),
        (["a", "b", "c"], TypeError),
        (None, TypeError),
    ]:
        with pytest.raises(error, match="observations"):
            policy.act(wrong)
    assert policy.act(np.zeros((0, 3))).shape == (0,)
    assert policy.probabilities(np.zeros((0, 3))).shape == (0, 4)
    for wrong, message in [("zz", "not a job key"), ("", "not a job key"), ("0" * 32, "no job")]:
        with pytest.raises(KeyError, match=message):
            jitai.Policy.from_store(store, wrong)
    with pytest.raises(TypeError, match="key"):
        jitai.Policy.from_store(store, 7)
    with pytest.raises(FileNotFoundError):
        jitai.Policy.from_store(tmp_path / "none", "00")
    with jitai.open(store) as results:
        runs = results.runs()
    rule = runs[runs.agent == "tailored"].job_key.iloc[0]
    with pytest.raises(KeyError, match="has no network to export"):
        jitai.Policy.from_store(store, rule)
    refused = run("export", "--policy", rule, "--out", str(tmp_path), "--store", str(store))
    assert refused.returncode == 2 and "has no network to export" in refused.stderr


def test_a_one_hot_of_time_is_the_last_entries(tmp_path):
    manifest, path = tmp_path / "hot.toml", tmp_path / "hot.sqlite"
    manifest.write_text(
        'format = 1\nname = "hot"\nscenarios = ["P"]\nseeds = 1\n'
        "environment = { sigma = 0.6, horizon = 5, time_one_hot = true }\n"
        '[[agent]]\nname = "r"\nalgorithm = "reinforce"\nepisodes = 5\nlayers = [4]\n'
        "[evaluation]\ntest_episodes = 5\n"
    )
    ran = run("run", str(manifest), "--store", str(path), "--quiet")
    assert ran.returncode == 0, ran.stderr
    with jitai.open(path) as results:
        policy = jitai.Policy.from_store(path, results.runs().job_key[0])
    names = [feature["name"] for feature in policy.description["features"]]
    assert names == ["P", "t0", "t1", "t2", "t3", "t4"]
    env = jitai.StepCountEnv(scenario="P", sigma=0.6, horizon=5, time_one_hot=True)
    observation, _ = env.reset(seed=1)
    assert policy.act(observation) in range(4)
    for wrong in ([0.5, 0, 0, 0, 0, 0], [0.5, 1, 1, 0, 0, 0], [0.5, 0.3, 0, 0, 0, 0]):
        with pytest.raises(ValueError, match="one-hot"):
            policy.act(wrong)
    assert Path(path).exists()
