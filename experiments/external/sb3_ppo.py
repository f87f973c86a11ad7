"""PPO of Stable-Baselines3, trained in this process; the episodes are reported."""

import torch
from jitai import external
from jitai.sb3 import JobVecEnv
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

job = external.connect()
torch.set_num_threads(1)
lanes = JobVecEnv(job, 16)
model = PPO(
    "MlpPolicy",
    VecNormalize(lanes, norm_obs=False, gamma=0.97),
    n_steps=50,
    batch_size=200,
    gamma=0.97,
    learning_rate=job.parameters["learning_rate"],
    seed=job.seed % 2**32,
    device="cpu",
)
# The callback ends the training once the budget is spent.
model.learn(job.episodes * job.horizon * 2, callback=lanes.callback)


def probabilities(observations):
    with torch.no_grad():
        distribution = model.policy.get_distribution(torch.as_tensor(observations))
    return distribution.distribution.probs.numpy()


job.test(probabilities)
