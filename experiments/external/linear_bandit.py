"""Linear Thompson sampling in NumPy: a Bayesian regression of the reward for every action."""

import numpy as np
from jitai import external

job = external.connect()
chance = np.random.default_rng(job.seed)
width = len(job.names) + 1
precision = np.stack([np.eye(width) / job.parameters["prior_sd"] ** 2] * job.actions)
moment = np.zeros((job.actions, width))


def regressors(observations):
    return np.column_stack([np.ones(len(observations)), observations])


def choose(observations):
    """The best action of a draw from the posterior, for each row."""
    covariance = np.linalg.inv(precision)
    mean = np.einsum("aij,aj->ai", covariance, moment)
    normal = chance.standard_normal((len(observations), job.actions, width))
    drawn = mean + np.einsum("aij,raj->rai", np.linalg.cholesky(covariance), normal)
    return np.einsum("ri,rai->ra", regressors(observations), drawn).argmax(axis=1)


while job.left > 0:
    observations, done = job.reset(), False
    while not done:
        [action] = choose(observations)
        [x] = regressors(observations)
        observations, [reward], [terminated], [truncated] = job.step([action])
        precision[action] += np.outer(x, x) / job.parameters["noise_sd"] ** 2
        moment[action] += x * reward / job.parameters["noise_sd"] ** 2
        done = terminated or truncated
job.test(choose)
