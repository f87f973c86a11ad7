//! Standard errors of effects that account for an agent that learned from everybody.
//!
//! In: a job with a trial, and the declaration of an estimate. Out: the covariance of the estimated coefficients.
//!
//! The sums of data at each update and the estimate solve one stack of estimating equations, person by person, in which
//! the parts of a person are weighted by the ratio of the probabilities of the person's actions to what they were. The
//! sandwich of the stack has derivatives of these ratios by the sums of earlier updates, through which people depend on
//! each other. The equations of the sums are linear, so that the sandwich needs no matrix of all updates: `effect` below is
//! the derivative of the estimate's equations by the sums of an update, along all paths through later updates.
//!
//! **Source**: Zhang, Janson and Murphy, "Statistical inference after adaptive sampling for longitudinal data", arXiv
//! 2202.07098, 2022: the adaptive sandwich.

use std::sync::Arc;

use crate::agent::{BanditSums, LinearThompson, Made, NoSlopes, Unavailable};
use crate::env::Action;
use crate::estimate::{Correction, Estimation};
use crate::job::{EstimateDeclaration, Job, Pooling};
use crate::train::trace::{NoTrace, Trace, TracedDecision};

/// Why standard errors cannot account for the learning.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoAfterStudy {
    /// The agent is no bandit.
    #[error("they are supported only for `linear_thompson`")]
    Agent,
    /// Each person has an agent.
    #[error("each person has an agent (`pooling = \"none\"`), so that people are independent")]
    NotPooled,
    /// People share an agent, but not all the same coefficients.
    #[error("they are supported only for `pooling = \"full\"`")]
    PartlyPooled,
    /// The agent sees the time as a one-hot.
    #[error("they are not supported where the agent observes a one-hot of time")]
    OneHot,
    /// The outcome is not the reward.
    #[error("they are supported only for the outcome \"reward\"")]
    Outcome,
    /// The agent learns from choices that were not taken.
    #[error(
        "they are not supported where messages cannot always be sent with `unavailable = \"chosen\"`"
    )]
    Chosen,
    /// The probabilities of the agent have no derivatives.
    #[error(transparent)]
    Slopes(#[from] NoSlopes),
    /// The trial cannot be simulated once more.
    #[error(transparent)]
    Trace(#[from] NoTrace),
    /// The estimate has no number.
    #[error("the estimate has no number")]
    NoEstimate,
}

/// A trial of a bandit with what its updates know.
#[derive(Clone, Debug, PartialEq)]
pub struct BanditTrace {
    /// The trial.
    pub trace: Trace,
    /// The number of regressions of the bandit, and of the regressors of each.
    pub regressions: usize,
    /// See [`BanditTrace::regressions`].
    pub width: usize,
    /// The sums of the prior, \[sums\]: for each regression the lower triangle of the precision Λ, row by row, and Λm.
    pub prior: Vec<f64>,
    /// The sums of every update, \[updates, sums\].
    pub sums: Vec<Vec<f64>>,
}

impl BanditTrace {
    /// A trial with what the updates of its bandit know.
    ///
    /// **Errors**: see [`NoAfterStudy`].
    pub(super) fn of(job: &Job, trace: Trace) -> Result<BanditTrace, NoAfterStudy> {
        let sums = sums_of(job)?;
        check(job, &trace)?;
        let policies = Learning::new(&sums, &trace)?.policies;
        let (regressions, width) = sums.shape();
        Ok(BanditTrace { trace, regressions, width, prior: sums.prior(), sums: policies })
    }
}

/// Checks that the agent of a trial has learned from the actions that were taken.
fn check(job: &Job, trace: &Trace) -> Result<(), NoAfterStudy> {
    let is_masked = trace.decisions.iter().any(|one| !one.decision.can_send);
    let bandit = job.agent.parameters::<LinearThompson>();
    match bandit.is_some_and(|bandit| bandit.unavailable == Unavailable::Chosen) {
        true if is_masked => Err(NoAfterStudy::Chosen),
        _ => Ok(()),
    }
}

/// The sums of a job's bandit for the standard errors of an estimate.
///
/// **Errors**: see [`NoAfterStudy`]; the errors that do not depend on the trial.
pub(super) fn sums_for(
    job: &Job,
    declaration: &EstimateDeclaration,
) -> Result<BanditSums, NoAfterStudy> {
    if declaration.is_of_reward() { sums_of(job) } else { Err(NoAfterStudy::Outcome) }
}

/// The sums of a job's bandit.
pub(super) fn sums_of(job: &Job) -> Result<BanditSums, NoAfterStudy> {
    let bandit = job.agent.parameters::<LinearThompson>().ok_or(NoAfterStudy::Agent)?;
    match job.trial.as_ref().map(|trial| trial.pooling) {
        None | Some(Pooling::Full) => {}
        Some(Pooling::None) => return Err(NoAfterStudy::NotPooled),
        Some(Pooling::Partial | Pooling::Groups(_)) => return Err(NoAfterStudy::PartlyPooled),
    }
    let interface = job.task().interface();
    if interface.observations.one_hot > 0 {
        return Err(NoAfterStudy::OneHot);
    }
    Ok(BanditSums::new(&bandit, interface.observations.features.len(), interface.actions)?)
}

/// The covariance of the coefficients of an estimate, those of the control features included, \[columns, columns\].
///
/// **Errors**: see [`NoAfterStudy`].
pub(super) fn covariance(
    job: &Job,
    declaration: &Arc<EstimateDeclaration>,
    correction: Correction,
    trace: Result<&Trace, &NoTrace>,
) -> Result<Vec<f64>, NoAfterStudy> {
    let sums = sums_for(job, declaration)?;
    let trace = trace.map_err(Clone::clone)?;
    check(job, trace)?;
    let actions = job.task().interface().actions;
    let mut estimation = Estimation::new(declaration.clone(), actions, &job.state_names());
    trace.decisions.iter().for_each(|one| estimation.add(&one.decision));
    let mut scores = estimation.sums().scores(correction).map_err(|_| NoAfterStudy::NoEstimate)?;
    let rows = rows(&mut estimation, trace, &scores.coefficients);
    let learning = Learning::new(&sums, trace)?;
    let parts = learning.parts(trace, &rows, scores.coefficients.len());
    for (person, part) in parts.into_iter().enumerate() {
        match scores.of_people.iter_mut().find(|(known, _)| *known == person) {
            Some((_, score)) => score.iter_mut().zip(part).for_each(|(sum, more)| *sum += more),
            None => scores.of_people.push((person, part)),
        }
    }
    Ok(scores.covariance())
}

/// The part of a decision in the equations of the estimate, and the actions whose probability is in its weight.
struct Row {
    /// Weight times row times residual, \[columns\].
    score: Vec<f64>,
    /// 1 / p for each action of the treatment that was taken, of probability p together, \[actions\].
    compared: Vec<f64>,
}

/// The rows of the decisions that the estimate uses; `None` for others.
fn rows(estimation: &mut Estimation, trace: &Trace, coefficients: &[f64]) -> Vec<Option<Row>> {
    let row = |one: &TracedDecision| {
        let decision = &one.decision;
        let compared = estimation.compared(decision)?;
        let reward = decision.reward_for(estimation.declaration());
        let (weight, row) = estimation.weighted_row(decision)?;
        let explained: f64 = row.iter().zip(coefficients).map(|(one, other)| one * other).sum();
        let residual = weight * (reward - explained);
        Some(Row { score: row.iter().map(|value| value * residual).collect(), compared })
    };
    trace.decisions.iter().map(row).collect()
}

/// The sums of the updates of a trial, and how probabilities depend on them.
struct Learning<'l> {
    sums: &'l BanditSums,
    /// The parts of each person in the equations of the sums of each update, \[updates, people, sums\].
    parts: Vec<Vec<Vec<f64>>>,
    /// The derivatives of the log probabilities of each person's actions under each policy, summed, in the same shape.
    slopes: Vec<Vec<Vec<f64>>>,
    /// For each decision: its features, and the number of the update whose policy it follows, from 0; `None` before the
    /// first update, or where the agent does not choose.
    seen: Vec<(Vec<f64>, Option<usize>)>,
    policies: Vec<Vec<f64>>,
}

