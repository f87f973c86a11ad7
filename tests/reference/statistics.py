"""Writes statistics.json: reference values from scipy, statsmodels, mpmath and R for jitai's statistics.

    pip install scipy==1.17.1 statsmodels==0.15.0 mpmath==1.4.1 numpy==2.4.6
    python statistics.py       # writes statistics.json beside this file; needs Rscript; minutes

Tails and the noncentral t distribution are computed by mpmath with 20 digits, because the double
precision of the libraries is not sufficient. Samples come from NumPy's generator with a fixed seed
and are written beside the results, so that the file is self-contained.
"""

import itertools
import json
import math
import platform
import subprocess
from pathlib import Path

import mpmath
import numpy
import scipy
import statsmodels
from scipy import optimize, stats
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.power import TTestPower
from statsmodels.stats.proportion import proportion_confint

mpmath.mp.dps = 20
LEVEL = 0.95
Z = stats.norm.ppf(0.975)


def r(code):
    """The numbers that R prints for an expression."""
    script = f"cat(format({code}, digits = 17, scientific = TRUE))"
    done = subprocess.run(["Rscript", "-e", script], capture_output=True, text=True, check=True)
    return [None if word == "NA" else float(word) for word in done.stdout.split()]


def r_list(values):
    return "c(" + ", ".join("NA" if value is None else repr(value) for value in values) + ")"


def two_sided_p(t, df):
    t, df = mpmath.mpf(t), mpmath.mpf(df)
    return float(mpmath.betainc(df / 2, mpmath.mpf(1) / 2, 0, df / (df + t * t), regularized=True))


def noncentral(t, df, shift):
    """P((Z + shift) / S <= t), integrated over U = S sqrt(df)."""
    t, df, shift = map(mpmath.mpf, (t, df, shift))
    log_density = lambda u: (df - 1) * mpmath.log(u) - u * u / 2
    density = lambda u: mpmath.exp(log_density(u)) if u else mpmath.mpf(df == 1)
    norm = mpmath.power(2, 1 - df / 2) / mpmath.gamma(df / 2)
    root = mpmath.sqrt(df)
    top = root + 12
    places = {mpmath.mpf(0), top, root}
    # The normal distribution function rises around this point.
    if t:
        middle, width = shift * root / t, 12 * root / abs(t)
        places |= {p for k in (-1, -0.5, 0, 0.5, 1) if 0 < (p := middle + k * width) < top}
    places |= {mpmath.mpf(k) for k in range(1, int(top), 2)}
    integrand = lambda u: density(u) * mpmath.ncdf(t * u / root - shift)
    return float(norm * mpmath.quad(integrand, sorted(places)))


def shift_interval(t, df):
    ends = []
    for probability in (0.975, 0.025):
        excess = lambda shift: noncentral(t, df, shift) - probability
        reach = 6 + 2 * abs(t)
        ends.append(optimize.brentq(excess, t - reach, t + reach, xtol=1e-13, rtol=1e-14))
    return ends


def correction(df):
    df = mpmath.mpf(df)
    return float(mpmath.gamma(df / 2) / (mpmath.sqrt(df / 2) * mpmath.gamma((df - 1) / 2)))


def newcombe(seen, m, n):
    """Newcombe's method 5: the roots of (p - seen)^2 = z^2 variance(p)."""
    larger = (m + n) / 2 - 1

    def excess(p):
        balance = (1 - p) / (2 - p) + p / (1 + p)
        return (p - seen) ** 2 - Z**2 * p * (1 - p) * (1 + larger * balance) / (m * n)

    edge = 1e-9
    solve = lambda low, high: optimize.brentq(excess, low, high, xtol=1e-15, rtol=1e-14)
    low = 0.0 if seen == 0 else solve(0, min(seen, 1 - edge))
    high = 1.0 if seen == 1 else solve(max(seen, edge), 1)
    return [low, high]


def t_test(result):
    interval = result.confidence_interval(LEVEL)
    return {
        "t": result.statistic,
        "df": result.df,
        "p": two_sided_p(result.statistic, result.df),
        "interval": [interval.low, interval.high],
    }


def unpaired(first, second):
    """Welch's statistic with the degrees of freedom of the smaller side."""
    welch = stats.ttest_ind(first, second, equal_var=False)
    df = min(len(first), len(second)) - 1
    difference = float(numpy.mean(first) - numpy.mean(second))
    half = stats.t.isf((1 - LEVEL) / 2, df) * abs(difference / welch.statistic)
    return {
        "t": float(welch.statistic),
        "df": df,
        "p": two_sided_p(welch.statistic, df),
        "interval": [difference - half, difference + half],
    }


