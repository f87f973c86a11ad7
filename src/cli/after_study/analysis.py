"""Standard errors that account for an agent that learned from everybody, by the package lifejacket.

jitai wrote this file beside the data of one trial. In an environment of its own:

    pip install "lifejacket==2.0.0" "numpy<2" "jax<0.5"
    python analysis.py

prints the estimates with both standard errors, and leaves the results of the package in the folder `lifejacket`.
"""

import json
from pathlib import Path

import jax
import numpy
import pandas

jax.config.update("jax_enable_x64", True)
from jax import numpy as jnp  # noqa: E402
from jax.scipy.stats import norm  # noqa: E402
from lifejacket.post_deployment_analysis import analyze_dataset  # noqa: E402

FOLDER = Path(__file__).resolve().parent
TRIAL = json.loads((FOLDER / "trial.json").read_text())
AGENT, ESTIMATE = TRIAL["agent"], TRIAL["estimate"]
SEEN = [f"seen_{number}" for number in range(1, 1 + TRIAL["features"])]
WIDTH, REGRESSIONS = TRIAL["width"], TRIAL["regressions"]
LOWER = numpy.tril_indices(WIDTH)
# Nodes of the trapezoidal rule for the mean of a logistic function of a normal variable.
NODES = numpy.linspace(-8.0, 8.0, 2001)
WEIGHTS = numpy.exp(-NODES**2 / 2) / numpy.exp(-NODES**2 / 2).sum()


def unpacked(beta):
    """The means and the precisions of all regressions: the parameters of an update are the means of a regression and the
    lower triangle of its precision, row by row, one regression behind the other."""
    parts = beta.reshape(REGRESSIONS, WIDTH + LOWER[0].size)
    lower = jnp.zeros((REGRESSIONS, WIDTH, WIDTH)).at[:, LOWER[0], LOWER[1]].set(parts[:, WIDTH:])
    return parts[:, :WIDTH], lower + jnp.swapaxes(jnp.tril(lower, -1), 1, 2)


def action_probability(beta, features):
    """The probability of action 1."""
    means, precisions = unpacked(beta)
    if AGENT["action_centring"]:
        row = jnp.concatenate([jnp.zeros(WIDTH - features.size), features])
        effect, variance = row @ means[0], row @ jnp.linalg.solve(precisions[0], row)
    else:
        effect = features @ (means[1] - means[0])
        variance = sum(features @ jnp.linalg.solve(one, features) for one in precisions)
    effect = effect + AGENT["bias"]
    if AGENT["allocation"] == "logistic":
        inner = AGENT["slope"] * (effect + jnp.sqrt(variance) * NODES) - AGENT["log_odds"]
        mean = jnp.sum(WEIGHTS / (1 + jnp.exp(-inner)))
        share = AGENT["lower"] + (AGENT["upper"] - AGENT["lower"]) * mean
    else:
        share = norm.cdf(effect / jnp.sqrt(variance))
    return AGENT["pi_min"] + (1 - 2 * AGENT["pi_min"]) * share


def update(beta, features, actions, rewards, probabilities, times, people):
    """The part of a person in the equations that the parameters of an update solve."""
    means, precisions = unpacked(beta)
    actions, rewards, probabilities = (one.reshape(-1, 1) for one in (actions, rewards, probabilities))
    if AGENT["action_centring"]:
        rows = [jnp.hstack([features, probabilities * features, (actions - probabilities) * features])]
    else:
        rows = [features * (actions == action) for action in (0, 1)]
    parts = []
    for row, mean, precision, prior_mean, prior in zip(
        rows, means, precisions, numpy.array(AGENT["prior_means"]), numpy.array(AGENT["prior_precisions"])
    ):
        residuals = rewards.reshape(-1) - row @ mean
        of_means = row.T @ residuals / AGENT["noise_variance"] - prior * (mean - prior_mean) / people
        of_precision = row.T @ row / AGENT["noise_variance"] + (jnp.diag(prior) - precision) / people
        parts += [of_means, of_precision[LOWER]]
    return jnp.concatenate(parts)


def wcls_rows(frame):
    """The rows of weighted and centred least squares, their weights, and the outcomes; `frame` is a mapping of columns."""
    action, probability = frame["action"], frame["probability"]
    share = ESTIMATE["numerator"]
    control = [jnp.ones_like(action)] + [frame[f"x_{name}"] for name in ESTIMATE["control"]]
    effect = [jnp.ones_like(action)] + [frame[f"x_{name}"] for name in ESTIMATE["moderators"]]
    rows = jnp.stack(control + [(action - share) * one for one in effect], axis=1)
    weights = jnp.where(action == 1, share / probability, (1 - share) / (1 - probability))
    return rows, weights, frame["reward"]


COLUMNS = ["action", "probability", "reward"]
COLUMNS += [f"x_{name}" for name in dict.fromkeys(ESTIMATE["control"] + ESTIMATE["moderators"])]


def scores(theta, *values):
    rows, weights, outcomes = wcls_rows({name: one.reshape(-1) for name, one in zip(COLUMNS, values)})
    return rows.T @ (weights * (outcomes - rows @ theta))


