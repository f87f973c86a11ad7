//! The state of a submission: its chunks by state, and its jobs done and left.
//!
//! In: the tasks that the engine holds (if it answers), and the attempts and parts in the folder. The
//! engine is queried before the folder is read, because a task leaves the engine only after it has
//! written how it ended. If the engine does not answer, a chunk is finished if its attempt recorded
//! this and all its jobs are handed in; otherwise its state is unknown.

use std::collections::{HashMap, HashSet};

use super::attempt::{AttemptEnd, TaskAttempt};
use super::engine::{Alive, TaskPhase};
use super::error::ClusterError;
use super::folder::{HandedIn, Stop, Submission};
use crate::job::JobKey;

/// The state of a chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChunkState {
    /// The engine holds the chunk, which has no node yet.
    Waiting,
    /// The chunk has a node.
    Running,
    /// All jobs of the chunk are handed in.
    Finished,
    /// The engine no longer holds the chunk, and jobs are left.
    Lost(Loss),
    /// The engine does not answer.
    Unknown,
}

/// How a chunk was lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Loss {
    /// No attempt has started: the task was cancelled while it waited, or its script failed.
    NotBegun,
    /// Its last attempt was stopped and not requeued: the task was cancelled.
    Stopped,
    /// Its last attempt failed, with this reason.
    Failed(String),
    /// Its last attempt died without a record: it was killed, or its node was lost.
    Died,
}

/// A chunk of a submission.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Its number.
    pub number: u32,
    /// Its state.
    pub state: ChunkState,
    /// Number of jobs.
    pub jobs: usize,
    /// The jobs that are not handed in.
    pub left: Vec<JobKey>,
    /// Number of attempts that died.
    pub deaths: u32,
}

/// The state of a submission.
#[derive(Clone, Debug)]
pub struct ChunkSurvey {
    /// Its chunks, by number.
    pub chunks: Vec<Chunk>,
    /// Recorded core-hours of its attempts.
    pub core_hours: f64,
    /// Why the submission was stopped, if it was.
    pub stopped: Option<Stop>,
}

/// The number of chunks in each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ChunkCounts {
    /// Waiting for a node.
    pub waiting: usize,
    /// Running.
    pub running: usize,
    /// Finished.
    pub finished: usize,
    /// Lost.
    pub lost: usize,
    /// Unknown.
    pub unknown: usize,
}

impl ChunkSurvey {
    /// Reads a submission. `alive` lists the tasks that the engine holds, possibly of other submissions
    /// too; `None` if it does not answer.
    ///
    /// **Errors**: a file of the submission cannot be read.
    pub fn of(
        submission: &Submission,
        alive: Option<&[Alive]>,
    ) -> Result<ChunkSurvey, ClusterError> {
        let name = submission.array_name();
        let held: Option<HashMap<u32, TaskPhase>> = alive.map(|alive| {
            let ours = alive.iter().filter(|task| task.name == name);
            ours.map(|task| (task.chunk, task.phase)).collect()
        });
        let attempts = submission.attempts()?;
        let handed = handed_in(submission)?;
        let none = Vec::new();
        let chunk = |number| {
            let keys = submission.chunk(number)?;
            let attempts = attempts.get(&number).unwrap_or(&none);
            let left: Vec<JobKey> =
                keys.iter().filter(|key| !handed.contains_key(key)).copied().collect();
            let state = state(attempts, left.is_empty(), held.as_ref().map(|h| h.get(&number)));
            let deaths = attempts.iter().filter(|attempt| attempt.end.is_none()).count() as u32;
            let deaths = if let ChunkState::Lost(_) = state { deaths } else { 0 };
            Ok(Chunk { number, state, jobs: keys.len(), left, deaths })
        };
        Ok(ChunkSurvey {
            chunks: (0..submission.intent.chunks)
                .map(chunk)
                .collect::<Result<_, ClusterError>>()?,
            core_hours: attempts
                .values()
                .flatten()
                .fold(0.0, |hours, one| hours + one.core_hours()),
            stopped: submission.stopped(),
        })
    }