def permutation_p(first, second, kind):
    """The p value of scipy; the statistic is the absolute difference, so that both tails count."""
    distance = lambda x, y, axis=-1: numpy.abs(numpy.mean(x, axis=axis) - numpy.mean(y, axis=axis))
    result = stats.permutation_test(
        (first, second),
        distance,
        permutation_type=kind,
        alternative="greater",
        n_resamples=numpy.inf,
        vectorized=True,
    )
    return float(result.pvalue)


def contrast(first, second):
    m, n = len(first), len(second)
    student = stats.ttest_ind(first, second)
    wins = stats.mannwhitneyu(first, second).statistic / (m * n)
    case = {
        "first": first,
        "second": second,
        "student": t_test(student),
        "unpaired": unpaired(first, second),
        "permutation_p": permutation_p(first, second, "independent"),
        "improvement": {"probability": wins, "interval": newcombe(wins, m, n)},
    }
    scale = math.sqrt(1 / m + 1 / n)
    case["hedges_g"] = {
        "g": student.statistic * scale * correction(m + n - 2),
        "interval": [end * scale for end in shift_interval(student.statistic, m + n - 2)],
    }
    if m == n:
        paired = stats.ttest_rel(first, second)
        case["paired"] = t_test(paired)
        case["paired_permutation_p"] = permutation_p(first, second, "samples")
        count = sum((x > y) + (x == y) / 2 for x, y in zip(first, second))
        low, high = proportion_confint(count, n, method="wilson")
        case["paired_improvement"] = {"probability": count / n, "interval": [low, high]}
        if n > 2:
            ends = shift_interval(paired.statistic, n - 1)
            case["paired_hedges_g"] = {
                "g": paired.statistic / math.sqrt(n) * correction(n - 1),
                "interval": [end / math.sqrt(n) for end in ends],
            }
    return case


def contrasts():
    generator = numpy.random.default_rng(20230801)
    draw = lambda mean, sd, n: [round(float(x), 3) for x in generator.normal(mean, sd, n)]
    yield contrast(draw(2370, 90, 3), draw(1750, 35, 3))
    yield contrast(draw(2380, 90, 10), draw(2350, 35, 10))
    yield contrast(draw(2600, 4, 10), draw(1750, 3, 10))
    yield contrast(draw(5, 1, 2), draw(4, 2, 2))
    yield contrast(draw(5, 1, 5), draw(4, 6, 9))
    yield contrast(draw(-3, 1, 7), draw(4, 0.1, 4))
    yield contrast([1.0, 2.0, 2.0, 3.0, 5.0], [2.0, 2.0, 4.0, 5.0, 5.0])
    yield contrast([4.0, 4.0, 4.0], [1.0, 2.0, 4.5, 3.0])
    yield contrast([1e6 + x for x in (0.25, 0.5, 1.0, 0.75)], [1e6 + x for x in (0, 0.5, 0.25, 0)])


def multiplicity():
    families = [
        [0.01, 0.04, 0.03, 0.005, 0.5],
        [0.0193, 0.00043, 1e-30, 0.00045, 0.06041, 0.00442, 0.00183, 0.03019, 0.02693, 0.3766],
        [0.02, 0.02, 0.02, 0.9, 1.0],
        [0.3],
        [None, 0.01, 0.02, None, 0.03],
    ]
    for family in families:
        values, n = r_list(family), len(family)
        adjusted = {
            name: r(f'p.adjust({values}, "{method}", n = {n})')
            for name, method in (("holm", "holm"), ("benjamini_hochberg", "BH"))
        }
        if None not in family:
            for name, method in (("holm", "holm"), ("benjamini_hochberg", "fdr_bh")):
                again = multipletests(family, method=method)[1]
                assert numpy.allclose(again, adjusted[name], rtol=1e-12, atol=0), (family, name)
        yield {"p": family, **adjusted}


def detectable_shift(df, level):
    """The shift that statsmodels searches for, to full precision; its own search stops at 1e-6."""
    bound = stats.t.isf(level / 2, df)
    missed = lambda shift: noncentral(bound, df, shift) - noncentral(-bound, df, shift)
    return optimize.brentq(lambda shift: missed(shift) - 0.2, 1, 10 + 2 * bound, xtol=1e-13)


