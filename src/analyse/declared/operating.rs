//! Operating characteristics: how estimates behave over the trials of an arm, and how many people a trial needs.

use std::collections::HashSet;

use super::arm::{Arm, ArmId, arms, by_value, decided_by};
use crate::analyse::{
    Along, Crossing, Formula, Interval, MonteCarloMean, Operating, TrialEstimate, crossing,
};
use crate::job::{CONSTANT, Effect, Estimator, distinct};
use crate::manifest::Find;
use crate::manifest::kind::OperatingCharacteristics;
use crate::record::JobRecord;

/// The operating characteristics of the estimates of some arms.
#[derive(Clone, Debug, PartialEq)]
pub struct OperatingFigure {
    /// Dotted name of the horizontal axis; `None` without a figure.
    pub axis: Option<String>,
    /// One row per term, arm and point on the axis, by term and arm.
    pub rows: Vec<OperatingRow>,
    /// What is sought, and what was found for each line; `None` if nothing is sought.
    pub sought: Option<(Find, Vec<Sought>)>,
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
    /// The estimates of completed trials, by seed; of a failed one, the reason.
    pub trials: Vec<Result<Effect, String>>,
    /// The diagnosands of the analysis by name, which whoever has the store computes from the trials.
    pub diagnosands: Vec<(String, Diagnosand)>,
    /// Completed trials whose estimate is not computed yet.
    pub lacking: usize,
    /// `None` without an estimate, for several coefficients, and for other estimators than least squares, of which alone the
    /// formula is.
    design: Option<Design>,
}

/// A trial as its estimates see it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Design {
    people: f64,
    /// The mean number of decisions per person that the estimate uses.
    decisions: f64,
    /// The mean residual standard deviation.
    residual_sd: f64,
    /// The mean p (1 - p) of the treatment.
    treatment_variance: f64,
    /// The number of coefficients of the control model.
    controls: usize,
}

/// A number of the user's own; what is missing has a reason.
pub type Diagnosand = Result<MonteCarloMean, String>;

/// Below this number of trials at a point, a power is too uncertain to seek where it is reached.
pub const FEW_TRIALS: usize = 20;

/// Where a power is reached along the number of people, or along a parameter of the effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Sought {
    /// The arm, without the number of people, or the parameter, among its settings.
    pub name: ArmId,
    /// The term.
    pub term: Term,
    /// The value by simulation; `None` if the power is not reached between the simulated values, or with fewer than
    /// [`FEW_TRIALS`] trials.
    pub simulated: Option<Crossing>,
    /// The true effect there, of which the ends are those at the ends of the interval; `None` along people, and where it is
    /// not simulated.
    pub truth: Option<Crossing>,
    /// The number of people by the formula of Liao and others, or the effect; `None` where it does not apply.
    pub formula: Option<f64>,
    /// The first and the last simulated value, each with its power.
    pub ends: [(f64, f64); 2],
    /// The fewest trials from which a power is computed.
    pub trials: usize,
}

impl Sought {
    /// Whether the formula's number lies outside the interval of the simulated one.
    pub fn differs(&self, along: Along) -> bool {
        let (found, whole): (_, fn(f64) -> f64) = match along {
            Along::People => (self.simulated, f64::ceil),
            Along::Effect => (self.truth, std::convert::identity),
        };
        let Some((found, formula)) = found.zip(self.formula) else { return false };
        found.low.is_some_and(|low| formula < whole(low))
            || found.high.is_some_and(|high| formula > whole(high))
    }
}

