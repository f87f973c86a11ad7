//! The events of a sweep, and their receiver.

use std::io;
use std::time::Duration;

use crate::record::Outcome;
use crate::schedule::checkpoint::CheckpointNote;
use crate::schedule::queued::Queued;
use crate::train::TrainingProgress;

/// What happens in a sweep, in order.
#[derive(Debug)]
pub enum Event<'a> {
    /// A worker has begun a job.
    Started {
        /// Which worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
    },
    /// A run has ended and is stored. Its worker may have begun another job by then.
    Ended {
        /// Which worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
        /// How it ended.
        outcome: &'a Outcome,
        /// Time it took.
        wall: Duration,
    },
    /// A run has ended, but another process had taken its job over: nothing of it is stored, and
    /// the job is waited for.
    Lost {
        /// Which worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
    },
    /// Something happened to a checkpoint of a job that a worker has begun.
    Checkpoint {
        /// Which worker, from 0.
        worker: usize,
        /// The job.
        queued: &'a Queued,
        /// What happened.
        note: &'a CheckpointNote,
    },
    /// A job needed no run of this sweep.
    Skipped {
        /// The job.
        queued: &'a Queued,
        /// Why it needed none.
        found: Found,
    },
    /// The system has threads for some of the workers only; the sweep goes on with these.
    FewerWorkers {
        /// How many there are.
        started: usize,
        /// What the system said about the next.
        reason: &'a io::Error,
    },
    /// Whenever no job has ended for a tenth of a second: how far each worker has come with its job.
    Tick {
        /// By worker; `None` while idle or before the first report.
        progress: &'a [Option<TrainingProgress>],
        /// Jobs that another process holds and that nothing else is left to do but wait for.
        waiting_for: usize,
    },
}

/// A receiver of the events of a sweep, such as a progress display.
pub trait EventSink {
    /// Takes an event, on the thread that owns the store.
    fn on_event(&mut self, event: Event<'_>);
}

impl<F: FnMut(Event<'_>)> EventSink for F {
    fn on_event(&mut self, event: Event<'_>) {
        self(event);
    }
}

/// Why a job needs no run of this sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// It is completed, by an earlier sweep or another process.
    Completed,
    /// It failed, in an earlier sweep or another process, and is not to be retried.
    Failed,
}
