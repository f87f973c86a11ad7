"""The posterior of partial pooling from the joint normal distribution of everything, in NumPy: posterior.json.

Coefficients of person i are theta + u_i, with theta ~ N(mean, diag(prior_sd^2)) and u_i ~ N(0, diag(person_sd^2)). Nothing here
uses that people are independent given theta. Run it in this folder: python3 posterior.py > posterior.json
"""

import json

import numpy as np

MEAN, PRIOR_SD, NOISE_SD = np.array([1.0, -0.5, 0.2]), np.array([2.0, 1.0, 4.0]), 1.5
COUNTS = [4, 1, 30, 0, 7, 2]
WIDTH = len(MEAN)


def joint(rows, rewards, person_sd):
    """Means and covariances of theta + u_i of everybody, and of a person without data."""
    size = WIDTH * (len(rows) + 2)
    sd = np.concatenate([PRIOR_SD, np.tile(person_sd, len(rows) + 1)])
    prior, mean = np.diag(sd**2), np.concatenate([MEAN, np.zeros(size - WIDTH)])
    design = np.zeros((sum(map(len, rows)), size))
    first = 0
    for person, own in enumerate(rows):
        design[first : first + len(own), :WIDTH] = own
        design[first : first + len(own), WIDTH * (person + 1) : WIDTH * (person + 2)] = own
        first += len(own)
    covariance = design @ prior @ design.T + NOISE_SD**2 * np.eye(len(design))
    gain = np.linalg.solve(covariance, design @ prior).T
    mean = mean + gain @ (np.concatenate(rewards) - design @ mean)
    covariance = prior - gain @ design @ prior
    people = []
    for person in range(len(rows) + 1):
        add = np.zeros((WIDTH, size))
        add[:, :WIDTH] = add[:, WIDTH * (person + 1) : WIDTH * (person + 2)] = np.eye(WIDTH)
        people.append({"mean": (add @ mean).tolist(), "covariance": (add @ covariance @ add.T).tolist()})
    return people


chance = np.random.default_rng(1)
rows = [np.column_stack([np.ones(n), chance.uniform(-1, 1, (n, WIDTH - 1))]) for n in COUNTS]
own = MEAN + chance.normal(0, [0.5, 0.2, 2.0], (len(COUNTS), WIDTH))
rewards = [x @ theta + chance.normal(0, NOISE_SD, len(x)) for x, theta in zip(rows, own)]
cases = []
for person_sd in ([0.5, 0.0, 2.0], [1e-4, 3.0, 0.2], [5.0, 8.0, 3.0]):
    cases.append({"person_sd": person_sd, "people": joint(rows, rewards, np.array(person_sd))})
print(
    json.dumps(
        {
            "mean": MEAN.tolist(),
            "prior_sd": PRIOR_SD.tolist(),
            "noise_sd": NOISE_SD,
            "rows": [x.tolist() for x in rows],
            "rewards": [x.tolist() for x in rewards],
            "cases": cases,
        }
    )
)
