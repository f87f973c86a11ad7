//! What has become of a submission: its chunks by state, its jobs done and left.
//!
//! In: what an engine says is alive, if it answers, and what attempts and parts in the folder say.
//! The engine is asked first and the folder read after that: a task leaves the engine only after it
//! has written how it ended. An engine that does not answer makes a chunk unknown, never finished.

use std::collections::{HashMap, HashSet};

use super::attempt::{Attempt, AttemptEnd};
use super::engine::{Alive, Phase};
use super::error::ClusterError;
use super::folder::{HandedIn, Stop, Submission};
use crate::plan::JobKey;

/// The state of a chunk.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ChunkState {
    /// The engine holds it, and it has no node.
    Waiting,
    /// It has a node.
    Running,
    /// Its jobs are handed in.
    Finished,
    /// The engine no longer holds it, and jobs are left.
    Lost(Loss),
    /// The engine does not answer.
    Unknown,
}

/// How a chunk was lost.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Loss {
    /// None of its attempts has begun: it was cancelled while it waited, or its script failed.
    NotBegun,
    /// Its last attempt was stopped and not queued again: it was cancelled.
    Stopped,
    /// Its last attempt could not go on, and says why.
    Failed(String),
    /// Its last attempt ended without a word: its node was lost, or it was killed.
    Died,
}

/// A chunk of a submission.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Its number.
    pub number: u32,
    /// Its state.
    pub state: ChunkState,
    /// Number of its jobs.
    pub jobs: usize,
    /// Its jobs that are not handed in.
    pub left: Vec<JobKey>,
    /// Attempts that ended without a word.
    pub deaths: u32,
}

/// What has become of a submission.
#[derive(Clone, Debug)]
pub struct Survey {
    /// Its chunks, by number.
    pub chunks: Vec<Chunk>,
    /// Core-hours that its attempts took, as far as they could say.
    pub core_hours: f64,
    /// Why its tasks are not to run, if so.
    pub stopped: Option<Stop>,
}

/// How many chunks are in each state.
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

impl Survey {
    /// Reads a submission. `alive` is what the engine holds, of this submission or of others too;
    /// `None` if it does not answer.
    ///
    /// **Errors**: a file of the submission cannot be read.
    pub fn of(submission: &Submission, alive: Option<&[Alive]>) -> Result<Survey, ClusterError> {
        let name = submission.array_name();
        let held: Option<HashMap<u32, Phase>> = alive.map(|alive| {
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
        Ok(Survey {
            chunks: (0..submission.intent.chunks)
                .map(chunk)
                .collect::<Result<_, ClusterError>>()?,
            core_hours: attempts.values().flatten().map(Attempt::core_hours).sum(),
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
    /// Chunks that may still hand something in.
    pub fn open(&self) -> usize {
        self.waiting + self.running + self.unknown
    }
}

/// `held` is what the engine says of the chunk: `None` if it does not answer, `Some(None)` if it
/// does not hold it.
fn state(attempts: &[Attempt], all_in: bool, held: Option<Option<&Phase>>) -> ChunkState {
    let finished = attempts.iter().any(|attempt| attempt.end == Some(AttemptEnd::Finished));
    match held {
        _ if finished && all_in => ChunkState::Finished,
        None => ChunkState::Unknown,
        Some(Some(Phase::Waiting)) => ChunkState::Waiting,
        Some(Some(Phase::Running)) => ChunkState::Running,
        // Killed between the hand-in and the word of it.
        Some(None) if all_in => ChunkState::Finished,
        Some(None) => ChunkState::Lost(match attempts.last().map(|last| &last.end) {
            None => Loss::NotBegun,
            Some(None) => Loss::Died,
            Some(Some(AttemptEnd::Stopped)) => Loss::Stopped,
            Some(Some(AttemptEnd::Failed(reason))) => Loss::Failed(reason.clone()),
            Some(Some(AttemptEnd::Finished)) => {
                Loss::Failed("it finished, but parts of it are gone from the folder".to_owned())
            }
        }),
    }
}

/// The jobs that were handed in, and how they ended.
pub fn handed_in(submission: &Submission) -> Result<HashMap<JobKey, HandedIn>, ClusterError> {
    let parts = submission.parts()?;
    Ok(parts.iter().filter_map(|part| part.jobs()).flatten().collect())
}

/// How often tasks died with each job, and in which chunk the last did.
#[derive(Clone, Debug, Default)]
pub struct Deaths {
    jobs: HashMap<JobKey, Dead>,
    chunks: usize,
}

/// The tasks that died with a job.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Dead {
    /// How many.
    pub tasks: u32,
    /// A number of the chunk of the last one.
    pub last: usize,
    /// Whether the job was the only one left in the last one.
    pub alone: bool,
}

/// Deaths after which a job has failed, if it was alone at the last.
const MOST_DEATHS: u32 = 3;

impl Deaths {
    /// Adds those of a submission, which began later than those before. `counts` says whether the
    /// deaths of a job in it count.
    pub fn add(&mut self, survey: &Survey, counts: impl Fn(&JobKey) -> bool) {
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

    /// Those of a job.
    pub fn of(&self, key: &JobKey) -> Option<Dead> {
        self.jobs.get(key).copied()
    }

    /// The jobs that brought their tasks down too often, the last one alone.
    pub fn guilty(&self) -> HashSet<JobKey> {
        let is_guilty = |dead: &Dead| dead.tasks >= MOST_DEATHS && dead.alone;
        self.jobs.iter().filter(|(_, dead)| is_guilty(dead)).map(|(key, _)| *key).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attempt(end: Option<AttemptEnd>) -> Attempt {
        Attempt { end, ..Attempt::begin(0, "1.0".to_owned(), "n1".to_owned(), 1) }
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
        let lost = |attempts: &[Attempt]| state(attempts, false, Some(None));
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
        assert_eq!(state(&stopped, false, Some(Some(&Phase::Waiting))), ChunkState::Waiting);
        assert_eq!(state(&stopped, false, Some(Some(&Phase::Running))), ChunkState::Running);
    }

    fn survey(left: &[&[u8]], deaths: u32, stopped: Option<Stop>) -> Survey {
        let chunk = |(number, keys): (usize, &&[u8])| Chunk {
            number: number as u32,
            state: ChunkState::Lost(Loss::Died),
            jobs: keys.len(),
            left: keys.iter().map(|key| JobKey([*key; 16])).collect(),
            deaths,
        };
        let chunks = left.iter().enumerate().map(chunk).collect();
        Survey { chunks, core_hours: 0.0, stopped }
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
