"""Stable-Baselines3 and an algorithm in the manner of CleanRL learn what our agents learn."""

from __future__ import annotations

import warnings

import jitai
import numpy as np
import pytest
from conftest import PEOPLE

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import jitai.sb3  # noqa: E402
import torch  # noqa: E402
from stable_baselines3 import PPO  # noqa: E402
from stable_baselines3.common.env_checker import check_env  # noqa: E402
from stable_baselines3.common.evaluation import evaluate_policy  # noqa: E402
from stable_baselines3.common.vec_env import VecNormalize  # noqa: E402

KEYWORDS = [
    {"sigma": 0.6},
    {"sigma": 0.4, "scenario": "L-T-A", "availability": 0.5, "time_one_hot": True},
    {"sigma": 0.4, "extends": "step_count_jitai"},
    {"family": "declared", "model": "oralytics_v2", "people": str(PEOPLE / "synthetic_v2.csv"), "days": 10},
]


@pytest.mark.parametrize("keywords", KEYWORDS)
def test_the_checker_of_stable_baselines_has_no_objection(keywords):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(jitai.StepCountEnv(**keywords))


@pytest.mark.parametrize("keywords", KEYWORDS)
def test_the_adapter_equals_single_environments_with_a_monitor(keywords):
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    lanes = 4
    ours = jitai.sb3.VecEnv(lanes, **keywords)
    make = lambda: Monitor(jitai.StepCountEnv(**keywords))  # noqa: E731
    theirs = DummyVecEnv([make] * lanes)
    ours.seed(7)
    theirs.seed(7)
    assert np.array_equal(ours.reset(), theirs.reset())
    chance = np.random.default_rng(0)
    ends = 0
    for _ in range(200):
        actions = chance.integers(0, ours.action_space.n, lanes)
        mine, other = ours.step(actions), theirs.step(actions)
        for one, two in zip(mine[:3], other[:3], strict=True):
            assert one.dtype == two.dtype and np.array_equal(one, two)
        for lane, (info, expected) in enumerate(zip(mine[3], other[3], strict=True)):
            assert bool(info) == mine[2][lane]
            if info:
                ends += 1
                wanted = expected["terminal_observation"]
                assert np.array_equal(info["terminal_observation"], wanted)
                assert info["TimeLimit.truncated"] == expected["TimeLimit.truncated"]
                assert info["episode"]["l"] == expected["episode"]["l"]
                assert info["episode"]["r"] == pytest.approx(expected["episode"]["r"], abs=1e-5)
    assert ends > 10
    masks = ours.env_method("action_masks")
    assert len(masks) == lanes and masks[0].dtype == bool
    # MaskablePPO looks for the method before it calls it.
    methods = ours.get_attr("action_masks")
    assert [method().tolist() for method in methods] == [mask.tolist() for mask in masks]
    with pytest.raises(AttributeError, match="only the method action_masks"):
        ours.env_method("fly")
    ours.close()


@pytest.mark.parametrize(
    "keywords",
    [
        {"sigma": 0.6},
        {"sigma": 0.4, "availability": 0.5, "scenario": "P-H-D-A"},
        {"sigma": 0.6, "population": {"epsilon_d": {"uniform": [0.2, 0.6]}}},
    ],
)
def test_infos_have_the_state_if_they_should(keywords):
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    ours = jitai.sb3.VecEnv(3, state_in_info=True, **keywords)
    theirs = DummyVecEnv([lambda: Monitor(jitai.StepCountEnv(**keywords))] * 3)
    # The time and the lanes' own arrays differ.
    of_monitor = ("episode", "terminal_observation", "TimeLimit.truncated")
    for envs in (ours, theirs):
        envs.seed(7)
        envs.reset()
    assert_same_infos(ours.reset_infos, theirs.reset_infos, of_monitor)
    chance = np.random.default_rng(0)
    ends = 0
    for _ in range(120):
        actions = chance.integers(0, 4, 3)
        mine, other = ours.step(actions), theirs.step(actions)
        assert_same_infos(mine[3], other[3], of_monitor)
        assert_same_infos(ours.reset_infos, theirs.reset_infos, of_monitor)
        ends += mine[2].sum()
    assert ends > 3
    assert jitai.sb3.VecEnv(3, **keywords).env.reset(seed=1)[1].keys() <= {"action_mask", "_action_mask"}


def assert_same_infos(ours, theirs, left_out):
    for mine, other in zip(ours, theirs, strict=True):
        kept = [{n: v for n, v in info.items() if n not in left_out} for info in (mine, other)]
        assert kept[0].keys() == kept[1].keys() and len(kept[0]) >= 8
        for name, value in kept[0].items():
            assert type(value) is type(kept[1][name]), name
            assert np.all(value == kept[1][name]), name


@pytest.mark.filterwarnings("ignore:.*renders nothing")
def test_environments_are_made_by_their_id():
    from stable_baselines3.common.env_util import make_vec_env

    envs = make_vec_env("jitai/StepCount-v0", n_envs=2, env_kwargs={"sigma": 0.6, "horizon": 9})
    assert envs.reset().shape == (2, 3)
    assert [spec.max_episode_steps for spec in envs.get_attr("spec")] == [9, 9]
    assert [masks.tolist() for masks in envs.env_method("action_masks")] == [[True] * 4] * 2
    PPO("MlpPolicy", envs, n_steps=8, batch_size=16, device="cpu").learn(16)
    model = PPO("MlpPolicy", "jitai/StepCount-v0", n_steps=16, batch_size=16, device="cpu")
    model.learn(16)
    assert model.get_env().get_attr("declaration")[0].keys["sigma"] == 0.4


# Test returns of jitai's agents with the same budget: the minimum and the maximum over ten seeds of DQN,
# with both kinds of targets, and of REINFORCE; `jitai run learning.toml` in this folder trains them. Means
# over 200 other episodes differ by up to 10 steps.
LOWEST, HIGHEST = 2614.7, 3216.2 + 10


def test_ppo_learns_as_our_agents_do():
    torch.set_num_threads(1)
    lanes = jitai.sb3.VecEnv(16, sigma=0.4, scenario="C-H-D")
    envs = VecNormalize(lanes, norm_obs=False, gamma=0.97)
    model = PPO(
        "MlpPolicy", envs, n_steps=64, batch_size=128, learning_rate=2e-3, gamma=0.97,
        ent_coef=0.005, seed=1, device="cpu",
    )  # fmt: skip
    model.learn(50_000)
    mean, _ = evaluate_policy(model, jitai.sb3.VecEnv(20, sigma=0.4, scenario="C-H-D"), 200)
    assert LOWEST <= mean <= HIGHEST, mean


def test_a_dqn_in_the_manner_of_cleanrl_learns_as_our_agents_do():
    from dqn import train

    mean = train(steps=50_000, seed=1, sigma=0.4, scenario="C-H-D")
    assert LOWEST <= mean <= HIGHEST, mean
