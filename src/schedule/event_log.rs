//! The events of a sweep as JSON, for programs.
//!
//! In: events. Out: an object per event, with its kind under `event`, in the order in which programs read
//! them: the end of a job comes before the next start of its worker.

use std::collections::VecDeque;
use std::path::Path;

use serde_json::{Value, json};

use super::checkpoint::CheckpointNote;
use super::event::{Event, Found};
use super::queued::Queued;
use crate::job::Outcome;
use crate::key::{Parameter, printable};
use crate::plan::Swept;

/// The events of a sweep as JSON.
#[derive(Debug)]
pub struct EventLog {
    swept: Swept,
    queues: Vec<EventQueue>,
}

impl EventLog {
    /// The log of a sweep with this number of workers.
    pub fn new(workers: usize, swept: Swept) -> EventLog {
        EventLog { swept, queues: (0..workers).map(|_| EventQueue::default()).collect() }
    }

    /// The objects to write after an event; none while estimates of completed jobs are added.
    pub fn of(&mut self, event: &Event<'_>) -> Vec<Value> {
        if !event.is_of_run() {
            return Vec::new();
        }
        match *event {
            Event::Started { worker, queued } => {
                let event = json!({
                    "event": "started", "worker": worker, "job": self.described(queued),
                });
                self.queues[worker].start(event).into_iter().collect()
            }
            Event::Ended { worker, queued, outcome, wall } => {
                let status = match outcome {
                    Outcome::Completed(_) => "completed",
                    Outcome::Failed(_) => "failed",
                    Outcome::Interrupted => "interrupted",
                };
                let mut event = json!({
                    "event": status, "worker": worker, "job": self.described(queued),
                    "wall_seconds": wall.as_secs_f64(),
                });
                match outcome {
                    Outcome::Completed(results) => {
                        event["mean_return"] = json!(results.metric("mean_return"));
                    }
                    Outcome::Failed(failure) => {
                        event["kind"] = json!(failure.kind.word());
                        event["message"] = json!(failure.message);
                    }
                    Outcome::Interrupted => {}
                }
                self.end(worker, event)
            }
            Event::Checkpoint { worker, queued, note } => {
                let event = self.noted(worker, queued, note);
                self.queues[worker].note(event).into_iter().collect()
            }
            Event::Lost { worker, queued } => {
                let job = self.described(queued);
                self.end(worker, json!({ "event": "lost", "worker": worker, "job": job }))
            }
            Event::Skipped { queued, found } => {
                let found = match found {
                    Found::Completed => "completed",
                    Found::Failed => "failed",
                };
                vec![json!({ "event": "skipped", "found": found, "job": self.described(queued) })]
            }
            Event::FewerWorkers { .. } | Event::Tick { .. } => Vec::new(),
        }
    }

    /// What happened to a checkpoint of a worker's job.
    fn noted(&self, worker: usize, queued: &Queued, note: &CheckpointNote) -> Value {
        let mut event = json!({ "worker": worker, "job": self.described(queued) });
        let mut of_file = |kind: &str, path: &Path, reason: String| {
            event["event"] = json!(kind);
            event["file"] = json!(printable(&path.display().to_string()));
            event["reason"] = json!(reason);
        };
        match note {
            CheckpointNote::Resumed(resumed) => {
                event["event"] = json!("resumed");
                event["episode"] = json!(resumed.episode);
            }
            CheckpointNote::Refused { path, reason } => {
                of_file("checkpoint_refused", path, reason.to_string());
            }
            CheckpointNote::NotKept { path, reason } => {
                of_file("checkpoint_not_kept", path, reason.to_string());
            }
        }
        event
    }

    /// The end of a worker's job, and the events that waited for it.
    fn end(&mut self, worker: usize, event: Value) -> Vec<Value> {
        let mut events = vec![event];
        events.append(&mut self.queues[worker].end());
        events
    }

    fn described(&self, queued: &Queued) -> Value {
        json!({
            "job_key": queued.key.to_string(),
            "agent": queued.agent,
            "scenario": queued.job.scenario.to_string(),
            "sigma": queued.job.number(Parameter::Environment("sigma")),
            "seed": queued.job.seed,
            "swept": self.swept.object(&queued.agent, &queued.job),
        })
    }
}

/// The events of one worker in the order in which programs read them. A job is stored a moment after it
/// ends, when its worker may already have started further jobs. The events of these jobs wait until the
/// end of the earlier job has been written.
#[derive(Debug, Default)]
struct EventQueue {
    /// Whether the start of a job has been written and its end has not.
    open: bool,
    later: VecDeque<Value>,
}

impl EventQueue {
    /// Returns an event of the last started job, if it can be written now.
    fn note(&mut self, event: Value) -> Option<Value> {
        if self.later.is_empty() {
            return Some(event);
        }
        self.later.push_back(event);
        None
    }

    /// Returns the event for the start of a job, if it can be written now.
    fn start(&mut self, event: Value) -> Option<Value> {
        if self.open {
            self.later.push_back(event);
            return None;
        }
        self.open = true;
        Some(event)
    }

    /// Returns the events to write after the end of the open job: the start of the next job, and
    /// its events so far.
    fn end(&mut self) -> Vec<Value> {
        let starts = |event: &Value| event["event"] == "started";
        let next = self.later.iter().skip(1).position(starts);
        let count = next.map_or(self.later.len(), |after_first| after_first + 1);
        let ready: Vec<Value> = self.later.drain(..count).collect();
        self.open = !ready.is_empty();
        ready
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_job_is_written_before_the_next_start_of_its_worker() {
        let mut queue = EventQueue::default();
        let start = |job| json!({ "event": "started", "job": job });
        let [one, two, three] = [1, 2, 3].map(start);
        let note = json!({ "event": "resumed", "job": 2 });
        assert_eq!(queue.start(one.clone()), Some(one));
        assert_eq!(queue.start(two.clone()), None);
        assert_eq!(queue.note(note.clone()), None);
        assert_eq!(queue.start(three.clone()), None);
        assert_eq!(queue.end(), [two, note]);
        assert_eq!(queue.end(), vec![three.clone()]);
        assert_eq!(queue.note(json!("now")), Some(json!("now")));
        assert!(queue.end().is_empty());
        assert_eq!(queue.start(three.clone()), Some(three));
    }
}
