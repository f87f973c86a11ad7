"""Writes synthetic people for the models of Oralytics: their numbers are invented, from the distributions below.

Run it in this folder: python3 synthetic.py. It needs no package, and writes the same files everywhere.
"""

import random

OUTCOME = {
    "v2": ["time_of_day", "prior_total", "day_n", "share", "weekend", "1"],
    "v3": ["time_of_day", "brushing_now", "dosage", "app_before", "weekend", "1", "day_n"],
}

# Mean and standard deviation of the weights: of the logit of not brushing, of the logarithm of the mean seconds, and
# of the mean root of the seconds.
BERNOULLI = {"time_of_day": (0.9, 1.0), "share": (-0.9, 0.5), "1": (-0.8, 0.9)}
LOG_MEAN = {"time_of_day": (0.0, 0.15), "1": (4.7, 0.25)}
ROOT = {"time_of_day": (0.1, 0.6), "1": (10.3, 1.0)}
OTHERS = (0.0, 0.25)
SMALL = (0.0, 0.08)

# Effects of a prompt.
EFFECTS = {"small": (0.25, 0.45), "smaller": (0.12, 0.22), "": (0.0, 0.4)}


def draw(random, of):
    return round(random.gauss(*of), 4)


def person(random, bed, is_daily):
    is_root = bed == "v2" and random.random() < 0.45
    features = OUTCOME[bed]

    def weights(prefix, law):
        return {
            f"{prefix}_{feature}": draw(random, law(feature)) if is_daily or feature != "day_n" else 0
            for feature in features
            if not (prefix.startswith("effect") and feature == "share")
        }

    row = weights("bernoulli", lambda feature: BERNOULLI.get(feature, OTHERS))
    amount, other = (ROOT, OTHERS) if is_root else (LOG_MEAN, SMALL)
    row |= weights("amount", lambda feature: amount.get(feature, other))
    if bed == "v2":
        row["sigma"] = round(random.uniform(1.0, 3.0), 4) if is_root else ""
    for size in ["small", "smaller"] if bed == "v2" else [""]:
        prefix = f"effect_{size}" if size else "effect"
        mean, spread = EFFECTS[size]
        for part, scale in [("bernoulli", 1.0), ("amount", 1.0 if is_root else 0.2)]:
            centres = {"1": mean * scale}
            row |= weights(f"{prefix}_{part}", lambda feature: (centres.get(feature, 0.0), spread * scale))
    if bed != "v2":
        row["app_open_probability"] = round(random.uniform(0.3, 1.0), 4)
    return row


def write(name, seed, bed, people, is_daily):
    generator = random.Random(seed)
    write_rows(name, [{"person": number, **person(generator, bed, is_daily)} for number in range(people)])


def write_v1(name, seed, people):
    generator = random.Random(seed)
    columns = OUTCOME["v2"]
    rows = []
    for number in range(people):
        row = {"person": number}
        for prefix, law, other in [("b_", BERNOULLI, OTHERS), ("p_", LOG_MEAN, SMALL)]:
            row |= {prefix + feature: draw(generator, law.get(feature, other)) for feature in columns}
        row |= {"e_b": draw(generator, (0.6, 0.2)), "e_p": draw(generator, (0.2, 0.1))}
        row["first_weekend"] = generator.choice([2, 4, 6, 8, 10])
        rows.append(row)
    write_rows(name, rows)


def write_rows(name, rows):
    with open(name, "w", encoding="utf-8", newline="\n") as file:
        file.write("# synthetic: these people are invented, by synthetic.py\n")
        file.write(",".join(rows[0]) + "\n")
        for row in rows:
            file.write(",".join(str(value) for value in row.values()) + "\n")


write_v1("synthetic_v1.csv", 5, 13)
write("synthetic_v2.csv", 1, "v2", 30, False)
write("synthetic_v2_daily.csv", 2, "v2", 30, True)
write("synthetic_v3.csv", 3, "v3", 12, False)
write("synthetic_v4.csv", 4, "v3", 72, True)
