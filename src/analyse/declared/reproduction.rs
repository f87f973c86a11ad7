//! Comparison of published numbers with ours.

use std::collections::BTreeMap;

use super::arm::arms;
use crate::analyse::undefined::finite;
use crate::analyse::{
    Agreement, Design, Estimate, Likeness, Sample, Undefined, Verdict, agreement, t_test,
};
use crate::env::inference_error;
use crate::job::metric::MEAN_RETURN;
use crate::manifest::{Equivalence, Published};
use crate::record::JobRecord;

/// Number of seeds behind every published mean.
const PUBLISHED_SEEDS: f64 = 3.0;

/// Half-width of the error of reading a published curve off its figure, in steps. The error is taken
/// as uniform, so its standard deviation is this divided by the square root of 3.
const READING_ERROR: f64 = 15.0;

/// The smallest p that is not printed as 0.00000.
const SMALLEST_P: f64 = 5e-6;

/// Number of samples behind a published error rate.
const ERROR_SAMPLES: f64 = 1000.0;

/// The comparisons of all published numbers that the jobs cover.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reproduction {
    /// The comparisons, in the order of the published file.
    pub comparisons: Vec<Comparison>,
}

/// The kind of a published number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Subject {
    /// A difference in a table of t tests.
    Effect,
    /// A point of a curve.
    CurvePoint,
    /// A tile of a heat map.
    HeatTile,
    /// A rate of context inference error.
    ErrorRate,
}

impl Subject {
    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Subject::Effect => "effect",
            Subject::CurvePoint => "curve point",
            Subject::HeatTile => "heat-map tile",
            Subject::ErrorRate => "error rate",
        }
    }
}

/// A published number and ours.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// The kind of number.
    pub subject: Subject,
    /// The agent, or both as `first - second`; empty where there is none.
    pub agent: String,
    /// The scenario, or both as `first - second`; empty where there is none.
    pub scenario: String,
    /// Further parameters: name and value.
    pub settings: Vec<(&'static str, f64)>,
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
    /// Mean difference.
    pub mean: f64,
    /// Root of the mean squared difference.
    pub root_mean_square: f64,
    /// Number of comparisons.
    pub numbers: usize,
}

