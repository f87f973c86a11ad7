"""Trained policies, and their files."""

from __future__ import annotations

import hashlib
import json
import pickle
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
    refused = run("export", "--policy", rule, "--out", str(tmp_path), "--store", str(store))
    assert refused.returncode == 2
    assert "agents of the algorithm `rule` have no weights" in refused.stderr


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


BANDITS = """\
format = 1
name = "bandits"
scenarios = [{scenario}]
seeds = 1
evaluation = {{ test_episodes = 4, record_decisions = "test" }}

[environment]
{environment}

"""

# Every way to a probability: an integral, shares of draws, the sign of the effect, and the logistic function.
OF_FOUR = {
    "plain": "",
    "biased": "action_bias = [0, -20, -30, 5]\npi_min = 0.05",
    "products": 'features = "interactions"\nprior_sd = 60',
    "centred": "action_centring = true\npi_min = 0.05",
    "smooth": "smoothing = 0.05\nprobability_draws = 300",
    "both": "action_centring = true\nsmoothing = 0.02\npi_min = 0.01\nprobability_draws = 200",
    "by_episode": 'draw = "episode"',
}
OF_TWO = {
    "plain": "noise_sd = 1000",
    "logistic": 'allocation = "logistic"\nlogistic_odds = 3\nlogistic_slope = 0.515',
    "clipped": 'allocation = "clipped"\npi_min = 0.1\nnoise_sd = 1000',
    "clipped_centred": 'allocation = "clipped"\naction_centring = true\npi_min = 0.2\nnoise_sd = 1000',
    "narrow": 'allocation = "logistic"\nlogistic_slope = 0.01\nprior_sd = 1',
    "steep": 'allocation = "logistic"\nlogistic_slope = 40\naction_bias = [0, 12]',
    "centred": 'allocation = "logistic"\naction_centring = true\nnoise_sd = 63.7',
}
# Scenario, environment, agents, and the observation of a recorded decision; the clock lags.
PLACES = {
    "four": (
        '"C-H-D"',
        "sigma = 0.4\nhorizon = 10",
        OF_FOUR,
        lambda row: [row.context, row.habituation, row.disengagement],
    ),
    "hot": (
        '"C-H"',
        "sigma = 0.4\nhorizon = 4\ntime_one_hot = true",
        {"products": OF_FOUR["products"]},
        lambda row: [row.context, row.habituation, *np.eye(4)[max(row.step - 1, 0)]],
    ),
    "two": (
        '["time_of_day", "app"]',
        'family = "declared"\nmodel = "oralytics_v2"\ndays = 8\npeople = "people.csv"',
        OF_TWO,
        lambda row: [row.step % 2, json.loads(row.state)["app_before"]],
    ),
}


@pytest.fixture(scope="session", params=PLACES)
def bandits(request, tmp_path_factory):
    """A store with a completed job of each bandit, the job keys by agent, and the observations."""
    folder = tmp_path_factory.mktemp(request.param)
    people = ROOT / "experiments" / "oralytics" / "synthetic_v2.csv"
    (folder / "people.csv").write_bytes(people.read_bytes())
    scenario, environment, agents, seen = PLACES[request.param]
    text = BANDITS.format(scenario=scenario, environment=environment)
    for name, keys in agents.items():
        text += f'[[agent]]\nname = "{name}"\nalgorithm = "linear_thompson"\nepisodes = 6\n{keys}\n'
    (folder / "bandits.toml").write_text(text)
    ran = run("run", "bandits.toml", "--quiet", cwd=folder)
    assert ran.returncode == 0, ran.stderr
    with jitai.open(folder / "jitai.sqlite") as results:
        keys = dict(results.runs()[["agent", "job_key"]].values)
    assert len(keys) == len(agents)
    return folder / "jitai.sqlite", keys, seen


