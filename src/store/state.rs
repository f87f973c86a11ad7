//! The state of a job, over all its runs.

use std::cmp::Reverse;

use rusqlite::Connection;
use rusqlite::types::{FromSql, FromSqlError, FromSqlResult, ValueRef};

/// The state of a job over all its runs, in ascending order of progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum JobState {
    /// The job has no run.
    Pending,
    /// Its runs were interrupted, or their process died. The job will run again.
    Interrupted,
    /// A run failed. The job runs again only on request.
    Failed,
    /// A living process is running the job.
    Running,
    /// The job has a completed run.
    Completed,
}

impl JobState {
    /// The name of the state on the command line.
    pub fn name(self) -> &'static str {
        match self {
            JobState::Pending => "pending",
            JobState::Interrupted => "interrupted",
            JobState::Failed => "failed",
            JobState::Running => "running",
            JobState::Completed => "completed",
        }
    }
}

/// The number of jobs in each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Jobs without a run.
    pub pending: u64,
    /// Interrupted; will run again.
    pub interrupted: u64,
    /// Failed.
    pub failed: u64,
    /// Run by a living process.
    pub running: u64,
    /// Completed.
    pub completed: u64,
}

impl Counts {
    /// The number of all jobs.
    pub fn total(&self) -> u64 {
        self.pending + self.interrupted + self.failed + self.running + self.completed
    }

    /// Adds `jobs` jobs in this state.
    pub fn add(&mut self, state: JobState, jobs: u64) {
        *match state {
            JobState::Pending => &mut self.pending,
            JobState::Interrupted => &mut self.interrupted,
            JobState::Failed => &mut self.failed,
            JobState::Running => &mut self.running,
            JobState::Completed => &mut self.completed,
        } += jobs;
    }
}

/// The states of all jobs that have runs, sorted by row id, for counting. Reading every run once is many
/// times faster than [`state_sql`] for every job. Lookups in the order of row ids have better memory locality
/// than lookups in a hash table.
pub(super) struct RunStates(Vec<(i64, JobState)>);

impl RunStates {
    /// The current states, where `alive` are the living sessions.
    pub(super) fn read(connection: &Connection, alive: &[i64]) -> rusqlite::Result<RunStates> {
        let mut statement = connection.prepare_cached(
            "SELECT job, session, CASE status
                WHEN 'completed' THEN 4 WHEN 'running' THEN 3 WHEN 'failed' THEN 2 ELSE 1 END
             FROM run",
        )?;
        let mut rows = statement.query([])?;
        let mut states = Vec::new();
        while let Some(row) = rows.next()? {
            let mut state: JobState = row.get(2)?;
            if state == JobState::Running && !alive.contains(&row.get(1)?) {
                state = JobState::Interrupted;
            }
            states.push((row.get(0)?, state));
        }
        // The most advanced state of each job comes first and is kept.
        states.sort_by_key(|&(job, state)| (job, Reverse(state)));
        states.dedup_by_key(|&mut (job, _)| job);
        Ok(RunStates(states))
    }

    /// The state of a job.
    pub(super) fn of(&self, job: i64) -> JobState {
        match self.0.binary_search_by_key(&job, |&(job, _)| job) {
            Ok(at) => self.0[at].1,
            Err(_) => JobState::Pending,
        }
    }
}

/// SQL for the state of the job with row id `{job}`, where `{alive}` is a JSON list of the living sessions:
/// the most advanced state of any run, as [`JobState`] reads it. A failure outranks a later interruption,
/// because the job would fail again.
pub(super) fn state_sql(job: &str, alive: &str) -> String {
    format!(
        "(SELECT max(CASE status
            WHEN 'completed' THEN 4
            WHEN 'running' THEN iif(session IN (SELECT value FROM json_each({alive})), 3, 1)
            WHEN 'failed' THEN 2
            WHEN 'interrupted' THEN 1 END) FROM run AS attempt WHERE attempt.job = {job})"
    )
}

impl FromSql for JobState {
    fn column_result(value: ValueRef<'_>) -> FromSqlResult<Self> {
        match value {
            ValueRef::Null => Ok(JobState::Pending),
            ValueRef::Integer(1) => Ok(JobState::Interrupted),
            ValueRef::Integer(2) => Ok(JobState::Failed),
            ValueRef::Integer(3) => Ok(JobState::Running),
            ValueRef::Integer(4) => Ok(JobState::Completed),
            _ => Err(FromSqlError::InvalidType),
        }
    }
}
