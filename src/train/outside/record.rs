//! The training of an outside program, as jitai counts and records it.

use crate::agent::{OutOfMemory, TrainedEpisode};
use crate::external::{OwnEpisodes, ProgramError, Update};
use crate::job::{Failure, FailureKind, MetricName, Outcome, Phase, Results};
use crate::job::{Job, counted};
use crate::train::control::TrainingControl;
use crate::train::curve::CurveRecorder;
use crate::train::decision_log::DecisionLog;
use crate::train::progress::TrainingProgress;
use crate::train::test::{Test, Tested};
use crate::train::training::assemble;

use super::broken::Broken;

/// The record of a training's episodes.
pub(super) struct TrainingRecord<'j> {
    job: &'j Job,
    pub(super) control: &'j dyn TrainingControl,
    /// The number of training episodes begun, including reported ones; never above the budget.
    begun: u32,
    curve: CurveRecorder,
    /// `None` if the job does not ask for it.
    pub(super) log: Option<DecisionLog>,
    /// The updates reported since the last episode ended, and the exploration rate.
    since: TrainedEpisode,
}

impl<'j> TrainingRecord<'j> {
    /// The record of a job before its first episode.
    pub(super) fn new(job: &'j Job, control: &'j dyn TrainingControl) -> Self {
        let records = job.evaluation.record_decisions.of_training();
        TrainingRecord {
            job,
            control,
            begun: 0,
            curve: CurveRecorder::new(
                job.evaluation.curve_stride,
                job.termination_metric(),
                job.evaluation.first_returns(),
            ),
            log: records.then(|| DecisionLog::new(job.agent.unavailable(), Phase::Train)),
            since: TrainedEpisode::default(),
        }
    }

    /// The number of training episodes finished.
    pub(super) fn episodes(&self) -> u32 {
        self.curve.episodes()
    }

    /// Counts episodes that begin.
    ///
    /// **Errors**: a description, if the budget has too few.
    pub(super) fn begin(&mut self, episodes: usize) -> Result<(), String> {
        let budget = self.job.agent.episodes();
        let begun = u32::try_from(episodes).ok().and_then(|more| self.begun.checked_add(more));
        match begun.filter(|begun| *begun <= budget) {
            Some(begun) => self.begun = begun,
            None => {
                return Err(format!(
                    "expected at most {} of training, the job's budget; found {episodes} more after {}",
                    counted(budget, "episode"),
                    self.begun
                ));
            }
        }
        Ok(())
    }

    /// Adds an episode that has ended to the learning curve.
    ///
    /// **Errors**: memory is short.
    pub(super) fn end(
        &mut self,
        total_reward: f64,
        length: u32,
        terminated: bool,
    ) -> Result<(), OutOfMemory> {
        let epsilon = self.since.epsilon;
        let episode = TrainedEpisode { total_reward, length, terminated, ..self.since };
        self.since = TrainedEpisode { epsilon, ..TrainedEpisode::default() };
        self.curve.add(&episode)?;
        let progress = TrainingProgress {
            episode: self.curve.episodes(),
            episodes: self.job.agent.episodes(),
            recent_return: self.curve.recent_return(),
        };
        self.control.report(progress, self.curve.points());
        Ok(())
    }

    /// Records an update, which belongs to the next episode that ends.
    pub(super) fn update(&mut self, update: Update) {
        self.since.updates += u32::from(update.loss.is_some());
        self.since.loss_sum += update.loss.unwrap_or_default();
        self.since.epsilon = update.epsilon.or(self.since.epsilon);
    }

    /// Adds episodes that the program has played itself.
    ///
    /// **Errors**: there is not enough memory; or a description of the fault in the episodes.
    pub(super) fn add(&mut self, of: &OwnEpisodes) -> Result<Result<(), String>, Broken> {
        let count = of.returns.len();
        if let Some(fault) = self.fault(of) {
            return Ok(Err(fault));
        }
        if let Err(fault) = self.begin(count) {
            return Ok(Err(fault));
        }
        for ((total, length), terminated) in of.returns.iter().zip(&of.lengths).zip(&of.terminated)
        {
            self.end(*total, *length, *terminated)?;
        }
        Ok(Ok(()))
    }

    fn fault(&self, of: &OwnEpisodes) -> Option<String> {
        let (count, lengths, terminated) =
            (of.returns.len(), of.lengths.len(), of.terminated.len());
        if self.log.is_some() {
            return Some(
                "expected \"reset\" and \"step\", because the job records the decisions of training; \
                 found \"episodes\""
                    .to_owned(),
            );
        }
        if lengths != count || terminated != count {
            return Some(format!(
                "expected as many `lengths` and `terminated` as `returns`, which are {count}; found \
                 {lengths} and {terminated}"
            ));
        }
        let longest = self.job.environment.longest_episode();
        let wrong = of.lengths.iter().find(|length| !(1..=longest).contains(*length));
        let steps =
            if longest == 1 { "1 step".to_owned() } else { format!("1 to {longest} steps") };
        wrong.map(|length| format!("`lengths`: expected {steps}, found {length}"))
    }

    /// The outcome of a job whose program failed.
    pub(super) fn failed(&self, error: &ProgramError) -> Outcome {
        Outcome::Failed(Failure {
            kind: FailureKind::External,
            message: error.to_string(),
            episode: self.episodes(),
        })
    }

    /// The results of a job, including its test.
    pub(super) fn results(self, test: Test) -> Results {
        let trained = self.episodes();
        // A program may train for fewer episodes than its budget allows.
        let known = self
            .job
            .evaluation
            .first_returns()
            .filter(|metric| metric.first_episodes() <= Some(trained));
        let known: Vec<MetricName> = known.collect();
        let first = |tested: &Tested, curve: &CurveRecorder| {
            if self.job.trial.is_some() {
                return tested.first_returns(self.job.evaluation.first_returns()).collect();
            }
            curve.first_returns().filter(|metric| known.contains(&metric.name)).collect()
        };
        assemble(test.finish(), self.curve, self.log, first, None)
    }
}