def test_the_reader_of_bandits_has_the_probabilities_of_the_program(bandits, tmp_path):
    store, keys, seen = bandits
    with jitai.open(store) as results:
        decisions = results.decisions()
    for agent, key in keys.items():
        policy = jitai.Policy.from_store(store, key)
        out = tmp_path / agent
        exported = run("export", "--policy", key, "--out", str(out), "--store", str(store))
        assert exported.returncode == 0, exported.stderr
        assert [path.name for path in out.iterdir()] == ["policy.json"]
        description = json.loads((out / "policy.json").read_text())
        assert description == policy.description
        reader = reader_of_bandits()["probabilities"]

        one_hot = description["posterior"]["one_hot"]
        chance = np.random.default_rng(3)
        # Numbers that the agent can observe.
        assert description["observation_bits"] == 32
        rows = chance.random((200, len(description["features"])), np.float32)
        if one_hot:
            rows[:, -one_hot:] = np.eye(one_hot)[chance.integers(0, one_hot, 200)]
        ours = policy.probabilities(rows)
        theirs = np.array([reader(description, row) for row in rows])
        assert np.abs(ours - theirs).max() < 1e-9, agent
        assert np.allclose(ours.sum(axis=1), 1) and ours.std(axis=0).max() > 1e-4
        best = policy.values(rows).argmax(axis=1)
        assert np.array_equal(policy.act(rows, greedy=True), best)

        played = decisions[decisions.job_key == key]
        assert len(played) >= 4 * 4
        for row in played.itertuples():
            # Observations have single precision.
            observation = np.array(seen(row), np.float32)
            recorded = np.array(json.loads(row.action_probabilities))
            if agent == "by_episode":
                # Given the coefficients of the episode, an action is certain.
                assert set(recorded) == {0.0, 1.0}
                continue
            assert np.array_equal(policy.probabilities(observation), recorded)
            assert np.abs(reader(description, observation) - recorded).max() < 1e-9


def reader_of_bandits():
    """The names that the reader of docs/bandits.md defines."""
    manual = (ROOT / "docs" / "bandits.md").read_text()
    [code] = re.findall(r"```python\n(# A reader of bandits.*?)```", manual, re.DOTALL)
    assert len(code.strip().splitlines()) <= 40
    names: dict = {}
    exec(compile(code, "docs/bandits.md", "exec"), names)
    return names


def test_chance_of_a_bandit_follows_its_probabilities(bandits):
    store, keys, _ = bandits
    policy = jitai.Policy.from_store(store, next(iter(keys.values())))
    inputs = len(policy.description["features"])
    row = np.zeros(inputs)
    row[-1] = 1
    expected = policy.probabilities(row)
    policy.reset(1)
    actions = policy.act(np.repeat(row[np.newaxis], 20_000, axis=0))
    shares = np.bincount(actions, minlength=len(expected)) / len(actions)
    assert (np.abs(shares - expected) < 5 * np.sqrt(expected / 20_000) + 1e-9).all()
    policy.reset(1)
    assert policy.act(row) == actions[0]
    mean, precision = policy.weights["mean"], policy.weights["precision"]
    assert np.allclose(np.einsum("rij,rj->ri", precision, mean), policy.weights["information"])


OTHERS = """\
format = 1
name = "others"
scenarios = ["P-H-D", "L-H-D"]
seeds = 1
environment = { sigma = 0.6, horizon = 10 }
evaluation.test_episodes = 5

[[agent]]
name = "dqn"
algorithm = "dueling_dqn"
recurrent = "gru"
episodes = 30
layers = [8, 6]
units = 5

[[agent]]
name = "ppo"
algorithm = "ppo"
recurrent = "gru"
episodes = 64
lanes = 8
steps = 16
layers = [8, 6]
units = 5
"""
RULES = ["never", "untailored", "tailored", "threshold", "random", "optimal"]


@pytest.fixture(scope="session")
def others(tmp_path_factory):
    """A store with agents that remember, and with every rule; and its job keys by agent and scenario."""
    folder = tmp_path_factory.mktemp("others")
    rules = "".join(
        f'[[agent]]\nname = "{rule}"\nalgorithm = "rule"\nrule = "{rule}"\n' for rule in RULES
    )
    (folder / "others.toml").write_text(OTHERS + rules)
    ran = run("run", "others.toml", "--quiet", cwd=folder)
    assert ran.returncode == 0, ran.stderr
    with jitai.open(folder / "jitai.sqlite") as results:
        runs = results.runs()
    keys = {(row.agent, row.scenario): row.job_key for row in runs.itertuples()}
    assert len(keys) == 2 * (2 + len(RULES))
    return folder / "jitai.sqlite", keys