def power():
    """Rows of pairs and level, the shift by statsmodels and to full precision, and the ends of its interval."""
    for n, level in [(2, 0.05), (3, 0.05), (3, 0.05 / 24), (5, 0.05), (10, 0.05), (10, 0.05 / 4), (30, 0.05)]:
        shift = detectable_shift(n - 1, level)
        # The search of statsmodels fails far in the tail.
        d = TTestPower().solve_power(nobs=n, alpha=level, power=0.8) if level > 0.01 else math.nan
        theirs = None if math.isnan(d) else float(d) * math.sqrt(n)
        ends = [shift * math.sqrt((n - 1) / stats.chi2.ppf(p, n - 1)) for p in (0.975, 0.025)]
        yield [n, level, theirs, shift, *ends]


def recoveries():
    """The shares at which scipy's t tests just reject, for independent and for matched seeds."""
    generator = numpy.random.default_rng(11)
    optimum = 3300.0
    for n, mean, sd in [(3, 3100, 20), (10, 2950, 60), (6, 2700, 90)]:
        common = generator.normal(0, 40, n)
        with_ = [round(float(x), 3) for x in common + generator.normal(mean, sd, n)]
        without = [round(float(x), 3) for x in common + generator.normal(2700, 60, n)]
        share = (numpy.mean(with_) - numpy.mean(without)) / (optimum - numpy.mean(without))

        def excess(test):
            rest = lambda r: (1 - r) * numpy.array(without) + r * optimum
            return lambda r: test(with_, rest(r)) - (1 - LEVEL)

        ends = {}
        tests = {
            "unpaired": lambda x, y: unpaired(x, y)["p"],
            "paired": lambda x, y: float(stats.ttest_rel(x, y).pvalue),
        }
        for name, test in tests.items():
            off = excess(test)
            solve = lambda one, other: optimize.brentq(off, one, other, xtol=1e-14, rtol=1e-14)
            ends[name] = [solve(share - 2, share - 1e-9), solve(share + 1e-9, share + 2)]
        yield {"with": with_, "without": without, "optimum": optimum, "share": float(share), **ends}


def middle_mean(values, axis=None):
    return stats.trim_mean(values, 0.25, axis=axis)


def resampled_interval(strata, means):
    """The t interval of the middle mean with the deviation of its resamples."""
    n = min(map(len, strata))
    value = middle_mean(list(itertools.chain(*strata)))
    half = stats.t.isf((1 - LEVEL) / 2, n - 1) * numpy.std(means) * math.sqrt(n / (n - 1))
    return [float(value - half), float(value + half)]


