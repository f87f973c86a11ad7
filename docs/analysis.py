"""The questions of analysis.md, answered with pandas.

    python docs/analysis.py [STORE [FOLDER [EXPERIMENT]]]

prints the answers about a store (jitai.sqlite by default), or writes them into FOLDER as 1.csv,
2.csv and so on; - as FOLDER prints them. Every cell stands on the first one alone, to be copied into
a notebook. The questions are about EXPERIMENT, or else about the experiments of the documents,
of which the quickstart has to be complete. Questions that do not concern an experiment, such as the
gain of scenarios that it lacks, stay without an answer.
"""

# %% The views of the store, and the completed runs of an experiment
import sqlite3
import sys
from pathlib import Path

import numpy as np
import pandas as pd

# The experiment that all questions are about, if it is not that of the documents.
named = sys.argv[3] if len(sys.argv) > 3 else None
path = Path(sys.argv[1] if len(sys.argv) > 1 else "jitai.sqlite").resolve()
# Read-only: a misspelt path is an error, and not a new file.
store = sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)
runs = pd.read_sql("SELECT * FROM run_summary", store)
parameters = pd.read_sql("SELECT * FROM parameter", store)
metrics = pd.read_sql("SELECT * FROM metric", store)
curves = pd.read_sql("SELECT * FROM learning_curve", store)
episodes = pd.read_sql("SELECT * FROM evaluation_episode", store)
choices = pd.read_sql("SELECT * FROM action_choice", store)
jobs = pd.read_sql("SELECT * FROM arm_summary", store)
decisions = pd.read_sql("SELECT * FROM decision", store)

ARM = ["agent", "scenario", "label"]
completed = runs[runs["status"] == "completed"]
with_results = jobs[jobs["mean_return"].notna()]
quickstart = with_results[with_results["experiment"] == (named or "quickstart")]
if quickstart.empty:
    raise SystemExit(f"{path} has no results of the experiment {named or 'quickstart'!r}")
# Every environment parameter of a job, as one text.
environment = parameters[parameters["name"].str.startswith("environment.")].sort_values("name")
environment = environment.assign(text=environment["name"] + "=" + environment["value"].astype(str))
environment = environment.groupby("job_key")["text"].agg(" ".join).rename("environment")
answers = {}

# %% 1. What did each arm reach, over its seeds?
answers[1] = quickstart.groupby(ARM)["mean_return"].agg(
    seeds="count", mean="mean", sd="std", lowest="min", highest="max"
)

# %% 2. How much do probabilities gain over the most likely context (P-H-D minus L-H-D)?
means = quickstart.pivot_table("mean_return", ["agent", "label"], "scenario")
has_both = {"P-H-D", "L-H-D"} <= set(means)
if has_both:
    answers[2] = (means["P-H-D"] - means["L-H-D"]).rename("gain")

# %% 3. Does every seed show the gain?
by_seed = quickstart.pivot(
    index=["agent", "label", "seed"], columns="scenario", values="mean_return"
)
if has_both:
    answers[3] = (by_seed["P-H-D"] - by_seed["L-H-D"]).rename("gain")

# %% 4. Is the gain more than chance?
# scipy.stats.ttest_rel is the same test, and has the p value.
if has_both:
    gains = answers[3].dropna().groupby(["agent", "label"])
    answers[4] = pd.DataFrame(
        {
            "gain": gains.mean(),
            "standard_error": gains.sem(),
            "t": gains.mean() / gains.sem(),
            "degrees_of_freedom": gains.count() - 1,
        }
    )

# %% 5. What share of the best arm's return does each arm reach?
arm = quickstart.join(environment, on="job_key").groupby(["environment", *ARM])
mean = arm["mean_return"].mean().to_frame("mean")
mean["share_of_best"] = mean["mean"] / mean.groupby("environment")["mean"].transform("max")
answers[5] = mean.droplevel("environment").sort_values(["label", "mean"], ascending=[True, False])

# %% 6. Which run was best, and which worst?
columns = [*ARM, "seed", "mean_return", "disengagement_rate", "job_key"]
answers[6] = quickstart.sort_values("mean_return", ascending=False)[columns].set_index("job_key")

# %% 7. What return do the least fortunate people get?
tested = quickstart[["job_key", *ARM]].merge(episodes, on="job_key")
quartile = lambda returns: np.quantile(returns, 0.25, method="inverted_cdf")
median = lambda returns: np.quantile(returns, 0.5, method="inverted_cdf")
answers[7] = tested.groupby(ARM)["total_reward"].agg(lower_quartile=quartile, median=median)

# %% 8. How often do episodes end in disengagement, and what does that cost in messages?
messages = quickstart["message_rate"] * quickstart["mean_length"]
asked = ["disengagement_rate", "mean_length", "messages_per_episode"]
answers[8] = quickstart.assign(messages_per_episode=messages).groupby(ARM)[asked].mean()

