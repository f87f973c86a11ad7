//! What happened: the outcomes of runs as plain data.
//!
//! Training makes them, the store keeps them, analysis reads them. Nothing here computes.

mod job;

use std::fmt;

use crate::plan::JobKey;
pub use job::{CompletedRun, DataSet, JobRecord, JobStatus};

/// A named number about a completed run.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Name, one of [`METRICS`].
    pub name: &'static str,
    /// Finite value.
    pub value: f64,
}

/// Names and meanings of the metrics of a run; all are over its test episodes.
pub const METRICS: &[(&str, &str)] = &[
    ("mean_return", "mean undiscounted return, in steps walked"),
    ("sd_return", "standard deviation of the return (n - 1), in steps walked; 0 for one episode"),
    ("mean_length", "mean episode length, in steps of the simulation"),
    ("disengagement_rate", "share of episodes that ended in disengagement"),
    ("message_rate", "share of steps on which a message was sent (actions 1 to 3)"),
    (
        "mean_net_return",
        "mean undiscounted return less the cost of messages, in steps walked; absent where they cost nothing",
    ),
];

/// Names and meanings of what a learning curve records; each is over the training episodes since
/// the point before.
pub const CURVE_METRICS: &[(&str, &str)] = &[
    ("mean_return", "mean undiscounted return, in steps walked"),
    ("mean_length", "mean episode length, in steps of the simulation"),
    ("disengagement_rate", "share of episodes that ended in disengagement"),
    ("mean_loss", "mean loss of the updates made; absent where none was made"),
    ("epsilon", "exploration rate at the last of these episodes (DQN)"),
];

/// One value of a learning curve.
#[derive(Clone, Debug, PartialEq)]
pub struct CurvePoint {
    /// Training episodes finished, counted from 1.
    pub episode: u32,
    /// Name, one of [`CURVE_METRICS`].
    pub metric: &'static str,
    /// Finite value.
    pub value: f64,
}

/// One episode of the test, by its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TestEpisode {
    /// Undiscounted return, in steps walked.
    pub total_reward: f64,
    /// Steps of the simulation.
    pub length: u32,
    /// Whether it ended in disengagement.
    pub disengaged: bool,
}

/// A part of a job in which decisions are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Phase {
    /// The training.
    Train,
    /// The test of what was trained.
    Test,
}

/// One step of an episode: what was seen, done, with which probability, and what it paid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// Whether the episode is one of the training or of the test.
    pub phase: Phase,
    /// Episode of the phase, from 1.
    pub episode: u32,
    /// Steps taken in the episode before this one.
    pub step: u32,
    /// True context, 0 or 1.
    pub context: u8,
    /// Inferred probability as the letter P shows it, whether the agent saw it or not.
    pub probability: f64,
    /// Most likely context, 0 or 1.
    pub likely_context: u8,
    /// Habituation before the step, in [0, 1].
    pub habituation: f64,
    /// Disengagement risk before the step, in [0, 1].
    pub disengagement: f64,
    /// Whether a message could be sent.
    pub available: bool,
    /// Action, 0 to 3.
    pub action: u8,
    /// Probability with which the action was chosen, in (0, 1].
    pub action_probability: f64,
    /// Reward, in steps walked.
    pub reward: f64,
}

/// Bins of the probability of context 0 in [`ActionCount`].
pub const PROBABILITY_BINS: usize = 10;

/// How often an action was taken in the test episodes, by the inferred probability of context 0
/// (whether the agent saw it or not) and the true context.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ActionCount {
    /// Bin of the probability: `[bin / 10, (bin + 1) / 10)`, the last one closed.
    pub bin: u8,
    /// True context, 0 or 1.
    pub context: u8,
    /// Action, 0 to 3.
    pub action: u8,
    /// Times taken; never 0.
    pub count: u64,
}

/// Everything a completed training leaves behind. The same job always makes the same bits.
#[derive(Clone, Debug, PartialEq)]
pub struct Results {
    /// Summary numbers, each of [`METRICS`] at most once.
    pub metrics: Vec<Metric>,
    /// Learning curve, by episode; empty for an algorithm that does not train.
    pub curve: Vec<CurvePoint>,
    /// Test episodes, by position.
    pub episodes: Vec<TestEpisode>,
    /// Choices of action in the test, counts above 0 only.
    pub actions: Vec<ActionCount>,
    /// Decisions that the job asks to record, by phase, episode and step.
    pub decisions: Vec<Decision>,
    /// Trained weights, in the safetensors format; `None` for an algorithm that has none.
    pub weights: Option<Vec<u8>>,
}

/// Why a run failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FailureKind {
    /// The process that trained it crashed, again and again.
    Crashed,
    /// A loss or weight became infinite or not a number.
    Diverged,
    /// There was no memory for what it needed.
    OutOfMemory,
    /// It took longer than its declared time limit.
    OverTime,
    /// The training code panicked.
    Panicked,
}

impl FailureKind {
    /// Every kind.
    pub const ALL: [FailureKind; 5] = [
        FailureKind::Crashed,
        FailureKind::Diverged,
        FailureKind::OutOfMemory,
        FailureKind::OverTime,
        FailureKind::Panicked,
    ];

    /// The kind of this name.
    pub fn from_name(name: &str) -> Option<FailureKind> {
        FailureKind::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// The word the store and the command line use.
    pub fn name(self) -> &'static str {
        match self {
            FailureKind::Crashed => "crashed",
            FailureKind::Diverged => "diverged",
            FailureKind::OutOfMemory => "out_of_memory",
            FailureKind::OverTime => "over_time",
            FailureKind::Panicked => "panicked",
        }
    }
}

impl fmt::Display for FailureKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A failed run: kind, message, and where in the training it happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// What went wrong.
    pub kind: FailureKind,
    /// What was seen, for a person.
    pub message: String,
    /// Training episodes finished before it.
    pub episode: u32,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// Trained and tested to the end.
    Completed(Results),
    /// Ended by a fault of its own; the same job would fail the same way again.
    Failed(Failure),
    /// Stopped from outside before its end; nothing is wrong with the job.
    Interrupted,
}

/// What made a run: the code and the machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Provenance {
    /// Version of jitai, as in `Cargo.toml`.
    pub code_version: String,
    /// Git revision the program was built from, `-dirty` behind it where files had changed;
    /// `unknown` outside a repository.
    pub git_revision: String,
    /// Name and version of the tensor backend.
    pub backend: String,
    /// Host name.
    pub host: String,
    /// Processor model.
    pub processor: String,
}
