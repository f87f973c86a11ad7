//! The outcomes of runs as plain data.
//!
//! Training creates them, the store keeps them, and analysis reads them. Nothing here computes.

use std::fmt;

use super::{Estimates, MetricName, ParticipantRange};
use crate::agent::features_of_state;
use crate::key::choices;

/// A named number about a completed run.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Its name.
    pub name: MetricName,
    /// Finite value.
    pub value: f64,
}

/// The result of a job in a comparison of jobs by one metric.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Score {
    /// The job has not ended.
    Open,
    /// The job failed, or ended without a finite value.
    Lost,
    /// The value of the metric.
    Value(f64),
}

/// One value of a learning curve.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CurvePoint {
    /// Training episodes finished, counted from 1.
    pub episode: u32,
    /// The metric, one of the metrics of learning curves.
    pub metric: MetricName,
    /// Finite value.
    pub value: f64,
}

/// One episode of the test, by its position.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TestEpisode {
    /// Undiscounted return.
    pub total_reward: f64,
    /// Number of steps.
    pub length: u32,
    /// Whether it was terminated, and not cut off at the horizon.
    pub terminated: bool,
}

/// A phase of a job in which decisions are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// The training.
    #[default]
    Train,
    /// The test of the trained agent.
    Test,
}

/// One step of an episode: observation, action with its probability, and reward.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decision {
    /// Whether the episode belongs to the training or to the test.
    pub phase: Phase,
    /// Episode of the phase, from 1.
    pub episode: u32,
    /// Steps taken in the episode before this one.
    pub step: u32,
    /// The state before the step: one number for each of [`Results::state_names`].
    pub state: Box<[f64]>,
    /// Whether a message could be sent, apart from the budget of messages.
    pub available: bool,
    /// Whether a message could be sent; where it could not, the action taken is 0.
    pub can_send: bool,
    /// Number of the action that the agent chose.
    pub chosen: u8,
    /// Number of the action taken.
    pub action: u8,
    /// Probabilities of all actions when the agent chose. All but the chosen action's are NaN where only
    /// this one is known.
    pub probabilities: Box<[f64]>,
    /// Reward.
    pub reward: f64,
    /// Whether the episode ended with this step in a terminal state.
    pub terminated: bool,
    /// Whether the episode was cut off after this step, and not by the end of the training.
    pub truncated: bool,
}

impl Decision {
    /// The probability with which the action was taken, in (0, 1]: 1 where no message could be sent.
    pub fn action_probability(&self) -> f64 {
        if self.can_send { self.probabilities[usize::from(self.action)] } else { 1.0 }
    }
}

/// The value of a parameter of a participant. A participant takes part in one episode.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ParticipantValue {
    /// Whether the episode belongs to the training or to the test.
    pub phase: Phase,
    /// Episode of the phase, from 1.
    pub episode: u32,
    /// The parameter, by its place; see [`crate::env::ParticipantSampler`].
    pub parameter: u8,
    /// Finite value.
    pub value: f64,
}

/// The posterior of the effect of a message after an update of a trial.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedPosterior {
    /// The number of the update, from 1.
    pub update: u32,
    /// The number of steps of the trial before the update.
    pub step: u32,
    /// The message: the number of an action above 0.
    pub action: u8,
    /// The means of the coefficients of the effect, \[features\]; the first is the intercept.
    pub mean: Vec<f64>,
    /// Their covariances, \[features, features\].
    pub covariance: Vec<f64>,
}

impl RecordedPosterior {
    /// The posterior mean of the effect in a state, divided by its standard deviation; `None` if the agent does not see
    /// states of this length.
    pub fn standardised_effect(&self, state: &[f64]) -> Option<f64> {
        let features = features_of_state(state, self.mean.len())?;
        let product =
            |row: &[f64]| row.iter().zip(&features).map(|(one, other)| one * other).sum::<f64>();
        let rows = self.covariance.chunks_exact(features.len()).map(product);
        let variance = product(&rows.collect::<Vec<_>>());
        Some(product(&self.mean) / variance.sqrt())
    }
}