impl Reproduction {
    /// Numbers of comparisons of a subject whose verdict is inside, outside and undefined.
    pub fn counts(&self, subject: Subject) -> (usize, usize, usize) {
        let mut counts = (0, 0, 0);
        for comparison in self.comparisons.iter().filter(|one| one.subject == subject) {
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
    pub fn equivalent(&self, subject: Subject) -> Option<(f64, usize, usize)> {
        let of_subject = || self.comparisons.iter().filter(|one| one.subject == subject);
        let margin = of_subject().find_map(|one| one.margin)?;
        let verdicts = || of_subject().filter_map(Comparison::is_equivalent);
        Some((margin, verdicts().filter(|is| *is).count(), verdicts().count()))
    }

    /// The distance of our numbers from the published numbers of a subject, by agent. Numbers can
    /// be too high on average although each of them agrees.
    pub fn distances(&self, subject: Subject) -> Vec<Distance> {
        let mut agents: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
        for one in self.comparisons.iter().filter(|one| one.subject == subject) {
            if let Ok(ours) = one.ours {
                agents.entry(&one.agent).or_default().push(ours - one.published);
            }
        }
        let distance = |(agent, differences): (&str, Vec<f64>)| {
            let mean = |of: fn(f64) -> f64| {
                differences.iter().map(|x| of(*x)).sum::<f64>() / differences.len() as f64
            };
            Distance {
                agent: agent.to_owned(),
                mean: mean(|x| x),
                root_mean_square: mean(|x| x * x).sqrt(),
                numbers: differences.len(),
            }
        };
        agents.into_iter().map(distance).collect()
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
/// left out.
pub fn reproduce(published: &Published, jobs: &[JobRecord]) -> Reproduction {
    let jobs: Vec<&JobRecord> = jobs.iter().collect();
    let mut comparisons = effects(published, &jobs);
    comparisons.extend(curve_points(published, &jobs));
    comparisons.extend(heat_tiles(published, &jobs));
    comparisons.extend(error_rates(published, &jobs));
    let Equivalence { steps, rate } = published.equivalence;
    for one in &mut comparisons {
        one.margin = if one.subject == Subject::ErrorRate { rate } else { steps };
    }
    Reproduction { comparisons }
}

/// The sample of the only arm with this agent, scenario and settings; `None` if no arm or several match.
fn arm(
    jobs: &[&JobRecord],
    agent: &str,
    scenario: &str,
    settings: &[(&'static str, f64)],
) -> Option<Sample> {
    let is = |job: &&&JobRecord| {
        let set = |(name, value): &(&str, f64)| {
            job.number(&format!("environment.{name}")) == Some(*value)
        };
        *job.agent == *agent && job.scenario == scenario && settings.iter().all(set)
    };
    let here: Vec<&JobRecord> = jobs.iter().filter(is).copied().collect();
    match arms(&here, &[]).as_slice() {
        [arm] => Some(arm.sample(MEAN_RETURN)),
        _ => None,
    }
}

fn effects(published: &Published, jobs: &[&JobRecord]) -> Vec<Comparison> {
    let mut comparisons = Vec::new();
    for test in &published.t_tests {
        let Some((first, second)) = test.contrast.split_once(" - ") else { continue };
        for (at, &sigma) in test.sigma.iter().enumerate() {
            let side = |word: &str| match (&test.agent, &test.scenario) {
                (Some(agent), None) => arm(jobs, agent, word, &[("sigma", sigma)]),
                (None, Some(scenario)) => arm(jobs, word, scenario, &[("sigma", sigma)]),
                _ => None,
            };
            let (Some(one), Some(other)) = (side(first), side(second)) else { continue };
            let (effect, p) = (test.effect[at], test.p_value[at]);
            let df = 2.0 * PUBLISHED_SEEDS - 2.0;
            let theirs = Estimate::of_published(effect, p.max(SMALLEST_P), df);
            let contrast = test.contrast.clone();
            let words = |word: &Option<String>| word.clone().unwrap_or_else(|| contrast.clone());
            let mut comparison = difference(&one, &other, effect, theirs);
            comparison.subject = Subject::Effect;
            comparison.agent = words(&test.agent);
            comparison.scenario = words(&test.scenario);
            comparison.settings = vec![("sigma", sigma)];
            comparison.published_p = Some(p);
            comparisons.push(comparison);
        }
    }
    comparisons
}

fn curve_points(published: &Published, jobs: &[&JobRecord]) -> Vec<Comparison> {
    let mut comparisons = Vec::new();
    for curve in &published.curves {
        for (&sigma, &value) in curve.sigma.iter().zip(&curve.mean_return) {
            let Some(sample) = arm(jobs, &curve.agent, &curve.scenario, &[("sigma", sigma)]) else {
                continue;
            };
            comparisons.push(Comparison {
                agent: curve.agent.clone(),
                scenario: curve.scenario.clone(),
                settings: vec![("sigma", sigma)],
                ..curve_point(value, &sample)
            });
        }
    }
    comparisons
}

/// The comparison of a published point of a curve with our seeds at that point.
fn curve_point(published: f64, sample: &Sample) -> Comparison {
    let reading_sd = READING_ERROR / 3f64.sqrt();
    let likeness = Likeness::new(&[sample.values()], PUBLISHED_SEEDS, reading_sd);
    let ours = Estimate::of_mean(sample.values());
    Comparison {
        subject: Subject::CurvePoint,
        ours: sample.mean(),
        ..alike(published, likeness, ours, sample.n())
    }
}

fn heat_tiles(published: &Published, jobs: &[&JobRecord]) -> Vec<Comparison> {
    let mut comparisons = Vec::new();
    for map in &published.heat_maps {
        let Some((first, second)) = map.contrast.split_once(" - ") else { continue };
        for (&delta_d, row) in map.delta_d.iter().zip(&map.effect) {
            for (&epsilon_d, &effect) in map.epsilon_d.iter().zip(row) {
                let settings = vec![("delta_d", delta_d), ("epsilon_d", epsilon_d)];
                let side = |scenario| arm(jobs, &map.agent, scenario, &settings);
                let (Some(one), Some(other)) = (side(first), side(second)) else { continue };
                comparisons.push(Comparison {
                    agent: map.agent.clone(),
                    scenario: map.contrast.clone(),
                    settings,
                    ..heat_tile(effect, &one, &other)
                });
            }
        }
    }
    comparisons
}

/// The comparison of a published tile of a heat map of differences with our seeds of both sides.
fn heat_tile(published: f64, first: &Sample, second: &Sample) -> Comparison {
    let likeness = Likeness::new(&[first.values(), second.values()], PUBLISHED_SEEDS, 0.0);
    let ours = estimate(first, second);
    let seeds = first.n().min(second.n());
    Comparison {
        subject: Subject::HeatTile,
        ours: gap(first, second),
        ..alike(published, likeness, ours, seeds)
    }
}

fn error_rates(published: &Published, jobs: &[&JobRecord]) -> Vec<Comparison> {
    let Some(errors) = &published.sigma_to_error else { return Vec::new() };
    let pairs = errors.sigma.iter().zip(&errors.reported);
    let declared = pairs.filter(|(sigma, _)| {
        jobs.iter().any(|job| job.number("environment.sigma") == Some(**sigma))
    });
    let comparison = |(&sigma, &rate): (&f64, &f64)| {
        let ours = inference_error(sigma);
        // The binomial standard error of a published rate whose true value is ours. Our rate is exact.
        let standard_error = (ours * (1.0 - ours) / ERROR_SAMPLES).sqrt();
        let exact = |value| Estimate { value, standard_error: 0.0, df: ERROR_SAMPLES - 1.0 };
        let theirs = Ok(Estimate { standard_error, ..exact(rate) });
        Comparison {
            subject: Subject::ErrorRate,
            settings: vec![("sigma", sigma)],
            ..compared(rate, theirs, Ok(exact(ours)), 0)
        }
    };
    declared.map(comparison).collect()
}

/// The comparison of a published difference, which has its own uncertainty, with our seeds of both sides.
fn difference(
    first: &Sample,
    second: &Sample,
    published: f64,
    theirs: Result<Estimate, Undefined>,
) -> Comparison {
    let seeds = first.n().min(second.n());
    let ours = estimate(first, second);
    Comparison { ours: gap(first, second), ..compared(published, theirs, ours, seeds) }
}

/// The difference of two arms with its standard error.
fn estimate(first: &Sample, second: &Sample) -> Result<Estimate, Undefined> {
    let design = Design::of(first, second);
    match design {
        Design::Independent => Estimate::of_difference(first.values(), second.values()),
        Design::Matched => t_test(first, second, design).map(|test| Estimate::of_test(&test)),
    }
}

/// The difference of the means of two arms, which needs one seed per arm.
fn gap(first: &Sample, second: &Sample) -> Result<f64, Undefined> {
    let (first, second) = Design::of(first, second).compared(first, second);
    finite(first.mean()? - second.mean()?)
}

/// A comparison with a number published without uncertainty, whose seeds are assumed to vary as much as ours.
fn alike(
    published: f64,
    likeness: Result<Likeness, Undefined>,
    ours: Result<Estimate, Undefined>,
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
    theirs: Result<Estimate, Undefined>,
    ours: Result<Estimate, Undefined>,
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
    ours: Result<Estimate, Undefined>,
    seeds: usize,
    agreement: Result<Agreement, Undefined>,
) -> Comparison {
    Comparison {
        subject: Subject::Effect,
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

    fn sample(values: &[f64]) -> Sample {
        Sample::new((1..).zip(values.iter().copied()), 0, 0).unwrap()
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
                curve_point(published_mean(&mut stream, sd) + reading, &ours)
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
                heat_tile(published, &first, &second)
            });
            assert!((0.94..0.97).contains(&covered), "{n} seeds, deviations {sds:?}: {covered}");
        }
    }
}
