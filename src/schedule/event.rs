//! The events of a sweep, and their receiver.

use std::io;
use std::time::Duration;

use crate::job::Outcome;
use crate::schedule::checkpoint::CheckpointNote;
use crate::schedule::queued::{Queued, QueuedFor};
use crate::train::TrainingProgress;

/// An event of a sweep.
#[derive(Debug)]
pub enum Event<'a> {
    /// A worker has started a job.
    Started {
        /// The worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
    },
    /// A run has ended and is stored. Its worker may already have started another job.
    Ended {
        /// The worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
        /// How it ended.
        outcome: &'a Outcome,
        /// The duration of the run.
        wall: Duration,
    },
    /// A run has ended, but another process had taken over its job. The run is not stored, and the
    /// sweep waits for the other process.
    Lost {
        /// The worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
    },
    /// A checkpoint of a started job was used, rejected, or not written.
    Checkpoint {
        /// The worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
        /// The event of the checkpoint.
        note: &'a CheckpointNote,
    },
    /// A job needs no run in this sweep.
    Skipped {
        /// The job.
        queued: &'a Queued,
        /// The reason.
        found: Found,
    },
    /// The system could start only some of the workers; the sweep continues with these.
    FewerWorkers {
        /// The number of workers that started.
        started: usize,
        /// Why the next worker did not start.
        reason: &'a io::Error,
    },
    /// The progress of each worker, sent whenever no job has ended for 100 ms.
    Tick {
        /// Progress by worker; `None` while idle or before the first report.
        progress: &'a [Option<TrainingProgress>],
        /// The number of jobs that other processes run, if no other work is left; otherwise 0.
        waiting_for: usize,
    },
}

impl Event<'_> {
    /// Whether it is an event of a run, and not of a completed job that is trained again for estimates.
    pub fn is_of_run(&self) -> bool {
        match self {
            Event::Started { queued, .. }
            | Event::Ended { queued, .. }
            | Event::Lost { queued, .. }
            | Event::Checkpoint { queued, .. }
            | Event::Skipped { queued, .. } => queued.purpose == QueuedFor::Run,
            Event::FewerWorkers { .. } | Event::Tick { .. } => true,
        }
    }
}

/// A receiver of the events of a sweep, such as a progress display.
pub trait EventSink {
    /// Receives an event, on the thread that owns the store.
    fn on_event(&mut self, event: Event<'_>);
}

impl<F: FnMut(Event<'_>)> EventSink for F {
    fn on_event(&mut self, event: Event<'_>) {
        self(event);
    }
}

/// Why a job needs no run in this sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// An earlier sweep or another process completed the job.
    Completed,
    /// The job failed in an earlier sweep or another process, and failed jobs are not retried.
    Failed,
}
