//! How a sweep of manifests ended.

use super::estimates::Estimated;
use super::survey::Remaining;
use super::sweep::{OnFailure, Tally};
use crate::job::counted;

/// Why a sweep ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Every job has ended.
    NothingLeft,
    /// The sweep was stopped from outside.
    Stopped,
    /// A job failed, and failures stop the sweep.
    Failure,
}

impl Cause {
    /// The name of the last event.
    pub fn name(self) -> &'static str {
        match self {
            Cause::NothingLeft => "done",
            Cause::Stopped => "stopped",
            Cause::Failure => "halted",
        }
    }
}

/// How a sweep ended.
pub struct End {
    /// Number of completed jobs that lacked estimates.
    lacking: usize,
    /// Number of jobs to run.
    queued: usize,
    /// Number of jobs that had completed before the sweep.
    completed_before: usize,
    /// Number of jobs that had failed before the sweep and were not run again.
    failed_before: usize,
    tally: Tally,
    cause: Cause,
    /// Number of jobs that ran at earlier stages of a race.
    ran_before: usize,
}

impl End {
    /// The end of a sweep that has not begun.
    pub fn before(remaining: &Remaining) -> End {
        End {
            lacking: remaining.lacking.len(),
            queued: remaining.queue.len(),
            completed_before: remaining.completed,
            failed_before: remaining.failed,
            tally: Tally::default(),
            cause: Cause::NothingLeft,
            ran_before: 0,
        }
    }

    /// The end after this number of jobs has run at earlier stages of a race.
    pub fn after(self, ran: usize) -> End {
        End { ran_before: ran, ..self }
    }

    /// The end of the sweep with this tally.
    pub fn ran_to(self, tally: Tally) -> End {
        End { tally, ..self }
    }

    /// The end with its cause. A stop after the last job has no effect.
    pub fn because(self, is_stopped: bool, on_failure: OnFailure) -> End {
        let cause = match on_failure {
            _ if self.left() == 0 && self.lacking_estimates() == 0 => Cause::NothingLeft,
            _ if is_stopped => Cause::Stopped,
            // Another process deleted jobs that lacked estimates.
            OnFailure::Stop if self.left() == 0 && self.tally.failed == 0 => Cause::NothingLeft,
            OnFailure::Stop => Cause::Failure,
            OnFailure::Continue => Cause::NothingLeft,
        };
        End { cause, ..self }
    }

    /// The end before the next stage of a race, which does not begin after a failure that stops the sweep.
    pub fn before_next_stage(self, on_failure: OnFailure) -> End {
        match (self.cause, on_failure) {
            (Cause::NothingLeft, OnFailure::Stop) if self.tally.failed > 0 => {
                End { cause: Cause::Failure, ..self }
            }
            _ => self,
        }
    }

    /// Why it ended.
    pub fn cause(&self) -> Cause {
        self.cause
    }

    /// How the estimates that completed jobs lacked came about.
    pub fn estimated(&self) -> &Estimated {
        &self.tally.estimated
    }

    /// Number of completed jobs whose estimates remain to be added, after a stop.
    fn lacking_estimates(&self) -> usize {
        self.lacking - self.tally.estimated.jobs()
    }

    /// Number of jobs that the sweep ran to their end.
    pub fn ran(&self) -> usize {
        self.ran_before + self.tally.completed + self.tally.failed
    }

    /// Number of completed jobs, whenever they ran.
    pub fn completed(&self) -> usize {
        self.completed_before + self.tally.already_completed + self.tally.completed
    }

    /// Number of failed jobs, whenever they ran.
    pub fn failed(&self) -> usize {
        self.failed_before + self.tally.already_failed + self.tally.failed
    }

    /// Number of jobs that have not ended.
    pub fn left(&self) -> usize {
        self.completed_before + self.failed_before + self.queued - self.completed() - self.failed()
    }

    /// The end in one line; `resume` says how to resume after a stop.
    pub fn line(&self, resume: &str) -> String {
        let (completed, failed, left) = (self.completed(), self.failed(), self.left());
        let ran = counted(self.ran(), "job");
        let ran = format!("{ran} run, {completed} completed in all, {failed} failed");
        match self.cause {
            Cause::Stopped => {
                let completed = counted(completed, "job");
                format!("stopped: {completed} completed, {left} left; {resume}")
            }
            Cause::Failure if left == 0 && self.lacking_estimates() > 0 => {
                let jobs = counted(self.lacking_estimates(), "completed job");
                format!("{ran}; halted after the first failure; estimates of {jobs} left")
            }
            Cause::Failure if left == 0 => {
                format!("{ran}; halted after the first failure, before the next stage")
            }
            Cause::Failure => {
                format!("{ran}; halted after the first failure; {} left", counted(left, "job"))
            }
            Cause::NothingLeft if self.queued == 0 && self.ran_before == 0 && failed == 0 => {
                match completed {
                    0 => "nothing to run: none of these jobs is wanted yet".to_owned(),
                    1 => "nothing to run: the job is completed".to_owned(),
                    _ => format!("nothing to run: all {completed} jobs are completed"),
                }
            }
            Cause::NothingLeft => ran,
        }
    }
}
