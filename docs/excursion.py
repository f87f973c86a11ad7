"""The causal excursion effect of a message, by weighted and centred least squares.

    python docs/excursion.py [STORE [EXPERIMENT]]

reads the decisions of the agent `random` of an experiment (`trial` by default) and prints the effect of
sending any message, against none, on the reward of the same step, with its 95 % interval over people;
then how often the intervals of many small trials, cut from the same decisions, hold the exact effect.

Source: Boruvka, Almirall, Witkiewitz and Murphy, "Assessing time-varying causal effect moderation in
mobile health", Journal of the American Statistical Association 113 (2018), 1112-1121: the estimating
equation of section 5, and its small-sample correction after Mancl and DeRouen (2001).
"""

# %% The decisions of the trial
import sqlite3
import sys
from pathlib import Path

import numpy as np
import pandas as pd

PEOPLE = 40  # in a small trial


def wcls(trial, moderators=()):
    """Effect of sending a message: estimates, standard errors and 95 % intervals, one row per term.

    `trial` has a row per decision with `person`, `action`, `action_probability`, `available`, `reward`
    and the moderators. The model of the reward without treatment has the moderators,
    habituation and disengagement risk; the estimate stays consistent if that model is wrong, because the
    treatment is centred with its probability.
    """
    trial = trial[trial["available"] == 1]
    sends = (trial["action"] > 0).to_numpy(float)
    # The trial sends each of four actions with its probability, so a message with what is left.
    none = trial.loc[trial["action"] == 0, "action_probability"].mean()
    randomised = np.where(sends == 1, 1 - none, none)
    centre = 1 - none
    weight = np.where(sends == 1, centre, 1 - centre) / randomised
    ones = np.ones(len(trial))
    moderation = np.column_stack([ones, *(trial[name] for name in moderators)])
    of_state = [name for name in ("habituation", "disengagement") if name not in moderators]
    controls = np.column_stack([moderation, trial[of_state]])
    design = np.column_stack([controls, (sends - centre)[:, None] * moderation])
    outcome = trial["reward"].to_numpy()

    bread = np.linalg.inv(design.T @ (weight[:, None] * design))
    estimate = bread @ design.T @ (weight * outcome)
    residual = outcome - design @ estimate
    meat = np.zeros_like(bread)
    people = pd.factorize(trial["person"])[0]
    count = people.max() + 1
    for person in range(count):
        rows = people == person
        x, w = design[rows], weight[rows]
        leverage = x @ bread @ (x * w[:, None]).T
        corrected = np.linalg.solve(np.eye(len(x)) - leverage, residual[rows])
        score = x.T @ (w * corrected)
        meat += np.outer(score, score)
    variance = bread @ meat @ bread
    terms = moderation.shape[1]
    error = np.sqrt(np.diag(variance))[-terms:]
    half = t_quantile(count - design.shape[1]) * error
    effect = estimate[-terms:]
    columns = {"effect": effect, "standard_error": error, "low": effect - half, "high": effect + half}
    return pd.DataFrame(columns, index=["message", *moderators])


def t_quantile(df):
    """The 97.5 % quantile of Student's t, by the expansion of Cornish and Fisher."""
    z = 1.959963984540054
    terms = [z, (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96]
    terms.append((3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384)
    return sum(term / df**power for power, term in enumerate(terms))


def exact_effect(trial, parameters):
    """What a message pays more than none in the states of the trial, by the equations of the simulation."""
    habituation = trial["habituation"]
    after = np.minimum(1, habituation + parameters["epsilon_h"])
    # One untailored message, one that fits the context, and one that does not.
    return ((1 - after) * (parameters["rho_1"] + parameters["rho_2"]) / 3).mean()


# %% The effect in the whole trial, and the coverage of small ones
if __name__ == "__main__":
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "jitai.sqlite").resolve()
    experiment = sys.argv[2] if len(sys.argv) > 2 else "trial"
    store = sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)
    trial = pd.read_sql(
        """SELECT d.* FROM arm_summary AS s JOIN decision AS d ON d.job_key = s.job_key
        WHERE s.experiment = ? AND s.agent = 'random' AND d.phase = 'test'""",
        store,
        params=[experiment],
    )
    trial["person"] = trial.groupby(["job_key", "episode"]).ngroup()
    named = pd.read_sql(
        "SELECT name, value FROM parameter WHERE job_key = ?", store, params=[trial["job_key"].iloc[0]]
    )
    parameters = {
        name.removeprefix("environment."): float(value)
        for name, value in named.itertuples(index=False)
        if name in ("environment.epsilon_h", "environment.rho_1", "environment.rho_2")
    }
    exact = exact_effect(trial, parameters)
    whole = wcls(trial[trial["person"] < 1000])
    print(f"exact effect {exact:.2f} steps\n{whole}\n")
    print(wcls(trial[trial["person"] < 1000], ["habituation"]), "\n")
    trials = (trial["person"].max() + 1) // PEOPLE
    held = [
        wcls(trial[trial["person"] // PEOPLE == number]).loc["message"] for number in range(trials)
    ]
    inside = np.mean([row["low"] <= exact <= row["high"] for row in held])
    print(f"{trials} trials of {PEOPLE} people: {100 * inside:.1f} % of the intervals hold the exact effect")
