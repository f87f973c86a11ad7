"""Turns the parameters of the published test beds of Oralytics into files of people, without identifiers.

    git clone https://github.com/StatisticalReinforcementLearningLab/oralytics_algorithm_design
    git clone https://github.com/StatisticalReinforcementLearningLab/oralytics-post-deployment-analysis
    python3 people.py oralytics_algorithm_design oralytics-post-deployment-analysis

writes v2.csv, v2_daily.csv, v3.csv, v3_daily.csv and v4.csv into this folder, and which people the published trials
had: v2_trials.csv, v3_trials.csv and v4_trial.csv; v3_chance.csv repeats those of V3 five times. The second clone is needed for V4 alone. It needs NumPy. The files
have the terms of use of their repositories (GPL-3.0); do not share them with your manifests. Cite Trella et al.,
"Oralytics Reinforcement Learning Algorithm", arXiv 2406.13127, for V2 and V3, and Trella et al., "A Deployed Online
Reinforcement Learning Algorithm In An Oral Health Clinical Trial", arXiv 2409.02069, for V4. The files were last changed in the commits dd9947aa and f7154719.
"""

import csv
import datetime
import hashlib
import io
import pathlib
import pickle
import sys

DIGESTS = {
    "sim_env_data/stat_user_models.csv": "ea325cff4133451871fc8b7b5ab4db304389d054ab64de8cd8fa3f46b4fc91f3",
    "sim_env_data/non_stat_user_models.csv": "e8ebbf1cce641a417a06f1fcc5fcbf344e6344cd30c5c03051e4dfc01296d523",
    "sim_env_data/less_small_stat_user_effect_sizes.p": "7afb439f1b4bb0ca487786caada7251a757851b9cc5bc6c81a70709e46f7d45a",
    "sim_env_data/less_small_non_stat_user_effect_sizes.p": "9281edfa500f914881f0aeaacf21892189d0cf09020d5f437665d37f99b77dec",
    "sim_env_data/smaller_stat_user_effect_sizes.p": "84500dd02ef0674c35fa2813a00efa62136b983b3fd6c7805d949754d357c8d6",
    "sim_env_data/smaller_non_stat_user_effect_sizes.p": "b31aba8718ab4073031c7022b05de2e9088ec5f68f0f80c00f451eb3ee672ef1",
    "sim_env_data/v3_stat_zip_model_params.csv": "9eec9acae8f77eef7a6295955c2ea52473b5eebf7da4a966ddcb3729db302ea3",
    "sim_env_data/v3_non_stat_zip_model_params.csv": "912f5c8119f19dd419d47a5b793efefecb99858d57aafed33bb7f14161e92b0b",
    "sim_env_data/v3_app_open_prob.csv": "b21a5af1a0c1ca12bc36e961d33392dbd503e46f18949bad887e27426ce15cb9",
    "sim_env_data/v4_non_stat_zip_model_params.csv": "daaeed991275252ae3d76b9bfa7fb9e910f45bd8c54e51e24d57ef5763a40e87",
    "sim_env_data/v4_app_open_prob.csv": "ea022b85d8a09d8b6982c59a44e8b0c0f173c73d4fc115cc6a0bae1a99192413",
    "sim_env_data/v4_start_end_dates.csv": "f4151b868b962b11b29a3aeeebbbd142a94404ad4c94ec362207603df83d9516",
}


def read(folder, name, digests):
    """A published file, whose name in its repository is a key of ``digests``."""
    path = pathlib.Path(folder) / name
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    if digest != digests[name]:
        # A pickle can run any code, so that another one is not opened.
        sys.exit(f"{path} is not the published file: its SHA-256 is {digest}, expected {digests[name]}")
    return content


def table(folder, name):
    return list(csv.DictReader(io.StringIO(read(folder, f"sim_env_data/{name}", DIGESTS).decode())))