    /// The chunks by state.
    pub fn counts(&self) -> ChunkCounts {
        let mut counts = ChunkCounts::default();
        for chunk in &self.chunks {
            *match chunk.state {
                ChunkState::Waiting => &mut counts.waiting,
                ChunkState::Running => &mut counts.running,
                ChunkState::Finished => &mut counts.finished,
                ChunkState::Lost(_) => &mut counts.lost,
                ChunkState::Unknown => &mut counts.unknown,
            } += 1;
        }
        counts
    }

    /// The jobs that a task may still complete.
    pub fn held(&self) -> impl Iterator<Item = &JobKey> {
        let is_held = |chunk: &&Chunk| match chunk.state {
            ChunkState::Waiting | ChunkState::Running | ChunkState::Unknown => true,
            ChunkState::Finished | ChunkState::Lost(_) => false,
        };
        self.chunks.iter().filter(is_held).flat_map(|chunk| &chunk.left)
    }
}

impl ChunkCounts {
    /// Number of chunks that may still hand in results.
    pub fn open(&self) -> usize {
        self.waiting + self.running + self.unknown
    }
}

/// The state of a chunk. `held` is the engine's answer about the chunk: `None` if the engine does not
/// answer, `Some(None)` if the engine does not hold the chunk.
fn state(attempts: &[TaskAttempt], all_in: bool, held: Option<Option<&TaskPhase>>) -> ChunkState {
    let finished = attempts.iter().any(|attempt| attempt.end == Some(AttemptEnd::Finished));
    match held {
        _ if finished && all_in => ChunkState::Finished,
        None => ChunkState::Unknown,
        Some(Some(TaskPhase::Waiting)) => ChunkState::Waiting,
        Some(Some(TaskPhase::Running)) => ChunkState::Running,
        // The task was killed between the hand-in and the record of its end.
        Some(None) if all_in => ChunkState::Finished,
        Some(None) => ChunkState::Lost(match attempts.last().map(|last| &last.end) {
            None => Loss::NotBegun,
            Some(None) => Loss::Died,
            Some(Some(AttemptEnd::Stopped)) => Loss::Stopped,
            Some(Some(AttemptEnd::Failed(reason))) => Loss::Failed(reason.clone()),
            Some(Some(AttemptEnd::Finished)) => Loss::Failed(
                "it finished, but some of its results are missing from the submission".to_owned(),
            ),
        }),
    }
}

/// The handed-in jobs, and how they ended.
pub fn handed_in(submission: &Submission) -> Result<HashMap<JobKey, HandedIn>, ClusterError> {
    let parts = submission.parts()?;
    Ok(parts.iter().filter_map(|part| part.jobs()).flatten().collect())
}

/// The number of tasks that died with each job, and the chunk of the last one.
#[derive(Clone, Debug, Default)]
pub struct Deaths {
    jobs: HashMap<JobKey, Dead>,
    chunks: usize,
}

/// The tasks that died with a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dead {
    /// Number of these tasks.
    pub tasks: u32,
    /// Identifies the chunk of the last of these tasks.
    pub last: usize,
    /// Whether the job was the only one left in the last of these tasks.
    pub alone: bool,
}

/// Number of deaths after which a job is recorded as failed, if it was alone in the last task.
const MOST_DEATHS: u32 = 3;

impl Deaths {
    /// Adds the deaths of a submission, in order of submission. `counts` decides whether the deaths of a
    /// job in it count.
    pub fn add(&mut self, survey: &ChunkSurvey, counts: impl Fn(&JobKey) -> bool) {
        if survey.stopped.is_some() {
            return;
        }
        for chunk in survey.chunks.iter().filter(|chunk| chunk.deaths > 0) {
            self.chunks += 1;
            for key in chunk.left.iter().filter(|key| counts(key)) {
                let dead = Dead { tasks: 0, last: 0, alone: false };
                let dead = self.jobs.entry(*key).or_insert(dead);
                dead.tasks += chunk.deaths;
                dead.last = self.chunks;
                dead.alone = chunk.left.len() == 1;
            }
        }
    }

    /// The tasks that died with a job.
    pub fn of(&self, key: &JobKey) -> Option<Dead> {
        self.jobs.get(key).copied()
    }

