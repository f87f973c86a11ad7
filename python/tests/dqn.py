"""A DQN in one file, in the manner of CleanRL: about 60 lines on the vector environment."""

import jitai
import numpy as np
import torch
from torch import nn


class Network(nn.Sequential):
    def __init__(self, inputs: int):
        super().__init__(
            nn.Linear(inputs, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 4)
        )


def train(steps: int, seed: int, lanes: int = 16, **keywords) -> float:
    """Trains for a number of steps, and returns the mean return of 200 greedy episodes."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    chance = np.random.default_rng(seed)
    envs = jitai.make_vec(lanes, autoreset_mode="SameStep", state_in_info=False, **keywords)
    inputs = envs.single_observation_space.shape[0]
    network, target = Network(inputs), Network(inputs)
    target.load_state_dict(network.state_dict())
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    size = 20_000
    seen, seen_next = np.zeros((2, size, inputs), np.float32)
    actions_taken, rewards_paid, ended = np.zeros(size, np.int64), np.zeros(size), np.zeros(size)
    observations, _ = envs.reset(seed=seed)
    for step in range(steps // lanes):
        epsilon = max(0.02, 1 - step * lanes / (0.4 * steps))
        with torch.no_grad():
            actions = network(torch.from_numpy(observations)).argmax(1).numpy()
        explores = chance.random(lanes) < epsilon
        actions = np.where(explores, chance.integers(0, 4, lanes), actions)
        following, rewards, terminated, truncated, infos = envs.step(actions)
        last = following.copy()
        for lane in np.flatnonzero(terminated | truncated):
            last[lane] = infos["final_obs"][lane]
        places = np.arange(step * lanes, (step + 1) * lanes) % size
        seen[places], seen_next[places], actions_taken[places] = observations, last, actions
        rewards_paid[places], ended[places] = rewards / 100, terminated
        observations = following
        if step >= 60:
            for _ in range(4):
                batch = chance.integers(0, min(size, (step + 1) * lanes), 128)
                with torch.no_grad():
                    best = target(torch.from_numpy(seen_next[batch])).max(1).values.numpy()
                targets = rewards_paid[batch] + 0.97 * best * (1 - ended[batch])
                values = network(torch.from_numpy(seen[batch]))
                chosen = values[torch.arange(128), torch.from_numpy(actions_taken[batch])]
                loss = nn.functional.smooth_l1_loss(chosen, torch.from_numpy(targets).float())
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
        if step % 30 == 0:
            target.load_state_dict(network.state_dict())
    envs = jitai.make_vec(200, autoreset_mode="NextStep", **keywords)
    observations, _ = envs.reset(seed=seed + 1)
    returns, alive = np.zeros(200), np.ones(200, bool)
    while alive.any():
        with torch.no_grad():
            actions = network(torch.from_numpy(observations)).argmax(1).numpy()
        observations, rewards, terminated, truncated, _ = envs.step(actions)
        returns += rewards * alive
        alive &= ~(terminated | truncated)
    return float(returns.mean())