/// How often an action was taken in the test episodes, by the stratum of the decision.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActionCount {
    /// The stratum, from 0; `None` in a family without strata.
    pub stratum: Option<u8>,
    /// Number of the action.
    pub action: u8,
    /// The number of times the action was taken; at least 1.
    pub count: u64,
}

/// All results of a completed run. The same job always gives bit-identical results.
#[derive(Clone, Debug, PartialEq)]
pub struct Results {
    /// Summary metrics, each at most once.
    pub metrics: Vec<Metric>,
    /// Learning curve, by episode; empty for an algorithm that does not train.
    pub curve: Vec<CurvePoint>,
    /// Test episodes, by position.
    pub episodes: Vec<TestEpisode>,
    /// Choices of action in the test; only counts above 0.
    pub actions: Vec<ActionCount>,
    /// How the environment described itself; see [`crate::env::Model::description`].
    pub description: Option<String>,
    /// The names of the numbers in the state of a decision.
    pub state_names: Vec<String>,
    /// Recorded decisions, by phase, episode and step; empty unless the job asks for them.
    pub decisions: Vec<Decision>,
    /// Parameters in which participants differ, by phase, episode and place. Parameters of the
    /// training are included if its decisions are recorded.
    pub participants: Vec<ParticipantValue>,
    /// What was learned at the updates of a trial, by update and action; empty unless the job asks for it.
    pub posteriors: Vec<RecordedPosterior>,
    /// Trained weights in the safetensors format; `None` for an algorithm without weights.
    pub weights: Option<Vec<u8>>,
    /// The estimates that were asked for. They are no part of the digest of results.
    pub estimates: Vec<Estimates>,
}

impl Results {
    /// The value of a summary metric; NaN without it.
    pub fn metric(&self, name: &str) -> f64 {
        self.metrics.iter().find(|metric| metric.name == name).map_or(f64::NAN, |m| m.value)
    }
}

/// A part of the results of runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum DataPart {
    /// A metric.
    Metric(MetricName),
    /// The learning curve of the mean return.
    LearningCurve,
    /// Choices of action.
    ActionChoice,
    /// Returns of the test episodes.
    Returns,
    /// Estimates of causal effects.
    Estimates,
    /// What was learned at the updates of trials.
    Posteriors,
    /// Test episodes of some participants.
    Participants(ParticipantRange),
}

choices! {
    /// Why a run failed.
    pub enum FailureKind {
        /// The process that trained the job crashed repeatedly.
        Crashed = "crashed",
        /// A loss or weight became infinite or NaN.
        Diverged = "diverged",
        /// The outside program did not start, ended early or broke the protocol.
        External = "external",
        /// There was not enough memory.
        OutOfMemory = "out_of_memory",
        /// The run exceeded its declared time limit.
        OverTime = "over_time",
        /// The training code panicked.
        Panicked = "panicked",
    }
}

impl fmt::Display for FailureKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

/// A failed run: its kind, its message, and the progress of training.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The kind of failure.
    pub kind: FailureKind,
    /// The message for the user.
    pub message: String,
    /// Training episodes finished before the failure.
    pub episode: u32,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a process holds few outcomes at a time")]
pub enum Outcome {
    /// Training and test were completed.
    Completed(Results),
    /// A fault of the job ended the run; the same fault would recur.
    Failed(Failure),
    /// The run was stopped from outside; the job itself is sound.
    Interrupted,
}

/// The code and the machine that produced a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// Version of jitai, as in `Cargo.toml`.
    pub code_version: String,
    /// Git revision of the build, with the suffix `-dirty` if files had changed; `unknown` outside a
    /// repository.
    pub git_revision: String,
    /// Name and version of the tensor backend.
    pub backend: String,
    /// Host name.
    pub host: String,
    /// Processor model.
    pub processor: String,
}
