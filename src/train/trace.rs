//! A trial with what its agent saw, and when it learned from whom.
//!
//! In: what was observed of a trial, in its job or when it is simulated once more. Out: its decisions, each with the
//! agent's observation, and the updates of the agent. Analyses after a trial need both, and jobs do not store them.

use crate::job::{Decision, Job, UnknownFile};
use crate::train::observers::ObservedTrial;
use crate::train::sightings::{Sighting, Sightings};
use crate::train::study::TracedUpdate;

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
    /// A file of the job is unknown.
    #[error(transparent)]
    UnknownFile(#[from] UnknownFile),
    /// The simulation was stopped.
    #[error("the simulation was stopped")]
    Stopped,
    /// The agent cannot start, or the trial has failed.
    #[error("the trial failed: {0}")]
    Failed(String),
}

impl Trace {
    /// What was observed of the trial of a job.
    ///
    /// **Errors**: what its agent saw was not observed, as an outside program takes part in it.
    pub(super) fn of(job: &Job, observed: &ObservedTrial) -> Result<Trace, NoTrace> {
        let people = job.trial.as_ref().ok_or(NoTrace::NoTrial)?.people as usize;
        let Sightings { rows, updates, .. } =
            observed.sightings.as_ref().ok_or(NoTrace::Outside)?;
        let decisions = observed.decisions.iter().zip(rows).map(|(decision, row)| {
            assert_eq!((decision.episode, decision.step), (row.episode, row.step));
            let Sighting { time, observed, learned, .. } = row.clone();
            TracedDecision { decision: decision.clone(), time, observed, learned }
        });
        Ok(Trace { decisions: decisions.collect(), updates: updates.clone(), people })
    }
}
