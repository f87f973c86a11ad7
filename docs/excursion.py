"""The causal excursion effect of a message, by weighted and centred least squares.

    python docs/excursion.py [STORE [EXPERIMENT]]

reads the decisions of the agent `random` of an experiment (`trial` by default) and prints the effect of
sending any message, against none, on the reward of the same step, before what messages cost, with its
95 % interval over people;
then how often the intervals of many small trials, cut from the same decisions, hold the exact effect.

Source: Boruvka, Almirall, Witkiewitz and Murphy, "Assessing time-varying causal effect moderation in
mobile health", Journal of the American Statistical Association 113 (2018), 1112-1121: the estimating
equation of section 5, and its small-sample correction after Mancl and DeRouen (2001).
"""

# %% The decisions of the trial
import json
import sqlite3
import sys
from pathlib import Path

import numpy as np
import pandas as pd

PEOPLE = 40  # in a small trial


def probability_of_sending(trial):
    """The probability with which each decision sends a message, whichever.

    Without `action_probabilities`, only the probability of the action taken is known. It is enough if
    there is a single kind of message.
    """
    sends, taken = trial["action"] > 0, trial["action_probability"]
    known = trial["action_probabilities"].notna()
    of_one = np.where(sends, taken, 1 - taken)
    if trial.loc[sends & ~known, "action"].nunique() > 1:
        raise SystemExit(
            "this trial has several messages and no `action_probabilities`, which jitai records for its own agents"
            " and for programs that report the probability of every action; earlier trials have to run again"
        )
    none = trial["action_probabilities"].map(lambda text: json.loads(text)[0], na_action="ignore")
    return np.where(known, 1 - none.astype(float), of_one)


def wcls(trial, moderators=()):
    """Effect of sending a message: estimates, standard errors and 95 % intervals, one row per term.

    `trial` has a row per decision with `person`, `action`, `action_probability`,
    `action_probabilities`, `can_send`, `reward` and the moderators. Decisions at which no message could be
    sent do not count. The model of the reward without treatment has the moderators, habituation and
    disengagement risk; the estimate stays consistent if that model is wrong, because the weights make the
    treatment independent of the state: each decision is weighted with p̃ / p if it sends and
    (1 - p̃) / (1 - p) if not, where p is its own probability of sending and p̃ the same for all.
    """
    trial = trial[trial["can_send"] == 1]
    sends = (trial["action"] > 0).to_numpy(float)
    randomised = probability_of_sending(trial)
    # Any constant gives a consistent estimate; the mean keeps the weights near 1.
    centre = randomised.mean()
    weight = np.where(sends == 1, centre / randomised, (1 - centre) / (1 - randomised))
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
    """The 97.5 % quantile of Student's t, from the distribution of whole degrees of freedom.

    Source: Abramowitz and Stegun, 1964, 26.7.3 and 26.7.4.
    """
    odd = df % 2
    steps = np.arange(1 + odd, df - 1, 2)
    # The factors of successive powers of the squared cosine.
    factors = np.cumprod(np.concatenate([[1.0], steps / (steps + 1)]))[: (df - odd) // 2]

    def between(angle):
        cosine = np.cos(angle)
        powers = cosine ** (2 * np.arange(len(factors)) + odd)
        tail = np.sin(angle) * np.sum(factors * powers)
        return 2 / np.pi * (angle + tail) if odd else tail

    low, high = 0.0, np.pi / 2
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if between(middle) < 0.95 else (low, middle)
    return np.sqrt(df) * np.tan(low)


def exact_effect(trial, parameters):
    """What a message pays more than none in the states of the trial, by the equations of the simulation.

    The message is the one that the trial would have drawn in this state, on average; where only the
    probability of the action taken is known, it is the one that was sent.
    """
    trial = trial[trial["can_send"] == 1]
    epsilon_h, rho_1, rho_2, rho_3 = (parameters[name] for name in ("epsilon_h", "rho_1", "rho_2", "rho_3"))
    after = np.minimum(1, trial["habituation"] + epsilon_h)
    is_one = trial["context"] == 1
    pays = pd.DataFrame(
        {1: rho_1, 2: np.where(is_one, rho_3, rho_2), 3: np.where(is_one, rho_2, rho_3)},
        index=trial.index,
    ).mul(1 - after, axis=0)
    known = trial["action_probabilities"].notna()
    shares = pd.DataFrame(0.0, index=trial.index, columns=[1, 2, 3])
    if known.any():
        drawn = np.vstack(trial.loc[known, "action_probabilities"].map(json.loads))[:, 1:]
        shares[known] = drawn / drawn.sum(axis=1, keepdims=True)
    sent = ~known & (trial["action"] > 0)
    for action in shares:
        shares.loc[sent & (trial["action"] == action), action] = 1.0
    weight = np.where(known, 1.0, np.where(sent, 1 / trial["action_probability"], 0.0))
    return np.average((shares * pays).sum(axis=1), weights=weight)


# %% The effect in the whole trial, and the coverage of small ones
if __name__ == "__main__":
    path = Path(sys.argv[1] if len(sys.argv) > 1 else "jitai.sqlite").resolve()
    experiment = sys.argv[2] if len(sys.argv) > 2 else "trial"
    if not path.is_file():
        raise SystemExit(f"there is no store {path}")
    store = sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)
    trial = pd.read_sql(
        """SELECT d.* FROM arm_summary AS s JOIN decision AS d ON d.job_key = s.job_key
        WHERE s.experiment = ? AND s.agent = 'random' AND d.phase = 'test'""",
        store,
        params=[experiment],
    )
    if trial.empty:
        raise SystemExit(f"{path} has no recorded test decisions of the agent `random` of the experiment {experiment!r}")
    trial["person"] = trial.groupby(["job_key", "episode"]).ngroup()
    # Decisions of earlier versions do not say whether the budget was spent.
    trial["can_send"] = trial["can_send"].fillna(trial["available"])
    named = pd.read_sql(
        "SELECT name, value FROM parameter WHERE job_key = ?", store, params=[trial["job_key"].iloc[0]]
    )
    parameters = {
        name.removeprefix("environment."): float(value)
        for name, value in named.itertuples(index=False)
        if name.removeprefix("environment.") in ("epsilon_h", "rho_1", "rho_2", "rho_3")
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