def write(name, rows):
    with open(pathlib.Path(__file__).parent / name, "w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(rows[0]) + "\n")
        for row in rows:
            file.write(",".join(str(value) for value in row.values()) + "\n")
    print(f"{name}: {len(rows)} rows")


def v2(folder, base, name):
    features = {
        "time_of_day": "Time.of.Day",
        "prior_total": "Prior.Day.Total.Brush.Time.norm",
        "day_n": "Day.in.Study.norm",
        "share": "Proportion.Brushed.In.Past.7.Days",
        "weekend": "Day.Type",
        "1": "Intercept",
    }
    effects = {
        size: pickle.loads(read(folder, f"sim_env_data/{stem}_{base}_user_effect_sizes.p", DIGESTS))
        for size, stem in [("small", "less_small"), ("smaller", "smaller")]
    }
    # Outcomes of the other people do not depend on the day.
    is_daily = base == "non_stat"
    rows = []
    for number, person in enumerate(table(folder, f"{base}_user_models.csv")):
        row = {"person": number}
        for part, suffix in [("bernoulli", "Bern"), ("amount", "Y")]:
            for feature, column in features.items():
                is_there = feature != "day_n" or is_daily
                row[f"{part}_{feature}"] = person[f"{column}.{suffix}"] if is_there else 0
        row["sigma"] = person["Sigma_u"] if person["Model Type"] == "sqrt_norm" else ""
        for size, of_people in effects.items():
            for part, numbers in zip(["bernoulli", "amount"], of_people[person["User"]]):
                shown = [feature for feature in features if feature != "share"]
                known = [feature for feature in shown if feature != "day_n" or is_daily]
                values = dict(zip(known, numbers, strict=True))
                row |= {f"effect_{size}_{part}_{feature}": repr(float(values.get(feature, 0))) for feature in shown}
        rows.append(row)
    write(name, rows)


def later(folder, bed, base, name, dates=None):
    features = {
        "time_of_day": "state_tod",
        "brushing_now": "state_b_bar.norm",
        "dosage": "state_a_bar.norm",
        "app_before": "state_app_engage",
        "weekend": "state_day_type",
        "1": "state_bias",
        "day_n": "state_day_in_study",
    }
    # Outcomes of the other people do not depend on the day.
    is_daily = base == "non_stat"
    opens = {row["user_id"]: row["app_open_prob"] for row in table(folder, f"{bed}_app_open_prob.csv")}
    first = datetime.date(2023, 9, 22)
    rows = []
    for number, person in enumerate(table(folder, f"{bed}_{base}_zip_model_params.csv")):
        row = {"person": number}
        for prefix, kind in [("", "Base"), ("effect_", "Adv")]:
            for part, suffix in [("bernoulli", "Bern"), ("amount", "Poisson")]:
                for feature, column in features.items():
                    is_there = feature != "day_n" or is_daily
                    row[f"{prefix}{part}_{feature}"] = person[f"{column}.{kind}.{suffix}"] if is_there else 0
        row["app_open_probability"] = opens[person["User"]]
        if dates is not None:
            for key in ["start", "end"]:
                day = datetime.date.fromisoformat(dates[person["User"]][f"user_{key}_day"])
                row[f"{key}_day"] = (day - first).days
        rows.append(row)
    write(name, rows)


def trials(name, people, times=1):
    """The people of the published trials 0 to 99, as those of seeds 1 to 100: 70 rows, drawn by NumPy's legacy generator.

    The next hundred seeds repeat them, ``times`` in all.
    """
    import numpy

    with open(pathlib.Path(__file__).parent / name, "w", encoding="utf-8", newline="\n") as file:
        file.write("seed,person,row\n")
        for seed in range(100 * times):
            numpy.random.seed(seed % 100)
            for person, row in enumerate(numpy.random.choice(people, 70)):
                file.write(f"{seed + 1},{person},{row}\n")
    print(f"{name}: {100 * times} trials")


def everybody(name, people):
    """Each person of a trial is the row of the same number, whatever the seed."""
    with open(pathlib.Path(__file__).parent / name, "w", encoding="utf-8", newline="\n") as file:
        file.write("person,row\n")
        file.writelines(f"{person},{person}\n" for person in range(people))
    print(f"{name}: {people} people")


def main():
    if len(sys.argv) not in (2, 3) or not pathlib.Path(sys.argv[1]).is_dir():
        sys.exit(__doc__)
    design = sys.argv[1]
    v2(design, "stat", "v2.csv")
    v2(design, "non_stat", "v2_daily.csv")
    later(design, "v3", "stat", "v3.csv")
    later(design, "v3", "non_stat", "v3_daily.csv")
    trials("v2_trials.csv", 31)
    trials("v3_trials.csv", 9)
    trials("v3_chance.csv", 9, times=5)
    if len(sys.argv) == 3:
        dates = {row["user_id"]: row for row in table(sys.argv[2], "v4_start_end_dates.csv")}
        later(sys.argv[2], "v4", "non_stat", "v4.csv", dates)
        everybody("v4_trial.csv", 72)


if __name__ == "__main__":
    main()
