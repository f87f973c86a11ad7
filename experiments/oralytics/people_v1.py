"""Turns the published numbers of the test bed V1 of Oralytics into files for heat_maps_v1.toml, without identifiers.

    git clone https://github.com/StatisticalReinforcementLearningLab/oralytics_reward_design
    git clone https://github.com/ROBAS-UCLA/ROBAS.3
    python3 people_v1.py oralytics_reward_design ROBAS.3

writes v1.csv, the 13 people, v1_trials.csv, which people the published trials had, and v1_published.csv, the 900 published
tiles, into this folder. It needs NumPy. The first repository is under the GPL-3.0, the second has no licence: do not share
the files with your manifests. Cite Trella et al., "Reward Design For An Online Reinforcement Learning Algorithm Supporting
Oral Self-Care", AAAI 2023, arXiv 2208.07406. The repositories were last changed in the commits 1fec448 and c218129.
"""

import csv
import io
import pathlib
import pickle
import sys

import numpy
from people import read, write

FEATURES = {
    "time_of_day": "Time.of.Day",
    "prior_total": "Prior.Day.Total.Brush.Time.norm",
    "day_n": "Day.in.Study.norm",
    "share": "Proportion.Brushed.In.Past.7.Days",
    "weekend": "Day.Type",
    "1": "Intercept",
}
# Those whose coefficients say how large effects are.
OF_EFFECTS = ["time_of_day", "prior_total", "share", "weekend"]
DIGESTS = {
    "sim_env_data/non_stat_zero_infl_pois_model_params.csv": "3a69e0e5e9a8f356cb2360b5d896b6f218f6587b7a12965395665f202f0a38f6",
    "data/robas_3_data.csv": "91dbd5b8b97f255025e41470e34759b3b3c183bc5d136699e446b81f50b2c44b",
    "figures/LOW_R_AVG_HEATMAP.p": "e20075f5b747bf1f9e83d2ed73ae0999f21e6559ed02a2bec440b1ff73cca00c",
    "figures/LOW_R_25_PERC_HEATMAP.p": "850a04d5ce5daad2ca0dd3748e93d1b2e21d63b2fcf10f5790352f1d36d8aecd",
    "figures/LOW_R_75_PERC_HEATMAP.p": "e953aa4d618e787885bad98f61f73f7ef4fd423656eb55ad3f16364e4dc6be3d",
    "figures/MED_R_AVG_HEATMAP.p": "1a474992b284e0d1b797dbad53bdf4d88838452ebc73d50a4f315ff1871b38ca",
    "figures/MED_R_25_PERC_HEATMAP.p": "3eb44c1b304cf32638373b8c20a323ffc7fafac05764aa71ef095642fe4fe830",
    "figures/MED_R_75_PERC_HEATMAP.p": "e3f4ae3e82a61177d2ea877f89266511f6cf2927e91e026a84826769a1292863",
    "figures/HIGH_R_AVG_HEATMAP.p": "91d1960f04e7d18d85010e3767220bc44b292102043c215f8813527d81a0fa26",
    "figures/HIGH_R_25_PERC_HEATMAP.p": "e3874dcc28add2862d740499d70a9741275d2fbd73f571c07db7656ec75032a2",
    "figures/HIGH_R_75_PERC_HEATMAP.p": "f173108b9c0ef6091f8858b864d4f99a7731a0e3bf524a777d49c9b8f0c6130d",
}
DECISIONS = 140


def table(folder, name):
    return list(csv.DictReader(io.StringIO(read(folder, name, DIGESTS).decode())))


def people(design, robas):
    """The coefficients of each person; effects are normal deviates around the mean size of four coefficients."""
    first_weekends = {}
    rows_of = {}
    for row in table(robas, "data/robas_3_data.csv"):
        index = rows_of.setdefault(row["ROBAS ID"], 0)
        rows_of[row["ROBAS ID"]] += 1
        if float(row["Day Type"]) == 1:
            first_weekends.setdefault(row["ROBAS ID"], index)
    published = table(design, "sim_env_data/non_stat_zero_infl_pois_model_params.csv")
    sizes = {
        part: numpy.abs([[float(person[f"{FEATURES[name]}.{part}"]) for name in OF_EFFECTS] for person in published])
        for part in ["Bern", "Poisson"]
    }
    draws = numpy.random.RandomState(1)
    effects = {part: draws.normal(size.mean(), size.mean(1).std(), len(published)) for part, size in sizes.items()}
    rows = []
    for number, person in enumerate(published):
        row = {"person": number}
        for prefix, part in [("b_", "Bern"), ("p_", "Poisson")]:
            row |= {prefix + name: person[f"{column}.{part}"] for name, column in FEATURES.items()}
        row |= {"e_b": repr(float(effects["Bern"][number])), "e_p": repr(float(effects["Poisson"][number]))}
        row["first_weekend"] = first_weekends[person["User"]]
        rows.append(row)
    write("v1.csv", rows)


def trials(people, of_trial):
    """The people of the published trials 0 to 99, as those of seeds 1 to 100."""
    rows = []
    for seed in range(100):
        drawn = numpy.random.RandomState(seed).choice(people, of_trial)
        rows += [{"seed": seed + 1, "person": person, "row": row} for person, row in enumerate(drawn)]
    write("v1_trials.csv", rows)


def published(design):
    """The tiles: qualities per decision, here as sums over a person's decisions, as returns are."""
    rows = []
    for environment, effect in [("LOW_R", 0), ("MED_R", 0.5), ("HIGH_R", 0.8)]:
        for short, metric in [("AVG", "mean"), ("25_PERC", "lower_quartile"), ("75_PERC", "upper_quartile")]:
            tiles = pickle.loads(read(design, f"figures/{environment}_{short}_HEATMAP.p", DIGESTS))
            for (good, frequent), tile in numpy.ndenumerate(tiles):
                rows.append({
                    "subject": metric.replace("_", "-"),
                    "agent": "thompson",
                    "scenario": "time_of_day-brushing_n-prompts-weekend",
                    "metric": f"{metric}_return",
                    "environment.parameters.effect_after_shrinking": effect,
                    "environment.parameters.cost_of_good_brushing": 20 * good,
                    "environment.parameters.cost_of_frequent_prompts": 20 * frequent,
                    "value": repr(DECISIONS * float(tile)),
                    "n": 100,
                })
    write("v1_published.csv", rows)


def main():
    if len(sys.argv) != 3 or not all(pathlib.Path(folder).is_dir() for folder in sys.argv[1:]):
        sys.exit(__doc__)
    people(*sys.argv[1:])
    trials(13, 72)
    published(sys.argv[1])


if __name__ == "__main__":
    main()