/// The operating characteristics of the estimates that the jobs have.
pub fn figure(kind: &OperatingCharacteristics, jobs: &[&JobRecord]) -> OperatingFigure {
    let axis = kind.x.or(kind.find.map(|find| find.along())).map(|axis| axis.to_string());
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
    let sought = kind.find.map(|find| (find, seek(&rows, find)));
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
    let (mut trials, mut lacking) = (Vec::new(), 0);
    let mut design = None;
    for job in jobs.iter().filter(|job| seen.insert(job.seed)) {
        let Some(run) = job.completed() else { continue };
        let of = run.estimates.iter().find(|one| one.declaration.name == term.estimate);
        let found = of.and_then(|of| of.terms.iter().find(|one| one.term == term.term));
        match found.map(|found| &found.effect) {
            Some(effect) => trials.push(effect.clone()),
            None => lacking += 1,
        }
        design = design.or_else(|| {
            let of = of.filter(|of| of.terms.len() == 1 && term.term == CONSTANT)?;
            let of = Some(of).filter(|of| of.declaration.estimator == Estimator::Wcls)?;
            let people = job.number("trial.people")?;
            Some((people, of.declaration.numerator, of.declaration.control.len() + 1))
        });
    }
    let effects: Vec<Effect> = trials.iter().flatten().copied().collect();
    let mean =
        |value: fn(&Effect) -> f64| effects.iter().map(value).sum::<f64>() / effects.len() as f64;
    let design = design.filter(|_| !effects.is_empty()).map(|(people, numerator, controls)| {
        let decisions = mean(|effect| effect.decisions as f64) / people;
        // Estimates of earlier releases do not have it.
        let constant = numerator * (1.0 - numerator);
        let variances = effects.iter().map(|effect| effect.treatment_variance.unwrap_or(constant));
        let treatment_variance = variances.sum::<f64>() / effects.len() as f64;
        let residual_sd = mean(|effect| effect.residual_sd);
        Design { people, decisions, residual_sd, treatment_variance, controls }
    });
    OperatingRow {
        name: arm.name.clone(),
        x,
        term: term.clone(),
        operating: Operating::of(&effects.iter().map(trial).collect::<Vec<_>>()),
        trials,
        diagnosands: Vec::new(),
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
    /// The reasons of the completed trials whose estimate failed.
    pub fn failures(&self) -> impl Iterator<Item = &String> {
        self.trials.iter().filter_map(|trial| trial.as_ref().err())
    }

    /// The trial as the formula sees it, with the mean true effect, or the mean estimate where no truth is known.
    fn formula(&self) -> Option<Formula> {
        let Design { decisions, residual_sd, treatment_variance, controls, .. } = self.design?;
        let operating = &self.operating;
        let effect = operating.truth.or(operating.mean).ok()?.value;
        let standardised_effect = effect / residual_sd;
        Some(Formula { standardised_effect, decisions, treatment_variance, controls })
    }

    /// The effect that the formula gives for a power, of the sign of the mean effect.
    fn least_effect(&self, power: f64) -> Option<f64> {
        let (design, formula) = (self.design?, self.formula()?);
        let size = formula.effect(design.people as u32, power)? * design.residual_sd;
        Some(size.copysign(formula.standardised_effect))
    }
}

/// What is found for each line.
fn seek(rows: &[OperatingRow], find: Find) -> Vec<Sought> {
    let is_one_line = |one: &OperatingRow, next: &OperatingRow| {
        (&one.name, &one.term) == (&next.name, &next.term)
    };
    rows.chunk_by(is_one_line).filter_map(|rows| seek_along(rows, find)).collect()
}

/// What is found along a line.
fn seek_along(rows: &[OperatingRow], find: Find) -> Option<Sought> {
    let along = if find.effect.is_some() { Along::Effect } else { Along::People };
    let mut with_power: Vec<(f64, MonteCarloMean, &OperatingRow)> =
        rows.iter().filter_map(|row| Some((row.x?, row.operating.power.ok()?, row))).collect();
    // Effects below 0 are larger the further they are from 0.
    let is_below = with_power.iter().all(|(x, _, _)| *x <= 0.0);
    if is_below {
        with_power.reverse();
        with_power.iter_mut().for_each(|(x, _, _)| *x = -*x);
    }
    let sign = if is_below { -1.0 } else { 1.0 };
    let (first, last) = (with_power.first()?, with_power.last()?);
    let trials = with_power.iter().map(|(_, _, row)| row.operating.trials).min()?;
    let powers: Vec<(f64, MonteCarloMean)> =
        with_power.iter().map(|(x, power, _)| (*x, *power)).collect();
    let found = crossing(&powers, find.power, along).filter(|_| trials >= FEW_TRIALS);
    let truths = with_power.iter().map(|(x, _, row)| Some((*x, row.operating.truth.ok()?.value)));
    let truths: Option<Vec<(f64, f64)>> = truths.collect();
    let truth = match (along, found, truths) {
        (Along::Effect, Some(found), Some(truths)) => of_truths(found, &truths),
        _ => None,
    };
    let formula = match along {
        Along::People => {
            last.2.formula().and_then(|formula| formula.people(find.power)).map(f64::from)
        }
        Along::Effect => last.2.least_effect(find.power),
    };
    let signed = |found: Crossing| Crossing {
        at: sign * found.at,
        low: found.low.map(|end| sign * end),
        high: found.high.map(|end| sign * end),
    };
    Some(Sought {
        name: rows[0].name.clone(),
        term: rows[0].term.clone(),
        simulated: found.map(signed),
        truth,
        formula,
        ends: [first, last].map(|(x, power, _)| (sign * x, power.value)),
        trials,
    })
}

/// The true effects where a power is reached, between those of simulated values.
fn of_truths(found: Crossing, truths: &[(f64, f64)]) -> Option<Crossing> {
    let at = |x: f64| {
        let pair = truths.windows(2).find(|pair| pair[0].0 <= x && x <= pair[1].0)?;
        let part = (x - pair[0].0) / (pair[1].0 - pair[0].0);
        Some(pair[0].1 + part * (pair[1].1 - pair[0].1))
    };
    let (mut low, mut high) = (found.low.and_then(at), found.high.and_then(at));
    let middle = at(found.at)?;
    // Where a larger value of the parameter means an effect below.
    if low.is_some_and(|low| low > middle) || high.is_some_and(|high| high < middle) {
        std::mem::swap(&mut low, &mut high);
    }
    Some(Crossing { at: middle, low, high })
}