@pytest.mark.parametrize("scenario", ["P-H-D", "L-H-D"])
@pytest.mark.parametrize("agent", ["dqn", "ppo", *RULES])
def test_agents_that_remember_and_rules_act_as_simulate_does(others, agent, scenario):
    store, keys = others
    key = keys[agent, scenario]
    simulated = run(
        "simulate", f"--policy=run:{key}", "--seed=5", "--episodes=20", "--format=json",
        f"--store={store}",
    )  # fmt: skip
    assert simulated.returncode == 0, simulated.stderr
    with jitai.open(store) as results:
        policy = results.policy(key)
    policy.reset(5)
    env = jitai.make(scenario=scenario, sigma=0.6, horizon=10)
    observation, info = env.reset(seed=5)
    for row in json.loads(simulated.stdout):
        probability = policy.probabilities(observation, info=info)
        assert np.array_equal(probability, policy.probabilities(observation, info=info))
        # A copy in another process continues identically.
        copied = pickle.loads(pickle.dumps(policy))
        action = policy.act(observation, info=info)
        assert copied.act(observation, info=info) == action
        assert (action, row["action_probability"]) == (row["action"], probability[action])
        observation, _, terminated, truncated, info = env.step(action)
        if terminated or truncated:
            observation, info = env.reset()
            policy.begin()
    assert repr(policy).startswith(f"<jitai.Policy of job {key}: ")


@pytest.mark.parametrize("agent", ["dqn", "ppo"])
def test_the_graph_of_a_gru_has_its_state(others, tmp_path, agent):
    store, keys = others
    key = keys[agent, "P-H-D"]
    policy = jitai.Policy.from_store(store, key)
    out = tmp_path / "policy"
    exported = run("export", "--policy", key, "--out", str(out), "--store", str(store))
    assert exported.returncode == 0, exported.stderr
    assert json.loads((out / "policy.json").read_text()) == policy.description
    [stack] = policy.description["network"]["stacks"]
    assert stack["gru"] == {"before": 1, "input": "gru_input", "state": "gru_hidden"}
    session = onnxruntime.InferenceSession(out / "policy.onnx", providers=["CPUExecutionProvider"])
    state = np.zeros((300, 5), np.float32)
    for step in range(12):
        rows = observations(policy, 300, seed=step)
        values, probabilities = policy.values(rows), policy.probabilities(rows)
        best = policy.act(rows, greedy=True)
        assert np.array_equal(best, values.argmax(axis=1))
        names = ["values", "probabilities", "best", "next_state"]
        theirs = session.run(names, {"observations": rows, "state": state})
        assert np.allclose(theirs[0], values, rtol=1e-4, atol=1e-4)
        ordered = np.sort(values, axis=1)
        clear = ordered[:, 3] - ordered[:, 2] > 1e-4 * (1 + np.abs(ordered[:, 3]))
        assert np.allclose(theirs[1][clear], probabilities[clear], atol=1e-4)
        assert np.array_equal(theirs[2][clear], best[clear])
        state = theirs[3]
        if step == 5:
            ended = np.arange(300) % 3 == 0
            policy.begin(ended)
            state[ended] = 0
    assert np.abs(state).max() > 1e-3


def test_rows_of_a_policy_that_remembers_are_episodes(others):
    store, keys = others
    policy = jitai.Policy.from_store(store, keys["ppo", "P-H-D"])
    assert policy.act(np.zeros((0, 3))).shape == (0,)
    rows = observations(policy, 3)
    first = policy.values(rows)
    policy.act(rows)
    assert not np.array_equal(policy.values(rows), first)
    with pytest.raises(ValueError, match="a row for each of 3 running episodes, found 2; begin"):
        policy.act(rows[:2])
    with pytest.raises(ValueError, match="an entry for each of 3 running episodes, found 2"):
        policy.begin([True, False])
    policy.begin([True, False, True])
    now = policy.values(rows)
    assert np.array_equal(now[[0, 2]], first[[0, 2]]) and not np.array_equal(now[1], first[1])
    policy.begin()
    assert np.array_equal(policy.values(rows[:2]), first[:2])
    policy.act(rows[:1])
    policy.reset()
    assert np.array_equal(policy.values(rows), first)


def test_a_rule_acts_on_the_true_state(others):
    store, keys = others
    policy = jitai.Policy.from_store(store, keys["tailored", "L-H-D"])
    envs = jitai.make_vec(50, scenario="L-H-D", sigma=0.6)
    rows, infos = envs.reset(seed=1)
    rows, *_, infos = envs.step(policy.act(rows, info=infos))
    assert np.array_equal(policy.act(rows, info=infos), 2 + infos["likely"])
    assert policy.description["job_key"] == policy.job_key and not policy.weights
    with pytest.raises(TypeError, match="acts on the true state; pass info"):
        policy.act(rows)
    with pytest.raises(ValueError, match="likely.* missing"):
        policy.act(rows, info={"step": 1})
    with pytest.raises(ValueError, match="this policy is a rule"):
        policy.act(rows, info=infos, greedy=True)
    with pytest.raises(ValueError, match="no values"):
        policy.values(rows)
    chance = jitai.Policy.from_store(store, keys["random", "P-H-D"])
    assert set(chance.act(rows)) == {0, 1, 2, 3}
    assert np.array_equal(chance.probabilities(rows[0]), [0.25] * 4)


