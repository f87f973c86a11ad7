//! Operating characteristics: how estimates behave over the trials of an arm, and how many people a trial needs.

use std::collections::HashSet;

use super::arm::{Arm, ArmId, arms, by_value, decided_by};
use crate::analyse::{
    Formula, Interval, MonteCarloMean, Operating, SampleSize, TrialEstimate, sample_size,
};
use crate::job::{CONSTANT, Effect, distinct};
use crate::key::Parameter;
use crate::manifest::kind::OperatingCharacteristics;
use crate::record::JobRecord;

/// The number of people of a trial.
const PEOPLE: Parameter = Parameter::Trial("people");

/// The operating characteristics of the estimates of some arms.
#[derive(Clone, Debug, PartialEq)]
pub struct OperatingFigure {
    /// Dotted name of the horizontal axis; `None` without a figure.
    pub axis: Option<String>,
    /// One row per term, arm and point on the axis, by term and arm.
    pub rows: Vec<OperatingRow>,
    /// The power that is sought, and what was found for each line; `None` if none is sought.
    pub sought: Option<(f64, Vec<Sought>)>,
}

/// A term of an estimate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Term {
    /// The name of the estimate.
    pub estimate: String,
    /// The term of its effect.
    pub term: String,
    /// The outcome of the estimate.
    pub outcome: String,
}

/// The estimates of one term over the trials of an arm.
#[derive(Clone, Debug, PartialEq)]
pub struct OperatingRow {
    /// The arm, without the parameter of the axis among its settings.
    pub name: ArmId,
    /// The value of the parameter of the axis.
    pub x: Option<f64>,
    /// The term.
    pub term: Term,
    /// Its operating characteristics.
    pub operating: Operating,
    /// Completed trials whose estimate failed, and why that of the first did.
    pub failed: (usize, Option<String>),
    /// Completed trials whose estimate is not computed yet.
    pub lacking: usize,
    /// The mean number of decisions per person that the estimate uses, the mean residual standard deviation, the
    /// mean p (1 - p) of the treatment, and the number of coefficients of the control model; `None` without an estimate
    /// or for several coefficients.
    design: Option<(f64, f64, f64, usize)>,
}

/// Below this number of trials at a number of people, a power is too uncertain for a sample size.
pub const FEW_TRIALS: usize = 20;

/// The number of people that reaches a power.
#[derive(Clone, Debug, PartialEq)]
pub struct Sought {
    /// The arm, without the number of people among its settings.
    pub name: ArmId,
    /// The term.
    pub term: Term,
    /// The number of people by simulation; `None` if the power is not reached between the simulated numbers, or with
    /// fewer than [`FEW_TRIALS`] trials.
    pub simulated: Option<SampleSize>,
    /// The number of people by the formula of Liao and others; `None` where it does not apply.
    pub formula: Option<u32>,
    /// The powers at the fewest and the most people: people and share.
    pub ends: [(f64, f64); 2],
    /// The fewest trials from which a power is computed.
    pub trials: usize,
}

impl Sought {
    /// Whether the formula's number lies outside the interval of the simulated one.
    pub fn differs(&self) -> bool {
        let Some((size, formula)) = self.simulated.zip(self.formula.map(f64::from)) else {
            return false;
        };
        size.low.is_some_and(|low| formula < low.ceil())
            || size.high.is_some_and(|high| formula > high.ceil())
    }
}

/// The operating characteristics of the estimates that the jobs have.
pub fn figure(kind: &OperatingCharacteristics, jobs: &[&JobRecord]) -> OperatingFigure {
    let sought = kind.find.as_ref().map(|find| find.power);
    let axis = kind.x.or(sought.map(|_| PEOPLE)).map(|axis| axis.to_string());
    // What follows from the axis, such as a zipped key, varies along it.
    let along = axis.as_ref().map_or_else(Vec::new, |axis| {
        let mut along = decided_by(axis, jobs);
        along.push(axis.clone());
        along
    });
    let along: Vec<&str> = along.iter().map(String::as_str).collect();
    let arms = arms(jobs, &along);
    let mut rows = Vec::new();
    for term in terms(jobs, &kind.estimates.0) {
        // An estimate can be declared for some agents alone.
        for arm in arms.iter().filter(|arm| has_estimate(arm, &term)) {
            let points: Vec<(Option<f64>, Vec<&JobRecord>)> = match &axis {
                Some(axis) if arm.jobs.iter().any(|job| job.number(axis).is_some()) => {
                    let points = by_value(axis, &arm.jobs).into_iter();
                    points.map(|(x, jobs)| (Some(x), jobs)).collect()
                }
                _ => vec![(None, arm.jobs.clone())],
            };
            rows.extend(points.into_iter().map(|(x, jobs)| row(arm, x, &jobs, &term)));
        }
    }
    let sought = sought.map(|power| (power, seek(&rows, power)));
    OperatingFigure { axis, rows, sought }
}