impl<'l> Learning<'l> {
    /// **Errors**: a precision is not positive definite.
    fn new(sums: &'l BanditSums, trace: &Trace) -> Result<Self, NoSlopes> {
        let seen = |one: &TracedDecision| {
            let updates = trace.updates.iter().filter(|update| update.time <= one.time).count();
            let policy = updates.checked_sub(1).filter(|_| one.decision.can_send);
            (sums.features(&one.observed), policy)
        };
        let seen = trace.decisions.iter().map(seen).collect();
        let mut learning =
            Learning { sums, parts: Vec::new(), slopes: Vec::new(), seen, policies: Vec::new() };
        for update in 0..trace.updates.len() {
            learning.add_update(trace, update);
        }
        learning.slopes = vec![vec![vec![0.0; sums.count()]; trace.people]; trace.updates.len()];
        learning.add_slopes(trace)?;
        Ok(learning)
    }

    /// The reward of a decision in the data of an update; `None` if the decision is not in them.
    fn counted(trace: &Trace, update: usize, one: &TracedDecision) -> Option<f64> {
        let update = &trace.updates[update];
        let counts = one.decision.can_send
            && one.time < update.before
            && update.people[one.decision.episode as usize - 1];
        one.learned.filter(|_| counts)
    }

    /// Adds the parts of the people in an update, and its sums.
    fn add_update(&mut self, trace: &Trace, update: usize) {
        let mut parts = vec![vec![0.0; self.sums.count()]; trace.people];
        let mut has_data = vec![false; trace.people];
        for (one, (features, _)) in trace.decisions.iter().zip(&self.seen) {
            if let Some(reward) = Learning::counted(trace, update, one) {
                let person = one.decision.episode as usize - 1;
                has_data[person] = true;
                self.sums.add(made(one, features), reward, &mut parts[person]);
            }
        }
        let mut total = vec![0.0; self.sums.count()];
        for part in &parts {
            total.iter_mut().zip(part).for_each(|(sum, one)| *sum += one);
        }
        // The equations of the people who have data share the rest.
        let people = has_data.iter().filter(|has| **has).count().max(1) as f64;
        for (part, _) in parts.iter_mut().zip(&has_data).filter(|(_, has)| **has) {
            part.iter_mut().zip(&total).for_each(|(one, all)| *one -= all / people);
        }
        self.parts.push(parts);
        let prior = self.sums.prior();
        self.policies.push(prior.iter().zip(&total).map(|(prior, data)| prior + data).collect());
    }