# %% 9. When do people disengage?
tested = quickstart[["job_key", *ARM]].merge(episodes, on="job_key")
answers[9] = (
    tested[tested["disengaged"] == 1]
    .rename(columns={"length": "step"})
    .groupby([*ARM, "step"])
    .size()
    .rename("disengagements")
)

# %% 10. Which actions are chosen, by how sure the inference is?
chosen = quickstart[["job_key", *ARM]].merge(choices, on="job_key")
steps = chosen.groupby([*ARM, "p_low", "p_high", "action"])["count"].sum().to_frame("steps")
steps["share"] = steps["steps"] / steps.groupby([*ARM, "p_low"])["steps"].transform("sum")
answers[10] = steps

# %% 11. How many messages are sent, and how many tailored messages fit the context?
chosen = quickstart[["job_key", *ARM]].merge(choices, on="job_key")
counts = chosen[ARM].assign(
    all=chosen["count"],
    sent=chosen["count"].where(chosen["action"] > 0),
    tailored=chosen["count"].where(chosen["action"] >= 2),
    fitting=chosen["count"].where(chosen["action"] == chosen["context"] + 2),
)
counts = counts.groupby(ARM).sum(min_count=1)
answers[11] = pd.DataFrame(
    {
        "message_rate": counts["sent"] / counts["all"],
        "share_that_fits": counts["fitting"] / counts["tailored"],
    }
)

# %% 12. What does the learning curve look like, smoothed?
returns = curves[curves["metric"] == "mean_return"].sort_values("episode")
learning = quickstart[["job_key", *ARM, "seed"]].merge(returns, on="job_key")
learning["moving_mean_return"] = learning.groupby([*ARM, "seed"])["value"].transform(
    lambda values: values.rolling(10, min_periods=1).mean()
)
answers[12] = learning.set_index([*ARM, "seed", "episode"])["moving_mean_return"]

# %% 13. After how many episodes is an agent within 5 % of its final return?
returns = curves[curves["metric"] == "mean_return"].sort_values("episode")
learning = quickstart[["job_key", *ARM, "seed"]].merge(returns, on="job_key")
by_run = learning.groupby([*ARM, "seed"])
learning["smoothed"] = by_run["value"].transform(
    lambda values: values.rolling(10, min_periods=1).mean()
)
ending = by_run["smoothed"].transform("last")
answers[13] = (
    learning[learning["smoothed"] >= 0.95 * ending]
    .groupby([*ARM, "seed"])["episode"]
    .min()
    .rename("episodes")
)

# %% 14. How does the gain depend on the disengagement dynamics?
swept = (
    parameters[parameters["name"].isin(["environment.delta_d", "environment.epsilon_d"])]
    .pivot(index="job_key", columns="name", values="value")
    .rename(columns=lambda name: name.removeprefix("environment."))
    .astype(float)
)
dynamics = with_results[with_results["experiment"] == (named or "disengagement")].join(swept, on="job_key")
axes = ["delta_d", "epsilon_d"]
if set(axes) <= set(dynamics):
    means = dynamics.pivot_table("mean_return", ["agent", "label", *axes], "scenario")
if set(axes) <= set(dynamics) and {"P-H-D", "L-H-D"} <= set(means):
    answers[14] = (means["P-H-D"] - means["L-H-D"]).rename("gain")

# %% 15. What were the parameters of a job?
job = quickstart.query("agent == 'dqn' and scenario == 'P-H-D' and seed == 1").sort_values("label")
if job.empty:
    job = quickstart.sort_values("job_key")
job_key = job["job_key"].iloc[0]
answers[15] = parameters[parameters["job_key"] == job_key].set_index("name")[["value"]]

# %% 16. Which parameters does an experiment vary, and over which values?
held = runs[runs["experiment"] == (named or "disengagement")].merge(parameters, on="job_key")
varied = held.groupby(["agent", "name"])["value"]
# Values of one parameter are of one type, but the column is not.
varied = varied.agg(different="nunique", lowest=lambda v: min(v), highest=lambda v: max(v))
answers[16] = varied[varied["different"] > 1]

# %% 17. Which runs failed?
columns = ["experiment", "agent", "scenario", "sigma", "seed", "attempt"]
columns += ["failure_kind", "failure_message", "job_key"]
failed = runs[runs["status"] == "failed"].sort_values("started_at")
answers[17] = failed[columns].set_index("experiment")

# %% 18. How many seeds does each arm have, and how many are missing?
seeds = jobs.groupby(["experiment", *ARM])["mean_return"].agg(seeds="size", completed="count")
seeds["without_results"] = seeds["seeds"] - seeds["completed"]
answers[18] = seeds.sort_values("without_results", ascending=False, kind="stable")