    /// The jobs with too many dead tasks, in the last of which the job was alone.
    pub fn guilty(&self) -> HashSet<JobKey> {
        let is_guilty = |dead: &Dead| dead.tasks >= MOST_DEATHS && dead.alone;
        self.jobs.iter().filter(|(_, dead)| is_guilty(dead)).map(|(key, _)| *key).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attempt(end: Option<AttemptEnd>) -> TaskAttempt {
        TaskAttempt { end, ..TaskAttempt::begin(0, "1.0".to_owned(), "n1".to_owned(), 1) }
    }

    #[test]
    fn an_engine_that_does_not_answer_makes_a_chunk_unknown_unless_it_says_that_it_finished() {
        let finished = [attempt(Some(AttemptEnd::Finished))];
        for attempts in [&[][..], &[attempt(None)], &[attempt(Some(AttemptEnd::Stopped))]] {
            assert_eq!(state(attempts, false, None), ChunkState::Unknown);
        }
        assert_eq!(state(&finished, true, None), ChunkState::Finished);
    }

    #[test]
    fn a_chunk_that_the_engine_does_not_hold_is_lost_until_all_of_it_is_handed_in() {
        let lost = |attempts: &[TaskAttempt]| state(attempts, false, Some(None));
        assert_eq!(lost(&[]), ChunkState::Lost(Loss::NotBegun));
        assert_eq!(lost(&[attempt(None)]), ChunkState::Lost(Loss::Died));
        let stopped = attempt(Some(AttemptEnd::Stopped));
        assert_eq!(lost(std::slice::from_ref(&stopped)), ChunkState::Lost(Loss::Stopped));
        let failed = attempt(Some(AttemptEnd::Failed("full".to_owned())));
        assert_eq!(lost(&[stopped, failed]), ChunkState::Lost(Loss::Failed("full".to_owned())));
        assert_eq!(state(&[attempt(None)], true, Some(None)), ChunkState::Finished);
    }

    #[test]
    fn a_chunk_that_was_preempted_waits_and_is_neither_done_nor_lost() {
        let stopped = [attempt(Some(AttemptEnd::Stopped))];
        assert_eq!(state(&stopped, false, Some(Some(&TaskPhase::Waiting))), ChunkState::Waiting);
        assert_eq!(state(&stopped, false, Some(Some(&TaskPhase::Running))), ChunkState::Running);
    }

    fn survey(left: &[&[u8]], deaths: u32, stopped: Option<Stop>) -> ChunkSurvey {
        let chunk = |(number, keys): (usize, &&[u8])| Chunk {
            number: number as u32,
            state: ChunkState::Lost(Loss::Died),
            jobs: keys.len(),
            left: keys.iter().map(|key| JobKey([*key; 16])).collect(),
            deaths,
        };
        let chunks = left.iter().enumerate().map(chunk).collect();
        ChunkSurvey { chunks, core_hours: 0.0, stopped }
    }

    #[test]
    fn a_job_is_guilty_after_three_deaths_the_last_of_them_alone() {
        let mut deaths = Deaths::default();
        let all = |_: &JobKey| true;
        deaths.add(&survey(&[&[1, 2, 3]], 1, None), all);
        deaths.add(&survey(&[&[1, 2]], 1, None), all);
        deaths.add(&survey(&[&[1, 2]], 1, None), all);
        assert!(deaths.guilty().is_empty());
        assert_eq!(deaths.of(&JobKey([3; 16])).unwrap().tasks, 1);
        deaths.add(&survey(&[&[1]], 1, None), all);
        assert_eq!(deaths.guilty(), HashSet::from([JobKey([1; 16])]));
    }

    #[test]
    fn tasks_of_a_cancelled_submission_and_before_a_recorded_crash_do_not_count() {
        let mut deaths = Deaths::default();
        deaths.add(&survey(&[&[1]], 3, Some(Stop::Cancelled)), |_| true);
        deaths.add(&survey(&[&[1]], 3, None), |_| false);
        assert!(deaths.of(&JobKey([1; 16])).is_none());
    }
}