    fn add_slopes(&mut self, trace: &Trace) -> Result<(), NoSlopes> {
        for (update, sums) in self.policies.iter().enumerate() {
            let mut policy = self.sums.policy(sums)?;
            let follows =
                |(_, seen): &(&TracedDecision, &(Vec<f64>, Option<usize>))| seen.1 == Some(update);
            for (one, (features, _)) in trace.decisions.iter().zip(&self.seen).filter(follows) {
                let action = usize::from(one.decision.action);
                let mut weights = vec![0.0; one.decision.probabilities.len()];
                weights[action] = 1.0 / one.decision.probabilities[action];
                let person = one.decision.episode as usize - 1;
                policy.add_slopes(features, &weights, &mut self.slopes[update][person]);
            }
        }
        Ok(())
    }

    /// The part of every person in the estimate by way of the learning, \[people, columns\].
    fn parts(&self, trace: &Trace, rows: &[Option<Row>], columns: usize) -> Vec<Vec<f64>> {
        let mut of_people = vec![vec![0.0; columns]; trace.people];
        let mut effects: Vec<Vec<f64>> =
            (0..self.policies.len()).map(|at| self.direct(trace, rows, at, columns)).collect();
        for update in (0..effects.len()).rev() {
            let (earlier, rest) = effects.split_at_mut(update);
            let effect = &rest[0];
            for (person, part) in self.parts[update].iter().enumerate() {
                let through = product(effect, part);
                of_people[person].iter_mut().zip(&through).for_each(|(sum, one)| *sum += one);
                for (effect, slopes) in earlier.iter_mut().zip(&self.slopes) {
                    add_outer(effect, &through, &slopes[person]);
                }
            }
            self.add_regressors(trace, update, effect, earlier);
        }
        of_people
    }

