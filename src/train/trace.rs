//! A trial that is simulated once more, with what its agent saw, and when it learned from whom.
//!
//! In: a job with a trial. Out: its decisions, as if they had been recorded, each with the agent's observation, and the
//! updates of the agent. Analyses after a trial need both, and jobs do not store them.

use crate::job::{Decision, Failure, Job, RecordedDecisions};
use crate::train::sightings::{Sighting, Sightings, TracedUpdate};
use crate::train::training::{Stage, Training};

/// A trial with all that its agent saw.
#[derive(Clone, Debug, PartialEq)]
pub struct Trace {
    /// The decisions, by person and step.
    pub decisions: Vec<TracedDecision>,
    /// The updates of the agent of everybody, in order.
    pub updates: Vec<TracedUpdate>,
    /// The number of people.
    pub people: usize,
}

/// A decision with what the agent saw of it.
#[derive(Clone, Debug, PartialEq)]
pub struct TracedDecision {
    /// The decision as it is recorded; its episode is the number of the person, from 1.
    pub decision: Decision,
    /// The step of the trial, from 0.
    pub time: u32,
    /// The features that the agent observed, \[letters\].
    pub observed: Vec<f64>,
    /// The reward from which the agent learns, which may differ from the outcome that is recorded; `None` where it did not
    /// reach the agent.
    pub learned: Option<f64>,
}

/// Why a trial cannot be simulated once more.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum NoTrace {
    /// The job has no trial.
    #[error("it is not a trial; declare [trial]")]
    NoTrial,
    /// The agent or the environment is an outside program.
    #[error("an outside program takes part in it, which jitai does not start for an analysis")]
    Outside,
    /// The simulation was stopped.
    #[error("the simulation was stopped")]
    Stopped,
    /// The agent cannot start, or the trial has failed.
    #[error("the trial failed: {0}")]
    Failed(String),
}

/// The trial of a job, simulated once more until `stop` returns true.
///
/// **Errors**: see [`NoTrace`].
pub fn trace(job: &Job, stop: &dyn Fn() -> bool) -> Result<Trace, NoTrace> {
    let people = job.trial.as_ref().ok_or(NoTrace::NoTrial)?.people as usize;
    if job.is_outside() {
        return Err(NoTrace::Outside);
    }
    let mut job = job.clone();
    job.evaluation.record_decisions = RecordedDecisions::Test;
    let failed = |failure: Failure| NoTrace::Failed(failure.message);
    let training = Training::new(&job).map_err(|error| NoTrace::Failed(error.to_string()))?;
    let mut training = training.with_sightings(Sightings::default());
    while training.stage() != Stage::Over {
        training.advance(stop).map_err(failed)?;
        if stop() {
            return Err(NoTrace::Stopped);
        }
    }
    let (decisions, sightings) = training.into_sightings();
    let Sightings { mut rows, updates, .. } = sightings;
    rows.sort_unstable_by_key(|row| (row.episode, row.step));
    let decisions = decisions.into_iter().zip(rows).map(|(decision, row)| {
        assert_eq!((decision.episode, decision.step), (row.episode, row.step));
        let Sighting { time, observed, learned, .. } = row;
        TracedDecision { decision, time, observed, learned }
    });
    Ok(Trace { decisions: decisions.collect(), updates, people })
}