# The package finds the columns by the names of the parameters.
exec(f"def inference(theta, {', '.join(COLUMNS)}):\n    return scores(theta, {', '.join(COLUMNS)})")


def theta_of(frame):
    active = frame[frame.in_study == 1]
    rows, weights, outcomes = wcls_rows({name: jnp.array(active[name].to_numpy(float)) for name in COLUMNS})
    weighted = rows * weights[:, None]
    return jnp.linalg.solve(weighted.T @ rows, weighted.T @ outcomes)


def expanded(seen):
    """The features of the agent, \\[decisions, features\\]."""
    columns = [numpy.ones(len(seen)), *seen.T]
    if AGENT["features"] == "interactions":
        columns += [a * b for at, a in enumerate(seen.T) for b in seen.T[at + 1 :]]
    return numpy.stack(columns, axis=1)


def parameters():
    """The parameters of every update."""
    found = {}
    for number, rows in pandas.read_csv(FOLDER / "parameters.csv").groupby("policy_num"):
        parts = []
        for _, one in rows.groupby("regression"):
            values = one.value.to_numpy()
            packed, information = values[:-WIDTH], values[-WIDTH:]
            precision = numpy.zeros((WIDTH, WIDTH))
            precision[LOWER] = packed
            precision += numpy.tril(precision, -1).T
            parts += [numpy.linalg.solve(precision, information), packed]
        found[int(number)] = jnp.array(numpy.concatenate(parts))
    return found


def main():
    frame = pandas.read_csv(FOLDER / "decisions.csv")
    betas = parameters()
    features = expanded(frame[SEEN].to_numpy())
    # Before the first update the prior decides.
    prior = [
        numpy.concatenate([mean, numpy.diag(precision)[LOWER]])
        for mean, precision in zip(AGENT["prior_means"], AGENT["prior_precisions"])
    ]
    betas[0] = jnp.array(numpy.concatenate(prior))
    chosen = {}
    for place, row in enumerate(frame.itertuples()):
        arguments = (betas[row.policy_num], jnp.array(features[place])) if row.in_study else ()
        chosen.setdefault(row.calendar_t, {})[row.person] = arguments
    updates = {}
    for number, counted in pandas.read_csv(FOLDER / "updates.csv").groupby("policy_num"):
        before = dict(zip(counted.person, counted.before))
        data = {
            person: numpy.flatnonzero(
                (frame.person == person) & (frame.in_study == 1) & (frame.seen_outcome == 1) & (frame.calendar_t < until)
            )
            for person, until in before.items()
        }
        people = sum(one.size > 0 for one in data.values())
        updates[int(number)] = {}
        for person in frame.person.unique():
            own = data.get(person, numpy.array([], int))
            rows = frame.iloc[own]
            arrays = [features[own], rows.action, rows.learned, rows.probability]
            arguments = (betas[int(number)], *(jnp.array(numpy.array(one, float)) for one in arrays))
            arguments += (jnp.array(rows.calendar_t.to_numpy()), float(people))
            updates[int(number)][person] = arguments if own.size else ()
    centred = AGENT["action_centring"]
    (FOLDER / "lifejacket").mkdir(exist_ok=True)
    result = analyze_dataset(
        output_dir=FOLDER / "lifejacket",
        analysis_df=frame,
        action_prob_func=action_probability,
        action_prob_func_args=chosen,
        action_prob_func_args_beta_index=0,
        alg_update_func=update,
        alg_update_func_type="estimating",
        alg_update_func_args=updates,
        alg_update_func_args_beta_index=0,
        alg_update_func_args_action_prob_index=4 if centred else -1,
        alg_update_func_args_action_prob_times_index=5 if centred else -1,
        alg_update_func_args_previous_betas_index=-1,
        inference_func=inference,  # noqa: F821
        inference_func_type="estimating",
        inference_func_args_theta_index=0,
        theta_calculation_func=theta_of,
        active_col_name="in_study",
        action_col_name="action",
        policy_num_col_name="policy_num",
        calendar_t_col_name="calendar_t",
        subject_id_col_name="person",
        action_prob_col_name="probability",
        reward_col_name="reward",
        suppress_interactive_data_checks=True,
        suppress_all_data_checks=False,
        form_adjusted_meat_adjustments_explicitly=False,
        run_diagnostics=False,
    )
    (FOLDER / "result.json").write_text(json.dumps(summary(result), indent=2))
    print((FOLDER / "result.json").read_text())


def summary(result):
    """The coefficients with both standard errors."""
    terms = ["1", *ESTIMATE["control"]] + [f"effect: {name}" for name in ["1", *ESTIMATE["moderators"]]]
    errors = {
        name: numpy.sqrt(numpy.diag(numpy.asarray(result[f"{name}_sandwich_var_estimate"])))
        for name in ("adjusted", "classical")
    }
    estimates = numpy.asarray(result["theta_est"])
    return [
        {"term": term, "estimate": float(estimate), "after_study": float(after), "nominal": float(nominal)}
        for term, estimate, after, nominal in zip(terms, estimates, errors["adjusted"], errors["classical"])
    ]


if __name__ == "__main__":
    main()