    /// The derivative of the equations of the estimate by the sums of an update, through the policy that follows it,
    /// \[columns, sums\].
    fn direct(
        &self,
        trace: &Trace,
        rows: &[Option<Row>],
        update: usize,
        columns: usize,
    ) -> Vec<f64> {
        let mut effect = vec![0.0; columns * self.sums.count()];
        let mut scores = vec![vec![0.0; columns]; trace.people];
        for (one, row) in trace.decisions.iter().zip(rows) {
            let Some(row) = row else { continue };
            let score = &mut scores[one.decision.episode as usize - 1];
            score.iter_mut().zip(&row.score).for_each(|(sum, value)| *sum += value);
        }
        for (score, slopes) in scores.iter().zip(&self.slopes[update]) {
            add_outer(&mut effect, score, slopes);
        }
        // The weight of a decision has the probability in the denominator.
        let mut policy = self.sums.policy(&self.policies[update]).expect("it was factored before");
        for (row, (features, follows)) in rows.iter().zip(&self.seen) {
            if let (Some(row), true) = (row, *follows == Some(update)) {
                let mut slopes = vec![0.0; self.sums.count()];
                policy.add_slopes(features, &row.compared, &mut slopes);
                slopes.iter_mut().for_each(|slope| *slope = -*slope);
                add_outer(&mut effect, &row.score, &slopes);
            }
        }
        effect
    }

    /// Adds what the sums of an update owe to probabilities under earlier policies that stand in regressors.
    fn add_regressors(
        &self,
        trace: &Trace,
        update: usize,
        effect: &[f64],
        earlier: &mut [Vec<f64>],
    ) {
        for (policy, earlier) in earlier.iter_mut().enumerate() {
            let mut smooth =
                self.sums.policy(&self.policies[policy]).expect("it was factored before");
            for (one, (features, follows)) in trace.decisions.iter().zip(&self.seen) {
                let reward = Learning::counted(trace, update, one);
                let Some(reward) = reward.filter(|_| *follows == Some(policy)) else { continue };
                let mut slope = vec![0.0; self.sums.count()];
                self.sums.add_slope(made(one, features), reward, &mut slope);
                if slope.iter().all(|value| *value == 0.0) {
                    return;
                }
                let mut of_action = vec![0.0; self.sums.count()];
                smooth.add_slopes(features, &[0.0, 1.0], &mut of_action);
                add_outer(earlier, &product(effect, &slope), &of_action);
            }
        }
    }
}

/// A decision as the bandit learns from it.
fn made<'d>(one: &'d TracedDecision, features: &'d [f64]) -> Made<'d> {
    Made {
        features,
        probabilities: &one.decision.probabilities,
        action: Action::from_index(one.decision.action.into()).unwrap_or_default(),
    }
}

/// The product of a matrix, row by row, and a vector.
fn product(matrix: &[f64], vector: &[f64]) -> Vec<f64> {
    let rows = matrix.chunks_exact(vector.len());
    rows.map(|row| row.iter().zip(vector).map(|(one, other)| one * other).sum()).collect()
}

/// Adds the outer product of two vectors to a matrix, row by row.
fn add_outer(matrix: &mut [f64], left: &[f64], right: &[f64]) {
    for (row, one) in matrix.chunks_exact_mut(right.len()).zip(left) {
        row.iter_mut().zip(right).for_each(|(sum, other)| *sum += one * other);
    }
}