def test_policies_can_be_pickled(store, jobs, bandits):
    of_bandits, keys, _ = bandits
    policies = [jitai.Policy.from_store(store, job["job_key"]) for job in jobs[:4]]
    policies += [jitai.Policy.from_store(of_bandits, key) for key in keys.values()]
    for policy in policies:
        inputs = len(policy.description["features"])
        rows = np.zeros((50, inputs))
        rows[:, -1] = 1
        policy.reset(7)
        policy.act(rows)
        copied = pickle.loads(pickle.dumps(policy))
        assert (copied.job_key, copied.description) == (policy.job_key, policy.description)
        assert np.array_equal(copied.probabilities(rows), policy.probabilities(rows))
        assert np.array_equal(copied.act(rows), policy.act(rows))


def test_a_bandit_learns_from_a_log_as_the_program_does(bandits, tmp_path):
    store, keys, _ = bandits
    if "plain" not in keys:
        pytest.skip("rows of a one-hot have no columns in a log")
    for agent in ("plain", "centred"):
        key = keys[agent]
        policy = jitai.Policy.from_store(store, key)
        rows = observations(policy, 30)
        chance = np.random.default_rng(3)
        count = len(policy.description["actions"])
        actions = chance.integers(0, count, 30)
        rewards = chance.normal(50, 20, 30)
        chances = chance.dirichlet(np.ones(count), 30)
        learned = policy.update(rows, actions, rewards, chances)
        # By conjugacy: the precision grows by the rows, and the order does not matter.
        assert not np.array_equal(learned.weights["precision"], policy.weights["precision"])
        halves = policy.update(rows[15:], actions[15:], rewards[15:], chances[15:])
        halves = halves.update(rows[:15], actions[:15], rewards[:15], chances[:15])
        for name in ("mean", "precision"):
            np.testing.assert_allclose(halves.weights[name], learned.weights[name], rtol=1e-8, atol=1e-8)
        # The program learns the same from files.
        assert run("export", "--store", str(store), "--policy", key, "--out", str(tmp_path / agent)).returncode == 0
        file = tmp_path / agent / "policy.json"
        names = [feature["name"] for feature in policy.description["features"]]
        columns = {name: rows[:, index] for index, name in enumerate(names)}
        columns |= {"action": actions, "reward": rewards}
        columns |= {f"probability_{index}": chances[:, index] for index in range(1, count)}
        log = tmp_path / f"{agent}.csv"
        lines = (",".join(repr(float(column[row])) for column in columns.values()) for row in range(30))
        log.write_text("\n".join([",".join(columns), *lines]) + "\n")
        new = tmp_path / f"{agent}.json"
        ran = run("decide", "--policy", str(file), "--data", str(log), "--update", str(new))
        assert ran.returncode == 0, ran.stderr
        of_program = json.loads(new.read_text())["posterior"]
        np.testing.assert_allclose(of_program["mean"], learned.weights["mean"], rtol=1e-6, atol=1e-6)
        # Decisions without availability, and outcomes that were not reached, teach nothing.
        available, reached = np.arange(30) % 5 > 0, np.arange(30) % 7 != 3
        unknown = np.where(available & reached, rewards, np.nan)
        some = policy.update(
            rows, np.where(available, actions, 0), unknown, chances, available=available, reached=reached * 1
        )
        kept = available & reached
        same = policy.update(rows[kept], actions[kept], rewards[kept], chances[kept])
        assert np.array_equal(some.weights["precision"], same.weights["precision"])
        assert np.array_equal(some.weights["mean"], same.weights["mean"])
    with pytest.raises(ValueError, match="row 0 has 1 where available is 0"):
        policy.update(rows[:1], [1], [1.0], chances[:1], available=[0])
    with pytest.raises(ValueError, match="reached: expected 0 or 1 for each of 2"):
        policy.update(rows[:2], [1, 1], [1.0, 1.0], chances[:2], reached=[1, 0.5])
    with pytest.raises(ValueError, match="row 0 has 99"):
        policy.update(rows[:1], [99], [1.0], chances[:1])
    with pytest.raises(ValueError, match="an action and a reward for each of 2"):
        policy.update(rows[:2], [1], [1.0])
    certain = np.eye(count)[:1]
    with pytest.raises(ValueError, match="row 0 has 0 for its action 1"):
        policy.update(rows[:1], [1], [1.0], certain)
    with pytest.raises(TypeError, match="whole numbers"):
        policy.update(rows[:1], [0.5], [1.0])
