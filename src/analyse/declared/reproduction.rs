//! Comparison of published numbers with ours.

use std::collections::BTreeMap;

use super::arm::arms;
use crate::analyse::undefined::finite;
use crate::analyse::{
    Agreement, Likeness, Sample, SeedPairing, UncertainNumber, Undefined, Verdict, agreement,
    t_test,
};
use crate::env::inference_error;
use crate::job::{MetricName, MetricUnit, Scalar, distinct};
use crate::key::Parameter;
use crate::manifest::{Published, PublishedRow};
use crate::record::JobRecord;

/// The smallest p that is not printed as 0.00000.
const SMALLEST_P: f64 = 5e-6;

/// The comparisons of all published numbers that the jobs cover.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reproduction {
    /// The comparisons, in the order of the published file.
    pub comparisons: Vec<Comparison>,
}

/// A published number and ours.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The kind of number, as the published file calls it.
    pub subject: String,
    /// Another algorithm than ours that has the published number; empty if ours should have it, too.
    pub competitor: String,
    /// The metric; `None` for an error rate.
    pub metric: Option<MetricName>,
    /// The unit of returns.
    pub return_unit: &'static str,
    /// The agent, or both as `first - second`; empty where there is none.
    pub agent: String,
    /// The scenario, or both as `first - second`; empty where there is none.
    pub scenario: String,
    /// Further parameters: name and value.
    pub settings: Vec<(&'static str, Scalar)>,
    /// The published number.
    pub published: f64,
    /// Its standard error, if it can be derived.
    pub published_error: Result<f64, Undefined>,
    /// The published p value, for effects only.
    pub published_p: Option<f64>,
    /// Our number.
    pub ours: Result<f64, Undefined>,
    /// Its standard error.
    pub our_error: Result<f64, Undefined>,
    /// Our number of seeds, of the smaller side.
    pub seeds: usize,
    /// Our number minus the published number, with the joint interval.
    pub agreement: Result<Agreement, Undefined>,
    /// The declared margin within which two numbers are equivalent.
    pub margin: Option<f64>,
}

impl Comparison {
    /// Whether the number is a share.
    pub fn is_rate(&self) -> bool {
        self.metric.is_none_or(|metric| metric.unit() == MetricUnit::Share)
    }

    /// Whether our number should be the published one.
    fn is_of_ours(&self) -> bool {
        self.competitor.is_empty()
    }

    /// Whether both numbers are equivalent within the declared margin.
    pub fn is_equivalent(&self) -> Option<bool> {
        let margin = self.margin?;
        self.agreement.ok().map(|agreement| agreement.equivalence_bound <= margin)
    }
}

/// The distance of an agent's numbers from the published ones, as ours minus published.
#[derive(Clone, Debug, PartialEq)]
pub struct Distance {
    /// The agent.
    pub agent: String,
    /// The unit of returns.
    pub return_unit: &'static str,
    /// Mean difference.
    pub mean: f64,
    /// Root of the mean squared difference.
    pub root_mean_square: f64,
    /// Number of comparisons.
    pub numbers: usize,
}

impl Reproduction {
    /// The kinds of numbers, in the order of the published file.
    pub fn subjects(&self) -> Vec<&str> {
        distinct(self.comparisons.iter().map(|one| one.subject.as_str()))
    }

    /// Numbers of comparisons of a subject whose verdict is inside, outside and undefined.
    pub fn counts(&self, subject: &str) -> (usize, usize, usize) {
        let mut counts = (0, 0, 0);
        let is_of = |one: &&Comparison| one.subject == subject && one.is_of_ours();
        for comparison in self.comparisons.iter().filter(is_of) {
            match &comparison.agreement {
                Ok(Agreement { verdict: Verdict::Inside, .. }) => counts.0 += 1,
                Ok(Agreement { verdict: Verdict::Outside, .. }) => counts.1 += 1,
                Err(_) => counts.2 += 1,
            }
        }
        counts
    }

    /// Of the comparisons of a subject whose margin is declared: the margin, the number that is equivalent, and
    /// the number compared; `None` if no margin is declared.
    pub fn equivalent(&self, subject: &str) -> Option<(f64, usize, usize)> {
        let is_of = |one: &&Comparison| one.subject == subject && one.is_of_ours();
        let of_subject = || self.comparisons.iter().filter(is_of);
        let margin = of_subject().find_map(|one| one.margin)?;
        let verdicts = || of_subject().filter_map(Comparison::is_equivalent);
        Some((margin, verdicts().filter(|is| *is).count(), verdicts().count()))
    }

