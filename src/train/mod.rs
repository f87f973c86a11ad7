//! One job, from its declaration to its outcome.
//!
//! In: a [`Job`] and a [`Monitor`] to report to. Out: an [`Outcome`] that depends on the job and
//! the code alone. It knows no database, no worker and no other job.

mod curve;
mod roll;
mod test;

use crate::agent::{self, Learner, Span, Start, TrainedEpisode};
use crate::env::Observer;
use crate::plan::Job;
use crate::record::{CurvePoint, Failure, FailureKind, Outcome, Results};

use curve::CurveRecorder;

pub use roll::{Chooser, TestStreams, Watch, roll};

/// How far a training has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Training episodes finished.
    pub episode: u32,
    /// Training episodes in all.
    pub episodes: u32,
    /// Mean return of the last hundred episodes or fewer, in steps walked.
    pub recent_return: f64,
}

/// Whom a training reports to, and who may stop it.
pub trait Monitor {
    /// Hears how far it has come, after every span of the learner: an episode, or an update.
    fn report(&self, progress: Progress);

    /// Whether the training should end at the next occasion, without a result.
    fn stop_requested(&self) -> bool;
}

/// A monitor that nobody watches.
#[derive(Clone, Copy, Debug)]
pub struct Unwatched;

impl Monitor for Unwatched {
    fn report(&self, _: Progress) {}

    fn stop_requested(&self) -> bool {
        false
    }
}

/// Trains the job's agent, tests it, and returns what came out.
pub fn run(job: &Job, monitor: &dyn Monitor) -> Outcome {
    let start = agent::start(&job.agent, &job.environment, &job.scenario, job.seed);
    let mut learner = match start {
        Start::Learner(learner) => learner,
        Start::Rule(rule) => {
            return tested(job, Chooser::Rule(rule), monitor, Learnt::default());
        }
    };
    let mut curve = CurveRecorder::new(job.evaluation.curve_stride);
    match train(job, learner.as_mut(), &mut curve, monitor) {
        Ended::Trained => {}
        Ended::Stopped => return Outcome::Interrupted,
        Ended::Failed(failure) => return Outcome::Failed(failure),
    }
    let weights = learner.weights();
    if !weights.are_finite() {
        return Outcome::Failed(Failure {
            kind: FailureKind::Diverged,
            message: "a weight is infinite or not a number after training".to_owned(),
            episode: job.agent.episodes(),
        });
    }
    let policy = learner.policy(job.evaluation.test_actions.into());
    let chooser = Chooser::trained(policy, Observer::new(&job.environment, &job.scenario));
    let learnt = Learnt { curve: curve.finish(), weights: Some(weights.to_bytes()) };
    tested(job, chooser, monitor, learnt)
}

/// What training leaves behind; nothing, for a rule.
#[derive(Default)]
struct Learnt {
    curve: Vec<CurvePoint>,
    weights: Option<Vec<u8>>,
}

/// Tests who chooses, and completes the job.
fn tested(job: &Job, chooser: Chooser, monitor: &dyn Monitor, learnt: Learnt) -> Outcome {
    let Some(tested) = test::run(job, chooser, monitor) else {
        return Outcome::Interrupted;
    };
    Outcome::Completed(Results {
        metrics: tested.metrics(),
        curve: learnt.curve,
        episodes: tested.episodes,
        actions: tested.actions,
        weights: learnt.weights,
    })
}

enum Ended {
    Trained,
    Stopped,
    Failed(Failure),
}

fn train(
    job: &Job,
    learner: &mut dyn Learner,
    curve: &mut CurveRecorder,
    monitor: &dyn Monitor,
) -> Ended {
    let episodes = job.agent.episodes();
    let mut finished: Vec<TrainedEpisode> = Vec::new();
    while curve.episodes() < episodes {
        match learner.advance(&mut finished, &|| monitor.stop_requested()) {
            Ok(Span::Whole) => {}
            Ok(Span::BrokenOff) => return Ended::Stopped,
            Err(diverged) => {
                return Ended::Failed(Failure {
                    kind: FailureKind::Diverged,
                    message: diverged.to_string(),
                    episode: curve.episodes(),
                });
            }
        }
        finished.drain(..).for_each(|episode| curve.add(&episode));
        monitor.report(Progress {
            episode: curve.episodes(),
            episodes,
            recent_return: curve.recent_return(),
        });
    }
    Ended::Trained
}