/// The terms of the chosen estimates, all if none is chosen, in order of first appearance.
fn terms(jobs: &[&JobRecord], chosen: &[String]) -> Vec<Term> {
    let estimates = jobs.iter().filter_map(|job| job.completed()).flat_map(|run| &run.estimates);
    let estimates =
        estimates.filter(|one| chosen.is_empty() || chosen.contains(&one.declaration.name));
    distinct(estimates.flat_map(|of| {
        of.terms.iter().map(|one| Term {
            estimate: of.declaration.name.clone(),
            term: one.term.clone(),
            outcome: of.declaration.outcome.clone(),
        })
    }))
}

/// Whether a trial of an arm has the estimate of a term.
fn has_estimate(arm: &Arm<'_>, term: &Term) -> bool {
    let mut runs = arm.jobs.iter().filter_map(|job| job.completed());
    runs.any(|run| run.estimates.iter().any(|one| one.declaration.name == term.estimate))
}

fn row(arm: &Arm<'_>, x: Option<f64>, jobs: &[&JobRecord], term: &Term) -> OperatingRow {
    let mut seen = HashSet::new();
    let (mut effects, mut failures, mut lacking) = (Vec::<Effect>::new(), Vec::new(), 0);
    let mut design = None;
    for job in jobs.iter().filter(|job| seen.insert(job.seed)) {
        let Some(run) = job.completed() else { continue };
        let of = run.estimates.iter().find(|one| one.declaration.name == term.estimate);
        let found = of.and_then(|of| of.terms.iter().find(|one| one.term == term.term));
        match found.map(|found| &found.effect) {
            Some(Ok(effect)) => effects.push(*effect),
            Some(Err(reason)) => failures.push(reason.clone()),
            None => lacking += 1,
        }
        design = design.or_else(|| {
            let of = of.filter(|of| of.terms.len() == 1 && term.term == CONSTANT)?;
            let people = job.number("trial.people")?;
            Some((people, of.declaration.numerator, of.declaration.control.len() + 1))
        });
    }
    let trials: Vec<TrialEstimate> = effects.iter().map(trial).collect();
    let mean =
        |value: fn(&Effect) -> f64| effects.iter().map(value).sum::<f64>() / effects.len() as f64;
    let design = design.filter(|_| !effects.is_empty()).map(|(people, numerator, controls)| {
        let decisions = mean(|effect| effect.decisions as f64) / people;
        // Estimates of earlier releases do not have it.
        let constant = numerator * (1.0 - numerator);
        let variances = effects.iter().map(|effect| effect.treatment_variance.unwrap_or(constant));
        let variance = variances.sum::<f64>() / effects.len() as f64;
        (decisions, mean(|effect| effect.residual_sd), variance, controls)
    });
    OperatingRow {
        name: arm.name.clone(),
        x,
        term: term.clone(),
        operating: Operating::of(&trials),
        failed: (failures.len(), failures.first().cloned()),
        lacking,
        design,
    }
}

fn trial(effect: &Effect) -> TrialEstimate {
    TrialEstimate {
        value: effect.value,
        standard_error: effect.standard_error,
        interval: Interval { low: effect.low, high: effect.high },
        truth: effect.truth,
    }
}

impl OperatingRow {
    /// The trial as the formula sees it, with the mean true effect, or the mean estimate where no truth is known.
    fn formula(&self, mean: f64) -> Option<Formula> {
        let (decisions, sd, treatment_variance, controls) = self.design?;
        let effect = self.operating.truth.map_or(mean, |truth| truth.value);
        Some(Formula { standardised_effect: effect / sd, decisions, treatment_variance, controls })
    }
}

/// What is found for each line along the number of people.
fn seek(rows: &[OperatingRow], power: f64) -> Vec<Sought> {
    let is_one_line = |one: &OperatingRow, next: &OperatingRow| {
        (&one.name, &one.term) == (&next.name, &next.term)
    };
    let line = |rows: &[OperatingRow]| {
        let at = |row: &OperatingRow| Some((row.x?, row.operating.power.ok()?));
        let powers: Vec<(f64, MonteCarloMean)> = rows.iter().filter_map(at).collect();
        let (first, last) = (powers.first()?, powers.last()?);
        let mut with_power = rows.iter().filter(|row| row.operating.power.is_ok());
        let trials = with_power.clone().map(|row| row.operating.trials).min()?;
        let most = with_power.next_back()?;
        let effect = most.operating.mean.ok().map(|mean| mean.value);
        let formula = effect.and_then(|effect| most.formula(effect)?.people(power));
        Some(Sought {
            name: rows[0].name.clone(),
            term: rows[0].term.clone(),
            simulated: if trials < FEW_TRIALS { None } else { sample_size(&powers, power) },
            formula,
            ends: [first, last].map(|(people, power)| (*people, power.value)),
            trials,
        })
    };
    rows.chunk_by(is_one_line).filter_map(line).collect()
}