    /// The distance of our numbers from the published numbers of a subject that have no p value and are no shares, by
    /// agent. Numbers can be too high on average although each of them agrees.
    pub fn distances(&self, subject: &str) -> Vec<Distance> {
        let mut agents: BTreeMap<(&str, &'static str), Vec<f64>> = BTreeMap::new();
        let is_of = |one: &&Comparison| {
            one.subject == subject
                && one.is_of_ours()
                && !one.is_rate()
                && one.published_p.is_none()
        };
        for one in self.comparisons.iter().filter(is_of) {
            if let Ok(ours) = one.ours {
                agents.entry((&one.agent, one.return_unit)).or_default().push(ours - one.published);
            }
        }
        let distance = |((agent, return_unit), differences): ((&str, _), Vec<f64>)| {
            let mean = |function: fn(f64) -> f64| {
                differences.iter().map(|x| function(*x)).sum::<f64>() / differences.len() as f64
            };
            Distance {
                agent: agent.to_owned(),
                return_unit,
                mean: mean(|x| x),
                root_mean_square: mean(|x| x * x).sqrt(),
                numbers: differences.len(),
            }
        };
        agents.into_iter().map(distance).collect()
    }

    /// Of the numbers of other algorithms: how many of ours are higher, lower and not different by the joint interval.
    pub fn competitors(&self) -> [usize; 3] {
        let mut counts = [0; 3];
        for one in self.comparisons.iter().filter(|one| !one.is_of_ours()) {
            let Ok(agreement) = &one.agreement else { continue };
            counts[match agreement.verdict {
                Verdict::Inside => 2,
                Verdict::Outside if agreement.difference > 0.0 => 0,
                Verdict::Outside => 1,
            }] += 1;
        }
        counts
    }

    /// Among effects with a published p below 0.01: the number whose sign equals ours, and the number
    /// compared.
    pub fn signs(&self) -> (usize, usize) {
        let clear = |one: &&Comparison| one.published_p.is_some_and(|p| p < 0.01);
        let answered = self.comparisons.iter().filter(clear).filter_map(|one| {
            let ours = one.ours.ok()?;
            Some((ours > 0.0) == (one.published > 0.0))
        });
        let answered: Vec<bool> = answered.collect();
        (answered.iter().filter(|same| **same).count(), answered.len())
    }
}

/// Compares every published number with the jobs that measure it. Numbers without a declared job are
/// left out. `return_unit` is the unit of returns.
pub fn reproduce(
    published: &Published,
    jobs: &[JobRecord],
    return_unit: &'static str,
) -> Reproduction {
    let jobs: Vec<&JobRecord> = jobs.iter().collect();
    let compared = |row: &PublishedRow| {
        let comparison = match (row.metric, row.sides()) {
            (None, _) => error_rate(row, &jobs)?,
            (Some(metric), None) => {
                mean(row, &arm(&jobs, row, (&row.agent, &row.scenario), metric)?)
            }
            (Some(metric), Some(sides)) => {
                let [one, other] = sides.map(|side| arm(&jobs, row, side, metric));
                difference(row, &one?, &other?)
            }
        };
        let settings = row.parameters.iter();
        Some(Comparison {
            subject: row.subject.clone(),
            competitor: row.competitor.clone(),
            metric: row.metric,
            return_unit,
            agent: row.agent.clone(),
            scenario: row.scenario.clone(),
            settings: settings.map(|(parameter, value)| (parameter.key(), value.clone())).collect(),
            published_p: row.p,
            margin: row.margin,
            ..comparison
        })
    };
    Reproduction { comparisons: published.rows.iter().filter_map(compared).collect() }
}

/// The sample of the only arm with this agent and scenario and the parameters of a row; `None` if no arm or
/// several match.
fn arm(
    jobs: &[&JobRecord],
    row: &PublishedRow,
    (agent, scenario): (&str, &str),
    metric: MetricName,
) -> Option<Sample> {
    let is = |job: &&&JobRecord| {
        let set = |(parameter, value): &(Parameter, Scalar)| {
            job.setting(&parameter.to_string()) == Some(value)
        };
        *job.agent == *agent && job.scenario == scenario && row.parameters.iter().all(set)
    };
    let here: Vec<&JobRecord> = jobs.iter().filter(is).copied().collect();
    match arms(&here, &[]).as_slice() {
        [arm] => Some(arm.sample(metric)),
        _ => None,
    }
}

/// The standard deviation of the error of reading a number off a figure. The error is taken as uniform, so it is half
/// its width divided by the square root of 3.
fn reading_sd(row: &PublishedRow) -> f64 {
    row.reading_error / 3f64.sqrt()
}

/// The comparison of a published mean with our seeds. Without a published standard deviation, its seeds are assumed
/// to vary as much as ours.
fn mean(row: &PublishedRow, sample: &Sample) -> Comparison {
    let reading_sd = reading_sd(row);
    let ours = UncertainNumber::of_mean(sample.values());
    let comparison = match row.sd {
        Some(sd) => {
            let standard_error = (sd * sd / row.n + reading_sd * reading_sd).sqrt();
            let theirs = UncertainNumber { value: row.value, standard_error, df: row.n - 1.0 };
            let is_known = if row.n > 1.0 {
                Ok(theirs)
            } else {
                Err(Undefined::TooFewSeeds { have: 1, need: 2 })
            };
            compared(row.value, is_known, ours, sample.n())
        }
        None => {
            let likeness = Likeness::new(&[sample.values()], row.n, reading_sd);
            alike(row.value, likeness, ours, sample.n())
        }
    };
    Comparison { ours: sample.mean(), ..comparison }
}

/// The comparison of a published difference with our seeds of both sides. Its p value says how uncertain it is;
/// without one, its seeds are assumed to vary as much as ours.
fn difference(row: &PublishedRow, first: &Sample, second: &Sample) -> Comparison {
    let seeds = first.n().min(second.n());
    let ours = estimate(first, second);
    let comparison = match row.p {
        Some(p) => {
            let theirs =
                UncertainNumber::of_published(row.value, p.max(SMALLEST_P), 2.0 * row.n - 2.0);
            compared(row.value, theirs, ours, seeds)
        }
        None => {
            let sides = [first.values(), second.values()];
            let likeness = Likeness::new(&sides, row.n, reading_sd(row));
            alike(row.value, likeness, ours, seeds)
        }
    };
    Comparison { ours: gap(first, second), ..comparison }
}

/// The comparison of a published rate at which the most likely context is wrong with the exact one; `None` unless
/// jobs have its noise.
fn error_rate(row: &PublishedRow, jobs: &[&JobRecord]) -> Option<Comparison> {
    let sigma = row.value_of(Parameter::Environment("sigma"))?;
    jobs.iter().any(|job| job.number("environment.sigma") == Some(sigma)).then(|| {
        let ours = inference_error(sigma);
        // The binomial standard error of a published rate whose true value is ours. Our rate is exact.
        let standard_error = (ours * (1.0 - ours) / row.n).sqrt();
        let exact = |value| UncertainNumber { value, standard_error: 0.0, df: row.n - 1.0 };
        let theirs = Ok(UncertainNumber { standard_error, ..exact(row.value) });
        compared(row.value, theirs, Ok(exact(ours)), 0)
    })
}

/// The difference of two arms with its standard error.
fn estimate(first: &Sample, second: &Sample) -> Result<UncertainNumber, Undefined> {
    let design = SeedPairing::of(first, second);
    match design {
        SeedPairing::Independent => UncertainNumber::of_difference(first.values(), second.values()),
        SeedPairing::Matched => {
            t_test(first, second, design).map(|test| UncertainNumber::of_test(&test))
        }
    }
}

/// The difference of the means of two arms, which needs one seed per arm.
fn gap(first: &Sample, second: &Sample) -> Result<f64, Undefined> {
    let (first, second) = SeedPairing::of(first, second).compared(first, second);
    finite(first.mean()? - second.mean()?)
}

/// A comparison with a number published without uncertainty, whose seeds are assumed to vary as much as ours.
fn alike(
    published: f64,
    likeness: Result<Likeness, Undefined>,
    ours: Result<UncertainNumber, Undefined>,
    seeds: usize,
) -> Comparison {
    let agreement = match (&ours, &likeness) {
        (Ok(ours), Ok(likeness)) => likeness.agreement(ours.value - published),
        (Err(reason), _) | (_, Err(reason)) => Err(*reason),
    };
    let published_error = likeness.map(|likeness| likeness.published_error);
    unlabelled(published, published_error, ours, seeds, agreement)
}

/// A comparison of two independent numbers.
fn compared(
    published: f64,
    theirs: Result<UncertainNumber, Undefined>,
    ours: Result<UncertainNumber, Undefined>,
    seeds: usize,
) -> Comparison {
    let agreement = match (&ours, &theirs) {
        (Ok(ours), Ok(theirs)) if ours.standard_error == 0.0 && theirs.standard_error == 0.0 => {
            certain(ours.value - theirs.value)
        }
        (Ok(ours), Ok(theirs)) => agreement(ours, theirs),
        (Err(reason), _) | (_, Err(reason)) => Err(*reason),
    };
    let published_error = theirs.map(|theirs| theirs.standard_error);
    unlabelled(published, published_error, ours, seeds, agreement)
}

/// A comparison whose subject and labels the caller fills in.
fn unlabelled(
    published: f64,
    published_error: Result<f64, Undefined>,
    ours: Result<UncertainNumber, Undefined>,
    seeds: usize,
    agreement: Result<Agreement, Undefined>,
) -> Comparison {
    Comparison {
        subject: String::new(),
        competitor: String::new(),
        metric: None,
        return_unit: "",
        agent: String::new(),
        scenario: String::new(),
        settings: Vec::new(),
        published,
        published_error,
        published_p: None,
        ours: ours.map(|ours| ours.value),
        our_error: ours.map(|ours| ours.standard_error),
        seeds,
        agreement,
        margin: None,
    }
}

/// The agreement of two numbers without uncertainty.
fn certain(difference: f64) -> Result<Agreement, Undefined> {
    let interval = crate::analyse::Interval { low: difference, high: difference };
    let verdict = if difference == 0.0 { Verdict::Inside } else { Verdict::Outside };
    Ok(Agreement { difference, interval, verdict, equivalence_bound: difference.abs() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::sample::sample;
    use crate::rng::{Purpose, Stream};

    /// Number of simulated comparisons in which both numbers have the same true value.
    const ROUNDS: usize = 4000;

    /// `n` normally distributed values with mean 0.
    ///
    /// **Source**: Box and Muller, "A note on the generation of random normal deviates", 1958.
    fn normal(stream: &mut Stream, n: usize, sd: f64) -> Vec<f64> {
        let one = |_| {
            let (radius, angle) = (1.0 - stream.unit(), stream.unit());
            sd * (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
        };
        (0..n).map(one).collect()
    }

    /// Number of seeds behind a published mean, and half-width of the error of reading it.
    const PUBLISHED_SEEDS: f64 = 3.0;
    const READING_ERROR: f64 = 15.0;

    fn row(value: f64, reading_error: f64) -> PublishedRow {
        PublishedRow { value, n: PUBLISHED_SEEDS, reading_error, ..PublishedRow::default() }
    }

    /// A mean of `PUBLISHED_SEEDS` values.
    fn published_mean(stream: &mut Stream, sd: f64) -> f64 {
        normal(stream, PUBLISHED_SEEDS as usize, sd).iter().sum::<f64>() / PUBLISHED_SEEDS
    }

    /// The share of simulated comparisons whose verdict is inside.
    fn coverage(mut simulated: impl FnMut() -> Comparison) -> f64 {
        let inside = (0..ROUNDS).filter(|_| {
            simulated().agreement.is_ok_and(|agreement| agreement.verdict == Verdict::Inside)
        });
        inside.count() as f64 / ROUNDS as f64
    }

    // Over `ROUNDS` rounds, a coverage of 95 % has a standard deviation of 0.34 %.
    // Counting degrees of freedom twice would give 90 % with three seeds.

    #[test]
    fn ninety_five_of_a_hundred_curve_points_with_one_truth_are_inside() {
        // The degrees of freedom ignore the known reading error. Where it is about as large as the
        // standard error, the coverage is slightly higher.
        for (n, sd, most) in
            [(3, 50.0, 0.985), (3, 200.0, 0.965), (10, 50.0, 0.97), (10, 200.0, 0.965)]
        {
            let mut stream = Stream::new(n as u64, Purpose::Bootstrap);
            let covered = coverage(|| {
                let ours = sample(&normal(&mut stream, n, sd));
                let reading = READING_ERROR * (2.0 * stream.unit() - 1.0);
                mean(&row(published_mean(&mut stream, sd) + reading, READING_ERROR), &ours)
            });
            assert!((0.94..most).contains(&covered), "{n} seeds, deviation {sd}: {covered}");
        }
    }

    #[test]
    fn ninety_five_of_a_hundred_heat_tiles_with_one_truth_are_inside() {
        for (n, sds) in
            [(3, (50.0, 50.0)), (3, (30.0, 90.0)), (10, (50.0, 50.0)), (10, (30.0, 90.0))]
        {
            let mut stream = Stream::new(n as u64, Purpose::Bootstrap);
            let covered = coverage(|| {
                let first = sample(&normal(&mut stream, n, sds.0));
                let second = sample(&normal(&mut stream, n, sds.1));
                let published =
                    published_mean(&mut stream, sds.0) - published_mean(&mut stream, sds.1);
                difference(&row(published, 0.0), &first, &second)
            });
            assert!((0.94..0.97).contains(&covered), "{n} seeds, deviations {sds:?}: {covered}");
        }
    }
}
