"""Times of PPO beside Stable-Baselines3 and sb3-contrib; `make bench-python` runs it.

The libraries play the same simulation, written with NumPy for all lanes at once. `program.py` describes the
output.
"""

import sys
import time

import gymnasium
import numpy as np
import program
import torch
from program import EPSILON_D, HORIZON, LARGE, LAYERS, SIGMA, SMALL, WITH_GRU, ours
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv


class Simulation(VecEnv):
    """The paper's simulation in scenario P-H-D, [lanes] at once."""

    def __init__(self, lanes):
        space = gymnasium.spaces.Box(0.0, 1.0, (3,), np.float32)
        super().__init__(lanes, space, gymnasium.spaces.Discrete(4))
        self.rng = np.random.default_rng(1)
        self.habituation, self.risk = np.empty(lanes), np.empty(lanes)
        self.context, self.probability = np.empty(lanes, int), np.empty(lanes)
        self.clock = np.zeros(lanes, int)

    def draw_contexts(self):
        self.context = self.rng.integers(0, 2, self.num_envs)
        feature = self.rng.normal(self.context, SIGMA)
        self.probability = 1.0 / (1.0 + np.exp((feature - 0.5) / SIGMA**2))

    def begin(self, lanes):
        self.habituation[lanes], self.risk[lanes], self.clock[lanes] = 0.1, 0.1, 0

    def observation(self):
        return np.stack([self.probability, self.habituation, self.risk], 1).astype(np.float32)

    def reset(self):
        self.begin(slice(None))
        self.draw_contexts()
        return self.observation()

    def step_async(self, actions):
        self.actions = actions

    def step_wait(self):
        none, general = self.actions == 0, self.actions == 1
        tailored = self.actions == self.context + 2
        h, d = self.habituation, self.risk
        self.habituation = np.where(none, 0.9 * h, np.minimum(1.0, h + 0.05))
        fits = general | tailored
        self.risk = np.where(none, d, np.where(fits, 0.9 * d, np.minimum(1.0, d + EPSILON_D)))
        pays = np.where(tailored, 200.0, np.where(general, 50.0, 0.0))
        reward = 0.1 + pays * (1.0 - self.habituation)
        self.clock += 1
        left = self.risk >= 1.0
        done = left | (self.clock >= HORIZON)
        reward[left] = 0.0
        self.draw_contexts()
        last = self.observation()
        self.begin(done)
        infos = [{} for _ in range(self.num_envs)]
        for lane in np.flatnonzero(done):
            infos[lane] = {"terminal_observation": last[lane], "TimeLimit.truncated": not left[lane]}
        # Rewards are divided as jitai's PPO divides them.
        return self.observation(), (reward / 200.0).astype(np.float32), done, infos

    def close(self):
        pass

    def get_attr(self, name, indices=None):
        return [getattr(self, name, None)] * self.num_envs

    def set_attr(self, name, value, indices=None):
        raise NotImplementedError(name)

    def env_method(self, name, *args, indices=None, **keywords):
        raise NotImplementedError(name)

    def env_is_wrapped(self, wrapper, indices=None):
        return [False] * self.num_envs


def theirs(algorithm, policy, setting, keywords):
    """Seconds of a training with a Python library, its construction excluded."""
    lanes, steps, minibatches, epochs, total = setting
    model = algorithm(
        policy,
        Simulation(lanes),
        n_steps=steps,
        batch_size=lanes * steps // minibatches,
        n_epochs=epochs,
        learning_rate=1e-3,
        ent_coef=0.01,
        policy_kwargs=keywords,
        device="cpu",
        seed=1,
    )
    began = time.perf_counter()
    model.learn(total)
    return time.perf_counter() - began


def contenders():
    """Name, a function that gives their seconds, and one that gives ours."""
    feed_forward = {"net_arch": LAYERS}
    memory = 'recurrent = "gru"\nlayers = [64]'
    for name, setting in [("64 x 50", LARGE), ("8 x 256", SMALL)]:
        for engine in ["fused", "burn"]:
            yield (
                f"PPO {name}, {engine}, to Stable-Baselines3",
                lambda s=setting: theirs(PPO, "MlpPolicy", s, feed_forward),
                lambda s=setting, e=engine: ours(s, e, f"layers = {LAYERS}"),
            )
    try:
        from sb3_contrib import RecurrentPPO
    except ImportError as error:
        print(f"sb3-contrib cannot be imported: {error}", file=sys.stderr)
        return
    # The library has an LSTM alone. One is shared by policy and value, as jitai's GRU is.
    lstm = {"net_arch": [], "lstm_hidden_size": 64, "shared_lstm": True, "enable_critic_lstm": False}
    for engine in ["fused", "burn"]:
        yield (
            f"PPO with a GRU, {engine}, to sb3-contrib's LSTM",
            lambda: theirs(RecurrentPPO, "MlpLstmPolicy", WITH_GRU, lstm),
            lambda e=engine: ours(WITH_GRU, e, memory),
        )


def main():
    torch.set_num_threads(1)
    program.compare(contenders())


if __name__ == "__main__":
    main()