def apart_interval(strata, resamples=200_000):
    """Strata without a seed in common are resampled separately."""
    generator = numpy.random.default_rng(7)
    means = []
    for _ in range(resamples // 20_000):
        drawn = [numpy.array(s)[generator.integers(len(s), size=(20_000, len(s)))] for s in strata]
        means.append(middle_mean(numpy.concatenate(drawn, axis=1), axis=1))
    return resampled_interval(strata, numpy.concatenate(means))


def joint_interval(strata, resamples=200_000):
    """Equal places in two strata are one seed, drawn with all its values.

    Seeds are drawn until every stratum has as many values as before.
    """
    generator = numpy.random.default_rng(7)
    seeds = max(map(len, strata))
    means = []
    for _ in range(resamples // 20_000):
        drawn = generator.integers(seeds, size=(20_000, 20 * seeds))
        taken = []
        for values in strata:
            has = drawn < len(values)
            counts = has & (numpy.cumsum(has, axis=1) <= len(values))
            assert (counts.sum(axis=1) == len(values)).all()
            places = numpy.argsort(~counts, axis=1, kind="stable")[:, : len(values)]
            taken.append(numpy.array(values)[numpy.take_along_axis(drawn, places, axis=1)])
        means.append(middle_mean(numpy.concatenate(taken, axis=1), axis=1))
    return resampled_interval(strata, numpy.concatenate(means))


def interquartile_means():
    generator = numpy.random.default_rng(5)
    for sizes in [(6, 6, 6, 6), (10,) * 12, (5, 4, 7)]:
        strata = [
            [round(float(x), 3) for x in generator.normal(1000 * (k + 1) ** 0.5, 80, n)]
            for k, n in enumerate(sizes)
        ]
        yield {
            "conditions": strata,
            "value": float(middle_mean(list(itertools.chain(*strata)))),
            "interval": apart_interval(strata),
            "joint_interval": joint_interval(strata),
        }


def quantiles():
    generator = numpy.random.default_rng(8)
    for n, share in [(1, 0.25), (2, 0.25), (10, 0.25), (1000, 0.25), (999, 0.9)]:
        values = [round(float(x), 3) for x in generator.exponential(700, n)]
        yield {"values": values, "share": share, "quantile": float(numpy.quantile(values, share))}


def moving_means():
    """Moving means over single episodes; each episode has the value of the point that covers it."""
    generator = numpy.random.default_rng(9)
    for episodes, stride, window in [(40, 1, 10), (200, 10, 100), (205, 10, 35), (30, 7, 12)]:
        ends = [*range(stride, episodes + 1, stride)]
        if ends[-1] < episodes:
            ends.append(episodes)
        points = [[end, round(float(generator.normal(500, 90)), 3)] for end in ends]
        single = numpy.repeat([value for _, value in points], numpy.diff([0, *ends]))
        smooth = [[end, float(single[end - window : end].mean())] for end in ends if end >= window]
        yield {"points": points, "stride": stride, "window": window, "smooth": smooth}


def agreements():
    for ours, se, df, effect, p, df_published in [
        (480.2, 31.0, 18.0, 483.02, 0.0193, 4.0),
        (763.36, 12.5, 15.3, 518.49, 0.00043, 4.0),
        (-80.0, 20.0, 17.7, -26.18, 0.3766, 4.0),
        (500.0, 20.0, 17.7, 518.49, 0.000005, 4.0),
    ]:
        theirs = abs(effect) / stats.t.isf(p / 2, df_published)
        joint = se**2 + theirs**2
        free = joint**2 / (se**4 / df + theirs**4 / df_published)
        low, high = stats.t.interval(LEVEL, free, ours - effect, math.sqrt(joint))
        yield {
            "ours": [ours, se, df],
            "published": [effect, p, df_published],
            "standard_error": float(theirs),
            "interval": [float(low), float(high)],
            "inside": bool(low <= 0 <= high),
        }


def mean_intervals(cases):
    for case in cases:
        values = case["second"]
        error = stats.sem(values)
        low, high = stats.t.interval(LEVEL, len(values) - 1, numpy.mean(values), error)
        yield {"values": values, "interval": [float(low), float(high)]}


def student():
    freedoms = [1, 2, 3.7, 4, 18, 57.3, 198, 1998]
    rows = [[t, df, two_sided_p(t, df)] for df in freedoms for t in (1e-3, 0.5, 1.96, 7, 40)]
    rows += [[t, df, two_sided_p(t, df)] for t, df in [(1e4, 18), (250, 198), (1e8, 4), (400, 58)]]
    assert min(p for _, _, p in rows) < 1e-200
    critical = [[df, float(stats.t.isf(0.025, df))] for df in freedoms]
    places = itertools.product((1e-12, 5e-6, 0.02, 0.9), (1, 4, 18, 6.3))
    of_p = [[p, df, float(stats.t.isf(p / 2, df))] for p, df in places]
    return {"two_sided_p": rows, "critical": critical, "t_of_p": of_p}


def noncentrals():
    small = [(0.0, 0.7), (0.3, -1.2), (2.1, 3.0), (-1.5, 1.0)]
    large = [(4.3, 3.1), (12.7, 16.4), (35.0, 33.0), (400.0, 390.0)]
    for df, (t, shift) in itertools.product((1, 2, 4, 18, 98, 998), small + large):
        yield [t, df, shift, noncentral(t, df, shift)]


def main():
    cases = list(contrasts())
    answers = {
        "versions": {
            "python": platform.python_version(),
            "numpy": numpy.__version__,
            "scipy": scipy.__version__,
            "statsmodels": statsmodels.__version__,
            "mpmath": mpmath.__version__,
            "R": ".".join(str(int(x)) for x in r("unlist(getRversion())")),
        },
        **student(),
        "noncentral_t": list(noncentrals()),
        "mean_interval": list(mean_intervals(cases)),
        "contrast": cases,
        "multiplicity": list(multiplicity()),
        "detectable": list(power()),
        "recovery": list(recoveries()),
        "quantile": list(quantiles()),
        "interquartile_mean": list(interquartile_means()),
        "moving_mean": list(moving_means()),
        "agreement": list(agreements()),
    }
    lines = []
    for name, answer in answers.items():
        if isinstance(answer, list):
            rows = ",\n".join("    " + json.dumps(row, default=float) for row in answer)
            lines.append(f'  "{name}": [\n{rows}\n  ]')
        else:
            lines.append(f'  "{name}": {json.dumps(answer, default=float)}')
    path = Path(__file__).with_name("statistics.json")
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    main()
