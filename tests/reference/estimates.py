"""Writes estimates.json: effects in small trials, estimated by statsmodels and by R's geepack.

    pip install statsmodels==0.15.0 pandas numpy==2.4.6
    apt-get install r-cran-geepack
    python estimates.py       # writes estimates.json beside this file

Weighted and centred least squares are a GEE with an independent working correlation, Gaussian outcome, and the
weights of Boruvka et al. (2018). statsmodels' `bias_reduced` covariance is the correction of Mancl and DeRouen;
geepack gives the covariance without a correction. Decisions come from NumPy's generator with a fixed seed and are
written beside the results, so that the file is self-contained.
"""

import json
import platform
import subprocess
import tempfile
from pathlib import Path

import numpy
import pandas
import statsmodels
import statsmodels.api

PEOPLE, DECISIONS = 20, 12
NUMERATOR = 0.4


def probabilities(kind, step, state, generator):
    """The probabilities of three actions, of which action 0 sends nothing."""
    send = {
        "constant": lambda: 0.4,
        "moderated": lambda: 0.2 + 0.5 * state["mood"],
        # As an algorithm that learns: it drifts, and differs between people.
        "time_varying": lambda: min(0.9, max(0.1, 0.2 + 0.04 * step + 0.1 * generator.normal())),
    }[kind]()
    first = 0.3 + 0.4 * state["load"] / 4
    one, other = round(send * first, 3), round(send * (1 - first), 3)
    return [round(1 - one - other, 3), one, other]


def trial(kind, generator):
    rows = []
    for person in range(1, PEOPLE + 1):
        level, load = generator.normal(), 1.0
        for step in range(DECISIONS):
            state = {"mood": round(float(generator.random()), 3), "load": load}
            can_send = bool(generator.random() < 0.85)
            drawn = probabilities(kind, step, state, generator)
            action = int(generator.choice(3, p=drawn)) if can_send else 0
            effect = [0, 1 + state["mood"], 0.5 - 0.2 * load][action]
            reward = 10 + level + 2 * state["mood"] - 0.5 * load + effect + generator.normal()
            rows.append(
                {"person": person, "step": step, "can_send": can_send, "action": action, "probabilities": drawn}
                | {"state": list(state.values()), "reward": round(float(reward), 3)}
            )
            load = round(float(min(4.0, 0.8 * load + (action > 0))), 3)
    return rows


def design(rows, control, moderators, treatment):
    """The decisions that count, as outcome, design, weight and person."""
    names = {"mood": 0, "load": 1}
    value = lambda row, name: row["step"] if name == "step" else row["state"][names[name]]
    messages = {"any message": [None], "each message": [1, 2], 2: [2]}[treatment]
    outcome, matrix, weights, people = [], [], [], []
    for row in rows:
        action, drawn = row["action"], row["probabilities"]
        if not row["can_send"] or (treatment == 2 and action == 1):
            continue
        if action == 0:
            weight = (1 - NUMERATOR) / drawn[0]
        elif treatment == "any message":
            weight = NUMERATOR / (drawn[1] + drawn[2])
        else:
            weight = NUMERATOR / len(messages) / drawn[action]
        line = [1.0, *(value(row, name) for name in control)]
        for message in messages:
            treated = action > 0 if message is None else action == message
            centred = treated - NUMERATOR / len(messages)
            line += [centred, *(centred * value(row, name) for name in moderators)]
        outcome.append(row["reward"])
        matrix.append(line)
        weights.append(weight)
        people.append(row["person"])
    return numpy.array(outcome), numpy.array(matrix), numpy.array(weights), numpy.array(people)


def by_statsmodels(outcome, matrix, weights, people):
    # `bias_reduced` takes one weight per person, so rows are multiplied by the roots of their weights instead.
    root = numpy.sqrt(weights)
    model = statsmodels.api.GEE(
        root * outcome, root[:, None] * matrix, groups=people,
        family=statsmodels.api.families.Gaussian(), cov_struct=statsmodels.api.cov_struct.Independence(),
    )
    fit = model.fit(cov_type="bias_reduced", ctol=1e-10)
    return fit.params.tolist(), fit.bse.tolist()


def by_geepack(outcome, matrix, weights, people):
    with tempfile.TemporaryDirectory() as folder:
        table = pandas.DataFrame(matrix, columns=[f"x{i}" for i in range(matrix.shape[1])])
        table = table.assign(y=outcome, w=weights, id=people)
        table.to_csv(f"{folder}/data.csv", index=False, float_format="%.17g")
        terms = " + ".join(name for name in table if name.startswith("x"))
        script = f"""
            data <- read.csv("{folder}/data.csv")
            fit <- geepack::geeglm(y ~ 0 + {terms}, data = data, id = data$id, weights = data$w, corstr = "independence",
                control = geepack::geese.control(epsilon = 1e-13, maxit = 100))
            cat(format(c(coef(fit), sqrt(diag(vcov(fit)))), digits = 17, scientific = TRUE))
        """
        done = subprocess.run(["Rscript", "-e", script], capture_output=True, text=True, check=True)
    numbers = [float(word) for word in done.stdout.split()]
    return numbers[: len(numbers) // 2], numbers[len(numbers) // 2 :]


def version(code):
    done = subprocess.run(["Rscript", "-e", f"cat({code})"], capture_output=True, text=True, check=True)
    return done.stdout


MODELS = [
    ([], [], "any message"),
    (["mood", "load"], [], "any message"),
    (["mood", "load", "step"], ["mood", "step"], "any message"),
    (["load"], ["mood"], 2),
    (["mood", "load"], ["mood"], "each message"),
]

generator = numpy.random.default_rng(20180614)
cases = []
for kind in ["constant", "moderated", "time_varying"]:
    rows = trial(kind, generator)
    models = []
    for control, moderators, treatment in MODELS:
        data = design(rows, control, moderators, treatment)
        first = 1 + len(control)
        estimate, error = by_statsmodels(*data)
        other_estimate, other_error = by_geepack(*data)
        models.append(
            {"control": control, "moderators": moderators, "treatment": treatment}
            | {"estimate": estimate[first:], "standard_error": error[first:]}
            | {"geepack_estimate": other_estimate[first:], "uncorrected_error": other_error[first:]}
        )
    cases.append({"probabilities": kind, "decisions": rows, "models": models})

versions = {
    "python": platform.python_version(), "numpy": numpy.__version__, "statsmodels": statsmodels.__version__,
    "R": version("R.version.string"), "geepack": version('as.character(packageVersion("geepack"))'),
}
result = {"versions": versions, "state": ["mood", "load"], "numerator": NUMERATOR, "cases": cases}
lines = json.dumps(result).replace('{"person"', '\n{"person"').replace('{"control"', '\n{"control"')
Path(__file__).with_name("estimates.json").write_text(lines + "\n")