# %% 19. How long does a job of each algorithm take?
algorithm = parameters[parameters["name"] == "agent.algorithm"].set_index("job_key")["value"]
seconds = completed.drop_duplicates("job_key").set_index("job_key")["wall_seconds"]
answers[19] = seconds.groupby(algorithm.rename("algorithm")).agg(
    runs="count", mean_seconds="mean", longest="max", hours_in_all=lambda s: s.sum() / 3600
)

# %% 20. Which experiments share jobs?
held = runs[["experiment", "job_key"]].drop_duplicates()
pairs = held.merge(held.rename(columns={"experiment": "shares_with"}), on="job_key")
pairs = pairs[pairs["shares_with"] > pairs["experiment"]]
answers[20] = pairs.groupby(["experiment", "shares_with"]).size().rename("jobs")

# %% 21. Which version of jitai made which results?
answers[21] = completed.groupby(["experiment", "code_version"]).agg(
    runs=("job_key", "size"), first=("started_at", "min"), last=("ended_at", "max")
)

# %% 22. Which jobs needed more than one attempt?
attempts = runs.drop(columns="experiment").drop_duplicates().sort_values("attempt")
attempts = attempts.groupby(["job_key", "agent", "scenario", "sigma", "seed"])["status"].agg(
    attempts="size", what_became_of_them=", ".join
)
answers[22] = attempts[attempts["attempts"] > 1].reset_index("job_key", drop=True)

# %% 23. Does the return agree with the episodes it was computed from?
again = episodes.groupby("job_key")["total_reward"].mean()
difference = completed["mean_return"] - completed["job_key"].map(again)
answers[23] = difference.abs().agg(["max"]).rename("largest_difference")

# %% 24. What share of the optimum does each agent reach?
both = with_results[with_results["experiment"].isin([named] if named else ["quickstart", "reference"])]
mean = both.join(environment, on="job_key").groupby(["environment", *ARM])["mean_return"].mean()
mean = mean.reset_index()
best = mean[mean["agent"] == "optimal"]
if not best.empty:
    best = best.set_index(["environment", "scenario"])["mean_return"].rename("best")
    shares = mean.join(best, on=["environment", "scenario"], how="inner")
    shares["share"] = shares["mean_return"] / shares["best"]
    answers[24] = shares.set_index(ARM)["share"]

# The trial of decisions.md: what was recorded of every step, and the arm that it belongs to.
trial = jobs.loc[jobs["experiment"] == (named or "trial"), ["job_key", *ARM, "seed"]]
trial = trial.merge(decisions[decisions["phase"] == "test"], on="job_key")

# %% 25. How many messages are sent at each level of habituation and disengagement risk?
free = trial[trial["can_send"] == 1]
levels = free.assign(
    habituation_from=np.minimum(3, np.floor(4 * free["habituation"])) / 4,
    disengagement_from=np.minimum(3, np.floor(4 * free["disengagement"])) / 4,
    sends=free["action"] > 0,
)
answers[25] = levels.groupby([*ARM, "habituation_from", "disengagement_from"])["sends"].agg(
    steps="size", message_rate="mean"
)

# %% 26. What does a message change immediately?
randomised = trial[(trial["agent"] == "random") & (trial["can_send"] == 1)]
weight = 1 / randomised["action_probability"]
weighted = randomised[["label", "context", "action"]].assign(
    weight=weight, reward=weight * randomised["reward"]
)
if not randomised.empty:
    sums = weighted.groupby(["label", "context", "action"]).sum()
    reward = (sums["reward"] / sums["weight"]).unstack("action")
    answers[26] = reward[[1, 2, 3]].sub(reward[0], axis=0).stack().rename("effect")

# %% 27. What would another policy have earned in the first three steps?
first = trial[trial["step"] < 3].sort_values(["job_key", "episode", "step"])
randomised = first[first["agent"] == "random"]
if not randomised.empty:
    follows = randomised["action"] == randomised["likely_context"] + 2
    follows |= randomised["can_send"] == 0
    factor = follows / randomised["action_probability"]
    weight = factor.groupby([randomised["job_key"], randomised["episode"]]).cumprod()
    weighted = randomised.assign(value=weight * randomised["reward"])
    estimated = weighted.groupby(["label", "job_key", "episode"])["value"].sum().groupby("label")
    tailored = first[first["agent"] == "tailored"]
    actual = tailored.groupby(["label", "job_key", "episode"])["reward"].sum()
    answers[27] = pd.DataFrame(
        {
            "estimated": estimated.mean(),
            "standard_error": estimated.std() / estimated.count() ** 0.5,
            "actual": actual.groupby("label").mean(),
        }
    )

# %% Printed, or written as files
if __name__ == "__main__":
    for question, answer in answers.items():
        if len(sys.argv) > 2 and sys.argv[2] != "-":
            folder = Path(sys.argv[2])
            folder.mkdir(parents=True, exist_ok=True)
            answer.to_csv(folder / f"{question}.csv")
        else:
            print(f"\n{question}.\n{answer}")
